"""The paper's table of test-stage optimisation: predictions before and after its three variants."""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tso_cli.evaluation.footprint import IOU_MEANS
from tso_cli.evaluation.metrics import nearest_squared
from tso_cli.geometry.camera import CANONICAL_ROTATION, Camera
from tso_cli.geometry.points import Array, normalise_longest_side
from tso_cli.geometry.view import View
from tso_cli.io.shipped import CATEGORIES
from tso_cli.network.model import BaseNetwork, NetworkConfig
from tso_cli.optimisation.presets import Mode
from tso_cli.refinement import RefineConfig, refine
from tso_cli.render.rays import RayScene
from tso_cli.render.settings import RenderSettings
from tso_cli.scene.network import network_scene

from .. import options
from ..charts import Panel, ratios
from ..options import option
from ..study import Cases, Plan, Progress, Record, Study, Table, by_shape, claim, uninterrupted
from .shapes import RenderedShape, Shape, see, shapes_of_part, view_aligned_network, weights_hash
from .summary import grouped, interval, mean, ratio_figures

VARIANTS: tuple[Mode, ...] = ("encoder", "encoder-decoder", "points")
LETTERS = {"before": "before", "encoder": "E", "encoder-decoder": "E and D", "points": "p"}
"""The paper's names: which parameters move."""
# Forward, backward and their sum, x1000: the paper's table of test-stage optimisation.
PAPER = {
    "before": (2.45, 2.19, 4.64),
    "encoder": (2.29, 2.14, 4.43),
    "encoder-decoder": (2.28, 2.09, 4.37),
    "points": (2.36, 2.13, 4.49),
}
TOTAL, VISIBLE, OCCLUDED = "ratio_of_means", "visible_ratio", "occluded_ratio"
KEPT = 1.01
"""Up to this ratio of distances after and before, what the picture does not show counts as kept."""
SIZE = 128
"""Pixels of the pictures each way."""
TOLERANCE = 2e-3
"""How far behind the first hit along its ray a visible point may lie, in longest sides."""
RAYS_AT_ONCE = 32
"""Rays are cast through a grid of columns and rows; only its diagonal is used."""


def plan(
    progress: Progress,
    *,
    meshes: Path,
    checkpoint: Path,
    split: Path | None,
    categories: tuple[str, ...],
    **settings: Any,
) -> Plan:
    """Refine the network's predictions of unseen shapes with each variant."""
    names = categories or (() if split else CATEGORIES)
    shapes = shapes_of_part(meshes, split, settings["part"], names, settings["limit"])
    network, about = view_aligned_network(checkpoint)
    settings |= {"categories": sorted({shape.category for shape in shapes}), "size": SIZE}
    settings |= {"shapes": len(shapes), "points": about.points, "sigma_sq": about.sigma_sq}
    settings |= {"network": weights_hash(network)}
    render = RenderSettings(views=settings["views"], size=(SIZE, SIZE))
    config = RefineConfig(
        steps=settings["steps"], sigma_sq=about.sigma_sq, preset="paper", accept_doubtful=True
    )

    def refine_shape(shape: Shape) -> Cases:
        seen, numbers = see(shape, render, settings["seed"]), range(settings["views"])
        return [refine_view(shape, seen, number, network, about, config) for number in numbers]

    return Plan(settings, by_shape({}, shapes, refine_shape).jobs)  # the settings count the shapes


def refine_view(
    shape: Shape,
    seen: RenderedShape,
    number: int,
    network: BaseNetwork,
    about: NetworkConfig,
    config: RefineConfig,
) -> Record:
    """Predict from one picture, refine with every variant, and compare all four clouds."""
    picture = seen.views[number]
    mask = picture.mask.astype(np.float32) / 255.0
    view = View(mask, picture.camera, name=f"{shape.name}, view {number}")
    scene = network_scene(picture.image, view, network, about, placing="box")
    clouds, ious, seconds = {"before": scene.points}, dict[str, float](), {}
    for variant in VARIANTS:
        points = scene.points if variant == "points" else None
        settings = replace(config, mode=variant)
        start = time.perf_counter()
        result = uninterrupted(
            refine(points, scene.view, config=settings, network=network, image=scene.image)
        )
        seconds[variant] = time.perf_counter() - start
        clouds[variant] = result.points
        ious = {"before": result.fit.iou_before} | ious | {variant: result.fit.iou_after}
    target = seen.target @ (CANONICAL_ROTATION @ picture.camera.R).T
    visible = visible_points(seen.scene, seen.target, picture.camera)
    capnet = {name: distances(cloud, target, visible) for name, cloud in clouds.items()}
    names = {"category": shape.category, "shape": shape.name, "view": number}
    return {**names, "capnet": capnet, "iou": ious, "seconds": seconds}


