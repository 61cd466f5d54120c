"""What moves a cloud: its points, by Adam."""

from __future__ import annotations

import numpy as np

from ..geometry.arrays import Array


class PointParameters:
    """The points themselves, [N, 3], moved by Adam: betas (0.9, 0.999), eps 1e-8."""

    def __init__(self, initial: Array, learning_rate: float) -> None:
        self._points, self._learning_rate = initial, learning_rate
        self._mean: Array | float = 0.0
        self._square: Array | float = 0.0
        self._steps = 0

    def points(self) -> Array:
        return self._points

    def step(self, gradient: Array) -> None:
        self._steps += 1
        first, second = 0.9, 0.999
        self._mean = first * self._mean + (1.0 - first) * gradient
        self._square = second * self._square + (1.0 - second) * np.square(gradient)
        scale = np.sqrt(self._square / (1.0 - second**self._steps)) + 1e-8
        rate = self._learning_rate / (1.0 - first**self._steps)
        self._points = self._points - rate * self._mean / scale
