"""The parts of fingerprints: each a piece of the method, run on the shipped examples, in a few numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from ...datasets.items import ObjectItem, ViewItem
from ...evaluation.metrics import chamfer
from ...geometry.points import Array
from ...geometry.resampling import area_resize
from ...geometry.rotations import angle_between, from_vectors
from ...geometry.view import View
from ...io.clouds import read_cloud
from ...io.images import read_image
from ...io.meshes import read_mesh
from ...io.shipped import CATEGORIES, default_checkpoint, examples_folder
from ...losses.silhouette import silhouette_of
from ...pose.fit import fit_camera
from ...refinement import MODES, PRESETS, RefineConfig, RefineResult, refine
from ...render import RenderSettings, normalise
from ...scene.load import load_points_scene
from ...scene.network import load_network_scene
from ...train import TrainConfig, train
from ...train.data import TrainingData
from .discretised import GAUSSIAN, PROJECTIONS, projected_objective
from .evidence_cases import framed
from .examples import example_scene, refine_scene
from .judging import judge, predict
from .mean_shape import mean_shape, pair_chamfer
from .parts import Shape, see

Numbers = dict[str, float]
# What takes longer than points mode is run on one example alone, and weights take at most so many steps.
ONE = "chair"
WEIGHT_STEPS = 12
QUARTER_TURNS = (90.0, 180.0, 270.0)
OFF_DEGREES, OFF_AXIS = 10.0, np.array([0.6, 0.64, 0.48])
SIGMAS = (0.1, 0.4, 1.6)
# What is rendered, and steps and pictures in each of the trainings.
MESH = "chair/q17_Chair"
STEPS, BATCH, SEED = 3, 3, 0
# At the studies' own rate, a hundred times as high, the last bit of one loss changes the next but one by several per cent.
RATE = 3e-6


def refined(mode: str, preset: str) -> Numbers:
    """Settings of the refinement, and for each example Chamfer distance to the truth and mean displacement, x1000."""
    config = RefineConfig(mode, preset=preset)
    settings = config.settings()
    numbers: Numbers = {"steps": settings.steps, "learning rate": settings.learning_rate, "gamma": settings.gamma}
    steps = settings.steps if mode == "points" else min(settings.steps, WEIGHT_STEPS)
    for name in CATEGORIES if mode == "points" else (ONE,):
        scene = example_scene(examples_folder() / name, mode, default_checkpoint())
        result = refine_scene(scene, replace(config, sigma_sq=scene.sigma_sq, steps=steps))
        after = _after(name, result, scene.to_output(result.points))
        numbers |= {f"{name}: {what}": value for what, value in after.items()}
    return numbers


def predicted() -> Numbers:
    """Chamfer distance x1000 of the shipped network's predictions to the truth, placed by silhouette and by box."""
    numbers: Numbers = {}
    for name in CATEGORIES:
        folder, target = examples_folder() / name, _truth(name)
        for placing in ("silhouette", "box"):
            scene = load_network_scene(
                folder / "image.png", folder / "mask.png", default_checkpoint(), world=True, placing=placing
            )
            numbers[f"{name}: {placing}"] = 1e3 * chamfer(scene.to_output(scene.points), target).chamfer
    return numbers


def from_four_sides(preset: str) -> Numbers:
    """The example's own mask, and silhouettes of the truth from the three other sides."""
    return _refined(_from_four_sides(), preset)


def of_64_pixels() -> Numbers:
    """The example's mask averaged to 64x64."""
    return _refined((_of_64_pixels(_view()),))


def in_photos(*widths: int) -> Numbers:
    """The example's picture in a photo so many times as wide; with more widths, the truth's silhouettes from four sides."""
    views = _from_four_sides() if len(widths) > 1 else (_view(),)
    return _refined(tuple(framed(view, times, 0.5, 0.3) for view, times in zip(views, widths, strict=True)))


def of_a_mesh() -> Numbers:
    """A shipped mesh toward the example's mask; its surface is judged."""
    mesh = normalise(read_mesh(examples_folder() / "meshes" / f"{MESH}.ply"))
    result = refine(mesh.vertices, (_view(),), faces=mesh.faces)
    return _after(ONE, result, result.judged[1])


