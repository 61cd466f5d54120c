"""What a refinement decided from its scene, why, and what work each decision saved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from ..io.shipped import NO_PRIOR
from ..optimisation.loop import Optimised
from ..optimisation.presets import default_steps
from ..optimisation.problem import Problem
from ..optimisation.settings import Settings


@dataclass(frozen=True)
class Decision:
    """One of the decisions.

    saving : the share of the work that was saved: of the masks' pixels, the points, the steps, or
        the work that a mirror plane takes.
    """

    what: str
    choice: str
    reason: str
    saving: float

    def document(self) -> dict[str, Any]:
        return {**asdict(self), "saving": round(self.saving, 3)}


def decisions(problem: Problem, settings: Settings, optimised: Optimised) -> tuple[Decision, ...]:
    """Of the default preset in points mode; other modes and presets decide nothing."""
    if not settings.smooth:
        return ()
    return (
        _window(problem),
        _points(problem, settings),
        _steps(problem, settings, optimised),
        _symmetry(problem),
    )


def _window(problem: Problem) -> Decision:
    pixels = sum(view.mask.size for view in problem.views)
    seen = 0.0
    for windowed in problem.given:
        left, top, right, bottom = windowed.resampled.box
        height, width = windowed.view.mask.shape
        across = min(right, width - 0.5) - max(left, -0.5)
        down = min(bottom, height - 0.5) - max(top, -0.5)
        seen += max(across, 0.0) * max(down, 0.0)
    share = seen / pixels
    return Decision(
        "window", f"{share:.0%} of the masks", "cloud and object are there", 1.0 - share
    )


def _points(problem: Problem, settings: Settings) -> Decision:
    cloud = problem.cloud
    control, of = len(cloud.control_points), len(cloud.measured)
    if control == of:
        return Decision("points", f"{control}", "all: there are no more", 0.0)
    reason = "a mask shows hardly more; the other points follow"
    if "points" in settings.given:
        asked = control == settings.points
        reason = "as asked for" if asked else "a surface has no more control points"
    return Decision("points", f"{control} of {of}", reason, 1.0 - control / of)


def _steps(problem: Problem, settings: Settings, optimised: Optimised) -> Decision:
    done, seen = optimised.steps, problem.observations
    enough = default_steps(seen, settings.prior != NO_PRIOR)
    reason = f"{enough} are enough for {'one mask' if seen == 1 else 'what is seen'}"
    if optimised.interrupted:
        reason = "interrupted"
    elif done + 1 < len(optimised.losses):
        reason = "the loss was not a number after them"
    elif done < settings.steps:
        reason = "no loss was left"
    elif "steps" in settings.given:
        reason = "as asked for"
    saving = 1.0 - done / max(done, enough)
    return Decision("steps", f"{done}", reason, saving)


def _symmetry(problem: Problem) -> Decision:
    """With a plane the optimisation sees the flipped views too."""
    used = problem.symmetry.plane is not None
    choice, saving = ("used", 0.0) if used else ("not used", 0.5)
    return Decision("mirror plane", choice, problem.symmetry.reason, saving)


def document_of(decided: Sequence[Decision]) -> list[dict[str, Any]]:
    """For JSON."""
    return [decision.document() for decision in decided]
