"""A view: what one picture says of an object."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .camera import Camera
from .errors import InputError


@dataclass(frozen=True, eq=False)
class View:
    """A mask and the camera that saw it.

    Parameters
    ----------
    mask : [H, W] float in [0, 1], inside 1; foreground is > 0.5. Soft values are kept.
    camera : its width and height are the mask's.
    known : [H, W] bool, False where the mask says nothing, or None when every pixel counts.
    name : what messages call it, usually the file.
    """

    mask: NDArray[np.float32]
    camera: Camera
    known: NDArray[np.bool_] | None = None
    name: str = "mask"

    def __post_init__(self) -> None:
        mask = np.asarray(self.mask, dtype=np.float32)
        if mask.ndim != 2:
            raise InputError(f"{self.name}: mask has shape {list(mask.shape)}, expected [H, W]")
        if not np.isfinite(mask).all() or mask.min() < 0.0 or mask.max() > 1.0:
            raise InputError(f"{self.name}: mask values span {mask.min():g} to {mask.max():g}, expected 0 to 1")
        object.__setattr__(self, "mask", mask)
        height, width = mask.shape
        if (width, height) != (self.camera.width, self.camera.height):
            raise InputError(
                f"{self.name}: the mask is {width}x{height}, its camera is for "
                f"{self.camera.width}x{self.camera.height} (width x height), expected the same"
            )
        counted = mask
        if self.known is not None:
            known = np.asarray(self.known, dtype=bool)
            if known.shape != mask.shape:
                raise InputError(f"{self.name}: the ignore map is {known.shape[1]}x{known.shape[0]}, the mask {width}x{height}")
            object.__setattr__(self, "known", known)
            counted = mask[known]
        inside = int((counted > 0.5).sum())
        if inside == 0:
            raise InputError(f"{self.name}: no pixel is foreground (> 0.5), expected an object")
        if inside == counted.size:
            raise InputError(f"{self.name}: every pixel is foreground, expected some background (try --invert-mask?)")

    def box(self) -> tuple[float, float, float, float]:
        """Left, top, right, bottom edges of the foreground in pixel coordinates."""
        inside = self.mask > 0.5
        if self.known is not None:
            inside &= self.known
        rows, columns = np.flatnonzero(inside.any(1)), np.flatnonzero(inside.any(0))
        return columns[0] - 0.5, rows[0] - 0.5, columns[-1] + 0.5, rows[-1] + 0.5
