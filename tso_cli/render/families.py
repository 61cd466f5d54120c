"""Families of shapes by rule: a prior can learn from them without anybody's meshes.

A family draws its proportions from a random generator, so that a seed is a shape. y is up. Shapes
have no texture, and parts may run into each other, as in most meshes that people have.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations, product
from typing import Any

import numpy as np

from ..geometry.arrays import Array, Indices
from ..geometry.rotations import from_vectors
from ..io.meshes import Mesh
from .normalise import normalise

Rng = np.random.Generator
Place = Sequence[float] | Array
UP = np.array([0.0, 1.0, 0.0])


@dataclass(frozen=True, eq=False)
class Part:
    """A closed surface: vertices [V, 3] and faces [F, 3]."""

    vertices: Array
    faces: Indices

    def at(self, shift: Place) -> Part:
        return Part(self.vertices + np.asarray(shift), self.faces)

    def mapped(self, matrix: Array, fixed: Place = (0, 0, 0)) -> Part:
        """Mapped by a matrix [3, 3] about a ``fixed`` place."""
        return Part((self.vertices - fixed) @ matrix.T + fixed, self.faces)


Family = Callable[[Rng], list[Part]]


def shape_of(family: str, seed: Sequence[int]) -> Mesh:
    """The shape of a family by its seed: centred, longest side 1."""
    parts = FAMILIES[family](np.random.default_rng(seed))
    counts = np.cumsum([0, *(len(part.vertices) for part in parts)])
    vertices = np.concatenate([part.vertices for part in parts])
    faces = [part.faces + first for part, first in zip(parts, counts[:-1], strict=True)]
    return normalise(Mesh(vertices, np.concatenate(faces)))


# Parts.


def block(size: Place, at: Place = (0, 0, 0)) -> Part:
    """A box of a size [3], around a place."""
    x, y, z = np.asarray(size, float) / 2.0
    return prism([(-x, -y), (x, -y), (x, y), (-x, y)], 2.0 * z).at(at)


def bar(start: Place, end: Place, radius: float, tip: float = 1.0) -> Part:
    """A round bar between two places; ``tip`` times as thick at its end."""
    return tube([start, end], radius * np.array([1.0, tip]))


def beam(start: Place, end: Place, width: float, height: float) -> Part:
    """A bar with a rectangular section, ``height`` across its length as far up as can be."""
    begin, along = np.array(start, float), np.subtract(end, start)
    length = float(np.linalg.norm(along))
    x = along / length
    z = np.cross(x, UP if abs(x[1]) < 0.95 else [1.0, 0.0, 0.0])
    z /= np.linalg.norm(z)
    turn = np.stack([x, np.cross(z, x), z], 1)
    return block((length, height, width)).mapped(turn).at(begin + along / 2.0)


def curve(x: Any, y: Any, z: Any = 0.0) -> Array:
    """The path [K, 3] of coordinates that are [K] or numbers."""
    return np.stack(np.broadcast_arrays(x, y, z), 1).astype(float)


def tube(path: Sequence[Place] | Array, radius: float | Array, sides: int = 12) -> Part:
    """A round tube along a path [K, 3], with a radius for all of it or for each place."""
    path = np.asarray(path, float)
    along = np.gradient(path, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along[0], UP if abs(along[0, 1]) < 0.9 else [1.0, 0.0, 0.0])
    angles = np.linspace(0.0, 2.0 * np.pi, sides, endpoint=False)
    radii, rings = np.broadcast_to(radius, len(path)), []
    for place, direction, size in zip(path, along, radii, strict=True):
        # The ring before, turned no more than the path: a tube does not twist.
        across = across - direction * (across @ direction)
        across /= np.linalg.norm(across)
        other = np.cross(direction, across)
        ring = np.cos(angles)[:, None] * across + np.sin(angles)[:, None] * other
        rings.append(place + size * ring)
    return _between(np.array(rings))


def _between(rings: Array) -> Part:
    """The surface through closed rings [K, S, 3], with a lid at both ends."""
    count, sides = rings.shape[:2]
    index = np.arange(count * sides).reshape(count, sides)
    here, there = index[:-1], index[1:]
    after, across = np.roll(here, -1, 1), np.roll(there, -1, 1)
    faces = [np.stack([here, after, there], -1), np.stack([after, across, there], -1)]
    middle = count * sides + np.arange(2)
    for ring, centre in ((index[0][::-1], middle[0]), (index[-1], middle[1])):
        fan = np.stack([ring, np.roll(ring, -1), np.full(sides, centre)], -1)
        faces.append(fan)
    vertices = np.concatenate([rings.reshape(-1, 3), rings[[0, -1]].mean(1)])
    return Part(vertices, np.concatenate([part.reshape(-1, 3) for part in faces]))


def ball(radii: Place, at: Place = (0, 0, 0)) -> Part:
    """An ellipsoid with half axes [3]."""
    angles = np.linspace(0.0, np.pi, 13)
    sphere = turned(list(zip(np.sin(angles), -np.cos(angles), strict=True)))
    return sphere.mapped(np.diag(np.asarray(radii, float))).at(at)


def turned(profile: Sequence[tuple[float, float]], at: Place = (0, 0, 0)) -> Part:
    """A body of revolution about y, of a profile of radii and heights."""
    radii, heights = np.array(profile, float).T
    angles = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    circle = np.stack([np.cos(angles), np.zeros(24), -np.sin(angles)], -1)
    return _between(
        np.maximum(radii, 1e-3)[:, None, None] * circle + heights[:, None, None] * UP + at
    )


def prism(outline: Sequence[tuple[float, float]] | Array, depth: float) -> Part:
    """An outline [K, 2] in x and y, seen whole from its middle, as thick as ``depth`` along z."""
    flat = np.pad(np.asarray(outline), ((0, 0), (0, 1)))
    return _between(np.stack([flat + [0.0, 0.0, side * depth / 2.0] for side in (-1.0, 1.0)]))


def sheet(heights: Array, thickness: float) -> Part:
    """A thin sheet over the unit square of x and z, with ``heights`` [K, K] along y."""
    count = len(heights)
    x, z = np.meshgrid(*[np.linspace(-0.5, 0.5, count)] * 2, indexing="ij")
    top = np.stack([x, heights, z], -1).reshape(-1, 3)
    index = np.arange(count * count).reshape(count, count)
    a, b, c, d = (
        part.ravel() for part in (index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:])
    )
    upper = np.concatenate([np.stack([a, c, b], -1), np.stack([a, d, c], -1)])
    rim = np.concatenate([index[0], index[1:, -1], index[-1, -2::-1], index[-2:0:-1, 0]])
    here, there, below = rim, np.roll(rim, -1), count * count
    sides = [
        np.stack([here, there, here + below], -1),
        np.stack([there, there + below, here + below], -1),
    ]
    faces = np.concatenate([upper, upper[:, ::-1] + below, *sides])
    return Part(np.concatenate([top, top - thickness * UP]), faces)


def both_sides(parts: Iterable[Part], axis: int = 2) -> list[Part]:
    """The parts and their mirror images along an axis."""
    parts = list(parts)
    flip = np.eye(3)
    flip[axis, axis] = -1.0
    return [*parts, *(part.mapped(flip) for part in parts)]


def about(parts: Iterable[Part], axis: Place, degrees: float, at: Place = (0, 0, 0)) -> list[Part]:
    """The parts, turned about an axis through a place."""
    turn = from_vectors(np.radians(degrees) * np.asarray(axis) / np.linalg.norm(axis))
    return [part.mapped(turn, at) for part in parts]


def around(
    part: Callable[[], list[Part]] | list[Part], count: int, first: float = 0.0
) -> list[Part]:
    """The same parts ``count`` times around y."""
    solids = part() if callable(part) else part
    return [solid for k in range(count) for solid in about(solids, UP, first + 360.0 * k / count)]


# Furniture.


def legs(rng: Rng, width: float, depth: float, height: float) -> list[Part]:
    """Four legs, a pedestal or two boards under a plate at ``height``, standing on y = 0."""
    kind, thick = rng.choice(4), rng.uniform(0.02, 0.06)
    x, z, splay = width / 2.0 - thick, depth / 2.0 - thick, rng.uniform(0.0, 0.08)
    if kind == 0:
        foot = rng.uniform(0.2, 0.45) * width
        star = around([beam((0, 0.03, 0), (foot, 0.02, 0), thick, thick)], int(rng.integers(3, 6)))
        return [bar((0, 0, 0), (0, height, 0), rng.uniform(0.02, 0.08)), *star]
    if kind == 1:
        return both_sides([block((thick, height, depth), (x, height / 2, 0))], 0)
    make = bar if kind == 2 else lambda a, b, r: beam(a, b, 2 * r, 2 * r)
    leg = make((x + splay, 0, z + splay), (x, height, z), thick * rng.uniform(0.5, 1.0))
    parts = both_sides(both_sides([leg], 0), 2)
    if rng.random() < 0.4:
        low = rng.uniform(0.15, 0.6) * height
        parts += both_sides([beam((-x, low, z), (x, low, z), 0.6 * thick, thick)], 2)
    return parts


def chair(rng: Rng) -> list[Part]:
    width, depth, seat, back = rng.uniform((0.4, 0.4, 0.35, 0.3), (0.6, 0.6, 0.6, 0.7))
    thick, lean = rng.uniform(0.02, 0.1), rng.uniform(0.0, 18.0)
    parts = [block((width, thick, depth), (0, seat, 0)), *legs(rng, width, depth, seat)]
    z, side = -depth / 2 + 0.03, width / 2 - 0.03
    kind = rng.choice(3)
    if kind == 0:
        rest = [block((width, back, rng.uniform(0.02, 0.08)), (0, seat + back / 2, z))]
    else:
        rest = both_sides([bar((side, seat, z), (side, seat + back, z), 0.02)], 0)
        count = int(rng.integers(2, 6))
        for share in np.linspace(0.3, 1.0, count):
            left, right = ((half * width, seat + share * back, z) for half in (-0.5, 0.5))
            rest.append(beam(left, right, 0.02, rng.uniform(0.02, 0.06)))
        if kind == 2:
            places = np.linspace(-0.4, 0.4, count + 1) * width
            bars = [bar((x, seat, z), (x, seat + back, z), 0.012) for x in places]
            rest = [*rest[:2], *bars, rest[-1]]
    parts += about(rest, (1, 0, 0), -lean, (0, seat, z))
    if rng.random() < 0.35:
        high, x = seat + rng.uniform(0.15, 0.3), width / 2
        arm = beam((x, high, -depth / 2), (x, high, depth / 3), 0.05, 0.03)
        parts += both_sides([arm, bar((x, seat, depth / 3), (x, high, depth / 3), 0.02)], 0)
    return parts


def sofa(rng: Rng) -> list[Part]:
    low, most = (0.7, 0.6, 0.25, 0.3, 0.08), (2.4, 0.95, 0.45, 0.6, 0.25)
    width, depth, seat, back, arm = rng.uniform(low, most)
    thick = rng.uniform(0.1, 0.25)
    rest = block((width, back, thick), (0, seat + back / 2, -depth / 2 + thick / 2))
    parts = [block((width, seat * 0.7, depth), (0, seat * 0.65, 0))]
    parts += about([rest], (1, 0, 0), -rng.uniform(0, 12), (0, seat, -depth / 2))
    high = seat + rng.uniform(0.1, 0.3)
    parts += both_sides([block((arm, high, depth), (width / 2 + arm / 2, high / 2, 0))], 0)
    count = int(rng.integers(1, 4))
    for k in range(count):
        place = (width * ((k + 0.5) / count - 0.5), seat + 0.04, thick / 2)
        parts.append(block((0.95 * width / count, 0.12, depth - thick), place))
    return parts


def table(rng: Rng) -> list[Part]:
    width, depth, height = rng.uniform((0.5, 0.4, 0.3), (1.6, 0.9, 0.8))
    thick = rng.uniform(0.02, 0.08)
    if rng.random() < 0.3:
        half, top = width / 2, height + thick
        plate = turned([(0, height), (half, height), (half, top), (0, top)])
        return [plate, *legs(rng, 0.6 * width, 0.6 * width, height)]
    parts = [block((width, thick, depth), (0, height, 0)), *legs(rng, width, depth, height)]
    if rng.random() < 0.3:
        size = (width * rng.uniform(0.3, 0.9), height * rng.uniform(0.1, 0.3), depth * 0.8)
        parts.append(block(size, (0, height * 0.85, 0)))
    if rng.random() < 0.3:
        size = (width * rng.uniform(0.2, 0.35), height * 0.8, depth * 0.85)
        parts.append(block(size, (width * 0.3, height * 0.55, 0)))
    return parts


def shelf(rng: Rng) -> list[Part]:
    width, depth, height = rng.uniform((0.3, 0.2, 0.5), (1.2, 0.5, 1.8))
    thick = rng.uniform(0.015, 0.05)
    parts = both_sides([block((thick, height, depth), (width / 2, height / 2, 0))], 0)
    for y in np.linspace(thick / 2, height - thick / 2, int(rng.integers(2, 7))):
        parts.append(block((width, thick, depth), (0, y, 0)))
    if rng.random() < 0.5:
        parts.append(block((width, height, thick), (0, height / 2, -depth / 2)))
    if rng.random() < 0.4:
        parts.append(
            block((width, height * rng.uniform(0.2, 0.6), thick), (0, height * 0.3, depth / 2))
        )
    return parts


def bed(rng: Rng) -> list[Part]:
    width, length, seat = rng.uniform((0.7, 1.6, 0.2), (1.8, 2.2, 0.5))
    parts = [
        block((length, seat * 0.5, width), (0, seat * 0.75, 0)),
        *legs(rng, length, width, seat * 0.6),
    ]
    for end, high in ((-1, rng.uniform(0.2, 0.9)), (1, rng.uniform(0.0, 0.5))):
        parts.append(block((0.06, seat + high, width), (end * length / 2, (seat + high) / 2, 0)))
    if rng.random() < 0.6:
        parts += [ball((0.18, 0.08, 0.3 * width), (-length / 2 + 0.3, seat + 0.06, 0))]
    return parts


def lamp(rng: Rng) -> list[Part]:
    height, base = rng.uniform(0.5, 1.8), rng.uniform(0.1, 0.25)
    parts = [turned([(0, 0), (base, 0), (base * rng.uniform(0.2, 1), 0.06), (0.02, 0.08)])]
    low, top, deep = rng.uniform((0.12, 0.05, 0.12), (0.35, 0.25, 0.4))
    inner = [(max(top - 0.02, 0.01), deep), (max(low - 0.02, 0.01), 0.0)]
    shade = turned([(low, 0), (top, deep), *inner])
    if rng.random() < 0.6:
        stem = bar((0, 0, 0), (0, height + 0.05, 0), rng.uniform(0.01, 0.04))
        return [*parts, stem, shade.at((0, height, 0))]
    knee = (rng.uniform(-0.3, 0.1), height * 0.6, 0)
    head = (knee[0] + rng.uniform(0.2, 0.5), height * rng.uniform(0.6, 0.9), 0)
    (tilted,) = about([shade.at((0, -deep, 0))], (0, 0, 1), rng.uniform(-45, 45))
    return [*parts, bar((0, 0, 0), knee, 0.02), bar(knee, head, 0.02), tilted.at(head)]


# What moves.


def wheels(radius: float, width: float, places: Iterable[float], half: float) -> list[Part]:
    """Pairs of wheels along x, at z = +- half."""
    ends = [[(x, radius, half - width), (x, radius, half)] for x in places]
    return both_sides([tube(pair, radius, 20) for pair in ends])


def car(rng: Rng) -> list[Part]:
    length, width, low, high = rng.uniform((1.4, 0.55, 0.2, 0.2), (2.2, 0.8, 0.35, 0.4))
    radius = rng.uniform(0.12, 0.2)
    nose, tail = rng.uniform(0.6, 1.0, 2)
    a, b, c, d = np.sort(rng.uniform(-0.42, 0.4, 4)) * length
    half, belt = length / 2, radius + low
    outline = [(-half, radius), (half, radius), (half, radius + low * nose), (d, belt)]
    body = prism([*outline, (-length * 0.4, belt), (-half, radius + low * tail)], width)
    b, c = a + max(b - a, 0.12 * length), max(c, a + 0.35 * length)
    d = max(d, c + 0.08 * length)
    top = belt + high
    outline = [(a, top - high), (d, top - high), (c, top), (b, top)]
    roof = prism(outline, width * rng.uniform(0.75, 0.95))
    ends = np.array([-0.32, 0.33]) * length * rng.uniform(0.9, 1.1, 2)
    return [body, roof, *wheels(radius, 0.12, ends, width / 2)]


def truck(rng: Rng) -> list[Part]:
    length, width, height = rng.uniform((1.6, 0.5, 0.5), (3.5, 0.8, 0.9))
    radius, cab = rng.uniform(0.1, 0.18), rng.uniform(0.3, 0.6)
    parts = [block((length, 0.1, width * 0.8), (0, radius + 0.05, 0))]
    place = (length / 2 - cab / 2, radius + height * 0.45, 0)
    parts.append(block((cab, height * rng.uniform(0.6, 1.0), width), place))
    kind = rng.choice(3)
    cargo, middle = length - cab - 0.08, -cab / 2 - 0.04
    if kind == 0:
        parts.append(block((cargo, height, width), (middle, radius + 0.1 + height / 2, 0)))
    elif kind == 1:
        ends = [(middle - cargo / 2, 0, 0), (middle + cargo / 2, 0, 0)]
        parts.append(tube(ends, 0.45 * width, 20).at((0, radius + 0.1 + 0.45 * width, 0)))
    else:
        parts.append(block((cargo, 0.05, width), (middle, radius + 0.14, 0)))
        parts += both_sides([block((cargo, height * 0.3, 0.03), (middle, radius + 0.2, width / 2))])
    places = np.linspace(-length / 2 + radius, length / 2 - radius, int(rng.integers(2, 5)))
    return parts + wheels(radius, 0.1, places, width / 2)


def wing(
    root: Place, span: float, chord: float, back: float, taper: float, lift: float, thick: float
) -> Part:
    """A wing along z from its root: swept ``back`` along -x, lifted along y."""
    outline = np.array([(0.5, 0.0), (0.15, 0.5), (-0.5, 0.05), (-0.5, -0.05), (0.15, -0.5)])
    rings = [
        np.stack([size * chord * outline[:, 0], size * thick * outline[:, 1], np.zeros(5)], -1)
        + place
        for size, place in ((1.0, np.zeros(3)), (taper, np.array([-back, lift, span])))
    ]
    return _between(np.array(rings) + np.array(root, float))


def airplane(rng: Rng) -> list[Part]:
    length, radius = rng.uniform(0.8, 1.4), rng.uniform(0.04, 0.1)
    x = np.linspace(-0.5, 0.5, 9)
    tip = np.minimum((x + 0.5) / rng.uniform(0.2, 0.5), (0.5 - x) / rng.uniform(0.08, 0.25))
    path = curve(x * length, np.where(x < 0, -x * rng.uniform(0, 0.1), 0.0))
    span, chord, sweep, taper = rng.uniform((0.4, 0.12, -0.03, 0.25), (0.8, 0.35, 0.35, 1.0))
    high, at = rng.uniform(-1, 1) * radius, rng.uniform(-0.05, 0.15) * length
    main = wing((at, high, 0), span, chord, sweep, taper, rng.uniform(-0.02, 0.12), 0.03)
    parts = [tube(path, radius * np.clip(tip, 0.08, 1.0), 14), *both_sides([main])]
    small, back = rng.uniform(0.35, 0.5), -0.44 * length
    root = (back, 0.03 + rng.uniform(0, 0.12), 0)
    parts += both_sides([wing(root, small * span, 0.55 * chord, 0.6 * sweep, taper, 0.0, 0.02)])
    tall, swept = rng.uniform(0.12, 0.28), rng.uniform(0.0, 0.12)
    fin = wing((0, 0, 0), tall, 0.6 * chord, swept, taper, 0.0, 0.02)
    parts += [solid.at((back, 0.02, 0)) for solid in about([fin], (1, 0, 0), -90.0)]
    if (engines := rng.choice(3)) and span > 0.5:
        for k in range(engines):
            z = span * (0.3 + 0.25 * k)
            x0 = at - sweep * z / span + 0.3 * chord
            ends = [(x0 - 0.1, high - 0.03, z), (x0 + 0.08, high - 0.03, z)]
            parts += both_sides([tube(ends, rng.uniform(0.02, 0.045))])
    return parts


def ship(rng: Rng) -> list[Part]:
    length, width, deep = rng.uniform((1.0, 0.2, 0.12), (1.6, 0.45, 0.3))
    x = np.linspace(-0.5, 0.5, 11)
    bow, stern = (0.5 - x) / rng.uniform(0.2, 0.5), (x + 0.5) / rng.uniform(0.02, 0.3) + 0.5
    plan = width / 2 * np.clip(np.minimum(bow, stern), 0.03, 1.0)
    section = np.array([(1.0, 0.0), (0.6, -0.8), (0.0, -1.0), (-0.6, -0.8), (-1.0, 0.0)])
    rings = [
        curve(place * length, deep * section[:, 1], half * section[:, 0])
        for place, half in zip(x, plan, strict=True)
    ]
    parts, y = [_between(np.array(rings))], 0.0
    for k in range(int(rng.integers(0, 4))):
        long, tall, wide = rng.uniform((0.1, 0.05, 0.3), (0.4, 0.15, 0.8))
        size = np.array([length * long, tall, width * wide]) * 0.85**k
        parts.append(block(size, (rng.uniform(-0.25, 0.1) * length, y + size[1] / 2, 0)))
        y += size[1]
    for x0 in rng.uniform(-0.2, 0.3, rng.choice(3)) * length:
        top = rng.uniform(0.4, 1.1)
        parts.append(bar((x0, 0, 0), (x0, top, 0), 0.015))
        if rng.random() < 0.7:
            sail = [(x0, 0.12), (x0 - rng.uniform(0.2, 0.45), 0.14), (x0, top)]
            parts.append(prism(sail, 0.01))
    return parts


def bicycle(rng: Rng) -> list[Part]:
    radius, apart, tyre = rng.uniform((0.28, 0.9, 0.012), (0.38, 1.2, 0.03))
    circle = np.linspace(0, 2 * np.pi, 28)
    ring = curve(radius * np.cos(circle), radius * np.sin(circle) + radius)
    parts = [tube(ring + [x, 0, 0], tyre, 8) for x in (-apart / 2, apart / 2)]
    rear, front = (-apart / 2, radius, 0), (apart / 2, radius, 0)
    crank, saddle = (-0.08, radius * 0.9, 0), (-0.22, radius * rng.uniform(2.0, 2.8), 0)
    head = (apart / 2 - 0.22, radius * rng.uniform(2.2, 2.8), 0)
    rod = rng.uniform(0.01, 0.03)
    joints = (rear, crank, saddle, rear), (crank, head, saddle), (head, front)
    parts += [bar(a, b, rod) for path in joints for a, b in zip(path, path[1:], strict=False)]
    parts.append(ball((0.12, 0.03, 0.06), (saddle[0], saddle[1] + 0.03, 0)))
    return [
        *parts,
        bar((head[0], head[1] + 0.05, -0.25), (head[0], head[1] + 0.05, 0.25), 0.015),
        *(bar((a[0], a[1], -0.02), (a[0], a[1], 0.02), 0.04) for a in (rear, front)),
    ]


# What lives.


def limb(rng: Rng, start: Place, end: Place, thick: float) -> list[Part]:
    """Two tapering bones with a joint that is a little off the line."""
    start, end = np.asarray(start, float), np.asarray(end, float)
    joint = (start + end) / 2 + rng.normal(0, 0.06, 3) * np.linalg.norm(end - start)
    bones = bar(start, joint, thick, 0.75), bar(joint, end, 0.75 * thick, 0.7)
    return [*bones, ball([thick * 0.8] * 3, joint)]


def animal(rng: Rng) -> list[Part]:
    length, thick, leg = rng.uniform((0.5, 0.1, 0.15), (0.9, 0.25, 0.6))
    y = leg + thick * 0.6
    parts = [ball((length / 2, thick, thick * rng.uniform(0.6, 1.0)), (0, y, 0))]
    neck = np.array([length / 2, y, 0]) + [rng.uniform(0.0, 0.3), rng.uniform(-0.05, 0.5), 0]
    parts.append(bar((length * 0.35, y, 0), neck, thick * 0.55, 0.7))
    parts.append(ball((rng.uniform(0.1, 0.2), 0.09, 0.08), neck + [0.06, 0.02, 0]))
    for x in (-0.38 * length, 0.35 * length):
        for z in (-0.5 * thick, 0.5 * thick):
            foot = (x + rng.normal(0, 0.08), 0, z)
            parts += limb(rng, (x, y, z), foot, thick * rng.uniform(0.2, 0.4))
    tail = rng.uniform(0.1, 0.6)
    bends = np.array([0.0, rng.uniform(-0.2, 0.3), rng.uniform(-0.4, 0.4)])
    path = curve(-length / 2 - tail * np.array([0.0, 0.6, 1.0]), y + bends)
    parts.append(tube(path, thick * np.array([0.25, 0.15, 0.05])))
    if rng.random() < 0.5:
        tip = neck + [rng.uniform(-0.1, 0.05), rng.uniform(0.1, 0.25), 0.08]
        parts += both_sides([bar(neck + [0, 0.05, 0.04], tip, 0.025, 0.3)])
    return parts


def person(rng: Rng) -> list[Part]:
    hip, chest, wide = rng.uniform((0.7, 0.4, 0.12), (1.0, 0.6, 0.22))
    top = hip + chest
    parts = [
        ball((wide, chest / 2 + 0.05, wide * 0.6), (0, hip + chest / 2, 0)),
        ball((0.09, 0.12, 0.1), (0, top + 0.2, 0)),
        bar((0, top, 0), (0, top + 0.12, 0), 0.05),
    ]
    for side in (-1, 1):
        step = rng.normal(0, 0.15)
        foot = (side * wide * rng.uniform(0.4, 1.6), 0, step)
        parts += limb(rng, (side * wide * 0.5, hip, 0), foot, 0.08)
        hand = rng.normal(0, 0.35, 3) + [side * (0.25 + wide), top - 0.35, 0]
        parts += limb(rng, (side * wide, top - 0.02, 0), hand, 0.05)
    return parts


def plant(rng: Rng) -> list[Part]:
    low, high, tall = rng.uniform((0.1, 0.12, 0.15), (0.2, 0.3, 0.35))
    parts = [turned([(0, 0), (low, 0), (high, tall), (0, tall)])] if rng.random() < 0.7 else []
    for angle in rng.uniform(0, 360, int(rng.integers(4, 14))):
        reach, rise = rng.uniform((0.1, 0.2), (0.5, 0.9))
        share = np.linspace(0, 1, 5)
        path = curve(reach * share**2, tall + rise * np.sin(share * rng.uniform(1.2, 2.4)))
        stem = [tube(path, 0.012, 6)]
        if rng.random() < 0.8:
            stem.append(ball((rng.uniform(0.06, 0.16), 0.012, rng.uniform(0.03, 0.09)), path[-1]))
        parts += about(stem, UP, angle)
    return parts


def tree(rng: Rng) -> list[Part]:
    trunk, thick = rng.uniform(0.3, 0.9), rng.uniform(0.03, 0.1)
    parts = [bar((0, 0, 0), (0, trunk + 0.3, 0), thick, 0.5)]
    if rng.random() < 0.4:
        for k in range(count := int(rng.integers(2, 5))):
            y = trunk + 0.3 * k
            parts.append(turned([(0.5 * (1 - k / (count + 1)), y), (0.0, y + 0.45)]))
        return parts
    for _ in range(int(rng.integers(3, 9))):
        at = rng.normal(0, 0.2, 3) + [0, trunk + 0.4, 0]
        parts.append(ball(rng.uniform(0.12, 0.35, 3), at))
        parts.append(bar((0, trunk * 0.8, 0), at, thick * 0.5, 0.5))
    return parts


# What people hold.


def vessel(rng: Rng) -> list[Part]:
    """A vase, bowl, cup or mug: open, with a wall."""
    height, wall = rng.uniform(0.2, 1.2), rng.uniform(0.02, 0.05)
    heights = np.linspace(0, height, 7)
    radii = np.clip(rng.uniform(0.2, 0.45) + np.cumsum(rng.normal(0, 0.06, 7)), 0.08, 0.6)
    outer = list(zip(radii, heights, strict=True))
    inner = [(max(r - wall, 0.02), max(h, wall)) for r, h in outer[::-1]]
    parts = [turned([(0, 0), *outer, *inner, (0, wall)])]
    if rng.random() < 0.4:
        angle = np.linspace(-1.4, 1.4, 9)
        size, middle = rng.uniform(0.15, 0.35) * height, height * rng.uniform(0.4, 0.6)
        side = np.interp(middle, heights, radii) - 0.1 * size
        path = curve(side + size * np.cos(angle), middle + size * np.sin(angle))
        parts.append(tube(path, rng.uniform(0.015, 0.04)))
    return parts


def bottle(rng: Rng) -> list[Part]:
    wide, tall, neck, long = rng.uniform((0.12, 0.4, 0.04, 0.1), (0.3, 0.9, 0.1, 0.4))
    neck = min(neck, wide * 0.8)
    shoulder = tall + rng.uniform(0.02, 0.25)
    profile = [(0, 0), (wide, 0), (wide * rng.uniform(0.8, 1.1), tall / 2), (wide, tall)]
    profile += [(neck, shoulder), (neck, shoulder + long)]
    if rng.random() < 0.6:
        top = shoulder + long
        profile += [(neck * 1.3, top), (neck * 1.3, top + 0.08)]
    body = turned([*profile, (0, profile[-1][1])])
    if rng.random() < 0.3:
        body = body.mapped(np.diag([1.0, 1.0, rng.uniform(0.4, 0.9)]))
    return [body]


def can(rng: Rng) -> list[Part]:
    """A can, box, jar or barrel."""
    if rng.random() < 0.4:
        return [block(rng.uniform(0.15, 1.0, 3))]
    radius, tall, lid = rng.uniform((0.15, 0.2, 0.6), (0.5, 1.2, 1.1))
    body = [(0, 0), (radius, 0), (radius * rng.uniform(0.9, 1.2), tall / 2), (radius, tall)]
    top = tall + 0.08
    return [turned([*body, (radius * lid, tall), (radius * lid, top), (0, top)])]


def hammer(rng: Rng) -> list[Part]:
    """A stick with a head across: hammers, axes, brushes, rakes."""
    long, thick = rng.uniform(0.6, 1.0), rng.uniform(0.012, 0.05)
    parts = [bar((0, 0, 0), (0, long, 0), thick, rng.uniform(0.7, 1.3))]
    kind, wide, deep = rng.choice(3), rng.uniform(0.1, 0.4), rng.uniform(0.02, 0.12)
    if kind == 0:
        ends = (-wide / 2, long, 0), (wide / 2, long, 0)
        return [*parts, bar(*ends, deep, rng.uniform(0.2, 1.2))]
    if kind == 1:
        top = long + deep
        blade = [(0, long - deep), (wide, long - 2 * deep), (wide * 1.1, top), (0, top)]
        return [*parts, prism(blade, 0.03)]
    teeth = [
        bar((x, long, 0), (x, long + rng.uniform(0.05, 0.2), 0), 0.01)
        for x in np.linspace(-wide / 2, wide / 2, int(rng.integers(3, 9)))
    ]
    return [*parts, beam((-wide / 2, long, 0), (wide / 2, long, 0), deep, deep), *teeth]


def spoon(rng: Rng) -> list[Part]:
    """A spoon, fork, knife, spatula or pan."""
    long, wide, thick = rng.uniform((0.5, 0.06, 0.01), (0.9, 0.4, 0.03))
    parts = [beam((0, 0, 0), (long, rng.uniform(-0.05, 0.15), 0), rng.uniform(0.02, 0.06), thick)]
    kind = rng.choice(3)
    if kind == 0:
        deep, broad = rng.uniform(0.1, 0.5), rng.uniform(0.5, 1.0)
        return [*parts, ball((wide, wide * deep, wide * broad), (-wide, 0, 0))]
    if kind == 1:
        places = np.linspace(-wide / 2, wide / 2, int(rng.integers(2, 6)))
        teeth = [block((0.25, thick, 0.02), (-0.14, 0, z)) for z in places]
        return [*parts, block((0.06, thick, wide), (0, 0, 0)), *teeth]
    y, low, high = wide / 3, -rng.uniform(0.3, 0.8), -rng.uniform(0.1, 0.3)
    blade = prism([(0.05, -y), (low, -y), (high, y), (0.05, y)], thick)
    return [*parts, *about([blade], (1, 0, 0), rng.choice([0.0, 90.0]))]


def pliers(rng: Rng) -> list[Part]:
    """Two crossing arms: pliers, scissors, pegs."""
    grip, jaw, open_by = rng.uniform((0.35, 0.15, 4), (0.7, 0.4, 30))
    thick, bow = rng.uniform(0.02, 0.05), rng.uniform(0.0, 0.12)
    share = np.linspace(0, 1, 6)
    arm = [tube(curve(-grip * share, bow * np.sin(np.pi * share)), thick)]
    arm.append(beam((0, 0, 0), (jaw, 0, 0), thick * 2, thick * 2))
    if rng.random() < 0.4:
        angle = np.linspace(0, 2 * np.pi, 16)
        eye = curve(-grip - 0.08 + 0.08 * np.cos(angle), 0.08 * np.sin(angle))
        arm.append(tube(eye, 0.015))
    arms = both_sides(about(arm, (0, 0, 1), open_by / 2), 1)
    return [*arms, tube([(0, 0, -0.05), (0, 0, 0.05)], 0.05)]


def spanner(rng: Rng) -> list[Part]:
    """A flat bar with an eye or a fork at its ends: spanners, keys, links."""
    long, wide, flat = rng.uniform((0.5, 0.04, 0.02), (0.8, 0.12, 0.08))
    parts = [block((long, wide, flat))]
    for end in (-1, 1):
        kind, size = rng.choice(3), rng.uniform(0.06, 0.16)
        at = (end * (long / 2 + size * 0.8), 0, 0)
        if kind == 0:
            angle = np.linspace(0, 2 * np.pi, 20)
            eye = curve(at[0] + size * np.cos(angle), size * np.sin(angle))
            parts.append(tube(eye, size * rng.uniform(0.2, 0.45), 8))
        elif kind == 1:
            fork = block((size * 1.4, size * 0.4, flat), (at[0], size * 0.6, 0))
            parts += both_sides([fork], 1)
            parts.append(block((size * 0.5, size * 1.2, flat), (end * long / 2, 0, 0)))
        else:
            for k, tooth in enumerate(size * rng.uniform(0.2, 0.9, int(rng.integers(2, 5)))):
                place = (end * (long / 2 - 0.08 * k), -wide / 2 - tooth / 2, 0)
                parts.append(block((0.05, tooth, flat), place))
    return parts


def screw(rng: Rng) -> list[Part]:
    """A screw, bolt, nail, pin or needle with a head."""
    long, thick = rng.uniform(0.5, 1.0), rng.uniform(0.012, 0.08)
    parts = [bar((0, long, 0), (0, 0, 0), thick, 1.0 if rng.random() < 0.5 else 0.1)]
    head = thick * rng.uniform(1.4, 3.5)
    kind = rng.choice(3)
    if kind == 0:
        return [*parts, ball((head, head * rng.uniform(0.4, 1.0), head), (0, long, 0))]
    sides = 6 if kind == 1 else 20
    parts.append(tube([(0, long, 0), (0, long + head * rng.uniform(0.3, 1.0), 0)], head, sides))
    if rng.random() < 0.3:
        nut = (0, long * 0.3, 0), (0, long * 0.3 + thick * 1.5, 0)
        parts.append(tube(nut, thick * 2.2, 6))
    return parts


def bracket(rng: Rng) -> list[Part]:
    wide, flat = rng.uniform(0.05, 0.4), rng.uniform(0.015, 0.06)
    a, b = rng.uniform(0.3, 1.0, 2)
    parts = [block((a, flat, wide), (a / 2, 0, 0)), block((flat, b, wide), (0, b / 2, 0))]
    if rng.random() < 0.6:
        ends = (a * rng.uniform(0.4, 0.9), 0, 0), (0, b * rng.uniform(0.4, 0.9), 0)
        parts.append(beam(*ends, wide * rng.uniform(0.1, 1.0), flat))
    if rng.random() < 0.4:
        parts.append(block((rng.uniform(0.1, 0.5), flat, wide), (rng.choice([-1, 1]) * 0.2, b, 0)))
    return parts


def frame(rng: Rng) -> list[Part]:
    """A frame of bars: racks, gates, easels, glasses, cages."""
    size, thick = rng.uniform(0.2, 1.0, 3), rng.uniform(0.012, 0.05)
    if rng.random() < 0.4:
        size[2] = 0.0
    corners = [
        np.array(place) * size for place in product((0, 1), (0, 1), (0, 1)[: 1 + bool(size[2])])
    ]
    pairs = combinations(corners, 2)
    edges = [pair for pair in pairs if np.count_nonzero(pair[0] != pair[1]) == 1]
    parts = [bar(*edge, thick) for edge in edges if rng.random() < 0.9]
    axis = int(rng.integers(2))
    for share in rng.uniform(0.1, 0.9, int(rng.integers(0, 6))):
        a, b = np.zeros(3), np.zeros(3)
        a[axis] = b[axis] = share * size[axis]
        b[1 - axis] = size[1 - axis]
        parts.append(bar(a, b, 0.7 * thick))
    return parts or [bar(corners[0], corners[-1], thick)]


def glasses(rng: Rng) -> list[Part]:
    wide, tall, apart, back = rng.uniform((0.13, 0.1, 0.04, 0.3), (0.22, 0.2, 0.1, 0.6))
    angle, rim = np.linspace(0, 2 * np.pi, 24), rng.uniform(0.008, 0.03)
    power = rng.uniform(0.5, 1.0)
    across, up = (np.sign(wave) * np.abs(wave) ** power for wave in (np.cos(angle), np.sin(angle)))
    side = [tube(curve(wide * across + wide + apart / 2, tall * up), rim, 8)]
    x, y = 2 * wide + apart / 2, tall / 2
    side.append(tube([(x, y, 0), (x, y, -back), (x - 0.02, 0, -back - 0.1)], rim, 6))
    return [*both_sides(side, 0), bar((-apart / 2, 0, 0), (apart / 2, 0, 0), rim)]


# What has no name.


def revolution(rng: Rng) -> list[Part]:
    heights = np.sort(rng.uniform(0, 1, int(rng.integers(3, 9))))
    radii = rng.uniform(0.04, 0.5, len(heights))
    body = turned([(0, heights[0]), *zip(radii, heights, strict=True), (0, heights[-1])])
    return about([body], (0, 0, 1), rng.choice([0.0, 90.0]))


def extrusion(rng: Rng) -> list[Part]:
    count = int(rng.integers(3, 12))
    angle = np.sort(rng.uniform(0, 2 * np.pi, count))
    angle = 0.5 * angle + 0.5 * np.linspace(0, 2 * np.pi, count, endpoint=False)
    outline = rng.uniform(0.2, 0.5, (count, 1)) * np.stack([np.cos(angle), np.sin(angle)], 1)
    return about([prism(outline, rng.uniform(0.03, 0.8))], (1, 0, 0), rng.choice([0.0, 90.0]))


def bent_tube(rng: Rng) -> list[Part]:
    """A hook, spring, pipe, handle or cable."""
    if rng.random() < 0.35:
        turns, share = rng.uniform(0.6, 4.0), np.linspace(0, 1, 80)
        radius, rise = rng.uniform(0.1, 0.5), rng.uniform(0.1, 1.0)
        angle = 2 * np.pi * turns * share
        path = curve(radius * np.cos(angle), rise * share, radius * np.sin(angle))
    else:
        knots = np.cumsum(rng.normal(0, 0.3, (int(rng.integers(4, 7)), 3)), 0)
        if rng.random() < 0.5:
            knots[:, 2] = 0.0
        # A quadratic spline, which is smooth and stays near its knots.
        share = np.linspace(0, 1, 12)[:, None]
        middles = np.concatenate([knots[:1], (knots[1:-2] + knots[2:-1]) / 2, knots[-1:]])
        pieces = zip(middles[:-1], knots[1:-1], middles[1:], strict=True)
        rest = 1 - share
        path = np.concatenate(
            [rest**2 * a + 2 * share * rest * b + share**2 * c for a, b, c in pieces]
        )
        path = path[np.r_[True, np.linalg.norm(np.diff(path, axis=0), axis=1) > 1e-6]]
    return [tube(path, rng.uniform(0.012, 0.1), 10)]


def thin_sheet(rng: Rng) -> list[Part]:
    """A leaf, sail, tray, cloth or sign."""
    x, z = np.meshgrid(*[np.linspace(-0.5, 0.5, 17)] * 2, indexing="ij")
    bend = rng.normal(0, 0.35, 3)
    heights = bend[0] * x**2 + bend[1] * z**2 + bend[2] * x * z
    heights += rng.uniform(0, 0.06) * np.sin(rng.uniform(3, 14) * x + rng.uniform(3, 14) * z)
    solid = sheet(heights, rng.uniform(0.008, 0.04))
    solid = solid.mapped(np.diag([1.0, 1.0, rng.uniform(0.2, 1.0)]))
    return about([solid], (1, 0, 0), rng.choice([0.0, 90.0]))


def primitives(rng: Rng) -> list[Part]:
    """A bag of parts that touch."""
    parts, at = [], np.zeros(3)
    for _ in range(int(rng.integers(2, 7))):
        size = rng.uniform(0.05, 0.4, 3)
        kind = rng.choice(3)
        if kind == 0:
            part = block(2 * size)
        elif kind == 1:
            part = ball(size)
        else:
            part = bar((0, -size[1], 0), (0, size[1], 0), size[0], rng.uniform(0.2, 1.2))
        turn = rng.normal(size=3), rng.choice([0.0, 90.0, rng.uniform(0, 90)])
        parts += [solid.at(at) for solid in about([part], *turn)]
        at = at + rng.choice([-1, 1], 3) * size * rng.uniform(0.3, 1.0, 3)
    return parts


def building(rng: Rng) -> list[Part]:
    """Blocks with roofs, towers or steps."""
    parts = []
    for _ in range(int(rng.integers(1, 4))):
        x, y, z = rng.uniform((0.2, 0.2, 0.2), (0.8, 1.0, 0.6))
        at = rng.uniform(-0.3, 0.3, 2)
        parts.append(block((x, y, z), (at[0], y / 2, at[1])))
        kind, roof = rng.choice(3), rng.uniform(0.05, 0.4)
        if kind == 0:
            parts.append(prism([(-x / 2, 0), (x / 2, 0), (0, roof)], z).at((at[0], y, at[1])))
        elif kind == 1:
            parts.append(turned([(min(x, z) / 2, y), (0, y + roof)], (at[0], 0, at[1])))
    return parts


FAMILIES: dict[str, Family] = {
    made.__name__.replace("_", " "): made
    for made in (
        *(chair, sofa, table, shelf, bed, lamp),
        *(car, truck, airplane, ship, bicycle),
        *(animal, person, plant, tree),
        *(vessel, bottle, can, hammer, spoon, pliers, spanner, screw, bracket, frame, glasses),
        *(revolution, extrusion, bent_tube, thin_sheet, primitives, building),
    )
}
"""By name."""
