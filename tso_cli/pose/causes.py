"""What may be wrong with cloud, cameras and masks, and what each of these causes explains.

Every cause is a few unknowns of a placement. All are fitted to the contours of the masks, and
compared by what the cloud misses of the contours then, plus a price for every unknown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ..geometry.arrays import Array
from ..geometry.view import View
from . import Asked, Keep, Moved
from .levenberg import Freedom
from .move import FITS, FITS_NEARLY, Body, Move, unmoved
from .placement import ASPECT, FOCAL, GROWTH, PRINCIPAL, UNKNOWNS, Placements
from .placing import GIVEN_ERROR, MOST_DEVIATIONS, Placing
from .search import EXPLAINED, LEFT, SIDE, Comparison, SearchResult
from .target import MARGIN

Name = Literal["shift", "pose", "focal-length", "aspect", "principal-point", "outline", "stretch"]
# Standard deviations of what is given: those of a placement, logarithms, longer sides of the
# picture, pixels. A larger error is a mistake of another kind.
DEVIATIONS = GIVEN_ERROR.copy()
DEVIATIONS[[FOCAL, ASPECT]] = 0.12
DEVIATIONS[PRINCIPAL] = 0.08
DEVIATIONS[GROWTH] = 3.0
# Smaller errors of a camera or a mask are those of a right one: outline errors, and longer sides of
# the object, by which the contour moves. They may explain a misfit, but then the shape is nearly
# right too.
LEAST_ERRORS, LEAST_MOVED = 1.5, 0.015
# What of the contours an unknown must explain: with six more unknowns a cloud of a right shape and
# place misses about six times as much less.
PRICE = 0.01
# Causes whose costs differ by less explain about as much.
SIMILAR = 0.03
# A camera explains a misfit if the cloud then misses less than these shares of the contours, and of
# what it misses as given.
EXPLAINED_WITHOUT_MOVING, LEFT_WITHOUT_MOVING = 0.25, 0.5
# Masks that are too large or too small explain a misfit if less than this share of it is left: the
# growth is one number, and coarse masks hide much else. Of exact clouds before masks that are off
# by 1 to 4 %, 43 of 78 are then found.
LEFT_BY_OUTLINE = 0.55
# Else outlines are corrected by at most this, in pixels: the error that tso assumes of the coarsest
# masks. Without this a large --mask-error lets a right mask grow toward another shape: by 2 px or
# more before 10 of 38 clouds, and now before 2.
MOST_GROWN = 0.75
MOST_LEFT: dict[Name, tuple[float, float]] = {
    "shift": (EXPLAINED, LEFT),
    "pose": (EXPLAINED, LEFT),
    "focal-length": (EXPLAINED_WITHOUT_MOVING, LEFT_WITHOUT_MOVING),
    "aspect": (EXPLAINED_WITHOUT_MOVING, LEFT_WITHOUT_MOVING),
    "principal-point": (EXPLAINED_WITHOUT_MOVING, LEFT_WITHOUT_MOVING),
    "outline": (1.0, LEFT_BY_OUTLINE),
    # Another shape is what is left if nothing else explains the misfit.
    "stretch": (0.0, 0.0),
}
"""What each cause must leave less of: of the contours, and of what the cloud misses as given."""


@dataclass(frozen=True, eq=False)
class Cause:
    """Something that may be wrong.

    unknowns : how many numbers were fitted. missed : share of the contours that the cloud misses if
    this is mended. placement : how cloud, cameras and masks are then.
    """

    name: Name
    unknowns: int
    missed: float
    placement: Placements

    @property
    def cost(self) -> float:
        return self.missed + PRICE * self.unknowns

    @property
    def of_place(self) -> bool:
        """Whether the cloud is mended, by moving as one."""
        return self.name in ("shift", "pose")

    @property
    def change(self) -> Array:
        """[17], the unknowns, counted from what was given."""
        change: Array = self.placement.since(Placements.unmoved())[0]
        return change


def find_move(
    body: Body, views: Sequence[View], asked: Asked = "auto", keep: Keep = "auto"
) -> Move:
    """What moves as one, of what was ``asked`` for.

    "camera" : each camera by itself. "pose", "similarity" : the cloud stands where the masks would
    have it, near where it was given, or anywhere if it does not fit there.
    "auto" : what explains why the cloud does not fit its masks. Nothing moves if it fits, if its
    shape may be wrong, or if a camera or a mask explains the misfit about as well: then the move
    has these `Move.causes`. "shape" : the same where no place and no camera is wrong.
    """
    problem = Placing(body, views)
    if asked == "camera":
        return problem.of_cameras()
    if asked == "pose" or asked == "similarity":
        return problem.placed(asked, keep)
    missed = problem.comparison.missed_unmoved
    if missed < FITS:
        return unmoved(views, "the cloud fits the contours where it is", missed)
    # Of size and distance, the distance stays: it is longer than the object, so that a wrong
    # distance is a larger error than a wrong size.
    keep = "distance" if keep == "auto" and not problem.tells_size else keep
    fitted = _fitted(problem, keep, asked == "auto")
    stretch = next(cause for cause in fitted if cause.name == "stretch")
    rivals = [cause for cause in fitted if _explains(cause, stretch, problem)]
    if not rivals:
        settled = missed < FITS_NEARLY and stretch.missed > LEFT_WITHOUT_MOVING * missed
        why = "the cloud fits the contours where it is"
        if not settled:
            why = "no small turn and shift explains the misfit"
            if any(view.truncated for view in views):
                why = "a picture cuts off the object"
        growth = 0.0 if settled else _growth(problem, stretch.placement)
        move = unmoved(views, why, missed)
        return replace(move, settled=settled, growth=growth, stretched=stretch.missed)
    rivals.sort(key=lambda cause: cause.cost)
    likely = [cause for cause in rivals if cause.cost < rivals[0].cost + SIMILAR]
    if not all(cause.of_place for cause in likely):
        why = "something else explains the misfit about as well"
        return replace(unmoved(views, why, missed), causes=tuple(likely))
    first = likely[0]
    kind: Moved = "shift" if first.name == "shift" else "pose"
    result = SearchResult(first.placement, missed, first.missed)
    freedom, fixed = problem.freedom(kind, keep)
    return problem.move(kind, result, fixed, freedom)


def _growth(problem: Placing, stretched: Placements) -> float:
    """By how many pixels the masks have grown, as a cloud of other proportions finds.

    The cloud is compared as exactly as pixels show outlines: within a large error of the masks
    every cloud fits.
    """
    growth = float(stretched.growth[0])
    if abs(growth) <= MOST_GROWN:
        return growth
    exact = [replace(view, mask_error=None) for view in problem.normalised]
    placements = Placements.joined([stretched, replace(stretched, growth=np.zeros(1))])
    missed, without = Comparison.of(problem.points, exact).missed(placements)
    if missed <= LEFT_BY_OUTLINE * without:
        return growth
    return float(np.copysign(MOST_GROWN, growth))


def missed_if_stretched(body: Body, views: Sequence[View]) -> float:
    """The share of the contours that a cloud misses if it stretches as they would have it."""
    problem = Placing(body, views)
    placement, _ = problem.comparison.settled(Placements.unmoved(), problem.stretch, from_afar=True)
    return float(problem.comparison.missed(placement)[0])


def _explains(cause: Cause, stretch: Cause, problem: Placing) -> bool:
    """Whether a cause leaves hardly anything of what the cloud misses, no more than a stretch does.

    A thin cloud that is turned looks much like one that is stretched, so a turn has no advantage.
    """
    most, share = MOST_LEFT[cause.name]
    likely = bool(np.abs(cause.change / DEVIATIONS).max() <= MOST_DEVIATIONS)
    if cause.missed >= min(most, share * problem.comparison.missed_unmoved) or not likely:
        return False
    if cause.of_place:
        return cause.missed <= stretch.missed
    # A right camera or mask may be off by a small change. Longer sides of object and picture, px:
    change, target = np.abs(cause.change), problem.comparison.targets[0]
    across, picture = SIDE / MARGIN / target.pixel, target.picture / target.pixel
    of_lens = float(change[FOCAL] + change[ASPECT]) * across / 2.0
    of_camera = of_lens + float(np.linalg.norm(change[PRINCIPAL])) * picture
    least = LEAST_ERRORS * problem.outline_error
    is_small = change[GROWTH] < least and of_camera < max(least, LEAST_MOVED * across)
    return cause.cost <= stretch.cost and not is_small


def _fitted(problem: Placing, keep: Keep, may_move: bool) -> list[Cause]:
    """All causes, fitted at once; ``may_move`` : also those of the cloud's place and of cameras."""
    unit = np.eye(UNKNOWNS)
    bases: dict[Name, Array] = {"outline": unit[:, [GROWTH]], "stretch": problem.stretch.basis}
    if may_move:
        bases |= {
            "focal-length": unit[:, [FOCAL]],
            "aspect": unit[:, [ASPECT]],
            "principal-point": unit[:, PRINCIPAL],
        }
    # Where a picture cuts off the object, the contour does not show where it is.
    if may_move and not any(view.truncated for view in problem.views):
        bases |= {
            "shift": problem.freedom("shift", keep)[0].basis,
            "pose": problem.freedom("pose", keep)[0].basis,
        }
    numbers = {name: number for number, name in enumerate(bases)}
    most = max(basis.shape[1] for basis in bases.values())
    padded = [np.pad(basis, ((0, 0), (0, most - basis.shape[1]))) for basis in bases.values()]
    deviations = np.tile(DEVIATIONS, (len(bases), 1))
    deviations[numbers["stretch"]] = problem.stretch.deviation
    freedom = Freedom(np.stack(padded), Placements.unmoved(), deviations)
    comparison = problem.comparison
    step = np.zeros((len(bases), UNKNOWNS))
    if "principal-point" in bases:
        # K of a crop is too far off for a descent from where it was given.
        step[numbers["principal-point"], PRINCIPAL] = _shift_of_boxes(problem)
    start = Placements.unmoved(len(bases)).stepped(step)
    placements, _ = comparison.settled(start, freedom, from_afar=True)
    missed = comparison.missed(placements)
    return [
        Cause(name, bases[name].shape[1], float(missed[i]), placements[i : i + 1])
        for name, i in numbers.items()
    ]


def _shift_of_boxes(problem: Placing) -> Array:
    """[2], the shift of the boxes of the masks against those of the cloud, in pictures."""
    shifts = []
    for target in problem.comparison.targets:
        px = target.project(problem.points, Placements.unmoved()).px[0]
        ends = target.cells.min(0) + target.cells.max(0) - px.min(0) - px.max(0)
        shifts.append(ends / 2.0 / target.picture)
    return np.mean(shifts, 0)
