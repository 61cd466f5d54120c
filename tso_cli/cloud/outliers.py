"""Points that do not belong to the surface: outliers far from the rest, and sparse points near it.

Both are found by the distance to the fourth neighbour, which says how densely a cloud is sampled
around a point. An outlier is left out of everything. A sparse point takes part: it may be an
outlier close to the object, or belong to a part that was sampled sparsely.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..geometry.arrays import Array, Bits, Indices
from ..geometry.points import (
    CANDIDATES,
    bounds,
    longest_side,
    quantile,
    scattered,
    spread_subset,
)
from ..geometry.view import View
from ..losses.nearest import nearest_few
from ..losses.projection import pixels_under

NEIGHBOUR = 4

# With a larger share of outliers the cloud is sampled too unevenly to find any.
LARGEST_SHARE_OF_OUTLIERS = 0.25

# A smaller share of the points is not a part of the object that a mask would show.
SMALLEST_PART = 0.05
# At most this share of the control points is sparse, or the share of the cloud. On training clouds
# with outliers less is better; with more, sparse halves of merged scans keep their control points.
LARGEST_SPARSE_SHARE = 1 / 6


class DistantPoint:
    """A point is an outlier if its fourth neighbour is far away by two measures at once."""

    SIZES = 0.3  # farther than this part of the size of the cloud's middle four fifths
    MEDIANS = 6.0  # farther than this multiple of the median of all distances
    # Least length of a cloud with such points, in sizes of its middle four fifths.
    SHORTEST_CLOUD = 1.6


class DistantGroup:
    """A group of points is an outlier if all of it lies far outside the largest group's box.

    Points form one group while gaps are short: under 1.5 sizes of the cloud's middle half (up to
    2.3 sizes, since points are grouped by cubes).
    """

    GAP = 1.5  # in sizes of the middle half
    CUBES_IN_A_GAP = 4
    OUTSIDE = 0.5  # distance to the largest group's box, in sizes of that box
    # Least length of a cloud with such groups, in sizes of its middle half.
    SHORTEST_CLOUD = 3.5
    FEWEST_POINTS = 64  # fewer points have gaps of their own
    MOST_CUBES = 2048  # with more cubes the cloud is no object with outliers
    FARTHEST_CUBE = 1 << 20  # cubes farther from the middle, either way, count as one


class SparsePoint:
    """A point is sparse if its fourth neighbour is far away, in medians of all such distances."""

    MEDIANS = 1.6
    # The cloud has sparse points if at least a share and a number of points are clearly sparse,
    # since some are in an even sampling.
    CLEARLY = 2.5  # medians
    SMALLEST_SHARE = 0.003
    FEWEST = 3
    # Neighbours are searched among this number of places. Two samples of the places, the first
    # smaller, are searched for sparse points; most clouds have none in the first.
    PLACES = 4096
    SAMPLES = (256, 1024)


def find_outliers(points: Array) -> Bits:
    """[N], which of ``points`` [N, 3] lie far from the object, one by one or in groups.

    One outlier at ten times the object's size would leave the object a tenth of every window.
    """
    found = _distant_groups(points)
    found[~found] = _distant_points(points[~found])
    return found if found.mean() <= LARGEST_SHARE_OF_OUTLIERS else np.zeros(len(points), bool)


def are_part_of_object(points: Array, count: int, views: Sequence[View]) -> bool:
    """Whether ``points`` [M, 3], outliers of a cloud of ``count`` points, are a part of the object.

    They are if they are many and half of them fall on the mask in every view. An example is the
    shade of a lamp whose pole is missing from the cloud.
    """
    return len(points) >= SMALLEST_PART * count and all(
        2 * _on_mask(points, view) >= len(points) for view in views
    )


def _on_mask(points: Array, view: View) -> int:
    pixels, _, visible = view.camera.project_visible(points)
    pixel, inside = pixels_under(pixels, visible, *view.mask.shape)
    return int(np.count_nonzero(inside & (view.mask.ravel()[pixel] > 0.5)))


def _distant_groups(points: Array) -> Bits:
    """[N], points of groups far from the largest group; none if they are many."""
    none = np.zeros(len(points), bool)
    size = float((quantile(points, 0.75) - quantile(points, 0.25)).max())
    compact = longest_side(points) <= DistantGroup.SHORTEST_CLOUD * size
    if len(points) < DistantGroup.FEWEST_POINTS or compact or size == 0.0:
        return none
    edge = DistantGroup.GAP / DistantGroup.CUBES_IN_A_GAP * size
    cubes = np.floor((points - quantile(points, 0.5)) / edge)
    cubes = cubes.clip(-DistantGroup.FARTHEST_CUBE, DistantGroup.FARTHEST_CUBE - 1).astype(np.int64)
    # One number for each cube, which sorts faster than three.
    numbers = (cubes + DistantGroup.FARTHEST_CUBE) @ [
        4 * DistantGroup.FARTHEST_CUBE**2,
        2 * DistantGroup.FARTHEST_CUBE,
        1,
    ]
    _, first, cube, counts = np.unique(
        numbers, return_index=True, return_inverse=True, return_counts=True
    )
    if len(first) > DistantGroup.MOST_CUBES:
        return none
    group = _connected(cubes[first])
    of_points = group[cube.ravel()]
    low, high = bounds(points[of_points == np.bincount(group, counts).argmax()])
    distance = np.maximum(low - points, points - high).max(1)
    outside = distance > DistantGroup.OUTSIDE * (high - low).max()
    # A group counts as distant if none of its points is near.
    distant: Bits = (np.bincount(of_points, ~outside) == 0)[of_points]
    return distant if distant.mean() <= LARGEST_SHARE_OF_OUTLIERS else none


def _connected(cubes: Indices) -> Indices:
    """[C], the same number for ``cubes`` [C, 3] that a chain of near cubes connects.

    scipy has this too, but takes longer to import than this takes to run.
    """
    near = np.logical_and.reduce(
        [
            np.abs(np.subtract.outer(axis, axis)) <= DistantGroup.CUBES_IN_A_GAP + 1
            for axis in cubes.T
        ]
    )
    group = np.arange(len(cubes))
    while (least := np.where(near, group, len(cubes)).min(1)).tolist() != group.tolist():
        group = least[least]
    return group


def _distant_points(points: Array) -> Bits:
    """[N], points far from all others; none if they are many."""
    none = np.zeros(len(points), bool)
    size = float((quantile(points, 0.9) - quantile(points, 0.1)).max())
    if len(points) <= NEIGHBOUR or longest_side(points) <= DistantPoint.SHORTEST_CLOUD * size:
        return none
    # Invalid points of a scan may all lie in one place.
    places, place = np.unique(points, axis=0, return_inverse=True)
    distance = _to_fourth(places, places)
    least = max(DistantPoint.SIZES * size, DistantPoint.MEDIANS * float(quantile(distance, 0.5)))
    distant: Bits = (distance > least)[place.ravel()]
    return distant if distant.mean() <= LARGEST_SHARE_OF_OUTLIERS else none


def find_sparse(points: Array) -> Bits:
    """[N], which of ``points`` [N, 3] are sparse; none where the sampling is even.

    This takes seconds for millions of points; pass a subset of them.
    """
    none = np.zeros(len(points), bool)
    places = np.unique(scattered(points, SparsePoint.PLACES), axis=0)
    if len(places) <= NEIGHBOUR:
        return none
    for count in SparsePoint.SAMPLES:
        distance = _to_fourth(scattered(places, count), places)
        least = SparsePoint.CLEARLY * float(quantile(distance, 0.5))
        if distance.max() <= least:
            return none
    fewest = max(SparsePoint.FEWEST, SparsePoint.SMALLEST_SHARE * len(distance))
    if np.count_nonzero(distance > least) < fewest:
        return none
    least *= SparsePoint.MEDIANS / SparsePoint.CLEARLY
    sparse: Bits = _to_fourth(points, places) > least
    return sparse


def spread_over_surfaces(points: Array, count: int) -> Indices:
    """Indices of ``count`` evenly spread points [N, 3]. Few of them are sparse.

    Farthest-point sampling alone would choose sparse points first.
    """
    candidates = scattered(np.arange(len(points)), CANDIDATES)
    sparse = find_sparse(points[candidates])
    dense, thin = candidates[~sparse], candidates[sparse]
    share = max(LARGEST_SPARSE_SHARE, len(thin) / len(candidates))
    most = min(len(thin), int(share * count))
    parts = ((dense, count - most), (thin, most)) if most else ((dense, count),)
    return np.concatenate([part[spread_subset(points[part], of)] for part, of in parts])


def _to_fourth(queries: Array, places: Array) -> Array:
    """[Q], distance from each of the ``queries`` to its fourth neighbour in ``places`` [N, 3].

    A query that is one of the places is not its own neighbour. Among fewer than five places the
    last one counts. There are at least two places, and no two are the same.
    """
    near = nearest_few(queries, places, min(NEIGHBOUR + 1, len(places)))
    distance = [np.linalg.norm(queries - places[column], axis=1) for column in near.T]
    among = np.logical_or.reduce([to_place == 0.0 for to_place in distance])
    return np.where(among, distance[-1], distance[-2])
