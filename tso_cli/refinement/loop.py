"""The one loop: Adam on whatever moves, for any number of clouds at once, with the best iterate of each kept."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ..adam import Adam
from ..kernels.choice import whole_batches

Progress = Callable[[int, int, float], None]

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
    best_beside : what moved beside the clouds ([B, ...] each), as it was at the best iterate of each.
    """

    best: Tensor
    best_step: NDArray[np.int64]
    losses: NDArray[np.float64]
    interrupted: bool
    best_beside: list[Tensor] = field(default_factory=list)


def descend(
    produce: Callable[[], Tensor],
    parameters: list[Tensor],
    objective: Callable[[Tensor], Tensor],
    steps: int,
    learning_rate: float,
    progress: Progress | None = None,
    beside: Sequence[Tensor] = (),
    beside_rate: float = 0.0,
) -> Descent:
    """Adam on ``parameters``.

    Parameters
    ----------
    produce : gives the clouds [B, N, 3] as the parameters have them.
    objective : gives their losses [B]. What moves one cloud must not show in the loss of another.
    steps : Adam steps; it ends earlier when no cloud is left that is finite and has a finite loss.
    progress : called after every step with (step, steps, mean loss of the clouds that have one).
    beside : [B, ...] each, moved too, with a learning rate of their own.

    Raises
    ------
    KeyboardInterrupt
        Before the loss of the start is known; later it ends the loop.
    """
    optimisers = [(Adam(parameters, learning_rate), len(parameters))]
    if beside:
        optimisers.append((Adam(list(beside), beside_rate), len(beside)))
    best_beside = [part.detach().clone() for part in beside]
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
            # Together, so that Ctrl-C finds all of one step.
            best, best_beside, lowest, best_step = (
                torch.where(better.view(-1, 1, 1), moved.detach(), best),
                [
                    torch.where(better.view(-1, *[1] * (b.ndim - 1)), b.detach(), kept)
                    for b, kept in zip(beside, best_beside, strict=True)
                ],
                torch.where(better, values, lowest),
                torch.where(better, step, best_step),
            )
            told = progress is not None and step > 0
            if (told or not whole_batches(best) or step % STEPS_UNREAD == 0) and not alive.any():
                break
            if progress and told:
                progress(step, steps, float(values[alive].mean()))
            if step < steps:
                grads = torch.autograd.grad(loss.sum(), [*parameters, *beside])
                for optimiser, count in optimisers:
                    optimiser.apply(grads[:count])
                    grads = grads[count:]
    except KeyboardInterrupt:
        if not losses:
            raise
        interrupted = True
    return Descent(best, best_step.cpu().numpy(), torch.stack(losses).cpu().numpy(), interrupted, best_beside)
