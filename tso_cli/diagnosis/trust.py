"""What to think of a result: one ordered table of rules, read once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

from .confidence import REASONS
from .examine import Diagnosis
from .findings import ASSUMED_CAMERA

Verdict = Literal["fits better", "left", "doubtful"]
FINDING = "finding"
"""The reason of a result that is doubtful because of a suspicious finding."""
UNSURE = ("unsure-camera", "unsure-place")
"""The notes that say that a pose found in all directions is unsure."""

# A result with less confidence is doubtful. Chosen on scenes of training shapes (`tso lab
# confidence`), each rated by a fit without its shape.
LEAST_CONFIDENCE = 0.8
# What is doubtful moves at most so far, as a root mean square in longest sides: less harm is small,
# and most gains of doubtful results are larger risks.
MOST_OF_DOUBTFUL = 0.07
# With less IoU, before or after, a cloud hardly touches its mask, and nothing is sure.
LEAST_OVERLAP = 0.1
# With less IoU before, a camera that nobody gave is probably not the right one: of validation
# clouds of other shapes, seen by their own camera, 95 % fit better.
LEAST_IF_ASSUMED = 0.33
# A result that misses more of the contours than before, by this share, got worse.
MORE_MISSED = 0.03


@dataclass(frozen=True)
class Facts:
    """What a verdict depends on.

    improved : whether the shape moved, or could move, to where it agrees better.
    placed : whether the cloud moved as one; asked : and that was asked for; explains : and it then
        fits. far : how far all of this moved the points, a root mean square in longest sides.
    missed : shares of the contours that the cloud misses, before and after. overlap : mean IoU of
        the views, before and after the shape moved.
    confidence, group : of the model, and the group of features that lowers it most.
    unknown : why there is no confidence, as a name and in words; None where there is one.
    """

    diagnosis: Diagnosis
    improved: bool
    placed: bool
    asked: bool
    explains: bool
    far: float
    missed: tuple[float, float]
    overlap: tuple[float, float]
    confidence: float = 1.0
    group: str = ""
    unknown: tuple[str, str] | None = None

    def notes(self, *names: str) -> list[str]:
        """What the notes with these ``names`` say."""
        return [note.says for note in self.diagnosis.notes if note.name in names]

    @property
    def is_small(self) -> bool:
        return self.far <= MOST_OF_DOUBTFUL

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
    reason : the name of the rule, or the group of features that lowers the confidence most
        (`REASONS`), if doubtful or without a confidence; else "".
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


@dataclass(frozen=True)
class Rule:
    """A row of the table.

    holds : when it decides. moves : whether the displacement is then taken. says : why, in words.
    confidence : what is said of it, if anything.
    """

    reason: str
    holds: Callable[[Facts], bool]
    verdict: Verdict | None
    moves: Callable[[Facts], bool]
    says: Callable[[Facts], str] = lambda facts: ""
    confidence: Callable[[Facts], float | None] = lambda facts: None


def _never(facts: Facts) -> bool:
    return False


def _always(facts: Facts) -> bool:
    return True


# The first rule that holds decides.
RULES = (
    # Something is probably wrong with the input. What is wrong with few views, the others outvote.
    Rule(
        FINDING,
        lambda facts: bool(facts.diagnosis.suspicious),
        "doubtful",
        lambda facts: facts.diagnosis.outvoted and facts.is_sure,
        lambda facts: words_of(facts.diagnosis),
    ),
    Rule(
        UNSURE[0],
        lambda facts: bool(facts.notes(UNSURE[0])),
        "doubtful",
        _never,
        lambda facts: facts.notes(UNSURE[0])[0],
    ),
    Rule(
        UNSURE[1],
        lambda facts: bool(facts.notes(UNSURE[1])),
        "doubtful",
        _never,
        lambda facts: facts.notes(UNSURE[1])[0],
    ),
    Rule(
        "overlap",
        lambda facts: min(facts.overlap) < LEAST_OVERLAP,
        "doubtful",
        _never,
        lambda facts: f"cloud and mask hardly overlap (IoU {min(facts.overlap):.2f})",
    ),
    Rule(
        ASSUMED_CAMERA,
        lambda facts: bool(facts.notes(ASSUMED_CAMERA)) and facts.overlap[0] < LEAST_IF_ASSUMED,
        "doubtful",
        _never,
        lambda facts: facts.notes(ASSUMED_CAMERA)[0],
    ),
    # The start stays. Only of one that fits is that sure to be right.
    Rule(
        "fits",
        lambda facts: facts.diagnosis.fits and not facts.improved and not facts.placed,
        "left",
        _never,
        confidence=lambda facts: 1.0,
    ),
    Rule(
        "unexplained",
        lambda facts: not facts.improved and not facts.placed,
        "left",
        _never,
        lambda facts: (
            "nothing that was tried agrees better with the masks, and the cloud misses "
            f"{facts.missed[0]:.0%} of their contours"
        ),
    ),
    Rule(
        "",
        lambda facts: facts.unknown is not None,
        None,
        _always,
        lambda facts: facts.unknown[1] if facts.unknown else "",
    ),
    # A move that was asked for is made; one that nobody asked for may be a mistake of the camera.
    Rule(
        "move",
        lambda facts: facts.placed and facts.asked and not facts.explains,
        "doubtful",
        _always,
        lambda facts: (
            f"the cloud misses {facts.missed[1]:.0%} of the contours in its new place too"
        ),
    ),
    Rule(
        "place",
        lambda facts: facts.placed and not facts.asked,
        "doubtful",
        lambda facts: facts.is_small,
        lambda facts: "the cloud was out of place, or the camera is: masks cannot tell",
    ),
    Rule(
        "misfit",
        lambda facts: facts.missed[1] > facts.missed[0] + MORE_MISSED,
        "doubtful",
        _never,
        lambda facts: (
            f"the cloud misses {facts.missed[1]:.0%} of the contours afterwards, before "
            f"{facts.missed[0]:.0%}"
        ),
    ),
    Rule(
        "",
        lambda facts: not facts.is_sure,
        "doubtful",
        lambda facts: facts.is_small,
        lambda facts: REASONS.get(facts.group, ""),
        lambda facts: facts.confidence,
    ),
    Rule("", _always, "fits better", _always, confidence=lambda facts: facts.confidence),
)


def judged(facts: Facts, features: dict[str, float] | None = None) -> Trust:
    """What the first rule that holds says."""
    rule = next(rule for rule in RULES if rule.holds(facts))
    reason = rule.reason
    if not reason and rule.verdict is None and facts.unknown:
        reason = facts.unknown[0]
    elif not reason and rule.verdict == "doubtful":
        reason = facts.group
    return Trust(
        rule.verdict,
        rule.confidence(facts),
        reason,
        rule.says(facts),
        rule.moves(facts),
        features or {},
    )


def words_of(diagnosis: Diagnosis) -> str:
    """What looks wrong, in words."""
    joined = " or ".join if diagnosis.of_input else "; ".join
    return f"it looks as if {joined(finding.says for finding in diagnosis.suspicious)}"
