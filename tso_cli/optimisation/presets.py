"""The numbers of both presets: "paper", as published, and "best", the default.

The numbers of "best" were chosen on training and validation shapes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, get_args

from ..cloud.control_points import CONTROL_POINTS
from ..io.shipped import LEARNED, NO_PRIOR
from ..pose import Asked

Mode = Literal["points", "encoder", "encoder-decoder", "latent"]
Preset = Literal["best", "paper"]
MODES: tuple[Mode, ...] = get_args(Mode)
PRESETS: tuple[Preset, ...] = get_args(Preset)

# The paper's variance of the Gaussian, in squared cells of a window of 64.
SIGMA_SQ = 0.4
# Numbers of control points that may be asked for. With fewer there is no confidence; farthest-point
# sampling chooses no more (`geometry.points.CANDIDATES`).
FEWEST_CONTROL_POINTS, MOST_POINTS = 16, 16_384


@dataclass(frozen=True)
class Defaults:
    """Defaults of a preset and a mode, by the names of `RefineConfig`."""

    steps: int
    learning_rate: float
    gamma: float
    symmetry: str = "none"
    move: Asked = "shape"
    prior: str = NO_PRIOR
    points: int | None = None
    sigma_sq: float = SIGMA_SQ


DEFAULTS = {
    ("best", "points"): Defaults(20, 4e-3, 0.0, "auto", "auto", LEARNED, CONTROL_POINTS),
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

# Cost of moving a point of the default preset, per squared distance (longest side 1) from where the
# optimisation begins.
PRIOR_WEIGHT = 250.0
# Where the learned prior asks to move a cloud less than this, as a root mean square in longest
# sides, less is left to move too: the weight is as many times larger. Without this, four masks
# leave .07 more of the error of nearly right clouds. What depth maps show, the prior does not see;
# with them it counts as if it had asked for this at least.
FAR, LEAST_SEEN = 0.1, 0.035
