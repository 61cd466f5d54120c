"""Adam."""

from __future__ import annotations

import numpy as np

from ..geometry.arrays import Array


class Adam:
    """The optimiser of the paper: betas (0.9, 0.999), eps 1e-8."""

    def __init__(self, learning_rate: float) -> None:
        self._learning_rate = learning_rate
        self._mean: Array | float = 0.0
        self._square: Array | float = 0.0
        self._steps = 0

    def step(self, gradient: Array) -> Array:
        """What to add to the parameters, by the gradient [...] of the loss."""
        self._steps += 1
        first, second = 0.9, 0.999
        self._mean = first * self._mean + (1.0 - first) * gradient
        self._square = second * self._square + (1.0 - second) * np.square(gradient)
        scale = np.sqrt(self._square / (1.0 - second**self._steps)) + 1e-8
        rate = -self._learning_rate / (1.0 - first**self._steps)
        step: Array = rate * self._mean / scale
        return step
