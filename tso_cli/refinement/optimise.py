"""The one optimisation loop: any parameters, any number of clouds at once, the best iterate of each kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..kernels.dispatch import whole_batches
from .adam import Adam, UniformAdam

Progress = Callable[[int, int, float], None]
Objective = Callable[[Tensor], Tensor]

# Reading a loss from a GPU waits for all its work, so the check for finished clouds is made every so many steps.
STEPS_UNREAD = 10


def offset_progress(on_progress: Progress, done: int, total: int) -> Progress:
    """Reports the steps of a part after ``done`` of ``total`` steps."""
    return lambda step, _steps_of_part, loss: on_progress(done + step, total, loss)


@dataclass(frozen=True, eq=False)
class Descent:
    """The result of a descent of B clouds.

    Attributes
    ----------
    best : [B, N, 3], the iterate of each with the lowest loss. best_step : [B], its step.
    losses : [steps + 1, B], at the start and after every step; NaN once a cloud or its loss is not finite.
    interrupted : Ctrl-C ended it.
    first_loss, best_loss : [B], of the start and of ``best``.
    """

    best: Tensor
    best_step: NDArray[np.int64]
    losses: NDArray[np.float64]
    interrupted: bool
    first_loss: NDArray[np.float64]
    best_loss: NDArray[np.float64]


def descend(
    forward: Callable[[], Tensor],
    objective: Objective,
    optimiser: Adam | UniformAdam,
    steps: int,
    on_progress: Progress | None = None,
) -> Descent:
    """Minimise ``objective(forward())``.

    Parameters
    ----------
    forward : the clouds [B, N, 3] as functions of the optimiser's parameters.
    objective : their losses [B]. No cloud may show in the loss of another.
    steps : at most; it ends earlier when no cloud is left that is finite and has a finite loss.
    on_progress : called after every step with (step, steps, mean of the finite losses).

    Raises
    ------
    KeyboardInterrupt
        Before the loss of the start is known; later it ends the loop.
    """
    best = forward().detach().clone()
    lowest = torch.full((len(best),), torch.inf, dtype=torch.float64, device=best.device)
    alive = torch.ones_like(lowest, dtype=torch.bool)
    best_step = torch.zeros_like(lowest, dtype=torch.int64)
    losses: list[Tensor] = []
    interrupted = False
    try:
        for step in range(steps + 1):
            points = forward()
            loss = objective(points)
            values = loss.detach().double()
            # Non-finite points are invisible to the views, so the loss alone may not show them; their sum does.
            alive = alive & torch.isfinite(values) & torch.isfinite(points.detach().sum((1, 2)))
            losses.append(torch.where(alive, values, torch.nan))
            better = alive & (values < lowest)
            # One assignment, so that Ctrl-C leaves all three of the same step.
            best, lowest, best_step = (
                torch.where(better.view(-1, 1, 1), points.detach(), best),
                torch.where(better, values, lowest),
                torch.where(better, step, best_step),
            )
            report = on_progress is not None and step > 0
            if (report or not whole_batches(best) or step % STEPS_UNREAD == 0) and not alive.any():
                break
            if on_progress and report:
                on_progress(step, steps, float(values[alive].mean()))
            if step < steps:
                optimiser.step(loss.sum())
    except KeyboardInterrupt:
        if not losses:
            raise
        interrupted = True
    history = torch.stack(losses).cpu().numpy()
    return Descent(best, best_step.cpu().numpy(), history, interrupted, history[0], lowest.cpu().numpy())
