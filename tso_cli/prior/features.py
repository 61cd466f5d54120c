"""What the prior's network is given: a cloud and a mask in the axes of a view.

In the axes of a view x points right, y down and z away from the camera, and the middle of the cloud
is on the optical axis at z = 0; the cloud's longest side is 1. A point y is seen at
w = (y_x, y_y) / (1 + u y_z). The closeness u is 1 over the distance of the camera, and 0 where the
camera is orthographic. So a cloud and a camera that are turned together look the same.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .backend import Backend

# Maps show the square [-HALF, HALF]^2 of w in GRID x GRID cells.
GRID, HALF = 40, 0.75
CELL = 2.0 * HALF / GRID
# Points that make the maps, and how many of them, the first, are given a displacement. The other
# points of a cloud follow.
DENSE, NODES = 512, 128
# Nodes that a point is interpolated from; the furthest has hardly a weight.
INTERPOLATED_FROM = 5
# The box of a cloud leaves out this share of the points on each side: single points far from the
# rest do not belong to the object.
LEFT_OUT = 1 / 500
# Control points along a side of the lattice.
LATTICE = 4
# Distances to the mask are known up to this.
FAR = 0.3
# A mask's pixel pulls a point that is further away than this.
COVERED = 0.02
# The cells of the foreground are counted as if there were this many.
CELLS = 256.0
# A point behind the camera, or nearer to its plane than this share of the cloud's distance, is seen
# as one that is so near: beyond the maps, unless it is on the axis.
NEAREST = 1e-3
# Where a cell has no point.
NO_DEPTH = -9.0
# Numbers of a view, of a node, and of the lattice: the sizes of the network's input.
MAPS, OF_NODE, OF_LATTICE = 11, 24, 8
OF_VIEW = 12 + OF_LATTICE * LATTICE**3
# Depths that are further from the cloud's front than this are as far.
FAR_DEPTH = 0.3
EVERY = 2  # every second cell of a depth map pulls
# The size of an object in pixels that counts as 0.
USUAL_SIZE = 64.0


@dataclass(frozen=True, eq=False)
class Sight:
    """What B views show, in the axes of each.

    closeness : [B], u.
    distance, known : [B, GRID, GRID] signed distance to the mask, positive outside, and 1 where the
        picture is, 0 beyond its border.
    cells, counted : [B, K, 2] places w in the foreground, and [B, K] 1 for those that count.
    depth, measured : [B, GRID, GRID] z of the visible surface, and 1 where a depth map has it.
    metric : [B], 1 for a depth map of the cloud's unit, 0 for one that was fitted to the cloud, or
        without a map.
    size : [B], the longest side of the cloud in pixels of the mask.
    """

    closeness: Any
    distance: Any
    known: Any
    cells: Any
    counted: Any
    depth: Any
    measured: Any
    metric: Any
    size: Any


@dataclass(frozen=True, eq=False)
class Features:
    """Of B views.

    maps : [B, MAPS, GRID, GRID]. nodes : [B, N, OF_NODE]. view : [B, OF_VIEW].
    places : [B, N, 2], where the nodes are seen, in [-1, 1] within the maps.
    basis : [B, N, 64], weights of the lattice's control points at the nodes.
    """

    maps: Any
    nodes: Any
    view: Any
    places: Any
    basis: Any


def features(backend: Backend, points: Any, nodes: int, sight: Sight) -> Features:
    """The features of clouds and of what is seen of them, for numpy or torch.

    ``points`` [B, M, 3] are in the axes of the view; the first ``nodes`` of them are nodes.
    """
    xp = backend.xp
    distance, known, cells, counted = sight.distance, sight.known, sight.cells, sight.counted
    w = seen_at(points, sight.closeness)
    shown = _maps(backend, points, w, distance, known)
    low, high = xp.amin(points, 1), xp.amax(points, 1)
    extent, middle = high - low, (high + low) / 2.0

    y, seen = points[:, :nodes], w[:, :nodes]
    compared = xp.stack([distance, shown.mismatch, shown.rough], axis=1)
    here = backend.sampled(compared, seen / HALF)
    slope = _slope(backend, distance, seen)
    owner = backend.nearest(points, points[:, :nodes])
    mean, length, count, share = _pull(backend, w, owner, nodes, cells, counted)
    within = (y - middle[:, None]) / (extent[:, None] / 2.0 + 1e-3)
    ahead = sight.measured * shown.closed * (sight.depth - shown.front)
    surface = xp.stack([sight.depth * sight.measured, sight.measured], axis=1)
    surface = backend.sampled(surface, seen / HALF)
    measured = surface[..., 1:]
    behind = surface[..., :1] / measured.clip(0.25, np.inf) - y[..., 2:]
    behind = behind.clip(-FAR_DEPTH, FAR_DEPTH) * measured
    cell, _ = _cells(xp, seen)
    front = backend.rows(shown.front.reshape(len(points), -1, 1), backend.whole(cell))
    front = (y[..., 2:] - front).clip(-FAR_DEPTH, FAR_DEPTH)
    of_nodes = [y * 2.0, within, here * 5.0, slope, mean, length, count, share]
    of_nodes += [behind * 5.0, measured, front * 5.0]
    of_nodes.append(_pull_of_surface(backend, points, owner, nodes, sight))

    basis = bernstein(backend, ((within + 1.0) / 2.0).clip(-0.2, 1.2))
    beyond = here[..., :1].clip(0.0, 0.2)
    weight, one = count.clip(0.0, 1.5), xp.ones_like(beyond)
    pulls = [mean * weight, length * weight, count]
    pulls += [-12.0 * beyond * slope, _indicator(xp, beyond > 0.0, beyond), one]
    pooled = xp.swapaxes(basis, 1, 2) @ xp.concatenate(pulls, axis=-1) * (NODES / nodes)
    weighed = pooled[..., :-1] / (pooled[..., -1:] + 0.7)
    pooled = xp.concatenate([weighed, xp.log1p(pooled[..., -1:].clip(0.0, np.inf))], axis=-1)

    uncovered = (shown.mismatch.clip(0.0, 1.0) * shown.inside).mean((1, 2))
    outside = _indicator(xp, shown.mismatch < -0.5, known).mean((1, 2))
    numbers = [uncovered * 20.0, outside * 20.0, sight.closeness * 5.0 - 2.0]
    numbers += [xp.log(sight.size / USUAL_SIZE), sight.metric, sight.measured.mean((1, 2)) * 4.0]
    numbers = xp.stack(numbers, axis=1)
    of_view = [extent * 2.0, middle * 4.0, numbers, pooled.reshape(len(points), -1)]
    maps = [distance.clip(-FAR, FAR) * 5.0, shown.rough * 5.0, shown.inside, shown.closed]
    maps += [shown.mismatch, known, shown.front * 2.0, shown.back * 2.0]
    maps += [sight.depth * sight.measured * 2.0, ahead.clip(-FAR_DEPTH, FAR_DEPTH) * 5.0]
    maps += [sight.measured]
    return Features(
        xp.stack(maps, axis=1),
        xp.concatenate(of_nodes, axis=-1),
        xp.concatenate(of_view, axis=-1),
        seen / HALF,
        basis,
    )


def seen_at(points: Any, closeness: Any) -> Any:
    """[B, M, 2], the places w at which ``points`` [B, M, 3] in the axes of a view are seen."""
    depth = 1.0 + closeness[:, None, None] * points[..., 2:]
    return points[..., :2] / depth.clip(NEAREST, np.inf)


def front_of(backend: Backend, points: Any, closeness: Any) -> tuple[Any, Any]:
    """The nearest depth of ``points`` [B, M, 3] in each cell, and 1 where they cover the cell."""
    front, _, closed = _depths(backend, points, seen_at(points, closeness))
    return front, closed


def bernstein(backend: Backend, t: Any) -> Any:
    """[B, N, 64]: the cubic Bernstein polynomials at ``t`` [B, N, 3] in a box [0, 1]^3."""
    xp, s = backend.xp, 1.0 - t
    cubic = xp.stack([s**3, 3.0 * t * s**2, 3.0 * t**2 * s, t**3], axis=-1)  # [B, N, 3, 4]
    x, y, z = cubic[:, :, 0], cubic[:, :, 1], cubic[:, :, 2]
    product = x[..., :, None, None] * y[..., None, :, None] * z[..., None, None, :]
    return product.reshape(*t.shape[:2], LATTICE**3)


@dataclass(frozen=True, eq=False)
class _Maps:
    """Maps [B, GRID, GRID] of what a view shows.

    inside : the mask. closed : the cells that the cloud occupies, with gaps closed.
    mismatch : their difference. rough : signed distance to ``closed``. front, back : the nearest
        and the farthest depth of the cloud.
    """

    inside: Any
    closed: Any
    mismatch: Any
    rough: Any
    front: Any
    back: Any


def _maps(backend: Backend, points: Any, w: Any, distance: Any, known: Any) -> _Maps:
    xp = backend.xp
    front, back, closed = _depths(backend, points, w)
    inside = 1.0 / (1.0 + xp.exp((distance / (0.35 * CELL)).clip(-40.0, 40.0)))
    mismatch = (inside - closed) * known
    return _Maps(inside, closed, mismatch, _rough_distance(backend, closed), front, back)


def _cells(xp: Any, w: Any) -> tuple[Any, Any]:
    """The number of the cell at ``w`` [B, N, 2], or of the nearest one; and whether it is there."""
    cell = xp.floor((w + HALF) / CELL)
    within = ((cell >= 0) & (cell < GRID)).all(-1)
    nearest = cell.clip(0, GRID - 1)
    return nearest[..., 1] * GRID + nearest[..., 0], within


def _depths(backend: Backend, points: Any, w: Any) -> tuple[Any, Any, Any]:
    """[B, GRID, GRID] each: nearest and farthest depth, and 1 in the cells that points cover."""
    xp = backend.xp
    index, within = _cells(xp, w)
    # What is seen beyond the maps falls into a cell of its own.
    index = backend.whole(xp.where(within, index, xp.full_like(index, GRID * GRID)))

    def most(depth: Any) -> Any:
        """The largest depth in a cell and its neighbours, so that gaps have a depth too."""
        largest = backend.largest(index, depth, GRID * GRID + 1, NO_DEPTH)[:, :-1]
        return backend.dilated(largest.reshape(len(points), 1, GRID, GRID))

    back, front = most(points[..., 2]), -most(-points[..., 2])
    closed = -backend.dilated(-_indicator(xp, back > NO_DEPTH, back))
    front, back = (xp.where(closed > 0.0, depth, 0.0 * depth)[:, 0] for depth in (front, back))
    return front, back, closed[:, 0]


def _rough_distance(backend: Backend, closed: Any) -> Any:
    """[B, GRID, GRID] signed distance to ``closed`` cells, by dilation at half the size."""
    xp, half = backend.xp, GRID // 2
    halved = closed.reshape(len(closed), 1, half, 2, half, 2).mean((3, 5))
    inside = _indicator(xp, halved > 0.3, halved)
    outside, steps = 1.0 - inside, 0.0 * inside
    for _ in range(round(FAR / (2.0 * CELL))):
        steps = steps + (1.0 - inside) - (1.0 - outside)
        inside, outside = backend.dilated(inside), backend.dilated(outside)
    return doubled(xp, steps * (2.0 * CELL))[:, 0]


def doubled(xp: Any, maps: Any) -> Any:
    """``maps`` [B, C, H, W] with twice as many cells each way."""
    batch, channels, height, width = maps.shape
    four = xp.stack([xp.stack([maps, maps], axis=-1)] * 2, axis=3)
    return four.reshape(batch, channels, 2 * height, 2 * width)


def _slope(backend: Backend, distance: Any, places: Any) -> Any:
    """[B, N, 2]: the gradient of the ``distance`` [B, GRID, GRID] at ``places`` w."""
    xp = backend.xp
    differences = []
    for step in ((CELL, 0.0), (0.0, CELL)):
        shift = backend.constant(np.array(step), places)
        ahead, behind = (
            backend.sampled(distance[:, None], (places + sign * shift) / HALF)
            for sign in (1.0, -1.0)
        )
        differences.append((ahead - behind) / (2.0 * CELL))
    return xp.concatenate(differences, axis=-1)


def _pull(
    backend: Backend, w: Any, owner: Any, nodes: int, cells: Any, counted: Any
) -> tuple[Any, Any, Any, Any]:
    """How the foreground pulls the points that each node owns.

    Each cell pulls the point that is seen nearest to it, and a point belongs to its nearest node.

    Returns
    -------
    For each node [B, N, .]: the mean pull (2), its mean length (1), the logarithm of how many cells
    pull (1), and the share of all cells that pull (1).
    """
    xp = backend.xp
    point = backend.nearest(cells, w)
    offset = cells - backend.rows(w, point)
    length = xp.sqrt((offset**2).sum(-1, keepdims=True) + 1e-12)
    weight = counted[..., None] * (length - COVERED).clip(0.0, np.inf) / length
    number = counted.sum(1)[:, None, None] + 1.0
    pulls = xp.concatenate([offset, length], axis=-1)
    node = backend.rows(owner[..., None], point)[..., 0]
    mean, count = _of_nodes(backend, pulls, weight, node, nodes, CELLS / number)
    share = 3.0 * weight.sum(1, keepdims=True) / number
    return mean[..., :2], mean[..., 2:], count, share + 0.0 * count


def _pull_of_surface(backend: Backend, points: Any, owner: Any, nodes: int, sight: Sight) -> Any:
    """[B, N, 5]: how the surface that a depth map shows pulls the points that each node owns.

    As `_pull`, in space: every second cell of the map pulls the point that is nearest to it.
    """
    xp, every = backend.xp, GRID // EVERY
    if not sight.measured.any():
        return 0.0 * points[:, :nodes, :1] + backend.constant(np.zeros(5), points)
    depth, measured = (
        maps[:, ::EVERY, ::EVERY].reshape(len(points), every * every, 1)
        for maps in (sight.depth, sight.measured)
    )
    centres = (np.arange(0, GRID, EVERY) + 0.5) * CELL - HALF
    across, down = np.meshgrid(centres, centres)
    w = backend.constant(np.stack([across, down], -1).reshape(1, -1, 2), depth)
    ahead = 1.0 + sight.closeness[:, None, None] * depth
    surface = xp.concatenate([w * ahead, depth], axis=-1)
    point = backend.nearest(surface, points)
    offset = surface - backend.rows(points, point)
    length = xp.sqrt((offset**2).sum(-1, keepdims=True) + 1e-12)
    weight = measured * (FAR_DEPTH / length).clip(0.0, 1.0)
    pulls = xp.concatenate([offset, length], axis=-1)
    node = backend.rows(owner[..., None], point)[..., 0]
    return xp.concatenate(_of_nodes(backend, pulls, weight, node, nodes, 1.0), axis=-1)


def _of_nodes(
    backend: Backend, pulls: Any, weight: Any, node: Any, nodes: int, scale: Any
) -> tuple[Any, Any]:
    """The mean [B, N, D] of the ``pulls`` [B, K, D] at each node, and how many pull [B, N, 1].

    ``node`` [B, K] is that of each pull. ``scale`` multiplies the weights [B, K, 1]. Where little
    pulls, the mean is small. The number is a logarithm.
    """
    xp = backend.xp
    weighed = xp.concatenate([pulls * weight, weight], axis=-1)
    summed = backend.sums(node, weighed, nodes) * scale
    total = summed[..., -1:]
    return 12.0 * summed[..., :-1] / (total + 0.3), xp.log1p(0.5 * total)


def _indicator(xp: Any, condition: Any, like: Any) -> Any:
    """1 where a condition holds, else 0, of the type of ``like``."""
    return xp.where(condition, xp.ones_like(like), xp.zeros_like(like))
