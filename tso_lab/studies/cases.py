"""Cases to refine: masks of unseen shapes, clouds wrong in a known way; and ways to refine them."""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from tso_cli.datasets.variants import shape_type
from tso_cli.errors import InputError, TsoError
from tso_cli.evaluation.metrics import chamfer
from tso_cli.geometry.camera import CANONICAL_ROTATION
from tso_cli.geometry.points import Array, farthest_point_sample, sample_surface
from tso_cli.geometry.rotations import from_quaternion
from tso_cli.geometry.view import View
from tso_cli.io.shipped import CATEGORIES, NO_PRIOR
from tso_cli.network.model import BaseNetwork, NetworkConfig
from tso_cli.optimisation.presets import Mode
from tso_cli.refinement import RefineConfig, RefineResult, refine, refine_batch
from tso_cli.render.rays import RayScene, render_view
from tso_cli.render.settings import RenderSettings
from tso_cli.render.viewpoints import fitting_distance, look_at, sample_cameras
from tso_cli.scene.network import network_scene

from ..study import uninterrupted
from .shapes import Shape, shapes_of_part

KINDS = ("other", "turned", "near", "cut", "right", "network")
"""Where the start is from:

- other: another shape of the category, about as wrong as a trained network's prediction;
- turned: the cases of other, where start, truth and cameras are turned together by a random
  rotation: the cloud lies at an angle to its axes;
- near: another shape close to the truth;
- cut: as other, and the border of the picture truncates the object;
- right: another sampling of the truth;
- network: the network's prediction.
"""
# Chamfer distance (longest side 1) from another shape's cloud to the truth that is aimed at. A
# category without one starts from its most similar training shape.
LEVELS = {"other": {"airplane": 2.0e-3, "car": 1.6e-3}, "near": {"airplane": 0.4e-3, "car": 0.8e-3}}
LEVELS["turned"] = LEVELS["cut"] = LEVELS["other"]
SAMPLES, COMPARED = 16_384, 1024
"""Points of a surface, and how many of them are compared to choose a start."""
MASKS = 4
"""Of each case. The network sees one picture; its further masks are from known cameras."""
TRUNCATING_DISTANCE = 0.75
"""Distance of the camera of kind "cut", over that from which the whole object is seen."""
PICTURE = 128
"""Pixels each way of the picture that the network's crop is cut from."""


