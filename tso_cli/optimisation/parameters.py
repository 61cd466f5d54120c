"""What moves a cloud: its points, or a smooth displacement field."""

from __future__ import annotations

import numpy as np

from ..cloud.smooth_field import SmoothField
from .adam import Adam
from .loop import Array, StepDown


class PointParameters:
    """The points themselves, [N, 3]."""

    def __init__(self, initial: Array, optimiser: Adam) -> None:
        self._points, self._optimiser = initial, optimiser

    def forward(self) -> tuple[Array, StepDown]:
        return self._points, self._step

    def _step(self, gradient: Array) -> None:
        self._points = self._points + self._optimiser.step(gradient)


class FieldParameters:
    """The values u [M, 3] of a `SmoothField` at its nodes, added to ``initial`` [N, 3] after smoothing."""

    def __init__(
        self, initial: Array, field: SmoothField, smoothness: float, optimiser: Adam
    ) -> None:
        self._initial, self._field, self._optimiser = initial, field, optimiser
        self._smoothness = smoothness
        self._values = np.zeros((len(field.nodes), 3))

    def forward(self) -> tuple[Array, StepDown]:
        return self._initial + self._field.spread(
            self._field.smoothed(self._values, self._smoothness)
        ), self._step

    def _step(self, gradient: Array) -> None:
        by_values = self._field.smoothed(self._field.gather(gradient), self._smoothness)
        self._values = self._values + self._optimiser.step(by_values)
