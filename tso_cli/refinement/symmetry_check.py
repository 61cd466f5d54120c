"""Whether the picture bears out that an object is its own mirror image."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import torch
from torch import Tensor

from .coarse_to_fine import CoarseToFineConfig, Stage, coarse_to_fine_descent
from .config import BEST_LEARNING_RATE, Settings
from .objective import MaskChamferObjective
from .problem import Problem
from .smooth_field import SmoothField

# A short descent of its own, as smooth as the second stage is and hearing of pixels as far away as the first does. It is held
# loosely: what holds both descents alike would hide what they differ in.
PROBE = CoarseToFineConfig(stages=(Stage(10.0, 6.0, 1.0, 512),), anchor=350.0, least_anchor=30.0)
STEPS = 20
# The share of the loss that may be left with the flipped picture, in units of that without it, for one picture. How often
# shapes that are their own mirror image, and shapes that are not, stay under it is in docs/method.md.
MOST_LEFT = 1.1


def verified_symmetry(
    items: Sequence[Problem],
    counts: Tensor,
    first: Tensor,
    weights: Tensor,
    settings: Settings,
    fields: dict[int, SmoothField],
) -> tuple[list[Problem], Tensor, bool]:
    """Give up planes that the pictures contradict: with the flipped ones beside them, more of their loss is left.

    A shape that is symmetric moves toward both pictures at once. One that is not is pulled to and fro: what one wants covered
    the other wants cleared.

    Parameters
    ----------
    items : B of one batch, all with a plane that was found; their views are followed by as many mirrored ones.
    counts, first : [B], [B, N, 3] their clouds. weights : [B, V] of the views. fields : as in
        `coarse_to_fine_descent`.

    Returns
    -------
    The items, without a plane where it is given up; [B, V or 2 V] weights of the views as they see them now; and whether Ctrl-C
    came: then every plane stays.
    """
    both = torch.cat([weights, weights], 1)
    left = []
    for shown in (both, weights):
        views = [item.working[: shown.shape[1]] for item in items]
        pull = MaskChamferObjective(views, counts, first, shown)
        probe = coarse_to_fine_descent(
            first,
            counts,
            partial(_same, pull),
            None,
            STEPS,
            BEST_LEARNING_RATE["points"],
            config=PROBE,
            fields=fields,
        )
        if probe.interrupted:
            return list(items), both, True
        left.append(torch.from_numpy(probe.best_loss))
    ratio = left[0] / (2.0 * left[1]).clamp_min(torch.finfo(torch.float64).tiny)
    # Nothing left either way: nothing speaks against it.
    kept = ((ratio <= MOST_LEFT) | (left[0] == 0.0)).tolist()
    told = [
        replace(
            item,
            plane=item.plane if keep else None,
            symmetry_outcome=item.symmetry_outcome if keep else "contradicted",
            symmetry_reason=f"{item.symmetry_reason}; with the flipped picture the loss that is left is {value:.2f} times "
            f"that without, for each picture ({f'at most {MOST_LEFT}' if keep else f'over {MOST_LEFT}'})",
        )
        for item, keep, value in zip(items, kept, ratio.tolist(), strict=True)
    ]
    if not any(kept):
        return [item.seen_by(item.views, settings) for item in told], weights, False
    share = torch.tensor(kept, dtype=weights.dtype).unsqueeze(1)
    return told, torch.cat([weights, weights * share], 1), False


def _same(pull: MaskChamferObjective, _points: Tensor, _finest: bool) -> MaskChamferObjective:
    """So short a descent keeps its windows."""
    return pull
