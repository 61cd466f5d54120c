"""Measures and samples of points and surfaces that need numpy alone."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from .camera import Array

Number = TypeVar("Number", bound=np.generic)

# Points among which farthest-point sampling chooses about a thousand.
CANDIDATES = 16_384
# Its multiples, without their whole parts, fill the unit interval evenly.
GOLDEN = (5.0**0.5 - 1.0) / 2.0


def as_points(points: ArrayLike, name: str = "cloud") -> Array:
    """``points`` as a float64 array [N, 3] with N >= 1 and finite coordinates; InputError naming ``name`` otherwise."""
    array = np.asarray(points, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(f"{name}: shape is {list(array.shape)}, expected points [N, 3]")
    if len(array) == 0:
        raise InputError(f"{name}: holds no points, expected at least one")
    finite = np.isfinite(array).all(1)
    if not finite.all():
        raise InputError(f"{name}: point {int(np.argmin(finite))} has a NaN or infinite coordinate")
    return array


def quantile(values: Array, share: float) -> Array:
    """As `numpy.quantile` by the first axis of ``values`` [N, ...]; that imports masked arrays, a tenth of a small command."""
    place = share * (len(values) - 1)
    low, high = int(place), min(int(place) + 1, len(values) - 1)
    ordered = np.partition(values, (low, high), axis=0)
    between: Array = ordered[low] + (place - low) * (ordered[high] - ordered[low])
    return between


def scattered(points: NDArray[Number], most: int) -> NDArray[Number]:
    """At most so many of ``points`` [N, ...], in their order. Equal steps may take one column of an organised cloud."""
    if len(points) <= most:
        return points
    # Some of these places may be the same.
    return points[np.unique((len(points) * (np.arange(most) * GOLDEN % 1.0)).astype(np.int64))]


def farthest_point_sample(points: ArrayLike, count: int) -> NDArray[np.int64]:
    """Indices [count] of a subset spread out greedily, in the order of choice: the first k are the sample of size k.

    The first index is 0; each new point is the one farthest from all chosen so far, among equals the first. Points [N, 3] may
    coincide; no index is chosen twice. O(N count) time. Raises InputError where ``count`` is out of range.
    """
    array = as_points(points)
    total = len(array)
    if not 1 <= count <= total:
        raise InputError(f"asked for {count} of {total} points, expected 1 to {total}")
    # Contiguous columns, and no allocation inside the loop over all points.
    x, y, z = (np.ascontiguousarray(column) for column in array.T)
    squared, step = np.empty(total), np.empty(total)
    nearest = np.full(total, np.inf)  # squared distance to the chosen set
    chosen = np.empty(count, dtype=np.int64)
    index = 0
    for i in range(count):
        chosen[i] = index
        np.subtract(x, x[index], out=squared)
        np.multiply(squared, squared, out=squared)
        for column in (y, z):
            np.subtract(column, column[index], out=step)
            np.multiply(step, step, out=step)
            np.add(squared, step, out=squared)
        np.minimum(nearest, squared, out=nearest)
        # Below every distance: where points coincide, no index is chosen again.
        nearest[index] = -1.0
        index = int(nearest.argmax())
    return chosen


def spread_subset(
    points: ArrayLike,
    count: int,
    sample: Callable[[Array, int], NDArray[np.int64]] = farthest_point_sample,
) -> NDArray[np.int64]:
    """Indices of at most ``count`` evenly spread points [N, 3]; of a large cloud, chosen among some of them.

    ``sample`` is another form of `farthest_point_sample`.
    """
    array = as_points(points)
    indices = np.arange(len(array))
    if len(array) <= count:
        return indices
    candidates = scattered(indices, CANDIDATES)
    return candidates[sample(array[candidates], min(count, len(candidates)))]


def bounds(points: Array) -> tuple[Array, Array]:
    """[D] least and largest coordinates of points [N, D]; axis by axis, which is a tenth of the time."""
    axes = np.ascontiguousarray(points.T)
    return axes.min(1), axes.max(1)


def longest_side(points: Array) -> float:
    """Of the bounding box of points [N, D]."""
    low, high = bounds(points)
    return float((high - low).max())


def bounding_box_normalisation(points: ArrayLike, name: str = "cloud") -> tuple[Array, float]:
    """Centre [3] and longest side of a cloud's bounding box: ``(points - centre) / scale`` is centred, of longest side 1.

    Raises InputError naming ``name`` where all points are equal, or the box has no finite size.
    """
    array = as_points(points, name)
    low, high = bounds(array)
    with np.errstate(over="ignore"):
        scale = float((high - low).max())
    if scale == 0.0:
        problem = (
            "holds a single point" if len(array) == 1 else f"all {len(array)} points are equal"
        )
        raise InputError(f"{name}: {problem}, expected a cloud of some extent")
    if not np.isfinite(scale):
        raise InputError(
            f"{name}: coordinates reach {np.abs(array).max():.3g}, too large to measure"
        )
    return low / 2.0 + high / 2.0, scale


def normalise_longest_side(points: ArrayLike, name: str = "cloud") -> Array:
    """``points`` [N, 3] centred on their bounding box and scaled uniformly to longest side 1; raises as the above."""
    centre, scale = bounding_box_normalisation(points, name)
    return (as_points(points, name) - centre) / scale


def sample_surface(
    vertices: ArrayLike, faces: ArrayLike, count: int, rng: np.random.Generator
) -> Array:
    """Points [count, 3] drawn uniformly by area from the triangles ``faces`` [F, 3]; InputError where they have no area."""
    corners = as_points(vertices, "mesh")
    triangles = as_triangles(faces, len(corners), "mesh")
    drawn, barycentric = draw_surface(corners, triangles, count, rng)
    origin, first, second = (corners[triangles[drawn, k]] for k in range(3))
    return origin + barycentric[:, :1] * (first - origin) + barycentric[:, 1:] * (second - origin)


def as_triangles(faces: ArrayLike, count: int, name: str) -> NDArray[np.int64]:
    """``faces`` as int64 [F, 3] that index ``count`` vertices; InputError naming ``name`` otherwise."""
    try:
        triangles = np.asarray(faces)
    except ValueError:
        raise InputError(
            f"{name}: the faces are no array of whole numbers, expected triangles [F, 3]"
        ) from None
    if triangles.ndim != 2 or triangles.shape[1] != 3:
        raise InputError(
            f"{name}: faces have shape {list(triangles.shape)}, expected triangles [F, 3]"
        )
    if triangles.dtype.kind not in "iu":
        raise InputError(f"{name}: the faces are {triangles.dtype}, expected whole numbers")
    outside = (triangles < 0) | (triangles >= count)
    if outside.any():
        raise InputError(
            f"{name}: a face names vertex {triangles[outside][0]}, outside 0 to {count - 1}"
        )
    return triangles.astype(np.int64)


def draw_surface(
    corners: Array, triangles: NDArray[np.int64], count: int, rng: np.random.Generator
) -> tuple[NDArray[np.int64], Array]:
    """Of ``count`` points drawn uniformly by area the triangles [count], and [count, 2] their barycentric coordinates of the
    second and the third corner; InputError if there are no triangles, or they have no area.
    """
    if len(triangles) == 0:
        raise InputError("mesh: there are no faces, expected at least one triangle")
    origin = corners[triangles[:, 0]]
    first, second = corners[triangles[:, 1]] - origin, corners[triangles[:, 2]] - origin
    # In units of the longest edge: areas of very small or very large meshes neither vanish nor overflow.
    unit = max(float(np.abs(first).max()), float(np.abs(second).max())) or 1.0
    area = np.linalg.norm(np.cross(first / unit, second / unit), axis=1)
    if not area.any():
        raise InputError(f"mesh: the {len(triangles)} triangles have no area, expected a surface")
    cumulative = np.cumsum(area)
    # Searching right of equal sums passes over triangles without area.
    drawn = np.searchsorted(cumulative, rng.random(count) * cumulative[-1], side="right")
    drawn = np.minimum(drawn, np.flatnonzero(area)[-1])
    along, across = np.sqrt(rng.random((count, 1))), rng.random((count, 1))
    return drawn, np.concatenate([along * (1.0 - across), along * across], axis=1)
