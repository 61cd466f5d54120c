"""Where a cloud falls in a view: the check before any optimisation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.camera import NEAR
from ..geometry.points import bounds, longest_side
from ..geometry.view import View

# Boxes of mask and projected cloud with a lower IoU belong to different cameras, units or axes.
SMALLEST_BOX_IOU = 0.05
# Where they hardly meet, the cloud may belong to one part of the mask whose box has so much with its own.
PART_BOX_IOU = 0.3
# Of the parts with most pixels in the cloud's box.
MOST_PARTS = 4
# A mask with fewer foreground pixels is coarse; so is one with fewer along its longer side, if its pixels are wider than the
# spacing of the projected points.
FEWEST_PIXELS, FEWEST_ACROSS = 16, 16

Array = NDArray[np.float64]
Box = tuple[float, float, float, float]


@dataclass(frozen=True)
class Placement:
    """How a cloud and a mask meet in one view; boxes are left, top, right, bottom edges in pixels."""

    points: int  # in all
    behind: int  # at or behind the camera
    inside_image: int
    inside_mask: int
    depth: tuple[float, float] | None  # nearest and farthest of the points in front, world units
    points_box: Box | None  # of the projected cloud, clipped to the image; None if invisible
    mask_box: Box  # of the mask's foreground
    box_iou: float  # intersection over union of the two


def place(points: Array, view: View) -> Placement:
    """Project ``points`` [N, 3] (world units) into ``view`` and count where they fall."""
    camera = view.camera
    pixels, depth = camera.project(points)
    front = np.isfinite(pixels).all(1)
    if camera.model == "perspective":
        front &= depth > NEAR * longest_side(points)
    seen = pixels[front]
    columns, rows = np.rint(seen).T
    inside = (columns >= 0) & (rows >= 0) & (columns < camera.width) & (rows < camera.height)
    on_mask = view.mask[rows[inside].astype(int), columns[inside].astype(int)] > 0.5
    mask_box = _plain(view.box())
    box, overlap = None, 0.0
    if len(seen):
        # Half a pixel around the points: a cloud of one column still has a width, as the mask's box does.
        low, high = bounds(seen)
        low = np.maximum(low - 0.5, -0.5)
        high = np.minimum(high + 0.5, [camera.width - 0.5, camera.height - 0.5])
        if (high > low).all():
            box = _plain((*low, *high))
            overlap = box_iou(box, mask_box)
    distances = (float(depth[front].min()), float(depth[front].max())) if len(seen) else None
    return Placement(
        len(points),
        int((~front).sum()),
        int(inside.sum()),
        int(on_mask.sum()),
        distances,
        box,
        mask_box,
        overlap,
    )


def mask_doubts(view: View, points: int) -> list[str]:
    """Warnings for a cloud of so many ``points``: that the mask is coarse, or that specks are ignored."""
    doubts = [coarse] if (coarse := _coarse(view, points)) else []
    if view.specks:
        doubts.append(f"{view.name}: foreground far from the object is left out ({view.specks} px)")
    return doubts


def _coarse(view: View, points: int) -> str | None:
    pixels = int(view.inside.sum())
    left, top, right, bottom = view.box()
    side = round(max(right - left, bottom - top))
    # Front and back of the surface both project: with over two points per pixel their spacing is below a pixel.
    if pixels >= FEWEST_PIXELS and (side >= FEWEST_ACROSS or points <= 2 * pixels):
        return None
    if side == 1:
        return f"{view.name}: shows the object with a single pixel, which tells where it is and nothing of its shape"
    return f"{view.name}: shows the object with only {pixels} pixels: details smaller than 1/{side} of its size cannot be seen"


def _plain(box: Any) -> Box:
    left, top, right, bottom = (float(edge) for edge in box)
    return left, top, right, bottom


def box_iou(a: Box, b: Box) -> float:
    """Intersection over union of two boxes (left, top, right, bottom)."""
    width = min(a[2], b[2]) - max(a[0], b[0])
    height = min(a[3], b[3]) - max(a[1], b[1])
    common = max(width, 0.0) * max(height, 0.0)
    union = (a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - common
    return common / union if union > 0.0 else 0.0


def behind_warnings(placement: Placement, view: View) -> list[str]:
    """The warning of points behind the camera; empty without any, or where all are."""
    if not 0 < placement.behind < placement.points:
        return []
    return [
        f"{view.name}: {placement.behind} of {placement.points} points lie behind the camera and take no part"
    ]


def require_overlap(placement: Placement, view: View, advice: str | None = None) -> None:
    """Raise InputError with ``advice`` for a cloud and a mask that do not meet."""
    general = (
        "check the camera's axes (OpenCV: x right, y down, z forward; X_camera = R X_world + t) and units, "
        "or look at the numbers with --check"
    )
    if placement.behind == placement.points:
        raise InputError(
            f"{view.name}: all {placement.points} points lie behind the camera; {advice or general}"
        )
    if not placement.inside_image or placement.points_box is None:
        size = f"{view.camera.width}x{view.camera.height}"
        raise InputError(
            f"{view.name}: no point falls inside the {size} image; {advice or general}"
        )
    if placement.box_iou <= SMALLEST_BOX_IOU:
        advice = advice or _part_met(placement.points_box, view.inside) or general
        raise InputError(
            f"{view.name}: the projected cloud ({describe_box(placement.points_box)}) and the mask "
            f"({describe_box(placement.mask_box)}) hardly meet: IoU of the boxes {placement.box_iou:.3f}, expected over "
            f"{SMALLEST_BOX_IOU}; {advice}"
        )


def _part_met(points_box: Box, inside: NDArray[np.bool_]) -> str | None:
    """Advice where the cloud meets a connected part of the mask well, None where it meets none."""
    from scipy.ndimage import label

    parts = label(inside, np.ones((3, 3)))[0]
    left, top, right, bottom = np.ceil(points_box).astype(int)
    counts = np.bincount(parts[top:bottom, left:right].ravel(), minlength=2)
    counts[0] = 0
    # Of a mask of dots there are millions.
    most = [part for part in np.argsort(-counts, kind="stable")[:MOST_PARTS] if counts[part]]
    if not most:
        return None
    places = [np.nonzero(parts == part) for part in most]
    boxes = [
        _plain((x.min() - 0.5, y.min() - 0.5, x.max() + 0.5, y.max() + 0.5)) for y, x in places
    ]
    best = max(boxes, key=lambda box: box_iou(points_box, box))
    if box_iou(points_box, best) < PART_BOX_IOU:
        return None
    part = describe_box(best)
    return f"it meets a part of the mask ({part}): is the rest something else? Erase it, or leave it out by --ignore FILE"


def describe_box(box: Box) -> str:
    """``box`` in words, rounded to whole pixels."""
    left, top, right, bottom = (round(edge) for edge in box)
    return f"columns {left} to {right}, rows {top} to {bottom}"
