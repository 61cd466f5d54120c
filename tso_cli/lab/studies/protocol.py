"""The cases of the study of points: a real shape seen once, and the cloud of another shape to start from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...errors import InputError
from ...evaluation.metrics import chamfer
from ...geometry.points import Array
from ...geometry.view import View
from ...io.meshes import find_meshes, read_mesh
from ...render import RayScene, RenderSettings, ground_truth, normalise, render_view, sample_cameras
from ..study import Report
from .parts import spread

# How the initial cloud of a category is chosen among its other shapes: the Chamfer distance (longest side 1) that it
# should have from the truth, the error of a trained network. 0 takes the most similar shape.
INITIAL_CHAMFER = {"chair": 0.0, "airplane": 2.0e-3, "car": 1.6e-3}


@dataclass(frozen=True, eq=False)
class Case:
    """One shape to refine toward.

    Attributes
    ----------
    category, shape : of the truth; start : the shape that the initial cloud is sampled from.
    initial, target : [1024, 3] each, longest side 1, centred.
    view : the mask of the true shape and its camera.
    """

    category: str
    shape: str
    start: str
    initial: Array
    target: Array
    view: View


def shape_type(shape: str) -> str:
    """The common name of files that are variants of one object: `fg_767_763` and `fg_767_767` are both `fg_767`."""
    parts = shape.split("_")
    return "_".join(parts[:2]) if parts[0] == "fg" and len(parts) > 2 else shape


def build_cases(
    folder: Path, category: str, seed: int = 0, limit: int | None = None, report: Report = lambda what, done, total: None
) -> list[Case]:
    """The cases of one category: each shape of ``folder``/``category``, one random view of it and another shape's cloud.

    The camera has f = 120 px at 64x64, azimuth 0 to 360, elevation -5 to 40 degrees, and stands as near as the whole object
    fits the image, 2 or more. Everything random depends on ``seed`` and the shape's place in the sorted folder.

    Parameters
    ----------
    limit : at most so many shapes, spread evenly over the folder, are refined toward; all serve as starts.

    Raises
    ------
    InputError
        The folder of the category is missing or holds fewer than two shapes.
    """
    paths = find_meshes(folder / category)
    if len({shape_type(path.stem) for path in paths}) < 2:
        raise InputError(f"{folder / category}: {len(paths)} shapes of one type, expected two types at least")
    settings, names = RenderSettings(views=1), [path.stem for path in paths]
    targets: list[Array] = []
    views: dict[int, View] = {}
    chosen = spread(range(len(paths)), limit)
    for i, path in enumerate(paths):
        rng = np.random.default_rng([seed, i])
        mesh = normalise(read_mesh(path))
        targets.append(ground_truth(mesh, settings, rng)[1].astype(np.float64))
        if i in chosen:
            camera = sample_cameras(settings, mesh.vertices, rng)[0]
            mask = render_view(RayScene(mesh), camera, rng).mask
            views[i] = View(mask.astype(np.float32) / 255.0, camera, name=path.name)
        report(f"{category}: sampling", i + 1, len(paths))
    cases = []
    for i, view in views.items():
        others = [j for j in range(len(paths)) if shape_type(names[j]) != shape_type(names[i])]
        j = min(others, key=lambda j: abs(chamfer(targets[j], targets[i]).chamfer - INITIAL_CHAMFER[category]))
        cases.append(Case(category, names[i], names[j], targets[j], targets[i], view))
        report(f"{category}: choosing starts", len(cases), len(chosen))
    return cases
