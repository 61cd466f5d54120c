"""Settings of a refinement."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from ..errors import InputError
from ..geometry.points import CANDIDATES
from ..optimisation.presets import (
    BEST,
    BEST_GAMMA,
    BEST_LEARNING_RATE,
    BEST_STEPS,
    FEWEST_POINTS,
    FIELD_NODES,
    FULL,
    FULL_STEPS,
    MAX_VIEWS_FOR_STEPS,
    MODES,
    PAPER_GAMMA,
    PAPER_LEARNING_RATE,
    PAPER_SIGMA_SQ,
    PAPER_STEPS,
    PRESETS,
    SHORT_POINTS,
    SHORT_SECONDS,
    CoarseToFineConfig,
)


@dataclass(frozen=True)
class RefineConfig:
    """Settings of one refinement; None stands for the preset's value.

    Parameters
    ----------
    mode : what is optimised: "points", "encoder", "encoder-decoder" (the network's weights), or "latent" (its 128-vector).
    steps : of the optimiser; 0 returns the start. Paper 50; best 48 in points mode for each view, up to four, twice as many
        where the start fits several large masks badly, 12 for weights, 30 for the latent vector.
    learning_rate : for a cloud of longest side 1. Best: how far the point with the largest gradient moves in one of the first
        steps, 0.04; encoder 3e-5, encoder and decoder 6e-5, latent vector 1e-3. Paper: Adam's, 5e-4, 1e-6, 5e-6.
    gamma : weight of the Chamfer distance to the start (longest side 1). Best 0; paper 1e6, in encoder mode 0.
    sigma_sq : variance of the projection's Gaussian in squared cells of the window, which has 64 a side; 0.4, the paper's.
        Used by the preset "paper" and by ``refine_camera``; the mask Chamfer loss of "best" has no Gaussian.
    device : where the network is: "cpu", "cuda", "auto" or any name torch knows. Points mode needs none, and is on the CPU.
    preset : "best", or "paper": Eq. 7 with the paper's settings.
    symmetry : "auto" (best, points mode) searches a mirror plane of the start and uses it if the views agree; "none" (paper);
        "x", "y", "z": the axis normal to a plane through the middle of the start's bounding box; or "a,b,c,d": the plane
        ax + by + cz = d.
    refine_camera : first correct the camera of each view, held near the given one; points mode.
    accept_doubtful : take the whole step also where the result is doubtful, in place of a part of it or none.
    budget : "auto", what the scene is known to gain by; "full" (best, points mode), 96 steps for each view, with the
        finest grid in every stage; or seconds, in which "auto" comes to its end. Of each cloud of a batch.
    points : how many points of a cloud, or samples of a mesh (at most 4,096), move by themselves, at most (best, points
        mode); the others follow. None: 1,024, or 512 with a budget of less than 0.3 seconds a view.
    coarse_to_fine : settings of the preset "best" of points mode, for ablations.

    Raises
    ------
    InputError
        A value is out of range.
    """

    mode: str = "points"
    steps: int | None = None
    learning_rate: float | None = None
    gamma: float | None = None
    sigma_sq: float | None = None
    device: str = "cpu"
    preset: str = "best"
    symmetry: str | None = None
    refine_camera: bool = False
    accept_doubtful: bool = False
    budget: str | float = "auto"
    points: int | None = None
    coarse_to_fine: CoarseToFineConfig = BEST

    def __post_init__(self) -> None:
        for name, known in (("mode", MODES), ("preset", PRESETS)):
            if getattr(self, name) not in known:
                raise InputError(
                    f"{name} is {getattr(self, name)!r}, expected one of {', '.join(known)}"
                )
        if self.refine_camera and self.mode != "points":
            raise InputError(f"mode is {self.mode!r}, expected points to refine the camera")
        steps = self.steps
        if steps is not None and (
            isinstance(steps, bool) or not isinstance(steps, int) or steps < 0
        ):
            raise InputError(f"steps is {steps!r}, expected a whole number, 0 or more")
        for name, low, high in (
            ("learning_rate", 0.0, 1e6),
            ("gamma", -1.0, 1e15),
            ("sigma_sq", 0.0, 1e9),
        ):
            value = getattr(self, name)
            if value is not None and not (
                isinstance(value, (int, float)) and low < value <= high and value >= 0.0
            ):
                raise InputError(
                    f"{name} is {value!r}, expected a number {'>= 0' if low else '> 0'}, at most {high:g}"
                )
        if self.mode == "points" and self.device not in ("cpu", "auto"):
            raise InputError(
                f"device is {self.device!r}, expected cpu or auto: mode points has no network to put there"
            )
        if self.symmetry is not None:
            parse_symmetry(self.symmetry)
        if self.points is not None and (
            not isinstance(self.points, int) or not FEWEST_POINTS <= self.points <= CANDIDATES
        ):
            raise InputError(
                f"points is {self.points!r}, expected a whole number from {FEWEST_POINTS} to {CANDIDATES:,}"
            )
        budget = self.parsed_budget
        if budget == "full" and self.coarse_to_fine is not BEST:
            raise InputError(
                "budget is 'full', which has a coarse_to_fine of its own, found another"
            )
        staged_only = {
            "coarse_to_fine": self.coarse_to_fine is not BEST,
            "points": self.points is not None,
        }
        for name, used in (staged_only | {"budget full": budget == "full"}).items():
            if used and (self.preset, self.mode) != ("best", "points"):
                raise InputError(
                    f"{name} is for mode points with preset best, found {self.mode} with {self.preset}"
                )

    @property
    def parsed_budget(self) -> str | float:
        """``budget``, its seconds a number."""
        return _parse_budget(self.budget)

    def settings(self, views: int = 1) -> Settings:
        """The same with the preset's values in place of None, for clouds with ``views`` views each."""
        best = self.preset == "best"
        staged = best and self.mode == "points"
        steps = (staged_steps(views) if staged else BEST_STEPS[self.mode]) if best else PAPER_STEPS
        rates = BEST_LEARNING_RATE if best else PAPER_LEARNING_RATE
        gamma = BEST_GAMMA if best else PAPER_GAMMA[self.mode]
        defaults: dict[str, Any] = dict(
            steps=steps,
            learning_rate=rates[self.mode],
            gamma=gamma,
            symmetry="auto" if staged else "none",
            sigma_sq=PAPER_SIGMA_SQ,
            points=FIELD_NODES if staged else None,
        )
        budget = self.parsed_budget
        if budget == "full":
            defaults["steps"] = FULL_STEPS * steps
        elif isinstance(budget, float) and staged and budget < SHORT_SECONDS * views:
            defaults["points"] = SHORT_POINTS
        chosen = {
            name: value
            for name, value in vars(self).items()
            if value is not None and name != "budget"
        }
        if budget == "full":
            chosen["coarse_to_fine"] = FULL
        seconds = budget if isinstance(budget, float) else math.inf
        return Settings(
            **(defaults | chosen), seconds=seconds, full=budget == "full", given=frozenset(chosen)
        )


@dataclass(frozen=True)
class Settings:
    """A `RefineConfig` with every value known.

    points : that move by themselves, None for all. seconds : how long the refinement may take. full : whether the budget is.
    given : the names of the values that are not the preset's.
    """

    mode: str
    preset: str
    steps: int
    learning_rate: float
    gamma: float
    symmetry: str
    sigma_sq: float
    device: str
    refine_camera: bool
    accept_doubtful: bool
    points: int | None
    seconds: float
    full: bool
    coarse_to_fine: CoarseToFineConfig
    given: frozenset[str]

    @property
    def staged(self) -> bool:
        """Whether points move from coarse to fine, and not down the objective of Eq. 7."""
        return self.preset == "best" and self.mode == "points"


def staged_steps(views: int) -> int:
    """The default of the steps from coarse to fine; `run` may take more."""
    return BEST_STEPS["points"] * min(views, MAX_VIEWS_FOR_STEPS)


def _parse_budget(budget: str | float) -> str | float:
    """One of auto and full, or seconds, which may be given as text; InputError for anything else."""
    if isinstance(budget, str) and budget in ("auto", "full"):
        return budget
    try:
        seconds = float(budget)
    except (TypeError, ValueError):
        seconds = math.nan
    if isinstance(budget, bool) or not 0.0 < seconds < math.inf:
        raise InputError(f"budget is {budget!r}, expected auto, full or seconds")
    return seconds


def parse_symmetry(text: str) -> str | tuple[float, float, float, float]:
    """One of auto, none, x, y, z, or the four numbers of a,b,c,d; InputError for anything else."""
    if text in ("auto", "none", "x", "y", "z"):
        return text
    expected = "expected auto, none, x, y, z or four numbers a,b,c,d of the plane ax + by + cz = d"
    try:
        a, b, c, d = (float(part) for part in text.split(","))
    except (ValueError, AttributeError):
        raise InputError(f"symmetry is {text!r}, {expected}") from None
    if not (1e-100 < math.hypot(a, b, c) < 1e100 and abs(d) < 1e100):
        raise InputError(
            f"symmetry is {text!r}, whose normal has no direction or whose numbers are too large; {expected}"
        )
    return a, b, c, d
