"""The frame of meshes that are rendered."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..io.meshes import Mesh


def normalise(mesh: Mesh) -> Mesh:
    """The mesh centred on its bounding box and scaled to longest side 1.

    Vertices that no face uses are removed.
    """
    rows, faces = np.unique(mesh.faces, return_inverse=True)
    vertices = mesh.vertices[rows]
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    vertices = (vertices - (low + high) / 2.0) / (high - low).max()
    return replace(mesh, vertices=vertices, faces=faces.reshape(mesh.faces.shape).astype(np.int64))
