"""Loss curves of trainings, and what a network makes of a few pictures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..io.logs import TrainingLog
from ..io.output import atomic_output, check_output
from .style import COLOURS, INK

# Share of the steps over which the running mean goes.
WINDOW = 0.02
# Values drawn of one curve; more would not show.
MOST_POINTS = 4000


@dataclass(frozen=True, eq=False)
class Sample:
    """One picture and its clouds.

    Attributes
    ----------
    name : of the object.
    image : [3, H, W] in [0, 1], as the network sees it.
    points, target : [N, 3] and [M, 3] in one frame, y up, z toward the viewer; target None where the truth is not known.
    chamfer : between them, raw; None without a target.
    """

    name: str
    image: NDArray[np.float32]
    points: NDArray[np.float64]
    target: NDArray[np.float64] | None
    chamfer: float | None


def running_mean(values: NDArray[np.float64], window: int) -> NDArray[np.float64]:
    """The mean over the last ``window`` values up to each; over those there are at the start."""
    sums = np.concatenate([[0.0], np.cumsum(values)])
    ends = np.arange(1, len(values) + 1)
    starts = np.maximum(ends - window, 0)
    return np.asarray((sums[ends] - sums[starts]) / (ends - starts))


def lambda_drop(log: TrainingLog) -> int | None:
    """The first step that was made with a smaller lambda than the one before it, None where there is none."""
    if "lambda" not in log.columns:
        return None
    fallen = np.flatnonzero(np.diff(log.columns["lambda"]) < 0.0)
    return int(log.columns["step"][fallen[0] + 1]) if len(fallen) else None


def draw_curves(path: Path, logs: Sequence[TrainingLog], overwrite: bool = False) -> None:
    """The loss and each of its terms over the steps, raw values faint under their running mean, logarithmic.

    A dotted line marks where lambda dropped. Terms that a training does not have are left out of its curves.

    Raises InputError if ``path`` cannot be written to.
    """
    check_output(path, overwrite)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    terms = list(dict.fromkeys(name for log in logs for name in log.columns if name not in ("step", "lambda")))
    figure = Figure(figsize=(1.2 + 4.0 * len(terms), 4.2), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(1, len(terms), squeeze=False)[0]
    handles: dict[str, Any] = {}
    for number, log in enumerate(logs):
        label = labels(logs)[number]
        colour = COLOURS[number % len(COLOURS)]
        steps, drop = log.columns["step"], lambda_drop(log)
        for axis, name in zip(axes, terms, strict=True):
            if name not in log.columns:
                continue
            values = log.columns[name]
            window = max(1, round(WINDOW * len(values)))
            every = max(1, len(values) // MOST_POINTS)
            axis.plot(steps[::every], values[::every], color=colour, alpha=0.2, linewidth=0.6)
            (handles[label],) = axis.plot(steps[::every], running_mean(values, window)[::every], color=colour, linewidth=1.6)
            if drop is not None:
                handles["lambda drops"] = axis.axvline(drop, color=INK, linestyle=":", linewidth=1.0)
    for axis, name in zip(axes, terms, strict=True):
        axis.set_title(name)
        axis.set_xlabel("step")
        # A term may be 0 throughout, as the affinity is without its weight.
        if any((log.columns[name] > 0.0).any() for log in logs if name in log.columns):
            axis.set_yscale("log")
        axis.spines[["top", "right"]].set_visible(False)
    figure.legend(list(handles.values()), list(handles), loc="outside lower center", ncols=min(4, len(handles)), frameon=False)
    with atomic_output(path) as temporary:
        figure.savefig(temporary, dpi=110)


def draw_samples(path: Path, samples: Sequence[Sample], scale: str, overwrite: bool = False) -> None:
    """A row for each sample: the picture, and prediction and target from the front and from the right; ``scale`` in words.

    Raises InputError if ``path`` cannot be written to.
    """
    check_output(path, overwrite)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.0, 2.3 * len(samples)), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(samples), 5, squeeze=False)
    for row, sample in zip(axes, samples, strict=True):
        row[0].imshow(np.clip(sample.image.transpose(1, 2, 0), 0.0, 1.0), interpolation="nearest")
        name = sample.name.split("/")[-1]
        row[0].set_ylabel(name if len(name) <= 24 else f"{name[:23]}…", fontsize=8)
        half = 1.05 * max(float(np.abs(cloud).max()) for cloud in (sample.points, sample.target) if cloud is not None)
        told = "" if sample.chamfer is None else f"Chamfer x1000: {1e3 * sample.chamfer:.2f}"
        row[1].set_title(told, fontsize=9)
        for axis, cloud in zip(row[1:], (sample.points, sample.target) * 2, strict=True):
            axis.set_aspect("equal")
            axis.set_xlim(-half, half)
            axis.set_ylim(-half, half)
            if cloud is None:
                continue
            # From the right the viewer's side, z, lies to the left.
            front = axis in row[1:3]
            across, depth = (cloud[:, 0], cloud[:, 2]) if front else (-cloud[:, 2], cloud[:, 0])
            order = np.argsort(depth)
            axis.scatter(across[order], cloud[order, 1], c=depth[order], s=3, cmap="viridis", linewidths=0)
    for axis, title in zip(
        axes[-1],
        ("input", "prediction, front", "target, front", "prediction, from the right", "target, from the right"),
        strict=True,
    ):
        axis.set_xlabel(title)
    figure.supxlabel(f"Chamfer: squared distances, mean over points, {scale}", fontsize=8)
    for axis in axes.flat:
        axis.set_xticks([])
        axis.set_yticks([])
    with atomic_output(path) as temporary:
        figure.savefig(temporary, dpi=110)


def labels(logs: Sequence[TrainingLog]) -> list[str]:
    """What each curve is called: the name of its file, with its folder where two share one."""
    stems = [log.path.stem for log in logs]
    return [
        stem if stems.count(stem) == 1 else f"{log.path.resolve().parent.name}/{stem}"
        for stem, log in zip(stems, logs, strict=True)
    ]
