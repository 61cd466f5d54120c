"""The position prior: what it costs the points of a cloud to leave where they begin."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.arrays import Array
from ..losses.mask_chamfer import REFERENCE_POINTS
from .objective import MaskChamferObjective, ViewTargets
from .presets import Recipe

# Robust scale of the loss of the start, px of a mask of 64.
START_ROBUST_SCALE = 4.0
# Least loss of the start that the prior weight is computed from, px^2 per mask pixel.
LEAST_LOSS = 0.1
# A start whose mean loss is over half of what a pixel can cost is not right, whatever the learned
# prior says of it: it may have no idea of a cloud that lies far from its mask.
BAD_FIT = START_ROBUST_SCALE**2 / 2.0


@dataclass(frozen=True, eq=False)
class PositionPrior:
    """``w sum_i |x_i - x0_i|^2``."""

    initial: Array  # [N, 3]
    weight: float

    def __call__(self, points: Array) -> tuple[float, Array]:
        shift = points - self.initial
        return self.weight * float(np.square(shift).sum()), 2.0 * self.weight * shift


def start_loss(initial: Array, targets: ViewTargets) -> float:
    """The mean loss of a start [N, 3] by its views, px^2 per mask pixel."""
    return MaskChamferObjective(targets, START_ROBUST_SCALE)(initial)[0] / targets.pixels


def position_prior(
    initial: Array,
    targets: ViewTargets,
    recipe: Recipe,
    observations: float = 1.0,
    rightness: float = 0.0,
) -> PositionPrior:
    """The prior of a cloud ``initial`` [N, 3]: the better it fits its views, the firmer.

    Parameters
    ----------
    observations : `Problem.observations`. The more views, the less the start is needed: the least
        prior weight falls with their square.
    rightness : `Beginning.rightness`.
    """
    loss = start_loss(initial, targets)
    weight = recipe.prior_weight / max(loss, LEAST_LOSS) ** recipe.prior_decay
    weight = max(weight, recipe.least_prior_weight / observations**2)
    if loss < BAD_FIT:
        weight *= recipe.firmness**rightness
    factor = recipe.truncated_prior if targets.truncated else 1.0
    return PositionPrior(initial, weight * factor * REFERENCE_POINTS / len(initial))
