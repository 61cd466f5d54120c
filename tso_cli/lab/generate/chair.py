"""Chairs, front +z, symmetric about x = 0, floor at y = 0. Lengths in metres."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ...geometry.points import Array
from ...io.meshes import Mesh
from .parts import (
    X_AXIS,
    Range,
    both,
    box,
    chance,
    curve,
    cushion,
    draw,
    flat,
    loft,
    oval,
    pick,
    plate,
    rectangle,
    rod,
    superellipse,
    sweep,
    turned,
)

# Standard deviation of the logarithms by which a chair is stretched along x, y and z.
SPREAD = 0.08
WEIGHTS = {"dining": 36, "armchair": 21, "lounger": 13, "office": 10, "shell": 12, "bar": 8}


# Ranges of the fields of `Frame` from width to flare, and weights of backs, arms and bases.
Kind = tuple[tuple[Range, ...], dict[str, float], dict[str, float], dict[str, float]]
FRAMED: dict[str, Kind] = {
    "dining": (
        (
            (0.37, 0.58),
            (0.37, 0.52),
            (0.38, 0.5),
            (0.015, 0.09),
            (0.3, 0.6),
            (0, 0.3),
            (0, 0.1),
            (0.8, 1),
            (-0.1, 0.1),
        ),
        {"panel": 3.5, "posts": 5, "hoop": 1.6, "raised": 1.5},
        {"none": 7, "rest": 2, "tube": 1},
        {"legs": 12, "sled": 1.5, "cantilever": 1.5, "crossed": 1, "wires": 1, "pedestal": 0.6},
    ),
    "office": (
        (
            (0.42, 0.54),
            (0.42, 0.52),
            (0.42, 0.54),
            (0.04, 0.12),
            (0.4, 0.75),
            (0, 0.3),
            (0, 0.1),
            (0.8, 1),
            (-0.2, 0.1),
        ),
        {"panel": 1, "raised": 2},
        {"none": 3.5, "tee": 4, "tube": 2, "rest": 1},
        {"casters": 9, "pedestal": 0.6, "sled": 0.4},
    ),
    "bar": (
        (
            (0.28, 0.44),
            (0.28, 0.44),
            (0.55, 0.82),
            (0.02, 0.1),
            (0.15, 0.4),
            (0, 0.25),
            (0, 0.1),
            (0.8, 1),
            (0, 0),
        ),
        {"none": 9, "panel": 3, "posts": 2, "raised": 3, "hoop": 1},
        {"none": 1},
        {"legs": 6, "pedestal": 3, "sled": 0.7, "wires": 0.9},
    ),
}
SHELL_BASES = {"legs": 4, "wires": 2, "pedestal": 2, "sled": 1.5, "casters": 0.6, "cantilever": 0.5}

Path = Sequence[tuple[float, float, float]]
# Bars of a base, reflected to the left: half widths, shares of the way up to the seat, and half depths.
BASES: dict[str, tuple[Path, ...]] = {
    "sled": (
        [
            (1, 1, -0.8),
            (1, 1, 0.8),
            (1.1, 0.1, 1),
            (1.1, 0.03, 0.9),
            (1.1, 0.03, -0.9),
            (1.1, 0.1, -1),
            (1, 0.9, -0.9),
        ],
        [(0, 0.03, -0.9), (1.1, 0.03, -0.9)],
    ),
    "cantilever": (
        [
            (1, *at)
            for at in (
                (1, -1),
                (1, 0.8),
                (0.96, 0.95),
                (0.88, 1),
                (0.14, 1),
                (0.05, 0.95),
                (0.03, 0.8),
                (0.03, -0.9),
            )
        ],
        [(0, 0.03, -0.9), (1, 0.03, -0.9)],
    ),
    "crossed": (
        [(1, 1, -0.8), (1, 0, 1)],
        [(0.92, 1, 0.8), (0.92, 0, -1)],
        [(0, 0.12, 0.8), (1, 0.12, 0.8)],
        [(0, 0.12, -0.8), (1, 0.12, -0.8)],
    ),
    "wires": (
        [(0.4, 1, 0.4), (1, 0, 1)],
        [(0.4, 1, -0.4), (1, 0, -1)],
        [(0, 0.9, 0), (0.7, 0.5, 0.7)],
        [(0, 0.9, 0), (0.7, 0.5, -0.7)],
    ),
}
# Bars of an arm: half widths of the seat, arm's heights above it, and half depths.
ARMS: dict[str, tuple[Path, ...]] = {
    "rest": ([(1, 1, -1), (1, 1, 0.2), (1, 1.05, 0.9)], [(1, -0.1, 0.7), (1, 1, 0.7)]),
    "tube": ([(1, -0.1, 0.8), (1, 0.75, 0.8), (1, 0.95, 0.7), (1, 1, 0.5), (1, 1, -1)],),
    "tee": ([(0.8, -0.3, 0), (1.05, -0.2, 0), (1.05, 1, 0)],),
}
# Side frames of an easy chair, floor 0 to arm 1, closed.
EASY: Path = [
    (1, 1, -1),
    (1, 1, 0.8),
    (1, 0.95, 1),
    (1, 0.1, 1.1),
    (1, 0.03, 1),
    (1, 0.03, -0.9),
    (1, 0.1, -1),
]


@dataclass(frozen=True)
class Frame:
    """Measures of a chair.

    width, depth, height, thick : of the seat; ``height`` is that of its upper face. back_height : of the back above the seat.
    lean : its slope, metres backward for each metre up. wrap : how far its edges come forward. back_width, flare : width of the
    back as a share of the seat's, and how much wider it is at the top. square : power of the seat's outline, 2 round to 30
    square.
    """

    width: float
    depth: float
    height: float
    thick: float
    back_height: float
    lean: float = 0.1
    wrap: float = 0.0
    back_width: float = 1.0
    flare: float = 0.0
    square: float = 30.0

    @property
    def corner(self) -> float:
        """Where the outline's corners lie, as a share of half the width and depth: 1 square, 0.71 round."""
        return float(2.0 ** (-1.0 / self.square))

    def back(self, u: Array | float, v: Array | float) -> Array:
        """Points [..., 3] of the back: u from -1 (left) to 1, v from 0 (seat) to 1 (top)."""
        across, up = np.broadcast_arrays(
            np.asarray(u, dtype=np.float64), np.asarray(v, dtype=np.float64)
        )
        x = (
            across
            * self.width
            / 2.0
            * self.back_width
            * min(1.0, 1.12 * self.corner)
            * (1.0 + self.flare * up)
        )
        # The back follows the rear edge of a round seat.
        follow = (1.0 - self.corner) * self.depth / 2.0 * across**2
        z = (
            -self.depth / 2.0
            + 0.015
            - self.lean * up * self.back_height
            + self.wrap * (across**2 - 1.0)
            + follow
        )
        return np.stack([x, self.height + up * self.back_height, z], axis=-1)

    def sheet(
        self, low: float, high: float, thick: float, width: float = 0.97, crown: float = 0.0
    ) -> Mesh:
        """The back between shares ``low`` and ``high`` of its height; ``crown`` rounds the top."""
        u, s = np.meshgrid(np.linspace(-1, 1, 11), np.linspace(0, 1, 9))
        v = low + (high - low) * s * (1.0 - 0.6 * crown * (high - low) * np.abs(u) ** 2.5)
        return plate(self.back(u * width * (1.0 - 0.6 * crown * s**3), v), thick)


