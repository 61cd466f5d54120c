"""The one loop: Adam on whatever moves, for any number of clouds at once, with the best iterate of each kept."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..adam import Adam

Progress = Callable[[int, int, float], None]


@dataclass(frozen=True, eq=False)
class Descent:
    """Where B clouds came to.

    Attributes
    ----------
    best : [B, N, 3], the iterate of each with the lowest loss; best_step : [B], the step it is from.
    losses : [steps + 1, B], at the start and after every step; NaN once a cloud's loss was no number.
    interrupted : Ctrl-C ended it.
    """

    best: Tensor
    best_step: NDArray[np.int64]
    losses: NDArray[np.float64]
    interrupted: bool


def descend(
    produce: Callable[[], Tensor],
    parameters: list[Tensor],
    objective: Callable[[Tensor], Tensor],
    steps: int,
    learning_rate: float,
    progress: Progress | None = None,
) -> Descent:
    """Adam on ``parameters``.

    Parameters
    ----------
    produce : gives the clouds [B, N, 3] as the parameters have them.
    objective : gives their losses [B]. What moves one cloud must not show in the loss of another.
    steps : Adam steps; it ends earlier when no cloud has a finite loss.
    progress : called after every step with (step, steps, mean loss of the clouds that have one).

    Raises
    ------
    KeyboardInterrupt
        Before the loss of the start is known; later it ends the loop.
    """
    optimiser = Adam(parameters, learning_rate)
    best = produce().detach().clone()
    best_step = np.zeros(len(best), np.int64)
    losses: list[NDArray[np.float64]] = []
    lowest = np.full(len(best), np.inf)
    interrupted = False
    try:
        for step in range(steps + 1):
            moved = produce()
            loss = objective(moved)
            values = loss.detach().double().cpu().numpy()
            alive = np.isfinite(values) & (np.isfinite(losses[-1]) if losses else True)
            losses.append(np.where(alive, values, np.nan))
            better = alive & (values < lowest)
            if better.all():
                best.copy_(moved.detach())
            elif better.any():
                index = torch.as_tensor(np.flatnonzero(better), device=best.device)
                best.index_copy_(0, index, moved.detach()[index])
            lowest, best_step = np.where(better, values, lowest), np.where(better, step, best_step)
            if not alive.any():
                break
            if progress and step:
                progress(step, steps, float(values[alive].mean()))
            if step < steps:
                optimiser.step(loss.sum())
    except KeyboardInterrupt:
        if not losses:
            raise
        interrupted = True
    return Descent(best, best_step, np.stack(losses), interrupted)