def cut_by_the_border(preset: str) -> Numbers:
    """The picture ends in the middle of the object."""
    view = _view()
    left, _, right, _ = view.box()
    width = round((left + right) / 2.0)
    camera = view.camera.cropped((-0.5, -0.5, width - 0.5, view.camera.height - 0.5), width, view.camera.height)
    return _refined((replace(view, mask=view.mask[:, :width], camera=camera),), preset)


def with_depth() -> Numbers:
    """A depth map: that of the true point nearest to each pixel."""
    view = _view()
    return _refined((replace(view, depth=view.camera.project(_truth(ONE))[1][_nearest(view)]),))


def with_photo() -> Numbers:
    """A photo in the colours of the true point nearest to each pixel, of a cloud painted alike."""
    view = _view()
    image = _painted(_truth(ONE))[_nearest(view)].astype(np.float32)
    return _refined((replace(view, image=image),), colours=_painted(_start()))


def with_its_camera_refined() -> Numbers:
    """The true cloud and its silhouette by a camera that is turned away; and by how many degrees the corrected one still is."""
    right, truth = _view("airplane").camera, _truth("airplane")
    turned = replace(right, R=from_vectors(np.radians(OFF_DEGREES) * OFF_AXIS) @ right.R)
    result = refine(truth, View(silhouette_of(truth, right), turned), config=RefineConfig(refine_camera=True))
    return {**_after("airplane", result), "degrees": float(angle_between(result.cameras[0].R, right.R))}


def camera_fitted() -> Numbers:
    """The camera of a mask and the true cloud: degrees off, IoU and distance."""
    view = _view("car")
    fitted = fit_camera(_truth("car"), view.mask)
    degrees = float(angle_between(fitted.camera.R, view.camera.R))
    return {"degrees": degrees, "IoU": fitted.iou, "distance": float(fitted.camera.t[2])}


def silhouettes() -> Numbers:
    """Mean |silhouette - mask| over the pixels of 64x64, by sigma^2."""
    numbers: Numbers = {}
    for name in CATEGORIES:
        view = _of_64_pixels(_view(name))
        for sigma_sq in SIGMAS:
            error = np.abs(silhouette_of(_truth(name), view.camera, sigma_sq) - view.mask).mean()
            numbers[f"{name}: sigma^2 {sigma_sq:g}"] = float(error)
    return numbers


def pictures() -> Numbers:
    """A shipped mesh as the studies render theirs: foreground, brightness, distance of its views; how far its points reach."""
    shape = Shape(MESH, examples_folder() / "meshes" / f"{MESH}.ply")
    seen = see(shape, RenderSettings(views=2, size=(96, 96)), SEED)
    numbers: Numbers = {"points": float(np.abs(seen.target).mean())}
    for number, view in enumerate(seen.views, 1):
        numbers[f"view {number}: foreground"] = float(view.mask.mean())
        numbers[f"view {number}: brightness"] = float(view.image.mean())
        numbers[f"view {number}: distance"] = float(view.camera.t[2])
    return numbers


def trained(projection: str = GAUSSIAN, **changes: Any) -> Numbers:
    """The loss of three steps on the examples, and what the network then predicts of their pictures: Chamfer x1000, scaled."""
    config = TrainConfig(
        steps=STEPS, batch_size=BATCH, learning_rate=RATE, averaging=0.99, frame="canonical", seed=SEED, **changes
    )
    objective = None if projection == GAUSSIAN else projected_objective(config, projection)
    data = _seen_from_four_sides()
    result = train(data, config, objective=objective)
    losses = {f"loss {step}": float(row[0]) for step, row in enumerate(result.history, 1)}
    judged = judge(predict(result.network, data, config.frame, views=1))
    return losses | {category: 1e3 * row["capnet"]["chamfer"] for category, row in judged.items()}


def mean_shape_of_the_examples() -> Numbers:
    """The mean shape of the examples: Chamfer distance x1000 to each."""
    targets = [_truth(name).astype(np.float32) for name in CATEGORIES]
    mean = mean_shape(targets, SEED, steps=STEPS)
    return {name: 1e3 * pair_chamfer(mean, target) for name, target in zip(CATEGORIES, targets, strict=True)}


