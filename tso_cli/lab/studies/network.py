"""How good is the base network on shapes it has not seen? Beside it, what needs no network: the mean and the nearest shape."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import torch

from ...evaluation.metrics import chamfer
from ...io.checkpoints import load_network
from ...io.shipped import CATEGORIES
from ...train.batches import Draw, assemble
from ..charts import draw_bars
from ..study import (
    CATEGORY,
    CHECKPOINT,
    MESHES,
    SEED,
    SPLIT,
    Cases,
    Plan,
    Progress,
    Record,
    Study,
    Table,
)
from .judging import Floats, Material, mean_shape
from .shapes import SPLIT as SHIPPED_SPLIT
from .shapes import weights_hash
from .summary import mean, summarised

PARTS = ("validation", "test")
CONVENTION = {
    "Chamfer": "squared distances, mean over points, forward + backward; targets of longest side 1, in the view's frame"
}
LABELS = {
    "network": "network",
    "nearest": "nearest training shape",
    "mean_aligned": "mean shape, aligned",
    "mean_view": "mean shape, view",
}
"""The network, and answers without one; see `plan`."""
# Quarter turns about y: shapes of one category may face any of four ways.
TURNS = tuple(
    np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]], dtype=np.float32)
    for c, s in ((1, 0), (0, 1), (-1, 0), (0, -1))
)


def plan(
    progress: Progress,
    *,
    meshes: Path,
    split: Path | None,
    checkpoint: Path,
    categories: tuple[str, ...],
    seed: int,
) -> Plan:
    """Judge a view-aligned network by Chamfer distance on the validation and test shapes of a split, beside three answers.

    - ``mean_view``: the mean training shape as the cameras see it: what a network that ignores the picture would learn.
    - ``mean_aligned``: the mean training shape in the objects' frame, in the best of four quarter turns: the pose is given.
    - ``nearest``: the nearest training shape in the best of four quarter turns: the best that retrieval could do.
    """
    network, _ = load_network(checkpoint)
    materials = {
        part: Material(meshes, split, part, categories, seed=seed, report=progress.report)
        for part in PARTS
    }

    def judge(category: str) -> Cases:
        training = materials[PARTS[0]].data(category, training=True)
        draws = [
            Draw(index, view)
            for index, item in enumerate(training.objects)
            for view in range(min(8, len(item.views)))
        ]
        mean_view = mean_shape(assemble(training, draws, "view").targets, seed)
        clouds = [training.target(i) for i in range(len(training.objects))]
        mean_aligned = aligned_mean(clouds, seed)
        cases = []
        for part, material in materials.items():
            judged = material.data(category, training=False)
            for index, item in enumerate(judged.objects):
                batch = assemble(
                    judged, [Draw(index, view) for view in range(len(item.views))], "view"
                )
                with torch.no_grad():
                    predicted = network(torch.from_numpy(batch.images)).numpy()
                pairs = list(zip(predicted, batch.targets, strict=True))
                case: Record = {"part": part, "category": category, "shape": item.name}
                case["network"] = mean(chamfer(cloud, target).chamfer for cloud, target in pairs)
                case["mean_view"] = mean(
                    chamfer(mean_view, target).chamfer for target in batch.targets
                )
                case["mean_aligned"] = nearest_of([mean_aligned], judged.target(index))
                cases.append({**case, "nearest": nearest_of(clouds, judged.target(index))})
                progress.report(f"{category}: judging, {part}", index + 1, len(judged.objects))
        return cases

    settings = {
        "seed": seed,
        "split": (split or SHIPPED_SPLIT).name,
        "network": weights_hash(network),
    }
    settings |= {"shapes": {part: material.counts() for part, material in materials.items()}}
    return Plan(
        settings,
        [({"category": category}, partial(judge, category)) for category in categories],
        "judging",
    )


def nearest_of(clouds: Sequence[Floats], truth: Floats) -> float:
    """Chamfer distance from ``truth`` to the nearest of ``clouds``, in the best of four quarter turns."""
    return min(chamfer(cloud, truth @ turn).chamfer for cloud in clouds for turn in TURNS)


def aligned_mean(targets: Sequence[Floats], seed: int = 0) -> Floats:
    """The mean shape of ``targets`` in the quarter turns that fit it best; turns and mean alternate three times."""
    result = targets[0]
    for _ in range(3):
        facing = [[target @ turn for turn in TURNS] for target in targets]
        result = mean_shape(
            [min(turned, key=lambda cloud: chamfer(result, cloud).chamfer) for turned in facing],
            seed,
        )
    return result


def conclude(cases: Cases) -> Record:
    """{"summary": {part: {category: {"shapes", "network", "nearest", ...}}}}, means over the shapes."""

    def means(rows: Cases) -> Record:
        return {"shapes": len(rows), **{name: mean(row[name] for row in rows) for name in LABELS}}

    return {"summary": summarised(cases, ("part", "category"), means)}


def tables(record: Record) -> list[Table]:
    """A row for each list and category."""
    rows = [
        [part, category, row["shapes"], *(1e3 * row[name] for name in LABELS)]
        + [row["network"] / row[name] for name in ("mean_view", "nearest")]
        for part, summary in record["summary"].items()
        for category, row in summary.items()
    ]
    note = "Chamfer x1000, mean over shapes and views"
    return [
        Table(
            ["list", "category", "shapes", *LABELS.values(), "/ mean, view", "/ nearest"],
            rows,
            note=note,
        )
    ]


def draw(path: Path, record: Record, overwrite: bool = False) -> None:
    """Chamfer of the network and of its three rivals, by category, on validation and test shapes."""
    panels = {
        f"{part}: mean Chamfer to the truth x1000": {
            category: {label: 1e3 * row[key] for key, label in LABELS.items()}
            for category, row in summary.items()
        }
        for part, summary in record["summary"].items()
    }
    draw_bars(path, panels, overwrite)


STUDY = Study(
    name="network",
    about="Chamfer to the truth, beside the mean training shape and the nearest training shape.",
    parts=("pictures", "network modes, paper"),
    tables=tables,
    draw=draw,
    reading="A network that ignored the picture could do no better than the mean shape in its own frame. The nearest training "
    "shape is the best that retrieval could do, were it told the answer: a network that comes close to it has learnt more "
    "than to remember.",
    convention=CONVENTION,
    options=(
        MESHES,
        SPLIT,
        CHECKPOINT,
        replace(CATEGORY, help="May be repeated.", default=CATEGORIES),
        SEED,
    ),
    plan=plan,
    conclude=conclude,
)
