"""Cases to refine: unseen shapes, masks of them, and clouds that are wrong in a known way."""

from __future__ import annotations

import zlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...evaluation.metrics import chamfer
from ...geometry.camera import CANONICAL_ROTATION
from ...geometry.points import Array, farthest_point_sample, sample_surface
from ...geometry.view import View
from ...io.shipped import CATEGORIES
from ...network.model import BaseNetwork, NetworkConfig
from ...render import (
    RayScene,
    RenderSettings,
    fitting_distance,
    look_at,
    render_view,
    sample_cameras,
)
from ...scene.network import network_scene
from .shapes import Shape, shape_type, shapes_of_part

KINDS = ("other", "near", "cut", "right", "network")
"""Where the start is from; "cut" is "other" with an object that the border truncates, "right" another sampling of the truth."""
# The Chamfer distance (longest side 1) that another shape's cloud should have from the truth; a category without one starts
# from its most similar training shape.
LEVELS = {"other": {"airplane": 2.0e-3, "car": 1.6e-3}, "near": {"airplane": 0.4e-3, "car": 0.8e-3}}
LEVELS["cut"] = LEVELS["other"]
SAMPLES, JUDGED = 16_384, 1024
"""Points of a surface, and how many of them say which start is how far off."""
MASKS = 4
"""Of each case. The network sees one picture; the other masks of its cases are from known cameras."""
TRUNCATING_DISTANCE = 0.75
"""Of the camera of kind "cut", of that from which the whole object is seen."""
PICTURE = 128
"""Pixels each way of the picture that the network's crop is cut from."""


@dataclass(frozen=True, eq=False)
class Case:
    """One thing to refine.

    Attributes
    ----------
    category, shape : of the truth; start : the shape that the initial cloud is from.
    initial, target : [N, 3]; dense : [16384, 3], more points of the target. Longest side 1, centred; of kind "network" turned
        into the axes of the camera.
    views : the first is the case's own, the others are further masks.
    floor : Chamfer distance of another sampling of the truth to ``target``.
    image : [3, 64, 64], what the network saw.
    colours : [N, 3] in [0, 1] of ``initial``, for views that have photos.
    """

    kind: str
    category: str
    shape: str
    view: int
    start: str
    initial: Array
    target: Array
    dense: Array
    views: tuple[View, ...]
    floor: float
    image: NDArray[np.float32] | None = None
    colours: Array | None = None


