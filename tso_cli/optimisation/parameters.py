"""What moves a cloud: its points, or a smooth displacement field."""

from __future__ import annotations

import numpy as np

from ..cloud.smooth_field import SmoothField
from ..geometry.arrays import Array
from .adam import Adam


class PointParameters:
    """The points themselves, [N, 3]."""

    def __init__(self, initial: Array, optimiser: Adam) -> None:
        self._points, self._optimiser = initial, optimiser

    def points(self) -> Array:
        return self._points

    def step(self, gradient: Array) -> None:
        self._points = self._points + self._optimiser.step(gradient)


class FieldParameters:
    """The values u [M, 3] of a `SmoothField` at its nodes, added to ``initial`` [N, 3]."""

    def __init__(
        self, initial: Array, field: SmoothField, smoothness: float, optimiser: Adam
    ) -> None:
        self._initial, self._field, self._optimiser = initial, field, optimiser
        self._smoothness = smoothness
        self._values = np.zeros((len(field.nodes), 3))

    def points(self) -> Array:
        displacements = self._field.smoothed(self._values, self._smoothness)
        return self._initial + self._field.spread(displacements)

    def step(self, gradient: Array) -> None:
        by_values = self._field.smoothed(self._field.gather(gradient), self._smoothness)
        self._values = self._values + self._optimiser.step(by_values)
