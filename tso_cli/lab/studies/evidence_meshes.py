"""Cases that start from a mesh: from its vertices, from samples of its surface, or from it as a surface."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...io.meshes import Mesh, read_mesh
from ...refinement.surface import Surface
from ...render import normalise
from .accuracy_cases import AccuracyCase
from .evidence_cases import Alter, Truth

MOST = 20_000
"""Vertices that are still refined as a cloud."""
VERTICES, SAMPLES, FACES = "its vertices as a cloud", "the cloud of its samples", "as a mesh"


def from_mesh(form: str, faces: int | None = None) -> Alter:
    """The start is the mesh that its cloud was sampled from, in one of three forms; with ``faces`` cut down to so many before.

    What comes of vertices, given as a cloud or as a mesh, is judged by the surface that the mesh then has.
    """

    def altered(case: AccuracyCase, truth: Truth, rng: np.random.Generator) -> AccuracyCase | None:
        assert case.start_file is not None
        mesh = normalise(read_mesh(case.start_file))
        if faces is not None:
            if len(mesh.faces) <= faces:
                return None
            mesh = _cut_down(mesh, faces)
        surface = Surface(mesh.vertices, mesh.faces)
        if form == SAMPLES:
            return replace(case, initial=surface.samples)
        if form == VERTICES and len(mesh.vertices) > MOST:
            return None
        return replace(case, initial=mesh.vertices, faces=mesh.faces if form == FACES else None, surface=surface)

    return altered


def _cut_down(mesh: Mesh, faces: int) -> Mesh:
    """The mesh with so many faces, by quadric decimation."""
    import open3d

    found = open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(mesh.vertices), open3d.utility.Vector3iVector(mesh.faces.astype(np.int32))
    ).simplify_quadric_decimation(faces)
    found.remove_unreferenced_vertices()
    return Mesh(np.asarray(found.vertices), np.asarray(found.triangles).astype(np.int64))
