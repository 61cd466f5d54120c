"""Aeroplanes, nose toward -x, symmetric about z = 0. Unit: the length of the fuselage."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ...io.meshes import Mesh
from .parts import (
    X_AXIS,
    Array,
    Range,
    both,
    chance,
    draw,
    ellipsoid,
    loft,
    oval,
    pick,
    rectangle,
    rod,
    sweep,
    turned,
    wheel,
)

# Standard deviation of the logarithms by which an aeroplane is stretched along x, y and z.
SPREAD = 0.06


class Kind(NamedTuple):
    """How often a kind of aeroplane is drawn, weights of its tails and engines, and what it has.

    rounded : chance of round wing tips. gear : of wheels. canopy : ranges of the x, length and height of a glass hood.
    """

    weight: float
    tails: dict[str, float]
    engines: dict[str, float]
    rounded: float = 0.0
    gear: float = 0.5
    canopy: tuple[Range, Range, Range] | None = None


CABIN = ((-0.18, -0.05), (0.25, 0.45), (0.02, 0.07))
KINDS = {
    "airliner": Kind(20, {"low": 1}, {"under": 1}),
    "rear jet": Kind(14, {"t": 5, "cross": 1}, {"rear": 1}),
    "turboprop": Kind(8, {"low": 3, "t": 2, "cross": 1}, {"wing": 1}, 0.3),
    "transport": Kind(8, {"t": 3, "low": 2}, {"under": 1, "wing": 1}),
    "low wing": Kind(11, {"low": 5, "t": 1, "cross": 1}, {"nose": 2, "wing": 1}, 0.5, 0.7, CABIN),
    "high wing": Kind(11, {"low": 6, "t": 1}, {"nose": 3, "wing": 1}, 0.5, 0.7, CABIN),
    "warbird": Kind(
        8, {"low": 1}, {"nose": 1}, 1.0, 0.5, ((-0.08, 0.06), (0.14, 0.3), (0.02, 0.05))
    ),
    "glider": Kind(
        3, {"t": 3, "low": 1}, {"none": 1}, 1.0, 0.0, ((-0.26, -0.2), (0.2, 0.26), (0.01, 0.02))
    ),
}
WEIGHTS = {name: kind.weight for name, kind in KINDS.items()}
# Ranges of the fields of `Body`; the second column is the height over the width.
BODIES: dict[str, tuple[Range, ...]] = {
    "airliner": (
        (0.075, 0.14),
        (0.95, 1.15),
        (0.08, 0.16),
        (0.3, 0.4),
        (0.5, 0.7),
        (0.05, 0.2),
        (0.5, 0.9),
        (0, 0.4),
        (2, 2),
    ),
    "rear jet": (
        (0.08, 0.14),
        (1, 1.15),
        (0.1, 0.28),
        (0.3, 0.5),
        (0.5, 0.7),
        (0.05, 0.2),
        (0.4, 0.8),
        (0.1, 0.5),
        (2, 2),
    ),
    "turboprop": (
        (0.09, 0.15),
        (0.95, 1.3),
        (0.13, 0.25),
        (0.3, 0.5),
        (0.5, 0.7),
        (0.05, 0.2),
        (0.4, 0.9),
        (0.2, 0.6),
        (2, 3),
    ),
    "transport": (
        (0.11, 0.17),
        (1, 1.2),
        (0.1, 0.2),
        (0.35, 0.5),
        (0.5, 0.7),
        (0.1, 0.2),
        (0.7, 1),
        (0.2, 0.4),
        (2, 3.5),
    ),
    "low wing": (
        (0.11, 0.18),
        (1, 1.4),
        (0.18, 0.35),
        (0.5, 0.65),
        (0.35, 0.7),
        (0.05, 0.2),
        (0, 0.7),
        (0, 0.5),
        (2.2, 5),
    ),
    "high wing": (
        (0.11, 0.18),
        (1, 1.4),
        (0.18, 0.35),
        (0.5, 0.65),
        (0.35, 0.7),
        (0.05, 0.2),
        (0, 0.7),
        (0, 0.5),
        (2.2, 5),
    ),
    "warbird": (
        (0.085, 0.15),
        (1.1, 1.5),
        (0.1, 0.3),
        (0.5, 0.65),
        (0.3, 0.6),
        (0.08, 0.08),
        (0.1, 0.5),
        (0, 0.2),
        (2, 2),
    ),
    "glider": (
        (0.07, 0.11),
        (1.1, 1.4),
        (0.25, 0.35),
        (0.5, 0.62),
        (0.6, 0.6),
        (0.15, 0.3),
        (0.2, 0.7),
        (0.3, 0.3),
        (2, 2),
    ),
}
# Ranges of the wing: x of the root's leading edge, its height in body heights, half span, root chord, tip over root chord,
# tangents of the leading edge's sweep and of the dihedral, and thickness in chords.
WINGS: dict[str, tuple[Range, ...]] = {
    "airliner": (
        (-0.16, -0.02),
        (-0.32, -0.32),
        (0.38, 0.54),
        (0.16, 0.25),
        (0.15, 0.35),
        (0.4, 0.75),
        (0, 0.14),
        (0.1, 0.13),
    ),
    "rear jet": (
        (-0.1, 0.04),
        (-0.38, -0.32),
        (0.4, 0.56),
        (0.15, 0.24),
        (0.2, 0.45),
        (0.1, 0.6),
        (0.03, 0.12),
        (0.1, 0.12),
    ),
    "turboprop": (
        (-0.2, -0.08),
        (-0.35, -0.3),
        (0.5, 0.68),
        (0.13, 0.22),
        (0.4, 0.9),
        (0, 0.12),
        (0, 0.12),
        (0.12, 0.17),
    ),
    "transport": (
        (-0.2, -0.08),
        (0.42, 0.46),
        (0.46, 0.66),
        (0.16, 0.24),
        (0.25, 0.6),
        (0, 0.6),
        (-0.08, 0.06),
        (0.12, 0.14),
    ),
    "low wing": (
        (-0.28, -0.14),
        (-0.4, -0.35),
        (0.52, 0.78),
        (0.17, 0.25),
        (0.45, 1),
        (-0.02, 0.1),
        (0, 0.14),
        (0.11, 0.16),
    ),
    "high wing": (
        (-0.28, -0.14),
        (0.45, 0.6),
        (0.52, 0.78),
        (0.17, 0.25),
        (0.45, 1),
        (-0.02, 0.1),
        (0, 0.1),
        (0.11, 0.16),
    ),
    "warbird": (
        (-0.26, -0.16),
        (-0.35, -0.35),
        (0.5, 0.66),
        (0.22, 0.32),
        (0.45, 0.75),
        (0, 0.12),
        (0.05, 0.14),
        (0.12, 0.12),
    ),
    "glider": (
        (-0.2, -0.1),
        (0, 0.4),
        (0.9, 1.35),
        (0.11, 0.15),
        (0.3, 0.6),
        (-0.02, 0.03),
        (0, 0.08),
        (0.13, 0.13),
    ),
}


@dataclass(frozen=True)
class Body:
    """A fuselage from x = -0.5 (nose) to 0.5 (tail), its axis near y = 0.

    width, height : largest. nose, tail : shares of the length over which it narrows. blunt : 0.5 a round nose, 1 a cone.
    tip : size of the tail's end as a share. rise, droop : how far the tail's end lies above and the nose's tip below the axis,
    in half heights. square : power of the cross-section, see `superellipse`.
    """

    width: float
    height: float
    nose: float = 0.15
    tail: float = 0.35
    blunt: float = 0.6
    tip: float = 0.1
    rise: float = 0.6
    droop: float = 0.2
    square: float = 2.0

    def size(self, x: ArrayLike) -> Array:
        """Width and height at ``x`` as a share of the largest."""
        toward_nose, toward_tail = self._ends(x)
        front = np.clip(1.0 - toward_nose**2, 0.0, 1.0) ** self.blunt
        return np.maximum(front * (1.0 - (1.0 - self.tip) * toward_tail), 0.03)

    def axis(self, x: ArrayLike) -> Array:
        """Height of the middle of the cross-section at ``x``."""
        toward_nose, toward_tail = self._ends(x)
        return (toward_tail * self.rise - toward_nose**2 * self.droop) * self.height / 2.0

    def _ends(self, x: ArrayLike) -> tuple[Array, Array]:
        """How far ``x`` lies in the nose and in the tail, 0 to 1."""
        s = np.clip(np.asarray(x, dtype=np.float64) + 0.5, 0.0, 1.0)
        return 1.0 - np.clip(s / self.nose, 0.0, 1.0), np.clip(
            (s - 1.0 + self.tail) / self.tail, 0.0, 1.0
        ) ** 1.5

    def at(self, x: float, up: float = 0.0, out: float = 0.0) -> Array:
        """The point [3] at ``x``, ``up`` half heights above the axis and ``out`` half widths beside it."""
        size = float(self.size(x)) / 2.0
        return np.array([x, float(self.axis(x)) + up * size * self.height, out * size * self.width])

    def mesh(self, sides: int = 20) -> Mesh:
        front, behind = np.linspace(0, 1, 9) ** 1.7 * self.nose, np.linspace(1 - self.tail, 1, 9)
        x = (
            np.unique(np.concatenate([front, np.linspace(self.nose, 1 - self.tail, 4), behind]))
            - 0.5
        )
        outline = self.size(x)[:, None, None] * oval(
            self.width / 2.0, self.height / 2.0, self.square, sides
        )
        y = outline[..., 1] + self.axis(x)[:, None]
        return loft(np.stack([np.broadcast_to(x[:, None], y.shape), y, outline[..., 0]], axis=-1))


CHORD = np.array([1.0, 0.75, 0.45, 0.2, 0.06, 0.0])
# Half thickness of the NACA four-digit profile at these shares of the chord, over the thickness.
HALF = 5.0 * (
    0.2969 * np.sqrt(CHORD)
    - 0.126 * CHORD
    - 0.3516 * CHORD**2
    + 0.2843 * CHORD**3
    - 0.1015 * CHORD**4
)


def surface(
    root: Array, span: Array, chord: float, tip: float, thick: float = 0.09, rounding: float = 0.0
) -> Mesh:
    """A wing, tailplane or fin.

    root, span : [3] start of the leading edge, and the way from there to the tip.
    chord, tip : lengths of the profile along +x at root and tip; ``thick`` its thickness in chords.
    rounding : 0 a straight tip, else the exponent of the outline.
    """
    t = np.linspace(0.0, 1.0, 11) ** 0.6 if rounding else np.linspace(0.0, 1.0, 4)
    shrink = np.maximum(np.sqrt(1.0 - t**rounding), 0.12) if rounding else np.ones(4)
    chords = ((chord + (tip - chord) * t) * shrink)[:, None]
    edge = root + t[:, None] * span
    # A round tip is cut off in front too.
    profile = (
        edge[:, None] + ((CHORD + 0.3 * (1.0 / shrink[:, None] - 1.0)) * chords)[..., None] * X_AXIS
    )
    normal = np.cross(span, X_AXIS)
    lift = (np.maximum(HALF, 0.03) * thick * chords)[..., None] * normal / np.linalg.norm(normal)
    return loft(np.concatenate([profile + lift, (profile - lift)[:, ::-1]], axis=1))


def build(rng: np.random.Generator, name: str) -> list[Mesh]:
    """The parts of an aeroplane of a kind in `KINDS`."""
    kind = KINDS[name]
    width, height, *rest = draw(rng, BODIES[name])
    body = Body(width, width * height, *rest)
    x, y, semi, chord, taper, sweep, rise, thick = draw(rng, WINGS[name])
    root = np.array([x, y * body.height, 0.25 * body.width])
    span = np.array([sweep, rise, 1.0]) * (semi - root[2])
    rounding = 14.0 if chance(rng, kind.rounded) else 0.0
    parts = [body.mesh(), *both(surface(root, span, chord, taper * chord, thick, rounding), 2)]
    parts += _tail(rng, body, pick(rng, kind.tails))
    parts += _engines(rng, pick(rng, kind.engines), body, root, span)
    if kind.canopy:
        x, length, high = draw(rng, kind.canopy)
        radii = (length / 2.0, high + 0.25 * body.height, 0.4 * body.width * float(body.size(x)))
        parts.append(ellipsoid(radii, body.at(x, 1.0) - [0.0, 0.25 * body.height, 0.0], 9, 12))
    if chance(rng, kind.gear):
        parts += _gear(rng, body, root[0] + 0.7 * chord)
    return parts


def _tail(rng: np.random.Generator, body: Body, kind: str) -> list[Mesh]:
    """Fin and tailplane: low, t or cross."""
    high, chord, sweep = rng.uniform(0.11, 0.19), rng.uniform(0.11, 0.2), rng.uniform(0.1, 0.9)
    rounding = 5.0 if sweep < 0.4 and chance(rng, 0.5) else 0.0
    x = 0.5 - chord - rng.uniform(0.0, 0.05)
    root, span = (
        body.at(x + 0.6 * chord, 1.0) - [0.6 * chord, 0.015, 0.0],
        np.array([sweep, 1.0, 0.0]) * high,
    )
    tip = chord * rng.uniform(0.3, 0.6)
    parts = [surface(root, span, chord, tip, 0.09, rounding)]
    flat, semi = chord * rng.uniform(0.6, 0.85), rng.uniform(0.14, 0.22)
    if kind == "low":
        start = body.at(0.5 - flat - rng.uniform(0.0, 0.08), rng.uniform(0.0, 0.3), 0.3)
    else:
        start = root + span * (0.97 if kind == "t" else rng.uniform(0.3, 0.6))
    plane = np.array([sweep * rng.uniform(0.5, 0.9), rng.uniform(-0.05, 0.12), 1.0]) * semi
    return parts + both(
        surface(start, plane, flat, flat * rng.uniform(0.4, 0.8), 0.09, rounding), 2
    )


# Radii over the largest at shares of the length: jet engines, propeller engines.
JET = (
    [0.18, 0.03, 0.0, 0.06, 0.35, 0.72, 1.0, 0.92],
    [0.05, 0.82, 0.9, 1.0, 1.03, 0.82, 0.5, 0.08],
)
PISTON = ([0.0, 0.04, 0.2, 0.5, 0.8, 1.0], [0.3, 0.65, 1.0, 0.95, 0.55, 0.1])


def _engines(
    rng: np.random.Generator, kind: str, body: Body, root: Array, span: Array
) -> list[Mesh]:
    """Engines under or on the wing, beside the rear fuselage or in the nose."""
    radius, length = (
        rng.uniform(0.022, 0.042),
        rng.uniform(0.1, 0.2) * (1.4 if kind == "wing" else 1.0),
    )
    blade, disc = rng.uniform(0.06, 0.12), chance(rng, 0.5)
    parts: list[Mesh] = []
    if kind == "nose":
        return _propeller(rng, body.at(-0.5), 1.5 * blade, 0.028, disc)
    if kind in ("under", "wing"):
        for share in (rng.uniform(0.28, 0.38), rng.uniform(0.56, 0.68))[: 1 + chance(rng, 0.3)]:
            edge, down = root + share * span, 1.1 * radius if kind == "under" else 0.0
            front = edge - [rng.uniform(0.3, 0.6) * length, down, 0.0]
            parts.append(_body_of(JET if kind == "under" else PISTON, front, length, radius))
            if kind == "under":
                pylon = rectangle(0.008, 0.05)
                parts.append(
                    sweep(
                        [front + [0.5 * length, 0.0, 0.0], edge + [0.05, 0.0, 0.0]],
                        pylon,
                        side=(0, 0, 1),
                    )
                )
            else:
                parts += _propeller(rng, front, blade, 0.5 * radius, disc)
    elif kind == "rear":
        front = body.at(rng.uniform(0.1, 0.25), 0.3, 1.0) + [0.0, 0.0, 0.9 * radius]
        middle = front + [0.4 * length, 0.0, 0.0]
        parts = [_body_of(JET, front, length, radius)]
        parts.append(
            sweep([middle * [1, 1, 0], middle], rectangle(0.5 * length, 0.014), side=X_AXIS)
        )
    return both(parts, 2)


def _body_of(
    outline: tuple[list[float], list[float]], front: Array, length: float, radius: float
) -> Mesh:
    """The body of revolution of an outline, from ``front`` along +x."""
    return turned(front, front + [length, 0.0, 0.0], outline[0], radius * np.array(outline[1]), 14)


def _propeller(
    rng: np.random.Generator, centre: Array, radius: float, hub: float, disc: bool
) -> list[Mesh]:
    """Spinner and blades before ``centre``, or the disc that turning blades look like."""
    spinner = np.array([0.1, 0.6, 0.95, 1.0]) * hub
    parts = [
        turned(centre - [2.0 * hub, 0, 0], centre + [0.3 * hub, 0, 0], [0, 0.3, 0.7, 1], spinner)
    ]
    centre = centre - [0.4 * hub, 0.0, 0.0]
    if disc:
        return [
            *parts,
            rod(centre - [0.05 * hub, 0, 0], centre + [0.1 * hub, 0, 0], radius, sides=24),
        ]
    blades, section = int(rng.integers(2, 5)), rectangle(0.1 * radius, 0.03 * radius)
    for angle in rng.uniform(0, np.pi) + 2 * np.pi * np.arange(blades) / blades:
        out = np.array([0.0, np.cos(angle), np.sin(angle)])
        parts.append(
            sweep(
                [centre, centre + out * radius],
                section,
                [1.0, 0.7],
                np.cross(out, X_AXIS) + 0.4 * X_AXIS,
            )
        )
    return parts


def _gear(rng: np.random.Generator, body: Body, x: float) -> list[Mesh]:
    """Main wheels on legs at ``x``, and a wheel under the nose."""
    radius, out = rng.uniform(0.014, 0.035), rng.uniform(0.07, 0.2)
    width, low, leg = (
        0.7 * radius,
        -0.5 * body.height - rng.uniform(0.05, 0.11),
        rng.uniform(0.15, 0.3) * radius,
    )
    foot, head = np.array([x, low + radius, out]), body.at(x, -0.4) + [0.0, 0.0, 0.6 * out]
    parts = both([rod(head, foot, leg * 1.3, leg, 6), wheel(foot, radius, width, 2, 12)], 2)
    under = body.at(rng.uniform(-0.42, -0.34), -0.9)
    third = under * [1, 0, 1] + [0.0, low + radius, 0.0]
    return [*parts, rod(under, third, leg, sides=6), wheel(third, 0.9 * radius, width, 2, 12)]
