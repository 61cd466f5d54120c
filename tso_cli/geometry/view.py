"""A view: a mask of the object, its camera, and what else one picture says of the object."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .arrays import Array, Bits, Box, Floats, Indices, as_numbers
from .camera import Camera
from .depth_kind import FITTED, DepthKind

# How exactly a mask shows where its outline is, in pixels: that of a mask with pixels of 0 and 1.
OUTLINE_ERROR = 0.5
# That of a mask that shows an object with so few pixels along its longer side, or fewer: its pixels
# come from another grid, and are on or off by a rule of their own. With more it falls as 1 / side.
COARSE_ERROR, COARSE_SIDE = 0.75, 24.0
# A mask whose outline is less exact than this share of the object's longer side shows no shape.
LARGEST_ERROR = 0.25
# The shortest step of an outline shows whether a smaller mask was enlarged, where the outline has
# this number of steps along both axes.
FEWEST_STEPS = 8
# In units of the camera. Sums of squares of larger depths lose precision or overflow.
LARGEST_DEPTH = 1e15


class Speck:
    """A connected part of the foreground that does not belong to the object.

    An example is a false detection of the program that made the mask.
    """

    SHARE = 0.01  # the largest share of the foreground that all specks together have
    DISTANCE = 0.25  # least distance of a speck from the object, in units of the object's size


@dataclass(frozen=True, eq=False)
class View:
    """A mask and the camera that saw it.

    mask : [H, W] in [0, 1], inside 1; foreground is > 0.5. Soft values are kept. It may be given as
        `as_mask` takes it.
    known : [H, W], False where the mask says nothing; None if every pixel counts.
    name : what messages call the view, usually the file of the mask.
    depth : [H, W] of the surface along the camera's z axis, in the units of the camera's t, or
        what ``depth_kind`` says. 0 and values that are not finite are unknown. Only the depth of
        foreground pixels counts.
    image : [H, W, 3] red, green, blue in [0, 1], the photo that was masked; for clouds with
        colours.
    depth_kind : what the depth map holds (`DepthKind`).
    mask_error : how exactly the mask shows where its outline is, a standard deviation in pixels;
        None if it is not known (`outline_error`).
    depth_fitted : whether the depth map was brought to the unit of the cloud by a fit to a cloud.

    Raises InputError if a size, a value or the camera does not fit, or if the mask is all
    foreground or all background.
    """

    mask: Floats
    camera: Camera
    known: Bits | None = None
    name: str = "mask"
    depth: Array | None = None
    image: Floats | None = None
    depth_kind: DepthKind = "auto"
    mask_error: float | None = None
    depth_fitted: bool = False

    def __post_init__(self) -> None:
        mask = as_mask(self.mask, self.name)
        if mask.ndim != 2 or mask.size == 0:
            raise InputError(f"{self.name}: mask has shape {list(mask.shape)}, expected [H, W]")
        if not isinstance(self.camera, Camera):
            type_name = type(self.camera).__name__
            raise InputError(f"{self.name}: its camera is of type {type_name}, expected a Camera")
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
        if self.depth_kind not in get_args(DepthKind):
            raise InputError(
                f"{self.name}: the kind of its depth map is {self.depth_kind!r}, expected one of "
                f"{', '.join(get_args(DepthKind))}"
            )
        if self.mask_error is not None and not 0.0 < self.mask_error < np.inf:
            raise InputError(
                f"{self.name}: the error of the mask is {self.mask_error!r}, expected pixels over 0"
            )
        if self.depth is not None:
            object.__setattr__(self, "depth", self._checked_depth(self.depth))
        if self.image is not None:
            object.__setattr__(self, "image", self._checked_image(self.image))
        counted = mask
        if self.known is not None:
            known = as_numbers(self.known, f"{self.name}: the ignore map", bool)
            self._require_shape("ignore map", known, list(mask.shape))
            object.__setattr__(self, "known", known)
            counted = mask[known]
        self._require_both_sides(counted)
        self._require_small_error()

    def _require_small_error(self) -> None:
        """InputError if the mask says nothing of the object, by the error that was given."""
        if self.mask_error is None:
            return
        left, top, right, bottom = self.pixels_of_object
        longer = max(right - left, bottom - top)
        if self.mask_error > LARGEST_ERROR * longer:
            raise InputError(
                f"{self.name}: the error of the mask is {self.mask_error:g} px, and the object is "
                f"{longer} px long, expected at most {LARGEST_ERROR * longer:g} px, a quarter"
            )

    def _require_both_sides(self, counted: Floats) -> None:
        """InputError unless some of the ``counted`` pixels are foreground, and some are not."""
        inside = int((counted > 0.5).sum())
        of_ignore_map = "" if counted.size == self.mask.size else " that the ignore map leaves"
        if inside == 0:
            of_ignore_map = of_ignore_map if (self.mask > 0.5).any() else ""
            raise InputError(
                f"{self.name}: no pixel{of_ignore_map} is foreground: the largest value is "
                f"{counted.max(initial=0.0):.3g} of 1, expected some over 0.5"
            )
        if inside == counted.size:
            advice = "" if of_ignore_map else " (`invert_mask`?)"
            raise InputError(
                f"{self.name}: every pixel{of_ignore_map} is foreground, expected some "
                f"background{advice}"
            )

    def _checked_depth(self, depth: Array) -> Array:
        """A copy of the depth map, NaN where the depth is unknown."""
        depth = as_numbers(depth, f"{self.name}: the depth map").copy()
        self._require_shape("depth map", depth, list(self.mask.shape))
        if self.camera.model != "perspective":
            raise InputError(
                f"{self.name}: its camera is {self.camera.model}, "
                "expected perspective for a depth map"
            )
        depth[~np.isfinite(depth) | (depth == 0.0)] = np.nan
        if np.nanmin(depth, initial=np.inf) < 0.0 and self.depth_kind not in FITTED:
            raise InputError(
                f"{self.name}: the smallest depth is {np.nanmin(depth):g}, "
                "expected 0 (unknown) or more, or another `depth_kind`"
            )
        if np.nanmax(np.abs(depth), initial=0.0) > LARGEST_DEPTH:
            raise InputError(
                f"{self.name}: the largest depth is {np.nanmax(np.abs(depth)):g}, "
                f"expected at most {LARGEST_DEPTH:g}"
            )
        known = np.isfinite(depth) & (self.mask > 0.5)
        if not (known if self.known is None else known & self.known).any():
            raise InputError(f"{self.name}: no foreground pixel has a depth, expected some")
        return depth

    def _checked_image(self, image: Floats) -> Floats:
        image = as_numbers(image, f"{self.name}: the image", np.float32)
        self._require_shape("image", image, [*self.mask.shape, 3])
        low, high = image.min(), image.max()
        # This form of the condition refuses NaN too.
        if not (low >= 0.0 and high <= 1.0):
            raise InputError(
                f"{self.name}: the image's values span {low:g} to {high:g}, expected 0 to 1"
            )
        return image

    def _require_shape(self, what: str, array: NDArray[np.generic], shape: list[int]) -> None:
        if list(array.shape) != shape:
            size = f"{self.camera.width}x{self.camera.height}"
            raise InputError(
                f"{self.name}: the {what} has shape {list(array.shape)}, the mask is {size}, "
                f"expected {shape}"
            )

    def before_placed(self, R: Array, t: Array, size: float) -> View:
        """The view that sees ``X`` exactly where this one sees ``size * R X + t``."""
        depth = None if self.depth is None else self.depth / size
        return replace(self, camera=self.camera.before_placed(R, t, size), depth=depth)

    @cached_property
    def inside(self) -> Bits:
        """[H, W], the pixels that are known to be foreground."""
        inside: Bits = self.mask > 0.5
        return inside if self.known is None else inside & self.known

    @cached_property
    def pixels_of_object(self) -> tuple[int, int, int, int]:
        """Left, top, right and bottom of the object, right and bottom exclusive."""
        return object_box(self.inside)

    @cached_property
    def outline_error(self) -> float:
        """How exactly the mask shows where its outline is, a standard deviation in pixels.

        A blurred mask is less exact than its pixels, and a coarse mask too. So is a small mask that
        was enlarged: its pixels are squares. The steepest quarter of the outline shows the blur,
        since a pixel that the outline crosses makes a sharp mask less steep too.
        """
        if self.mask_error is not None:
            return self.mask_error
        steps, gaps = [], []
        left, top, right, bottom = self.pixels_of_object
        part = self.mask[max(top - 1, 0) : bottom + 1, max(left - 1, 0) : right + 1]
        for values in (part, part.T):
            across = (values[1:] > 0.5) != (values[:-1] > 0.5)
            steps.append(np.abs(values[1:][across] - values[:-1][across]))
            crossed = np.diff(np.flatnonzero(across.any(1)))
            gaps.append(int(crossed.min()) if len(crossed) >= FEWEST_STEPS else 1)
        steepest = np.quantile(np.concatenate([*steps, [1.0]]), 0.75)
        # The slope of a step after a Gaussian blur.
        of_blur = float(1.0 / (np.sqrt(2.0 * np.pi) * steepest))
        pixel = min(gaps)
        of_grid = COARSE_ERROR * min(1.0, COARSE_SIDE * pixel / max(right - left, bottom - top))
        return max(OUTLINE_ERROR * pixel, of_blur, of_grid * pixel)

    @property
    def truncated(self) -> bool:
        """Whether the object touches the border of the image, and so may extend beyond it."""
        left, top, right, bottom = self.pixels_of_object
        height, width = self.mask.shape
        return left == 0 or top == 0 or right == width or bottom == height

    def box(self) -> Box:
        """The edges of the object in pixel coordinates; specks do not belong to the object."""
        left, top, right, bottom = self.pixels_of_object
        return left - 0.5, top - 0.5, right - 0.5, bottom - 0.5

    @property
    def specks(self) -> int:
        """How many foreground pixels lie outside the object's box."""
        left, top, right, bottom = self.pixels_of_object
        return int(self.inside.sum()) - int(self.inside[top:bottom, left:right].sum())