def visible_points(scene: RayScene, points: Array, camera: Camera) -> NDArray[np.bool_]:
    """Which ``points`` [N, 3] on the surface of ``scene`` the perspective ``camera`` sees.

    A point is seen if the first hit along its ray is at most `TOLERANCE` before it, or if its ray,
    which grazes an edge, hits nothing.
    """
    pixels, depth = camera.project(points)
    first = [
        scene.cast(camera, *block.T)["depth"].diagonal()
        for block in np.array_split(pixels, -(-len(pixels) // RAYS_AT_ONCE))
    ]
    return ~(np.concatenate(first) < depth - TOLERANCE)


def distances(
    prediction: Array, target: Array, visible: NDArray[np.bool_]
) -> dict[str, float | None]:
    """Both directions of the Chamfer distance of the scaled clouds.

    And the forward distance over ``visible`` and over other points; None without such points.
    """
    prediction, target = normalise_longest_side(prediction), normalise_longest_side(target)
    forward, backward = nearest_squared(target, prediction), nearest_squared(prediction, target)
    return {
        "forward": float(forward.mean()),
        "backward": float(backward.mean()),
        "visible": float(forward[visible].mean()) if visible.any() else None,
        "occluded": float(forward[~visible].mean()) if not visible.all() else None,
    }


def conclude(cases: Cases) -> Record:
    """Means over the cases of each category and of all, and whether the paper's claims hold."""
    groups = {**dict(sorted(grouped(cases, "category").items())), "all": cases}
    summary = {name: _means(group) for name, group in groups.items()}
    return {"paper": PAPER, "summary": summary, "claims": claims(summary)}


def _chamfers(cases: Cases, name: str) -> Array:
    clouds = [case["capnet"][name] for case in cases]
    return np.array([cloud["forward"] + cloud["backward"] for cloud in clouds])


def _means(cases: Cases) -> Record:
    """Of each cloud the means of the distances, and of each variant its ratios to before."""
    chamfers = {name: _chamfers(cases, name) for name in LETTERS}
    capnet: Record = {}
    for name, chamfer in chamfers.items():
        row: Record = {}
        for key in ("forward", "backward", "visible", "occluded"):
            values = [case["capnet"][name][key] for case in cases]
            numbers = [value for value in values if value is not None]
            row[key] = mean(numbers) if numbers else None
        row["chamfer"] = float(chamfer.mean())
        if name != "before":
            before, shapes = capnet["before"], [case["shape"] for case in cases]
            row[TOTAL] = row["chamfer"] / before["chamfer"]
            row["interval"] = interval(shapes, chamfer, chamfers["before"])
            for key in ("visible", "occluded"):
                row[f"{key}_ratio"] = row[key] / before[key] if before[key] else None
            row |= ratio_figures(chamfer / chamfers["before"])
        capnet[name] = row
    ious = {name: mean(case["iou"][name] for case in cases) for name in LETTERS}
    seconds = {
        name: float(np.median([case["seconds"][name] for case in cases])) for name in VARIANTS
    }
    return {"cases": len(cases), "iou": ious, "median_seconds": seconds, "capnet": capnet}


def claims(summary: Record) -> list[Record]:
    """What the paper says of its table, and whether it holds over all cases and categories."""

    def changes(key: str) -> str:
        ratios = _ratios(summary["all"], key).items()
        return ", ".join(
            f"{LETTERS[name]} {100.0 * (ratio - 1.0):+.1f} %" for name, ratio in ratios
        )

    total, visible, occluded = map(changes, (TOTAL, VISIBLE, OCCLUDED))
    ious = ", ".join(f"{summary['all']['iou'][name]:.3f}" for name in VARIANTS)
    figures = (
        total,
        total,
        f"forward distance of occluded points {occluded}",
        f"forward distance of visible points {visible}",
        f"visible points {visible}; IoU {ious}",
    )
    holding = {name: _holding(group, name == "all") for name, group in summary.items()}
    answers = []
    for text, numbers in zip(holding["all"], figures, strict=True):
        fails = [name for name, holds in holding.items() if not holds[text]]
        note = f"; not on {', '.join(fails)}" if fails else ""
        answers.append(claim(text, not fails, numbers + note))
    return answers


def _holding(group: Record, whole: bool) -> dict[str, bool]:
    """Whether each claim holds; over all cases a gain must show in the whole of its interval."""
    total, visible, occluded = (_ratios(group, key) for key in (TOTAL, VISIBLE, OCCLUDED))
    ends = [group["capnet"][name]["interval"][1] for name in VARIANTS]
    iou = group["iou"]
    return {
        "every variant lowers the mean Chamfer distance": (
            max(ends if whole else total.values()) < 1.0
        ),
        "E and D together gain most, p alone least": (
            total["encoder-decoder"] < total["encoder"] < total["points"]
        ),
        "what the picture does not show is kept": max(occluded.values()) <= KEPT,
        "what the picture shows comes nearer to the truth": max(visible.values()) < 1.0,
        "E alone misses detail that the other two gain": all(
            visible[name] < visible["encoder"] and iou[name] > iou["encoder"]
            for name in VARIANTS[1:]
        ),
    }


def _ratios(group: Record, key: str) -> dict[str, float]:
    """After / before of each variant; 1 where no points are occluded."""
    ratios = {name: group["capnet"][name][key] for name in VARIANTS}
    return {name: 1.0 if ratio is None else ratio for name, ratio in ratios.items()}


def tables(record: Record) -> list[Table]:
    """The paper's table and ours, and what became of each category."""
    note = "Chamfer x1000, the paper's protocol; ratio: after/before of the means; median, worst: "
    note += "of the cases' own ratios; worse: cases with a ratio over 1; visible, occluded: ratio "
    note += "of the forward distance of target points that the view shows, and of the others"
    header = ["category", "moves", "cases", "before", "after", "ratio", "95 % interval", "median"]
    header += ["worst", "worse", "visible", "occluded", "IoU before", "after", "s"]
    keys = ("median_ratio", "worst_ratio", "worse", VISIBLE, OCCLUDED)
    rows = []
    for category, group in record["summary"].items():
        before = 1e3 * group["capnet"]["before"]["chamfer"]
        for name in VARIANTS:
            row = group["capnet"][name]
            low, high = row["interval"]
            figures = [1e3 * row["chamfer"], row[TOTAL], f"{low:.3f} to {high:.3f}"]
            figures += [*map(row.get, keys), group["iou"]["before"], group["iou"][name]]
            head = [category, LETTERS[name], group["cases"], before]
            rows.append([*head, *figures, group["median_seconds"][name]])
    columns = ["forward", "backward", "Chamfer", "%"]
    compared, paper = list[list[Any]](), record["paper"]
    for name, of_paper in paper.items():
        row = record["summary"]["all"]["capnet"][name]
        changes: list[float | None] = [None, None]
        if name != "before":
            ratios = row[TOTAL], of_paper[2] / paper["before"][2]
            changes = [100.0 * (ratio - 1.0) for ratio in ratios]
        ours = [1e3 * row[key] for key in ("forward", "backward", "chamfer")]
        compared.append([LETTERS[name], *ours, changes[0], *of_paper, changes[1]])
    of_both = ["", *columns, "paper's forward", *columns[1:]]
    return [Table(of_both, compared, decimals=2), Table(header, rows, note=note)]


def grid(record: Record) -> list[list[Panel]]:
    """Chamfer after / before of every view by category; dotted: the paper's ratio of the means."""
    before = record["paper"]["before"][2]
    paper = {LETTERS[name]: record["paper"][name][2] / before for name in VARIANTS}
    panels = []
    for category, cases in {**grouped(record["cases"], "category"), "all": record["cases"]}.items():
        starts = _chamfers(cases, "before")
        rows = {LETTERS[name]: _chamfers(cases, name) / starts for name in VARIANTS}
        panels.append(Panel(f"{category}, {len(cases)} views", rows, paper))
    return [panels]


STUDY = Study(
    name="tso",
    values={"IOU_MEANS": IOU_MEANS},
    parts=("pictures", "points, paper", "network modes, paper"),
    tables=tables,
    draw=ratios(grid),
    options=(
        *options.COMMON,
        options.CHECKPOINT,
        options.part("test"),
        options.categories(),
        options.views(4),
        option("--steps", kind=int, default=50, least=0),
    ),
    plan=plan,
    conclude=conclude,
)
