"""The paper's table of test-stage optimisation: a network's prediction before and after each of the three variants."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...evaluation.footprint import IOU_MEANS
from ...evaluation.metrics import nearest_squared
from ...geometry.camera import CANONICAL_ROTATION
from ...geometry.points import Array, normalise_longest_side
from ...geometry.view import View
from ...io.shipped import CATEGORIES
from ...network.model import BaseNetwork, NetworkConfig
from ...refinement import RefineConfig, refine
from ...render import RenderSettings
from ...scene.network import network_scene
from ..charts.ratios import Panel, draw_ratios
from ..study import CATEGORY, CHECKPOINT, COMMON, DEVICE, Cases, Option, Progress, Record, Study, Table, claim, part, record_of
from .accuracy_variants import uninterrupted
from .parts import SeenShape, Shape, see, shapes_of_part, view_aligned_network, weights_hash
from .summary import by_category, interval, ratio_figures
from .visibility import visible_points

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
KEPT = 1.01
"""Up to this ratio of distances after and before, what the picture does not show counts as kept."""
SIZE = 128
"""Pixels of the pictures each way."""
CONVENTION = {
    "chamfer": "squared distances, mean over points, forward (target -> prediction) + backward (prediction -> target)",
    "capnet": "the paper's protocol: in the camera's axes each cloud is centred and scaled to longest side 1 by its own box",
    "plain": "the network's own coordinates against the target turned to the axes of the camera, longest side 1",
    "visible, occluded": "forward distance of the target's points that the input view sees, and of the others",
    "iou": f"{IOU_MEANS}; on the 64x64 crop that the network sees",
    "seconds": "one refinement, with reading the masks and judging the silhouette, median over the cases",
}


def run(
    progress: Progress, *, meshes: Path, checkpoint: Path, split: Path | None, categories: tuple[str, ...], **settings: Any
) -> Record:
    """Let the network predict unseen shapes, refine every prediction with each variant and judge it against the truth.

    Raises InputError where a shape is missing, the network is not view-aligned, or the earlier record is of other settings.
    """
    shapes = shapes_of_part(meshes, split, settings["part"], categories or (() if split else CATEGORIES), settings["limit"])
    network, about = view_aligned_network(checkpoint)
    settings |= {
        "categories": sorted({shape.category for shape in shapes}),
        "size": SIZE,
        "shapes": len(shapes),
        "points": about.points,
        "sigma_sq": about.sigma_sq,
        "network": weights_hash(network),
    }
    cases = progress.earlier_cases("tso", settings)
    done = {case["shape"] for case in cases}
    render = RenderSettings(views=settings["views"], size=(SIZE, SIZE))

    def judged(shape: Shape) -> Cases:
        seen = see(shape, render, settings["seed"])
        config = partial(RefineConfig, steps=settings["steps"], device=settings["device"])
        return [judge_view(shape, seen, number, network, about, config) for number in range(settings["views"])]

    def record(cases: Cases, complete: bool) -> Record:
        summary = summarise(cases)
        about = {"complete": complete, "settings": settings, "paper": PAPER, "summary": summary}
        return record_of("tso", CONVENTION, **about, claims=claims(summary) if complete else [], cases=cases)

    groups = [None if shape.name in done else partial(judged, shape) for shape in shapes]
    return progress.complete("refining", cases, groups, record)


def judge_view(
    shape: Shape, seen: SeenShape, number: int, network: BaseNetwork, about: NetworkConfig, config: Callable[..., RefineConfig]
) -> dict[str, Any]:
    """Predict from one picture, refine with every variant, and measure all four clouds under both protocols."""
    picture = seen.views[number]
    view = View(picture.mask.astype(np.float32) / 255.0, picture.camera, name=f"{shape.name}, view {number}")
    scene = network_scene(picture.image, view, network, about, placing="box")
    clouds = {"before": scene.points}
    ious: dict[str, float] = {}
    seconds: dict[str, float] = {}
    best_steps: dict[str, int] = {}
    for variant in VARIANTS:
        settings = config(variant, sigma_sq=about.sigma_sq, preset="paper")
        points = scene.points if variant == "points" else None
        start = time.perf_counter()
        result = uninterrupted(refine(points, scene.view, config=settings, network=network, image=scene.image))
        seconds[variant] = time.perf_counter() - start
        clouds[variant], best_steps[variant] = result.points, result.best_step
        ious.setdefault("before", result.iou_before)
        ious[variant] = result.iou_after
    target = seen.target @ (CANONICAL_ROTATION @ picture.camera.R).T
    visible = visible_points(seen.scene, seen.target, picture.camera)
    scaled = normalise_longest_side
    return {
        "category": shape.category,
        "shape": shape.name,
        "view": number,
        "visible_share": float(visible.mean()),
        "capnet": {name: distances(scaled(cloud), scaled(target), visible) for name, cloud in clouds.items()},
        "plain": {name: distances(cloud, target, visible) for name, cloud in clouds.items()},
        "iou": ious,
        "best_step": best_steps,
        "seconds": seconds,
    }


def distances(prediction: Array, target: Array, visible: NDArray[np.bool_]) -> dict[str, float | None]:
    """Both directions of the Chamfer distance, and the forward one over the visible [N] bool and the other target points.

    A group without points has None.
    """
    forward, backward = nearest_squared(target, prediction), nearest_squared(prediction, target)
    return {
        "forward": float(forward.mean()),
        "backward": float(backward.mean()),
        "visible": float(forward[visible].mean()) if visible.any() else None,
        "occluded": float(forward[~visible].mean()) if not visible.all() else None,
    }


def summarise(cases: Cases) -> dict[str, Any]:
    """Means over the cases of each category, and over all of them as "all"."""
    return {name: _group(group) for name, group in {**dict(sorted(by_category(cases).items())), "all": cases}.items()}


def _group(cases: Cases) -> dict[str, Any]:
    shapes = [case["shape"] for case in cases]
    return {
        "shapes": len(set(shapes)),
        "cases": len(cases),
        "visible_share": float(np.mean([case["visible_share"] for case in cases])),
        "iou": {name: float(np.mean([case["iou"][name] for case in cases])) for name in LETTERS},
        "median_seconds": {name: float(np.median([case["seconds"][name] for case in cases])) for name in VARIANTS},
        **{protocol: _distances([case[protocol] for case in cases], shapes) for protocol in ("capnet", "plain")},
    }


def _distances(cases: list[dict[str, dict[str, Any]]], shapes: list[str]) -> dict[str, Any]:
    """Before and each variant: means of the distances; and of each variant what became of them."""
    chamfers = {name: np.array([case[name]["forward"] + case[name]["backward"] for case in cases]) for name in LETTERS}
    summary: dict[str, Any] = {}
    for name, chamfer in chamfers.items():
        row: dict[str, Any] = {}
        for key in ("forward", "backward", "visible", "occluded"):
            values = [case[name][key] for case in cases if case[name][key] is not None]
            row[key] = float(np.mean(values)) if values else None
        row["chamfer"] = float(chamfer.mean())
        if name != "before":
            before = summary["before"]
            row["ratio_of_means"] = row["chamfer"] / before["chamfer"]
            row["interval"] = interval(shapes, chamfer, chamfers["before"])
            for key in ("visible", "occluded"):
                row[f"{key}_ratio"] = row[key] / before[key] if before[key] else None
            row |= ratio_figures(chamfer / chamfers["before"])
        summary[name] = row
    return summary


def claims(summary: dict[str, Any]) -> list[dict[str, Any]]:
    """What the paper says of its table, whether it holds here over all cases and in every category, and the figures.

    All are judged under the paper's protocol, on ratios of the means after and before; the first one, over all, on the whole
    interval of each ratio, so that what might be chance does not count.
    """
    keys = ("ratio_of_means", "visible_ratio", "occluded_ratio")
    holding: dict[str, list[bool]] = {}
    for name, group in summary.items():
        rows = {variant: group["capnet"][variant] for variant in VARIANTS}
        # A view that shows everything has no occluded points, whose ratio is then 1.
        total, visible, occluded = (
            {variant: 1.0 if row[key] is None else row[key] for variant, row in rows.items()} for key in keys
        )
        gained = {variant: group["iou"][variant] - group["iou"]["before"] for variant in VARIANTS}
        highest = [row["interval"][1] if name == "all" else total[variant] for variant, row in rows.items()]
        holding[name] = [
            max(highest) < 1.0,
            total["encoder-decoder"] < total["encoder"] < total["points"],
            max(occluded.values()) <= KEPT,
            max(visible.values()) < 1.0,
            all(visible[name] < visible["encoder"] and gained[name] > gained["encoder"] for name in VARIANTS[1:]),
        ]
    # The last group is that of all cases.
    totals, visibles = _changes(total), f"visible points {_changes(visible)}"
    ends = ", ".join(
        f"{LETTERS[name]} {' to '.join(f'{100.0 * (end - 1.0):+.1f}' for end in row['interval'])} %"
        for name, row in rows.items()
    )
    ious = ", ".join(f"{LETTERS[name]} {more:+.3f}" for name, more in gained.items())
    figures = {
        "every variant lowers the mean Chamfer distance": f"{totals}; 95 % intervals over shapes {ends}",
        "E and D together gain most, p alone least": totals,
        "what the picture does not show is kept": f"forward distance of occluded points {_changes(occluded)}",
        "what the picture shows comes nearer to the truth": f"forward distance of {visibles}",
        "E alone misses detail that the other two gain": f"{visibles}; IoU {ious}",
    }
    answers = []
    for number, (text, numbers) in enumerate(figures.items()):
        fails = [name for name, holds in holding.items() if not holds[number]]
        answers.append(claim(text, not fails, numbers + (f"; not on {', '.join(fails)}" if fails else "")))
    return answers


def _changes(ratios: dict[str, float]) -> str:
    return ", ".join(f"{LETTERS[name]} {100.0 * (ratio - 1.0):+.1f} %" for name, ratio in ratios.items())


def tables(record: Record) -> list[Table]:
    """The paper's table beside ours, and what became of each category."""
    summary, paper = record["summary"], record["paper"]
    sides = []
    for name, theirs in paper.items():
        row = summary["all"]["capnet"][name]
        change = None if name == "before" else 100.0 * (row["ratio_of_means"] - 1.0)
        theirs_change = None if name == "before" else 100.0 * (theirs[2] / paper["before"][2] - 1.0)
        ours = [1e3 * row[key] for key in ("forward", "backward", "chamfer")]
        sides.append([LETTERS[name], *ours, change, *theirs, theirs_change])
    rows = []
    for category, group in summary.items():
        before = group["capnet"]["before"]["chamfer"]
        for name in VARIANTS:
            row = group["capnet"][name]
            low, high = row["interval"]
            rows.append(
                [category, LETTERS[name], group["cases"], 1e3 * before, 1e3 * row["chamfer"], row["ratio_of_means"]]
                + [f"{low:.3f} to {high:.3f}", row["median_ratio"], row["worst_ratio"], row["worse"]]
                + [group["plain"][name]["ratio_of_means"], row["visible_ratio"], row["occluded_ratio"]]
                + [group["iou"]["before"], group["iou"][name], group["median_seconds"][name]]
            )
    header = ["category", "moves", "cases", "before", "after", "ratio", "95 % interval", "median", "worst", "worse"]
    note = (
        "Chamfer x1000, the paper's protocol; ratio: after/before of the means; median, worst: of the cases' own; worse: cases "
        "over 1; plain: ratio without scaling; visible, occluded: ratio of the forward distance of target points that the view "
        "sees, and of the others"
    )
    return [
        Table(["", "forward", "backward", "Chamfer", "%", "paper's forward", "backward", "Chamfer", "%"], sides, decimals=2),
        Table([*header, "plain", "visible", "occluded", "IoU before", "after", "s"], rows, note=note),
    ]


