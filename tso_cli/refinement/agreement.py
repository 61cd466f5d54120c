"""Whether cloud, cameras and masks agree, and which common mistake explains it if they do not."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry.camera import Array
from ..geometry.points import scattered
from ..geometry.view import View, object_box
from ..losses.projection import pixels_under
from .assumptions import ASSUMPTIONS, AssumedView, Assumption, Suspect, about, axes_of, mirrored
from .occlusion import occluded

# Cells along the longer side of the mask's box, in which silhouettes are compared, and points that are projected.
CELLS, POINTS = 16, 1024
# An assumption is suspected if silhouettes then agree better than as given by this IoU, and at least so far.
MARGIN, LEAST_IOU = 0.16, 0.4
# With so much it is a hint, which `mistake_check` follows.
HINT_MARGIN = 0.04
# Others that fit about as well as the best.
SIMILAR, MOST_SUSPECTS = 0.03, 3
# An inverted mask is foreground along at least so much of the picture's border.
BORDER = 0.6
# A view of several is suspected if it agrees worse than the others by so much.
LEFT_OUT = 0.1
# Views of less IoU may have each the mask of another, if there are not too many of them, and their IoU then gains so much.
MISPAIRED, MOST_MISPAIRED, PAIRING_MARGIN = 0.8, 32, 0.12
# At most so many pairs are named.
MOST_PAIRS = 3
# Of 138 scenes of training shapes with boxes in place of masks 93 % got worse, of 97 whose masks were mispaired 85 %.
BOXED_CONFIDENCE, MISPAIRED_CONFIDENCE = 0.07, 0.15
# A mask of fewer cells matches too much by chance: a cloud that shrinks to a point, or one that a sensor barely resolves.
FEWEST_CELLS = 10
# A mask that fills so much of its box is taken for the box of an object, if the cloud fills less than so much of its own, in so
# many cells along it, but for so many strays at each side. Fewer points, or px of the mask's shorter side, do not tell.
FILLED, CLOUD_FILLED, CELLS_OF_CLOUD, STRAYS = 0.99, 0.92, 10, 0.01
FEWEST_POINTS, FEWEST_PIXELS = 512, 16
# Begins what is said of suspects.
NAMED = "it looks as if"
# A row of cells is so many columns further.
ROW = 1 << 32


@dataclass(frozen=True)
class Agreement:
    """How far the silhouette of a cloud and the masks agree, mean IoU in coarse cells of the views.

    as_given : of the input as it is. best : under the best of `ASSUMPTIONS`. suspects : what may be wrong, likeliest first.
    of_views : what may be wrong with single views of several, where the input as a whole looks right.
    hint : of an input that nothing was assumed of and nothing is suspected of, the assumption under which silhouettes agree
        somewhat better, if there is one. confirmed : that a descent agrees better under it too (`mistake_check`).
    most_confidence : upper bound of the result's confidence; under 1 where all masks are boxes of the object, which tell
        nothing of its shape, or masks and cameras are paired wrongly.
    """

    as_given: float
    best: float
    suspects: tuple[Suspect, ...]
    of_views: tuple[Suspect, ...] = ()
    hint: Hint | None = None
    confirmed: bool = False
    most_confidence: float = 1.0

    @classmethod
    def of(cls, points: Array, views: Sequence[View]) -> Agreement:
        """Of ``points`` [N, 3]; a few milliseconds a view."""
        points = scattered(points, POINTS)
        outlines = [_Outline(view) for view in views]
        others = _others(outlines[0].given)
        as_given = np.array([outline.iou(points, outline.given) for outline in outlines])
        ious = np.array([[outline.iou(points, other.assumptions) for outline in outlines] for other in others])
        handicaps = np.array([other.handicap for other in others])
        scores = ious.mean(1) - handicaps
        tells = np.array([len(outline.cells[False].inside) >= FEWEST_CELLS for outline in outlines])
        boxes = [outline.view for outline in outlines if _is_box(outline, points)]
        all_boxes = len(boxes) == len(views)
        judged = tells.any() and not all_boxes
        suspects: tuple[Suspect, ...] = ()
        mispaired = False
        if judged:
            told = ious[:, tells].mean(1) - handicaps
            # A mistake in all views may look as wrong pairs do, of a symmetric object.
            suspects = _mispaired(points, outlines, as_given, tells, float(told.max()))
            mispaired = bool(suspects)
            suspects = suspects or _suspects(others, told, as_given[tells].mean())
        of_views: tuple[Suspect, ...] = ()
        if not suspects:
            of_views = tuple(Suspect(f"{view.name} is the box of the object", "a mask of its outline", 0.0) for view in boxes)
            of_views += _of_views(outlines, others, ious, as_given, tells)
            of_views += _hidden(points, [view for view in views if view not in boxes])
        hinted = not suspects and not all_boxes and tells.all() and not outlines[0].given
        hint = _hint(others, scores, as_given.mean()) if hinted else None
        most = BOXED_CONFIDENCE if all_boxes else MISPAIRED_CONFIDENCE if mispaired else 1.0
        return cls(float(as_given.mean()), float(scores.max()), suspects, of_views, hint, most_confidence=most)

    @property
    def named(self) -> tuple[Suspect, ...]:
        """Suspects of the input as a whole, else of single views."""
        return self._of_input or self.of_views

    @property
    def _of_input(self) -> tuple[Suspect, ...]:
        return (self.hint.suspect,) if self.hint and self.confirmed else self.suspects

    @property
    def suspicion(self) -> str | None:
        """The suspects in words, None without any."""
        if not self._of_input:
            return "; ".join(f"{NAMED} {suspect.what}: try {suspect.option}" for suspect in self.of_views) or None
        first, *others = self._of_input
        return f"{NAMED} {first.what}: try {first.option}" + "".join(f", or {suspect.option}" for suspect in others)


class Hint(NamedTuple):
    """What may be wrong, and the assumption that mends it."""

    suspect: Suspect
    assumption: Assumption


class _Other(NamedTuple):
    """The given assumptions with one ``change``: ``what`` is right then, in words, and the ``option`` that asks for it."""

    what: str
    option: str
    assumptions: tuple[Assumption, ...]
    change: Assumption  # added, or left out
    fewer: bool  # whether it is left out

    @property
    def handicap(self) -> float:
        return 0.0 if self.fewer else self.change.handicap


def _others(given: tuple[Assumption, ...]) -> list[_Other]:
    """The given assumptions without one of them, and with one that is not given."""
    less = [
        _Other(f"{one.option} is wrong", f"without {one.option}", tuple(o for o in given if o is not one), one, True)
        for one in given
    ]
    # The same assumption may be given by another option.
    present = [replace(one, option="") for one in given]
    return less + [
        _Other(one.what, f"--assume {name}", (*given, one), one, False)
        for name, one in ASSUMPTIONS.items()
        if one not in present
    ]


def _suspects(others: list[_Other], scores: Array, as_given: float) -> tuple[Suspect, ...]:
    """Others that may be true; if fewer assumptions explain it, no more are suspected."""
    if scores.max() < max(as_given + MARGIN, LEAST_IOU):
        return ()
    likely = [i for i in np.argsort(-scores, kind="stable") if scores[i] >= scores.max() - SIMILAR]
    fewer = [i for i in likely if others[i].fewer]
    return tuple(
        Suspect(others[i].what, others[i].option, float(scores[i]) + others[i].handicap)
        for i in (fewer or likely)[:MOST_SUSPECTS]
    )


def _hint(others: list[_Other], scores: Array, as_given: float) -> Hint | None:
    best = others[int(np.argmax(scores))]
    if scores.max() < max(as_given + HINT_MARGIN, LEAST_IOU):
        return None
    score = float(scores.max()) + best.handicap
    return Hint(Suspect(best.what, best.option, score), best.change)


def _mispaired(
    points: Array, outlines: Sequence[_Outline], as_given: Array, tells: NDArray[np.bool_], otherwise: float
) -> tuple[Suspect, ...]:
    """What is said where views fit one another's masks better than their own.

    Of the views whose mask ``tells`` [V] enough; the mean IoU must be better than the best ``otherwise``.
    """
    numbers = np.flatnonzero(tells & (as_given < MISPAIRED))
    if not 2 <= len(numbers) <= MOST_MISPAIRED:
        return ()
    low = [outlines[int(i)] for i in numbers]
    # [seen by the camera, in the mask]
    ious = np.array([camera.ious(points, camera.given, low) for camera in low])
    if (ious.max(1) - ious.diagonal()).max() < PAIRING_MARGIN:
        return ()
    # It takes as long to import as a tenth of a run.
    from scipy.optimize import linear_sum_assignment

    best = linear_sum_assignment(ious, maximize=True)[1]
    moved = np.flatnonzero(best != np.arange(len(low)))
    if not len(moved):
        return ()
    given, paired = ious.diagonal()[moved], ious[moved, best[moved]]
    of_all = as_given[tells].mean() + (paired - given).sum() / np.count_nonzero(tells)
    if paired.mean() < max(given.mean() + PAIRING_MARGIN, LEAST_IOU) or of_all < otherwise + SIMILAR:
        return ()
    names = [outline.view.name for outline in outlines]
    if len(set(names)) < len(names):
        names = [f"view {number}" for number in range(1, len(names) + 1)]
    pairs = [f"{names[numbers[best[i]]]} with the camera of {names[numbers[i]]}" for i in moved[:MOST_PAIRS]]
    more = f", and so on, {len(moved)} in all" * (len(moved) > MOST_PAIRS)
    return (Suspect("masks and cameras are paired wrongly", ", ".join(pairs) + more, float(paired.mean())),)


def _of_views(
    outlines: Sequence[_Outline], others: list[_Other], ious: Array, as_given: Array, tells: NDArray[np.bool_]
) -> tuple[Suspect, ...]:
    """Where one view that ``tells`` enough [V] disagrees and the others agree: what would mend it, and not them."""
    suspects = []
    for i, outline in enumerate(outlines):
        rest = tells & (np.arange(len(outlines)) != i)
        # Another bad view among the rest hides none.
        if not tells[i] or not rest.any() or np.median(as_given[rest]) < as_given[i] + LEFT_OUT:
            continue
        # Of two views either may be the wrong one, if the cloud is seen in both.
        known = rest.sum() > 1 or as_given[i] == 0.0
        scores = [
            0.0 if _of_all(other, known) or ious[k, rest].mean() >= as_given[rest].mean() + SIMILAR else ious[k, i]
            for k, other in enumerate(others)
        ]
        best = int(np.argmax(scores))
        if scores[best] >= max(as_given[i] + MARGIN, LEAST_IOU):
            name, other = outline.view.name, others[best]
            option = f"{other.option}@{name}"
            if other.fewer:
                option = other.option if other.change.view else f"{other.option} for {name}"
            suspects.append(Suspect(f"for {name} alone {other.what}", option, float(scores[best])))
    return tuple(suspects)


def _of_all(other: _Other, known: bool) -> bool:
    """Whether it cannot be said of one view: the cloud is the same for all, and the wrong view may not be ``known``.

    An inverted mask is known by its border, without other views.
    """
    return other.change.of_cloud or not (known or other.change.mask == "inverted")


def _hidden(points: Array, views: Sequence[View]) -> tuple[Suspect, ...]:
    """Views in which something seems to be in front of the object."""
    suspects = []
    for view in views:
        score = occluded(_on_known(view.camera.project(points)[0], view), view)
        if score is not None:
            suspects.append(Suspect(f"something hides a part of the object in {view.name}", "--ignore FILE", score))
    return tuple(suspects)


def _is_box(outline: _Outline, points: Array) -> bool:
    """Whether the mask is a filled rectangle beside background, and the silhouette of ``points`` [N, 3] is not."""
    view = outline.view
    left, top, right, bottom = object_box(view.inside)
    if outline.may_be_inverted or min(right - left, bottom - top) < FEWEST_PIXELS:
        return False
    if view.inside[top:bottom, left:right].mean() < FILLED:
        return False
    pixels = _on_known(view.camera.project(points)[0], view)
    if len(pixels) < FEWEST_POINTS:
        return False
    low, high = np.quantile(pixels, [STRAYS, 1.0 - STRAYS], axis=0)
    size = np.maximum(high - low, 1e-9)
    cells = np.ceil(CELLS_OF_CLOUD * size / size.max())
    places = np.floor((pixels - low) / size * cells)
    inside = places[((places >= 0.0) & (places < cells)).all(1)]
    return len(np.unique(inside, axis=0)) < CLOUD_FILLED * float(cells.prod())


def _on_known(pixels: Array, view: View) -> Array:
    """Those of ``pixels`` [N, 2] that fall on known pixels of the image."""
    pixel, visible = pixels_under(pixels, np.asarray(np.isfinite(pixels).all(1)), *view.mask.shape)
    return pixels[visible if view.known is None else visible & view.known.ravel()[pixel]]


class _Outline:
    """A mask in coarse cells, to be compared with what a camera sees of a cloud."""

    def __init__(self, view: View) -> None:
        self.view = view
        self.given = view.given if isinstance(view, AssumedView) else ()
        self.camera = isinstance(view, AssumedView) and view.camera_read or view.camera
        inside = view.inside
        # Of an object that the border truncates, or a speck, the background would pass for an inverted mask.
        border = np.ones(inside.shape, bool) if view.known is None else view.known.copy()
        border[1:-1, 1:-1] = False
        self.may_be_inverted = border.any() and inside[border].mean() >= BORDER
        self.cells = {False: _Cells.of(inside)}
        if self.may_be_inverted:
            self.cells[True] = _Cells.of(~inside if view.known is None else ~inside & view.known)

    def iou(self, points: Array, assumptions: Sequence[Assumption]) -> float:
        """IoU of the mask's cells and those that ``points`` [N, 3] fall in, under these assumptions in place of the given."""
        return self.ious(points, assumptions, [self])[0]

    def ious(self, points: Array, assumptions: Sequence[Assumption], masks: Sequence[_Outline]) -> list[float]:
        """The same of other ``masks`` with this camera; 0 of one of another size."""
        view, given = self.view, about(self.view, self.given)
        assumptions, camera = about(view, assumptions), self.camera
        for assumption in assumptions:
            camera = assumption.of_camera(camera)
        # The mask has the given changes already; each change is its own inverse, so what occurs twice cancels.
        changes = [assumption.mask for assumption in (*given, *assumptions)] + ["left-right"] * mirrored(view)
        inverted, across, down = (changes.count(name) % 2 == 1 for name in ("inverted", "left-right", "upside-down"))
        masks_told = [mask.cells.get(inverted) if mask.view.mask.shape == view.mask.shape else None for mask in masks]
        if not any(masks_told):
            return [0.0] * len(masks)
        pixels, _ = camera.project(points @ axes_of(assumptions).T)
        # The cells stay as they are: flipping the projection has the same effect as flipping the mask.
        if across:
            pixels[:, 0] = camera.width - 1.0 - pixels[:, 0]
        if down:
            pixels[:, 1] = camera.height - 1.0 - pixels[:, 1]
        return [
            cells.iou(_on_known(pixels, mask.view)) if cells else 0.0 for cells, mask in zip(masks_told, masks, strict=True)
        ]


class _Cells(NamedTuple):
    """Those that are foreground, of a grid in which the object's longer side has so many."""

    low: Array  # [2], column and row of the first cell's corner, px
    edge: int  # of a cell, px
    inside: set[int]

    @classmethod
    def of(cls, inside: NDArray[np.bool_]) -> _Cells:
        left, top, right, bottom = object_box(inside)
        edge = -(-max(right - left, bottom - top) // CELLS)
        rows, columns = -(-(bottom - top) // edge), -(-(right - left) // edge)
        padded = np.zeros((rows * edge, columns * edge), bool)
        padded[: bottom - top, : right - left] = inside[top:bottom, left:right]
        row, column = np.nonzero(padded.reshape(rows, edge, columns, edge).mean((1, 3)) > 0.1)
        return cls(np.array([left, top]) - 0.5, edge, set((row * ROW + column).tolist()))

    def iou(self, pixels: Array) -> float:
        """IoU of the mask's cells and those that ``pixels`` [N, 2] fall in."""
        column, row = np.floor((pixels - self.low) / self.edge).astype(np.int64).T
        covered = set((row * ROW + column).tolist())
        return len(covered & self.inside) / max(1, len(covered | self.inside))
