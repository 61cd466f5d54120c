"""Measures and samples of points and surfaces. Only numpy is needed."""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from .arrays import LARGEST, Array, Indices, as_numbers

Number = TypeVar("Number", bound=np.generic)

# Farthest-point sampling chooses about a thousand points. In a large cloud it chooses them among
# this many: its time grows with the number of candidates.
CANDIDATES = 16_384


def as_points(points: ArrayLike, name: str = "cloud") -> Array:
    """``points`` as a float64 array [N, 3] with N >= 1 and finite coordinates.

    Raises InputError, which begins with ``name``, if they are anything else.
    """
    array: Array = as_numbers(points, f"{name}: what was given")
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(f"{name}: shape is {list(array.shape)}, expected points [N, 3]")
    if len(array) == 0:
        raise InputError(f"{name}: holds no points, expected at least one")
    finite = np.isfinite(array).all(1)
    if not finite.all():
        raise InputError(
            f"{name}: point {int(np.argmin(finite))} has a NaN or infinite coordinate, "
            "expected numbers"
        )
    if not (largest := max(array.max(), -array.min())) <= LARGEST:
        raise InputError(
            f"{name}: the largest coordinate is {largest:g}, expected at most {LARGEST:g}"
        )
    return array


def quantile(values: Array, share: float) -> Array:
    """The quantile ``share`` of ``values`` [N, ...] along the first axis, as `numpy.quantile`.

    `numpy.quantile` imports masked arrays, which takes a tenth of the time of a small command.
    """
    place = share * (len(values) - 1)
    low, high = int(place), min(int(place) + 1, len(values) - 1)
    ordered = np.partition(values, (low, high), axis=0)
    interpolated: Array = ordered[low] + (place - low) * (ordered[high] - ordered[low])
    return interpolated


def evenly(count: int, most: int) -> list[int]:
    """At most ``most`` of the indices 0 to ``count`` - 1, evenly from the first to the last."""
    return np.linspace(0, count - 1, min(count, most)).round().astype(int).tolist()


def scattered(points: NDArray[Number], most: int) -> NDArray[Number]:
    """At most ``most`` of ``points`` [N, ...], evenly from the whole array and in its order.

    Every k-th point will not do: of a cloud whose points form rows and columns, as a depth camera
    gives it, that may be a single column.
    """
    if len(points) <= most:
        return points
    # The fractional parts of its multiples fill the unit interval evenly.
    golden = (5.0**0.5 - 1.0) / 2.0
    # Some of these indices may be equal.
    return points[np.unique((len(points) * (np.arange(most) * golden % 1.0)).astype(np.int64))]


def farthest_point_sample(points: ArrayLike, count: int) -> Indices:
    """Indices [count] of points that are far apart, in the order in which they are chosen.

    The first index is 0. Each next point is the point of ``points`` [N, 3] that is farthest from
    all chosen points; of equally far points it is the first. The first k indices are thus the
    sample of size k. Points may coincide; no index is chosen twice. Takes O(N count) time.

    Raises InputError if ``count`` is not from 1 to N.
    """
    array = as_points(points)
    total = len(array)
    if not 1 <= count <= total:
        raise InputError(f"asked for {count} of {total} points, expected 1 to {total}")
    # For speed: contiguous columns, and no allocation inside the loop.
    x, y, z = (np.ascontiguousarray(column) for column in array.T)
    squared, difference = np.empty(total), np.empty(total)
    nearest = np.full(total, np.inf)  # squared distance to the nearest chosen point
    sample = np.empty(count, dtype=np.int64)
    index = 0
    for i in range(count):
        sample[i] = index
        np.subtract(x, x[index], out=squared)
        np.multiply(squared, squared, out=squared)
        for column in (y, z):
            np.subtract(column, column[index], out=difference)
            np.multiply(difference, difference, out=difference)
            np.add(squared, difference, out=squared)
        np.minimum(nearest, squared, out=nearest)
        # Less than any distance: no index is chosen twice, even if all points coincide.
        nearest[index] = -1.0
        index = int(nearest.argmax())
    return sample


def spread_subset(points: ArrayLike, count: int) -> Indices:
    """Indices of at most ``count`` evenly spread points of ``points`` [N, 3].

    In a cloud of over CANDIDATES points they are chosen among that many.
    """
    array = as_points(points)
    indices = np.arange(len(array))
    if len(array) <= count:
        return indices
    candidates = scattered(indices, CANDIDATES)
    return candidates[farthest_point_sample(array[candidates], min(count, len(candidates)))]


