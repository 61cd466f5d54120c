"""The symmetry check: do the views agree with a mirror plane that was found in the cloud?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from .coarse_to_fine import CoarseToFine, SmoothFields, WindowedTargets
from .config import Settings
from .presets import BEST_LEARNING_RATE, SYMMETRY_PROBE, SYMMETRY_PROBE_STEPS
from .problem import Problem
from .symmetry import MOST_LOSS_RATIO


def verified_symmetry(
    problems: Sequence[Problem], counts: Tensor, initial: Tensor, weights: Tensor, settings: Settings, fields: SmoothFields
) -> tuple[list[Problem], Tensor, bool]:
    """Drop mirror planes that the views contradict.

    Two short descents are compared, with and without the flipped views. A symmetric object fits both views at once. Of
    an asymmetric one a view and its flipped view contradict each other, and more loss remains. ``problems`` all have a plane
    that was found; ``weights`` [B, V] are of the given views.

    Returns
    -------
    The problems; [B, V or 2 V] weights of all their views; whether Ctrl-C came, which leaves every plane.
    """
    with_flipped = torch.cat([weights, weights], 1)
    losses = []
    for of_views in (with_flipped, weights):
        probed = [replace(problem, resampled=problem.resampled[: of_views.shape[1]]) for problem in problems]
        windowed = WindowedTargets.of(probed, initial, counts, of_views)
        probe = CoarseToFine(windowed, fields, SYMMETRY_PROBE, BEST_LEARNING_RATE["points"], follow=False)
        descent, _ = probe.run(SYMMETRY_PROBE_STEPS)
        if descent.interrupted:
            return list(problems), with_flipped, True
        losses.append(torch.from_numpy(descent.best_loss))
    ratio = losses[0] / (2.0 * losses[1]).clamp_min(torch.finfo(torch.float64).tiny)
    passed = ((ratio <= MOST_LOSS_RATIO) | (losses[0] == 0.0)).tolist()
    checked = [
        replace(problem, symmetry=replace(problem.symmetry, outcome="used" if keep else "contradicted", loss_ratio=value))
        for problem, keep, value in zip(problems, passed, ratio.tolist(), strict=True)
    ]
    if not any(passed):
        return [problem.with_views(problem.views, settings) for problem in checked], weights, False
    # In a batch a dropped flipped view stays, with weight 0.
    kept = torch.tensor(passed, dtype=weights.dtype).unsqueeze(1)
    return checked, torch.cat([weights, weights * kept], 1), False
