"""What `--budget auto` saves, and what that costs: on scenes from a brick to a lattice, of few pixels and points to many."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from threadpoolctl import threadpool_limits

from ...evaluation.metrics import chamfer
from ...geometry.points import CANDIDATES, Array, farthest_point_sample, sample_surface, scattered
from ...geometry.view import View
from ...io.meshes import Mesh, read_mesh
from ...io.shipped import examples_folder
from ...kernels.dispatch import planned
from ...optimisation.presets import BEST
from ...optimisation.presets import FULL as FINE
from ...plots.style import COLOURS, INK, page
from ...refinement import RefineConfig, refine
from ...refinement.api import compile_loops
from ...render import RayScene, RenderSettings, normalise, render_view, sample_cameras
from ..studies.refining import uninterrupted
from ..studies.summary import grouped, mean, rounded, standard_error
from ..study import SEED, Cases, Option, Plan, Progress, Record, Study, Table, claim
from .speed import machine

AUTO, FULL = "auto", "full"
WAYS = {
    AUTO: RefineConfig(),
    FULL: RefineConfig(budget="full"),
    "all points move": RefineConfig(points=CANDIDATES),
    "96 steps": RefineConfig(steps=96),
    "finest grid in every stage": RefineConfig(coarse_to_fine=FINE),
    "64 cells in every stage": RefineConfig(
        coarse_to_fine=replace(
            BEST, stages=tuple(replace(stage, fine_grid=False) for stage in BEST.stages)
        )
    ),
    "512 points move": RefineConfig(points=512),
    "24 steps": RefineConfig(steps=24),
    "no mirror plane": RefineConfig(symmetry="none"),
}
"""The budgets, then what auto saves one by one, then what it could save but does not."""
# Pixels of a mask each way, points of the cloud, and masks.
SCENES = (
    (64, 256, 1),
    (64, 1024, 1),
    (64, 1024, 2),
    (256, 1024, 1),
    (256, 1024, 4),
    (256, 16_384, 1),
    (2048, 16_384, 1),
    (256, 500_000, 1),
)
MOST_POINTS = 16_384
"""Of the ways but auto and full; of those with more only the simplest and the finest shape are refined."""
SLOWEST = ("brick", "lattice")
DRAWS = 5
"""Views and samplings of each scene: by one alone, a lattice whose struts are mistaken for each other decides the mean."""
# The start is the truth stretched along its axes, and bent.
STRETCH, BEND = (1.12, 0.92, 1.0), 0.25
KEYS = ("ratio", "seconds")
NEAR = 1.05
"""Of the least ratio among ways that take no longer."""
CONVENTION = {
    "ratio": "Chamfer distance after / before, mean over the scenes; squared distances, mean over points, both directions "
    "added, longest side 1, to 16,384 points of the truth",
    "seconds": "one call alone, one thread, compiled loops, without files; median over the scenes",
    "cost": "auto's mean ratio over this way's, error: its standard error; saving: 1 - seconds of auto over these",
}


def brick() -> Mesh:
    return _mesh(trimesh.creation.box((1.0, 0.5, 0.7)))


def lattice(cells: int = 3, width: float = 0.03) -> Mesh:
    """The edges of a cube of so many cells each way, as square struts."""
    places = np.linspace(-0.5, 0.5, cells + 1)
    struts = []
    for axis in range(3):
        extents = np.full(3, width)
        extents[axis] = 1.0 + width
        for pair in product(places, places):
            centre = np.insert(np.array(pair), axis, 0.0)
            struts.append(
                trimesh.creation.box(extents, trimesh.transformations.translation_matrix(centre))
            )
    return _mesh(trimesh.util.concatenate(struts))


def shipped(name: str) -> Mesh:
    return read_mesh(examples_folder() / "meshes" / name, textures=False)


SHAPES: dict[str, Callable[[], Mesh]] = {
    "brick": brick,
    "car": partial(shipped, "car/qbasic_CopCar.ply"),
    "chair": partial(shipped, "chair/q17_Chair.ply"),
    "aeroplane": partial(shipped, "airplane/qplane_SmallPlane.ply"),
    "lattice": lattice,
}


def _mesh(mesh: Any) -> Mesh:
    return Mesh(np.asarray(mesh.vertices, dtype=np.float64), np.asarray(mesh.faces, dtype=np.int64))


def plan(progress: Progress, *, shapes: tuple[str, ...], scenes: int, seed: int) -> Plan:
    """A job refines one scene of one shape in every way, one call after the other."""
    settings = {
        "shapes": list(shapes),
        "scenes": SCENES[:scenes],
        "ways": list(WAYS),
        "seed": seed,
        "machine": machine(),
    }
    compile_loops()

    def judge(draw: int, **place: Any) -> Cases:
        ways = {
            name: way
            for name, way in WAYS.items()
            if place["points"] <= MOST_POINTS or name in (AUTO, FULL)
        }
        start, target, views = scene(**place, seed=DRAWS * seed + draw)
        before, rows = chamfer(scattered(start, CANDIDATES), target).chamfer, {}
        with threadpool_limits(1), planned(1 << 60, 1 << 60):
            for name, config in ways.items():
                began = time.perf_counter()
                result = uninterrupted(refine(start, views, config=config))
                seconds = time.perf_counter() - began
                after = chamfer(scattered(result.points, CANDIDATES), target).chamfer
                rows[name] = rounded({"ratio": after / before, "seconds": seconds})
        return [{**place, "draw": draw, "ways": rows}]

    places: list[Record] = [
        {"shape": shape, "size": size, "points": points, "masks": masks, "draw": draw}
        for shape in shapes
        for size, points, masks in SCENES[:scenes]
        if points <= MOST_POINTS or shape in SLOWEST
        for draw in range(DRAWS)
    ]
    return Plan(settings, [(place, partial(judge, **place)) for place in places])


def scene(
    shape: str, size: int, points: int, masks: int, seed: int
) -> tuple[Array, Array, list[View]]:
    """The start [N, 3], points [16384, 3] of the truth, and views of it."""
    mesh, rng = normalise(SHAPES[shape]()), np.random.default_rng([seed, size, points])
    cameras = sample_cameras(RenderSettings(views=masks, size=(size, size)), mesh.vertices, rng)
    rays = RayScene(mesh)
    pictures = [
        render_view(rays, camera, rng).mask.astype(np.float32) / 255.0 for camera in cameras
    ]
    views = [
        View(*seen, name=f"{shape} {i}")
        for i, seen in enumerate(zip(pictures, cameras, strict=True))
    ]
    target = sample_surface(mesh.vertices, mesh.faces, CANDIDATES, rng)
    sampled = sample_surface(mesh.vertices, mesh.faces, max(points, CANDIDATES), rng)
    start = sampled if points >= CANDIDATES else sampled[farthest_point_sample(sampled, points)]
    start = start * STRETCH
    start[:, 0] += BEND * (np.square(start[:, 1]) - np.square(start[:, 1]).mean())
    return start, target, views


def conclude(cases: Cases) -> Record:
    """{"summary", of each way beside auto in its scenes, and "claims"}."""
    summary = {}
    for name in WAYS:
        pairs = [(case["ways"][name], case["ways"][AUTO]) for case in cases if name in case["ways"]]
        if pairs:
            ratio, of_auto = (np.array([pair[i]["ratio"] for pair in pairs]) for i in (0, 1))
            figures = {
                "mean_ratio": ratio.mean(),
                "median_seconds": np.median([pair[0]["seconds"] for pair in pairs]),
            }
            figures["cost"] = of_auto.mean() / ratio.mean()
            figures["error"] = standard_error(of_auto - ratio) / ratio.mean()
            figures["saving"] = 1.0 - np.median(
                [pair[1]["seconds"] / pair[0]["seconds"] for pair in pairs]
            )
            summary[name] = {"scenes": len(pairs), **rounded(figures)}
    cost, error, saving = (summary[FULL][key] for key in ("cost", "error", "saving"))
    claims = [
        claim(
            "auto comes within 2 % of full",
            cost <= 1.02,
            f"auto's mean ratio is {cost:.3f} times full's, ± {error:.3f}",
        ),
        claim(
            "auto takes at most a third of full's time",
            saving >= 2 / 3,
            f"auto saves {saving:.0%} of its time (median)",
        ),
        _near_front(cases),
    ]
    return {"summary": summary, "claims": claims}


def _near_front(cases: Cases) -> Record:
    """By the means of each scene's draws: is auto near the best of the ways that take no longer?"""
    scenes, beyond = _by_scene(cases), []
    for scene, rows in scenes.items():
        ways = {
            name: [mean(row["ways"][name][key] for row in rows) for key in KEYS]
            for name in WAYS
            if name in rows[0]["ways"]
        }
        ratio, seconds = ways[AUTO]
        best, least = min(
            ((name, way[0]) for name, way in ways.items() if way[1] <= seconds),
            key=lambda pair: pair[1],
        )
        if ratio > NEAR * least:
            beyond.append((ratio / least, f"; at most {ratio / least:.2f} times, {best}: {scene}"))
    found = f"{len(scenes) - len(beyond)} of {len(scenes)} scenes{max(beyond)[1] if beyond else ''}"
    return claim(
        "auto is within 5 % of every way that takes no longer, in every scene", not beyond, found
    )