def build(rng: np.random.Generator, kind: str) -> list[Mesh]:
    """The parts of a chair of a kind in `WEIGHTS`."""
    if kind == "shell":
        return _shell(rng)
    if kind == "armchair":
        return _block(rng) if chance(rng, 0.6) else _tub(rng)
    if kind == "lounger":
        return _easy(rng)
    sizes, backs, arms, bases = FRAMED[kind]
    frame = replace(
        Frame(*draw(rng, sizes)),
        square=float(rng.choice([2.0, 3.0, 6.0, 30.0], p=[0.17, 0.13, 0.2, 0.5])),
    )
    parts = _seat(rng, frame) + _base(rng, frame, pick(rng, bases))
    return parts + _back(rng, frame, pick(rng, backs)) + _arms(rng, frame, pick(rng, arms))


def _bars(
    rng: np.random.Generator, paths: Sequence[Path], scale: ArrayLike, height: float, radius: float
) -> list[Mesh]:
    """Bars along right-hand paths and their reflections, in shares of ``scale`` [3] from ``height`` up."""
    section = _section(rng, radius)
    return both(
        sweep(
            np.multiply(path, scale) + [0.0, height, 0.0],
            section,
            side=None if path[0][0] == 0 else X_AXIS,
        )
        for path in paths
    )


