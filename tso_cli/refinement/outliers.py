"""Points of a cloud that belong to no surface: outliers far from all others, and loose points among them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..geometry.points import CANDIDATES, Array, longest_side, quantile
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
# A cloud has loose points if of so large a share of its points the fourth neighbour is over three medians away, and of at least
# half as many as have it over two away: where the sampling is uneven, many have it over two, few over three.
FAR, LESS_FAR, LEAST_FAR = 3.0, 2.0, 0.0075
LEAST_OF_LESS_FAR, FEWEST_FAR = 0.5, 4
# That of a loose point is over so many medians away. That of some points of a surface is too: they are carried along as well.
LOOSE_SPACINGS = 1.6
# A first look is at so many points, and their neighbours among so many; most clouds have none that is far even there.
LOOKED_AT, LOOKED_AMONG = 256, 4096
# Points that are asked whether there are loose points at all.
ASKED = 1024


def outliers(points: Array) -> Bits:
    """[N], which of ``points`` [N, 3] lie far from all others, as stray points of a scan do.

    One of them at ten times the object's size would leave the object a tenth of the window and of every scale.
    """
    size = float((quantile(points, 0.9) - quantile(points, 0.1)).max())
    if len(points) <= NEIGHBOUR or longest_side(points) <= LONGEST * size:
        return np.zeros(len(points), bool)
    # Invalid points of a scan may all lie in one place.
    places, place = np.unique(points, axis=0, return_inverse=True)
    distance = _to_fourth(places, places)
    least = max(OUTLIER_SIZE * size, OUTLIER_SPACINGS * float(quantile(distance, 0.5)))
    far: Bits = (distance > least)[place.ravel()]
    return far if far.mean() <= MOST_OUTLIERS else np.zeros(len(points), bool)


def loose_points(points: Array) -> Bits:
    """[N], which of ``points`` [N, 3] lie off the surfaces that most of them are on; none where none clearly do.

    They would hide that the rest is mirror-symmetric, and be most of an evenly spread subset. Of large clouds some points at
    equal steps say how far neighbours are.
    """
    none = np.zeros(len(points), bool)
    if len(points) <= NEIGHBOUR:
        return none
    some = _at_steps(points, LOOKED_AMONG)
    distance = _to_fourth(_at_steps(some, LOOKED_AT), some)
    if distance.max() <= FAR * quantile(distance, 0.5):
        return none
    places = np.unique(_at_steps(points, CANDIDATES), axis=0)
    distance = _to_fourth(_at_steps(places, ASKED), places)
    median = float(quantile(distance, 0.5))
    far, less_far = (np.count_nonzero(distance > times * median) for times in (FAR, LESS_FAR))
    if far < max(FEWEST_FAR, LEAST_FAR * len(distance), LEAST_OF_LESS_FAR * less_far):
        return none
    found = _to_fourth(points, places) > LOOSE_SPACINGS * median
    return found if found.mean() <= MOST_OUTLIERS else none


def _at_steps(points: Array, most: int) -> Array:
    return points[:: -(-len(points) // most)]


def _to_fourth(queries: Array, places: Array) -> Array:
    """[Q], distance from each of the ``queries`` to its fourth neighbour among ``places`` [N, 3], of which most are one."""
    fourth = nearest_few(queries, places, min(NEIGHBOUR + 1, len(places)))[:, -1]
    distance: Array = np.linalg.norm(queries - places[fourth], axis=1)
    return distance


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
