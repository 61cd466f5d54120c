"""How good the base network is on unseen shapes, compared with the mean and the nearest shape."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import torch

from tso_cli.evaluation.metrics import chamfer
from tso_cli.io.checkpoints import load_network
from tso_cli.io.shipped import CATEGORIES
from tso_cli.network.model import BaseNetwork
from tso_cli.train.batches import Draw, assemble
from tso_cli.train.data import TrainingData

from .. import options
from ..charts import Rows, bars
from ..study import Cases, Plan, Progress, Record, Study, Table
from .material import MEAN_STEPS, Floats, Material, mean_shape
from .shapes import SPLIT, weights_hash
from .summary import mean, summarised

PARTS = ("validation", "test")
MEAN_VIEWS = 8
"""Of each training shape, for the mean shape in the axes of the view."""
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
    material: Callable[..., Material] = Material,
) -> Plan:
    """Compare a view-aligned network with three answers, on the validation and test shapes.

    - ``mean_view``: the mean training shape as cameras see it; what a network would learn that
      ignores the picture.
    - ``mean_aligned``: the mean training shape in the objects' frame; the pose is given.
    - ``nearest``: the training shape nearest to the truth; the best that retrieval could do.

    The last two are taken in the best of four quarter turns.
    """
    network, _ = load_network(checkpoint)
    materials = {
        part: material(meshes, split, part, categories, seed=seed, report=progress.report)
        for part in PARTS
    }

    def compare(category: str) -> Cases:
        training = materials[PARTS[0]].data(category, training=True)
        unseen = {part: shapes.data(category, training=False) for part, shapes in materials.items()}
        rows = compared(network, training, unseen, seed, materials[PARTS[0]].mean_steps)
        return [{"category": category, **row} for row in rows]

    settings: Record = {"seed": seed, "split": (split or SPLIT).name}
    settings |= {"network": weights_hash(network)}
    settings |= {"shapes": {part: material.counts() for part, material in materials.items()}}
    jobs = [({"category": category}, partial(compare, category)) for category in categories]
    return Plan(settings, jobs, "comparing")


def compared(
    network: BaseNetwork,
    training: TrainingData,
    unseen: Mapping[str, TrainingData],
    seed: int,
    steps: int,
) -> Iterator[Record]:
    """For each unseen shape of each part the mean distance of the network, and of its rivals."""
    draws = [
        Draw(index, view)
        for index, item in enumerate(training.objects)
        for view in range(min(MEAN_VIEWS, len(item.views)))
    ]
    mean_view = mean_shape(assemble(training, draws, "view").targets, seed, steps)
    clouds = [training.target(i) for i in range(len(training.objects))]
    mean_aligned = aligned_mean(clouds, seed, steps)
    places = ((part, data, i) for part, data in unseen.items() for i in range(len(data.objects)))
    for part, data, index in places:
        item, truth = data.objects[index], data.target(index)
        batch = assemble(data, [Draw(index, view) for view in range(len(item.views))], "view")
        with torch.no_grad():
            predicted = network(torch.from_numpy(batch.images)).numpy()
        pairs = zip(predicted, batch.targets, strict=True)
        yield {
            "part": part,
            "shape": item.name,
            "network": mean(chamfer(*pair).chamfer for pair in pairs),
            "mean_view": mean(chamfer(mean_view, target).chamfer for target in batch.targets),
            "mean_aligned": nearest_of([mean_aligned], truth),
            "nearest": nearest_of(clouds, truth),
        }


def nearest_of(clouds: Sequence[Floats], truth: Floats) -> float:
    """Chamfer distance from ``truth`` to the nearest of ``clouds``, in the best quarter turn."""
    return min(chamfer(cloud, truth @ turn).chamfer for cloud in clouds for turn in TURNS)


def aligned_mean(targets: Sequence[Floats], seed: int = 0, steps: int = MEAN_STEPS) -> Floats:
    """The mean shape of ``targets`` in their best quarter turns; both alternate three times."""
    result = targets[0]
    for _ in range(3):
        best = [
            min((target @ turn for turn in TURNS), key=lambda cloud: chamfer(result, cloud).chamfer)
            for target in targets
        ]
        result = mean_shape(best, seed, steps)
    return result


def conclude(cases: Cases) -> Record:
    """{"summary": {part: {category: {"shapes", "network", "nearest", ...}}}}, over the shapes."""

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
    header = ["list", "category", "shapes", *LABELS.values(), "/ mean, view", "/ nearest"]
    return [Table(header, rows, note="Chamfer x1000, mean over shapes and views")]


def panels(record: Record) -> Rows:
    """Chamfer of the network and of its three rivals, by list and category."""
    return {
        f"{part}: mean Chamfer to the truth x1000": {
            category: {label: 1e3 * row[key] for key, label in LABELS.items()}
            for category, row in summary.items()
        }
        for part, summary in record["summary"].items()
    }


STUDY = Study(
    name="network",
    parts=("pictures", "network modes, paper"),
    tables=tables,
    draw=bars(panels),
    options=(
        options.MESHES,
        options.SPLIT,
        options.CHECKPOINT,
        options.categories(*CATEGORIES),
        options.SEED,
    ),
    plan=plan,
    conclude=conclude,
)
