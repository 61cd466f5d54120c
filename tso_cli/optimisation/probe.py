"""Short descents, loosely held and without detail, whose final losses are compared."""

from __future__ import annotations

import math
import time

from ..cloud.smooth_field import SmoothField
from .presets import BEST_LEARNING_RATE, SYMMETRY_PROBE, SYMMETRY_PROBE_STEPS
from .problem import Problem
from .stages import CoarseToFine

# Of the time left, what the descents may take.
TIME_SHARE = 0.5
# So many steps tell how long a descent will take.
TIMED_STEPS = 6


def probe(problem: Problem, weights: list[float], field: SmoothField) -> CoarseToFine:
    """A descent by the views of ``problem``, of these ``weights``; ``field`` is of the start."""
    return CoarseToFine(
        problem, weights, field, SYMMETRY_PROBE, BEST_LEARNING_RATE["points"], follow=False
    )


def final_losses(probes: list[CoarseToFine], until: float) -> list[float] | None:
    """The loss that each of two descents ends with; ``until`` as in `descend`.

    None if they do not fit into a part of the time that is left. Raises KeyboardInterrupt where Ctrl-C ended one.
    """
    end = time.perf_counter() + TIME_SHARE * (until - time.perf_counter())
    if end < math.inf and not _in_time(probes[0], end):
        return None
    losses = []
    for each in probes:
        descent, _ = each.run(SYMMETRY_PROBE_STEPS, until=end)
        if descent.interrupted:
            raise KeyboardInterrupt
        if descent.out_of_time:
            return None
        losses.append(descent.best_loss)
    return losses


def _in_time(first: CoarseToFine, end: float) -> bool:
    """Whether both descents will be done by the ``end``; the second takes at most as long as the ``first``."""
    # The first time, factors are made that later ones use.
    for steps in (0, TIMED_STEPS):
        if (started := time.perf_counter()) >= end:
            return False
        if first.run(steps)[0].interrupted:
            raise KeyboardInterrupt
    now = time.perf_counter()
    return now + 1.5 * SYMMETRY_PROBE_STEPS / TIMED_STEPS * (now - started) < end
