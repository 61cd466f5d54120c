"""Points that most masks leave out: the ground that an object stands on, floaters, other objects.

A cloud of another shape or in another place is outside of its masks too. So points are no part of
the object only where the others fit the masks as a right cloud does, and all of them do not in
other proportions; or where they are a plane that reaches beyond the object, with all below it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..evaluation.footprint import Solid, window_iou
from ..geometry.arrays import Array, Bits
from ..geometry.points import bounding_box_normalisation, longest_side, quantile, scattered
from ..geometry.view import View
from ..pose.causes import SIMILAR, missed_if_stretched
from ..pose.move import FITS, FITS_NEARLY, Body
from ..pose.placing import MOST_VIEWS, missed_by
from ..pose.search import SIDE, some_views
from ..pose.target import Target

# A mask leaves out a point at this distance from the nearest cell of the object, in cells or in
# pixels, whichever are larger. Exact clouds then lose no point.
APART = 1.5
# Half of the points that are left out are at least so far away: of a cloud before a camera that is
# slightly wrong, points along the whole edge are left out.
FAR = 4.0
# A smaller share of the points is none: thin parts of exact clouds are missing from coarse masks.
LEAST_SHARE = 0.005
# Points by which is decided, and points that are left out by which a plane is searched.
DECIDING, OF_PLANE = 4096, 1024
# Views whose overlap is compared; each takes milliseconds.
OVERLAPPING_VIEWS = 4


class Ground:
    """A plane that an object stands on."""

    TRIES = 200  # planes through three points
    HALF_THICKNESS = 0.015  # of the plane's points, in longest sides of what masks do not leave out
    # The least share of the points on it or below that masks leave out, and that lie beyond the
    # object's box. Grounds of 1.5 object widths have 0.36; clouds of another shape at most 0.1.
    LEAST_BEYOND = 0.4
    MOST_BELOW = 0.08  # the largest share of the points on masks that lie below the plane
    # By how much the IoU with the masks rises without the ground: by 0.13 and more for exact clouds
    # on a ground of 1.5 object widths, and by at most 0.1 for clouds of another shape or place.
    LEAST_GAIN = 0.1
    TAIL = 0.005  # the share of points that does not widen the object's box, on each side


@dataclass(frozen=True, eq=False)
class Plane:
    """The top of a ground.

    axes : [3, 3], two along the plane, and its normal. height : along the normal.
    low, high : [2], along the plane, the box of what is above. base : whether points on the plane
        within that box are of the object, as the base of a sofa.
    """

    axes: Array
    height: float
    low: Array
    high: Array
    thickness: float
    base: bool = False

    def holds(self, points: Array) -> Bits:
        """[N], which of ``points`` [N, 3] are the ground."""
        along = points @ self.axes.T
        over = along[:, 2] - self.height
        below = np.asarray(over < 0.0)
        if self.base:
            beyond = (along[:, :2] < self.low) | (along[:, :2] > self.high)
            below &= beyond.any(1) | (over < -self.thickness)
        return below


@dataclass(frozen=True, eq=False)
class LeftOut:
    """What is not the object.

    targets : of masks that leave points out; () if only the ground is no part of the object.
    ground : below its top nothing is the object, apart from what the object stands on.
    """

    targets: tuple[Target, ...]
    ground: Plane | None

    def holds(self, points: Array) -> Bits:
        """[N], which of ``points`` [N, 3] are not the object."""
        holds = _left_out(points, self.targets)
        if self.ground is not None:
            holds |= self.ground.holds(points)
        return holds


def find_left_out(points: Array, views: Sequence[View]) -> LeftOut | None:
    """What of a cloud of ``points`` [N, 3] is not the object; None if all of it may be."""
    points = scattered(points, DECIDING)
    few_views = some_views(views, MOST_VIEWS)
    targets = tuple(Target.of(view, SIDE) for view in few_views)
    outside = _left_out(points, targets)
    if not LEAST_SHARE <= outside.mean() < 1.0:
        return None
    ground = _ground(points, outside)
    if ground is not None:
        above = points[~ground.holds(points)]
        if _overlap(above, views) < _overlap(points, views) + Ground.LEAST_GAIN:
            ground = None
        else:
            with_base = replace(ground, base=True)
            rest = points[~(with_base.holds(points) | outside)]
            if _missed(rest, few_views) < min(FITS_NEARLY, _missed(above, few_views)):
                ground = with_base
    rest = points[~(outside if ground is None else outside | ground.holds(points))]
    far = 2 * _left_out(points, targets, FAR).sum() >= outside.sum()
    if (
        far
        and longest_side(rest) > 0.0
        and (missed := _missed(rest, few_views)) < FITS
        # A longer object is outside of the masks too.
        and missed < missed_if_stretched(_body(points), few_views) - SIMILAR
    ):
        return LeftOut(targets, ground)
    return None if ground is None else LeftOut((), ground)


def _left_out(points: Array, targets: Sequence[Target], least: float = APART) -> Bits:
    """[N], which ``points`` [N, 3] half of the masks leave out, or more, of those that see them.

    Such a point is farther from the mask than ``least``, in cells or pixels.
    """
    views_of_point, without = np.zeros((2, len(points)), np.int64)
    for target in targets:
        px, _, visible = target.camera.project_visible(points)
        px = np.where(visible[:, None], px, 0.0)
        row, column, within = target.at(px)
        in_view = visible & np.where(within, target.known[row, column], not target.truncated)
        apart = np.linalg.norm(target.nearest[row, column] - px, axis=1)
        outside = apart > least * max(1.0, target.pixel)
        views_of_point += in_view
        without += in_view & outside
    return np.asarray(2 * without >= np.maximum(views_of_point, 1))


def _missed(points: Array, views: Sequence[View]) -> float:
    return missed_by(_body(points), views)[0]


def _body(points: Array) -> Body:
    return Body(points, *bounding_box_normalisation(points))


def _overlap(points: Array, views: Sequence[View]) -> float:
    few_views = some_views(views, OVERLAPPING_VIEWS)
    return float(np.mean([window_iou(Solid(points), view) for view in few_views]))


def _ground(points: Array, left_out: Bits) -> Plane | None:
    """The ground, of ``points`` [N, 3] that are ``left_out`` [N]."""
    body = points[~left_out]
    low, high = (quantile(body, share) for share in (Ground.TAIL, 1.0 - Ground.TAIL))
    size = float((high - low).max())
    half = Ground.HALF_THICKNESS * size
    middle = body.mean(0)
    outside, inside = (scattered(part, OF_PLANE) - middle for part in (points[left_out], body))
    first, second, third = outside[
        np.random.default_rng(0).integers(0, len(outside), (3, Ground.TRIES))
    ]
    normals = np.cross(second - first, third - first)
    lengths = np.linalg.norm(normals, axis=1)
    real = lengths > (half * size)
    if not real.any():
        return None
    normals = normals[real] / lengths[real, None]
    heights = (first[real] * normals).sum(1)
    # Upwards, to where the object is.
    upwards = np.where(heights <= 0.0, 1.0, -1.0)
    normals, heights = normals * upwards[:, None], heights * upwards
    over = outside @ normals.T - heights
    on = (np.abs(over) < half).sum(0)
    beneath = (over < half).sum(0) - (inside @ normals.T - heights < -half).sum(0)
    best = np.where(2 * on >= on.max(), beneath, -len(points)).argmax()
    sheet = outside[np.abs(over[:, best]) < half]
    if len(sheet) < 3:
        return None
    axes = np.linalg.svd(sheet - sheet.mean(0), full_matrices=False)[2]
    normal = axes[2] * (1.0 if axes[2] @ normals[best] > 0.0 else -1.0)
    height = float(sheet.mean(0) @ normal)
    if (inside @ normal - height < -half).mean() > Ground.MOST_BELOW:
        return None
    height = float(height + middle @ normal + half)
    over_top = points @ normal - height
    below = over_top < 0.0
    # A chunk of another object is no ground.
    if below.all() or 2 * np.count_nonzero(over_top[below] < -2.0 * half) > below.sum():
        return None
    # In the plane, what is beyond all that is above it.
    in_plane = points @ axes[:2].T
    above = in_plane[~below]
    low, high = (quantile(above, share) for share in (Ground.TAIL, 1.0 - Ground.TAIL))
    beyond = ((in_plane < low) | (in_plane > high)).any(1) & left_out
    if beyond[below].mean() <= Ground.LEAST_BEYOND:
        return None
    return Plane(np.stack([*axes[:2], normal]), height, low, high, 2.0 * half)
