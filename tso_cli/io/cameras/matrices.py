"""P = K [R t], taken apart."""

from __future__ import annotations

import numpy as np

from ...errors import InputError
from ...geometry.arrays import Array

# How far M M^T may be from 1 if M = P[:, :3] is taken for a rotation.
_ROTATION_TOLERANCE = 1e-3


def decomposed(P: Array) -> tuple[Array, Array, Array]:
    """K, R and t of the projection matrix ``P`` [3, 4], K with a positive diagonal.

    Raises InputError if P is no perspective camera, or [R | t]: a focal length of 1 px has no use.
    """
    M = P[:, :3]
    if np.abs(M @ M.T - np.eye(3)).max() <= _ROTATION_TOLERANCE:
        raise InputError(
            "P looks like [R | t]: its left 3x3 is a rotation, expected K [R | t]; name it E "
            "(world to camera) or c2w in a .json or .npz file, and give K with it"
        )
    if abs(np.linalg.det(M)) <= 1e-12 * max(float(np.abs(M).max()) ** 3, 1e-300):
        raise InputError("P is singular, expected K [R t] of a perspective camera")
    P = P * np.sign(np.linalg.det(M))
    # M = K R with K upper triangular: the QR decomposition of M with its rows reversed.
    flip = np.eye(3)[::-1]
    Q, U = np.linalg.qr((flip @ P[:, :3]).T)
    K, R = flip @ U.T @ flip, flip @ Q.T
    signs = np.diag(np.sign(np.diag(K)))
    K, R = K @ signs, signs @ R
    t = np.linalg.solve(K, P[:, 3])
    K = K / K[2, 2]
    K[[1, 2, 2], [0, 0, 1]] = 0.0
    return K, R, t
