"""The settings of a training."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from ..errors import InputError
from ..network import Frame, Supervision
from ..option import check_values, opt

MASKS = {"supervision": ("masks", "joint")}


@dataclass(frozen=True, kw_only=True)
class TrainConfig:
    """The settings of the training of a network; InputError for a setting out of range.

    category_sigma_sq : category -> its variance, in place of ``sigma_sq``.
    joint_weight : weight of the Chamfer distance relative to the mask loss ("joint" only); 1e6,
        like gamma in refinement.
    recipe : name and digest of the file that the settings are from, or None.

    A run depends on the seed, the data and the device alone.

    balance : Draw every category equally often, however many objects it has.
    augment : Mirror and recolour the pictures at random.
    supervision : What the loss compares with: the true points (3D), masks (2D, through the
        projector), or both, each of its own data (needs `mask_data`).
    views : Masks to compare each object with in a step, for `supervision` masks.
    affinity_weight : Weight of the affinity loss, lambda of Eq. 6. Once the loss saturates, the
        weight drops to 2 % of this.
    affinity : Form of the affinity loss: between points and mask, or the paper's, between pairs of
        pixels.
    saturation_steps : The loss is saturated if its mean over this number of steps is less than 1 %
        below the mean over as many steps before.
    sigma_sq : Variance of the projector's Gaussian, px^2 of a 64x64 mask.
    points : Points of the predicted cloud.
    frame : Axes of the predicted cloud: the camera's (view) or the object's (canonical).
    decay : How the learning rate falls: not at all, or to 0 along half a cosine.
    steps : Optimiser steps in all, those before `resume` included.
    batch_size : Objects in a step.
    learning_rate : Learning rate of Adam.
    averaging : Save the moving average of the weights with this decay. 0: save the last weights.
    precision : Number format of the network's layers; bfloat16 is mixed precision. Weights, losses
        and projector stay in float32.
    device : cpu, cuda, cuda:1, mps or auto. GPU support (Triton kernels) is experimental.
    seed : Seed of all random numbers.
    workers : Threads that prepare batches ahead.
    """

    balance: bool = opt(False, heading="Data")
    augment: bool = opt(False, heading="Input pictures", brief=True)
    supervision: Supervision = opt("points", heading="Supervision", brief=True)
    views: int = opt(4, least=1, only={"supervision": ("masks",)})
    affinity_weight: float = opt(
        1.0, heading="Losses", names=("lambda",), least=0.0, below=math.inf, only=MASKS
    )
    affinity: Literal["points", "paper"] = opt("points", only=MASKS)
    saturation_steps: int | None = opt(None, "a sixth of `steps`, 10 to 500", least=1, only=MASKS)
    sigma_sq: float = opt(0.4, above=0.0, below=math.inf)
    points: int = opt(1024, heading="Network", least=1)
    frame: Frame = opt("view")
    decay: Literal["none", "cosine"] = opt("none", heading="Optimisation")
    steps: int = opt(20_000, "20000; 600 without DATA", brief=True, least=1)
    batch_size: int = opt(16, brief=True, least=1)
    learning_rate: float = opt(5e-5, "5e-05; 0.0003 without DATA", above=0.0, below=math.inf)
    averaging: float = opt(0.0, "0; 0.99 without DATA", least=0.0, below=1.0)
    precision: Literal["float32", "bfloat16"] = opt("float32")
    device: str = opt("cpu", heading="Running", metavar="DEVICE", brief=True)
    seed: int = opt(0, least=0, most=2**63 - 1)
    workers: int = opt(1, least=1)
    category_sigma_sq: Mapping[str, float] = field(default_factory=dict)
    joint_weight: float = 1e6
    recipe: str | None = None

    def __post_init__(self) -> None:
        check_values(self)
        positive = {f"`category_sigma_sq` of {k}": v for k, v in self.category_sigma_sq.items()}
        for name, value in {**positive, "joint_weight": self.joint_weight}.items():
            if not 0.0 < value < math.inf:
                raise InputError(f"{name} is {value:g}, expected a finite number above 0")

    @property
    def window(self) -> int:
        """Of `AffinitySchedule`."""
        return self.saturation_steps or min(500, max(10, self.steps // 6))

    def rate(self, step: int) -> float:
        """The learning rate of ``step``, which counts from 0."""
        if self.decay == "none":
            return self.learning_rate
        return self.learning_rate * (1.0 + math.cos(math.pi * step / self.steps)) / 2.0