def _section(rng: np.random.Generator, radius: float) -> Array:
    return (
        oval(radius, radius, 2.0, 8) if chance(rng, 0.5) else rectangle(2.5 * radius, 2.0 * radius)
    )


def _seat(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """A board, a cushion or both; slats."""
    w, d, top, thick = frame.width, frame.depth, frame.height, frame.thick
    kind = pick(
        rng, {"board": 4.0, "cushion": 3.0, "both": 1.5, "slats": 0.8 * (frame.square > 5.0)}
    )
    if kind == "slats":
        count = int(rng.integers(4, 10))
        wide = d / count * rng.uniform(0.55, 0.85)
        slats = [
            box((w, 0.02, wide), (0, top, z)) for z in ((np.arange(count) + 0.5) / count - 0.5) * d
        ]
        return slats + both(box((0.03, thick, d), (w * 0.4, top - thick / 2.0, 0)))
    if kind == "cushion":
        puff = rng.uniform(0.0, 0.4) * chance(rng, 0.5)
        return [
            cushion(
                (w, thick, d),
                (0, top - thick / 2.0, 0),
                rng.uniform(0.3, 1.0),
                min(frame.square, 12.0),
                puff,
            )
        ]
    outline = oval(w / 2.0, d / 2.0, frame.square, 16)
    # Narrower behind than in front: a trapezoid.
    outline[:, 0] *= 1.0 - rng.uniform(0.0, 0.12) * chance(rng, 0.5) * (
        1.0 - outline[:, 1] / (d / 2.0)
    )
    parts = [loft([flat(outline, top - thick), flat(outline, top)])]
    if kind == "both":
        parts.append(
            cushion(
                (w * 0.94, 0.05, d * 0.92), (0, top + 0.02, 0.01), 0.8, max(frame.square, 3.0), 0.2
            )
        )
    return parts


def _back(rng: np.random.Generator, frame: Frame, kind: str) -> list[Mesh]:
    """A panel from the seat up, or raised on two posts; posts with rails or slats between; a bent bow with spindles."""
    if kind == "none":
        return []
    if kind in ("panel", "raised"):
        low = rng.uniform(0.2, 0.65) if kind == "raised" else -0.03
        thick = rng.uniform(0.012, 0.035) if chance(rng, 0.6) else rng.uniform(0.04, 0.1)
        panel = frame.sheet(
            low, 1.0, thick, rng.uniform(0.8, 1.05), rng.uniform(0.0, 0.5) * chance(rng, 0.5)
        )
        radius = rng.uniform(0.007, 0.02)
        posts = frame.back(rng.uniform(0.1, 0.95), np.linspace(-0.08, (low + 1.0) / 2.0, 6)) - [
            0,
            0,
            radius,
        ]
        return [
            panel,
            *(both(sweep(posts, _section(rng, radius), side=X_AXIS)) if kind == "raised" else ()),
        ]
    thick = rng.uniform(0.018, 0.05)
    if kind == "hoop":
        power = rng.uniform(2.0, 4.5)
        u, v = superellipse(np.linspace(0.0, np.pi, 21), power).T
        # Its feet stand closer together than it is wide.
        u = u * (1.0 - rng.uniform(0.0, 0.35) * (1.0 - v) ** 2)
        parts = [sweep(frame.back(u * 0.97, v), _section(rng, thick / 2.0))]
        count = int(rng.integers(3, 9))
        for a in ((2.0 * np.arange(count) + 1.0) / count - 1.0) * 0.9:
            top = float((1.0 - abs(a) ** power) ** (1.0 / power))
            path = frame.back(a * np.array([0.75, 1.0]), np.array([-0.02, top]))
            parts.append(sweep(path, oval(0.3 * thick, 0.3 * thick, 2.0, 6)))
        return parts
    edge, low, high = 1.0 - thick / frame.width, rng.uniform(0.05, 0.4), rng.uniform(0.025, 0.12)
    top, u = 1.0 - high / 2.0 / frame.back_height, np.linspace(-edge, edge, 9)
    parts = both(
        sweep(frame.back(edge, np.linspace(-0.1, 1.0, 8)), _section(rng, thick / 2.0), side=X_AXIS)
    )
    parts.append(
        sweep(frame.back(u, top), rectangle(high, rng.uniform(0.015, 0.03)), side=(0, 1, 0))
    )
    if chance(rng, 0.45):
        rails = np.linspace(low, top, int(rng.integers(0, 5)), endpoint=False)
        section = rectangle(
            min(rng.uniform(0.02, 0.1), 0.8 * (top - low) * frame.back_height / (len(rails) + 0.5)),
            0.018,
        )
        return parts + [sweep(frame.back(u, v), section, side=(0, 1, 0)) for v in rails]
    count = int(rng.integers(1, 9))
    slat = rectangle(frame.width * rng.uniform(0.25, 0.75) / (count + 1), 0.012)
    parts.append(sweep(frame.back(u, low), rectangle(0.03, 0.02), side=(0, 1, 0)))
    at = ((2.0 * np.arange(count) + 1.0) / count - 1.0) * edge * 0.95
    return parts + [sweep(frame.back(a, np.linspace(low, top, 6)), slat, side=X_AXIS) for a in at]


def _arms(rng: np.random.Generator, frame: Frame, kind: str) -> list[Mesh]:
    """Bars of `ARMS`, sometimes with a pad."""
    if kind == "none":
        return []
    high, pad = min(rng.uniform(0.15, 0.28), 0.8 * frame.back_height), rng.uniform(0.2, 0.3)
    scale = (frame.width / 2.0 + 0.02, high, frame.depth / 2.0)
    parts = _bars(rng, ARMS[kind], scale, frame.height, rng.uniform(0.008, 0.022))
    if kind == "tee" or chance(rng, 0.4):
        parts += both(
            cushion((0.06, 0.03, pad), (1.05 * scale[0], frame.height + high, 0.02), 0.8, 4.0)
        )
    return parts


def _base(rng: np.random.Generator, frame: Frame, kind: str) -> list[Mesh]:
    """What carries the seat: legs, a column, or bars of `BASES`."""
    inside, top = min(1.0, 1.03 * frame.corner), frame.height - 0.7 * frame.thick
    width, depth = frame.width * inside, frame.depth * inside
    if kind == "legs":
        return _legs(rng, width, depth, top)
    if kind in ("pedestal", "casters"):
        return _column(rng, top, kind == "casters")
    scale = (width / 2.0 - 0.02, top, depth / 2.0 * rng.uniform(0.8, 1.1))
    return _bars(rng, BASES[kind], scale, 0.0, rng.uniform(0.007, 0.018))


def _legs(rng: np.random.Generator, width: float, depth: float, top: float) -> list[Mesh]:
    """Four legs: straight, tapered or turned; with or without stretchers and an apron."""
    form = pick(rng, {"straight": 5, "tapered": 6, "turned": 1.5})
    thick = rng.uniform(0.018, 0.055) if chance(rng, 0.88) else rng.uniform(0.055, 0.1)
    splay, splay_back = rng.uniform(0.0, 0.22) * chance(rng, 0.5), rng.uniform(0.0, 0.2)
    x, z = (
        size / 2.0 - thick / 2.0 - rng.uniform(0.0, 0.06) * chance(rng, 0.5)
        for size in (width, depth)
    )

    def leg(front: bool, down: Array | float) -> Array:
        """Points of the right leg at shares of the way down."""
        down, sign, out = (
            np.asarray(down, dtype=np.float64),
            1.0 if front else -1.0,
            splay if front else splay_back,
        )
        return np.stack(
            [x + splay * 0.6 * top * down, top * (1.0 - down), sign * (z + out * top * down)],
            axis=-1,
        )

    t = np.linspace(0.0, 1.0, 15 if form == "turned" else 2)
    scale = 1.0 - t * rng.uniform(0.2, 0.5) * (form == "tapered")
    if form == "turned":
        scale = 1.0 + rng.uniform(0.1, 0.35) * np.sin(rng.uniform(6, 20) * t) * np.sin(np.pi * t)
    section = _section(rng, thick / 2.0)
    parts = [
        part
        for front in (True, False)
        for part in both(sweep(leg(front, t), section, scale, X_AXIS))
    ]
    flip = np.array([-1.0, 1.0, 1.0])
    if chance(rng, 0.45):
        at, cross, radius = (
            rng.uniform(0.45, 0.8),
            rng.uniform(0.35, 0.85),
            thick * rng.uniform(0.2, 0.4),
        )
        parts += both(rod(leg(True, at), leg(False, at), radius))
        if chance(rng, 0.6):
            parts += [
                rod(leg(front, cross), leg(front, cross) * flip, radius) for front in (True, False)
            ]
    if chance(rng, 0.4):
        high = rng.uniform(0.03, 0.09)
        parts += both(box((0.018, high, 2.0 * z), (x, top - high / 2.0, 0.0)))
        parts += [box((2.0 * x, high, 0.018), (0.0, top - high / 2.0, side)) for side in (z, -z)]
    return parts


def _column(rng: np.random.Generator, top: float, casters: bool) -> list[Mesh]:
    """A column on a disc, a trumpet foot, or a star of arms, which may end in casters."""
    foot, column = rng.uniform(0.18, 0.3), rng.uniform(0.02, 0.045)
    kind = "star" if casters else pick(rng, {"disc": 2, "trumpet": 2, "star": 3})
    if kind == "trumpet":
        t = np.linspace(0.0, 1.0, 9)
        return [
            turned(
                (0, 0, 0),
                (0, top, 0),
                t,
                column + (foot - column) * (1.0 - t) ** rng.uniform(4, 9),
                20,
            )
        ]
    parts = [rod((0, 0.02, 0), (0, top, 0), column)]
    if kind == "disc":
        return [
            *parts,
            turned((0, 0, 0), (0, 0.03, 0), [0, 0.4, 1], [foot, foot, column * 1.2], 20),
        ]
    count, ground, width = 5 if casters else 4, 0.06 if casters else 0.015, rng.uniform(0.025, 0.05)
    for angle in rng.choice([0.0, np.pi / count]) + 2.0 * np.pi * np.arange(count) / count:
        out, across = (
            np.array([np.sin(angle), 0.0, np.cos(angle)]),
            np.array([-np.cos(angle), 0.0, np.sin(angle)]),
        )
        tip = 1.1 * foot * out + [0.0, ground, 0.0]
        parts.append(
            sweep(
                np.array([[0.0, ground + 0.06, 0.0], tip]),
                rectangle(1.2 * width, 0.9 * width),
                [1.0, 0.6],
                across,
            )
        )
        if casters:
            axle = tip - [0.0, ground - 0.028, 0.0]
            parts.append(rod(axle - 0.026 * across, axle + 0.026 * across, 0.028, sides=10))
    return parts


def _shell(rng: np.random.Generator) -> list[Mesh]:
    """Seat and back bent from one sheet, on any base."""
    width, depth, height, high, lean = draw(
        rng, ((0.42, 0.62), (0.4, 0.55), (0.4, 0.48), (0.28, 0.55), (0.08, 0.4))
    )
    front, hollow, end, taper, waist = draw(
        rng, ((0.0, 0.05), (0.0, 0.04), (0.0, 0.45), (0.0, 0.15), (0.0, 0.15))
    )
    z = depth / 2
    profile = [
        (height - front, z),
        (height + 0.01, z * 0.75),
        (height - hollow, -z * 0.3),
        (height + 0.03, -z * 0.8),
    ]
    profile += [(height + high * 0.35, -z - 0.35 * lean * high), (height + high, -z - lean * high)]
    line = curve(profile, 19)
    s, u = np.linspace(0, 1, 19)[:, None], np.linspace(-1, 1, 13)[None, :]
    ends = np.abs(2 * s - 1)
    wide = width / 2 * (1.0 - end * ends ** rng.uniform(3, 8)) * (1.0 - taper * s)
    wide = wide * (1.0 - waist * np.exp(-((s - 0.5) ** 2) / 0.02))
    # Bucket shells curl upward beside the seat and forward beside the back.
    curl = rng.uniform(0.0, 0.22) * chance(rng, 0.6) * np.abs(u) ** rng.uniform(2, 4)
    beside_back = np.clip((s - 0.45) / 0.2, 0, 1)
    y = line[:, :1] + curl * np.clip(1.15 - ends, 0, 1) * (1.0 - 0.6 * beside_back)
    # A rounded upper edge.
    y = y - rng.uniform(0.0, 0.12) * np.abs(u) ** 3 * np.clip((s - 0.8) / 0.2, 0, 1)
    thick = rng.uniform(0.008, 0.03) if chance(rng, 0.7) else rng.uniform(0.03, 0.09)
    sheet = plate(
        np.stack([u * wide, y, line[:, 1:] + curl * beside_back * rng.uniform(0.2, 1.0)], axis=-1),
        thick,
    )
    return [
        sheet,
        *_base(
            rng,
            Frame(width * 0.85, depth * 0.85, height - 0.02, 0.03, high),
            pick(rng, SHELL_BASES),
        ),
    ]


def _easy(rng: np.random.Generator) -> list[Mesh]:
    """A low armchair: a bent sling or cushion in an open frame."""
    width, height, depth, slope, lean, high, top = draw(
        rng,
        ((0.5, 0.72), (0.3, 0.42), (0.5, 0.62), (0.05, 0.3), (0.25, 0.6), (0.45, 0.7), (0.5, 0.62)),
    )
    z, low, x, radius = (
        depth / 2,
        height - slope * depth,
        width / 2 + 0.02,
        rng.uniform(0.01, 0.022),
    )
    line = curve(
        [
            (height, z),
            (low + 0.02, -z * 0.7),
            (low + 0.08, -z),
            (low + 0.08 + high, -z - lean * high),
        ],
        17,
    )
    u = np.linspace(-width / 2, width / 2, 5)[None, :] + np.zeros((17, 1))
    sling = np.stack([u, line[:, :1] + 0.0 * u, line[:, 1:] + 0.0 * u], axis=-1)
    parts = [
        plate(sling, rng.uniform(0.015, 0.03) if chance(rng, 0.5) else rng.uniform(0.06, 0.14))
    ]
    parts += [rod((-x, y, at), (x, y, at), radius) for y, at in ((low, -z), (height - 0.03, z))]
    if chance(rng, 0.3):
        return parts + _base(
            rng, Frame(width * 0.9, depth, low, 0.02, 0.5), pick(rng, FRAMED["dining"][3])
        )
    frame = np.array(EASY) * (x, top, z * rng.uniform(1.0, 1.3))
    parts += both(sweep(frame, _section(rng, radius), side=X_AXIS, closed=True))
    if chance(rng, 0.4):
        parts += both(
            cushion((0.08, rng.uniform(0.04, 0.1), 2.0 * z), (x, top + 0.02, 0.0), 0.7, 4.0)
        )
    return parts


def _block(rng: np.random.Generator) -> list[Mesh]:
    """An upholstered chair of thick blocks: seat, two arms and a back."""
    arm, behind, inner, inner_depth = draw(
        rng, ((0.06, 0.28), (0.1, 0.32), (0.42, 0.68), (0.42, 0.7))
    )
    seat_top, arm_top, padding, top = draw(rng, ((0.36, 0.48), (0.5, 0.7), (0.1, 0.2), (0.6, 1.1)))
    width, depth, feet = (
        inner + 2 * arm,
        inner_depth + behind,
        rng.uniform(0.02, 0.18) * chance(rng, 0.65),
    )
    hard, front, under = rng.uniform(0.0, 1.0), depth / 2, seat_top - padding
    lean, length = rng.uniform(0.0, 0.3) * max(top - seat_top, 0.0), rng.uniform(0.85, 1.0) * depth

    def block(size: Sequence[float], centre: ArrayLike) -> Mesh:
        """Sheared backward above the seat, by ``lean`` half a metre higher."""
        part = cushion(size, centre, 0.85 - 0.75 * hard, 4.0 + 16.0 * hard)
        shear = np.clip(part.vertices[:, 1:2] - seat_top, 0.0, None) / 0.5 * [0.0, 0.0, lean]
        return Mesh(part.vertices - shear, part.faces)

    parts = [box((inner + 0.02, under - feet, depth - 0.04), (0, (under + feet) / 2, 0))]
    parts.append(
        cushion(
            (inner, padding, inner_depth + 0.03),
            (0, seat_top - padding / 2, front - inner_depth / 2),
            0.6,
            8.0,
        )
    )
    parts.append(
        block(
            (width if chance(rng, 0.5) else inner + 0.02, top - feet, behind),
            (0, (feet + top) / 2, behind / 2 - front),
        )
    )
    if chance(rng, 0.45):
        high = max(top - seat_top, 0.2)
        parts.append(
            block((inner * 0.96, high, 0.15), (0, seat_top + high / 2, behind - front + 0.05))
        )
    x, z = inner / 2 + arm / 2, (depth - length) / 2 * rng.choice([-1.0, 1.0])
    parts += both(
        cushion(
            (arm, arm_top - feet, length),
            (x, (feet + arm_top) / 2, z),
            0.85 - 0.75 * hard,
            4.0 + 16.0 * hard,
        )
    )
    if chance(rng, 0.25):
        parts += both(
            rod((x, arm_top, z - length / 2), (x, arm_top, z + length / 2), arm * 0.58, sides=14)
        )
    return parts + _feet(rng, width, depth, feet)


def _tub(rng: np.random.Generator) -> list[Mesh]:
    """A wall bent round the seat in a U, as high in front as an arm and behind as a back."""
    width, depth, thick, seat_top, arm_top = draw(
        rng, ((0.62, 1.0), (0.6, 0.95), (0.04, 0.24), (0.36, 0.46), (0.5, 0.68))
    )
    lean, flare, top = draw(rng, ((0.0, 0.25), (0.0, 0.2), (0.6, 1.05)))
    feet = rng.uniform(0.03, 0.25) * chance(rng, 0.7)
    # From the right arm's front round the back to the left arm's front.
    t = np.linspace(-0.5, np.pi + 0.5, 27)
    x, z = ((superellipse(t, rng.uniform(2.0, 5.0)) * [width - thick, thick - depth]) / 2).T
    straight = np.clip(-np.sin(t), 0.0, None) / np.sin(0.5)
    z = np.where(straight > 0, straight * (depth / 2 - thick / 4), z)
    x = np.where(straight > 0, np.sign(x) * (width - thick) / 2, x)
    rise, levels = (
        np.clip(np.sin(t), 0.0, 1.0) ** rng.uniform(0.7, 4.0),
        np.linspace(0.0, 1.0, 6)[:, None],
    )
    y = feet + levels * (arm_top + (top - arm_top) * rise - feet)
    out = 1.0 + flare * levels * (y - feet)
    grid = np.stack([x * out, y, z * out - lean * np.clip(y - seat_top, 0, None) * rise], axis=-1)
    soft = (
        0.4 + 0.6 * np.sin(np.pi * np.clip(levels, 0.02, 0.85))
        if chance(rng, 0.5)
        else np.ones((6, 1))
    )
    parts = [plate(grid, np.broadcast_to(thick * soft, y.shape))]
    parts.append(
        cushion(
            (width - thick, seat_top - 0.1 - feet, depth - thick),
            (0, (seat_top - 0.1 + feet) / 2, 0),
            0.1,
            4.0,
        )
    )
    parts.append(
        cushion(
            (width - 1.6 * thick, 0.14, depth - thick),
            (0, seat_top - 0.07, thick * 0.4),
            0.7,
            4.0,
            0.15,
        )
    )
    return parts + _feet(rng, width * 0.76, depth * 0.76, feet)


def _feet(rng: np.random.Generator, width: float, depth: float, high: float) -> list[Mesh]:
    """Feet under an armchair, from the floor to y = ``high``; none where it is 0."""
    thick, end = rng.uniform(0.015, 0.04), rng.uniform(0.4, 1.0)
    heads = (
        [(width / 2.0 - 0.06, high + 0.05, z) for z in (depth / 2.0 - 0.06, 0.06 - depth / 2.0)]
        if high
        else []
    )
    return both(rod(head, (head[0], 0.0, head[2]), thick, thick * end) for head in heads)
