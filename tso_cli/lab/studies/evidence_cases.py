"""Cases with other evidence: depth maps, wrong views, wrong cameras, objects that lack a part."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from ...geometry.camera import Camera
from ...geometry.points import farthest_point_sample, sample_surface
from ...geometry.rotations import from_vectors
from ...geometry.view import View
from ...io.meshes import Mesh, read_mesh
from ...refinement.symmetry import find_mirror_plane
from ...render import RayScene, fitting_distance, look_at, normalise, render_view
from .accuracy_cases import SAMPLES, AccuracyCase
from .parts import Shape

# Fewer than these, once a part of the object is gone, make no case.
FEWEST_FACES, FEWEST_PIXELS = 20, 50
# A wrong camera is shifted by this share of its distance for each degree that it is turned.
SHIFT = 0.005
WRONG_TURN = 30.0
# Three cameras that stand close together, and one to the side of them; degrees.
BUNCHED = (0.0, 10.0, 20.0, 100.0)

Rng = np.random.Generator


@dataclass(frozen=True)
class Truth:
    """The shape that a case is of, and another one of its category; None where there is no other."""

    shape: Shape
    other: Shape | None

    @cached_property
    def mesh(self) -> Mesh:
        return normalise(read_mesh(self.shape.path))

    @cached_property
    def scene(self) -> RayScene:
        return RayScene(self.mesh)

    @cached_property
    def other_scene(self) -> RayScene | None:
        return None if self.other is None else RayScene(normalise(read_mesh(self.other.path)))


Alter = Callable[[AccuracyCase, Truth, Rng], AccuracyCase | None]
"""Alters a case; None where that is not possible."""


def as_it_is(case: AccuracyCase, truth: Truth, rng: Rng) -> AccuracyCase:
    return case


def framed(view: View, times: int, across: float, down: float) -> View:
    """The view's picture in a photo so many times as wide and high, at a share of the free way; around it is background."""
    height, width = view.mask.shape
    top, left = int(height * (times - 1) * down), int(width * (times - 1) * across)
    mask = np.zeros((times * height, times * width), np.float32)
    mask[top : top + height, left : left + width] = view.mask
    K = view.camera.K + [[0, 0, left], [0, 0, top], [0, 0, 0]]
    return View(mask, replace(view.camera, K=K, width=mask.shape[1], height=mask.shape[0]), name=view.name)


def with_depth(case: AccuracyCase, truth: Truth, rng: Rng, noise: float = 0.0) -> AccuracyCase:
    """Each view with the depth of the true surface at its pixels, and Gaussian noise (longest side 1) on it."""
    views = []
    for view in case.views:
        columns, rows = np.arange(view.camera.width), np.arange(view.camera.height)
        depth = truth.scene.cast(view.camera, columns.astype(float), rows.astype(float))["depth"]
        depth = np.where(np.isfinite(depth), depth + noise * rng.normal(size=depth.shape), 0.0)
        views.append(replace(view, depth=depth))
    return replace(case, views=tuple(views))


def without(case: AccuracyCase, truth: Truth, rng: Rng, part: str) -> AccuracyCase | None:
    """The object lacks "side", "high" or "low" parts on one side of the start's mirror plane; the start has them.

    Faces go whose middle lies more than 0.12 beyond the plane through the middle, or more than 0.03 and higher than 0 or lower
    than -0.1 (longest side 1, y up).
    """
    normal = np.abs(find_mirror_plane(case.initial).normal)
    middles = truth.mesh.vertices[truth.mesh.faces].mean(1)
    beyond, height = middles[:, 0 if normal[0] >= normal[2] else 2], middles[:, 1]
    gone = {"side": beyond > 0.12, "high": (beyond > 0.03) & (height > 0.0), "low": (beyond > 0.03) & (height < -0.1)}[part]
    faces = truth.mesh.faces[~gone]
    if len(faces) < FEWEST_FACES:
        return None
    mesh = replace(truth.mesh, faces=faces, colours=None)
    scene = RayScene(mesh)
    masks = [_mask(scene, view.camera) for view in case.views]
    if min(int((mask > 0.5).sum()) for mask in masks) < FEWEST_PIXELS:
        return None
    views = tuple(replace(view, mask=mask) for view, mask in zip(case.views, masks, strict=True))
    dense = sample_surface(mesh.vertices, mesh.faces, SAMPLES, rng)
    return replace(case, views=views, dense=dense, target=dense[farthest_point_sample(dense, len(case.target))])


def bunched(case: AccuracyCase, truth: Truth, rng: Rng) -> AccuracyCase:
    """Three of the four cameras within 20 degrees, the last to the side of them."""
    size = case.views[0].camera.width, case.views[0].camera.height
    azimuth, elevation = rng.uniform(0.0, 360.0), rng.uniform(-5.0, 40.0)
    views = []
    for turn in BUNCHED:
        near = look_at(azimuth + turn, elevation, 1.0, size)
        camera = look_at(azimuth + turn, elevation, fitting_distance(truth.mesh.vertices, near), size)
        views.append(View(_mask(truth.scene, camera), camera, name=f"{case.shape}, {turn:g} degrees"))
    return replace(case, views=tuple(views))


def anothers_mask(case: AccuracyCase, truth: Truth, rng: Rng) -> AccuracyCase | None:
    """The last view's mask is that of another shape of the category."""
    if truth.other_scene is None:
        return None
    wrong = case.views[-1]
    return replace(case, views=(*case.views[:-1], replace(wrong, mask=_mask(truth.other_scene, wrong.camera))))


def turned_away(case: AccuracyCase, truth: Truth, rng: Rng) -> AccuracyCase:
    """The last view's camera is taken to stand 30 degrees to the side, left or right, of where it stood."""
    wrong = case.views[-1]
    turn = from_vectors(np.array([0.0, np.radians(WRONG_TURN) * rng.choice([-1.0, 1.0]), 0.0]))
    camera = replace(wrong.camera, R=wrong.camera.R @ turn)
    return replace(case, views=(*case.views[:-1], replace(wrong, camera=camera)))


def cameras_off(case: AccuracyCase, truth: Truth, rng: Rng, degrees: float) -> AccuracyCase:
    """Every camera is turned by so many degrees about the object's middle, about any axis, and shifted in proportion."""
    views = []
    for view in case.views:
        turn, shift = (vector / np.linalg.norm(vector) for vector in rng.normal(size=(2, 3)))
        turned = from_vectors(np.radians(degrees) * turn)
        moved = view.camera.t + degrees * SHIFT * view.camera.t[2] * shift
        views.append(replace(view, camera=replace(view.camera, R=turned @ view.camera.R, t=moved)))
    return replace(case, views=tuple(views))


def _mask(scene: RayScene, camera: Camera) -> NDArray[np.float32]:
    mask: NDArray[np.float32] = render_view(scene, camera).mask.astype(np.float32) / 255.0
    return mask
