"""The paper's table of test-stage optimisation: a network's prediction before and after each of the three variants."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...evaluation.footprint import IOU_MEANS
from ...evaluation.metrics import nearest_squared
from ...geometry.camera import CANONICAL_ROTATION, Camera
from ...geometry.points import Array, normalise_longest_side
from ...geometry.view import View
from ...io.shipped import CATEGORIES
from ...network.model import BaseNetwork, NetworkConfig
from ...refinement import RefineConfig, refine
from ...render import RayScene, RenderSettings
from ...scene.network import network_scene
from ..charts import Panel, draw_ratios
from ..study import (
    CATEGORY,
    CHECKPOINT,
    COMMON,
    DEVICE,
    Cases,
    Option,
    Plan,
    Progress,
    Record,
    Study,
    Table,
    claim,
    part,
)
from .refining import uninterrupted
from .shapes import RenderedShape, Shape, see, shapes_of_part, view_aligned_network, weights_hash
from .summary import grouped, interval, mean, ratio_figures

VARIANTS = ("encoder", "encoder-decoder", "points")
LETTERS = {"before": "before", "encoder": "E", "encoder-decoder": "E and D", "points": "p"}
"""What the paper calls them: which parameters move."""
# Forward, backward and their sum, x1000: the paper's table of test-stage optimisation.
PAPER = {
    "before": (2.45, 2.19, 4.64),
    "encoder": (2.29, 2.14, 4.43),
    "encoder-decoder": (2.28, 2.09, 4.37),
    "points": (2.36, 2.13, 4.49),
}
RATIOS = ("ratio_of_means", "visible_ratio", "occluded_ratio")
KEPT = 1.01
"""Up to this ratio of distances after and before, what the picture does not show counts as kept."""
SIZE = 128
"""Pixels of the pictures each way."""
TOLERANCE = 2e-3
"""How far behind the first hit along its ray a point may lie and still be seen, in longest sides."""
# Rays are cast through a grid of columns and rows, of which only the diagonal is used.
POINTS_AT_ONCE = 32
GAINS = "every variant lowers the mean Chamfer distance"
ORDER = "E and D together gain most, p alone least"
KEEPS = "what the picture does not show is kept"
SHOWS = "what the picture shows comes nearer to the truth"
MISSES = "E alone misses detail that the other two gain"
CONVENTION = {
    "chamfer": "squared distances, mean over points, forward (target -> prediction) + backward (prediction -> target)",
    "capnet": "the paper's protocol: in the camera's axes each cloud is centred and scaled to longest side 1 by its own box",
    "visible, occluded": "forward distance of the target's points that the input view sees, and of the others",
    "iou": f"{IOU_MEANS}; on the 64x64 crop that the network sees",
    "seconds": "one refinement, with reading the masks and judging the silhouette, median over the cases",
}


def plan(
    progress: Progress,
    *,
    meshes: Path,
    checkpoint: Path,
    split: Path | None,
    categories: tuple[str, ...],
    **settings: Any,
) -> Plan:
    """Let the network predict unseen shapes, refine every prediction with each variant and judge it against the truth."""
    shapes = shapes_of_part(
        meshes,
        split,
        settings["part"],
        categories or (() if split else CATEGORIES),
        settings["limit"],
    )
    network, about = view_aligned_network(checkpoint)
    settings |= {
        "categories": sorted({shape.category for shape in shapes}),
        "size": SIZE,
        "shapes": len(shapes),
    }
    settings |= {
        "points": about.points,
        "sigma_sq": about.sigma_sq,
        "network": weights_hash(network),
    }
    render = RenderSettings(views=settings["views"], size=(SIZE, SIZE))
    config = RefineConfig(
        steps=settings["steps"], device=settings["device"], sigma_sq=about.sigma_sq, preset="paper"
    )

    def judge(shape: Shape) -> Cases:
        seen = see(shape, render, settings["seed"])
        return [
            judge_view(shape, seen, number, network, about, config)
            for number in range(settings["views"])
        ]

    return Plan(settings, [({"shape": shape.name}, partial(judge, shape)) for shape in shapes])


def judge_view(
    shape: Shape,
    seen: RenderedShape,
    number: int,
    network: BaseNetwork,
    about: NetworkConfig,
    config: RefineConfig,
) -> Record:
    """Predict from one picture, refine with every variant, and measure all four clouds."""
    picture = seen.views[number]
    view = View(
        picture.mask.astype(np.float32) / 255.0, picture.camera, name=f"{shape.name}, view {number}"
    )
    scene = network_scene(picture.image, view, network, about, placing="box")
    clouds, ious, seconds = {"before": scene.points}, dict[str, float](), {}
    for variant in VARIANTS:
        points, settings = (
            scene.points if variant == "points" else None,
            replace(config, mode=variant),
        )
        start = time.perf_counter()
        result = uninterrupted(
            refine(points, scene.view, config=settings, network=network, image=scene.image)
        )
        seconds[variant] = time.perf_counter() - start
        clouds[variant] = result.points
        ious = {"before": result.iou_before} | ious | {variant: result.iou_after}
    target = seen.target @ (CANONICAL_ROTATION @ picture.camera.R).T
    visible = visible_points(seen.scene, seen.target, picture.camera)
    found = {name: distances(cloud, target, visible) for name, cloud in clouds.items()}
    names = {"category": shape.category, "shape": shape.name, "view": number}
    return {**names, "capnet": found, "iou": ious, "seconds": seconds}


def visible_points(scene: RayScene, points: Array, camera: Camera) -> NDArray[np.bool_]:
    """For each of ``points`` [N, 3] on the surface of ``scene`` whether the perspective ``camera`` sees it.

    A point is seen when the first hit along its ray is no more than `TOLERANCE` before it, or when its ray, which grazes an
    edge, hits nothing at all.
    """
    pixels, depth = camera.project(points)
    first = [
        scene.cast(camera, *block.T)["depth"].diagonal()
        for block in np.array_split(pixels, -(-len(pixels) // POINTS_AT_ONCE))
    ]
    return ~(np.concatenate(first) < depth - TOLERANCE)


def distances(
    prediction: Array, target: Array, visible: NDArray[np.bool_]
) -> dict[str, float | None]:
    """Of the scaled clouds both directions of the Chamfer distance, and the forward one over ``visible`` and other points.

    A group without points has None.
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
    """The means over the cases of each category, and over "all", beside the paper's; and whether its statements hold."""
    groups = {**dict(sorted(grouped(cases, "category").items())), "all": cases}
    summary = {name: _means(group) for name, group in groups.items()}
    return {"paper": PAPER, "summary": summary, "claims": claims(summary)}


