"""The position prior: what it costs the points of a cloud to leave their start."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..cloud.smooth_field import SmoothField
from ..geometry.arrays import Array
from ..losses.mask_chamfer import REFERENCE_POINTS
from .objective import MaskChamferObjective, ViewTargets
from .presets import CoarseToFineConfig

# Robust scale of the loss of the start, px of a mask of 64.
START_ROBUST_SCALE = 4.0
# Least loss of the start that the prior weight is computed from, px^2 per mask pixel.
LEAST_LOSS = 0.1
# A part of the cloud is held by its own mean loss if that is over the first number, in px^2 per
# mask pixel. The second is the smoothness with which it is averaged over neighbours.
LOCAL_LOSS, LOCAL_SMOOTHNESS = 1.0, 1.0


@dataclass(frozen=True, eq=False)
class PositionPrior:
    """``sum_i w_i |x_i - x0_i|^2``."""

    initial: Array  # [N, 3]
    weights: Array  # [N]

    def __call__(self, points: Array) -> tuple[float, Array]:
        shift = points - self.initial
        weighted = self.weights[:, None] * shift
        return float((weighted * shift).sum()), 2.0 * weighted


def start_loss(initial: Array, targets: ViewTargets) -> tuple[float, Array]:
    """The mean loss of a start [N, 3] by its views, px^2 per mask pixel.

    Also what each point adds to the masks' part of the sum, [N].
    """
    objective = MaskChamferObjective(targets, START_ROBUST_SCALE)
    total, _, per_point = objective.in_parts(initial)
    return total / targets.pixels, per_point


def position_prior(
    initial: Array,
    targets: ViewTargets,
    field: SmoothField,
    config: CoarseToFineConfig,
    observations: float = 1.0,
) -> PositionPrior:
    """The prior of a cloud ``initial`` [N, 3]: the better the start fits its views, the firmer.

    Parameters
    ----------
    targets, field : of the start.
    observations : `Problem.observations`. The more views, the less the start is needed: the least
        prior weight falls with their square.
    """
    mean, per_point = start_loss(initial, targets)
    loss = np.full(len(initial), mean)
    if config.local_prior:
        local = field.averaged(per_point * (len(initial) / targets.pixels), LOCAL_SMOOTHNESS)
        loss = np.maximum(loss, np.where(local > LOCAL_LOSS, local, 0.0))
    weights = config.prior_weight / np.maximum(loss, LEAST_LOSS) ** config.prior_decay
    weights = np.maximum(weights, config.least_prior_weight / observations**2)
    factor = config.truncated_prior if targets.truncated else 1.0
    return PositionPrior(initial, weights * (factor * REFERENCE_POINTS / len(initial)))
