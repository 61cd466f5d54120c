"""The settings of the training of a prior."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any, Literal

from ...errors import InputError
from ...option import check, opt

RISING_STEPS = 100  # over these the learning rate rises, or over a tenth of a short training
# After these steps the learning rate falls by their square root, and over the last share of all
# steps to 0. Gradients of single batches are mostly chance: at the full rate 5,000 steps bring what
# 2,000 bring so.
HIGHEST_STEPS, COOLING_SHARE = 500, 0.25
AVERAGING = 0.999  # decay of the running mean of the weights, which is saved
# Settings that a training without predictions does not have.
OF_PREDICTIONS = ("predicted_by", "predictions")


@dataclass(frozen=True, kw_only=True)
class PriorConfig:
    """The settings of the training of a prior; InputError for a setting out of range.

    predicted_by : name of the network whose predictions are starts too (`Predictor.name`); None
        for no such starts.
    initial : name of the prior whose weights the training starts from (`io.reading.name_of`); None
        for random weights.
    recipe : name and digest of the file that the settings are from, or None.

    A run depends on the seed, the shapes and the device alone.

    by_rule : Shapes of each family that the prior learns from, with or without MESHES; `tso render`
        names the families.
    marred : Share of the masks that have a trouble, such as an arm or a hole.
    depth_maps : Share of the scenes that have depth maps.
    scenes : Scenes to draw before the training; 1,000 take 40 s.
    predictions : Most predictions of `predicted_by`; 100 take 10 s.
    steps : Optimiser steps in all, those before `resume` included; the learning rate is 0 after the
        last.
    cooled_at : The learning rate falls to 0 at this step too, as in a training that ends there; so
        a finished training can be resumed with more steps.
    batch_size : Starts in a step.
    precision : Number format of the network's layers; bfloat16 is mixed precision.
    device : cpu, cuda, cuda:1, mps or auto.
    seed : Seed of all random numbers.
    """

    by_rule: int = opt(0, heading="Data", brief=True, least=2, neutral=(0,))
    marred: float = opt(0.4, least=0.0, most=1.0)
    depth_maps: float = opt(0.4, least=0.0, most=1.0)
    scenes: int = opt(8000, brief=True, least=1)
    predictions: int = opt(1600, least=1)
    steps: int = opt(3000, heading="Optimisation", brief=True, least=1)
    cooled_at: int = opt(0, least=0)
    batch_size: int = opt(64, brief=True, least=1)
    precision: Literal["float32", "bfloat16"] = opt("float32")
    device: str = opt("cpu", heading="Running", metavar="DEVICE", brief=True)
    seed: int = opt(0, least=0, most=2**63 - 1)
    predicted_by: str | None = None
    initial: str | None = None
    recipe: str | None = None

    def __post_init__(self) -> None:
        check(self)
        if self.cooled_at >= self.steps:
            raise InputError(
                f"`cooled_at` is {self.cooled_at}, expected less than `steps`, {self.steps}"
            )

    def settings(self) -> dict[str, Any]:
        """What a resumed run must have in common with the run that it continues.

        A run that is being resumed does not know `initial` itself: the file that it resumes does.
        """
        of_predictions = OF_PREDICTIONS if self.predicted_by else ()
        of_initial = ("initial",) if self.initial else ()
        of_recipe = ("recipe",) if self.recipe else ()
        of_cooling = ("cooled_at",) if self.cooled_at else ()
        names = ["steps", "batch_size", "scenes", "by_rule", "marred", "depth_maps"]
        names += ["precision", "seed", *of_predictions, *of_initial, *of_recipe, *of_cooling]
        return {name: getattr(self, name) for name in names}

    def rate(self, step: int) -> float:
        """The learning rate of ``step``, which counts from 0, as a share of the highest one.

        It rises, falls with the square root of the step, and is cooled to 0 at the end (Zhai et
        al., 2022, "Scaling vision transformers"). So a longer training begins as a shorter one, and
        may go on from its end (Wen et al., 2024, "Understanding warmup-stable-decay").
        """
        if step < self.cooled_at:
            return replace(self, steps=self.cooled_at, cooled_at=0).rate(step)
        rising = max(1, min(RISING_STEPS, self.steps // 10))
        falling = math.sqrt(HIGHEST_STEPS / max(step + 1, HIGHEST_STEPS))
        cooled = max(0.0, 1.0 - (self.steps - step) / (COOLING_SHARE * self.steps))
        return min(1.0, (step + 1) / rising) * falling * (1.0 - math.sqrt(cooled))
