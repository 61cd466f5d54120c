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

    steps : of the optimiser.
    learning_rate : for a cloud of longest side 1.
    gamma : weight of the Chamfer distance to the start, for a cloud of longest side 1.
    """

    steps: int
    learning_rate: float
    gamma: float


DEFAULTS = {
    ("best", "points"): Defaults(20, 4e-3, 0.0),
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

# Least number of control points that may be asked for, and for which there is a confidence.
FEWEST_CONTROL_POINTS = 16

# Cost of moving a point of the default preset, per squared distance (longest side 1) from where the
# optimisation begins.
PRIOR_WEIGHT = 250.0
# Where the learned prior asks to move a cloud less than this, as a root mean square in longest
# sides, less is left to move too: the weight is as many times larger. Without this, four masks
# leave .07 more of the error of nearly right clouds. What depth maps show, the prior does not see;
# with them it counts as if it had asked for this at least.
FAR, LEAST_SEEN = 0.1, 0.035
