"""The body of a car as one loft from nose to rear, and what is fixed to it. Lengths in metres, front +z, ground at y = 0."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...io.meshes import Mesh
from .parts import Array, both, box, chance, cushion, ellipsoid, loft, rod, sweep, wheel

Knots = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class Shape:
    """Measures of a car body.

    length, width, height : metres, overall. clearance : height of the underside.
    profile : side view of the upper edge, pairs of (share of the length from the nose, share of the height).
    belt : height of the lower edge of the windows at nose and rear, as a share of the height.
    tumble : how far the sides lean inward above it, metres a metre. bulge : how far they belly out, as a share of the width.
    nose, rear : how rounded the ends are seen from above, 0 to 1.
    smooth : how much the profile's corners are rounded, as a share of the length.
    front_axle, rear_axle : shares of the length. radius, tyre : radius and width of the wheels.
    inset : of the wheels' outer faces from the widest point. arch : radius of the wheel arches in wheel radii, 0 without.
    hollow : (from, to, depth), where the top is open downward: shares of the length and metres.
    """

    length: float
    width: float
    height: float
    clearance: float
    profile: Knots
    belt: tuple[float, float] = (0.6, 0.64)
    tumble: float = 0.35
    nose: float = 0.5
    rear: float = 0.4
    smooth: float = 0.03
    bulge: float = 0.04
    front_axle: float = 0.19
    rear_axle: float = 0.79
    radius: float = 0.31
    tyre: float = 0.2
    inset: float = 0.02
    arch: float = 1.15
    hollow: tuple[float, float, float] | None = None

    def top(self, s: Array | float) -> Array:
        """Height of the upper edge at share ``s`` of the length, corners rounded."""
        knots = np.array(self.profile)
        at = np.asarray(s, dtype=np.float64)
        offsets = np.linspace(-1.0, 1.0, 9) * self.smooth
        around = np.clip(at[..., None] + offsets, 0.0, 1.0)
        return np.interp(around, knots[:, 0], knots[:, 1]).mean(axis=-1) * self.height

    def half_width(self, s: Array | float) -> Array:
        """Half the width at the belt at share ``s`` of the length."""
        at = np.asarray(s, dtype=np.float64)
        front = 1.0 - 0.5 * self.nose * np.clip(1.0 - at / 0.2, 0.0, 1.0) ** 3
        behind = 1.0 - 0.45 * self.rear * np.clip(1.0 - (1.0 - at) / 0.2, 0.0, 1.0) ** 3
        return self.width / 2.0 * front * behind

    def z(self, s: Array | float) -> Array:
        return (0.5 - np.asarray(s, dtype=np.float64)) * self.length

    def mesh(self, open_below: bool = False) -> Mesh:
        """The body; without its underside where ``open_below``."""
        reach = self.arch * self.radius / self.length
        around = np.linspace(-1.0, 1.0, 7) * 0.999 * reach
        ends = np.array([0.004, 0.015, 0.035, 0.06])
        s = np.concatenate([np.linspace(0, 1, 13), ends, 1.0 - ends, [k for k, _ in self.profile]])
        if self.arch:
            s = np.concatenate([s, self.front_axle + around, self.rear_axle + around])
        if self.hollow:
            s = np.concatenate([s, np.array(self.hollow[:2]), np.array(self.hollow[:2]) + [-0.004, 0.004]])
        s = np.unique(np.round(np.clip(s, 0.0, 1.0), 5))
        wide, top = self.half_width(s), self.top(s)
        low = self.clearance + 0.35 * (top.min() - self.clearance) * (
            np.clip(1 - s / 0.08, 0, 1) ** 2 + np.clip(1 - (1 - s) / 0.08, 0, 1) ** 2
        )
        belt = np.minimum(np.interp(s, [0, 1], self.belt) * self.height, top - 0.015)
        side = np.full_like(s, 0.0) + low
        for axle in (self.front_axle, self.rear_axle) if self.arch else ():
            away = (s - axle) * self.length
            rim = self.radius + np.sqrt(np.clip((self.arch * self.radius) ** 2 - away**2, 0.0, None))
            side = np.where(np.abs(away) < self.arch * self.radius, np.maximum(rim, side), side)
        side = np.minimum(side, low + 0.92 * (belt - low))
        inner = np.maximum(wide - self.inset - 1.25 * self.tyre, 0.3 * wide)
        glass = top - belt
        crown = np.minimum(0.35 * glass, 0.06)
        edge = np.maximum(wide - self.tumble * glass, 0.25 * wide)
        bulge = self.bulge * wide
        mid = side + 0.45 * (belt - side)
        floor = top.copy()
        rim_x = 0.6 * edge
        if self.hollow:
            inside = (s >= self.hollow[0]) & (s <= self.hollow[1])
            floor = np.where(inside, np.maximum(top - self.hollow[2], low + 0.05), top)
            rim_x = np.where(inside, 0.88 * edge, rim_x)
        zero = 0.004 * wide
        points = [
            (zero, low),
            (inner, low),
            (inner, side),
            (wide - bulge, side),
            (wide, mid),
            (wide - 0.3 * bulge, belt - 0.15 * (belt - mid)),
            (wide - bulge, belt),
            ((wide - bulge + edge) / 2.0, belt + 0.5 * (glass - crown)),
            (edge, top - crown),
            (edge - 0.7 * crown, top - 0.15 * crown),
            (rim_x, floor),
            (zero, floor),
        ]
        half = np.stack([np.stack(np.broadcast_arrays(x, y), axis=-1) for x, y in points], axis=1)
        ring = np.concatenate([half, half[:, ::-1] * [-1.0, 1.0]], axis=1)
        z = np.broadcast_to(self.z(s)[:, None], ring.shape[:2])
        body = loft(np.concatenate([ring, z[..., None]], axis=-1))
        if open_below:
            # The first and last two points of every outline are the underside.
            at = body.faces % ring.shape[1]
            below = ((at < 2) | (at >= ring.shape[1] - 2)).all(axis=1)
            body = Mesh(body.vertices, body.faces[~below])
        return body

    def wheels(self, rng: np.random.Generator) -> list[Mesh]:
        """Four wheels; those with a rim are hollow."""
        hub = rng.uniform(0.45, 0.75)
        x = self.width / 2.0 - self.inset - self.tyre / 2.0
        parts = []
        for axle in (self.front_axle, self.rear_axle):
            parts += both(wheel((x, self.radius, float(self.z(axle))), self.radius, self.tyre, 0, 18, hub))
        return parts


def extras(rng: np.random.Generator, shape: Shape, share: float = 1.0) -> list[Mesh]:
    """Mirrors, bumpers, lamps, rails, spoilers, signs: each with some chance, times ``share``."""
    parts: list[Mesh] = []
    half, high = shape.width / 2.0, shape.height
    front, rear = float(shape.z(0.0)), float(shape.z(1.0))
    if chance(rng, 0.6 * share):
        belt = shape.belt[0] * high + 0.08
        z = float(shape.z(rng.uniform(0.3, 0.36)))
        parts += both(cushion((rng.uniform(0.12, 0.22), rng.uniform(0.1, 0.16), 0.09), (half * 0.97 + 0.07, belt, z), 0.8, 3))
    if chance(rng, 0.35 * share):
        y, thick = shape.clearance + 0.15 * high, rng.uniform(0.08, 0.2)
        for z, s in ((front, 0.02), (rear, 0.98)):
            parts.append(cushion((2.0 * float(shape.half_width(s)) * 1.05, thick, 0.16), (0, y + 0.05, z), 0.4, 8))
    if chance(rng, 0.25 * share):
        x = half * rng.uniform(0.6, 0.75)
        parts += both(ellipsoid((0.1, 0.09, 0.07), (x, 0.42 * high, front - 0.04)))
    if chance(rng, 0.2 * share):
        along = np.linspace(0.46, 0.66, 5)
        path = np.stack([np.full(5, half * 0.6), shape.top(along) + 0.02, shape.z(along)], axis=1)
        parts += both(sweep(path, np.array([[-0.02, -0.025], [0.02, -0.025], [0.02, 0.025], [-0.02, 0.025]]), side=(1, 0, 0)))
    if chance(rng, 0.1 * share):
        width = rng.choice([0.3, 0.9]) * shape.width * 0.7
        s = rng.uniform(0.48, 0.6)
        parts.append(box((width, 0.13, 0.18), (0, float(shape.top(s)) + 0.05, float(shape.z(s))), (0.9, 0.6)))
    if chance(rng, 0.14 * share):
        deck = float(shape.top(0.95))
        rise = rng.uniform(0.05, 0.25)
        parts.append(box((shape.width * rng.uniform(0.75, 1.0), 0.035, rng.uniform(0.15, 0.3)), (0, deck + rise, rear + 0.15)))
        parts += both(box((0.04, rise + 0.06, 0.12), (half * 0.65, deck + rise / 2 - 0.03, rear + 0.16)))
    if chance(rng, 0.15 * share) and float(shape.top(0.96)) > 0.75 * high:
        parts.append(wheel((0, 0.55 * high, rear - 0.08), shape.radius * 0.9, 0.18, 2))
    if chance(rng, 0.12 * share):
        parts += both(
            rod((half * 0.5, shape.clearance + 0.03, rear + 0.2), (half * 0.5, shape.clearance + 0.03, rear - 0.04), 0.035)
        )
    return parts


def interior(rng: np.random.Generator, shape: Shape) -> list[Mesh]:
    """Seats and a dashboard."""
    parts = []
    seat = shape.clearance + 0.22
    rows = (0.47, 0.64) if shape.length > 3.4 and chance(rng, 0.7) else (0.5,)
    for s in rows:
        z = float(shape.z(s))
        size = (0.26 * shape.width, 0.14, 0.48)
        parts += both(cushion(size, (0.23 * shape.width, seat, z), 0.5, 6))
        parts += both(
            box(
                (size[0], 0.32 * shape.height, 0.12),
                (0.23 * shape.width, seat + 0.18 * shape.height, z - 0.26),
                (0.8, 0.8),
                (0, -0.06),
            )
        )
    s = rows[0] - 0.13
    parts.append(box((0.8 * shape.width, 0.2, 0.25), (0, 0.5 * shape.height, float(shape.z(s))), (0.95, 0.6)))
    return parts


def fender(centre: tuple[float, float, float], radius: float, width: float, front: float, rear: float) -> Mesh:
    """A mudguard bent over a wheel, from angle ``front`` to ``rear`` in radians (0 is forward, pi/2 up)."""
    t = np.linspace(front, rear, 11)
    path = np.array(centre) + radius * np.stack([0 * t, np.sin(t), np.cos(t)], axis=1)
    return sweep(path, np.array([[-0.5, 0.0], [0.5, 0.0], [0.5, 0.12], [-0.5, 0.12]]) * [width, radius * 0.5], side=(1, 0, 0))
