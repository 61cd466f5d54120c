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
from ..optimisation.view_weights import FEWEST_TO_JUDGE
from .hypotheses import ASSUMPTIONS, Assumption, Suspect
from .occlusion import occluded
from .outline import LEAST_IOU, MARGIN, SIMILAR, Outline, on_known
from .pairing import mispaired_views

# Points that are projected.
POINTS = 1024
# With so much gain of the IoU an assumption is a hint, which `mistake_check` follows.
HINT_MARGIN = 0.04
# Of those that fit about as well as the best.
MOST_SUSPECTS = 3
# A view of several is suspected if it agrees worse than the others by so much.
LEFT_OUT = 0.1
# What is wrong with at most this share of the views is outvoted by the others.
OUTVOTED = 0.5
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


@dataclass(frozen=True)
class Agreement:
    """How far the silhouette of a cloud and the masks agree, mean IoU in coarse cells of the views.

    as_given : of the input as it is. best : under the best of `ASSUMPTIONS`. suspects : what may be wrong, likeliest first.
    of_views : what may be wrong with single views of several, where the input as a whole looks right.
    hint : of an input that nothing was assumed of and nothing is suspected of, the assumption under which silhouettes agree
        somewhat better, if there is one. confirmed : that a descent agrees better under it too (`mistake_check`).
    most_confidence : upper bound of the result's confidence; under 1 where all masks are boxes of the object, which tell
        nothing of its shape, or most masks and cameras are paired wrongly.
    outvoted : whether what is suspected is of so few views that the others outvote them.
    """

    as_given: float
    best: float
    suspects: tuple[Suspect, ...]
    of_views: tuple[Suspect, ...] = ()
    hint: Hint | None = None
    confirmed: bool = False
    most_confidence: float = 1.0
    outvoted: bool = False

    @classmethod
    def of(cls, points: Array, views: Sequence[View]) -> Agreement:
        """Of ``points`` [N, 3]; a few milliseconds a view, and less for each pair of those that agree badly."""
        points = scattered(points, POINTS)
        outlines = [Outline(view) for view in views]
        others = _others(outlines[0].given)
        as_given = np.array([outline.iou(points, outline.given) for outline in outlines])
        ious = np.array(
            [[outline.iou(points, other.assumptions) for outline in outlines] for other in others]
        )
        handicaps = np.array([other.handicap for other in others])
        scores = ious.mean(1) - handicaps
        tells = np.array([len(outline.cells[False].inside) >= FEWEST_CELLS for outline in outlines])
        boxes = [outline.view for outline in outlines if _is_box(outline, points)]
        all_boxes = len(boxes) == len(views)
        judged = tells.any() and not all_boxes
        suspects: tuple[Suspect, ...] = ()
        pairs: tuple[Suspect, ...] = ()
        mispaired, most_confidence = 0, BOXED_CONFIDENCE if all_boxes else 1.0
        if judged:
            told = ious[:, tells].mean(1) - handicaps
            # A mistake in all views may look as wrong pairs do, of a symmetric object.
            pairs, mispaired = mispaired_views(points, outlines, as_given, tells, float(told.max()))
            if mispaired > OUTVOTED * len(views):
                suspects, most_confidence = pairs, MISPAIRED_CONFIDENCE
            elif not pairs:
                suspects = _suspects(others, told, as_given[tells].mean())
        of_views: tuple[Suspect, ...] = ()
        if not suspects:
            of_views = tuple(
                Suspect(f"{view.name} is the box of the object", "a mask of its outline", 0.0)
                for view in boxes
            )
            of_views += pairs or _of_views(outlines, others, ious, as_given, tells)
            of_views += _hidden(points, [view for view in views if view not in boxes])
        # Pairs are one suspect, of several views.
        suspected = len(of_views) + max(0, mispaired - 1)
        outvoted = (
            bool(of_views) and len(views) >= FEWEST_TO_JUDGE and suspected <= OUTVOTED * len(views)
        )
        hinted = not suspects and not all_boxes and tells.all() and not outlines[0].given
        hint = _hint(others, scores, as_given.mean()) if hinted else None
        return cls(
            as_given=float(as_given.mean()),
            best=float(scores.max()),
            suspects=suspects,
            of_views=of_views,
            hint=hint,
            most_confidence=most_confidence,
            outvoted=outvoted,
        )

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
            return (
                "; ".join(
                    f"{NAMED} {suspect.what}: try {suspect.option}" for suspect in self.of_views
                )
                or None
            )
        first, *others = self._of_input
        return f"{NAMED} {first.what}: try {first.option}" + "".join(
            f", or {suspect.option}" for suspect in others
        )


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
        _Other(
            f"{one.option} is wrong",
            f"without {one.option}",
            tuple(o for o in given if o is not one),
            one,
            True,
        )
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


def _of_views(
    outlines: Sequence[Outline],
    others: list[_Other],
    ious: Array,
    as_given: Array,
    tells: NDArray[np.bool_],
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
            0.0
            if _of_all(other, known) or ious[k, rest].mean() >= as_given[rest].mean() + SIMILAR
            else ious[k, i]
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
        score = occluded(on_known(view.camera.project(points)[0], view), view)
        if score is not None:
            suspects.append(
                Suspect(
                    f"something hides a part of the object in {view.name}", "--ignore FILE", score
                )
            )
    return tuple(suspects)


def _is_box(outline: Outline, points: Array) -> bool:
    """Whether the mask is a filled rectangle beside background, and the silhouette of ``points`` [N, 3] is not."""
    view = outline.view
    left, top, right, bottom = object_box(view.inside)
    if outline.may_be_inverted or min(right - left, bottom - top) < FEWEST_PIXELS:
        return False
    if view.inside[top:bottom, left:right].mean() < FILLED:
        return False
    pixels = on_known(view.camera.project(points)[0], view)
    if len(pixels) < FEWEST_POINTS:
        return False
    low, high = np.quantile(pixels, [STRAYS, 1.0 - STRAYS], axis=0)
    size = np.maximum(high - low, 1e-9)
    cells = np.ceil(CELLS_OF_CLOUD * size / size.max())
    places = np.floor((pixels - low) / size * cells)
    inside = places[((places >= 0.0) & (places < cells)).all(1)]
    return len(np.unique(inside, axis=0)) < CLOUD_FILLED * float(cells.prod())
