"""Data augmentation: warped and painted copies of a mesh."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ..geometry.arrays import Indices
from ..io.meshes import Mesh
from ..io.paint import Paint
from ..signals import waiting_signals

# Largest logarithm of the factor by which an axis is stretched. The other deformations scale with
# it.
MAX_STRETCH = 0.3


def warp(mesh: Mesh, rng: np.random.Generator) -> Mesh:
    """A smoothly deformed copy of a normalised ``mesh`` (centred, longest side 1, y up).

    It stretches the axes, displaces each coordinate by a sine of itself, tapers and shears with
    height, and sweeps the sides back along the other horizontal axis. Shear and sweep move points
    along one axis only, so that a mesh with an upright mirror plane keeps it.
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
    """The mesh with one of one to three random colours on each connected part."""
    part = connected_parts(mesh.faces, len(mesh.vertices))
    count = int(part.max()) + 1
    size = rng.integers(1, 4)
    brightness = rng.uniform(20.0, 245.0, (size, 1))
    colours = brightness + rng.normal(0.0, 35.0, (size, 3)) * rng.random()
    palette = np.clip(np.rint(colours), 0, 255).astype(np.uint8)
    of_faces = palette[rng.integers(size, size=count)][part]
    return replace(mesh, paint=Paint.of_faces(of_faces))


def connected_parts(faces: Indices, vertices: int) -> Indices:
    """For each of ``faces`` [F, 3] the number of its connected part, from 0.

    Faces that share a vertex are connected. ``vertices`` is the number of vertices.
    """
    with waiting_signals():
        from trimesh.graph import connected_component_labels

    label = connected_component_labels(np.concatenate([faces[:, :2], faces[:, 1:]]), vertices)
    _, part = np.unique(label[faces[:, 0]], return_inverse=True)
    return part.astype(np.int64)
