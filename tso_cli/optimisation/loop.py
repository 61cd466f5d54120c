"""The one optimisation loop: any parameters, the best iterate kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from ..errors import is_interrupt
from ..geometry.arrays import Array

if TYPE_CHECKING:
    from .learned_start import Beginning

Progress = Callable[[int, int, float, Array], None]
"""Called with (step, steps, loss, points [N, 3]) of each step but the start."""
Term = Callable[[Array], tuple[float, Array]]
"""The value of a loss at points [N, 3], and its gradient [N, 3]."""


class Parameters(Protocol):
    """What moves points."""

    def points(self) -> Array:
        """The points [N, 3] by the parameters as they are."""

    def step(self, gradient: Array) -> None:
        """Change the parameters by one step, by the gradient [N, 3] at the last `points`."""


@dataclass(frozen=True, eq=False)
class Optimised:
    """What an optimisation found.

    Attributes
    ----------
    best : [N, 3], the iterate with the lowest loss. best_step : its step.
    losses : where it began and after every step; the last is NaN where points or loss were not
        finite.
    interrupted : whether Ctrl-C ended the optimisation.
    first_loss, best_loss : of the start and of ``best``.
    begun : where `optimise_points` began, None in other optimisations.
    """

    best: Array
    best_step: int
    losses: list[float]
    interrupted: bool
    first_loss: float
    best_loss: float
    begun: Beginning | None = None

    @property
    def steps(self) -> int:
        """Steps that were taken and had a finite loss."""
        return int(np.isfinite(self.losses).sum()) - 1


def sum_of(terms: list[Term]) -> Term:
    """The sum of the terms."""

    def total(points: Array) -> tuple[float, Array]:
        value, gradient = terms[0](points)
        for term in terms[1:]:
            more, further = term(points)
            value, gradient = value + more, gradient + further
        return value, gradient

    return total


def minimise(
    parameters: Parameters,
    objective: Term,
    steps: int,
    on_progress: Progress | None = None,
) -> Optimised:
    """Minimise ``objective`` by ``parameters`` in ``steps`` steps.

    The loop ends early where the loss is 0, or points or loss are not finite.

    Raises KeyboardInterrupt before the loss of the start is known. Ctrl-C later ends the loop.
    """
    best, lowest, best_step = parameters.points(), np.inf, 0
    losses: list[float] = []
    interrupted = False
    try:
        for step in range(steps + 1):
            points = parameters.points()
            # Views do not see points that are not finite, and a search for neighbours would fail.
            finite = np.isfinite(points).all()
            value, gradient = objective(points) if finite else (np.nan, points)
            losses.append(value if np.isfinite(value) else np.nan)
            if not np.isfinite(value):
                break
            if value < lowest:
                # One assignment, so that Ctrl-C leaves all three of the same step.
                best, lowest, best_step = points, value, step
            if on_progress and step:
                on_progress(step, steps, value, points)
            if value == 0.0:
                break
            if step < steps:
                parameters.step(gradient)
    except (KeyboardInterrupt, SystemError) as error:
        if not losses or not is_interrupt(error):
            raise
        interrupted = True
    # Ctrl-C may come after the first loss is known and before it is the lowest.
    lowest = min(lowest, losses[0])
    return Optimised(best, best_step, losses, interrupted, losses[0], lowest)
