"""Cases with other evidence: depth maps, photos, objects that lack a part."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...evaluation.metrics import chamfer
from ...geometry.camera import Camera
from ...geometry.points import Array, farthest_point_sample, sample_surface
from ...geometry.view import View
from ...io.meshes import Mesh
from ...optimisation.symmetry import find_mirror_plane
from ...render import RayScene, render_view
from ...render.rays import AMBIENT, RAYS_ACROSS
from .cases import SAMPLES, Case
from .shapes import Shape

# An object that lacks a part needs as many faces, and its masks as many pixels, to make a case.
FEWEST_FACES, FEWEST_PIXELS = 20, 50
# Waves of a paint, and their lengths (longest side 1): from stripes of the width of a window to
# whole parts in one colour.
WAVES, SHORTEST, LONGEST = 12, 0.1, 1.0
SHARPNESS = 4.0
"""Of the edges between two colours."""
# Waves that bend a cloud, their lengths, and the halvings that find how far.
BENDS, BEND_LENGTHS, HALVINGS = 6, (0.8, 2.0), 25
# Where a part begins beyond the mirror plane and, of half a side, above or below (longest side 1).
SIDE, HALF_SIDE, HIGH, LOW = 0.12, 0.03, 0.0, -0.1

Rng = np.random.Generator
Paint = Callable[[Array], Array]


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
    mesh = replace(truth.mesh, faces=faces, colours=None)
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


def painted(case: Case, truth: Truth, rng: Rng, start: str, exposure: float | None) -> Case:
    """The object is painted and photographed under a random light; the cloud has colours.

    start : "bent 2" or "bent 6", the true cloud in the object's own paint, bent by a smooth random
        field until it is that far off (Chamfer x1000); or "other", the case's start in other paint.
    exposure : 1 is as long as needed; None takes no photo.
    """
    paint, other_paint, bend = paint_of(rng), paint_of(rng), _bend_of(rng)
    lights = _directions(rng, (len(case.views),))
    if start == "other":
        initial, colours = case.initial, other_paint(case.initial)
    else:
        resampled = case.dense[rng.choice(len(case.dense), len(case.target), replace=False)]
        level = 1e-3 * float(start.split()[1])
        initial, colours = _bent(resampled, bend, case.target, level), paint(resampled)
    views = case.views
    if exposure is not None:
        views = tuple(
            replace(view, image=photo(truth.scene, view, paint, light, exposure))
            for view, light in zip(views, lights, strict=True)
        )
    return replace(case, initial=initial, colours=colours, views=views)


def paint_of(rng: Rng) -> Paint:
    """Colours [..., 3] in [0, 1] of places [..., 3]: patches of two tones, with clear edges."""
    lengths = np.exp(rng.uniform(np.log(SHORTEST), np.log(LONGEST), (3, WAVES, 1)))
    directions = _directions(rng, (3, WAVES)) * (2.0 * np.pi / lengths)
    phases = rng.uniform(0.0, 2.0 * np.pi, (3, WAVES))
    dark, light = rng.uniform(0.1, 0.45, 3), rng.uniform(0.55, 0.9, 3)

    def paint(places: Array) -> Array:
        angles = np.einsum("...k,cwk->...cw", places, directions) + phases
        waves = np.cos(angles).sum(-1) / np.sqrt(WAVES)
        return np.asarray(dark + (light - dark) * (0.5 + 0.5 * np.tanh(SHARPNESS * waves)))

    return paint


def photo(
    scene: RayScene, view: View, paint: Paint, light: Array, exposure: float = 1.0
) -> NDArray[np.float32]:
    """[H, W, 3] in [0, 1]: the painted mesh under one far light, on white, 25 rays a pixel.

    ``light`` is a unit vector in the axes of the world.
    """
    camera = view.camera
    offsets = (np.arange(RAYS_ACROSS) + 0.5) / RAYS_ACROSS - 0.5
    columns, rows = (
        (np.arange(size)[:, None] + offsets).ravel() for size in (camera.width, camera.height)
    )
    hits = scene.cast(camera, columns, rows)
    x, y = np.meshgrid(
        (columns - camera.K[0, 2]) / camera.K[0, 0], (rows - camera.K[1, 2]) / camera.K[1, 1]
    )
    hit = hits["hit"]
    depth = hits["depth"][hit][:, None]
    places = (np.stack([x[hit], y[hit], np.ones(hit.sum())], 1) * depth - camera.t) @ camera.R
    shade = AMBIENT + (1.0 - AMBIENT) * np.abs(hits["normal"][hit] @ light)
    image = np.ones((*hit.shape, 3))
    image[hit] = np.minimum(exposure * shade[:, None] * paint(places), 1.0)
    means = image.reshape(camera.height, RAYS_ACROSS, camera.width, RAYS_ACROSS, 3).mean((1, 3))
    return np.asarray(means, dtype=np.float32)


def _bend_of(rng: Rng) -> Callable[[Array], Array]:
    waves = _directions(rng, (BENDS,)) * (2.0 * np.pi / rng.uniform(*BEND_LENGTHS, (BENDS, 1)))
    sizes, phases = rng.normal(size=(BENDS, 3)), rng.uniform(0.0, 2.0 * np.pi, BENDS)
    return lambda points: np.cos(points @ waves.T + phases) @ sizes / np.sqrt(BENDS)


def _bent(points: Array, bend: Callable[[Array], Array], target: Array, level: float) -> Array:
    """``points`` moved along ``bend`` until they are ``level`` from ``target``."""
    field, low, high = bend(points), 0.0, 0.5
    for _ in range(HALVINGS):
        middle = (low + high) / 2.0
        near = chamfer(points + middle * field, target).chamfer < level
        low, high = (middle, high) if near else (low, middle)
    return np.asarray(points + low * field)


def _directions(rng: Rng, shape: tuple[int, ...]) -> Array:
    """Unit vectors [*shape, 3]."""
    vectors = rng.normal(size=(*shape, 3))
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))
