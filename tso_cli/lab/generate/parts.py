"""Random draws, and the closed solids that shapes are put together from, in the unit of their arguments."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import CubicHermiteSpline

from ...io.meshes import Mesh

Array = NDArray[np.float64]
Range = tuple[float, float]
X_AXIS = np.array([1.0, 0.0, 0.0])


def chance(rng: np.random.Generator, probability: float) -> bool:
    """True with this probability."""
    return bool(rng.random() < probability)


def pick(rng: np.random.Generator, weights: Mapping[str, float]) -> str:
    """One of the keys, drawn by weight."""
    probabilities = np.array(list(weights.values()), dtype=np.float64)
    return list(weights)[int(rng.choice(len(weights), p=probabilities / probabilities.sum()))]


def draw(rng: np.random.Generator, ranges: Sequence[Range]) -> list[float]:
    """A number from each range (low, high)."""
    low, high = np.array(ranges).T
    return [float(value) for value in rng.uniform(low, high)]


def join(parts: Iterable[Mesh]) -> Mesh:
    """All parts as one mesh; they stay separate components."""
    parts = list(parts)
    starts = np.cumsum([0] + [len(part.vertices) for part in parts])
    faces = [part.faces + start for part, start in zip(parts, starts[:-1], strict=True)]
    return Mesh(np.concatenate([part.vertices for part in parts]), np.concatenate(faces))


def both(parts: Mesh | Iterable[Mesh], axis: int = 0) -> list[Mesh]:
    """The parts and their reflections in the plane where coordinate ``axis`` is 0."""
    parts = [parts] if isinstance(parts, Mesh) else list(parts)
    sign = 1.0 - 2.0 * np.eye(3)[axis]
    return parts + [Mesh(part.vertices * sign, part.faces[:, ::-1]) for part in parts]


def loft(sections: ArrayLike, closed: bool = False) -> Mesh:
    """The solid through a row of outlines.

    sections : [S, P, 3]. An end is closed by pairing point j with point P - 1 - j, which suits convex outlines and bent strips.
    closed : the last outline is joined to the first instead.
    """
    outlines = np.asarray(sections, dtype=np.float64)
    count, around = outlines.shape[:2]
    index = np.arange(count * around).reshape(count, around)
    rows = np.concatenate([index, index[:1]]) if closed else index
    near, far = rows[:-1], rows[1:]
    faces = [_quads(near, np.roll(near, -1, 1), np.roll(far, -1, 1), far)]
    if not closed:
        j = np.arange(around // 2)
        first, last = index[0], index[-1]
        faces.append(_quads(first[j], first[around - 1 - j], first[around - 2 - j], first[j + 1]))
        faces.append(_quads(last[j], last[j + 1], last[around - 2 - j], last[around - 1 - j]))
    vertices, triangles = outlines.reshape(-1, 3), np.concatenate(faces)
    a, b, c = (vertices[triangles[:, k]] - vertices[0] for k in range(3))
    outward = (a * np.cross(b, c)).sum() >= 0.0
    return Mesh(vertices, triangles if outward else triangles[:, ::-1])


def _quads(*corners: NDArray[np.int64]) -> NDArray[np.int64]:
    """Triangles [F, 3] of four-cornered faces, without those that have a corner twice."""
    a, b, c, d = (np.ravel(corner) for corner in corners)
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    x, y, z = faces.T
    return faces[(x != y) & (y != z) & (z != x)]


def superellipse(angle: ArrayLike, power: float) -> Array:
    """Points [..., 2] of the unit superellipse: power 2 a circle, above 6 nearly a square."""
    cos, sin = np.cos(angle), np.sin(angle)
    # Scaled along rays, which spreads the points evenly whatever the power.
    return (
        np.stack([cos, sin], -1)
        * ((np.abs(cos) ** power + np.abs(sin) ** power) ** (-1.0 / power))[..., None]
    )


def oval(half_width: float, half_height: float, power: float = 2.0, count: int = 12) -> Array:
    """Outline [count, 2] of a superellipse."""
    return superellipse(2.0 * np.pi * np.arange(count) / count, power) * [half_width, half_height]


def rectangle(width: float, height: float) -> Array:
    """Outline [4, 2], centred."""
    return np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) * [
        width / 2.0,
        height / 2.0,
    ]


def sweep(
    path: ArrayLike,
    section: Array,
    scale: ArrayLike = 1.0,
    side: ArrayLike | None = None,
    closed: bool = False,
) -> Mesh:
    """An outline drawn along a path.

    path : [N, 3], no point twice in a row; where ``closed`` it returns to its first point.
    section : [P, 2]; its first axis follows ``side``, by default the coordinate axis most across the path.
    scale : of the section, one number or one for each point [N].
    """
    points = np.asarray(path, dtype=np.float64)
    around = (
        np.concatenate([points[-1:], points, points[:1]])
        if closed
        else np.concatenate([points[:1], points, points[-1:]])
    )
    tangent = _unit(around[2:] - around[:-2])
    reference = (
        np.eye(3)[int(np.abs(tangent).max(0).argmin())]
        if side is None
        else np.asarray(side, dtype=np.float64)
    )
    first = _unit(reference - (tangent @ reference)[:, None] * tangent)
    size = np.broadcast_to(np.asarray(scale, dtype=np.float64), (len(points),))[:, None, None]
    offsets = (
        section[None, :, 0, None] * first[:, None]
        + section[None, :, 1, None] * np.cross(tangent, first)[:, None]
    )
    return loft(points[:, None] + size * offsets, closed)


def _unit(vectors: Array) -> Array:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)


def rod(
    a: ArrayLike, b: ArrayLike, radius: float, end: float | None = None, sides: int = 8
) -> Mesh:
    """Cylinder from ``a`` to ``b``, or the frustum of radius ``end`` at ``b``."""
    return turned(a, b, [0.0, 1.0], [radius, radius if end is None else end], sides)


def turned(
    a: ArrayLike, b: ArrayLike, stations: ArrayLike, radii: ArrayLike, sides: int = 10
) -> Mesh:
    """Body of revolution about the line from ``a`` to ``b``: radius ``radii`` [N] at fractions ``stations`` [N] of it."""
    start, line = np.asarray(a, dtype=np.float64), np.subtract(b, a, dtype=np.float64)
    direction = _unit(line)
    first = np.eye(3)[int(np.abs(direction).argmin())]
    first = _unit(first - (first @ direction) * direction)
    circle = oval(1.0, 1.0, 2.0, sides)
    ring = circle[:, :1] * first + circle[:, 1:] * np.cross(direction, first)
    along = np.asarray(stations, dtype=np.float64)[:, None]
    return loft(
        (start + along * line)[:, None] + np.asarray(radii, dtype=np.float64)[:, None, None] * ring
    )


def box(size: Sequence[float], centre: ArrayLike) -> Mesh:
    """Box of ``size`` [3]."""
    outline = rectangle(size[0], size[2])
    return loft(
        np.stack([flat(outline, -0.5 * size[1]), flat(outline, 0.5 * size[1])]) + np.asarray(centre)
    )


def cushion(
    size: Sequence[float],
    centre: ArrayLike,
    rounding: float = 0.5,
    power: float = 6.0,
    puff: float = 0.0,
) -> Mesh:
    """Box of ``size`` [3] with round edges.

    rounding : radius of the upper and lower edges in half heights. power : how square it is seen from above; see
    `superellipse`. puff : how far the upper face bulges, in heights.
    """
    half = np.asarray(size, dtype=np.float64) / 2.0
    edge = rounding * half[1]
    # Rings from below: inset from the outline, and height.
    inset = np.array([0.6, 0.293, 0.0, 0.0, 0.293, 1.0]) * edge
    height = (
        np.array([-1.0, -1.0, -1.0, 1.0, 1.0, 1.0]) * half[1]
        + np.array([0.0, 0.293, 1.0, -1.0, -0.293, 0.0]) * edge
    )
    if puff > 0.0:
        inset = np.append(inset, edge + 0.45 * max(half[[0, 2]].min() - edge, 0.0))
        height = np.append(height, half[1] * (1.0 + 2.0 * puff))
    wide, deep = (np.maximum(half[axis] - inset, 1e-4) for axis in (0, 2))
    rings = [flat(oval(x, z, power, 16), y) for x, y, z in zip(wide, height, deep, strict=True)]
    return loft(np.stack(rings) + np.asarray(centre, dtype=np.float64))


def flat(outline: Array, y: float) -> Array:
    """Outline [P, 2] in x and z laid at height y: [P, 3]."""
    return np.insert(outline, 1, y, axis=1)


def ellipsoid(radii: Sequence[float], centre: ArrayLike, rings: int = 7, sides: int = 12) -> Mesh:
    """Ellipsoid with half axes ``radii`` [3]."""
    angle = np.linspace(0.02, np.pi - 0.02, rings)
    ball = turned((0, -1, 0), (0, 1, 0), (1.0 - np.cos(angle)) / 2.0, np.sin(angle), sides)
    return Mesh(ball.vertices * np.asarray(radii) + np.asarray(centre), ball.faces)


def plate(grid: ArrayLike, thickness: ArrayLike) -> Mesh:
    """A bent sheet: middle surface [M, N, 3], and its thickness, one number or [M, N]."""
    middle = np.asarray(grid, dtype=np.float64)
    normal = _unit(np.cross(np.gradient(middle, axis=0), np.gradient(middle, axis=1)))
    half = (
        np.broadcast_to(np.asarray(thickness, dtype=np.float64), middle.shape[:2])[..., None]
        / 2.0
        * normal
    )
    return loft(np.concatenate([middle + half, (middle - half)[:, ::-1]], axis=1))


def curve(points: ArrayLike, count: int) -> Array:
    """A smooth curve [count, D] through ``points`` [K, D], K >= 3, evenly stepped between them."""
    knots = np.asarray(points, dtype=np.float64)
    at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(knots, axis=0), axis=1))])
    return np.asarray(
        CubicHermiteSpline(at, knots, np.gradient(knots, at, axis=0))(
            np.linspace(0.0, at[-1], count)
        )
    )


def wheel(
    centre: ArrayLike, radius: float, width: float, axis: int, sides: int = 18, hub: float = 0.6
) -> Mesh:
    """Wheel with a hollow hub; ``width`` along ``axis``."""
    half = np.eye(3)[axis] * width / 2.0
    stations = [0.12, 0.06, 0.0, 0.12, 0.88, 1.0, 0.94, 0.88]
    radii = np.array([0.05, hub, 0.85, 1.0, 1.0, 0.85, hub, 0.05]) * radius
    return turned(centre - half, centre + half, stations, radii, sides)
