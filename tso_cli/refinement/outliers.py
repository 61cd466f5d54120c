"""Points of a cloud that belong to no surface: outliers far from all others, and loose points among them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..geometry.points import Array, longest_side, quantile
from ..losses.nearest import nearest_few

Bits = NDArray[np.bool_]

# Where a point's fourth neighbour is says how densely the cloud is sampled around it.
NEIGHBOUR = 4
# That of an outlier is farther than this part of the size of the middle four fifths of the cloud, and than so many times the
# median of all points.
OUTLIER_SIZE, OUTLIER_SPACINGS = 0.3, 6.0
# With a larger share the cloud is sampled too unevenly to tell.
MOST_OUTLIERS = 0.25
# Without outliers the whole cloud is less than so many times as long as its middle four fifths.
LONGEST = 1.6
# Loose points are looked for by some of so many points, taken at equal steps; most clouds have none that is far even among few.
PLACES, FIRST_ASKED, ASKED = 4096, 256, 1024
# A cloud may have loose points if of so large a share of its points the fourth neighbour is over three medians away.
FAR, LEAST_FAR, FEWEST_FAR = 3.0, 0.01, 4
# They are those that have it over so many medians away. Some points of a surface have too: they follow the others as well.
LOOSE_SPACINGS = 1.6
# Around points of a surface the number of neighbours grows with the square of the distance, however sparse the surface is;
# around points off it faster than with the cube, as the surface comes in reach. The power is estimated from so many neighbours.
NEIGHBOURS, LOOSE_DIMENSION = 8, 3.0


def outliers(points: Array) -> Bits:
    """[N], which of ``points`` [N, 3] lie far from all others, as stray points of a scan do.

    One of them at ten times the object's size would leave the object a tenth of the window and of every scale.
    """
    size = float((quantile(points, 0.9) - quantile(points, 0.1)).max())
    if len(points) <= NEIGHBOUR or longest_side(points) <= LONGEST * size:
        return np.zeros(len(points), bool)
    # Invalid points of a scan may all lie in one place.
    places, place = np.unique(points, axis=0, return_inverse=True)
    distance = _to_others(places, places, min(NEIGHBOUR, len(places) - 1))[:, -1]
    least = max(OUTLIER_SIZE * size, OUTLIER_SPACINGS * float(quantile(distance, 0.5)))
    far: Bits = (distance > least)[place.ravel()]
    return far if far.mean() <= MOST_OUTLIERS else np.zeros(len(points), bool)


def loose_points(points: Array) -> Bits:
    """[N], which of ``points`` [N, 3] lie off the surfaces that most of them are on; none where none clearly do.

    They would hide that the rest is mirror-symmetric, and be most of an evenly spread subset.
    """
    none = np.zeros(len(points), bool)
    places = np.unique(_at_steps(points, PLACES), axis=0)
    if len(places) <= NEIGHBOURS:
        return none
    for asked, count in ((FIRST_ASKED, NEIGHBOUR), (ASKED, NEIGHBOURS)):
        distance = _to_others(_at_steps(places, asked), places, count)
        fourth = distance[:, NEIGHBOUR - 1]
        median = float(quantile(fourth, 0.5))
        if fourth.max() <= FAR * median:
            return none
    if np.count_nonzero(fourth > FAR * median) < max(FEWEST_FAR, LEAST_FAR * len(fourth)):
        return none
    if _dimension(distance[fourth > LOOSE_SPACINGS * median]) < LOOSE_DIMENSION:
        return none
    found = _to_others(points, places, NEIGHBOUR)[:, -1] > LOOSE_SPACINGS * median
    return found if found.mean() <= MOST_OUTLIERS else none


def _at_steps(points: Array, most: int) -> Array:
    return points if len(points) <= most else points[np.arange(most) * len(points) // most]


def _to_others(queries: Array, places: Array, count: int) -> Array:
    """[Q, count], distances from each of the ``queries`` to its nearest ``places`` [N, 3], N over ``count``, but itself."""
    near = nearest_few(queries, places, count + 1)
    # A column at a time bounds memory: a large scan has millions of queries.
    distance = np.stack([np.linalg.norm(queries - places[column], axis=1) for column in near.T], axis=1)
    return np.where(distance[:, :1] == 0.0, distance[:, 1:], distance[:, :-1])


def _dimension(distance: Array) -> float:
    """Intrinsic dimension around points whose neighbours are at ``distance`` [Q, K], increasing (Levina and Bickel, 2004)."""
    with np.errstate(divide="ignore"):
        return float(1.0 / np.log(distance[:, -1:] / distance[:, :-1]).mean())


def outlier_warnings(outliers: Bits, loose: Bits) -> list[str]:
    """What is said of a cloud's outliers and loose points [N]; empty without any."""
    return [
        f"{_lie(count)} {said}, and out of all measures"
        for count, said in (
            (int(outliers.sum()), "far from all others: left where found"),
            (int(loose.sum()), "off the surfaces of the others: only carried along"),
        )
        if count
    ]


def _lie(count: int) -> str:
    return "1 point lies" if count == 1 else f"{count:,} points lie"
