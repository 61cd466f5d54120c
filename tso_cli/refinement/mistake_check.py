"""The mistake check: do the views agree far better with the cloud if a common mistake is undone?"""

from __future__ import annotations

import math
from dataclasses import replace

from .coarse_to_fine import CoarseToFine
from .config import Settings
from .presets import BEST_LEARNING_RATE, SYMMETRY_PROBE, SYMMETRY_PROBE_STEPS
from .problem import Problem
from .smooth_field import SmoothField
from .symmetry import SymmetryDecision

# Loss that may remain once the mistake is undone, relative to that of the input as given.
MOST_LOSS = 0.62


def checked_hint(
    problem: Problem, weights: list[float], settings: Settings, field: SmoothField, until: float = math.inf
) -> tuple[Problem, bool]:
    """The problem, whose hint is confirmed where a descent says so too; and whether Ctrl-C came, which ends the check.

    Silhouettes that agree somewhat better under an assumption (`Agreement.hint`) may do so by chance. Two short descents are
    compared, as given and under the assumption, both without a mirror plane: an object of another shape fits both about as
    well, the same one seen rightly fits far better. ``weights`` are of the given views; without time for it ``until`` then
    (`time.perf_counter`), nothing is confirmed.
    """
    agreement = problem.agreement
    if not (agreement and agreement.hint and problem.masks_alone):
        return problem, False
    losses = []
    without_plane = replace(problem, symmetry=SymmetryDecision("not_asked"))
    for views in (problem.views, tuple(map(agreement.hint.assumption.read, problem.views))):
        probed = without_plane.with_views(views, settings)
        probe = CoarseToFine(probed, weights, field, SYMMETRY_PROBE, BEST_LEARNING_RATE["points"], follow=False)
        descent, _ = probe.run(SYMMETRY_PROBE_STEPS, until=until)
        if descent.interrupted or descent.out_of_time:
            return problem, descent.interrupted
        losses.append(descent.best_loss)
    confirmed = losses[1] < MOST_LOSS * losses[0]
    return replace(problem, agreement=replace(agreement, confirmed=confirmed)), False
