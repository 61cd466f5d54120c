"""Fingerprints: a few numbers of what the method makes of the shipped examples.

They show whether a record was made by the method as it is.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
import torch

from tso_cli.evaluation.metrics import chamfer
from tso_cli.geometry.rotations import angle_between, from_vectors
from tso_cli.geometry.view import View
from tso_cli.io.clouds import read_cloud
from tso_cli.io.shipped import default_checkpoint, examples_folder
from tso_cli.losses.silhouette import silhouette_of
from tso_cli.optimisation.presets import Mode, Preset
from tso_cli.pose.fit import fit_camera
from tso_cli.prior.file import read_prior, shipped_prior
from tso_cli.refinement import PRESETS, RefineConfig, RefineResult, refine
from tso_cli.render.settings import RenderSettings
from tso_cli.scene.load import load_points_scene
from tso_cli.scene.network import load_network_scene
from tso_cli.train.config import TrainConfig
from tso_cli.train.loop import train
from tso_cli.train.sources import shipped_examples

from ..bench.speed import views_around
from ..study import uninterrupted
from .shapes import Shape, see

Numbers = dict[str, float]
# Relative. Threads, plain loops, another BLAS or other instructions change a number by 3e-4 at
# most. But in the default preset the last bit of a start can choose other nodes,
# and masks and steps amplify the change.
TOLERANCE = 0.005
# Of parts whose numbers depend on the last bits of a processor's sums: networks compute in float32.
TOLERANCES = {
    "points, best": {"Chamfer": 0.02, "IoU": 0.01},
    "network modes, best": {"IoU": 0.03},
}
CHAIR, PLANE = examples_folder() / "chair", examples_folder() / "airplane"


def _figures(label: str, result: RefineResult, points: np.ndarray) -> Numbers:
    distance = chamfer(points, read_cloud(CHAIR / "target.ply").points).chamfer
    return {f"{label}: Chamfer": 1e3 * distance, f"{label}: IoU": result.fit.iou_after}


def _points(preset: Preset) -> Numbers:
    """The chair with one mask, with four, truncated, and with the depth map of a plane."""
    scene = load_points_scene(CHAIR / "initial.ply", CHAIR / "mask.png")
    truth = read_cloud(CHAIR / "target.ply").points
    view, camera, numbers = scene.view, scene.view.camera, Numbers()
    around = views_around(view, truth, np.pi * np.array([0.5, 1.0, 1.5]))
    seen = {"one mask": [view], "four masks": around}
    seen["truncated"] = [View(view.mask[:, :128], replace(camera, width=128))]
    if preset == "best":
        plane = np.full(view.mask.shape, camera.t[2])
        seen["depth"] = [replace(view, depth=plane, depth_kind="z")]
    for label, views in seen.items():
        result = uninterrupted(refine(scene.points, views, config=RefineConfig(preset=preset)))
        numbers |= _figures(label, result, result.points)
    return numbers


def _network_modes(preset: Preset) -> Numbers:
    """The shipped network's prediction of the chair after 12 steps of each mode."""
    files = CHAIR / "image.png", CHAIR / "mask.png", default_checkpoint()
    scene, numbers = load_network_scene(*files, world=True), Numbers()
    modes: tuple[Mode, ...] = ("encoder", "encoder-decoder", "latent")
    for mode in modes:
        config = RefineConfig(mode=mode, preset=preset, steps=12)
        result = refine(None, scene.view, config=config, network=scene.network, image=scene.image)
        uninterrupted(result)
        numbers |= _figures(mode, result, scene.to_output(result.points))
    return numbers


def _camera_fit() -> Numbers:
    """The fitted camera of the true aeroplane, and its camera turned by 10 degrees, corrected."""
    scene = load_points_scene(PLANE / "target.ply", PLANE / "mask.png")
    points, view, camera = scene.points, scene.view, scene.view.camera
    tilt = from_vectors(np.radians(10.0) * np.array([0.6, 0.64, 0.48]))
    turned = View(silhouette_of(points, camera), replace(camera, R=tilt @ camera.R))
    result = uninterrupted(refine(points, turned, config=RefineConfig(move="camera")))
    corrected = result.cameras[0]
    degrees = float(angle_between(corrected.R, camera.R))
    return {"IoU": fit_camera(points, view.mask).iou, "degrees": degrees}


def _training() -> Numbers:
    """The loss after three steps under each supervision.

    At higher rates rounding changes it by several per cent.
    """
    masks = TrainConfig(supervision="masks", views=1, steps=3, batch_size=3, learning_rate=3e-6)
    configs = {
        "masks": masks,
        "printed Eq. 5": replace(masks, affinity="paper"),
        "points": replace(masks, supervision="points"),
    }
    return {
        name: float(uninterrupted(train(shipped_examples(), config)).history[-1][0])
        for name, config in configs.items()
    }


def _prior_training() -> Numbers:
    """The parts of the loss of the shipped prior on a batch of the shipped meshes."""
    from tso_cli.train.prior.bank import build_bank
    from tso_cli.train.prior.loss import PARTS, loss
    from tso_cli.train.prior.shapes import read_shapes
    from tso_cli.train.prior.starts import draw

    bank = build_bank(read_shapes(examples_folder() / "meshes"), 8, 0)
    weights, _ = read_prior(shipped_prior())
    tensors = {name: torch.tensor(np.float32(array)) for name, array in weights.items()}
    batch = draw(bank, np.random.default_rng(0), 16)
    parts = loss(tensors, batch, torch.Generator().manual_seed(0))
    return dict(zip(PARTS, parts.tolist(), strict=True))


def _pictures() -> Numbers:
    """A shipped mesh as the studies render theirs."""
    mesh = CHAIR.parent / "meshes" / "chair" / "q17_Chair.ply"
    shape = see(Shape("chair/q17_Chair", mesh), RenderSettings(views=1), 0)
    view = shape.views[0]
    seen = {"mask": view.mask, "image": view.image, "points": np.abs(shape.target)}
    return {key: float(values.mean()) for key, values in seen.items()}


PARTS: dict[str, Callable[[], Numbers]] = {
    **{f"points, {preset}": partial(_points, preset) for preset in PRESETS},
    **{f"network modes, {preset}": partial(_network_modes, preset) for preset in PRESETS},
    **{"camera fit": _camera_fit, "training": _training, "pictures": _pictures},
    "training of a prior": _prior_training,
}


@cache
def today(part: str) -> Numbers:
    """The numbers of a part by the method as it is, five digits each."""
    return {key: float(f"{value:.5g}") for key, value in PARTS[part]().items()}


def differences(record: dict[str, Any]) -> list[str]:
    """A line for each number by which the method of ``record`` differs from today's."""
    fingerprint = record.get("fingerprint")
    lines = [] if fingerprint else ["it has no fingerprint"]
    for part, earlier in (fingerprint or {}).items():
        numbers = today(part) if part in PARTS else {}
        for key in dict.fromkeys((*numbers, *earlier)):
            then, now = earlier.get(key), numbers.get(key)
            tolerance = TOLERANCES.get(part, {}).get(key.split(": ")[-1], TOLERANCE)
            if then is None or now is None or not abs(then - now) <= tolerance * abs(now):
                lines.append(f"{part}: {key} {then}, now {now}")
    return lines