def root_mean_square(vectors: Array) -> float:
    """Of the lengths of ``vectors`` [N, D]."""
    return float(np.sqrt(np.square(vectors).sum(1).mean()))


def bounds(points: Array) -> tuple[Array, Array]:
    """[D] least and largest coordinates of points [N, D]."""
    # Contiguous axes take a tenth of the time.
    axes = np.ascontiguousarray(points.T)
    return axes.min(1), axes.max(1)


def longest_side(points: Array) -> float:
    """The longest side of the bounding box of points [N, D]."""
    low, high = bounds(points)
    return float((high - low).max())


def bounding_box_normalisation(points: ArrayLike, name: str = "cloud") -> tuple[Array, float]:
    """Centre [3] and longest side, ``scale``, of a cloud's bounding box.

    ``(points - centre) / scale`` is centred at the origin and has longest side 1. Raises
    InputError, which begins with ``name``, if all points are equal or the box has no finite size.
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
    """``points`` [N, 3] centred on their bounding box and scaled to longest side 1.

    Raises InputError as `bounding_box_normalisation`.
    """
    centre, scale = bounding_box_normalisation(points, name)
    return (as_points(points, name) - centre) / scale


def sample_surface(
    vertices: ArrayLike, faces: ArrayLike, count: int, rng: np.random.Generator
) -> Array:
    """Points [count, 3] drawn uniformly by area from the triangles ``faces`` [F, 3].

    Raises InputError if there are no triangles or they have no area.
    """
    corners = as_points(vertices, "mesh")
    triangles = as_triangles(faces, len(corners), "mesh")
    drawn, barycentric = draw_surface(corners, triangles, count, rng)
    origin, first, second = (corners[triangles[drawn, k]] for k in range(3))
    return origin + barycentric[:, :1] * (first - origin) + barycentric[:, 1:] * (second - origin)


def as_triangles(faces: ArrayLike, count: int, name: str) -> Indices:
    """``faces`` as int64 [F, 3], indices of ``count`` vertices.

    Raises InputError, which begins with ``name``, if they are anything else.
    """
    try:
        triangles = np.asarray(faces)
    except ValueError:
        raise InputError(
            f"{name}: the faces are not an array of whole numbers, expected triangles [F, 3]"
        ) from None
    if triangles.ndim != 2 or triangles.shape[1] != 3:
        raise InputError(
            f"{name}: faces have shape {list(triangles.shape)}, expected triangles [F, 3]"
        )
    if triangles.dtype.kind not in "iu":
        raise InputError(f"{name}: the faces are {triangles.dtype}, expected whole numbers")
    require_vertices(triangles, count, name)
    return triangles.astype(np.int64)


def require_vertices(corners: NDArray[np.integer], count: int, name: str) -> None:
    """Raise InputError, which begins with ``name``, if a corner is none of ``count`` vertices."""
    outside = (corners < 0) | (corners >= count)
    if outside.any():
        raise InputError(
            f"{name}: a face names vertex {corners[outside][0]}, expected 0 to {count - 1}"
        )


def draw_surface(
    vertices: Array, triangles: Indices, count: int, rng: np.random.Generator
) -> tuple[Indices, Array]:
    """Draw ``count`` points uniformly by area from the ``triangles`` [F, 3] of ``vertices`` [V, 3].

    Returns the triangle of each point [count], and its barycentric coordinates of the second and
    the third corner [count, 2]. Raises InputError if there are no triangles or they have no area.
    """
    if len(triangles) == 0:
        raise InputError("mesh: there are no faces, expected at least one triangle")
    origin = vertices[triangles[:, 0]]
    first, second = vertices[triangles[:, 1]] - origin, vertices[triangles[:, 2]] - origin
    # Areas are in units of the longest edge: then those of very small or very large meshes neither
    # vanish nor overflow.
    unit = max(float(np.abs(first).max()), float(np.abs(second).max())) or 1.0
    area = np.linalg.norm(np.cross(first / unit, second / unit), axis=1)
    if not area.any():
        raise InputError(f"mesh: the {len(triangles)} triangles have no area, expected a surface")
    cumulative = np.cumsum(area)
    # Equal sums belong to triangles without area: the search on their right passes over them.
    drawn = np.searchsorted(cumulative, rng.random(count) * cumulative[-1], side="right")
    drawn = np.minimum(drawn, np.flatnonzero(area)[-1])
    along, across = np.sqrt(rng.random((count, 1))), rng.random((count, 1))
    return drawn, np.concatenate([along * (1.0 - across), along * across], axis=1)
