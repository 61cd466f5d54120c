"""The one optimisation loop: any parameters, the best iterate kept."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ..errors import is_interrupt

Array = NDArray[np.float64]
Progress = Callable[[int, int, float], None]
"""Called with (step, steps, loss)."""
Term = Callable[[Array], tuple[float, Array]]
"""The value of a loss at points [N, 3], and its gradient [N, 3]."""


StepDown = Callable[[Array], None]
"""Takes one step down a loss, by its gradient [N, 3] at the points that came with this function."""


class Parameters(Protocol):
    """What moves points."""

    def forward(self) -> tuple[Array, StepDown]:
        """The points [N, 3], and the step from there."""


@dataclass(frozen=True, eq=False)
class Descent:
    """The result of a descent.

    Attributes
    ----------
    best : [N, 3], the iterate with the lowest loss. best_step : its step.
    losses : at the start and after every step; the last is NaN where points or loss were not finite.
    interrupted : Ctrl-C ended it. out_of_time : its time did.
    first_loss, best_loss : of the start and of ``best``. stages : the best of each stage, [N, 3]; objective : of the last.
    """

    best: Array
    best_step: int
    losses: list[float]
    interrupted: bool
    first_loss: float
    best_loss: float
    stages: tuple[Array, ...] = ()
    objective: Term | None = None
    out_of_time: bool = False


def offset_progress(on_progress: Progress, done: int, total: int) -> Progress:
    """Reports the steps of a part after ``done`` of ``total`` steps."""
    return lambda step, _steps_of_part, loss: on_progress(done + step, total, loss)


def sum_of(terms: list[Term]) -> Term:
    """The sum of the terms."""

    def total(points: Array) -> tuple[float, Array]:
        value, gradient = terms[0](points)
        for term in terms[1:]:
            more, further = term(points)
            value, gradient = value + more, gradient + further
        return value, gradient

    return total


def descend(
    parameters: Parameters,
    objective: Term,
    steps: int,
    on_progress: Progress | None = None,
    until: float = math.inf,
) -> Descent:
    """Minimise ``objective`` by ``parameters`` in ``steps`` steps.

    There are fewer where the loss is 0, points or loss are not finite, or ``until`` has passed (`time.perf_counter`).

    Raises KeyboardInterrupt before the loss of the start is known; later it ends the loop.
    """
    best, lowest, best_step = parameters.forward()[0], np.inf, 0
    losses: list[float] = []
    interrupted = out_of_time = False
    try:
        for step in range(steps + 1):
            points, step_down = parameters.forward()
            # Views do not see points that are not finite, and a search for their neighbours would fail.
            value, gradient = objective(points) if np.isfinite(points).all() else (np.nan, points)
            losses.append(value if np.isfinite(value) else np.nan)
            if not np.isfinite(value):
                break
            if value < lowest:
                # One assignment, so that Ctrl-C leaves all three of the same step.
                best, lowest, best_step = points, value, step
            if on_progress and step:
                on_progress(step, steps, value)
            out_of_time = 0 < step < steps and time.perf_counter() >= until
            if value == 0.0 or out_of_time:
                break
            if step < steps:
                step_down(gradient)
    except (KeyboardInterrupt, SystemError) as error:
        if not losses or not is_interrupt(error):
            raise
        interrupted = True
    # Ctrl-C may fall between the loss of the start and its being the lowest.
    return Descent(
        best,
        best_step,
        losses,
        interrupted,
        losses[0],
        min(lowest, losses[0]),
        out_of_time=out_of_time,
    )
