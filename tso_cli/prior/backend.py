"""The array operations that the prior needs, in numpy and in torch under the same names.

The prior is used in points mode, which has no torch, and trained with torch. Features and network
are written once, for either: what numpy and torch call alike is called as such, and the rest is
here. Both forms give the same numbers (tests/prior/test_network.py).
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np


class Backend(Protocol):
    """Arrays [...] are of the backend's own kind.

    xp : the module whose functions are called.
    """

    xp: Any

    def constant(self, values: np.ndarray[Any, Any], like: Any) -> Any:
        """The ``values``, of the type and place of ``like``."""

    def whole(self, values: Any) -> Any:
        """The ``values`` as whole numbers."""

    def rows(self, values: Any, index: Any) -> Any:
        """[B, K, C]: the rows ``index`` [B, K] of ``values`` [B, N, C]."""

    def sums(self, index: Any, values: Any, count: int) -> Any:
        """[B, count, C]: ``values`` [B, K, C] added up by ``index`` [B, K]."""

    def largest(self, index: Any, values: Any, count: int, least: float) -> Any:
        """[B, count]: the largest of ``values`` [B, K] by ``index`` [B, K], at least ``least``."""

    def nearest(self, queries: Any, data: Any) -> Any:
        """[B, K]: which of ``data`` [B, N, D] is nearest to each of the ``queries`` [B, K, D]."""

    def dilated(self, maps: Any) -> Any:
        """[B, C, H, W]: the largest of each 3x3 cells."""

    def convolved(self, maps: Any, kernel: Any, offset: Any, stride: int) -> Any:
        """``maps`` [B, C, H, W] with a ``kernel`` [D, C, 3, 3] and a margin of one zero."""

    def linear(self, values: Any, matrix: Any, offset: Any) -> Any:
        """``values`` [..., C] times a ``matrix`` [C, D], plus an ``offset`` [D]."""

    def activated(self, values: Any) -> Any:
        """``values`` times their logistic function (SiLU)."""

    def sampled(self, maps: Any, places: Any) -> Any:
        """[B, N, C]: ``maps`` [B, C, H, W] of [-1, 1]^2, bilinear at ``places`` [B, N, 2].

        Beyond the outermost centres of cells the maps go on as there.
        """


class NumpyBackend:
    """`Backend` of numpy."""

    xp: Any = np

    def constant(self, values: Any, like: Any) -> Any:
        return np.asarray(values, like.dtype)

    def whole(self, values: Any) -> Any:
        return values.astype(np.int64)

    def rows(self, values: Any, index: Any) -> Any:
        return np.take_along_axis(values, index[..., None], 1)

    def sums(self, index: Any, values: Any, count: int) -> Any:
        out = np.zeros((len(values), count, values.shape[2]), values.dtype)
        np.add.at(out, (np.arange(len(values))[:, None], index), values)
        return out

    def largest(self, index: Any, values: Any, count: int, least: float) -> Any:
        out = np.full((len(values), count), least, values.dtype)
        np.maximum.at(out, (np.arange(len(values))[:, None], index), values)
        return out

    def nearest(self, queries: Any, data: Any) -> Any:
        lengths = np.square(data).sum(-1)[:, None]
        return (lengths - 2.0 * queries @ np.swapaxes(data, 1, 2)).argmin(2)

    def dilated(self, maps: Any) -> Any:
        return self._windows(maps, -np.inf).max((-2, -1))

    def convolved(self, maps: Any, kernel: Any, offset: Any, stride: int) -> Any:
        windows = self._windows(maps, 0.0)[:, :, ::stride, ::stride]
        product = np.tensordot(windows, kernel, ((1, 4, 5), (1, 2, 3)))
        return np.moveaxis(product, -1, 1) + offset[:, None, None]

    def linear(self, values: Any, matrix: Any, offset: Any) -> Any:
        return values @ matrix + offset

    def activated(self, values: Any) -> Any:
        return values / (1.0 + np.exp((-values).clip(-60.0, 60.0)))

    def sampled(self, maps: Any, places: Any) -> Any:
        height, width = maps.shape[2:]
        batch = np.arange(len(maps))[:, None]
        low, part = [], []
        for axis, size in ((0, width), (1, height)):
            place = np.clip((places[..., axis] + 1.0) * size / 2.0 - 0.5, 0.0, size - 1.0)
            low.append(np.minimum(place.astype(int), size - 2))
            part.append((place - low[-1])[..., None])
        (x, y), (right, down) = low, part
        return (1.0 - down) * (
            (1.0 - right) * maps[batch, :, y, x] + right * maps[batch, :, y, x + 1]
        ) + down * ((1.0 - right) * maps[batch, :, y + 1, x] + right * maps[batch, :, y + 1, x + 1])

    def _windows(self, maps: Any, margin: float) -> Any:
        """[B, C, H, W, 3, 3], the 3x3 cells around each cell."""
        padded = np.pad(maps, ((0, 0), (0, 0), (1, 1), (1, 1)), constant_values=margin)
        return np.lib.stride_tricks.sliding_window_view(padded, (3, 3), (2, 3))


NUMPY = NumpyBackend()
