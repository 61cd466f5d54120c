"""Backgrounds of training pictures: crops of photos, or generated textures."""

from __future__ import annotations

import warnings
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.arrays import Floats
from ..geometry.resampling import area_resize
from ..io.images import read_image
from ..network.model import IMAGE_SIZE

TEXTURES = "textures"
SUFFIXES = (".jpg", ".jpeg", ".png", ".webp", ".bmp", ".tif", ".tiff")


class Backgrounds:
    """Random pictures [3, 64, 64] in [0, 1].

    They are crops of the photos in the folder ``source``, or generated textures if it is
    "textures". A photo that cannot be read causes one warning and an entry in ``unusable`` (photo
    -> why), and the next photo takes its place. With ``strict`` it is an error. A missing folder,
    and a folder without a readable picture, are always errors.
    """

    def __init__(self, source: str, strict: bool = False) -> None:
        self.source, self.strict = source, strict
        self.unusable: dict[str, str] = {}
        self._photo = lru_cache(maxsize=2000)(_shrunk)  # 0.2 MB each
        self._paths: list[Path] = []
        if source == TEXTURES:
            return
        folder = Path(source)
        if not folder.is_dir():
            raise InputError(
                f"{folder}: not a folder, "
                f"expected a folder of photos for backgrounds, or {TEXTURES!r}"
            )
        self._paths = sorted(
            path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES and path.is_file()
        )
        if not self._paths:
            raise InputError(f"{folder}: holds no picture, expected {', '.join(SUFFIXES)} files")

    def sample(self, rng: np.random.Generator) -> Floats:
        """One background: a random square of a random photo, or a new texture."""
        if not self._paths:
            return texture(rng)
        photo = self._photo_from(int(rng.integers(len(self._paths))))
        height, width = photo.shape[:2]
        side = rng.uniform(0.4, 1.0) * min(height, width)
        left, top = rng.uniform(0.0, width - side) - 0.5, rng.uniform(0.0, height - side) - 0.5
        crop, _ = area_resize(
            photo / np.float32(255.0), (left, top, left + side, top + side), IMAGE_SIZE, IMAGE_SIZE
        )
        if rng.random() < 0.5:
            crop = crop[:, ::-1]
        return np.ascontiguousarray(np.clip(crop, 0.0, 1.0).transpose(2, 0, 1), dtype=np.float32)

    def _photo_from(self, index: int) -> NDArray[np.uint8]:
        """The photo at ``index``, or the next one that can be read."""
        for path in self._paths[index:] + self._paths[:index]:
            if str(path) in self.unusable:
                continue
            try:
                return self._photo(path)
            except InputError as error:
                if self.strict:
                    raise
                self.unusable[str(path)] = str(error)
                warnings.warn(f"{error}; left out", stacklevel=2)
        raise InputError(
            f"{self.source}: no photo can be used; the first: {next(iter(self.unusable.values()))}"
        )


def _shrunk(path: Path) -> NDArray[np.uint8]:
    """The photo, shrunk to a longest side of 256 px."""
    pixels = read_image(path)[..., :3].astype(np.float32) / np.float32(255.0)
    height, width = pixels.shape[:2]
    factor = min(1.0, 256 / max(height, width))
    size = max(1, round(width * factor)), max(1, round(height * factor))
    shrunk, _ = area_resize(pixels, (-0.5, -0.5, width - 0.5, height - 0.5), *size)
    return np.rint(255.0 * np.clip(shrunk, 0.0, 1.0)).astype(np.uint8)


def texture(rng: np.random.Generator) -> Floats:
    """A random texture [3, 64, 64]: a gradient between two colours, and noise at five scales."""
    ends = rng.uniform(0.0, 1.0, (2, 3, 1, 1))
    angle = rng.uniform(0.0, 2.0 * np.pi)
    across = np.linspace(-0.5, 0.5, IMAGE_SIZE)
    ramp = np.clip(
        0.5 + np.cos(angle) * across[None, :] + np.sin(angle) * across[:, None], 0.0, 1.0
    )
    image = ends[0] * (1.0 - ramp) + ends[1] * ramp
    for cells in (2, 4, 8, 16, 32):
        deviation = rng.uniform(0.0, 0.25)
        channels = 3 if rng.random() < 0.5 else 1
        coarse = rng.normal(0.0, deviation, (channels, cells + 1, cells + 1))
        image = image + _enlarged(coarse, IMAGE_SIZE)
    return np.clip(image, 0.0, 1.0).astype(np.float32)


def _enlarged(values: NDArray[np.float64], size: int) -> NDArray[np.float64]:
    """Bilinear interpolation of [C, n, n] to [C, size, size], corner to corner."""
    position = np.linspace(0.0, values.shape[1] - 1.0, size)
    low = np.minimum(position.astype(int), values.shape[1] - 2)
    weights = np.zeros((size, values.shape[1]))
    weights[np.arange(size), low] = 1.0 - (position - low)
    weights[np.arange(size), low + 1] = position - low
    return np.einsum("ai,cij,bj->cab", weights, values, weights)
