"""A grid of cases: what the mask asked for, and what became of the cloud where the camera cannot see it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...evaluation.footprint import Seen, common_window, in_window
from ...geometry.view import View
from ...io.output import atomic_output, check_output

Array = NDArray[np.float64]

INK, OUTLINE = "#333333", "#d55e00"
CELL = 1.75
"""Inches."""
DOTS = 1500
"""Points of a cloud that are drawn, at most."""
# What is across, what is up, and what is near, of the camera's axes (x right, y down, z away).
SIDES = {
    "from the camera's right": ((0, 0, 1), (0, -1, 0), (1, 0, 0)),
    "from above": ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
}
CLOUDS = ("initial", "refined", "truth")


@dataclass(frozen=True, eq=False)
class Pictured:
    """A case to draw.

    Attributes
    ----------
    title : beside its row. view : the mask that was seen.
    initial, refined, target : [N, 3] clouds, longest side about 1.
    """

    title: str
    view: View
    initial: Array
    refined: Array
    target: Array


def draw_cases(path: Path, cases: Sequence[Pictured], overwrite: bool = False) -> None:
    """A row a case: the mask with the silhouette's outline before and after, then both clouds and the truth from two sides.

    Raises InputError if ``path`` cannot be written to.
    """
    check_output(path, overwrite)
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    columns = 2 + len(SIDES) * len(CLOUDS)
    figure = Figure(figsize=(CELL * columns + 1.6, CELL * len(cases) + 0.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(len(cases), columns, squeeze=False)
    for row, case in zip(axes, cases, strict=True):
        box = common_window([(points, case.view) for points in (case.initial, case.refined)])
        for axis, points in zip(row[:2], (case.initial, case.refined), strict=True):
            _draw_mask(axis, in_window(points, case.view, box))
        clouds = case.initial, case.refined, case.target
        turned = [points @ case.view.camera.R.T for points in clouds]
        for i, (across, up, near) in enumerate(SIDES.values()):
            for axis, points in zip(row[2 + i * len(CLOUDS) :], turned, strict=False):
                _draw_cloud(axis, points, np.array([across, up, near], dtype=np.float64), turned)
        row[0].set_ylabel(case.title, fontsize=9, rotation=0, ha="right", va="center", color=INK)
    titles = ["mask, initial outline", "mask, refined outline"]
    titles += [f"{cloud}\n{side}" for side in SIDES for cloud in CLOUDS]
    for axis, title in zip(axes[0], titles, strict=True):
        axis.set_title(title, fontsize=9, color=INK)
    with atomic_output(path) as temporary:
        figure.savefig(temporary, dpi=80)


def _draw_mask(axis: Any, seen: Seen) -> None:
    axis.imshow(1.0 - 0.45 * seen.mask, cmap="gray", vmin=0.0, vmax=1.0)
    if seen.silhouette.any() and not seen.silhouette.all():
        axis.contour(seen.silhouette, levels=[0.5], colors=OUTLINE, linewidths=1.2)
    _bare(axis)


def _draw_cloud(axis: Any, points: Array, axes: Array, every: Sequence[Array]) -> None:
    """``axes`` [3, 3]: across, up and towards the eye; all of ``every`` share one frame."""
    low, high = (np.array([getattr(cloud @ axes.T, end)(0) for cloud in every]) for end in ("min", "max"))
    middle, half = (low.min(0) + high.max(0)) / 2.0, float((high.max(0) - low.min(0))[:2].max()) * 0.54
    across, up, near = (points[:: -(-len(points) // DOTS)] @ axes.T - middle).T
    order = np.argsort(near)
    axis.scatter(across[order], up[order], s=2.2, c=near[order], cmap="viridis", linewidths=0)
    axis.set_xlim(-half, half)
    axis.set_ylim(-half, half)
    axis.set_aspect("equal")
    _bare(axis)


def _bare(axis: Any) -> None:
    axis.set_xticks([])
    axis.set_yticks([])
    for spine in axis.spines.values():
        spine.set_color("#cccccc")
