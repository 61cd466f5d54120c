"""Polygons of a mesh as triangles."""

from __future__ import annotations

import numpy as np

from .arrays import Array, Indices

# A polygon with more corners remains a fan, even where that is wrong: to cut off one ear after the
# other takes a time that grows with their square, or more.
MOST_CORNERS = 500


def triangulated(points: Array, corners: Indices, lengths: Indices) -> Indices:
    """Places [T, 3] in ``corners``: the triangles of polygons, in the polygons' order.

    ``corners`` are the polygons one after another, ``lengths`` [P] corners each, as indices of
    ``points`` [N, 3]. A polygon becomes a fan around its first corner. Where this fan would leave
    the polygon, its ears are cut off one by one (Meisters, "Polygons have ears", 1975).
    """
    firsts, counts = np.cumsum(lengths) - lengths, np.maximum(lengths - 2, 0)
    ends = np.cumsum(counts)
    polygon = np.repeat(np.arange(len(lengths)), counts)
    k = np.arange(len(polygon)) - (ends - counts)[polygon]
    places: Indices = firsts[polygon][:, None] + np.stack([np.zeros_like(k), k + 1, k + 2], 1)
    several = counts[polygon] > 1
    polygon, fans = polygon[several], corners[places[several]]
    with np.errstate(over="ignore", invalid="ignore"):
        origin, second, third = points[fans].transpose(1, 0, 2)
        normals = np.cross(second - origin, third - origin)
        whole = np.zeros((len(lengths), 3))
        np.add.at(whole, polygon, normals)  # twice the vector area
        along = (normals * whole[polygon]).sum(1)
        concave = np.unique(polygon[along < -1e-9 * np.square(whole[polygon]).sum(1)])
    for number in concave[lengths[concave] <= MOST_CORNERS].tolist():
        of_polygon = slice(firsts[number], firsts[number] + lengths[number])
        rows = slice(ends[number] - counts[number], ends[number])
        places[rows] = firsts[number] + _ears(points[corners[of_polygon]], whole[number])
    return places


def _ears(points: Array, normal: Array) -> Indices:
    """Triangles [K - 2, 3] of one polygon [K, 3] with this ``normal``."""
    # Seen along the axis that the normal is nearest to, so that the polygon goes round to the left.
    axis = int(np.abs(normal).argmax())
    x, y = points[:, (axis + 1) % 3] * np.sign(normal[axis]), points[:, (axis + 2) % 3]

    def left_of(a: int, b: int, c: Indices | int) -> Array:
        """Twice the area of the triangles a, b, c: above 0 if c is to the left of a to b."""
        area: Array = (x[b] - x[a]) * (y[c] - y[a]) - (y[b] - y[a]) * (x[c] - x[a])
        return area

    rest, triangles = list(range(len(points))), []
    while len(rest) > 3:
        others = np.array(rest)
        for place, corner in enumerate(rest):
            before, after = rest[place - 1], rest[(place + 1) % len(rest)]
            if left_of(before, corner, after) <= 0.0:
                continue
            # The corners of the triangle lie on its sides, not inside.
            sides = ((before, corner), (corner, after), (after, before))
            if not np.all([left_of(*side, others) > 0.0 for side in sides], axis=0).any():
                break
        else:  # of a polygon that crosses itself
            before, corner, after = rest[:3]
        triangles.append((before, corner, after))
        rest.remove(corner)
    return np.array([*triangles, rest])
