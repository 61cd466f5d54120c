"""Weights by which a point takes values of the points near it."""

from __future__ import annotations

import numpy as np

from ..geometry.arrays import Array

# Control points that a point is interpolated from.
INTERPOLATED_FROM = 6


def falling_weights(distance: Array) -> Array:
    """Weights [n, k] of the k nearest nodes by their sorted ``distance`` [n, k].

    They sum to 1, and fall to 0 at the last node.
    """
    furthest = np.maximum(distance[:, -1:], np.finfo(float).tiny)
    # The constant keeps the sum positive where all nodes are equally far.
    weight = np.square(1.0 - np.square(distance / furthest)) + 1e-6
    falling: Array = weight / weight.sum(1, keepdims=True)
    return falling
