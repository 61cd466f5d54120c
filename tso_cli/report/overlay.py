"""The picture of one refinement: mask and silhouette, and the cloud from two sides, before and after."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..projection import silhouette_of
from ..refinement import RefineResult
from ..scene import View

# Safe for colour-blind readers: blue is missing, orange is too much.
AGREED, MISSING, STRAY = (0.62, 0.65, 0.68), (0.0, 0.45, 0.70), (0.90, 0.45, 0.0)
UNKNOWN = (0.93, 0.90, 0.80)


def compare(silhouette: NDArray[np.floating], view: View) -> NDArray[np.float64]:
    """[H, W, 3] picture: grey where mask and silhouette agree, blue where the silhouette is missing, orange where it strays.

    Soft values blend.
    """
    mask = view.mask.astype(np.float64)[..., None]
    shape = np.asarray(silhouette, dtype=np.float64)[..., None]
    picture = mask * shape * AGREED + mask * (1 - shape) * MISSING + (1 - mask) * shape * STRAY + (1 - mask) * (1 - shape)
    if view.known is not None:
        picture[~view.known] = UNKNOWN
    return picture


def draw_overlay(path: Path, result: RefineResult, view: View) -> None:
    """Write a picture: a row before and a row after; mask against silhouette, the cloud from the camera, and from its right.

    It is written straight to ``path``, for the caller to move where it belongs once all outputs are there.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10.2, 7.0), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 3)
    rotated = [points @ view.camera.R.T for points in (result.initial, result.points)]
    low = np.min([points.min(0) for points in rotated], axis=0)
    high = np.max([points.max(0) for points in rotated], axis=0)
    middle, half = (low + high) / 2.0, float((high - low).max()) * 0.53
    rows = (("before", result.initial, rotated[0], result.iou_before), ("after", result.points, rotated[1], result.iou_after))
    for (name, points, seen, iou), (left, front, side) in zip(rows, axes, strict=True):
        left.imshow(compare(silhouette_of(points, view.camera, result.sigma_sq), view), interpolation="nearest")
        left.set_title(f"{name}: IoU {iou:.3f}")
        # OpenCV axes: x right, y down, z away. From the right of the camera, what is far lies to the right.
        _scatter(front, seen[:, 0], seen[:, 1], seen[:, 2], middle[0], middle[1], half)
        front.set_title(f"{name}: from the camera")
        _scatter(side, seen[:, 2], seen[:, 1], -seen[:, 0], middle[2], middle[1], half)
        side.set_title(f"{name}: from the camera's right")
    for axis in axes.flat:
        axis.set_xticks([])
        axis.set_yticks([])
    handles = [_patch(AGREED, "agree"), _patch(MISSING, "mask without silhouette"), _patch(STRAY, "silhouette without mask")]
    if view.known is not None:
        handles.append(_patch(UNKNOWN, "says nothing"))
    figure.legend(
        handles=handles,
        loc="outside lower left",
        ncols=4,
        frameon=False,
    )
    figure.savefig(path, dpi=110)


def _scatter(axis, x, y, depth, middle_x, middle_y, half) -> None:  # type: ignore[no-untyped-def]
    order = np.argsort(-depth)
    size = float(np.clip(4000.0 / len(x), 0.3, 6.0))
    axis.scatter(x[order], y[order], c=depth[order], s=size, cmap="viridis_r", linewidths=0)
    axis.set_xlim(middle_x - half, middle_x + half)
    axis.set_ylim(middle_y + half, middle_y - half)
    axis.set_aspect("equal")


def _patch(colour, label):  # type: ignore[no-untyped-def]
    from matplotlib.patches import Patch

    return Patch(color=colour, label=label)
