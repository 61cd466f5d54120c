"""Adam, and a variant with one scale for the whole cloud."""

from __future__ import annotations

import numpy as np

from ..geometry.arrays import Array

# Decay of the running means of the gradient and of its square: the paper's betas.
FIRST_DECAY, SECOND_DECAY = 0.9, 0.999


class Adam:
    """The optimiser of the paper: betas (0.9, 0.999), eps 1e-8."""

    EPSILON = 1e-8

    def __init__(self, learning_rate: float) -> None:
        self._learning_rate = learning_rate
        self._mean: Array | float = 0.0
        self._square: Array | float = 0.0
        self._steps = 0

    def step(self, gradient: Array) -> Array:
        """What to add to the parameters, by the gradient [...] of the loss."""
        self._steps += 1
        first, second = FIRST_DECAY, SECOND_DECAY
        self._mean = first * self._mean + (1.0 - first) * gradient
        self._square = second * self._square + (1.0 - second) * self._squared(gradient)
        scale = np.sqrt(self._square / (1.0 - second**self._steps)) + self.EPSILON
        rate = -self._learning_rate / (1.0 - first**self._steps)
        step: Array = rate * self._mean / scale
        return step

    def _squared(self, gradient: Array) -> Array | float:
        squared: Array = np.square(gradient)
        return squared


class UniformAdam(Adam):
    """Adam with one scale for all numbers, so that steps keep the proportions of the gradient.

    Adam moves points of tiny gradient as far as all others. Here a running mean of the largest
    vector of the gradient [N, D] divides the gradient, as in Nicolet et al. 2021. The point with
    that vector moves by about ``learning_rate`` in a step.
    """

    EPSILON = 1e-12

    def _squared(self, gradient: Array) -> Array | float:
        return float(np.square(gradient).sum(1).max())
