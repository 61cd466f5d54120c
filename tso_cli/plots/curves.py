"""Loss curves of trainings, and samples of a network."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..geometry.points import evenly
from ..io.logs import TrainingLog
from .style import COLOURS, INK, page

if TYPE_CHECKING:
    from ..network.model import BaseNetwork
    from ..train.data import TrainingData


@dataclass(frozen=True, eq=False)
class Sample:
    """The network's input in [0, 1], its prediction, and the true points in the same frame.

    In this frame y points up and z toward the viewer.
    """

    name: str
    image: NDArray[np.float32]  # [3, H, W]
    points: NDArray[np.float64]  # [N, 3]
    target: NDArray[np.float64] | None  # [M, 3]
    chamfer: float | None  # between the two


def sample_predictions(
    network: BaseNetwork, data: TrainingData, frame: str, count: int = 6
) -> list[Sample]:
    """Predictions from the first view of at most ``count`` objects, spread evenly over the data."""
    import torch

    from ..evaluation.metrics import chamfer
    from ..train.batches import Draw, assemble

    samples = []
    device = next(network.parameters()).device
    for index in evenly(len(data.objects), count):
        has_target = data.readable(index)
        if data.usable(index, 0, has_target)[0] != index:
            continue  # none of its pictures can be read
        batch = assemble(data, [Draw(index, 0)], frame, targets=has_target)
        with torch.no_grad():
            (cloud,) = network(torch.as_tensor(batch.images, device=device))
        points = cloud.cpu().numpy().astype(np.float64)
        target = batch.targets[0].astype(np.float64) if batch.targets else None
        distance = None if target is None else chamfer(points, target).chamfer
        samples.append(Sample(data.objects[index].name, batch.images[0], points, target, distance))
    return samples


def running_mean(values: NDArray[np.float64], window: int) -> NDArray[np.float64]:
    """The mean of the last ``window`` values at each place; of fewer values at the start."""
    sums = np.concatenate([[0.0], np.cumsum(values)])
    ends = np.arange(1, len(values) + 1)
    starts = np.maximum(ends - window, 0)
    return np.asarray((sums[ends] - sums[starts]) / (ends - starts))


def lambda_drop(log: TrainingLog) -> int | None:
    """The first step with a smaller lambda than the step before; None if there is no such step."""
    if "lambda" not in log.columns:
        return None
    drops = np.flatnonzero(np.diff(log.columns["lambda"]) < 0.0)
    return int(log.columns["step"][drops[0] + 1]) if len(drops) else None


def draw_curves(path: Path, logs: Sequence[TrainingLog], overwrite: bool = False) -> None:
    """Draw the loss and its terms over the steps, on a logarithmic scale.

    At most 4,000 values are drawn of a curve, faint, under their running mean over 2 % of the
    steps. A dotted line marks the drop of lambda. Raises
    InputError if ``path`` cannot be written.
    """
    names = dict.fromkeys(name for log in logs for name in log.columns)
    terms = [name for name in names if name not in ("step", "lambda")]
    with page(path, overwrite, (1.2 + 4.0 * len(terms), 4.2)) as figure:
        axes = dict(zip(terms, figure.subplots(1, len(terms), squeeze=False)[0], strict=True))
        handles: dict[str, Any] = {}
        for number, (label, log) in enumerate(zip(labels(logs), logs, strict=True)):
            colour, drop = COLOURS[number % len(COLOURS)], lambda_drop(log)
            for name in terms:
                if name not in log.columns:
                    continue
                values = log.columns[name]
                stride = max(1, len(values) // 4000)
                steps = log.columns["step"][::stride]
                means = running_mean(values, max(1, round(0.02 * len(values))))[::stride]
                axes[name].plot(steps, values[::stride], color=colour, alpha=0.2, linewidth=0.6)
                (handles[label],) = axes[name].plot(steps, means, color=colour, linewidth=1.6)
                if drop is not None:
                    handles["lambda drops"] = axes[name].axvline(
                        drop, color=INK, linestyle=":", linewidth=1.0
                    )
        for name, axis in axes.items():
            axis.set_title(name)
            axis.set_xlabel("step")
            # The affinity loss is 0 in all steps if its weight is 0.
            if any((log.columns[name] > 0.0).any() for log in logs if name in log.columns):
                axis.set_yscale("log")
        place: dict[str, Any] = {"loc": "outside lower center", "ncols": min(4, len(handles))}
        figure.legend(list(handles.values()), list(handles), frameon=False, **place)


def draw_samples(
    path: Path, samples: Sequence[Sample], scale: str, overwrite: bool = False
) -> None:
    """Draw a row for each sample: the picture, prediction and target from the front and the right.

    ``scale`` is the scale of the clouds in words. Raises InputError if ``path`` cannot be written.
    """
    with page(path, overwrite, (11.0, 2.3 * len(samples)), frames=True) as figure:
        axes = figure.subplots(len(samples), 5, squeeze=False)
        for row, sample in zip(axes, samples, strict=True):
            _draw_sample(row, sample)
        sides = ("front", "from the right")
        clouds = [f"{cloud}, {side}" for side in sides for cloud in ("prediction", "target")]
        for axis, title in zip(axes[-1], ("input", *clouds), strict=True):
            axis.set_xlabel(title)
        for axis in axes.flat:
            axis.set_xticks([])
            axis.set_yticks([])
        figure.supxlabel(f"Chamfer: squared distances, mean over points, {scale}", fontsize=8)


def _draw_sample(row: Sequence[Any], sample: Sample) -> None:
    row[0].imshow(np.clip(sample.image.transpose(1, 2, 0), 0.0, 1.0), interpolation="nearest")
    name = sample.name.split("/")[-1]
    row[0].set_ylabel(name if len(name) <= 24 else f"{name[:23]}…", fontsize=8)
    if sample.chamfer is not None:
        row[1].set_title(f"Chamfer x1000: {1e3 * sample.chamfer:.2f}", fontsize=9)
    half = 1.05 * max(
        float(np.abs(cloud).max()) for cloud in (sample.points, sample.target) if cloud is not None
    )
    for number, cloud in enumerate((sample.points, sample.target, sample.points, sample.target), 1):
        row[number].set(aspect="equal", xlim=(-half, half), ylim=(-half, half))
        if cloud is not None:
            # Seen from the right, the viewer's side (z) is on the left.
            across, depth = (
                (cloud[:, 0], cloud[:, 2]) if number <= 2 else (-cloud[:, 2], cloud[:, 0])
            )
            order = np.argsort(depth)
            row[number].scatter(
                across[order], cloud[order, 1], c=depth[order], s=3, cmap="viridis", linewidths=0
            )


def labels(logs: Sequence[TrainingLog]) -> list[str]:
    """The name of each log's file, with its folder if several logs have the same name."""
    stems = [log.path.stem for log in logs]
    folders = [
        f"{log.path.resolve().parent.name}/" if stems.count(log.path.stem) > 1 else ""
        for log in logs
    ]
    return [folder + stem for folder, stem in zip(folders, stems, strict=True)]