@dataclass(frozen=True, eq=False)
class Case:
    """One thing to refine.

    Attributes
    ----------
    category, shape : of the truth; start : the shape that the initial cloud is from.
    initial, target : [N, 3]; dense : [16384, 3], more points of the target. Longest side 1,
        centred; of kind "turned" turned at random, of kind "network" into the axes of the camera.
    views : the first is the case's own, the others are further masks.
    floor : Chamfer distance from another sampling of the truth to ``target``.
    image : [3, 64, 64], what the network saw.
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

    @property
    def names(self) -> dict[str, str | int]:
        """What records call the case."""
        return {key: getattr(self, key) for key in ("kind", "category", "shape", "view")}

    def turned(self, rotation: Array) -> Case:
        """The whole world turned: clouds by ``rotation`` [3, 3], cameras so that masks stay."""
        inverse = rotation.T
        views = (
            replace(view, camera=replace(view.camera, R=view.camera.R @ inverse))
            for view in self.views
        )
        clouds = {name: getattr(self, name) @ inverse for name in ("initial", "target", "dense")}
        return replace(self, views=tuple(views), **clouds)


@dataclass(frozen=True, eq=False)
class CaseBuilder:
    """Makes the cases of any shape; all random numbers depend on seed and shape's name alone.

    ``folder`` and ``split_file`` are those of `shapes_of_part`; starts come from its list "train".
    ``size`` is the size of the masks in pixels. Kind "network" needs the view-aligned ``network``.
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
        dense = sample_surface(mesh.vertices, mesh.faces, SAMPLES, rng)
        resampled = sample_surface(mesh.vertices, mesh.faces, SAMPLES, rng)
        target, initial = (
            farthest_point_subset(dense, self.points),
            farthest_point_subset(resampled, self.points),
        )
        floor = chamfer(initial, target).chamfer
        # The cases of kind "turned" are those of "other", so that both can be compared one by one.
        scene, rng = RayScene(mesh), self._rng(shape, "other" if kind == "turned" else kind)
        start = {"right": "the truth", "network": "prediction"}.get(kind, "")
        if not start:
            level = LEVELS[kind].get(shape.category, 0.0)
            start, initial = self._start(shape, farthest_point_subset(dense, COMPARED), level)
        names = (kind, shape.category, shape.name)

        def case(number: int, *views: View) -> Case:
            return Case(*names, number, start, initial, target, dense, views, floor)

        if kind == "network":
            plain = map(case, range(self.views))
            return [self._predicted(case, shape, scene, rng) for case in plain]
        # The three views after its own are a case's further masks.
        numbers = range(self.views + MASKS - 1)
        views = [self._view(shape, number, scene, kind == "cut", rng) for number in numbers]
        cases = [case(number, *views[number : number + MASKS]) for number in range(self.views)]
        if kind == "turned":
            quaternion = self._rng(shape, kind).normal(size=4).tolist()
            cases = [case.turned(from_quaternion(*quaternion)) for case in cases]
        return cases

    def _rng(self, shape: Shape, purpose: str) -> np.random.Generator:
        words = (zlib.crc32(word.encode()) for word in (shape.name, purpose))
        return np.random.default_rng([self.seed, *words])

    def _start(self, shape: Shape, target: Array, level: float) -> tuple[str, Array]:
        """Name and cloud of a training shape of another type, about ``level`` from the truth."""
        if shape.category not in self._starts:
            starts = self._starts[shape.category] = []
            for training in shapes_of_part(self.folder, self.split_file, "train", [shape.category]):
                mesh, rng = training.mesh(), self._rng(training, "truth")
                samples = sample_surface(mesh.vertices, mesh.faces, SAMPLES, rng)
                starts.append((training, samples, farthest_point_subset(samples, COMPARED)))
        own_type = shape_type(shape.path.stem)
        candidates = [
            start
            for start in self._starts[shape.category]
            if shape_type(start[0].path.stem) != own_type
        ]
        if not candidates:
            found = f"no {shape.category} of another type is in the list train"
            raise InputError(f"{shape.name}: {found}, expected one to start from")
        nearest, samples, _ = min(
            candidates, key=lambda start: abs(chamfer(start[2], target).chamfer - level)
        )
        return nearest.name, farthest_point_subset(samples, self.points)

    def _view(
        self, shape: Shape, number: int, scene: RayScene, truncated: bool, rng: np.random.Generator
    ) -> View:
        settings = RenderSettings(views=1, size=(self.size, self.size))
        vertices = scene.mesh.vertices
        while True:
            if truncated:
                angles = rng.uniform(*settings.azimuth), rng.uniform(*settings.elevation)
                unit = look_at(*angles, 1.0, settings.size)
                distance = TRUNCATING_DISTANCE * fitting_distance(vertices, unit)
                camera = look_at(*angles, distance, settings.size)
            else:
                (camera,) = sample_cameras(settings, vertices, rng)
            mask = render_view(scene, camera, rng).mask
            border = np.concatenate([mask[[0, -1]].ravel(), mask[:, [0, -1]].ravel()])
            # Seen from its narrow side, a long object may fit: then another direction is drawn.
            if not truncated or border.max() > 127:
                foreground = mask.astype(np.float32) / 255.0
                return View(foreground, camera, name=f"{shape.name}, mask {number}")

    def _predicted(
        self, case: Case, shape: Shape, scene: RayScene, rng: np.random.Generator
    ) -> Case:
        """The network's prediction from a picture, with a camera at the true distance."""
        assert self.network is not None
        assert self.about is not None
        settings = RenderSettings(views=1, size=(PICTURE, PICTURE))
        (camera,) = sample_cameras(settings, scene.mesh.vertices, rng)
        picture = render_view(scene, camera, rng)
        foreground = picture.mask.astype(np.float32) / 255.0
        view = View(foreground, camera, name=f"{shape.name}, view {case.view}")
        predicted = network_scene(picture.image, view, self.network, self.about, placing="camera")
        # A generator for each view: the number of views changes none of them.
        rng = np.random.default_rng([self.seed, zlib.crc32(shape.name.encode()), case.view])
        views = (self._view(shape, number, scene, False, rng) for number in range(1, MASKS))
        turned = replace(case, views=tuple(views)).turned(CANONICAL_ROTATION @ camera.R)
        return replace(
            turned,
            initial=predicted.points,
            views=(predicted.view, *turned.views),
            image=predicted.image,
        )


