"""How good is the base network on shapes it has not seen? Beside it, what needs no network: the mean and the nearest shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ...io.checkpoints import load_network
from ...io.shipped import CATEGORIES
from ...plots.style import COLOURS, PALE, page
from ...silhouette.chamfer import chamfer
from ...train.batches import Draw, assemble
from ..study import CHECKPOINT, MESHES, SEED, SPLIT, Option, Progress, Record, Study, Table, record_of
from .material import Material, Source
from .mean_shape import TURNS, aligned_mean, mean_shape, pair_chamfer, view_targets
from .parts import SPLIT as SHIPPED_SPLIT

Floats = NDArray[np.float32]
PARTS = ("validation", "test")
LABELS = {
    "network": "network",
    "nearest": "nearest training shape",
    "mean_aligned": "mean shape, aligned",
    "mean_view": "mean shape, view",
}
"""The network, and answers without one; see `run`."""
CONVENTION = "squared distances, mean over points, forward + backward; targets of longest side 1, in the view's frame"


def run(
    progress: Progress, *, meshes: Path, split: Path | None, checkpoint: Path, categories: tuple[str, ...], seed: int
) -> Record:
    """Judge a view-aligned network by Chamfer distance on the validation and test shapes of a split, beside three answers.

    - ``mean_view``: the mean training shape as the cameras see it: what a network that ignores the picture would learn.
    - ``mean_aligned``: the mean training shape in the objects' frame, in the best of four quarter turns: the pose is given.
    - ``nearest``: the nearest training shape in the best of four quarter turns: the best that retrieval could do.
    """
    network, about = load_network(checkpoint)
    source = Source(meshes, split or SHIPPED_SPLIT, seed=seed, categories=categories)
    materials = {part: Material(replace(source, part=part), progress.report) for part in PARTS}
    summary: dict[str, dict[str, Any]] = {part: {} for part in PARTS}
    shapes: list[dict[str, Any]] = []
    for category in categories:
        training = materials[PARTS[0]].data(category, training=True)
        mean_view = mean_shape(view_targets(training), seed)
        clouds = [training.target(i) for i in range(len(training.objects))]
        mean_aligned = aligned_mean(clouds, seed)
        for part in PARTS:
            judged = materials[part].data(category, training=False)
            rows = []
            for index, item in enumerate(judged.objects):
                batch = assemble(judged, [Draw(index, view) for view in range(len(item.views))], "view")
                truth = judged.target(index)
                with torch.no_grad():
                    predicted = network(torch.from_numpy(batch.images))
                distances = {
                    "network": _distance(predicted, batch.targets),
                    "mean_view": _distance(torch.from_numpy(mean_view).expand(len(batch.targets), -1, -1), batch.targets),
                    "mean_aligned": nearest_of([mean_aligned], truth),
                    "nearest": nearest_of(clouds, truth),
                }
                rows.append({"part": part, "shape": item.name, **distances})
                progress.report(f"{category}: judging, {part}", index + 1, len(judged.objects))
            shapes += rows
            summary[part][category] = _summary(rows, len(clouds))
    settings = {key: getattr(about, key) for key in ("steps", "training_set", "points", "sigma_sq")}
    settings |= {"seed": seed, "split": source.split.name, "device": "cpu"}
    return record_of("network", CONVENTION, settings=settings, summary=summary, shapes=shapes)


def nearest_of(clouds: Sequence[Floats], truth: Floats) -> float:
    """Chamfer distance from ``truth`` to the nearest of ``clouds``, in the best of four quarter turns."""
    return min(pair_chamfer(cloud, truth @ turn) for cloud in clouds for turn in TURNS)


def _distance(clouds: Tensor, targets: Sequence[Floats]) -> float:
    forward, backward = chamfer(clouds, torch.from_numpy(np.stack(targets)))
    return float((forward + backward).mean())


def _summary(rows: list[dict[str, Any]], training: int) -> dict[str, Any]:
    means = {name: float(np.mean([row[name] for row in rows])) for name in LABELS}
    return {"shapes": len(rows), "training_shapes": training, **means}


def tables(record: Record) -> list[Table]:
    """A row for each list and category."""
    rows = [
        [part, category, row["shapes"], *(1e3 * row[name] for name in LABELS)]
        + [row["network"] / row[name] for name in ("mean_view", "nearest")]
        for part, summary in record["summary"].items()
        for category, row in summary.items()
    ]
    note = "Chamfer x1000, mean over shapes and views"
    return [Table(["list", "category", "shapes", *LABELS.values(), "/ mean, view", "/ nearest"], rows, note=note)]


def draw(path: Path, record: Record, overwrite: bool = False) -> None:
    """Chamfer of the network and of its three rivals, by category, on validation and test shapes."""
    with page(path, overwrite, (9.6, 4.2)) as figure:
        axes = figure.subplots(1, len(record["summary"]), sharey=True, squeeze=False)[0]
        for axis, (part, summary) in zip(axes, record["summary"].items(), strict=True):
            for j, (name, colour) in enumerate(zip(LABELS, (COLOURS[0], "#999999", PALE, "#e5e5e5"), strict=True)):
                values = [1e3 * row[name] for row in summary.values()]
                bars = axis.bar(np.arange(len(values)) + 0.2 * (j - 1.5), values, 0.19, color=colour, label=LABELS[name])
                axis.bar_label(bars, fmt="%.1f", fontsize=7, padding=2)
            axis.set_xticks(range(len(summary)), [f"{name}\n{row['shapes']} shapes" for name, row in summary.items()])
            axis.set_title(part)
        axes[0].set_ylabel("Chamfer to the truth x1000, mean")
        figure.legend(*axes[0].get_legend_handles_labels(), loc="outside lower center", frameon=False, ncols=4)


STUDY = Study(
    "network",
    "Chamfer to the truth, beside the mean training shape and the nearest training shape.",
    (
        MESHES,
        SPLIT,
        CHECKPOINT,
        Option("--category", "May be repeated.", str, CATEGORIES, multiple=True, name="categories"),
        SEED,
    ),
    run,
    tables,
    draw,
    "A network that ignored the picture could do no better than the mean shape in its own frame. The nearest training shape is "
    "the best that retrieval could do, were it told the answer: a network that comes close to it has learnt more than to "
    "remember.",
)