@dataclass(frozen=True, eq=False)
class CaseBuilder:
    """Makes the cases of any shape; everything random depends on the seed and the shape's name alone.

    ``folder`` and ``split_file`` are those of `shapes_of_part`, whose list "train" has the starts; ``size`` is that of the
    masks, in pixels; kind "network" needs the view-aligned ``network``.
    """

    folder: Path
    split_file: Path | None
    views: int
    size: int
    points: int
    seed: int = 0
    network: BaseNetwork | None = None
    about: NetworkConfig | None = None
    _starts: dict[str, list[tuple[Shape, Array, Array]]] = field(default_factory=dict)

    def cases(self, shape: Shape, kind: str) -> list[Case]:
        """The cases of one shape, one for each of the views."""
        mesh = shape.mesh()
        rng = self._rng(shape, "truth")
        dense, resampled = (
            sample_surface(mesh.vertices, mesh.faces, SAMPLES, rng) for _ in range(2)
        )
        target, initial = _subset(dense, self.points), _subset(resampled, self.points)
        floor = chamfer(initial, target).chamfer
        scene, rng = RayScene(mesh), self._rng(shape, kind)
        start = {"right": "the truth", "network": "prediction"}.get(kind, "")
        if not start:
            start, initial = self._start(
                shape, _subset(dense, JUDGED), LEVELS[kind].get(shape.category, 0.0)
            )
        # Each view has the next three beside it; `_predicted` makes those of a network's case.
        count = 0 if kind == "network" else self.views + MASKS - 1
        views = [self._view(shape, number, scene, kind == "cut", rng) for number in range(count)]
        cases = []
        for number in range(self.views):
            beside = tuple(views[number : number + MASKS])
            case = Case(
                kind,
                shape.category,
                shape.name,
                number,
                start,
                initial,
                target,
                dense,
                beside,
                floor,
            )
            cases.append(self._predicted(case, shape, scene, rng) if kind == "network" else case)
        return cases

    def _rng(self, shape: Shape, purpose: str) -> np.random.Generator:
        return np.random.default_rng(
            [self.seed, zlib.crc32(shape.name.encode()), zlib.crc32(purpose.encode())]
        )

    def _start(self, shape: Shape, target: Array, level: float) -> tuple[str, Array]:
        """The training shape of another type whose distance from the truth is nearest to ``level``: its name and cloud."""
        if shape.category not in self._starts:
            starts = self._starts[shape.category] = []
            for training in shapes_of_part(self.folder, self.split_file, "train", [shape.category]):
                mesh = training.mesh()
                samples = sample_surface(
                    mesh.vertices, mesh.faces, SAMPLES, self._rng(training, "truth")
                )
                starts.append((training, samples, _subset(samples, JUDGED)))
        object_type = shape_type(shape.path.stem)
        candidates = [
            start
            for start in self._starts[shape.category]
            if shape_type(start[0].path.stem) != object_type
        ]
        if not candidates:
            found = f"no {shape.category} of another type is in the list train"
            raise InputError(f"{shape.name}: {found}, expected one to start from")
        nearest, samples, _ = min(
            candidates, key=lambda start: abs(chamfer(start[2], target).chamfer - level)
        )
        return nearest.name, _subset(samples, self.points)

    def _view(
        self, shape: Shape, number: int, scene: RayScene, truncated: bool, rng: np.random.Generator
    ) -> View:
        settings = RenderSettings(views=1, size=(self.size, self.size))
        while True:
            if truncated:
                angles = rng.uniform(*settings.azimuth), rng.uniform(*settings.elevation)
                whole = fitting_distance(scene.mesh.vertices, look_at(*angles, 1.0, settings.size))
                camera = look_at(*angles, TRUNCATING_DISTANCE * whole, settings.size)
            else:
                (camera,) = sample_cameras(settings, scene.mesh.vertices, rng)
            mask = render_view(scene, camera, rng).mask
            border = np.concatenate([mask[[0, -1]].ravel(), mask[:, [0, -1]].ravel()])
            # From its narrow side a long object fits the picture from nearer too: then another direction is drawn.
            if not truncated or border.max() > 127:
                return View(
                    mask.astype(np.float32) / 255.0, camera, name=f"{shape.name}, mask {number}"
                )

    def _predicted(
        self, case: Case, shape: Shape, scene: RayScene, rng: np.random.Generator
    ) -> Case:
        """The network's prediction from a picture, before a camera whose distance from the object is known."""
        assert self.network is not None
        assert self.about is not None
        (camera,) = sample_cameras(
            RenderSettings(views=1, size=(PICTURE, PICTURE)), scene.mesh.vertices, rng
        )
        picture = render_view(scene, camera, rng)
        view = View(
            picture.mask.astype(np.float32) / 255.0, camera, name=f"{shape.name}, view {case.view}"
        )
        predicted = network_scene(picture.image, view, self.network, self.about, placing="camera")
        turn = (CANONICAL_ROTATION @ camera.R).T
        # A generator for each view: the number of views changes none of them.
        rng = np.random.default_rng([self.seed, zlib.crc32(shape.name.encode()), case.view])
        views = [self._view(shape, number, scene, False, rng) for number in range(1, MASKS)]
        turned = [
            replace(view, camera=replace(view.camera, R=view.camera.R @ turn)) for view in views
        ]
        clouds = {
            "initial": predicted.points,
            "target": case.target @ turn,
            "dense": case.dense @ turn,
        }
        return replace(case, views=(predicted.view, *turned), image=predicted.image, **clouds)


def kinds_of(category: str, kinds: Sequence[str]) -> list[str]:
    """Those of ``kinds`` that there are for a category."""
    near, known = category in LEVELS["near"], category in CATEGORIES
    return [kind for kind in kinds if (kind != "near" or near) and (kind != "network" or known)]


def _subset(samples: Array, count: int) -> Array:
    """So many of ``samples`` [S, 3], spread evenly."""
    return samples if count == len(samples) else samples[farthest_point_sample(samples, count)]
