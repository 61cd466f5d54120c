"""Data augmentation: warped and painted copies of a mesh."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..io.meshes import Mesh

MAX_STRETCH = 0.3
"""Largest logarithm of the factor by which an axis is stretched; the other deformations scale with it."""


def warp(mesh: Mesh, rng: np.random.Generator) -> Mesh:
    """A smoothly deformed copy of a normalised ``mesh`` (centred, longest side 1, y up).

    Stretches the axes, displaces each coordinate by a sine of itself, tapers and shears with height, and sweeps the sides back
    along the other horizontal axis. Shear and sweep move points along one axis, which keeps an upright mirror plane.
    """

    def drawn(size: int | None = None) -> Any:
        return rng.uniform(-MAX_STRETCH, MAX_STRETCH, size)

    points = mesh.vertices * np.exp(drawn(3))
    points /= max(float(np.ptp(points, axis=0).max()), 1e-12)
    points += drawn(3) / (4.0 * np.pi) * np.sin(2.0 * np.pi * points)
    points[:, [0, 2]] *= 1.0 + drawn(2) * points[:, 1:2]
    along, across = (0, 2) if rng.random() < 0.5 else (2, 0)
    points[:, along] += drawn() * np.abs(points[:, across])
    points[:, along] += 0.5 * drawn() * points[:, 1]
    return replace(mesh, vertices=points)


def paint(mesh: Mesh, rng: np.random.Generator) -> Mesh:
    """The mesh with a random colour of a small palette on each connected part."""
    part = connected_parts(mesh.faces, len(mesh.vertices))
    count = int(part.max()) + 1
    palette = rng.integers(1, 4)
    colours = (
        rng.uniform(20.0, 245.0, (palette, 1)) + rng.normal(0.0, 35.0, (palette, 3)) * rng.random()
    )
    chosen = np.clip(np.rint(colours), 0, 255).astype(np.uint8)[rng.integers(palette, size=count)]
    return Mesh(mesh.vertices, mesh.faces, chosen[part])


def connected_parts(faces: NDArray[np.int64], vertices: int) -> NDArray[np.int64]:
    """For each of ``faces`` [F, 3] the number of its connected part, from 0; faces that share a vertex are connected."""
    from trimesh.graph import connected_component_labels

    label = connected_component_labels(np.concatenate([faces[:, :2], faces[:, 1:]]), vertices)
    _, part = np.unique(label[faces[:, 0]], return_inverse=True)
    return part.astype(np.int64)
