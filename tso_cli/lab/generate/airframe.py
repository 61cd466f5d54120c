"""Parts of aeroplanes: fuselage, flying surfaces, engines, landing gear. Unit: the length of the fuselage, nose toward -x."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from ...io.meshes import Mesh
from .parts import Array, bar, both, ellipsoid, loft, oval, rod, turned, wheel


@dataclass(frozen=True)
class Body:
    """A fuselage from x = -length/2 (nose) to length/2 (tail), its axis near y = 0.

    width, height : largest, outside. nose, tail : shares of the length over which it narrows. blunt : 0.5 a round nose, 1 a
    cone. tip : size of the tail's end as a share. rise, droop : how far the tail's end lies above and the nose's tip below the
    axis, in half heights. square : power of the cross-section, see `oval`. hump : extra height over the front, as a share.
    """

    width: float
    height: float
    length: float = 1.0
    nose: float = 0.15
    tail: float = 0.35
    blunt: float = 0.6
    tip: float = 0.1
    rise: float = 0.6
    droop: float = 0.2
    square: float = 2.0
    hump: float = 0.0

    def size(self, x: ArrayLike) -> Array:
        """Width and height at ``x`` as a share of the largest."""
        s = np.clip(np.asarray(x, dtype=np.float64) / self.length + 0.5, 0.0, 1.0)
        front = np.clip(1.0 - (1.0 - np.clip(s / self.nose, 0, 1)) ** 2, 0.0, 1.0) ** self.blunt
        behind = 1.0 - (1.0 - self.tip) * np.clip((s - 1.0 + self.tail) / self.tail, 0, 1) ** 1.5
        return np.maximum(front * behind, 0.03)

    def axis(self, x: ArrayLike) -> Array:
        """Height of the middle of the cross-section at ``x``."""
        s = np.clip(np.asarray(x, dtype=np.float64) / self.length + 0.5, 0.0, 1.0)
        back = np.clip((s - 1.0 + self.tail) / self.tail, 0, 1) ** 1.5 * self.rise
        front = (1.0 - np.clip(s / self.nose, 0, 1)) ** 2 * self.droop
        return (back - front) * self.height / 2.0

    def top(self, x: float) -> float:
        """Height of the upper side at ``x``."""
        return float(self.axis(x) + self.size(x) * self.height / 2.0)

    def half_width(self, x: float) -> float:
        return float(self.size(x) * self.width / 2.0)

    def mesh(self, sides: int = 20) -> Mesh:
        s = np.unique(
            np.concatenate(
                [
                    np.linspace(0, 1, 9) ** 1.7 * self.nose,
                    np.linspace(self.nose, 1 - self.tail, 4),
                    np.linspace(1 - self.tail, 1, 9),
                ]
            )
        )
        x = (s - 0.5) * self.length
        outline = oval(self.width / 2.0, self.height / 2.0, self.square, sides)
        yz = self.size(x)[:, None, None] * outline[None]
        bulge = self.hump * np.interp(s, [0.0, self.nose * 0.7, 0.25, 0.4], [0.0, 1.0, 1.0, 0.0])
        upper = np.where(yz[..., 1] > 0.0, 1.0 + bulge[:, None], 1.0)
        y = yz[..., 1] * upper + self.axis(x)[:, None]
        return loft(np.stack([np.broadcast_to(x[:, None], y.shape), y, yz[..., 0]], axis=-1))


_CHORD = np.array([1.0, 0.75, 0.45, 0.2, 0.06, 0.0])
_HALF = 5.0 * (0.2969 * np.sqrt(_CHORD) - 0.126 * _CHORD - 0.3516 * _CHORD**2 + 0.2843 * _CHORD**3 - 0.1015 * _CHORD**4)


def surface(leading: ArrayLike, chords: ArrayLike, thickness: ArrayLike = 0.1) -> Mesh:
    """A wing, fin or winglet with a rounded profile.

    Parameters
    ----------
    leading : [S, 3] the leading edge from root to tip.
    chords : [S] lengths of the profile along +x, > 0.
    thickness : of the profile, in chords; one number or [S].
    """
    edge, chord = np.asarray(leading, dtype=np.float64), np.asarray(chords, dtype=np.float64)[:, None]
    half = np.maximum(_HALF, 0.03) * np.broadcast_to(np.asarray(thickness, dtype=np.float64), (len(edge),))[:, None] * chord
    along = np.gradient(edge, axis=0) * [0.0, 1.0, 1.0]
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-12)
    normal = np.stack([np.zeros(len(edge)), along[:, 2], -along[:, 1]], axis=1)
    profile = edge[:, None] + (_CHORD * chord)[..., None] * [1.0, 0.0, 0.0]
    lift = half[..., None] * normal[:, None]
    return loft(np.concatenate([profile + lift, (profile - lift)[:, ::-1]], axis=1))


def half_wing(
    root: ArrayLike,
    semi: float,
    chord: float,
    tip: float,
    sweep: float,
    rise: float = 0.0,
    thick: float = 0.1,
    kink: float = 0.0,
    rounded: bool = False,
    elliptic: bool = False,
    winglet: float = 0.0,
) -> Mesh:
    """The wing on the side of +z.

    Parameters
    ----------
    root : [3] where its leading edge starts. semi : distance from there to the tip along z.
    chord, tip : lengths at root and tip. sweep, rise : tangents of the sweep of the leading edge and of the dihedral.
    kink : the trailing edge of the inner third is filled up by this share of the chord.
    rounded : the tip ends in an arc. elliptic : chords follow an ellipse. winglet : height of a turned-up tip.
    """
    t = np.array([0.0, 0.34, 0.67, 0.9, 1.0]) if not (rounded or elliptic) else np.linspace(0, 1, 11) ** 0.6
    chords = chord + (tip - chord) * t
    x = sweep * semi * t
    if kink:
        chords = chords + kink * chord * np.array([0.6, -0.1, -0.05, 0.0, 0.0]) if len(t) == 5 else chords
    if elliptic or rounded:
        shrink = np.sqrt(np.clip(1.0 - t**2, 0.0, 1.0)) if elliptic else np.clip(1.0 - t**14, 0.0, 1.0) ** 0.4
        shrink = np.maximum(shrink, 0.12)
        x = x + 0.3 * chords * (1.0 - shrink)
        chords = chords * shrink
    edge = np.asarray(root, dtype=np.float64) + np.stack([x, rise * semi * t, semi * t], axis=1)
    if winglet:
        bend = edge[-1] + np.array(
            [[0.4 * tip, 0.25 * winglet, 0.25 * winglet], [0.5 * tip + 0.7 * winglet, winglet, 0.4 * winglet]]
        )
        edge, chords = np.concatenate([edge, bend]), np.concatenate([chords, [0.8 * tip, 0.4 * tip]])
    return surface(edge, chords, thick)


def fin(
    root: ArrayLike,
    high: float,
    chord: float,
    tip: float,
    sweep: float,
    lean: float = 0.0,
    thick: float = 0.09,
    rounded: bool = False,
) -> Mesh:
    """A fin upward from ``root`` [3]; ``lean`` is how far it tilts toward +z for each unit up."""
    t = np.linspace(0, 1, 8) ** 0.6 if rounded else np.array([0.0, 0.5, 1.0])
    shrink = np.maximum(np.clip(1.0 - t**5, 0.0, 1.0) ** 0.5, 0.2) if rounded else np.ones(3)
    chords = chord + (tip - chord) * t
    x = sweep * high * t + 0.5 * chords * (1.0 - shrink)
    edge = np.asarray(root, dtype=np.float64) + np.stack([x, high * t, lean * high * t], axis=1)
    return surface(edge, chords * shrink, thick)


def jet(front: ArrayLike, length: float, radius: float, sides: int = 16) -> Mesh:
    """A nacelle with open ends, from ``front`` [3] along +x."""
    a = np.asarray(front, dtype=np.float64)
    stations = [0.18, 0.03, 0.0, 0.06, 0.35, 0.72, 1.0, 0.92]
    return turned(a, a + [length, 0, 0], stations, np.array([0.05, 0.82, 0.9, 1.0, 1.03, 0.82, 0.5, 0.08]) * radius, sides)


def spindle(front: ArrayLike, length: float, radius: float, high: float = 1.0, sides: int = 12) -> Mesh:
    """A streamlined pod from ``front`` along +x, ``high`` times as high as wide."""
    a = np.asarray(front, dtype=np.float64)
    part = turned(
        (0, 0, 0), (length, 0, 0), [0, 0.04, 0.2, 0.5, 0.8, 1], np.array([0.3, 0.65, 1, 0.95, 0.55, 0.1]) * radius, sides
    )
    return Mesh(part.vertices * [1, high, 1] + a, part.faces)


def propeller(rng: np.random.Generator, centre: ArrayLike, radius: float, hub: float, disc: bool) -> list[Mesh]:
    """Spinner and blades before ``centre`` [3], or the disc that turning blades look like."""
    c = np.asarray(centre, dtype=np.float64)
    parts = [turned(c - [2.0 * hub, 0, 0], c + [0.3 * hub, 0, 0], [0, 0.3, 0.7, 1], np.array([0.1, 0.6, 0.95, 1]) * hub, 10)]
    if disc:
        return [*parts, turned(c - [0.45 * hub, 0, 0], c - [0.3 * hub, 0, 0], [0, 1], [radius, radius], 24)]
    blades = int(rng.integers(2, 5))
    for angle in rng.uniform(0, np.pi) + 2 * np.pi * np.arange(blades) / blades:
        out = np.array([0.0, np.cos(angle), np.sin(angle)])
        parts.append(
            bar(
                c - [0.4 * hub, 0, 0],
                c - [0.4 * hub, 0, 0] + out * radius,
                0.1 * radius,
                0.03 * radius,
                0.7,
                np.cross(out, (1, 0, 0)) + [0.4, 0, 0],
            )
        )
    return parts


def gear(rng: np.random.Generator, body: Body, main: float, low: float, radius: float, track: float, **how: Any) -> list[Mesh]:
    """Wheels on legs.

    Parameters
    ----------
    main : x of the main wheels; low : y of the ground; track : their z; radius : of the wheels.
    how : ``tail=True`` puts the third wheel behind; ``spats=True`` covers the wheels.
    """
    foot = np.array([main, low + radius, track])
    width = radius * rng.uniform(0.5, 0.9)
    head = np.array([main, float(body.axis(main)) - 0.2 * body.height, track * rng.uniform(0.3, 1.0)])
    leg = rng.uniform(0.15, 0.3) * radius
    parts = both(rod(head, foot, leg * 1.3, leg, 6), 2) + both(wheel(foot, radius, width, 2, 12), 2)
    if how.get("spats"):
        parts += both(spindle(foot - [1.7 * radius, -0.2 * radius, 0], 4.0 * radius, 0.75 * width + 0.3 * radius, 1.3, 8), 2)
    third = 0.9 * radius if not how.get("tail") else 0.5 * radius
    x = body.length * (0.43 if how.get("tail") else -0.5 + rng.uniform(0.08, 0.16))
    bottom = float(body.axis(x) - body.size(x) * body.height / 2.0)
    # A tail wheel hangs close under the fuselage; a nose wheel stands on the ground.
    y = bottom - 0.8 * third if how.get("tail") else low + third
    parts += [
        rod((x, bottom + 0.2 * body.height * float(body.size(x)), 0), (x, y, 0), leg, sides=6),
        wheel((x, y, 0), third, width, 2, 12),
    ]
    return parts


def floats(body: Body, low: float, track: float, length: float) -> list[Mesh]:
    """Two floats on struts."""
    radius = 0.045 * length / 0.6
    parts = both(spindle((-0.42 * length - 0.05, low + radius, track), length, radius, 1.0), 2)
    for x in (-0.2 * length, 0.12 * length):
        parts += both(
            rod((x, float(body.axis(x)) - 0.3 * body.height, track * 0.3), (x, low + 1.5 * radius, track), 0.006, sides=6), 2
        )
    return parts


def canopy(body: Body, x: float, length: float, high: float, wide: float = 0.8) -> Mesh:
    """A glass hood: an ellipsoid sunk into the upper side of the fuselage around ``x``."""
    half = body.half_width(x) * wide
    return ellipsoid((length / 2.0, high + 0.25 * body.height, half), (x, body.top(x) - 0.25 * body.height, 0), 9, 12)


def mirror_all(parts: list[Mesh]) -> list[Mesh]:
    """Every part and its reflection in z = 0."""
    return [m for part in parts for m in both(part, 2)]