def _means(cases: Cases) -> Record:
    """Before and each variant: means of the distances; and of each variant what became of them."""
    found = [case["capnet"] for case in cases]
    chamfers = {
        name: np.array([row[name]["forward"] + row[name]["backward"] for row in found])
        for name in LETTERS
    }
    capnet: Record = {}
    for name, chamfer in chamfers.items():
        row: Record = {}
        for key in ("forward", "backward", "visible", "occluded"):
            values = [of_case[name][key] for of_case in found if of_case[name][key] is not None]
            row[key] = float(np.mean(values)) if values else None
        row["chamfer"] = float(chamfer.mean())
        if name != "before":
            before = capnet["before"]
            row["ratio_of_means"] = row["chamfer"] / before["chamfer"]
            row["interval"] = interval(
                [case["shape"] for case in cases], chamfer, chamfers["before"]
            )
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
    """What the paper says of its table, whether it holds here over all cases and in every category, and the figures."""
    total, visible, occluded = (
        ", ".join(
            f"{LETTERS[name]} {100.0 * (ratio - 1.0):+.1f} %"
            for name, ratio in _ratios(summary["all"], key).items()
        )
        for key in RATIOS
    )
    figures = {
        GAINS: total,
        ORDER: total,
        KEEPS: f"forward distance of occluded points {occluded}",
        SHOWS: f"forward distance of visible points {visible}",
        MISSES: f"visible points {visible}; IoU "
        + ", ".join(f"{summary['all']['iou'][name]:.3f}" for name in VARIANTS),
    }
    holding = {name: _holding(group, name == "all") for name, group in summary.items()}
    answers = []
    for text, numbers in figures.items():
        fails = [name for name, holds in holding.items() if not holds[text]]
        answers.append(
            claim(text, not fails, numbers + f"; not on {', '.join(fails)}" * bool(fails))
        )
    return answers


def _holding(group: Record, whole: bool) -> dict[str, bool]:
    """Whether each claim holds of a group of cases; over all cases a gain must show in the whole of its interval."""
    total, visible, occluded = (_ratios(group, key) for key in RATIOS)
    highest = (
        [group["capnet"][name]["interval"][1] for name in VARIANTS] if whole else total.values()
    )
    iou = group["iou"]
    return {
        GAINS: max(highest) < 1.0,
        ORDER: total["encoder-decoder"] < total["encoder"] < total["points"],
        KEEPS: max(occluded.values()) <= KEPT,
        SHOWS: max(visible.values()) < 1.0,
        MISSES: all(
            visible[name] < visible["encoder"] and iou[name] > iou["encoder"]
            for name in VARIANTS[1:]
        ),
    }


