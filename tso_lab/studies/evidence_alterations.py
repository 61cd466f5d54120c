"""Cases with other evidence: depth maps, objects that lack a part."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tso_cli.geometry.camera import Camera
from tso_cli.geometry.points import Array, farthest_point_sample, sample_surface
from tso_cli.io.meshes import Mesh
from tso_cli.optimisation.symmetry import find_mirror_plane
from tso_cli.render.rays import RayScene, render_view

from .cases import SAMPLES, Case
from .shapes import Shape

# An object that lacks a part needs as many faces, and its masks as many pixels, to make a case.
FEWEST_FACES, FEWEST_PIXELS = 20, 50
# Where a part begins beyond the mirror plane and, of half a side, above or below (longest side 1).
SIDE, HALF_SIDE, HIGH, LOW = 0.12, 0.03, 0.0, -0.1

Rng = np.random.Generator


@dataclass(frozen=True)
class Truth:
    """The shape that a case is of."""

    shape: Shape

    @cached_property
    def mesh(self) -> Mesh:
        return self.shape.mesh()

    @cached_property
    def scene(self) -> RayScene:
        return RayScene(self.mesh)


Alter = Callable[[Case, Truth, Rng], Case | None]
"""Alters a case; None where that is not possible."""


def unaltered(case: Case, truth: Truth, rng: Rng) -> Case:
    return case


def with_depth(case: Case, truth: Truth, rng: Rng, noise: float = 0.0) -> Case:
    """Each view with the depth of the true surface, and Gaussian ``noise`` (longest side 1)."""
    views = []
    for view in case.views:
        exact = exact_depth(truth.scene, view.camera)
        noisy = exact + noise * rng.normal(size=exact.shape)
        views.append(replace(view, depth=np.where(np.isfinite(exact), noisy, 0.0)))
    return replace(case, views=tuple(views))


def exact_depth(scene: RayScene, camera: Camera) -> Array:
    """[H, W] along z, infinite where nothing is hit."""
    columns, rows = np.arange(float(camera.width)), np.arange(float(camera.height))
    return scene.cast(camera, columns, rows)["depth"]


def without(case: Case, truth: Truth, rng: Rng, part: str) -> Case | None:
    """The object lacks a part on one side of the start's mirror plane; the start has it.

    ``part`` is "side", or "high" or "low" for the upper or lower half of a side (y up).
    """
    normal = np.abs(find_mirror_plane(case.initial).plane.normal)
    middles = truth.mesh.vertices[truth.mesh.faces].mean(1)
    beyond, height = middles[:, 0 if normal[0] >= normal[2] else 2], middles[:, 1]
    gone = {
        "side": beyond > SIDE,
        "high": (beyond > HALF_SIDE) & (height > HIGH),
        "low": (beyond > HALF_SIDE) & (height < LOW),
    }[part]
    faces = truth.mesh.faces[~gone]
    if len(faces) < FEWEST_FACES:
        return None
    mesh = replace(truth.mesh, faces=faces, paint=None)
    scene = RayScene(mesh)
    views = tuple(
        replace(view, mask=render_view(scene, view.camera).mask.astype(np.float32) / 255.0)
        for view in case.views
    )
    if min(int((view.mask > 0.5).sum()) for view in views) < FEWEST_PIXELS:
        return None
    dense = sample_surface(mesh.vertices, mesh.faces, SAMPLES, rng)
    target = dense[farthest_point_sample(dense, len(case.target))]
    return replace(case, views=views, dense=dense, target=target)
