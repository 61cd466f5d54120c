"""Smooth random deformations of shapes: displacements on a lattice of Bernstein polynomials."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from ...geometry.arrays import Floats, Indices

SIDE = 4  # nodes along an axis: cubic polynomials
STRETCH = 0.12  # standard deviation of the logarithm-like scale of an axis
NOISE = 0.05  # of a node, in sizes of the box; multiplied by a number in NOISE_RANGE
NOISE_RANGE = (0.3, 1.2)
# The noise along a short side is at least that of a side this long, so that flat parts bend.
LEAST_SIDE = 0.25
SHEAR, SHEAR_CHANCE = 0.05, 0.3  # for each ordered pair of axes
SYMMETRIC_CHANCE = 0.8
STRENGTH = (0.3, 1.0)  # the whole deformation is multiplied by a number in this range
# Polynomials grow fast outside of the box: points farther out are moved as points here.
OUTSIDE = 0.2


def draw_lattices(
    rng: np.random.Generator,
    sizes: Floats,
    mirror_axes: Indices,
    strength: tuple[float, float] = STRENGTH,
) -> Floats:
    """Displacements [B, SIDE^3, 3] of the nodes of B lattices.

    ``sizes`` [B, 3] are the sides of the boxes of B shapes. Most lattices keep a shape symmetric
    that has a mirror plane across its axis in ``mirror_axes`` [B].
    """
    count = len(sizes)
    along = np.linspace(-1.0, 1.0, SIDE)
    nodes = np.stack(np.meshgrid(along, along, along, indexing="ij"), -1)  # [S, S, S, 3]
    half = (sizes / 2.0)[:, None, None, None]
    lattices = nodes * half * rng.normal(0.0, STRETCH, (count, 1, 1, 1, 3))
    noise = rng.normal(0.0, NOISE, (count, SIDE, SIDE, SIDE, 3))
    noise *= rng.uniform(*NOISE_RANGE, (count, 1, 1, 1, 1))
    lattices += noise * np.maximum(sizes, LEAST_SIDE)[:, None, None, None]
    shears = rng.normal(0.0, SHEAR, (count, 3, 3)) * (rng.random((count, 3, 3)) < SHEAR_CHANCE)
    shears *= 1.0 - np.eye(3)
    lattices += np.einsum("xyza,bca->bxyzc", nodes, shears)
    symmetric = rng.random(count) < SYMMETRIC_CHANCE
    for axis in range(3):
        rows = np.flatnonzero(symmetric & (mirror_axes == axis))
        image = np.flip(lattices[rows], axis + 1) * np.where(np.arange(3) == axis, -1.0, 1.0)
        lattices[rows] = (lattices[rows] + image) / 2.0
    lattices *= rng.uniform(*strength, (count, 1, 1, 1, 1))
    return lattices.reshape(count, SIDE**3, 3).astype(np.float32)


def warped(points: Tensor, low: Tensor, high: Tensor, lattices: Tensor) -> Tensor:
    """``points`` [B, N, 3] moved by ``lattices`` [B, SIDE^3, 3] over boxes ``low``, ``high`` [B, 3]

    A side of the box without extent does not divide by 0: there all points are in the middle.
    """
    side = (high - low)[:, None]
    place = (points - low[:, None]) / side.clamp_min(1e-6)
    place = place.clamp(-OUTSIDE, 1.0 + OUTSIDE).where(side > 1e-6, torch.full_like(place, 0.5))
    rest = 1.0 - place
    basis = torch.stack(
        [rest**3, 3.0 * place * rest**2, 3.0 * place**2 * rest, place**3], -1
    )  # [B, N, 3, SIDE]
    x, y, z = basis.unbind(2)
    weights = (x[..., None, None] * y[..., None, :, None] * z[..., None, None, :]).flatten(2)
    return points + weights @ lattices
