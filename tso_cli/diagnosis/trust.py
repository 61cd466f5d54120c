"""What to think of a result: one ordered table of rules, read once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

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


def _always(facts: Facts) -> bool:
    return True


def _never(facts: Facts) -> bool:
    return False


def _if_small(facts: Facts) -> bool:
    return facts.far <= MOST_OF_DOUBTFUL


def _if_outvoted(facts: Facts) -> bool:
    """What is wrong with few views, the others outvote."""
    return facts.diagnosis.outvoted and facts.is_sure


@dataclass(frozen=True)
class Rule:
    """A row of the table.

    holds : when it decides. moves : whether the displacement is then taken. why : the reason, if
    there is one. confidence : what is said of it; by default it is not known.
    """

    holds: Callable[[Facts], bool]
    verdict: Verdict | None
    moves: Callable[[Facts], bool]
    why: Callable[[Facts], Why] = lambda facts: NO_REASON
    confidence: Callable[[Facts], float | None] = lambda facts: None


# The first rule that holds decides.
RULES = (
    # Something is probably wrong with the input.
    Rule(
        lambda facts: bool(facts.diagnosis.suspicious),
        "doubtful",
        _if_outvoted,
        lambda facts: (FINDING, words_of(facts.diagnosis)),
    ),
    Rule(
        lambda facts: bool(facts.notes(*UNSURE)),
        "doubtful",
        _never,
        lambda facts: facts.notes(*UNSURE)[0],
    ),
    Rule(
        lambda facts: min(facts.overlap) < LEAST_OVERLAP,
        "doubtful",
        _never,
        lambda facts: (
            "overlap",
            f"cloud and mask hardly overlap (IoU {min(facts.overlap):.2f})",
        ),
    ),
    Rule(
        lambda facts: bool(facts.notes(ASSUMED_CAMERA)) and facts.overlap[0] < LEAST_IF_ASSUMED,
        "doubtful",
        _never,
        lambda facts: facts.notes(ASSUMED_CAMERA)[0],
    ),
    # The start stays. Only one that explains its masks whole is sure to be right.
    Rule(
        lambda facts: facts.stays and facts.diagnosis.fits,
        "left",
        _never,
        confidence=lambda facts: None if facts.diagnosis.hidden else 1.0,
    ),
    Rule(
        lambda facts: facts.stays,
        "left",
        _never,
        lambda facts: (
            "unexplained",
            "nothing that was tried agrees better with the masks, and the cloud misses "
            f"{facts.missed[0]:.0%} of their contours",
        ),
    ),
    # Nothing is known of what moved.
    Rule(
        lambda facts: facts.unknown != NO_REASON,
        None,
        _always,
        lambda facts: facts.unknown,
    ),
    # A move that was asked for is made; one that nobody asked for may be a mistake of the camera.
    Rule(
        lambda facts: facts.placed and facts.asked and not facts.explains,
        "doubtful",
        _always,
        lambda facts: (
            "move",
            f"the cloud missed {facts.missed[0]:.0%} of the contours, and misses "
            f"{facts.missed[1]:.0%} in its new place",
        ),
    ),
    # What its place gained is more than what its shape could lose.
    Rule(lambda facts: facts.placed and facts.asked, "fits better", _always),
    Rule(
        lambda facts: facts.placed and not facts.asked,
        "doubtful",
        _if_small,
        lambda facts: (
            "place",
            "the cloud was out of place, or the camera is: masks cannot tell",
        ),
    ),
    Rule(
        lambda facts: not facts.is_sure,
        "doubtful",
        _if_small,
        lambda facts: (facts.group, REASONS[facts.group]),
        lambda facts: facts.confidence,
    ),
    Rule(_always, "fits better", _always, confidence=lambda facts: facts.confidence),
)


def trust_of(facts: Facts, features: dict[str, float] | None = None) -> Trust:
    """What the first rule that holds says."""
    rule = next(rule for rule in RULES if rule.holds(facts))
    verdict, confidence, moves = rule.verdict, rule.confidence(facts), rule.moves(facts)
    return Trust(verdict, confidence, *rule.why(facts), moves, features or {})


def words_of(diagnosis: Diagnosis) -> str:
    """What looks wrong, in words."""
    joined = " or ".join if diagnosis.of_input else "; ".join
    return f"it looks as if {joined(finding.says for finding in diagnosis.suspicious)}"
