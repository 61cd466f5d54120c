"""Depth maps of known kinds, brought to depth along z."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..geometry.arrays import Array
from ..geometry.depth_kind import FITTED
from ..geometry.view import View
from .depth_map import FEWEST_BLOCKS, RELATED, SeenSurface
from .findings import Finding

# Of the robust line: how often its weights are found, and its scale in median distances.
ROUNDS, ROBUST = 30, 1.5


def along_z(view: View) -> View:
    """The view with distances along the ray brought to depth along z."""
    if view.depth is None or view.depth_kind != "ray":
        return view
    row, column = np.ogrid[: view.depth.shape[0], : view.depth.shape[1]]
    return replace(view, depth=view.depth / view.camera.ray_lengths(row, column), depth_kind="z")


def fitted(points: Array, views: Sequence[View]) -> tuple[list[View], list[Finding]]:
    """The views with the maps that are known up to two numbers fitted, and what was found.

    ``points`` [N, 3] are those of a cloud in its place. A map that cannot be fitted is left out.
    """
    rows = [_fitted(points, view, number) for number, view in enumerate(views)]
    return [view for view, _ in rows], [finding for _, finding in rows if finding]


def _fitted(points: Array, view: View, number: int) -> tuple[View, Finding | None]:
    kind, depth = view.depth_kind, view.depth
    if depth is None or kind not in FITTED:
        return view, None
    surface = SeenSurface.of(points, view)
    power, what = (-1.0, "1 / depth") if kind == "inverse" else (1.0, "depth")
    values: dict[str, float | str]
    values = {"kind": kind, "what": what, "rank": surface.rank, "places": len(surface.depth)}
    unfitted = without_depth(view), Finding("depth-unfitted", (number,), values=values)
    if len(surface.depth) < FEWEST_BLOCKS or power * surface.rank < RELATED:
        return unfitted
    scale, shift = line(surface.values, surface.depth**power)
    powers = scale * depth + shift
    depth = np.where(powers > 0.0, powers, np.nan) ** power
    # Far from the cloud, small errors of the two numbers count for much.
    near, far = surface.depth.min() - surface.size, surface.depth.max() + surface.size
    depth = np.where((depth > near) & (depth < far), depth, np.nan)
    if scale <= 0.0 or not np.isfinite(depth[view.inside]).any():
        return unfitted
    found = Finding("depth-fitted", (number,), values=values | {"scale": scale, "shift": shift})
    return replace(view, depth=depth, depth_kind="z", depth_fitted=True), found


def without_depth(view: View) -> View:
    """The view with its mask alone."""
    return replace(view, depth=None, depth_kind="auto")


def line(x: Array, y: Array) -> tuple[float, float]:
    """Slope and intercept of ``y`` [B] by ``x`` [B], robust to pairs that do not belong together.

    Least squares, weighed again in each round with the weights of Geman and McClure.
    """
    weight = np.ones(len(x))
    for _ in range(ROUNDS):
        about_x, about_y = x - weight @ x / weight.sum(), y - weight @ y / weight.sum()
        slope = (weight * about_x) @ about_y / ((weight * about_x) @ about_x)
        error = np.abs(about_y - slope * about_x)
        scale = ROBUST * np.median(error)
        if scale == 0.0:
            break
        weight = 1.0 / np.square(1.0 + np.square(error / scale))
    return float(slope), float(weight @ (y - slope * x) / weight.sum())
