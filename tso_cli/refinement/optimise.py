"""The one loop: Adam on whatever moves, for any number of clouds at once, with the best iterate of each kept."""

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

# On a GPU a step ends before its work is done. Reading waits for that work, so it is done every so many steps.
STEPS_UNREAD = 10


@dataclass(frozen=True, eq=False)
class Descent:
    """Where B clouds came to.

    Attributes
    ----------
    best : [B, N, 3], the iterate of each with the lowest loss; best_step : [B], the step it is from.
    losses : [steps + 1, B], at the start and after every step; NaN once a cloud or its loss was no finite number.
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
    produce: Callable[[], Tensor],
    parameters: list[Tensor],
    objective: Objective,
    steps: int,
    learning_rate: float,
    progress: Progress | None = None,
    optimiser_of: Callable[[list[Tensor], float], Adam | UniformAdam] = Adam,
) -> Descent:
    """Gradient steps on ``parameters``.

    Parameters
    ----------
    produce : gives the clouds [B, N, 3] as the parameters have them.
    objective : gives their losses [B]. What moves one cloud must not show in the loss of another.
    steps : at most so many; it ends earlier when no cloud is left that is finite and has a finite loss.
    progress : called after every step with (step, steps, mean loss of the clouds that have one).

    Raises
    ------
    KeyboardInterrupt
        Before the loss of the start is known; later it ends the loop.
    """
    optimiser = optimiser_of(parameters, learning_rate)
    best = produce().detach().clone()
    lowest = torch.full((len(best),), torch.inf, dtype=torch.float64, device=best.device)
    alive = torch.ones_like(lowest, dtype=torch.bool)
    best_step = torch.zeros_like(lowest, dtype=torch.int64)
    losses: list[Tensor] = []
    interrupted = False
    try:
        for step in range(steps + 1):
            moved = produce()
            loss = objective(moved)
            values = loss.detach().double()
            # A sum is finite where all that is added is. Points that are no number are not seen, and the loss may not tell.
            alive = alive & torch.isfinite(values) & torch.isfinite(moved.detach().sum((1, 2)))
            losses.append(torch.where(alive, values, torch.nan))
            better = alive & (values < lowest)
            # ViewBatch, so that Ctrl-C finds the three of one step.
            best, lowest, best_step = (
                torch.where(better.view(-1, 1, 1), moved.detach(), best),
                torch.where(better, values, lowest),
                torch.where(better, step, best_step),
            )
            told = progress is not None and step > 0
            if (told or not whole_batches(best) or step % STEPS_UNREAD == 0) and not alive.any():
                break
            if progress and told:
                progress(step, steps, float(values[alive].mean()))
            if step < steps:
                optimiser.step(loss.sum())
    except KeyboardInterrupt:
        if not losses:
            raise
        interrupted = True
    told_losses = torch.stack(losses).cpu().numpy()
    return Descent(best, best_step.cpu().numpy(), told_losses, interrupted, told_losses[0], lowest.cpu().numpy())
