"""A painted sheet that fills its mask, as a cloud and as a photo."""

import numpy as np

from tests.scenes import block
from tso_cli import Camera

SIZE = 64
CAMERA = Camera.canonical(SIZE, SIZE)
MASK = block(np.s_[5:59, 5:59])
COLUMNS, ROWS = np.meshgrid(np.arange(SIZE), np.arange(SIZE))


def painted(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """[..., 3] colours of the sheet at world coordinates."""
    return np.stack(
        [
            0.5 + 0.4 * np.sin(31.0 * x),
            0.5 + 0.4 * np.sin(27.0 * y),
            0.5 + 0.2 * np.cos(19.0 * (x + y)),
        ],
        -1,
    )


def sheet(step: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """A square sheet that fills the mask, a point to so many pixels, and its colours."""
    columns, rows = (part.ravel() for part in np.meshgrid(*[np.arange(5.0, 59.0, step)] * 2))
    x, y = (columns - 31.5) / 60.0, -(rows - 31.5) / 60.0
    return np.stack([x, y, np.zeros_like(x)], 1), painted(x, y)


def photo(exposure: float = 1.0, behind: float = 1.0) -> np.ndarray:
    image = exposure * painted((COLUMNS - 31.5) / 60.0, -(ROWS - 31.5) / 60.0)
    return np.where(MASK[..., None] > 0.5, image, behind).astype(np.float32)
