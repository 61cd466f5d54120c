"""What moves a cloud: its points."""

from __future__ import annotations

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
