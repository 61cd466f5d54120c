"""What a refinement spent on its scene, and what it saved: each decision with its reason."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ..optimisation.loop import Descent
from ..optimisation.presets import FULL_STEPS, SHORT_POINTS, SYMMETRY_PROBE_STEPS
from ..optimisation.problem import Problem
from ..optimisation.resampled_view import FINE_GRIDS
from .config import Settings, staged_steps


@dataclass(frozen=True)
class Decision:
    """One of the decisions.

    saving : share that was spared: of the pixels of the masks, the cells of the finest grid, the points, the steps of the
        budget "full", or the work that a mirror plane takes.
    """

    what: str
    choice: str
    reason: str
    saving: float

    def document(self) -> dict[str, Any]:
        return {**asdict(self), "saving": round(self.saving, 3)}


def decisions(problem: Problem, settings: Settings, descent: Descent) -> tuple[Decision, ...]:
    """Of the default preset in points mode; of other modes and presets none, which do as they are told."""
    if not settings.staged:
        return ()
    return (
        _window(problem),
        _grid(problem),
        _points(problem, settings),
        _steps(problem, settings, descent),
        _symmetry(problem, settings),
    )


def _window(problem: Problem) -> Decision:
    pixels = sum(view.mask.size for view in problem.views)
    seen = 0.0
    for view, resampled in zip(problem.views, problem.resampled, strict=False):
        left, top, right, bottom = resampled.box
        height, width = view.mask.shape
        across, down = (
            min(right, width - 0.5) - max(left, -0.5),
            min(bottom, height - 0.5) - max(top, -0.5),
        )
        seen += max(across, 0.0) * max(down, 0.0)
    return Decision(
        "window",
        f"{seen / pixels:.0%} of the masks",
        "cloud and object are there",
        1.0 - seen / pixels,
    )


def _grid(problem: Problem) -> Decision:
    cells = [view.camera.width for view in problem.resampled[: len(problem.views)]]
    finest = FINE_GRIDS[0][1]
    saving = 1.0 - sum(count**2 for count in cells) / (len(cells) * finest**2)
    reason = (
        "the window's pixels, and the moving points, resolve no more"
        if saving
        else "the masks resolve as much"
    )
    choice = ", ".join(f"{count}x{count}" for count in dict.fromkeys(cells))
    return Decision("cells", f"{choice} in the last stage", reason, saving)


def _points(problem: Problem, settings: Settings) -> Decision:
    cloud = problem.cloud
    moving, of = len(cloud.initial), len(cloud.judged)
    if moving == of:
        return Decision("points", f"{moving}", "all: there are no more", 0.0)
    reason = "a mask shows hardly more; the others follow"
    if "points" in settings.given:
        reason = (
            "so many were asked for"
            if moving == settings.points
            else "of a surface no more samples are taken"
        )
    elif settings.points == SHORT_POINTS:
        reason = f"{settings.seconds:g} s are short"
    return Decision("points", f"{moving} of {of}", reason, 1.0 - moving / of)


def _steps(problem: Problem, settings: Settings, descent: Descent) -> Decision:
    done = int(np.isfinite(descent.losses).sum()) - 1
    masks = len(problem.views)
    enough = staged_steps(masks)
    most = max(done, FULL_STEPS * enough)
    reason = f"{enough} are enough for {masks} mask{'s' * (masks > 1)}"
    if descent.interrupted:
        reason = "interrupted"
    elif descent.out_of_time:
        reason = f"{settings.seconds:g} s were over"
    elif done + 1 < len(descent.losses):
        reason = "the loss was no number after them"
    elif done < settings.steps:
        reason = "no loss was left"
    elif "steps" in settings.given:
        reason = "so many were asked for"
    elif settings.full:
        reason = "the budget is full"
    elif settings.steps > enough:
        reason = f"the start fits {masks} large masks badly"
    return Decision("steps", f"{done}", reason, 1.0 - done / most)


def _symmetry(problem: Problem, settings: Settings) -> Decision:
    """The check descends with the given masks and with the flipped ones too; with a plane the refinement sees both."""
    symmetry = problem.symmetry
    checked = symmetry.loss_ratio is not None
    steps = settings.steps / len(problem.views)
    work = 3 * SYMMETRY_PROBE_STEPS * checked + (1 + (symmetry.plane is not None)) * steps
    saving = 1.0 - work / (3 * SYMMETRY_PROBE_STEPS + 2 * steps)
    choice = ("checked, " if checked else "") + ("used" if symmetry.plane else "not used")
    return Decision("mirror plane", choice, symmetry.reason, saving)