def kinds_of(category: str, kinds: Sequence[str]) -> list[str]:
    """The ``kinds`` of cases that a category has."""
    limited = {"near": LEVELS["near"], "network": CATEGORIES}
    return [kind for kind in kinds if kind not in limited or category in limited[kind]]


def farthest_point_subset(samples: Array, count: int) -> Array:
    """``count`` of ``samples`` [S, 3], spread evenly."""
    return samples if count == len(samples) else samples[farthest_point_sample(samples, count)]


# The ways of refining that studies compare.


@dataclass(frozen=True)
class Variant:
    """One way of refining a case.

    config : settings. masks : how many masks of the case are seen.
    then : settings of a second refinement, in points mode, which starts from the result.
    """

    config: RefineConfig = field(default_factory=RefineConfig)
    masks: int = 1
    then: RefineConfig | None = None


PAPER: Final = "paper"
DEFAULT: Final = "best"
NO_SYMMETRY, TWO_MASKS, FOUR_MASKS = "best, no symmetry", "best, two masks", "best, four masks"
BY_MASKS = (DEFAULT, TWO_MASKS, FOUR_MASKS)
"""The default preset with one, two and four masks."""
# The paper's method leaves nothing as it was.
POINTS = {
    PAPER: Variant(RefineConfig(preset="paper", accept_doubtful=True)),
    DEFAULT: Variant(),
    NO_SYMMETRY: Variant(RefineConfig(symmetry="none")),
    TWO_MASKS: Variant(masks=2),
    FOUR_MASKS: Variant(masks=4),
}
FIRST_MODES: tuple[Mode, ...] = ("latent", "encoder-decoder")
COMBINED = {
    f"{mode}, then points": Variant(
        RefineConfig(mode=mode, accept_doubtful=True), then=RefineConfig()
    )
    for mode in FIRST_MODES
}
ABLATION = {
    PAPER: POINTS[PAPER],
    DEFAULT: POINTS[DEFAULT],
    "no mirror plane": POINTS[NO_SYMMETRY],
    "no learned prior": Variant(RefineConfig(prior=NO_PRIOR)),
    "one step": Variant(RefineConfig(steps=1)),
}
"""The default preset with one ingredient changed in each row, below the paper's and itself."""


def with_prior(variants: Mapping[str, Variant], prior: str) -> dict[str, Variant]:
    """The ``variants`` with this learned prior, wherever the default preset moves points.

    A variant that has chosen its prior keeps it.
    """

    def chosen(config: RefineConfig) -> RefineConfig:
        takes_one = (config.preset, config.mode) == (DEFAULT, "points") and config.prior is None
        return replace(config, prior=prior) if takes_one else config

    return {
        name: replace(
            variant, config=chosen(variant.config), then=variant.then and chosen(variant.then)
        )
        for name, variant in variants.items()
    }


def refined(
    cases: list[Case], variant: Variant, network: BaseNetwork | None = None
) -> list[RefineResult]:
    """The result of each case; TsoError where a case cannot be refined."""
    # Networks have no batch.
    if variant.config.mode != "points":
        return [alone(case, variant, network) for case in cases]
    problems = [(case.initial, case.views[: variant.masks]) for case in cases]
    results = []
    for result in refine_batch(problems, variant.config):
        uninterrupted(result)
        if isinstance(result, TsoError):
            raise result
        results.append(result)
    return results


def alone(case: Case, variant: Variant, network: BaseNetwork | None) -> RefineResult:
    """The result of one case, refined by itself."""
    config, views = variant.config, case.views[: variant.masks]
    if config.mode == "points":
        return uninterrupted(refine(case.initial, views, config=config))
    result = uninterrupted(refine(None, views, config=config, network=network, image=case.image))
    if variant.then is None:
        return result
    then = uninterrupted(refine(result.points, views, config=variant.then))
    return replace(then, fit=replace(then.fit, iou_before=result.fit.iou_before))
