"""Short optimisations, loosely held and without detail, whose final losses are compared."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from ..cloud.smooth_field import SmoothField
from .field_optimisation import optimise_field
from .loop import Optimised
from .presets import COMPARISON, COMPARISON_RATE, COMPARISON_STEPS
from .problem import Problem

# The share of the time left that a comparison may take.
TIME_SHARE = 0.5
# This number of steps shows how long two optimisations will take, up to this factor.
TIMED_STEPS, TIMING_FACTOR = 6, 1.5


def final_losses(
    problems: Sequence[Problem],
    weights: Sequence[float],
    field: SmoothField,
    until: float = math.inf,
) -> list[float] | None:
    """The losses that problems of the same cloud end with after a few steps.

    ``weights`` are of the given views; ``field`` is of the start. None if the optimisations do not
    fit into a part of the time left ``until`` then (`time.perf_counter`).

    Raises KeyboardInterrupt where Ctrl-C ended one of them.
    """
    runs: list[Callable[..., Optimised]] = [
        partial(optimise_field, problem, weights, field, COMPARISON, COMPARISON_RATE)
        for problem in problems
    ]
    end = time.perf_counter() + TIME_SHARE * (until - time.perf_counter())
    if end < math.inf and not _in_time(runs, end):
        return None
    losses = []
    for run in runs:
        optimised = run(COMPARISON_STEPS, until=end)
        if optimised.interrupted:
            raise KeyboardInterrupt
        if optimised.out_of_time:
            return None
        # `best_loss` has no position prior, which says how far the cloud had to move.
        losses.append(float(np.nanmin(optimised.losses)))
    return losses


def _in_time(runs: Sequence[Callable[..., Optimised]], end: float) -> bool:
    """Whether all are done by the ``end``; each takes at most as long as the first."""
    # The first time, factors are computed that later runs use.
    for steps in (0, TIMED_STEPS):
        if (started := time.perf_counter()) >= end:
            return False
        if runs[0](steps).interrupted:
            raise KeyboardInterrupt
    now = time.perf_counter()
    longer = TIMING_FACTOR * len(runs) / 2 * COMPARISON_STEPS / TIMED_STEPS
    return now + longer * (now - started) < end
