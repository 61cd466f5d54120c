"""The training of a prior: batches, loss, steps."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial

import numpy as np
import torch
from torch import Tensor

from ..trainer import prefetched, require_finite, run
from .bank import Bank
from .config import AVERAGING, PriorConfig
from .loss import loss
from .shapes import Progress
from .starts import Batch, draw
from .state import PriorState

Objective = Callable[[Mapping[str, Tensor], Batch, torch.Generator], Tensor]
# A batch is computed in this many shares, each by one thread.
SHARES = 2
# Losses of single batches vary: progress shows their mean over this number of steps.
SHOWN_STEPS = 50


def train(
    bank: Bank,
    config: PriorConfig,
    state: PriorState,
    *,
    objective: Objective | None = None,
    progress: Progress | None = None,
    save: Callable[[PriorState], None] | None = None,
    save_every: int = 0,
    workers: int = 1,
) -> str:
    """Train until ``config.steps`` steps are done, or until Ctrl-C; the current step is finished.

    Parameters
    ----------
    state : is changed in place. One whose steps are all done is saved as it is.
    objective : the parts of the loss of a batch, as a function of the weights.
    progress : called after every step with (step, steps, note).
    workers : threads that share each step; their number does not change the result.
    save : called with the state every ``save_every`` steps (0: never) and at the end.

    Returns "max_steps" or "interrupted" (Ctrl-C). Raises TsoError if the loss is not finite.
    """
    objective = objective or partial(loss, precision=config.precision)
    pool = ThreadPoolExecutor(min(workers, SHARES), thread_name_prefix="tso-share")

    def take(shares: list[Share]) -> str:
        gradients = pool.map(partial(_gradients, state.weights, objective), shares)
        _step(state, config, list(gradients), save_every if save else 0)
        mean = np.mean(state.history[-SHOWN_STEPS:], 0)
        return f"loss {mean.sum():.3f}, moves {mean[0]:.3f}"

    with pool, _one_thread():
        return run(
            state,
            config.steps,
            prefetched(partial(_draw, bank, config), state.step, config.steps, 1),
            take,
            progress=progress,
            save=partial(save, state) if save else None,
            save_every=save_every,
        )


Share = tuple[Batch, torch.Generator]


def _draw(bank: Bank, config: PriorConfig, step: int) -> list[Share]:
    """The shares of the batch of a step, and the random numbers of their losses.

    Both depend on seed and step alone.
    """
    sizes = [len(part) for part in np.array_split(np.arange(config.batch_size), SHARES)]
    shares = []
    for number, size in enumerate(sizes):
        if size:
            rng = np.random.default_rng([config.seed, 3, step, number])
            batch = draw(bank, rng, size)
            shares.append((batch, torch.Generator().manual_seed(int(rng.integers(2**63)))))
    return shares


def _gradients(
    weights: Mapping[str, Tensor], objective: Objective, share: Share
) -> tuple[Tensor, list[Tensor], int]:
    """The parts of the loss of a share of a batch, their gradients, and its size."""
    # Leaves of its own: several threads do not add to one gradient.
    own = {name: weight.detach().requires_grad_() for name, weight in weights.items()}
    parts = objective(own, *share)
    gradients = torch.autograd.grad(parts.sum(), list(own.values()))
    return parts.detach(), list(gradients), len(share[0].start)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Each worker computes with one thread, so that any number of workers gives the same bits."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


def _step(
    state: PriorState,
    config: PriorConfig,
    shares: Sequence[tuple[Tensor, list[Tensor], int]],
    save_every: int,
) -> None:
    """Change the weights by the mean of the gradients of the ``shares`` of a batch."""
    counts = [count / sum(count for *_, count in shares) for *_, count in shares]
    parts = sum(count * parts for count, (parts, _, _) in zip(counts, shares, strict=True))
    numbers = torch.as_tensor(parts).tolist()
    rate = f"at {config.rate(state.step):.2g} of the highest learning rate"
    require_finite(sum(numbers), state.step, rate, save_every)
    of_weights = zip(*(gradients for _, gradients, _ in shares), strict=True)
    mean = [
        sum(count * gradient for count, gradient in zip(counts, each, strict=True))
        for each in of_weights
    ]
    state.optimiser.step(mean, config.rate(state.step))
    state.history.append(numbers)
    state.update_average(state.weights, AVERAGING)
