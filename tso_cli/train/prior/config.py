"""The settings of the training of a prior."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from ...errors import InputError

RISING_STEPS = 100  # over these the learning rate rises, or over a tenth of a short training
# After these steps the learning rate falls by their square root, and over the last share of all
# steps to 0. Gradients of single batches are mostly chance: at the full rate 5,000 steps bring what
# 2,000 bring so.
HIGHEST_STEPS, COOLING_SHARE = 500, 0.25
AVERAGING = 0.999  # decay of the running mean of the weights, which is saved
# Settings that a training without predictions does not have.
OF_PREDICTIONS = ("predicted_by", "predictions")


@dataclass(frozen=True)
class PriorConfig:
    """The settings of one training; InputError for a setting out of range.

    Parameters
    ----------
    steps : optimiser steps in all; the learning rate is 0 after the last.
    batch_size : starts in a step.
    scenes : scenes that are drawn before the training.
    predicted_by : name of the network whose predictions are starts too (`Predictor.name`); None
        for no such starts.
    predictions : the most predictions that are drawn before the training.
    initial : name of the prior whose weights the training starts from (`io.reading.name_of`); None
        for random weights.
    by_rule : shapes of each family that are learned from, next to meshes.
    marred, depth_maps : see `scenes.Chances`.
    precision : "bfloat16" runs the network in mixed precision.
    recipe : name and digest of the file that the settings are from, or None.
    seed : seed of the weights and of every draw. A run depends on the seed, the shapes and the
        device alone.
    """

    steps: int = 3000
    batch_size: int = 64
    scenes: int = 8000
    predicted_by: str | None = None
    predictions: int = 1600
    initial: str | None = None
    by_rule: int = 0
    marred: float = 0.4
    depth_maps: float = 0.4
    precision: str = "float32"
    recipe: str | None = None
    seed: int = 0
    device: str = "cpu"

    def __post_init__(self) -> None:
        for name in ("steps", "batch_size", "scenes", "predictions"):
            if getattr(self, name) < 1:
                raise InputError(f"`{name}` is {getattr(self, name)}, expected 1 or more")
        for name in ("marred", "depth_maps"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise InputError(f"`{name}` is {getattr(self, name):g}, expected 0 to 1")
        if self.by_rule == 1:
            raise InputError("`by_rule` is 1, expected 2 or more: a start is another shape, or 0")

    def settings(self) -> dict[str, Any]:
        """What a resumed run must have in common with the run that it continues.

        A run that is being resumed does not know `initial` itself: the file that it resumes does.
        """
        of_predictions = OF_PREDICTIONS if self.predicted_by else ()
        of_initial = ("initial",) if self.initial else ()
        of_recipe = ("recipe",) if self.recipe else ()
        names = ["steps", "batch_size", "scenes", "by_rule", "marred", "depth_maps"]
        names += ["precision", "seed", *of_predictions, *of_initial, *of_recipe]
        return {name: getattr(self, name) for name in names}

    def rate(self, step: int) -> float:
        """The learning rate of ``step``, which counts from 0, as a share of the highest one.

        It rises, falls with the square root of the step, and is cooled to 0 at the end (Zhai et
        al., 2022, "Scaling vision transformers"). So a longer training begins as a shorter one.
        """
        rising = max(1, min(RISING_STEPS, self.steps // 10))
        falling = math.sqrt(HIGHEST_STEPS / max(step + 1, HIGHEST_STEPS))
        cooled = max(0.0, 1.0 - (self.steps - step) / (COOLING_SHARE * self.steps))
        return min(1.0, (step + 1) / rising) * falling * (1.0 - math.sqrt(cooled))
