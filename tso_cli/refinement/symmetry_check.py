"""The symmetry check: do the views agree with a mirror plane that was found in the cloud?"""

from __future__ import annotations

import math
import time
from dataclasses import replace

from .coarse_to_fine import CoarseToFine
from .config import Settings
from .presets import BEST_LEARNING_RATE, SYMMETRY_PROBE, SYMMETRY_PROBE_STEPS
from .problem import Problem
from .smooth_field import SmoothField
from .symmetry import MOST_LOSS_RATIO, MOST_OF_SEVERAL

# Of the time left, what the check may take.
TIME_SHARE = 0.5
# So many steps tell how long the check will take.
TIMED_STEPS = 6


def verified_symmetry(
    problem: Problem, weights: list[float], settings: Settings, field: SmoothField, until: float
) -> tuple[Problem, bool]:
    """The problem, without its mirror plane where the views contradict it; and whether Ctrl-C came, which leaves the plane.

    Without time for it in a part of what is left ``until`` then (`time.perf_counter`), there is no check and no plane.

    Two short descents are compared, with and without the flipped views. A symmetric object fits both views at once. Of
    an asymmetric one a view and its flipped view contradict each other, and more loss remains. ``weights`` are of the given
    views.
    """
    probes = [
        CoarseToFine(probed, of_views, field, SYMMETRY_PROBE, BEST_LEARNING_RATE["points"], follow=False)
        for of_views in ([*weights, *weights], weights)
        for probed in [replace(problem, resampled=problem.resampled[: len(of_views)])]
    ]
    unchecked = replace(problem, symmetry=replace(problem.symmetry, outcome="unchecked"))
    end = time.perf_counter() + TIME_SHARE * (until - time.perf_counter())
    try:
        if end < math.inf and not _in_time(probes[0], end):
            return unchecked.with_views(problem.views, settings), False
    except KeyboardInterrupt:
        return problem, True
    losses = []
    for probe in probes:
        descent, _ = probe.run(SYMMETRY_PROBE_STEPS, until=end)
        if descent.interrupted:
            return problem, True
        if descent.out_of_time:
            return unchecked.with_views(problem.views, settings), False
        losses.append(descent.best_loss)
    ratio = losses[0] / max(2.0 * losses[1], 1e-300)
    most = MOST_LOSS_RATIO if len(weights) == 1 else MOST_OF_SEVERAL
    passed = ratio <= most or losses[0] == 0.0
    symmetry = replace(problem.symmetry, outcome="used" if passed else "contradicted", loss_ratio=ratio, most=most)
    problem = replace(problem, symmetry=symmetry)
    return problem if passed else problem.with_views(problem.views, settings), False


def _in_time(probe: CoarseToFine, end: float) -> bool:
    """Whether the check will be done by the ``end``; ``probe`` is of all views, the other one of half as many."""
    # The first time, factors are made that later ones use.
    for steps in (0, TIMED_STEPS):
        if (started := time.perf_counter()) >= end:
            return False
        if probe.run(steps)[0].interrupted:
            raise KeyboardInterrupt
    now = time.perf_counter()
    return now + 1.5 * SYMMETRY_PROBE_STEPS / TIMED_STEPS * (now - started) < end
