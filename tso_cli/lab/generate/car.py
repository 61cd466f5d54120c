"""Cars, front +z, symmetric about x = 0, ground at y = 0. Lengths in metres."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ...io.meshes import Mesh
from .parts import Array, Range, both, box, chance, cushion, draw, loft, wheel

# Standard deviation of the logarithms by which a car is stretched along x, y and z.
SPREAD = 0.05
# Side views: shares of the length from the nose, and of the height there.
PROFILES: dict[str, tuple[list[float], list[float]]] = {
    "sedan": (
        [0, 0.03, 0.28, 0.43, 0.52, 0.66, 0.82, 0.97, 1],
        [0.42, 0.52, 0.63, 0.96, 1, 0.97, 0.69, 0.65, 0.5],
    ),
    "hatch": (
        [0, 0.04, 0.25, 0.42, 0.54, 0.82, 0.96, 1],
        [0.42, 0.53, 0.65, 0.97, 1, 0.93, 0.65, 0.45],
    ),
    "suv": ([0, 0.02, 0.26, 0.37, 0.46, 0.9, 0.98, 1], [0.45, 0.6, 0.66, 0.97, 1, 0.97, 0.65, 0.4]),
    "van": (
        [0, 0.04, 0.12, 0.27, 0.34, 0.97, 0.995, 1],
        [0.35, 0.45, 0.53, 0.94, 1, 0.98, 0.9, 0.5],
    ),
    "pickup": (
        [0, 0.02, 0.26, 0.36, 0.4, 0.54, 0.585, 0.99, 1],
        [0.45, 0.57, 0.62, 0.97, 1, 0.98, 0.63, 0.62, 0.5],
    ),
    "sports": (
        [0, 0.04, 0.34, 0.5, 0.57, 0.68, 0.9, 0.98, 1],
        [0.3, 0.48, 0.68, 0.97, 1, 0.95, 0.73, 0.7, 0.5],
    ),
    "wedge": (
        [0, 0.1, 0.3, 0.46, 0.55, 0.66, 0.8, 0.99, 1],
        [0.28, 0.45, 0.62, 0.97, 1, 0.9, 0.75, 0.7, 0.4],
    ),
    "round": (
        [0, 0.08, 0.3, 0.4, 0.52, 0.66, 0.85, 0.96, 1],
        [0.3, 0.52, 0.62, 0.92, 1, 0.93, 0.62, 0.4, 0.28],
    ),
    "box": (
        [0, 0.005, 0.28, 0.38, 0.42, 0.72, 0.84, 0.995, 1],
        [0.55, 0.6, 0.62, 0.99, 1, 1, 0.63, 0.62, 0.55],
    ),
}
NUMBERS = (
    "length",
    "width",
    "height",
    "clearance",
    "radius",
    "smooth",
    "tumble",
    "nose",
    "rear",
    "bulge",
    "inset",
)
# Ranges of the first six of these fields of `Shape`.
SIZES: dict[str, tuple[Range, ...]] = {
    "sedan": ((4.2, 5.1), (1.65, 1.9), (1.36, 1.52), (0.14, 0.22), (0.29, 0.35), (0.01, 0.06)),
    "hatch": ((3.5, 4.4), (1.55, 1.85), (1.38, 1.58), (0.14, 0.22), (0.28, 0.34), (0.01, 0.06)),
    "suv": ((4.0, 5.0), (1.75, 2.0), (1.6, 1.95), (0.2, 0.32), (0.34, 0.42), (0.01, 0.04)),
    "van": ((4.2, 6.2), (1.7, 2.1), (1.85, 2.7), (0.18, 0.3), (0.31, 0.38), (0.01, 0.04)),
    "pickup": ((4.6, 5.6), (1.7, 2.05), (1.6, 1.95), (0.22, 0.38), (0.34, 0.44), (0.008, 0.03)),
    "sports": ((3.9, 4.8), (1.7, 2.0), (1.1, 1.34), (0.1, 0.17), (0.3, 0.36), (0.03, 0.08)),
    "wedge": ((4.0, 4.7), (1.8, 2.05), (1.0, 1.22), (0.09, 0.15), (0.3, 0.36), (0.01, 0.06)),
    "round": ((3.6, 4.4), (1.5, 1.85), (1.4, 1.6), (0.15, 0.25), (0.28, 0.36), (0.05, 0.1)),
    "box": ((3.6, 5.0), (1.5, 2.1), (1.2, 1.7), (0.14, 0.35), (0.26, 0.42), (0.0, 0.02)),
}
WEIGHTS = {
    "sedan": 20, "hatch": 15, "suv": 12, "van": 8, "pickup": 5, "sports": 12, "wedge": 6, "round": 10, "box": 6,
}  # fmt: skip
# Ranges of the others: of most cars, and of kinds with a form of their own.
FORM: tuple[Range, ...] = ((0.15, 0.55), (0.1, 0.9), (0.1, 0.8), (0.0, 0.09), (-0.02, 0.06))
FORMS: dict[str, tuple[Range, ...]] = {
    "van": ((0.02, 0.2), (0.2, 0.8), (0.0, 0.2), (0.0, 0.09), (-0.02, 0.06)),
    "sports": ((0.4, 0.8), (0.4, 1.0), (0.1, 0.8), (0.03, 0.1), (-0.02, 0.06)),
    "pickup": ((0.15, 0.55), (0.1, 0.9), (0.0, 0.15), (0.0, 0.09), (-0.02, 0.06)),
    "box": ((0.0, 0.4), (0.0, 0.2), (0.0, 0.2), (0.0, 0.03), (-0.2, 0.04)),
    "round": ((0.3, 0.6), (0.5, 1.2), (0.5, 1.2), (0.05, 0.15), (-0.02, 0.06)),
}


@dataclass(frozen=True)
class Shape:
    """A car body of one loft from nose to rear.

    profile : [K, 2] side view of the upper edge: shares of the length from the nose, and of the height. smooth : how much its
    corners are rounded, as a share of the length. belt : heights of the windows' lower edge at nose and rear, as shares of the
    height. tumble : slope of the sides above it. nose, rear : how rounded the ends are seen from above. bulge : how far the
    sides belly out, as a share of the width. inset : of the wheels' outer faces. axles : shares of the length. arch : radius of
    the wheel arches in wheel radii, 0 without. hollow : (from, to, depth) of a pickup's bed: shares of the length, metres.
    """

    length: float
    width: float
    height: float
    clearance: float
    radius: float
    smooth: float
    profile: Array
    belt: Range
    tumble: float
    nose: float
    rear: float
    bulge: float
    inset: float
    axles: Range
    tyre: float
    arch: float
    hollow: tuple[float, float, float] | None = None

    def top(self, s: Array | float) -> Array:
        """Height of the upper edge at share ``s`` of the length, corners rounded."""
        around = np.clip(
            np.asarray(s, dtype=np.float64)[..., None] + np.linspace(-1.0, 1.0, 9) * self.smooth,
            0.0,
            1.0,
        )
        heights: Array = np.interp(around, *self.profile.T).mean(axis=-1) * self.height
        return heights

    def half_width(self, s: Array | float) -> Array:
        """Half the width at the belt."""
        at = np.asarray(s, dtype=np.float64)
        front = 1.0 - 0.5 * self.nose * np.clip(1.0 - at / 0.2, 0.0, 1.0) ** 3
        behind = 1.0 - 0.45 * self.rear * np.clip(1.0 - (1.0 - at) / 0.2, 0.0, 1.0) ** 3
        return self.width / 2.0 * front * behind

    def z(self, s: Array | float) -> Array:
        return (0.5 - np.asarray(s, dtype=np.float64)) * self.length

    def mesh(self) -> Mesh:
        s = self._stations()
        wide, top = self.half_width(s), self.top(s)
        ends = (
            np.clip(1.0 - s / 0.08, 0.0, 1.0) ** 2 + np.clip(1.0 - (1.0 - s) / 0.08, 0.0, 1.0) ** 2
        )
        low = self.clearance + 0.35 * (top.min() - self.clearance) * ends
        belt = np.minimum(np.interp(s, [0, 1], self.belt) * self.height, top - 0.015)
        # The lower edge of the sides, raised over the wheels.
        side, reach = low, self.arch * self.radius
        for axle in self.axles:
            away = np.abs(s - axle) * self.length
            rim = self.radius + np.sqrt(np.clip(reach**2 - away**2, 0.0, None))
            side = np.where(away < reach, np.maximum(rim, side), side)
        side = np.minimum(side, low + 0.92 * (belt - low))
        inner = np.maximum(wide - self.inset - 1.25 * self.tyre, 0.3 * wide)
        glass, bulge, mid = top - belt, self.bulge * wide, side + 0.45 * (belt - side)
        crown = np.minimum(0.35 * glass, 0.06)
        edge = np.maximum(wide - self.tumble * glass, 0.25 * wide)
        floor, rim_x, middle = top, 0.6 * edge, 0.004 * wide
        if self.hollow:
            inside = (s >= self.hollow[0]) & (s <= self.hollow[1])
            floor = np.where(inside, np.maximum(top - self.hollow[2], low + 0.05), top)
            rim_x = np.where(inside, 0.88 * edge, rim_x)
        x = [
            middle,
            inner,
            inner,
            wide - bulge,
            wide,
            wide - 0.3 * bulge,
            wide - bulge,
            (wide - bulge + edge) / 2.0,
            edge,
        ]
        y = [
            low,
            low,
            side,
            side,
            mid,
            belt - 0.15 * (belt - mid),
            belt,
            belt + 0.5 * (glass - crown),
            top - crown,
        ]
        x, y = [*x, edge - 0.7 * crown, rim_x, middle], [*y, top - 0.15 * crown, floor, floor]
        half = np.stack([np.stack(x, 1), np.stack(y, 1)], axis=-1)
        ring = np.concatenate([half, half[:, ::-1] * [-1.0, 1.0]], axis=1)
        z = np.broadcast_to(self.z(s)[:, None, None], (*ring.shape[:2], 1))
        return loft(np.concatenate([ring, z], axis=-1))

    def _stations(self) -> Array:
        """Shares of the length at which the body has an outline."""
        ends, arch = (
            np.array([0.004, 0.015, 0.035, 0.06]),
            0.999 * self.arch * self.radius / self.length,
        )
        around = np.linspace(-arch, arch, 7)
        s = [
            np.linspace(0, 1, 13),
            ends,
            1.0 - ends,
            self.profile[:, 0],
            *(axle + around for axle in self.axles),
        ]
        if self.hollow:
            s.append(np.array([0.0, -0.004, 0.0, 0.004]) + np.repeat(self.hollow[:2], 2))
        return np.unique(np.round(np.clip(np.concatenate(s), 0.0, 1.0), 5))

    def wheels(self, hub: float) -> list[Mesh]:
        x = self.width / 2.0 - self.inset - self.tyre / 2.0
        return both(
            wheel(
                np.array([x, self.radius, float(self.z(axle))]), self.radius, self.tyre, 0, 18, hub
            )
            for axle in self.axles
        )


def build(rng: np.random.Generator, kind: str) -> list[Mesh]:
    """The parts of a car of a kind in `WEIGHTS`."""
    shape = _shape(rng, kind)
    return [shape.mesh(), *shape.wheels(rng.uniform(0.45, 0.75)), *_extras(rng, shape, kind)]


def _shape(rng: np.random.Generator, kind: str) -> Shape:
    numbers: dict[str, Any] = dict(
        zip(NUMBERS, draw(rng, SIZES[kind] + FORMS.get(kind, FORM)), strict=True)
    )
    knots = np.array(PROFILES[kind]).T
    knots = knots + rng.normal(0.0, 1.0, knots.shape) * [0.018, 0.015]
    # Ends stay ends, the order stays, and the highest point stays 1.
    s = np.maximum.accumulate(np.clip(knots[:, 0], 0.0, 1.0) + np.arange(len(knots)) * 1e-4)
    profile = np.stack([(s - s[0]) / (s[-1] - s[0]), knots[:, 1] / knots[:, 1].max()], axis=1)
    belts = {"van": ((0.4, 0.4), (0.45, 0.45))}
    low, high = draw(rng, belts.get(kind, ((0.54, 0.63), (0.58, 0.68))))
    front, rear, tyre, arch = draw(rng, ((0.155, 0.23), (0.76, 0.83), (0.16, 0.26), (1.06, 1.3)))
    hollow = None
    if kind == "pickup" and chance(rng, 0.8):
        hollow = (rng.uniform(0.59, 0.65), 0.975, rng.uniform(0.3, 0.5))
    if chance(rng, 0.15):
        arch = 0.0
    return Shape(
        **numbers,
        profile=profile,
        belt=(low, high),
        axles=(front, rear),
        tyre=tyre,
        arch=arch,
        hollow=hollow,
    )


def _extras(rng: np.random.Generator, shape: Shape, kind: str) -> list[Mesh]:
    """Mirrors, bumpers, spoiler and spare wheel, each with some chance."""
    parts: list[Mesh] = []
    half, high, rear = shape.width / 2.0, shape.height, float(shape.z(1.0))
    if chance(rng, 0.6):
        mirror = (
            0.97 * half + 0.07,
            shape.belt[0] * high + 0.08,
            float(shape.z(rng.uniform(0.3, 0.36))),
        )
        parts += both(
            cushion((rng.uniform(0.12, 0.22), rng.uniform(0.1, 0.16), 0.09), mirror, 0.8, 3)
        )
    if chance(rng, 0.35):
        y, thick = shape.clearance + 0.15 * high + 0.05, rng.uniform(0.08, 0.2)
        for s in (0.02, 0.98):
            parts.append(
                cushion(
                    (2.1 * float(shape.half_width(s)), thick, 0.16),
                    (0, y, float(shape.z(round(s)))),
                    0.4,
                    8,
                )
            )
    if chance(rng, 0.35 if kind in ("wedge", "sports", "box") else 0.14):
        deck, rise = float(shape.top(0.95)), rng.uniform(0.05, 0.3)
        size = (shape.width * rng.uniform(0.75, 1.0), 0.035, rng.uniform(0.15, 0.4))
        parts.append(box(size, (0, deck + rise, rear + 0.15)))
        parts += both(
            box((0.04, rise + 0.06, 0.12), (half * 0.65, deck + rise / 2 - 0.03, rear + 0.16))
        )
    if float(shape.top(0.96)) > 0.75 * high and chance(rng, 0.15):
        parts.append(wheel(np.array([0, 0.55 * high, rear - 0.08]), shape.radius * 0.9, 0.18, 2))
    return parts