def as_mask(values: Any, name: str) -> Floats:
    """An array or tensor [H, W] or [H, W, 1], or a picture of Pillow, as float32 [H, W].

    Whole numbers up to 255 are divided by 255. A picture with an alpha channel is a mask by it.
    Raises InputError, which begins with ``name``, for what holds no numbers.
    """
    if hasattr(values, "getbands"):
        values = values.getchannel("A") if "A" in values.getbands() else values
        values = np.asarray(values)
    mask: Floats = as_numbers(values, f"{name}: the mask", np.float32)
    if mask.ndim == 3 and mask.shape[2] == 1:
        mask = mask[..., 0]
    # Labels are smaller, and are refused.
    if 127.0 < mask.max(initial=0.0) <= 255.0 and (mask == np.rint(mask)).all():
        mask = mask / np.float32(255.0)
    return mask


def object_box(inside: Bits) -> tuple[int, int, int, int]:
    """Left, top, right and bottom of the object in ``inside`` [H, W], right and bottom exclusive.

    The object is the foreground without specks (`Speck`). If all specks together have too large a
    share of the foreground, they belong to the object.
    """
    counts = inside.sum(0), inside.sum(1)
    limit = Speck.SHARE * int(counts[0].sum())
    low, high = np.array([np.flatnonzero(count)[[0, -1]] for count in counts]).T + [[0], [1]]
    # The box that leaves out at most ``limit`` pixels on each side. In most masks it is close to
    # the box of the whole foreground: then there is no speck, and no need to find connected parts.
    bulk_low = np.array([np.searchsorted(np.cumsum(count), limit, "right") for count in counts])
    bulk_high = np.array(
        [len(count) - np.searchsorted(np.cumsum(count[::-1]), limit, "right") for count in counts]
    )
    away = Speck.DISTANCE * (bulk_high - bulk_low).max()
    if (low < bulk_low - away).any() or (high > bulk_high + away).any():
        low, high = _box_without_specks(inside, limit) or (low, high)
    (left, top), (right, bottom) = low.tolist(), high.tolist()
    return left, top, right, bottom


