"""The numbers of both presets: "paper", as published, and "best", the default, chosen on validation shapes."""

from __future__ import annotations

from dataclasses import dataclass, replace

MODES = ("points", "encoder", "encoder-decoder", "latent")
PRESETS = ("best", "paper")

# The paper's steps, learning rates and gamma; its encoder variant has no Chamfer term. The latent variant is not the paper's.
PAPER_STEPS = 50
PAPER_LEARNING_RATE = {"points": 5e-4, "encoder": 1e-6, "encoder-decoder": 5e-6, "latent": 1e-3}
PAPER_SIGMA_SQ = 0.4
PAPER_GAMMA = {"points": 1e6, "encoder": 0.0, "encoder-decoder": 1e6, "latent": 1e6}

BEST_STEPS = {"points": 48, "encoder": 12, "encoder-decoder": 12, "latent": 30}
BEST_LEARNING_RATE = {"points": 4e-2, "encoder": 3e-5, "encoder-decoder": 6e-5, "latent": 1e-3}
BEST_GAMMA = 0.0
# Points mode takes BEST_STEPS for each view, up to this many: views that disagree need longer to reconcile.
MAX_VIEWS_FOR_STEPS = 4
MORE_STEPS, BAD_START = 2, 1.0
"""Factor of these steps where several masks all fill the finest grid and the start's mean loss is over so many px^2 (of a mask
of 64) per mask pixel. Other scenes of the training and validation shapes gain nothing by more steps."""

FULL_STEPS = 2
"""Factor of BEST_STEPS with the budget "full"."""
OPTIMISING = 0.8
"""Share of a budget's seconds that the optimisation may take; the rest is for judging the result."""
SHORT_SECONDS = 0.3
"""For each view: with a budget of less, in which not all of 48 steps of 1,024 points may fit, `SHORT_POINTS` move."""
SHORT_POINTS = 512

FIELD_NODES = 1024
"""Most nodes of a smooth displacement field; larger clouds interpolate between them."""
FEWEST_POINTS = 16
"""Least number of points that may be asked to move by themselves, and for which a result is judged."""


@dataclass(frozen=True)
class Stage:
    """One stage of the coarse-to-fine descent; all stages have equally many steps.

    Parameters
    ----------
    smoothness : lambda of `SmoothField`.
    robust_scale : of the mask Chamfer loss, px of a window of 64.
    learning_rate_scale : times the learning rate; a slower last stage is what cars and sofas gain by.
    nodes : of the displacement field.
    averaging_weight : of this stage's best iterate in the result, which is a mean over the stages.
    blur : standard deviation of the photometric loss's blur, px of a window of 64.
    fine_grid : whether the window is resampled at `fine_cells` in place of 64 cells a side.
    """

    smoothness: float
    robust_scale: float
    learning_rate_scale: float = 1.0
    nodes: int = FIELD_NODES
    averaging_weight: float = 1.0
    blur: float = 0.5
    fine_grid: bool = False


# The cloud first moves almost rigidly, toward distant pixels too; at last almost point by point, toward near pixels only.
# Where stages disagree, the later one is wrong about as often as it is right. Their mean is about as accurate as the last
# stage, and is less often worse than the start.
STAGES = (
    Stage(100.0, 6.0, 1.0, 256, 1.0, blur=2.0),
    Stage(10.0, 3.0, 1.0, 512, 2.0, blur=1.0),
    Stage(1.0, 3.0, 0.35, FIELD_NODES, 3.0, fine_grid=True),
)


@dataclass(frozen=True)
class CoarseToFineConfig:
    """Settings of the default preset; the ablation changes one at a time.

    Parameters
    ----------
    stages : in this order.
    prior_weight : cost of moving a point, per squared distance (longest side 1), where the start's mean loss per mask pixel
        is e = 1 px^2. A worse start is held less, by prior_weight / e^prior_decay, but by at least ``least_prior_weight`` (for
        one view).
    truncated_prior : factor of the prior where every image border truncates the object.
    local_prior : whether a part of the cloud that fits badly is held less than the rest.
    uniform_adam : whether Adam's step has one scale for the whole cloud (`UniformAdam`) or one per number.
    use_resolvability : whether parts too thin for the pixels to resolve are left out of the background term.
    """

    stages: tuple[Stage, ...] = STAGES
    prior_weight: float = 300.0
    prior_decay: float = 1.0
    least_prior_weight: float = 200.0
    truncated_prior: float = 3.0
    local_prior: bool = True
    uniform_adam: bool = True
    use_resolvability: bool = True


BEST = CoarseToFineConfig()
# The budget "full": the masks as fine in every stage.
FULL = replace(BEST, stages=tuple(replace(stage, fine_grid=True) for stage in STAGES))
# The network modes: weights move many points together, so no field is needed; and a prediction that is far off is the wrong
# shape, which small changes of weights do not mend, so the prior falls more slowly.
NETWORK = CoarseToFineConfig(
    stages=(Stage(0.0, 3.0),),
    prior_weight=500.0,
    prior_decay=0.5,
    least_prior_weight=30.0,
    local_prior=False,
)
# The symmetry check: one short, loosely held stage. A strong prior would hide how the two descents it compares differ.
SYMMETRY_PROBE = CoarseToFineConfig(
    stages=(Stage(10.0, 6.0, nodes=512),),
    prior_weight=350.0,
    least_prior_weight=30.0,
    local_prior=False,
)
SYMMETRY_PROBE_STEPS = 20
