"""Gaussian splats that move as a whole: their rotations, scales and colours move along.

The properties are those of the reference code of 3D Gaussian splatting (Kerbl et al. 2023).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import partial

import numpy as np

from ..geometry.arrays import Array
from ..geometry.rotations import spread, to_quaternion
from .similarity import Similarity

# A file with these properties is one of splats.
MARKS = {"opacity", "scale_0"}
# Quaternions w, x, y, z of any length.
ROTATION = ("rot_0", "rot_1", "rot_2", "rot_3")
# Logarithms of the standard deviations along the axes of a splat; flat splats have two.
SCALES = ("scale_0", "scale_1", "scale_2")
# The part of the colour that depends on the direction: all coefficients of red, then of green,
# then of blue. A colour has as many of them as the harmonics of degrees 1, 1 to 2, or 1 to 3.
DIRECTIONAL = "f_rest_"
COEFFICIENTS = (3, 8, 15)


def moved_along(
    names: Iterable[str], move: Similarity
) -> list[tuple[tuple[str, ...], Callable[[Array], Array]]]:
    """What ``move`` changes of splats with the properties ``names``, besides coordinates.

    Each entry has the properties of a group, and the function from their values [N, properties]
    to those after the move.
    """
    there = set(names)
    groups: list[tuple[tuple[str, ...], Callable[[Array], Array]]] = []
    if not there.issuperset(MARKS):
        return groups
    if move.size != 1.0:
        scales = tuple(name for name in SCALES if name in there)
        groups.append((scales, partial(np.add, np.log(move.size))))
    if move.turns:
        rest = sum(name.startswith(DIRECTIONAL) for name in there)
        colours = tuple(f"{DIRECTIONAL}{number}" for number in range(rest))
        if there.issuperset(ROTATION):
            groups.append((ROTATION, partial(turned_rotations, turn=move.turn)))
        if there.issuperset(colours) and rest % 3 == 0 and rest // 3 in COEFFICIENTS:
            groups.append((colours, partial(turned_colours, turn=move.turn)))
    return groups


def turned_rotations(quaternions: Array, turn: Array) -> Array:
    """``quaternions`` [N, 4], each followed by the rotation ``turn`` [3, 3]; lengths stay."""
    w, x, y, z = to_quaternion(turn)
    product = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]])
    turned: Array = quaternions @ product.T
    return turned


def turned_colours(coefficients: Array, turn: Array) -> Array:
    """Coefficients [N, 3 K] with which a splat has from direction R d the colour it had from d.

    R is the rotation ``turn`` [3, 3]. ``coefficients`` are those of a file, channel by channel.
    """
    count = coefficients.shape[1] // 3
    directions = spread(32, 1)[:, 2]
    before, after = harmonics(directions), harmonics(directions @ turn.T)
    matrix = np.zeros((count, count))
    # Harmonics of one degree turn into harmonics of the same degree.
    for band in (slice(0, 3), slice(3, 8), slice(8, 15)):
        if band.stop <= count:
            matrix[band, band] = np.linalg.lstsq(after[:, band], before[:, band], rcond=None)[0]
    turned: Array = coefficients.reshape(-1, 3, count) @ matrix.T
    return turned.reshape(coefficients.shape)


def harmonics(directions: Array) -> Array:
    """The real spherical harmonics [D, 15] of degrees 1 to 3 at unit ``directions`` [D, 3].

    Order and signs are those of the reference code.
    """
    x, y, z = directions.T
    xx, yy, zz = x * x, y * y, z * z
    values = [
        -0.4886025119029199 * y,
        0.4886025119029199 * z,
        -0.4886025119029199 * x,
        1.0925484305920792 * x * y,
        -1.0925484305920792 * y * z,
        0.31539156525252005 * (2.0 * zz - xx - yy),
        -1.0925484305920792 * x * z,
        0.5462742152960396 * (xx - yy),
        -0.5900435899266435 * y * (3.0 * xx - yy),
        2.890611442640554 * x * y * z,
        -0.4570457994644658 * y * (4.0 * zz - xx - yy),
        0.3731763325901154 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy),
        -0.4570457994644658 * x * (4.0 * zz - xx - yy),
        1.445305721320277 * z * (xx - yy),
        -0.5900435899266435 * x * (xx - 3.0 * yy),
    ]
    return np.stack(values, axis=1)