def _ratios(group: Record, key: str) -> dict[str, float]:
    """After / before of each variant; 1 where a view that shows everything leaves no occluded points."""
    ratios = {name: group["capnet"][name][key] for name in VARIANTS}
    return {name: 1.0 if ratio is None else ratio for name, ratio in ratios.items()}


def tables(record: Record) -> list[Table]:
    """The paper's table beside ours, and what became of each category."""
    summary, paper = record["summary"], record["paper"]
    sides = []
    for name, theirs in paper.items():
        row = summary["all"]["capnet"][name]
        ratios = (
            (row["ratio_of_means"], theirs[2] / paper["before"][2])
            if name != "before"
            else (None, None)
        )
        changes = [ratio and 100.0 * (ratio - 1.0) for ratio in ratios]
        ours = [1e3 * row[key] for key in ("forward", "backward", "chamfer")]
        sides.append([LETTERS[name], *ours, changes[0], *theirs, changes[1]])
    rows = []
    for category, group in summary.items():
        before = group["capnet"]["before"]["chamfer"]
        for name in VARIANTS:
            row = group["capnet"][name]
            low, high = row["interval"]
            figures = [
                row[key]
                for key in (
                    "median_ratio",
                    "worst_ratio",
                    "worse",
                    "visible_ratio",
                    "occluded_ratio",
                )
            ]
            figures += [group["iou"]["before"], group["iou"][name], group["median_seconds"][name]]
            names = [
                category,
                LETTERS[name],
                group["cases"],
                1e3 * before,
                1e3 * row["chamfer"],
                row["ratio_of_means"],
            ]
            rows.append([*names, f"{low:.3f} to {high:.3f}", *figures])
    header = [
        "category",
        "moves",
        "cases",
        "before",
        "after",
        "ratio",
        "95 % interval",
        "median",
        "worst",
        "worse",
    ]
    note = (
        "Chamfer x1000, the paper's protocol; ratio: after/before of the means; median, worst: of the cases' own; worse: cases "
        "over 1; visible, occluded: ratio of the forward distance of target points that the view "
        "sees, and of the others"
    )
    return [
        Table(
            [
                "",
                "forward",
                "backward",
                "Chamfer",
                "%",
                "paper's forward",
                "backward",
                "Chamfer",
                "%",
            ],
            sides,
            decimals=2,
        ),
        Table([*header, "visible", "occluded", "IoU before", "after", "s"], rows, note=note),
    ]


def draw(path: Path, record: Record, overwrite: bool = False) -> None:
    """Chamfer after / before of every view, a panel for each category; dotted: the paper's ratio of the means."""
    paper = {
        LETTERS[name]: record["paper"][name][2] / record["paper"]["before"][2] for name in VARIANTS
    }
    panels = []
    for category, cases in {**grouped(record["cases"], "category"), "all": record["cases"]}.items():
        sums = [
            {name: row["forward"] + row["backward"] for name, row in case["capnet"].items()}
            for case in cases
        ]
        rows = {LETTERS[name]: [row[name] / row["before"] for row in sums] for name in VARIANTS}
        panels.append(Panel(f"{category}, {len(cases)} views", rows, paper))
    draw_ratios(path, [panels], overwrite)


STUDY = Study(
    name="tso",
    about="The paper's table. The network predicts each view of each shape; the prediction is judged before and after moving "
    "the encoder (E), the whole network (E and D) and the points (p), with the paper's settings.",
    parts=("pictures", "points, paper", "network modes, paper"),
    tables=tables,
    draw=draw,
    reading="The paper reports gains of 3 to 6 %. What a variant moves decides what it changes: through the weights the whole "
    "cloud moves, points alone move where the mask says so. The intervals are over shapes, as views of one shape are not "
    "independent; a gain counts only where its whole interval lies below 1.",
    convention=CONVENTION,
    options=(
        *COMMON,
        CHECKPOINT,
        part("test"),
        CATEGORY,
        Option("--views", "Random views of each shape.", int, 4, least=1),
        Option("--steps", kind=int, default=50, least=0),
        DEVICE,
    ),
    plan=plan,
    conclude=conclude,
)
