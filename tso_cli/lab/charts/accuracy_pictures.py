"""A grid of cases: mask and silhouette, and what became of the cloud where the camera cannot see it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ...evaluation.footprint import common_window, in_window
from ...geometry.points import Array
from ...plots.style import WORSE, page

if TYPE_CHECKING:
    from ..studies.cases import Case

CELL = 1.6
"""Inches."""
DOTS = 1500
"""Points of a cloud that are drawn, at most."""
# What is across, what is up, and what is near, of the camera's axes (x right, y down, z away).
SIDES = {
    "from the camera's right": np.array([(0, 0, 1), (0, -1, 0), (1, 0, 0)], dtype=np.float64),
    "from above": np.array([(1, 0, 0), (0, 0, 1), (0, -1, 0)], dtype=np.float64),
}


def draw_cases(path: Path, cases: Sequence[tuple[str, Case, Array]], overwrite: bool = False) -> None:
    """A row for each (title, case, refined points).

    The mask with the silhouette's outline before and after, then both clouds and the truth from two sides. Raises InputError if
    ``path`` cannot be written to.
    """
    columns = 2 + 3 * len(SIDES)
    with page(path, overwrite, (CELL * columns, (CELL + 0.4) * len(cases)), dpi=80) as figure:
        axes = figure.subplots(len(cases), columns, squeeze=False)
        for row, (title, case, refined) in zip(axes, cases, strict=True):
            view = case.views[0]
            box = common_window([(points, view) for points in (case.initial, refined)])
            for axis, points, name in zip(row, (case.initial, refined), ("initial", "refined"), strict=False):
                window = in_window(points, view, box)
                axis.imshow(1.0 - 0.45 * window.mask, cmap="gray", vmin=0.0, vmax=1.0)
                if window.silhouette.any() and not window.silhouette.all():
                    axis.contour(window.silhouette, levels=[0.5], colors=WORSE, linewidths=1.2)
                axis.set_title(f"mask, {name} outline", fontsize=8)
            turned = {
                name: points @ view.camera.R.T
                for name, points in (("initial", case.initial), ("refined", refined), ("truth", case.target))
            }
            for i, (side, directions) in enumerate(SIDES.items()):
                clouds = {name: points @ directions.T for name, points in turned.items()}
                for axis, name in zip(row[2 + 3 * i :], clouds, strict=False):
                    _draw_cloud(axis, clouds[name], list(clouds.values()))
                    axis.set_title(f"{name}\n{side}", fontsize=8)
            for axis in row:
                axis.set(xticks=[], yticks=[])
            row[0].text(0.0, 1.25, title, transform=row[0].transAxes, fontsize=9)


def _draw_cloud(axis: Any, points: Array, frame: Sequence[Array]) -> None:
    """``points`` [N, 3] across, up and towards the eye; all clouds of ``frame`` share one frame."""
    low, high = (np.array([getattr(cloud, end)(0) for cloud in frame]) for end in ("min", "max"))
    middle, half = (low.min(0) + high.max(0)) / 2.0, float((high.max(0) - low.min(0))[:2].max()) * 0.54
    across, up, near = (points[:: -(-len(points) // DOTS)] - middle).T
    order = np.argsort(near)
    axis.scatter(across[order], up[order], s=2.2, c=near[order], cmap="viridis", linewidths=0)
    axis.set(xlim=(-half, half), ylim=(-half, half), aspect="equal")
