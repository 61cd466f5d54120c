"""The settings of a training."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ..errors import InputError


@dataclass(frozen=True)
class TrainConfig:
    """The settings of one training; InputError for a setting out of range.

    Parameters
    ----------
    supervision : "points" (Chamfer distance to the target, 3D), "masks" (V views through the
        projector, 2D) or "joint" (points of one data set, and one mask for each image of another
        data set).
    frame : frame of the predicted points, "view" or "canonical" (see `NetworkConfig`).
    steps : number of Adam steps, including the steps before a resume.
    batch_size : objects in a step.
    views : V, number of supervising masks of each object in a step ("masks" only); 4 in the paper.
    affinity_weight : lambda of Eq. 6 ("masks" and "joint").
    affinity : form of Eq. 5.
    saturation_steps : window of `AffinitySchedule`; None for a sixth of ``steps``, but 10 to 500.
    sigma_sq : variance of the projection kernel, px^2 of the 64x64 mask.
    category_sigma_sq : category -> its variance, in place of ``sigma_sq``.
    joint_weight : weight of the Chamfer distance relative to the mask loss ("joint" only); 1e6,
        like gamma in refinement.
    decay : "none", or "cosine": the learning rate falls to 0 along half a cosine.
    averaging : decay of the running mean of the weights, which is saved; 0 saves the last weights.
    balance, augment : see `batches.Drawing`.
    workers : threads that prepare batches ahead.
    precision : "bfloat16" runs the layers of the network in mixed precision. Weights, losses and
        projector stay in float32.
    recipe : name and digest of the file that the settings are from, or None.
    seed : seed of the weights and of every draw. A run depends on the seed, the data and the device
        alone.
    """

    supervision: str = "points"
    frame: str = "view"
    steps: int = 1000
    batch_size: int = 16
    learning_rate: float = 5e-5
    decay: str = "none"
    views: int = 4
    affinity_weight: float = 1.0
    affinity: str = "points"
    saturation_steps: int | None = None
    sigma_sq: float = 0.4
    category_sigma_sq: Mapping[str, float] = field(default_factory=dict)
    points: int = 1024
    joint_weight: float = 1e6
    averaging: float = 0.0
    balance: bool = False
    augment: bool = False
    precision: str = "float32"
    workers: int = 1
    recipe: str | None = None
    seed: int = 0
    device: str = "cpu"

    def __post_init__(self) -> None:
        if self.saturation_steps is None:
            object.__setattr__(self, "saturation_steps", min(500, max(10, self.steps // 6)))
        for name in ("steps", "batch_size", "views", "saturation_steps", "points", "workers"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} is {getattr(self, name)}, expected 1 or more")
        if not 0.0 <= self.averaging < 1.0:
            raise InputError(f"averaging is {self.averaging:g}, expected 0 or more and below 1")
        positive = {
            name: getattr(self, name) for name in ("learning_rate", "sigma_sq", "joint_weight")
        }
        positive |= {f"sigma_sq of {name}": value for name, value in self.category_sigma_sq.items()}
        for name, value in positive.items():
            if not 0.0 < value < np.inf:
                raise InputError(f"{name} is {value:g}, expected a finite number above 0")
        if not 0.0 <= self.affinity_weight < np.inf:
            raise InputError(
                f"lambda is {self.affinity_weight:g}, expected a finite number, 0 or more"
            )

    def rate(self, step: int) -> float:
        """The learning rate of ``step``, which counts from 0."""
        if self.decay == "none":
            return self.learning_rate
        return self.learning_rate * (1.0 + math.cos(math.pi * step / self.steps)) / 2.0
