"""A view: what one picture says of an object."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .camera import Camera

# A speck has at most this part of the foreground, and lies at least so far beside the object, in units of the object's size.
SPECK, BESIDE = 0.01, 0.25

# A mask looks like a photo if it has so many grey pixels with grey neighbours for each pixel of the object or of the
# background, whichever is smaller. Counted in about so many rows or columns, and not where that is smaller than so many pixels.
GREY_SHARE, GREY_ALONG, GREY_FEWEST = 1.05, 256, 400


@dataclass(frozen=True, eq=False)
class View:
    """A mask and the camera that saw it.

    mask : [H, W] in [0, 1], inside 1; foreground is > 0.5. Soft values are kept.
    known : [H, W], False where the mask says nothing, or None when every pixel counts.
    name : what messages call it, usually the file.
    depth : [H, W] of the surface along the camera's z axis, in the units of its t; 0 and what is not finite are unknown. It
        counts for foreground pixels alone.
    image : [H, W, 3] red, green, blue in [0, 1], the photo that the mask is of, for clouds with colours.
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
            raise InputError(
                f"{self.name}: mask values span {mask.min():g} to {mask.max():g}, expected 0 to 1"
            )
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
                raise InputError(
                    f"{self.name}: the ignore map is {known.shape[1]}x{known.shape[0]}, the mask {width}x{height}"
                )
            object.__setattr__(self, "known", known)
            counted = mask[known]
        inside = int((counted > 0.5).sum())
        if inside == 0:
            ignored = ", but for those that the ignore map leaves out" if (mask > 0.5).any() else ""
            most = f"the largest value is {counted.max(initial=0.0):.3g} of 1"
            raise InputError(
                f"{self.name}: no pixel is foreground{ignored}: {most}, expected some over 0.5"
            )
        if inside == counted.size:
            left, advice = (
                ("", " (try --invert-mask?)")
                if inside == mask.size
                else (" that the ignore map leaves", "")
            )
            raise InputError(
                f"{self.name}: every pixel{left} is foreground, expected some background{advice}"
            )

    def _checked_depth(self, depth: NDArray[np.float64]) -> NDArray[np.float64]:
        """A copy of the depth map, NaN where nothing is known."""
        depth = np.array(depth, dtype=np.float64)
        self._require_shape("depth map", depth, list(self.mask.shape))
        if self.camera.model != "perspective":
            raise InputError(
                f"{self.name}: its camera is {self.camera.model}, expected perspective for a depth map"
            )
        depth[~np.isfinite(depth) | (depth == 0.0)] = np.nan
        if np.nanmin(depth, initial=np.inf) < 0.0:
            raise InputError(
                f"{self.name}: the smallest depth is {np.nanmin(depth):g}, expected 0 (unknown) or more"
            )
        known = np.isfinite(depth) & (self.mask > 0.5)
        if not (known if self.known is None else known & self.known).any():
            raise InputError(f"{self.name}: no foreground pixel has a depth, expected some > 0")
        return depth

    def _checked_image(self, image: NDArray[np.float32]) -> NDArray[np.float32]:
        image = np.asarray(image, dtype=np.float32)
        self._require_shape("image", image, [*self.mask.shape, 3])
        # NaN is not between 0 and 1 either.
        if not (image.min() >= 0.0 and image.max() <= 1.0):
            raise InputError(
                f"{self.name}: the image's values span {image.min():g} to {image.max():g}, expected 0 to 1"
            )
        return image

    def _require_shape(self, what: str, array: NDArray[np.generic], shape: list[int]) -> None:
        if list(array.shape) != shape:
            size = f"{self.camera.width}x{self.camera.height}"
            raise InputError(
                f"{self.name}: the {what} has shape {list(array.shape)}, the mask is {size}, expected {shape}"
            )

    @cached_property
    def inside(self) -> NDArray[np.bool_]:
        """[H, W], pixels known to be foreground."""
        inside: NDArray[np.bool_] = self.mask > 0.5
        return inside if self.known is None else inside & self.known

    @cached_property
    def _object(self) -> tuple[int, int, int, int]:
        return object_box(self.inside)

    @property
    def truncated(self) -> bool:
        """Whether the object touches the border of the image, and may extend beyond it."""
        left, top, right, bottom = self._object
        height, width = self.mask.shape
        return left == 0 or top == 0 or right == width or bottom == height

    @property
    def like_photo(self) -> bool:
        """Whether the mask is grey over more than what it shows: a soft mask is grey along the outline alone."""
        step = max(1, min(self.mask.shape) // GREY_ALONG)
        some, inside = self.mask[::step, ::step], self.inside[::step, ::step]
        known = np.ones(some.shape, bool) if self.known is None else self.known[::step, ::step]
        smaller = min(np.count_nonzero(inside), np.count_nonzero(known & ~inside))
        grey = (some > 0.1) & (some < 0.9) & known
        # Thin parts, of which every pixel is at the outline, have light or dark neighbours.
        grey = (
            grey[1:-1, 1:-1] & grey[2:, 1:-1] & grey[:-2, 1:-1] & grey[1:-1, 2:] & grey[1:-1, :-2]
        )
        return bool(smaller >= GREY_FEWEST and np.count_nonzero(grey) > GREY_SHARE * smaller)

    def box(self) -> tuple[float, float, float, float]:
        """Left, top, right, bottom edges of the object in pixel coordinates: of the foreground, but for specks far off."""
        left, top, right, bottom = self._object
        return left - 0.5, top - 0.5, right - 0.5, bottom - 0.5

    @property
    def specks(self) -> int:
        """How many foreground pixels lie outside the object's box."""
        left, top, right, bottom = self._object
        return int(self.inside.sum()) - int(self.inside[top:bottom, left:right].sum())


def object_box(inside: NDArray[np.bool_]) -> tuple[int, int, int, int]:
    """First column and row of the object in ``inside`` [H, W], and those behind its last, without specks far off.

    A speck is a connected part of at most 1 % of the foreground, more than a quarter of the object's size beside it. Specks
    are left out if together they are at most 1 % too.
    """
    counts = inside.sum(0), inside.sum(1)
    limit = SPECK * int(counts[0].sum())
    low, high = np.array([np.flatnonzero(count)[[0, -1]] for count in counts]).T + np.array(
        [[0], [1]]
    )
    # A box that leaves out at most the limit at each of its sides: often it shows that no speck is far off.
    bulk_low = np.array([np.searchsorted(np.cumsum(count), limit, "right") for count in counts])
    bulk_high = np.array(
        [len(count) - np.searchsorted(np.cumsum(count[::-1]), limit, "right") for count in counts]
    )
    beside = BESIDE * (bulk_high - bulk_low).max()
    if (low < bulk_low - beside).any() or (high > bulk_high + beside).any():
        from scipy.ndimage import find_objects, label

        parts, _ = label(inside, np.ones((3, 3)))
        sizes = np.bincount(parts.ravel())[1:]
        boxes = np.array(
            [
                [across.start, down.start, across.stop, down.stop]
                for down, across in find_objects(parts)
            ]
        )
        large = sizes > limit
        if large.any():
            first, last = boxes[large, :2].min(0), boxes[large, 2:].max(0)
            beside = BESIDE * (last - first).max()
            far = ~large & ((boxes[:, :2] < first - beside) | (boxes[:, 2:] > last + beside)).any(1)
            if sizes[far].sum() <= limit:
                low, high = boxes[~far, :2].min(0), boxes[~far, 2:].max(0)
    (left, top), (right, bottom) = low.tolist(), high.tolist()
    return left, top, right, bottom
