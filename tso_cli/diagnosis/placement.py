"""Where a cloud falls in a view: what is looked at before any optimisation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import InputError
from ..geometry.arrays import Array, Box
from ..geometry.points import bounds
from ..geometry.view import View
from ..optimisation.problem import Problem

# Bounding boxes of mask and projected cloud with a lower IoU belong to different cameras, units or
# axes.
LEAST_BOX_IOU = 0.05


@dataclass(frozen=True)
class Placement:
    """How a cloud and a mask meet in one view; boxes are in pixels."""

    points: int  # in all
    behind: int  # at or behind the camera
    inside_image: int
    inside_mask: int
    depth: tuple[float, float] | None  # nearest and farthest of the points in front, world units
    points_box: Box | None  # of the projected cloud, clipped to the image; None if invisible
    mask_box: Box  # of the mask's foreground
    box_iou: float  # intersection over union of the two boxes

    @property
    def meets(self) -> bool:
        """Whether cloud and mask overlap."""
        return self.box_iou > LEAST_BOX_IOU


def place(points: Array, view: View) -> Placement:
    """Project ``points`` [N, 3] (world units) into ``view`` and count where they fall."""
    camera = view.camera
    pixels, depth, front = camera.project_visible(points)
    visible = pixels[front]
    columns, rows = np.rint(visible).T
    inside = (columns >= 0) & (rows >= 0) & (columns < camera.width) & (rows < camera.height)
    on_mask = view.mask[rows[inside].astype(int), columns[inside].astype(int)] > 0.5
    mask_box = _as_floats(view.box())
    box, overlap, distances = None, 0.0, None
    if len(visible):
        distances = float(depth[front].min()), float(depth[front].max())
        # Half a pixel around the points: a cloud of one column has a width, as the mask's box has.
        low, high = bounds(visible)
        low = np.maximum(low - 0.5, -0.5)
        high = np.minimum(high + 0.5, [camera.width - 0.5, camera.height - 0.5])
        if (high > low).all():
            box = _as_floats((*low, *high))
            overlap = box_iou(box, mask_box)
    return Placement(
        points=len(points),
        behind=int((~front).sum()),
        inside_image=int(inside.sum()),
        inside_mask=int(on_mask.sum()),
        depth=distances,
        points_box=box,
        mask_box=mask_box,
        box_iou=overlap,
    )


def _as_floats(box: Any) -> Box:
    left, top, right, bottom = (float(edge) for edge in box)
    return left, top, right, bottom


def box_iou(a: Box, b: Box) -> float:
    """Intersection over union of two boxes (left, top, right, bottom)."""
    width = min(a[2], b[2]) - max(a[0], b[0])
    height = min(a[3], b[3]) - max(a[1], b[1])
    common = max(width, 0.0) * max(height, 0.0)
    union = (a[2] - a[0]) * (a[3] - a[1]) + (b[2] - b[0]) * (b[3] - b[1]) - common
    return common / union if union > 0.0 else 0.0


def why_apart(placement: Placement, view: View) -> str | None:
    """Why a cloud and a mask do not meet, in words; None where they meet."""
    if placement.behind == placement.points:
        return f"all {placement.points} points lie behind the camera"
    if not placement.inside_image or placement.points_box is None:
        return f"no point falls inside the {view.camera.width}x{view.camera.height} image"
    if not placement.meets:
        return (
            f"the projected cloud ({describe_box(placement.points_box)}) and the mask "
            f"({describe_box(placement.mask_box)}) hardly meet: IoU of the boxes "
            f"{placement.box_iou:.3f}, expected over {LEAST_BOX_IOU}"
        )
    return None


def require_plane_through(problem: Problem, symmetry: str) -> None:
    """Refuse a plane that ``symmetry`` gives, if the cloud does not meet its flipped views."""
    if problem.symmetry.outcome != "given":
        return
    for windowed in problem.flipped:
        placement = place(problem.cloud.control_points, windowed.view)
        if why := why_apart(placement, windowed.view):
            raise InputError(
                f"symmetry is {symmetry!r}, expected a plane ax + by + cz = d through the cloud; "
                f"as it is, {windowed.view.name}: {why}"
            )


def describe_box(box: Box) -> str:
    """The first and last pixels of a ``box`` in words."""
    left, top = (int(np.floor(edge + 0.5)) for edge in box[:2])
    right, bottom = (int(np.ceil(edge - 0.5)) for edge in box[2:])
    return f"columns {left} to {right}, rows {top} to {bottom}"