def draw(path: Path, record: Record, overwrite: bool = False) -> None:
    """Chamfer after / before of every view, a panel for each category; dotted: the paper's ratio of the means."""
    paper = {LETTERS[name]: record["paper"][name][2] / record["paper"]["before"][2] for name in VARIANTS}
    panels = []
    for category, cases in {**by_category(record["cases"]), "all": record["cases"]}.items():
        sums = [{name: row["forward"] + row["backward"] for name, row in case["capnet"].items()} for case in cases]
        rows = {LETTERS[name]: [row[name] / row["before"] for row in sums] for name in VARIANTS}
        panels.append(Panel(f"{category}, {len(cases)} views", rows, paper))
    draw_ratios(path, [panels], overwrite)


STUDY = Study(
    "tso",
    "The paper's table. The network predicts each view of each shape; the prediction is judged before and after moving the "
    "encoder (E), the whole network (E and D) and the points (p), with the paper's settings.",
    (
        *COMMON,
        CHECKPOINT,
        part("test"),
        CATEGORY,
        Option("--views", "Random views of each shape.", int, 4, least=1),
        Option("--steps", kind=int, default=50, least=0),
        DEVICE,
    ),
    run,
    tables,
    draw,
    "The paper reports gains of 3 to 6 %. What a variant moves decides what it changes: through the weights the whole "
    "cloud moves, points alone move where the mask says so. The intervals are over shapes, as views of one shape are not "
    "independent; a gain counts only where its whole interval lies below 1.",
    kept="after every shape",
)