def _box_without_specks(inside: Bits, limit: float) -> tuple[Indices, Indices] | None:
    """First column and row of the object, and those behind its last; None if there are no specks.

    ``limit`` is the most pixels that all specks may have together.
    """
    from scipy.ndimage import find_objects, label

    parts, _ = label(inside, np.ones((3, 3)))
    sizes = np.bincount(parts.ravel())[1:]
    slices = find_objects(parts)
    low = np.array([[columns.start, rows.start] for rows, columns in slices])
    high = np.array([[columns.stop, rows.stop] for rows, columns in slices])
    large = sizes > limit
    if not large.any():
        return None
    first, last = low[large].min(0), high[large].max(0)
    away = Speck.DISTANCE * (last - first).max()
    speck = ~large & ((low < first - away) | (high > last + away)).any(1)
    if sizes[speck].sum() > limit:
        return None
    return low[~speck].min(0), high[~speck].max(0)


class Grey:
    """A mask with more grey than a soft outline has: pixels whose neighbours are grey too."""

    LEAST_RATIO = 1.05  # of the object or of the background, whichever is smaller
    VALUES = (0.1, 0.9)
    ROWS = 256  # rows or columns that are counted, about
    FEWEST_PIXELS = 400  # of the smaller of object and background


def is_grey_inside(mask: Floats, inside: Bits, known: Bits) -> bool:
    """Whether a mask [H, W] is grey over more than what it shows, as a photo is."""
    step = max(1, min(mask.shape) // Grey.ROWS)
    thinned = slice(None, None, step), slice(None, None, step)
    values, foreground, counted = mask[thinned], inside[thinned], known[thinned]
    smaller = min(np.count_nonzero(foreground), np.count_nonzero(counted & ~foreground))
    grey: Bits = (values > Grey.VALUES[0]) & (values < Grey.VALUES[1]) & counted
    # Every pixel of a thin part is at the outline, and has light or dark neighbours.
    middle = grey[1:-1, 1:-1]
    grey = middle & grey[2:, 1:-1] & grey[:-2, 1:-1] & grey[1:-1, 2:] & grey[1:-1, :-2]
    return bool(
        smaller >= Grey.FEWEST_PIXELS and np.count_nonzero(grey) > Grey.LEAST_RATIO * smaller
    )
