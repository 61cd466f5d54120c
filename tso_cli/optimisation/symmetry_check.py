"""The symmetry check: do the views agree with a mirror plane that was found in the cloud?"""

from __future__ import annotations

from dataclasses import replace

from ..cloud.smooth_field import SmoothField
from ..refinement.config import Settings
from .probe import final_losses, probe
from .problem import Problem
from .symmetry import MOST_LOSS_RATIO, MOST_OF_SEVERAL


def verified_symmetry(
    problem: Problem, weights: list[float], settings: Settings, field: SmoothField, until: float
) -> tuple[Problem, bool]:
    """The problem, without its mirror plane where the views contradict it; and whether Ctrl-C came, which leaves the plane.

    Without time for it ``until`` then (`final_losses`), there is no check and no plane.

    Two short descents are compared, with and without the flipped views. A symmetric object fits both views at once. Of
    an asymmetric one a view and its flipped view contradict each other, and more loss remains. ``weights`` are of the given
    views.
    """
    probes = [
        probe(replace(problem, resampled=problem.resampled[: len(of_views)]), of_views, field)
        for of_views in ([*weights, *weights], weights)
    ]
    try:
        losses = final_losses(probes, until)
    except KeyboardInterrupt:
        return problem, True
    if losses is None:
        unchecked = replace(problem, symmetry=replace(problem.symmetry, outcome="unchecked"))
        return unchecked.with_views(problem.views, settings), False
    ratio = losses[0] / max(2.0 * losses[1], 1e-300)
    most = MOST_LOSS_RATIO if len(weights) == 1 else MOST_OF_SEVERAL
    passed = ratio <= most or losses[0] == 0.0
    symmetry = replace(
        problem.symmetry, outcome="used" if passed else "contradicted", loss_ratio=ratio, most=most
    )
    problem = replace(problem, symmetry=symmetry)
    return problem if passed else problem.with_views(problem.views, settings), False
