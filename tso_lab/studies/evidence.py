"""How far evidence other than one right mask of the whole object helps, or misleads."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from tso_cli.diagnosis.depth_map import Contents
from tso_cli.diagnosis.findings import OF_DEPTH_MAPS
from tso_cli.evaluation.metrics import chamfer
from tso_cli.geometry.camera import Camera, intrinsics
from tso_cli.geometry.points import Array, sample_surface
from tso_cli.geometry.view import View
from tso_cli.io.meshes import Mesh
from tso_cli.optimisation.symmetry import find_mirror_plane
from tso_cli.refinement import RefineConfig, RefineResult
from tso_cli.render.rays import RayScene, render_view
from tso_cli.render.viewpoints import fitting_distance

from .. import options
from ..charts import Panel, ratios
from ..study import Cases, Plan, Progress, Record, Study, Table
from .cases import SAMPLES, Case, CaseBuilder, Variant, farthest_point_subset, kinds_of, refined
from .shapes import Shape, shapes_of_part
from .summary import grouped, rounded, summarised

# Cases with other evidence: depth maps, objects that lack a part.

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
    target = farthest_point_subset(dense, len(case.target))
    return replace(case, views=views, dense=dense, target=target)


# Depth maps that hold something else than depth along z, and whether this is noticed.

# Of the mask's longer side, by which a map is shifted.
SHIFT = 0.1
DEPTH = "depth"
FIELDS_OF_VIEW = (30, 60, 90)


class Map(NamedTuple):
    """What a map ``holds``, and what that should be called; ``fov`` : of its camera, degrees."""

    holds: str
    called: Contents
    fov: int | None = None


MAPS = {
    **{name: Map(name, "inverse") for name in ("1 / depth", "a / depth + b")},
    **{name: Map(name, "affine") for name in ("depth from 0 to 1", "a depth + b")},
    "millimetres": Map("millimetres", "unit"),
    **{f"along the ray, {fov} degrees": Map("along the ray", "ray", fov) for fov in FIELDS_OF_VIEW},
    **{name: Map(name, "unrelated") for name in ("another object", "flipped", "shifted by 10 %")},
}


def map_rows() -> dict[str, tuple[Alter, Variant]]:
    """The mask, the right map, and each wrong map, which is tested."""
    table: dict[str, Alter] = {}
    for fov in (None, *FIELDS_OF_VIEW):
        seen = f", {fov} degrees" if fov else ""
        table[f"mask{seen}"] = partial(with_fov, fov=fov) if fov else unaltered
        table[f"right map{seen}"] = partial(with_map, holds=DEPTH, fov=fov)
    for name, (holds, _, fov) in MAPS.items():
        table[name] = partial(with_map, holds=holds, fov=fov)
    return {label: (alter, Variant()) for label, alter in table.items()}


def ignored(result: RefineResult, label: str) -> float:
    """1 if a map was left out."""
    return float(bool(_wrong(result)))


def named(result: RefineResult, label: str) -> float:
    """1 if it was said what the map of a row holds."""
    wrong = MAPS.get(label)
    return float(wrong is not None and f"depth-{wrong.called}" in _wrong(result))


def _wrong(result: RefineResult) -> set[str]:
    names = {finding.name for finding in result.findings}
    return names & set(OF_DEPTH_MAPS) - {"depth-fitted"}


def with_fov(case: Case, truth: Truth, rng: Rng, fov: float) -> Case:
    """The first view from so near that the object fills a picture of this angle, degrees."""
    view = case.views[0]
    focal = view.camera.width / 2.0 / np.tan(np.radians(fov) / 2.0)
    camera = replace(view.camera, K=intrinsics(focal, view.camera.width, view.camera.height))
    distance = fitting_distance(truth.mesh.vertices, camera, least=0.0)
    camera = replace(camera, t=np.array([0.0, 0.0, distance]))
    mask = render_view(truth.scene, camera).mask.astype(np.float32) / 255.0
    return replace(case, views=(replace(view, mask=mask, camera=camera),))


def with_map(
    case: Case, truth: Truth, rng: Rng, holds: str, fov: float | None = None
) -> Case | None:
    """The first view with a map that ``holds`` something, of a kind that tso has to find out.

    None where the map is unknown on the whole mask.
    """
    seen = case if fov is None else with_fov(case, truth, rng, fov)
    view = seen.views[0]
    values = _held(view, holds, truth, rng)
    values = np.where(np.isfinite(values) & (values > 0.0), values, 0.0)
    if not values[view.inside].any():
        return None
    return replace(seen, views=(replace(view, depth=values, depth_kind="auto"),))


def _held(view: View, holds: str, truth: Truth, rng: Rng) -> Array:
    """[H, W], the numbers of a map of the view."""
    depth = exact_depth(truth.scene, view.camera)
    depth = np.where(np.isfinite(depth), depth, np.nan)
    low, high = np.nanmin(depth), np.nanmax(depth)
    scale, shift = 10.0 ** rng.uniform(-1.0, 3.0), rng.uniform(0.5, 1.0)
    left, top, right, bottom = view.box()
    across = round(SHIFT * max(right - left, bottom - top))
    lying = replace(truth.mesh, vertices=truth.mesh.vertices[:, [1, 2, 0]])
    numbers: dict[str, Callable[[], Array]] = {
        DEPTH: lambda: depth,
        "1 / depth": lambda: 1.0 / depth,
        "a / depth + b": lambda: scale * (1.0 / depth - (2.0 * shift - 1.0) / high),
        "depth from 0 to 1": lambda: (depth - low) / (high - low),
        "a depth + b": lambda: scale * (depth - shift * low),
        "millimetres": lambda: 1000.0 * depth,
        "along the ray": lambda: depth * view.camera.ray_lengths(*np.indices(depth.shape)),
        # The shape on its side stands for another object.
        "another object": lambda: exact_depth(RayScene(lying), view.camera),
        "flipped": lambda: depth[:, ::-1],
        "shifted by 10 %": lambda: np.roll(depth, across, 1),
    }
    return numbers[holds]()


# The study.

SIZE, POINTS = 64, 1024
"""Pixels of the masks each way, points of the clouds."""
PLANES, NAMED, IGNORED = "no mirror plane", "named", "ignored"
FIGURES = {"cases": "cases", "mean_ratio": "ratio", "worst_ratio": "worst", "worse": "worse"}
ALL = "all"
Rows = dict[str, tuple[Alter, Variant]]
"""By label: how a case is altered, and how it is then refined."""


@dataclass(frozen=True)
class Question:
    """Rows that are compared on cases of some kinds and categories.

    more : further figures by their names: means of a number of each result and its row's label.
    """

    title: str
    kinds: tuple[str, ...]
    rows: Rows
    categories: tuple[str, ...]
    more: dict[str, Callable[[RefineResult, str], float]] = field(default_factory=dict)


def no_plane(result: RefineResult, label: str) -> float:
    """1 if the refinement used no mirror plane."""
    return float(result.symmetry.plane is None)


AUTO = Variant()
ONE, TWO = Variant(RefineConfig(symmetry="none")), Variant(RefineConfig(symmetry="none"), 2)
DEPTH_ROWS: Rows = {
    "mask, no symmetry": (unaltered, ONE),
    "mask and depth, no symmetry": (with_depth, ONE),
    "mask, symmetry auto": (unaltered, AUTO),
    "mask and depth, symmetry auto": (with_depth, AUTO),
    "mask and depth with noise of 0.01, no symmetry": (partial(with_depth, noise=0.01), ONE),
    "mask and depth with noise of 0.03, no symmetry": (partial(with_depth, noise=0.03), ONE),
    "two masks, no symmetry": (unaltered, TWO),
    "two masks and their depths, no symmetry": (with_depth, TWO),
}
LACKING: dict[str, Alter] = {
    "whole": unaltered,
    "one side missing": partial(without, part="side"),
    "upper part of a side missing": partial(without, part="high"),
    "lower part of a side missing": partial(without, part="low"),
}
MISSING_ROWS: Rows = {
    f"{name}; symmetry {plane}": (alter, variant)
    for (name, alter), (plane, variant) in product(
        LACKING.items(), {"none": ONE, "auto": AUTO}.items()
    )
}
THREE = ("chair", "airplane", "car")
QUESTIONS = {
    "depth": Question("Depth maps", ("other", "near"), DEPTH_ROWS, THREE),
    "missing": Question(
        "Objects that lack a part",
        ("other",),
        MISSING_ROWS,
        (*THREE, "sofa"),
        {PLANES: no_plane},
    ),
    "maps": Question(
        "Depth maps that hold something else",
        ("other",),
        map_rows(),
        THREE,
        {NAMED: named, IGNORED: ignored},
    ),
}


def plan(
    progress: Progress,
    *,
    meshes: Path,
    split: Path | None,
    questions: dict[str, Question] = QUESTIONS,
    **settings: Any,
) -> Plan:
    """Ask each question of every case that it is about; InputError where a shape is missing."""
    named = (name for question in questions.values() for name in question.categories)
    categories = list(dict.fromkeys(named))
    shapes = shapes_of_part(meshes, split, settings["part"], categories, settings["limit"])
    groups = {name: [shape for shape in shapes if shape.category == name] for name in categories}
    seed = settings["seed"]
    builder = CaseBuilder(meshes, split, settings["views"], SIZE, POINTS, seed)
    settings |= {"points": POINTS, "size": SIZE}
    settings["rows"] = {name: list(question.rows) for name, question in questions.items()}
    settings["shapes"] = [shape.name for group in groups.values() for shape in group]

    def refine_group(name: str, kind: str, group: list[Shape]) -> Cases:
        truths = map(Truth, group)
        cases = [(case, truth) for truth in truths for case in builder.cases(truth.shape, kind)]
        return refine_rows(name, questions[name], cases, seed)

    jobs = []
    for name, question in questions.items():
        for kind, (category, group) in product(question.kinds, groups.items()):
            if category in question.categories and kind in kinds_of(category, question.kinds):
                shared = {"question": name, "kind": kind, "shape": group[0].name}
                jobs.append((shared, partial(refine_group, name, kind, group)))
    return Plan(settings, jobs)


def refine_rows(name: str, question: Question, cases: list[tuple[Case, Truth]], seed: int) -> Cases:
    """Every row of a question for cases of one kind and category.

    Where a case cannot be altered as a row asks, the row is left out of it.
    """
    records: Cases = [{"question": name, **case.names, "rows": {}} for case, _ in cases]
    for label, (alter, variant) in question.rows.items():
        altered = []
        for number, (case, truth) in enumerate(cases):
            # The same random numbers for each row: rows differ in nothing else.
            key = [seed, zlib.crc32(f"{name} {case.shape}".encode()), case.view]
            changed = alter(case, truth, np.random.default_rng(key))
            if changed is not None:
                altered.append((number, changed))
        results = refined([case for _, case in altered], variant) if altered else []
        for (number, case), result in zip(altered, results, strict=True):
            row = {
                "before": chamfer(case.initial, case.target).chamfer,
                "chamfer": chamfer(result.points, case.target).chamfer,
            }
            row |= {name: number(result, label) for name, number in question.more.items()}
            records[number]["rows"][label] = rounded(row)
    return records


def conclude(cases: Cases) -> Record:
    """{"summary": {question: {kind: {"all": {row: {"cases", ...}}}}}}, of all categories."""
    figures = lambda of_kind: {ALL: _means(of_kind)}  # noqa: E731
    return {"summary": summarised(cases, ("question", "kind"), figures)}


def _means(cases: Cases) -> Record:
    """By row; a case may lack some."""
    means = {}
    for label in dict.fromkeys(label for case in cases for label in case["rows"]):
        rows = [case["rows"][label] for case in cases if label in case["rows"]]
        ratios = np.array([row["chamfer"] / row["before"] for row in rows])
        figures: Record = {"cases": len(rows), "worse": int((ratios > 1.0).sum())}
        figures |= {"mean_ratio": float(ratios.mean()), "worst_ratio": float(ratios.max())}
        for key in rows[0]:
            if key not in ("before", "chamfer"):
                figures[key] = float(np.mean([row[key] for row in rows]))
        means[label] = rounded(figures)
    return means


def tables(record: Record) -> list[Table]:
    """A table for each question."""
    result = []
    for question, kinds in record["summary"].items():
        about = QUESTIONS[question]
        columns = FIGURES | {name: name for name in about.more}
        rows = [
            [kind, label, *map(figures.get, columns)]
            for kind, groups in kinds.items()
            for label, figures in groups[ALL].items()
        ]
        header = ["kind", question, *columns.values()]
        result.append(Table(header, rows, title=about.title))
    return result


def grid(record: Record) -> list[list[Panel]]:
    """Chamfer after / before of every case: a row of panels for each question."""
    rows = []
    for question, cases in grouped(record["cases"], "question").items():
        panels = []
        for kind, of_kind in grouped(cases, "kind").items():
            by_label: dict[str, list[float]] = {}
            for label in record["summary"][question][kind][ALL]:
                of_label = [case["rows"][label] for case in of_kind if label in case["rows"]]
                by_label[label] = [row["chamfer"] / row["before"] for row in of_label]
            panels.append(Panel(f"{question}, {kind}", by_label))
        rows.append(panels)
    return rows


STUDY = Study(
    name="evidence",
    parts=("pictures", "points, best"),
    tables=tables,
    draw=ratios(grid),
    options=(*options.COMMON, options.part("validation"), options.views(2)),
    plan=plan,
    conclude=conclude,
)
