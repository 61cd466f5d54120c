"""The training of a prior: batches, loss, steps."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from contextlib import closing

import numpy as np
import torch
from torch import Tensor

from ...errors import TsoError
from ...signals import at_interrupt
from ..loop import prefetched
from .bank import Bank
from .config import LEARNING_RATE, LONGEST_GRADIENT, PriorConfig
from .loss import loss
from .shapes import Progress
from .starts import Batch, draw
from .state import PriorState

Objective = Callable[[Mapping[str, Tensor], Batch, torch.Generator], Tensor]
# Losses of single batches vary: progress shows their mean over this number of steps.
SHOWN_STEPS = 50


def train(
    bank: Bank,
    config: PriorConfig,
    state: PriorState,
    *,
    objective: Objective = loss,
    progress: Progress | None = None,
    save: Callable[[PriorState], None] | None = None,
    save_every: int = 0,
) -> str:
    """Train until ``config.steps`` steps are done, or until Ctrl-C; the current step is finished.

    Parameters
    ----------
    state : is changed in place. One whose steps are all done is saved as it is.
    objective : the loss of a batch, as a function of the weights.
    progress : called after every step with (step, steps, note).
    save : called with the state every ``save_every`` steps (0: never) and at the end.

    Returns "max_steps" or "interrupted" (Ctrl-C). Raises TsoError if the loss is not finite.
    """
    pressed = threading.Event()
    upcoming = prefetched(lambda step: _draw(bank, config, step), state.step, config.steps, 1)
    with at_interrupt(pressed.set, once=True), closing(upcoming):
        while state.step < config.steps and not pressed.is_set():
            batch, generator = next(upcoming)
            _step(state, config, objective(state.weights, batch, generator))
            if progress:
                mean = float(np.mean(state.history[-SHOWN_STEPS:]))
                progress(state.step, config.steps, f"loss {mean:.3f}")
            if save and save_every and state.step % save_every == 0 and state.step < config.steps:
                save(state)
        if save:
            save(state)
    return "max_steps" if state.step >= config.steps else "interrupted"


def _draw(bank: Bank, config: PriorConfig, step: int) -> tuple[Batch, torch.Generator]:
    """The batch of a step, and the random numbers of its loss; both depend on seed and step."""
    rng = np.random.default_rng([config.seed, 3, step])
    batch = draw(bank, rng, config.batch_size)
    return batch, torch.Generator().manual_seed(int(rng.integers(2**63)))


def _step(state: PriorState, config: PriorConfig, value: Tensor) -> None:
    """Change the weights by the gradient of the loss ``value``."""
    number = float(value.detach())
    if not np.isfinite(number):
        raise TsoError(
            f"the loss became {number} in step {state.step + 1} (learning rate {LEARNING_RATE:g})"
        )
    state.optimiser.zero_grad(set_to_none=True)
    value.backward()
    torch.nn.utils.clip_grad_norm_(state.weights.values(), LONGEST_GRADIENT)
    for group in state.optimiser.param_groups:
        group["lr"] = config.learning_rate(state.step)
    state.optimiser.step()
    state.history.append(number)
    state.update_average()
