"""The search for what moves as one: as little as is needed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np

from ..geometry.arrays import Array
from ..geometry.rotations import angle_between, from_vectors, nearest_rotation
from ..geometry.view import View
from . import Keep, Moved
from .everywhere import (
    closed_iou,
    same_by_symmetry,
    search_everywhere,
    size_of_object,
    spacing,
    spread_indices,
    unlike_first,
)
from .levenberg import Freedom
from .move import MOST_DEGREES, Body, Move, PoseDeviation, unmoved
from .placement import GROWTH, SHIFT, SIZE, STRETCH, TURN, UNKNOWNS, Placements
from .search import (
    EXPLAINED,
    NOTHING_KNOWN,
    SURE_GAP,
    Comparison,
    SearchResult,
    place_from,
    some_views,
)
from .target import Part

# The default does not move a cloud by more of the standard deviations below.
MOST_DEVIATIONS = 2.5
# Standard deviations of the error of a given placement: radians, longest sides of the cloud, and
# the logarithms of its size and of its proportions.
GIVEN_ERROR = np.array(
    [np.radians(MOST_DEGREES / MOST_DEVIATIONS)] * 3 + [0.12] * 4 + [np.inf] * (UNKNOWNS - 7)
)
GIVEN_ERROR[STRETCH] = 0.12
# Views that a place is searched with, at most; more hardly make it more exact.
MOST_VIEWS = 12
# A cloud whose silhouette overlaps with the masks by less is searched in all directions.
LEAST_OVERLAP = 0.1
# So is a cloud that is this many times as large or as small as what several masks show. From its
# narrow side an object is up to three times as small as its longest side.
OTHER_UNITS = 5.0
# A body that looks the same after this turn about an axis, radians, is taken for one of revolution:
# no polygon with few corners does.
A_TURN = 0.5


def missed_by(body: Body, views: Sequence[View], *clouds: Array) -> list[float]:
    """The share of the contours that a cloud misses where it is.

    And with each of the ``clouds`` [N, 3] in place of its points.
    """
    comparison = Placing(body, views).comparison
    comparisons = comparison, *(comparison.of_cloud(body.normalise(cloud)) for cloud in clouds)
    return [comparison.missed_unmoved for comparison in comparisons]


def missed_in_parts(
    body: Body, views: Sequence[View], parts: Sequence[Part | None]
) -> tuple[float, float]:
    """The share of the contours that a cloud misses in ``parts`` of views (None: in all of it).

    And the share of the contours in the squares of the parts that the parts hold.
    """
    problem, parts = Placing(body, views), some_views(parts, MOST_VIEWS)
    squares = [part and (part[0], np.ones_like(part[1])) for part in parts]
    of_parts, of_squares = (
        Comparison.of(problem.points, problem.normalised, places) for places in (parts, squares)
    )
    pieces, all_pieces = (
        sum(contour.pieces for contour in comparison.contours)
        for comparison in (of_parts, of_squares)
    )
    return of_parts.missed_unmoved, pieces / all_pieces


def _why_unsure(best: Move, others: Sequence[Move]) -> str:
    """Why one of the ``others`` may be right instead; "" if the best is sure."""
    if best.missed > EXPLAINED:
        return (
            f"the cloud misses {best.missed:.0%} of the contours at best, expected at most "
            f"{EXPLAINED:.0%}"
        )
    for other in others:
        if other.missed < best.missed + SURE_GAP:
            angle = angle_between(
                other.matrix[:3, :3] / other.size, best.matrix[:3, :3] / best.size
            )
            return (
                f"turned by another {float(angle):.0f} degrees it misses {other.missed:.0%} of the "
                f"contours, here {best.missed:.0%}"
            )
    return ""


def deviation_of(
    comparison: Comparison, placement: Placements, freedom: Freedom, points: Array, unit: float
) -> PoseDeviation:
    """How exact the one ``placement`` of ``points`` [N, 3] is; a shift by 1 is one by ``unit``."""
    covariance = comparison.covariance(placement, freedom)
    turns = covariance[TURN, TURN]
    axis = np.linalg.eigh(turns)[1][:, -1]
    # The samples of a bottle are no exact body of revolution, and seem to tell how it is turned.
    R, turned = placement.R[0], from_vectors(A_TURN * axis) @ placement.R[0]
    if same_by_symmetry(points, R, turned, spacing(points)):
        covariance[TURN, TURN] = turns + NOTHING_KNOWN**2 * np.outer(axis, axis)
    return PoseDeviation.of(covariance, unit)


class Placing:
    """A cloud and some of its views in the units of the cloud."""

    def __init__(self, body: Body, views: Sequence[View], unit: float | None = None) -> None:
        """``unit`` : length in the world of the cameras that stands for 1; the cloud's longest side
        by default.
        """
        self.body, self.views = body, views
        self.unit = body.scale if unit is None else unit
        self.points = body.normalise(body.points)
        self.normalised = tuple(
            view.before_placed(np.eye(3), body.centre, self.unit)
            for view in some_views(views, MOST_VIEWS)
        )

    @cached_property
    def comparison(self) -> Comparison:
        return Comparison.of(self.points, self.normalised)

    @cached_property
    def spread(self) -> Array:
        """Points of the cloud that are spread evenly."""
        return self.points[spread_indices(self.points)]

    @cached_property
    def tells_size(self) -> bool:
        """Whether the views can separate the size of a cloud from its distance."""
        return len(self.views) > 1 or bool(self.comparison.surfaces)

    def freedom(self, kind: Moved, keep: Keep) -> tuple[Freedom, Keep | None]:
        """What may change, and what stays of size and distance, where only one of them can."""
        unit = np.eye(UNKNOWNS)
        shift, turn, size = unit[:, SHIFT], unit[:, TURN], unit[:, [SIZE]]
        fixed: Keep | None = None if self.tells_size else keep
        if fixed == "auto":
            fixed = "distance" if kind in ("similarity", "shift") else "size"
        if fixed == "distance":
            shift = shift @ self.normalised[0].camera.R[:2].T
        columns = [shift] if kind == "shift" else [turn, shift]
        if kind == "similarity" and fixed != "size":
            columns.append(size)
        given = Placements.unmoved()
        freedom = Freedom(np.concatenate(columns, 1), given, GIVEN_ERROR)
        of_depth = self.comparison.at_depth(given, freedom)
        # A cloud in other units than the depth map.
        if abs(np.log(of_depth.size[0])) > MOST_DEVIATIONS * GIVEN_ERROR[SIZE]:
            freedom = replace(freedom, given=of_depth)
        return freedom, fixed

    @property
    def outline_error(self) -> float:
        """How exactly the masks show outlines, pixels: the mean of all views."""
        return float(np.mean([view.outline_error for view in self.views]))

    @property
    def stretch(self) -> Freedom:
        """The cloud may stretch along any axes, and shift; the masks may be inexact."""
        deviation = GIVEN_ERROR.copy()
        deviation[GROWTH] = self.outline_error
        return Freedom.of(Placements.unmoved(), STRETCH, SIZE, SHIFT, GROWTH, deviation=deviation)

    def placed(self, kind: Moved, keep: Keep) -> Move:
        """Near where the cloud was given, or anywhere if it does not fit there."""
        if kind == "similarity" and len(self.views) > 1:
            times = size_of_object(self.comparison.targets)
            if abs(np.log(times)) > np.log(OTHER_UNITS):
                return Placing(self.body, self.views, self.unit * times).anywhere(kind, keep)
        if not self.in_front:
            return self.anywhere(kind, keep)
        freedom, fixed = self.freedom(kind, keep)
        near = place_from(self.comparison, freedom)
        if near.placement is freedom.given and freedom.given.size[0] == 1.0:
            stays = unmoved(self.views, "no other place fits much better", near.missed_before)
            return replace(stays, exact_to=self.exact_to(near, freedom))
        move = self.move(kind, near, fixed, freedom)
        if near.fits:
            return move
        elsewhere = self.anywhere(kind, keep)
        if elsewhere.explains and elsewhere.missed < move.missed:
            return elsewhere
        # Whether the cloud says something about its place where it was given.
        points, targets = self.spread, self.comparison.targets
        overlap = closed_iou(points, Placements.unmoved(), targets, spacing(points))
        return move if overlap[0] >= LEAST_OVERLAP else elsewhere

    @cached_property
    def in_front(self) -> bool:
        """Whether the whole cloud was given in front of the cameras."""
        given = Placements.unmoved()
        return all(
            target.camera.model != "perspective"
            or target.project(self.points, given).depth.min() > 0.0
            for target in self.comparison.targets
        )

    def anywhere(self, kind: Moved, keep: Keep) -> Move:
        """The best of all directions, and the others that are no symmetry of the cloud."""
        freedom, fixed = self.freedom(kind, keep)
        if kind == "pose" and fixed == "distance":
            # Neither size nor distance could change: in another direction it would not fit.
            freedom, fixed = self.freedom(kind, "size")
        before = float(self.comparison.missed(freedom.given)[0])
        free = replace(freedom, deviation=np.full(UNKNOWNS, np.inf))
        candidates = search_everywhere(self.comparison, self.spread, self.normalised, free)
        placements = candidates.placements
        if fixed is not None and kind == "similarity":
            placements, fixed = self._with_fixed(placements, fixed)
        results = [
            SearchResult(placements[i : i + 1], before, float(candidates.missed[i]))
            for i in (0, *unlike_first(self.spread, placements.R))
        ]
        best, *others = (self.move(kind, result, fixed, free) for result in results)
        alternatives = tuple((other.missed, other.matrix) for other in others)
        return replace(best, alternatives=alternatives, why_unsure=_why_unsure(best, others))

    def _with_fixed(self, placements: Placements, fixed: Keep) -> tuple[Placements, Keep]:
        """The placements, scaled about the one camera so that the distance or the size stays.

        The size stays also if a part of the cloud was given behind the camera.
        """
        camera = self.normalised[0].camera
        if camera.model == "orthographic":
            return placements, fixed
        if fixed == "distance" and self.in_front:
            factor = camera.t[2] / (placements.t @ camera.R[2] + camera.t[2])
        else:
            fixed, factor = "size", 1.0 / placements.size
        return placements.scaled_about(camera.position, factor), fixed

    def of_cameras(self) -> Move:
        """Each camera moves by itself."""
        moves = []
        for view in self.views:
            alone = Placing(self.body, (view,))
            freedom, fixed = alone.freedom("pose", "size")
            result = place_from(alone.comparison, freedom)
            moves.append(alone.move("camera", result, fixed, freedom))
        return Move(
            "camera",
            tuple(move.views[0] for move in moves),
            np.eye(4),
            missed_before=float(np.mean([move.missed_before for move in moves])),
            missed=float(np.mean([move.missed for move in moves])),
            explains=all(move.explains for move in moves),
        )

    def exact_to(self, result: SearchResult, freedom: Freedom) -> PoseDeviation | None:
        """Of the placement of a search; None if the cloud does not fit there."""
        if result.missed >= EXPLAINED:
            return None
        return deviation_of(self.comparison, result.placement, freedom, self.spread, self.unit)

    def move(self, kind: Moved, result: SearchResult, fixed: Keep | None, freedom: Freedom) -> Move:
        """The move of that kind to the one placement of a search."""
        placement, centre = result.placement, self.body.centre
        # The product of many small rotations is a rotation only up to rounding.
        R = nearest_rotation(placement.R[0])
        size = float(placement.size[0]) * self.unit / self.body.scale
        t = centre + self.unit * placement.t[0] - size * R @ centre
        matrix = np.eye(4)
        if kind != "camera":
            matrix[:3, :3], matrix[:3, 3] = size * R, t
        views = tuple(view.before_placed(R, t, size) for view in self.views)
        return Move(
            kind,
            views,
            matrix,
            result.missed_before,
            result.missed,
            result.explains,
            fixed,
            exact_to=self.exact_to(result, freedom),
        )
