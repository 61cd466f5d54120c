"""Points that lie apart: strays close to the object, or a sparsely sampled part of it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..geometry.points import CANDIDATES, Array, quantile, scattered
from ..losses.nearest import Indices, nearest_few, spread_subset

# How far a point's fourth neighbour is says how densely the cloud is sampled around it.
NEIGHBOUR = 4
# It is over so many medians away of points that lie apart, ...
APART = 1.6
# ... if it is over so many medians away of at least so large a share, and so many points: few are so far on an even sampling.
FAR, LEAST_FAR, FEWEST_FAR = 2.5, 0.003, 3
# Points among which neighbours are searched, and of which so many say whether any lie apart; most clouds end the first look.
PLACES, FIRST_ASKED, ASKED = 4096, 256, 1024
# Of a subset that is spread evenly at most this share lies apart, or as much as of the cloud. Of training clouds with strays
# less is better; with more, sparse halves of merged scans keep the samples that an even spread gives them.
MOST_APART = 1 / 6


def lying_apart(points: Array) -> NDArray[np.bool_]:
    """[N], which of ``points`` [N, 3] lie clearly farther from their neighbours than most; none where the sampling is even.

    Nothing is left out of a refinement for that: strays and a sparse part of a surface are hard to tell from each other.
    Seconds for millions of points, of which some say as much.
    """
    none = np.zeros(len(points), bool)
    places = np.unique(scattered(points, PLACES), axis=0)
    if len(places) <= NEIGHBOUR:
        return none
    for count in (FIRST_ASKED, ASKED):
        distance = to_fourth(scattered(places, count), places)
        least = FAR * float(quantile(distance, 0.5))
        if distance.max() <= least:
            return none
    if np.count_nonzero(distance > least) < max(FEWEST_FAR, LEAST_FAR * len(distance)):
        return none
    apart: NDArray[np.bool_] = to_fourth(points, places) > APART / FAR * least
    return apart


def spread_on_surfaces(points: Array, count: int) -> Indices:
    """Indices of ``count`` evenly spread points [N, 3], of which few lie apart: an even spread takes strays first."""
    candidates = scattered(np.arange(len(points)), CANDIDATES)
    apart = lying_apart(points[candidates])
    near, far = candidates[~apart], candidates[apart]
    strays = min(len(far), int(max(MOST_APART, len(far) / len(candidates)) * count))
    parts = ((near, count - strays), (far, strays)) if strays else ((near, count),)
    return np.concatenate([part[spread_subset(points[part], most)] for part, most in parts])


def to_fourth(queries: Array, places: Array) -> Array:
    """[Q], distance from each of the ``queries`` to its fourth neighbour among ``places`` [N, 3], itself not counted.

    To the last of them where there are not so many, but at least two; no two places are the same.
    """
    near = nearest_few(queries, places, min(NEIGHBOUR + 1, len(places)))
    distance = [np.linalg.norm(queries - places[column], axis=1) for column in near.T]
    among = np.logical_or.reduce([to_place == 0.0 for to_place in distance])
    return np.where(among, distance[-1], distance[-2])
