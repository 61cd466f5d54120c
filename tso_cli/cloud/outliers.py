"""Points that do not belong to the surface: outliers far from the rest, and sparse points near it.

An outlier is left out of everything. A sparse point takes part: it may be an outlier close to the
object, or belong to a part that was sampled sparsely.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..geometry.arrays import Array, Bits, Indices
from ..geometry.points import CANDIDATES, quantile, scattered, spread_subset
from ..geometry.view import View
from ..losses.nearest import nearest_few
from ..losses.projection import pixels_under

# The distance to this neighbour says how densely a cloud is sampled around a point. It is searched
# among this number of places, and its median is that of a sample of them: both bound the time.
NEIGHBOUR, PLACES, SAMPLE = 4, 4096, 512
# Lengths in sizes of the middle half of the points: of a gap that has outliers beyond it, and from
# an outlier to its fourth neighbour, which is also six medians of such distances away.
GAP, FAR, MEDIANS_OF_OUTLIERS = 1.5, 0.5, 6.0
# With a larger share of outliers the cloud is sampled too unevenly to find any.
LARGEST_SHARE_OF_OUTLIERS = 0.25
# A smaller share of the points is not a part of the object that a mask would show.
SMALLEST_PART = 0.05
# A point is sparse if its fourth neighbour is this many medians away ...
MEDIANS = 1.6
# ... in a cloud where more points than two are so far: a few are in an even sampling.
CLEARLY, FEWEST = 2.5, 3
# At most this share of the control points is sparse, or the share of the cloud. On training clouds
# with outliers less is better; with more, sparse halves of merged scans keep their control points.
LARGEST_SPARSE_SHARE = 1 / 6


def find_outliers(points: Array) -> Bits:
    """[N], which of ``points`` [N, 3] lie far from the object, one by one or in groups.

    One outlier at ten times the object's size would leave the object a tenth of every window.
    """
    outlying = _beyond_gaps(points)
    outlying[~outlying] = _single(points[~outlying])
    return outlying if outlying.mean() <= LARGEST_SHARE_OF_OUTLIERS else np.zeros(len(points), bool)


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


def _middle(points: Array) -> tuple[Array, Array, float]:
    """Least and largest coordinates [3] of the middle half of the points, and its largest size."""
    low, high = quantile(points, 0.25), quantile(points, 0.75)
    return low, high, float((high - low).max())


def _beyond_gaps(points: Array) -> Bits:
    """[N], points beyond a long gap along an axis, as seen from the middle half of the points."""
    low, high, size = _middle(points)
    outlying = np.zeros(len(points), bool)
    for beyond in (*(low - points).T, *(points - high).T) if size > 0.0 else ():
        ordered = np.sort(beyond[beyond > 0.0])
        (ends,) = np.nonzero(np.diff(ordered, prepend=0.0) > GAP * size)
        if len(ends):
            outlying |= beyond >= ordered[ends[0]]
    return outlying


def _single(points: Array) -> Bits:
    """[N], points outside of the middle half and far from all others."""
    low, high, size = _middle(points)
    (outside,) = np.nonzero((np.maximum(low - points, points - high) > FAR * size).any(1))
    places = np.unique(scattered(points, PLACES), axis=0)
    outlying = np.zeros(len(points), bool)
    if len(outside) and len(places) > NEIGHBOUR:
        median = float(quantile(_to_fourth(scattered(places, SAMPLE), places), 0.5))
        least = max(FAR * size, MEDIANS_OF_OUTLIERS * median)
        outlying[outside] = _to_fourth(points[outside], places) > least
    return outlying


def find_sparse(points: Array) -> Bits:
    """[N], which of ``points`` [N, 3] are sparse; none where the sampling is even."""
    places = np.unique(scattered(points, PLACES), axis=0)
    none = np.zeros(len(points), bool)
    if len(places) <= NEIGHBOUR:
        return none
    distance = _to_fourth(scattered(places, SAMPLE), places)
    median = float(quantile(distance, 0.5))
    if np.count_nonzero(distance > CLEARLY * median) < FEWEST:
        return none
    sparse: Bits = _to_fourth(points, places) > MEDIANS * median
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
