"""All pictures and the ground truth of one mesh."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ..geometry.points import Array, farthest_point_sample, sample_surface
from ..io.meshes import Mesh
from .rays import RayScene, RenderedView, render_view
from .variation import paint
from .viewpoints import RenderSettings, sample_cameras


@dataclass(frozen=True, eq=False)
class RenderedObject:
    """Pictures and ground truth of one mesh, longest side 1.

    samples : [S, 3] float32 points of the surface; target : [P, 3] float32, the farthest-point subset of them.
    """

    views: list[RenderedView]
    samples: NDArray[np.float32]
    target: NDArray[np.float32]


def normalise(mesh: Mesh) -> Mesh:
    """The mesh centred on its bounding box and scaled to longest side 1, without the vertices that no face uses."""
    used, faces = np.unique(mesh.faces, return_inverse=True)
    vertices = mesh.vertices[used]
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    vertices = (vertices - (low + high) / 2.0) / (high - low).max()
    return replace(mesh, vertices=vertices, faces=faces.reshape(mesh.faces.shape).astype(np.int64))


def ground_truth(mesh: Mesh, settings: RenderSettings, rng: np.random.Generator) -> tuple[Array, Array]:
    """Surface samples [samples, 3] and the farthest-point subset of them [points, 3]."""
    samples = sample_surface(mesh.vertices, mesh.faces, settings.samples, rng)
    return samples, samples[farthest_point_sample(samples, settings.points)]


def render_mesh(mesh: Mesh, settings: RenderSettings, rng: np.random.Generator) -> RenderedObject:
    """Normalise ``mesh``, render its views and sample its ground truth."""
    mesh = normalise(paint(mesh, rng) if settings.paint else mesh)
    scene = RayScene(mesh)
    views = [render_view(scene, camera, rng) for camera in sample_cameras(settings, mesh.vertices, rng)]
    samples, target = ground_truth(mesh, settings, rng)
    return RenderedObject(views, samples.astype(np.float32), target.astype(np.float32))
