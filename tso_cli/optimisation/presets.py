"""The numbers of both presets: "paper", as published, and "best", the default.

The numbers of "best" were chosen on training and validation shapes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

Mode = Literal["points", "encoder", "encoder-decoder", "latent"]
Preset = Literal["best", "paper"]
MODES: tuple[Mode, ...] = get_args(Mode)
PRESETS: tuple[Preset, ...] = get_args(Preset)

# The paper's variance of the Gaussian, in squared cells of a window of 64.
SIGMA_SQ = 0.4


@dataclass(frozen=True)
class Defaults:
    """Defaults of a preset and a mode.

    steps : of the optimiser; in points mode with "best" for each view (`default_steps`).
    learning_rate : for a cloud of longest side 1. In points mode with "best" it is the largest
        change of a node's vector in the first step; smoothing makes the points move less.
    gamma : weight of the Chamfer distance to the start, for a cloud of longest side 1.
    """

    steps: int
    learning_rate: float
    gamma: float


DEFAULTS = {
    ("best", "points"): Defaults(20, 3e-2, 0.0),
    ("best", "encoder"): Defaults(12, 3e-5, 0.0),
    ("best", "encoder-decoder"): Defaults(12, 6e-5, 0.0),
    ("best", "latent"): Defaults(30, 1e-3, 0.0),
    # Published. The paper's encoder variant has no Chamfer term. It has no latent variant.
    ("paper", "points"): Defaults(50, 5e-4, 1e6),
    ("paper", "encoder"): Defaults(50, 1e-6, 0.0),
    ("paper", "encoder-decoder"): Defaults(50, 5e-6, 1e6),
    ("paper", "latent"): Defaults(50, 1e-3, 1e6),
}
BEST_POINTS, PAPER_POINTS = DEFAULTS["best", "points"], DEFAULTS["paper", "points"]

# Several views that disagree need longer to reconcile, up to this many.
MOST_VIEWS_FOR_STEPS = 4

# Least number of control points that may be asked for, and for which there is a confidence.
FEWEST_CONTROL_POINTS = 16


@dataclass(frozen=True)
class Recipe:
    """Numbers of the default preset. The ablation changes one at a time.

    The network modes have their own robust scale, prior weights and resolvability alone.

    Parameters
    ----------
    smoothness : lambda of `SmoothField`.
    robust_scale : of the mask Chamfer loss, px of a window of 64.
    fine_grid : whether windows have `fine_cells` in place of 64 cells a side.
    prior_weight : cost of moving a point, per squared distance (longest side 1), where the mean
        loss of the start per mask pixel is e = 1 px^2. A worse start is held less, by
        prior_weight / e^prior_decay.
    least_prior_weight : the least prior weight for one view.
    truncated_prior : factor of the prior where the image border truncates the object in every view.
    firmness : factor of the prior where the learned prior finds that the start is right.
    uniform_adam : whether Adam's step has one scale for the whole cloud (`UniformAdam`), or one
        for each number.
    use_resolvability : whether parts that are too thin for the pixels are left out of the loss of
        points outside the mask.
    """

    smoothness: float = 0.5
    robust_scale: float = 3.0
    fine_grid: bool = True
    prior_weight: float = 350.0
    prior_decay: float = 1.0
    least_prior_weight: float = 250.0
    truncated_prior: float = 3.0
    firmness: float = 16.0
    uniform_adam: bool = True
    use_resolvability: bool = True


BEST = Recipe()
# The network modes. Weights move many points together, so no field is needed. A prediction that is
# far off has the wrong shape, which small changes of weights do not mend, so the prior falls more
# slowly with the loss of the start.
NETWORK = Recipe(prior_weight=500.0, prior_decay=0.5, least_prior_weight=30.0)
# Two short optimisations are compared to verify a hypothesis. They move large parts together. Their
# position prior is weak: a strong one would hide how they differ.
COMPARISON = Recipe(
    smoothness=5.0,
    robust_scale=6.0,
    prior_weight=350.0,
    least_prior_weight=30.0,
)
COMPARISON_STEPS, COMPARISON_RATE = 20, 4e-2


def default_steps(views: int) -> int:
    """Steps of the default preset in points mode for a number of views."""
    return BEST_POINTS.steps * min(views, MOST_VIEWS_FOR_STEPS)