def _by_scene(cases: Cases) -> dict[str, Cases]:
    """The draws of each scene, by its name."""

    def name(case: Record) -> str:
        masks = f", {case['masks']} masks" * (case["masks"] > 1)
        return f"{case['shape']}, {case['size']} px, {case['points']:,} points{masks}"

    return grouped([{**case, "scene": name(case)} for case in cases], "scene")


def tables(record: Record) -> list[Table]:
    """Every way beside auto, and every scene."""
    header = ["way", "scenes", "ratio", "s", "auto's ratio / this", "±", "auto saves"]
    rows = [[name, *row.values()] for name, row in record["summary"].items()]
    scenes: list[Any] = [
        [name, *_of_draws(rows)] for name, rows in _by_scene(record["cases"]).items()
    ]
    return [Table(header, rows), Table(["scene", "auto", "s", "full", "s"], scenes, "Scenes")]


def _of_draws(cases: Cases) -> list[float]:
    """Means over the draws of a scene: ratio and seconds of auto, then of full."""
    return [mean(case["ways"][way][key] for case in cases) for way in (AUTO, FULL) for key in KEYS]


def draw(path: Path, record: Record, overwrite: bool = False) -> None:
    """Each way's time and ratio beside auto's."""
    with page(path, overwrite, (7.0, 4.2), dpi=100) as figure:
        axis = figure.subplots()
        for name, row in record["summary"].items():
            place = 1.0 / (1.0 - row["saving"]), 1.0 / row["cost"]
            axis.plot(
                *place,
                "*" if name == AUTO else "o",
                color=COLOURS[0],
                markersize=14 if name == AUTO else 6,
            )
            # Ways about as good as auto stand close to it: quicker ones are named on the left, full above, slower ones below.
            left, above = place[0] <= 1.0, 5 if place[1] >= 1.0 or name == FULL else -12
            axis.annotate(
                *(name, place, (-8 if left else 7, above)),
                textcoords="offset points",
                fontsize=9,
                horizontalalignment="right" if left else "left",
            )
        axis.axhline(1.0, color=INK, linewidth=0.8, zorder=0)
        axis.margins(0.25, 0.15)
        axis.set(
            xlim=(0.0, None),
            xlabel="time / auto's (median)",
            ylabel="Chamfer after / before, over auto's",
        )


STUDY = Study(
    name="budget",
    parts=("points, best",),
    tables=tables,
    draw=draw,
    reading="Starts are the truth stretched by a tenth and bent. Each row below the budgets changes one decision: what auto "
    "spares is worth its time if its ratio is hardly higher; what it could spare besides is not if its ratio is lower.",
    convention=CONVENTION,
    options=(
        Option(
            "--shape",
            "May be repeated.",
            str,
            tuple(SHAPES),
            tuple(SHAPES),
            multiple=True,
            name="shapes",
        ),
        Option(
            "--scenes",
            "So many of them, the smallest first.",
            int,
            len(SCENES),
            least=1,
            most=len(SCENES),
        ),
        SEED,
    ),
    plan=plan,
    conclude=conclude,
)