MASKS = {"supervision": "masks"}
PARTS: dict[str, Callable[[], Numbers]] = {
    **{f"{mode}, {preset}": partial(refined, mode, preset) for mode in MODES for preset in PRESETS},
    **{f"points, {preset}, four masks": partial(from_four_sides, preset) for preset in PRESETS},
    **{f"points, {preset}, cut by the border": partial(cut_by_the_border, preset) for preset in PRESETS},
    "points, best, in a larger photo": partial(in_photos, 5),
    "points, best, in photos of other widths each": partial(in_photos, 1, 4, 2, 8),
    "points, best, mask of 64 px": of_64_pixels,
    "points, best, mesh": of_a_mesh,
    "points, best, depth map": with_depth,
    "points, best, photo": with_photo,
    "points, best, camera refined": with_its_camera_refined,
    "pictures": pictures,
    "prediction": predicted,
    "camera fitted": camera_fitted,
    "silhouette": silhouettes,
    "training on points": partial(trained, supervision="points"),
    "training on masks": partial(trained, **MASKS),
    "training on masks, printed affinity": partial(trained, affinity="paper", **MASKS),
    **{f"training on masks, {projection} projection": partial(trained, projection, **MASKS) for projection in PROJECTIONS},
    "mean shape": mean_shape_of_the_examples,
}


def _refined(views: tuple[View, ...], preset: str = "best", colours: Array | None = None) -> Numbers:
    result = refine(_start(), views, config=RefineConfig(preset=preset), colours=colours)
    return _after(ONE, result)


def _after(name: str, result: RefineResult, points: Array | None = None) -> Numbers:
    """Of the refined cloud in the truth's frame: that of the result, unless ``points`` are given."""
    points = result.points if points is None else points
    moved = np.linalg.norm(result.points - result.initial, axis=1).mean()
    distance = 1e3 * chamfer(points, _truth(name)).chamfer
    return {"Chamfer": distance, "moved": 1e3 * float(moved), "IoU": result.iou_after}


@cache
def _truth(name: str) -> Array:
    return read_cloud(examples_folder() / name / "target.ply").points


@cache
def _view(name: str = ONE) -> View:
    return load_points_scene(examples_folder() / name / "initial.ply", examples_folder() / name / "mask.png").view


def _start() -> Array:
    return read_cloud(examples_folder() / ONE / "initial.ply").points


def _from_four_sides() -> tuple[View, ...]:
    turned = [_turned(_view(), degrees) for degrees in QUARTER_TURNS]
    return (_view(), *(replace(view, mask=silhouette_of(_truth(ONE), view.camera)) for view in turned))


def _of_64_pixels(view: View) -> View:
    whole = (-0.5, -0.5, view.camera.width - 0.5, view.camera.height - 0.5)
    return View(area_resize(view.mask, whole, 64, 64)[0].astype(np.float32), view.camera.resized(64, 64))


def _turned(view: View, degrees: float) -> View:
    """The view with the object turned about its upright axis."""
    turn = from_vectors(np.array([0.0, np.radians(degrees), 0.0]))
    return replace(view, camera=replace(view.camera, R=view.camera.R @ turn))


def _nearest(view: View) -> NDArray[np.int64]:
    """[H, W] which of the true points is projected nearest to each pixel."""
    rows, columns = np.indices(view.mask.shape)
    indices: NDArray[np.int64] = cKDTree(view.camera.project(_truth(ONE))[0]).query(np.stack([columns, rows], -1))[1]
    return indices


def _seen_from_four_sides() -> TrainingData:
    """The examples as training data: their own picture, and white silhouettes of the truth from the three other sides."""
    objects = []
    for name in CATEGORIES:
        view, image = _view(name), read_image(examples_folder() / name / "image.png")[..., :3]
        pictures = [(view.camera, (image, view.mask))]
        for degrees in QUARTER_TURNS:
            camera = _turned(view, degrees).camera
            mask = silhouette_of(_truth(name), camera)
            pictures.append((camera, (np.repeat(np.uint8(255.0 * mask)[..., None], 3, -1), mask)))
        views = [ViewItem(f"{name} view {i}", camera, partial(_same, shown)) for i, (camera, shown) in enumerate(pictures)]
        objects.append(ObjectItem(name, name, views, partial(_same, _truth(name).astype(np.float32))))
    return TrainingData(objects, "shipped examples")


def _same(value: Any) -> Any:
    return value


def _painted(points: Array) -> Array:
    """Colours [N, 3] in [0, 1] by place: stripes a tenth of the object wide."""
    return 0.5 + 0.4 * np.sin(20.0 * np.pi * points)
