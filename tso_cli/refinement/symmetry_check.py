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
    losses = []
    end = time.perf_counter() + TIME_SHARE * (until - time.perf_counter())
    in_time = end == math.inf or (time.perf_counter() < end and time.perf_counter() + _seconds(probes[0]) < end)
    for probe in probes:
        descent, _ = probe.run(SYMMETRY_PROBE_STEPS if in_time else 0, until=end)
        if descent.interrupted:
            return problem, True
        if descent.out_of_time or not in_time:
            unchecked = replace(problem, symmetry=replace(problem.symmetry, outcome="unchecked"))
            return unchecked.with_views(problem.views, settings), False
        losses.append(descent.best_loss)
    ratio = losses[0] / max(2.0 * losses[1], 1e-300)
    most = MOST_LOSS_RATIO if len(weights) == 1 else MOST_OF_SEVERAL
    passed = ratio <= most or losses[0] == 0.0
    symmetry = replace(problem.symmetry, outcome="used" if passed else "contradicted", loss_ratio=ratio, most=most)
    problem = replace(problem, symmetry=symmetry)
    return problem if passed else problem.with_views(problem.views, settings), False


def _seconds(probe: CoarseToFine) -> float:
    """How long the check will take; ``probe`` is of all views, the other one of half as many."""
    probe.run(0)  # the first time, factors are made that later ones use
    started = time.perf_counter()
    probe.run(TIMED_STEPS)
    return 1.5 * SYMMETRY_PROBE_STEPS / TIMED_STEPS * (time.perf_counter() - started)
