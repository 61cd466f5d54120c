"""What to think of a result: one ordered table of rules, read once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal, NamedTuple

from .confidence import REASONS
from .examine import Diagnosis
from .findings import ASSUMED_CAMERA

Verdict = Literal["fits better", "left", "doubtful"]
Why = tuple[str, str]  # the name of a reason, and the reason in words
NO_REASON: Why = ("", "")
FINDING = "finding"
"""The reason of a result that is doubtful because of a suspicious finding."""
UNSURE = ("unsure-camera", "unsure-place")
"""The notes that say that a pose found in all directions is unsure."""

# A result with less confidence is doubtful. Of training shapes, one of 360 right scenes with starts
# of another shape is then worse without a word.
LEAST_CONFIDENCE = 0.82
# What is doubtful moves at most so far, as a root mean square in longest sides: less harm is small,
# and most gains of doubtful results are larger risks.
MOST_OF_DOUBTFUL = 0.07
# With less IoU, before or after, a cloud hardly touches its mask, and nothing is sure.
LEAST_OVERLAP = 0.1
# With less IoU before, a camera that nobody gave is probably not the right one: of validation
# clouds of other shapes, seen by their own camera, 95 % fit better.
LEAST_IF_ASSUMED = 0.33


@dataclass(frozen=True)
class Facts:
    """What a verdict depends on.

    improved : whether the shape moved, or could move, to where it agrees better.
    placed : whether the cloud moved as one; asked : and that was asked for; explains : and it then
        fits. far : how far all of this moved the points, a root mean square in longest sides.
    missed : shares of the contours that the cloud misses, before and after. overlap : mean IoU of
        the views, before and after the shape moved.
    confidence, group : of the model, and the group of features that lowers it most.
    unknown : why there is no confidence, if there is none.
    """

    diagnosis: Diagnosis
    improved: bool
    placed: bool
    asked: bool
    explains: bool
    far: float
    missed: tuple[float, float]
    overlap: tuple[float, float]
    confidence: float
    group: str
    unknown: Why = NO_REASON

    def notes(self, *names: str) -> list[Why]:
        """The notes with these ``names``, as reasons."""
        return [(note.name, note.says) for note in self.diagnosis.notes if note.name in names]

    @property
    def stays(self) -> bool:
        return not self.improved and not self.placed

    @property
    def is_sure(self) -> bool:
        return self.confidence >= LEAST_CONFIDENCE

    @property
    def is_small(self) -> bool:
        return self.far <= MOST_OF_DOUBTFUL


@dataclass(frozen=True)
class Trust:
    """What to think of a result.

    verdict : "fits better": the displacement probably does not harm; "left": nothing agrees better
        than the start; "doubtful": the displacement may harm, or the input is suspicious; None if
        nothing can be said.
    confidence : probability that the displacement does not make the cloud worse by over 5 %
        in Chamfer distance, in [0, 1]; 1 for a start that fits and stays; None if it is not known.
    reason : if doubtful or without a confidence, its name: what a rule names, or the group of
        features that lowers the confidence most (`REASONS`); else "".
    says : the reason in words; "" if there is none.
    moves : whether the displacement is taken without `accept_doubtful`.
    features : what the confidence is computed from.
    """

    verdict: Verdict | None
    confidence: float | None
    reason: str = ""
    says: str = ""
    moves: bool = True
    features: dict[str, float] = field(default_factory=dict)


class Rule(NamedTuple):
    """A row of the table: where it ``holds``, what to think of the result."""

    holds: Callable[[Facts], bool]
    trust: Callable[[Facts], Trust]


def _doubtful(
    reason: str, says: str, moves: bool = False, confidence: float | None = None
) -> Trust:
    return Trust("doubtful", confidence, reason, says, moves)


# The first rule that holds decides.
RULES = (
    # Something is probably wrong with the input. What is wrong with few views, the others outvote.
    Rule(
        lambda facts: bool(facts.diagnosis.suspicious),
        lambda facts: _doubtful(
            FINDING, words_of(facts.diagnosis), facts.diagnosis.outvoted and facts.is_sure
        ),
    ),
    Rule(
        lambda facts: bool(facts.notes(*UNSURE)),
        lambda facts: _doubtful(*facts.notes(*UNSURE)[0]),
    ),
    Rule(
        lambda facts: min(facts.overlap) < LEAST_OVERLAP,
        lambda facts: _doubtful(
            "overlap", f"cloud and mask hardly overlap (IoU {min(facts.overlap):.2f})"
        ),
    ),
    Rule(
        lambda facts: bool(facts.notes(ASSUMED_CAMERA)) and facts.overlap[0] < LEAST_IF_ASSUMED,
        lambda facts: _doubtful(*facts.notes(ASSUMED_CAMERA)[0]),
    ),
    # The start stays. Only one that explains its masks whole is sure to be right.
    Rule(
        lambda facts: facts.stays and facts.diagnosis.fits,
        lambda facts: Trust("left", None if facts.diagnosis.hidden else 1.0, moves=False),
    ),
    Rule(
        lambda facts: facts.stays,
        lambda facts: Trust(
            "left",
            None,
            "unexplained",
            "nothing that was tried agrees better with the masks, and the cloud misses "
            f"{facts.missed[0]:.0%} of their contours",
            moves=False,
        ),
    ),
    # Nothing is known of what moved.
    Rule(
        lambda facts: facts.unknown != NO_REASON,
        lambda facts: Trust(None, None, *facts.unknown),
    ),
    # A move that was asked for is made; one that nobody asked for may be a mistake of the camera.
    Rule(
        lambda facts: facts.placed and facts.asked and not facts.explains,
        lambda facts: _doubtful(
            "move",
            f"the cloud missed {facts.missed[0]:.0%} of the contours, and misses "
            f"{facts.missed[1]:.0%} in its new place",
            moves=True,
        ),
    ),
    # What its place gained is more than what its shape could lose.
    Rule(
        lambda facts: facts.placed and facts.asked,
        lambda facts: Trust("fits better", None),
    ),
    Rule(
        lambda facts: facts.placed and not facts.asked,
        lambda facts: _doubtful(
            "place",
            "the cloud was out of place, or the camera is: masks cannot tell",
            facts.is_small,
        ),
    ),
    Rule(
        lambda facts: not facts.is_sure,
        lambda facts: _doubtful(
            facts.group, REASONS[facts.group], facts.is_small, facts.confidence
        ),
    ),
    Rule(lambda facts: True, lambda facts: Trust("fits better", facts.confidence)),
)


def trust_of(facts: Facts, features: dict[str, float] | None = None) -> Trust:
    """What the first rule that holds says."""
    rule = next(rule for rule in RULES if rule.holds(facts))
    return replace(rule.trust(facts), features=features or {})


def words_of(diagnosis: Diagnosis) -> str:
    """What looks wrong, in words."""
    joined = " or ".join if diagnosis.of_input else "; ".join
    return f"it looks as if {joined(finding.says for finding in diagnosis.suspicious)}"
