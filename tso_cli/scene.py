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
    depth : [H, W] how far the surface lies along the camera's z, in the units of its t; 0 and what is not finite are
        unknown. It says something of foreground pixels alone. None: there is no depth map.
    name : what messages call it, usually the file.
    image : [H, W, 3] red, green, blue in [0, 1], the photo that the mask is of. It says something to clouds that have colours.
    """

    mask: NDArray[np.float32]
    camera: Camera
    known: NDArray[np.bool_] | None = None
    name: str = "mask"
    depth: NDArray[np.float64] | None = None
    image: NDArray[np.float32] | None = None

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
        if self.depth is not None:
            object.__setattr__(self, "depth", self._checked_depth(self.depth))
        if self.image is not None:
            object.__setattr__(self, "image", self._checked_image(self.image))
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

    def _checked_depth(self, given: NDArray[np.float64]) -> NDArray[np.float64]:
        """The depth map, NaN where nothing is known."""
        depth: NDArray[np.float64] = np.array(given, dtype=np.float64)
        if depth.shape != self.mask.shape:
            height, width = self.mask.shape
            raise InputError(
                f"{self.name}: the depth map has shape {list(depth.shape)}, the mask is {width}x{height}, "
                f"expected [{height}, {width}]"
            )
        if self.camera.model != "perspective":
            raise InputError(f"{self.name}: its camera is {self.camera.model}, expected perspective for a depth map")
        depth[~np.isfinite(depth) | (depth == 0.0)] = np.nan
        if np.nanmin(depth, initial=np.inf) < 0.0:
            raise InputError(f"{self.name}: the smallest depth is {np.nanmin(depth):g}, expected 0 (unknown) or more")
        known = np.isfinite(depth) & (self.mask > 0.5)
        if not (known if self.known is None else known & self.known).any():
            raise InputError(f"{self.name}: no foreground pixel has a depth, expected some > 0")
        return depth

    def _checked_image(self, given: NDArray[np.float32]) -> NDArray[np.float32]:
        image: NDArray[np.float32] = np.asarray(given, dtype=np.float32)
        if image.shape != (*self.mask.shape, 3):
            height, width = self.mask.shape
            raise InputError(
                f"{self.name}: the image has shape {list(image.shape)}, the mask is {width}x{height}, "
                f"expected [{height}, {width}, 3]"
            )
        # NaN is not between 0 and 1 either.
        if not (image.min() >= 0.0 and image.max() <= 1.0):
            raise InputError(f"{self.name}: the image's values span {image.min():g} to {image.max():g}, expected 0 to 1")
        return image

    def box(self) -> tuple[float, float, float, float]:
        """Left, top, right, bottom edges of the foreground in pixel coordinates."""
        inside = self.mask > 0.5
        if self.known is not None:
            inside &= self.known
        rows, columns = np.flatnonzero(inside.any(1)), np.flatnonzero(inside.any(0))
        return columns[0] - 0.5, rows[0] - 0.5, columns[-1] + 0.5, rows[-1] + 0.5
