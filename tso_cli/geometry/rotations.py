"""Rotations as matrices [..., 3, 3].

Made from rotation vectors or spread evenly; as rotation vectors; and the angle between two.
"""

from __future__ import annotations

import numpy as np

from .arrays import Array


def from_vectors(vectors: Array) -> Array:
    """Rotations about ``vectors`` [..., 3], whose lengths are the angles in radians (Rodrigues)."""
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    cross = cross_product_matrix(vectors)
    # sinc is exact for small angles; numpy's sinc is sin(pi x) / (pi x).
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.square(np.sinc(angle / (2.0 * np.pi)))
    rotation: Array = np.eye(3) + first * cross + second * (cross @ cross)
    return rotation


def to_vectors(R: Array) -> Array:
    """The rotation vectors [..., 3] of rotations [..., 3, 3], of at most half a turn."""
    # Twice the sine of the angle, along the axis.
    vectors = np.stack(
        [
            R[..., 2, 1] - R[..., 1, 2],
            R[..., 0, 2] - R[..., 2, 0],
            R[..., 1, 0] - R[..., 0, 1],
        ],
        -1,
    )
    cosine = (np.trace(R, axis1=-2, axis2=-1) - 1.0) / 2.0
    angle = np.arctan2(np.linalg.norm(vectors, axis=-1) / 2.0, cosine)
    vectors = np.asarray(vectors / (2.0 * np.sinc(angle / np.pi))[..., None])
    # Near half a turn the sine is too small to show the axis.
    for index in np.argwhere(cosine < -0.99):
        w, *axis = to_quaternion(R[tuple(index)])
        unit = np.array(axis) / np.linalg.norm(axis)
        vectors[tuple(index)] = 2.0 * np.arctan2(np.linalg.norm(axis), w) * unit
    return vectors


def from_quaternion(w: float, x: float, y: float, z: float) -> Array:
    """The rotation [3, 3] of a quaternion, which need not have length 1."""
    s = 2.0 / max(w * w + x * x + y * y + z * z, 1e-300)
    return np.array(
        [
            [1.0 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
            [s * (x * y + w * z), 1.0 - s * (x * x + z * z), s * (y * z - w * x)],
            [s * (x * z - w * y), s * (y * z + w * x), 1.0 - s * (x * x + y * y)],
        ]
    )


def to_quaternion(R: Array) -> Array:
    """The unit quaternion w, x, y, z of a rotation [3, 3], with w >= 0."""
    w = np.array([
        [R[0, 0] - R[1, 1] - R[2, 2], 0.0, 0.0, 0.0],
        [R[0, 1] + R[1, 0], R[1, 1] - R[0, 0] - R[2, 2], 0.0, 0.0],
        [R[0, 2] + R[2, 0], R[1, 2] + R[2, 1], R[2, 2] - R[0, 0] - R[1, 1], 0.0],
        [R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1], R.trace()],
    ])  # fmt: skip
    # The eigenvector of the largest eigenvalue (Bar-Itzhack) bears rounding of R well.
    x, y, z, w0 = np.linalg.eigh(w / 3.0)[1][:, -1]
    quaternion = np.array([w0, x, y, z])
    return quaternion if w0 >= 0.0 else -quaternion


def cross_product_matrix(vectors: Array) -> Array:
    """The matrices [..., 3, 3] whose product with a vector w is ``vectors`` x w."""
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    return np.stack(
        [np.stack(row, -1) for row in ((zero, -z, y), (z, zero, -x), (-y, x, zero))], -2
    )


def lattice(directions: int) -> Array:
    """Unit vectors [directions, 3] that are spread evenly over the sphere: a Fibonacci lattice."""
    number = np.arange(directions) + 0.5
    height = 1.0 - 2.0 * number / directions
    azimuth = number * (np.pi * (3.0 - np.sqrt(5.0)))
    radius = np.sqrt(1.0 - height * height)
    return np.stack([radius * np.cos(azimuth), height, radius * np.sin(azimuth)], 1)


def nearest_rotation(matrix: Array) -> Array:
    """The rotation [3, 3] nearest to a ``matrix`` that is one up to rounding."""
    u, _, vt = np.linalg.svd(matrix)
    rotation: Array = u @ vt
    return rotation


def spread(directions: int, turns: int) -> Array:
    """Camera rotations [directions * turns, 3, 3], spread evenly over all rotations.

    The viewing directions are those of `lattice`. Each of them comes with ``turns``
    evenly spaced rotations about the viewing direction.
    """
    forward = lattice(directions)
    # The lattice has no point at the poles, so the y axis is never parallel to a direction.
    right = np.cross(forward, [0.0, 1.0, 0.0])
    right /= np.linalg.norm(right, axis=1, keepdims=True)
    upright = np.stack([right, np.cross(forward, right), forward], 1)  # rows are the camera's axes
    angle = 2.0 * np.pi * np.arange(turns) / turns
    turn = from_vectors(angle[:, None] * np.array([0.0, 0.0, 1.0]))
    return (turn[None] @ upright[:, None]).reshape(-1, 3, 3)


def angle_between(a: Array, b: Array) -> Array:
    """Angle [...] of the rotation from ``a`` to ``b`` [..., 3, 3], 0 to 180 degrees."""
    trace = np.einsum("...ij,...ij->...", a, b)
    degrees: Array = np.degrees(np.arccos(np.clip((trace - 1.0) / 2.0, -1.0, 1.0)))
    return degrees
