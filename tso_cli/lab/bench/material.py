"""The clouds and the views that are measured on: points of one chair before masks of another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from ...geometry.points import Array, normalise_longest_side, sample_surface, spread_subset
from ...geometry.view import View
from ...io.cameras import read_camera
from ...io.clouds import read_cloud
from ...io.images import read_mask
from ...io.meshes import read_mesh
from ...io.shipped import examples_folder
from ...losses.silhouette import silhouette_of

# The shipped example of a chair starts from points of this shape.
START = "q17_ChairHandle.ply"
# Clouds of up to so many points are spread evenly, like those of data sets: else no mirror plane would be found.
SPREAD, SAMPLES = 1024, 8192
DEGREES_BETWEEN_VIEWS = 50.0


def cloud(count: int, seed: int = 0) -> Array:
    """Initial points [count, 3], longest side 1."""
    mesh = read_mesh(examples_folder() / "meshes" / "chair" / START)
    samples = sample_surface(mesh.vertices, mesh.faces, max(count, SAMPLES), np.random.default_rng([seed, count]))
    return normalise_longest_side(samples[spread_subset(samples, count)] if count <= SPREAD else samples[:count])


def chair_views(count: int = 1) -> list[View]:
    """The mask of the shipped chair, and silhouettes of its cloud turned about the vertical axis."""
    folder = examples_folder() / "chair"
    mask = read_mask(folder / "mask.png")
    camera = read_camera(folder / "camera.json", mask.shape[1], mask.shape[0])
    views = [View(mask, camera)]
    for number in range(1, count):
        turn = Rotation.from_euler("y", number * DEGREES_BETWEEN_VIEWS, degrees=True).as_matrix()
        turned = replace(camera, R=camera.R @ turn)
        views.append(View(silhouette_of(read_cloud(folder / "target.ply").points, turned), turned))
    return views
