"""Chairs whose seat and back are one sheet: bent shells, loungers, slings. Lengths in metres."""

from __future__ import annotations

import numpy as np

from ...io.meshes import Mesh
from .chair_base import base
from .chair_feet import short_feet
from .chair_frame import Frame
from .parts import Array, bar, both, box, chance, curve, cushion, oval, pick, plate, rectangle, rod, sweep, tube, wheel


def shell(rng: np.random.Generator) -> list[Mesh]:
    """Seat and back bent from one sheet, on any base."""
    width, depth, height = rng.uniform(0.42, 0.62), rng.uniform(0.4, 0.55), rng.uniform(0.4, 0.48)
    high, lean = rng.uniform(0.28, 0.55), rng.uniform(0.08, 0.4)
    if chance(rng, 0.12):
        return _panton(rng, width, height, high)
    z = depth / 2
    profile = curve(
        [
            (height - rng.uniform(0.0, 0.05), z),
            (height + 0.01, z * 0.75),
            (height - rng.uniform(0.0, 0.04), -z * 0.3),
            (height + 0.03, -z * 0.8),
            (height + high * 0.35, -z - 0.35 * lean * high),
            (height + high, -z - lean * high),
        ],
        19,
    )
    # Bucket shells curl upward beside the seat and forward beside the back.
    curl = rng.uniform(0.0, 0.22) if chance(rng, 0.6) else 0.0
    s, u = np.linspace(0, 1, 19)[:, None], np.linspace(-1, 1, 13)[None, :]
    ends = np.abs(2 * s - 1)
    wide = (
        width
        / 2
        * (1.0 - rng.uniform(0.0, 0.45) * ends ** rng.uniform(3, 8))
        * (1.0 - rng.uniform(0.0, 0.25) * np.exp(-((s - 0.5) ** 2) / 0.02) * chance(rng, 0.4))
    )
    if chance(rng, 0.3):
        wide = wide * (1.0 - rng.uniform(0.0, 0.35) * s)
    bowl = np.clip(1.15 - ends, 0, 1) if chance(rng, 0.5) else np.clip(1.2 - s, 0.2, 1)
    dished = curl * np.abs(u) ** rng.uniform(2, 4)
    toward = np.clip((s - 0.45) / 0.2, 0, 1)
    y = profile[:, :1] + dished * bowl * (1.0 - 0.6 * toward)
    zz = profile[:, 1:] + dished * toward * rng.uniform(0.2, 1.0)
    # A rounded upper edge.
    y = y - rng.uniform(0.0, 0.12) * np.abs(u) ** 3 * np.clip((s - 0.8) / 0.2, 0, 1)
    thick = rng.uniform(0.008, 0.03) if chance(rng, 0.7) else rng.uniform(0.03, 0.09)
    parts = [plate(np.stack([np.broadcast_to(u * wide, y.shape), y, np.broadcast_to(zz, y.shape)], axis=-1), thick)]
    frame = Frame(width * 0.85, depth * 0.85, height - 0.02, 0.03, high)
    if chance(rng, 0.2):
        parts.append(cushion((width * 0.8, 0.04, depth * 0.8), (0, height + 0.01, 0), 0.8, 4))
    return parts + base(
        rng,
        frame,
        {"legs": 4, "wires": 2, "pedestal": 2, "sled": 1.5, "office": 0.6, "cantilever": 0.5, "rocker": 0.4, "hairpins": 0.4},
    )


def _panton(rng: np.random.Generator, width: float, height: float, high: float) -> list[Mesh]:
    """One sheet down to the floor in an S."""
    f = rng.uniform(0.2, 0.26)
    profile = curve(
        [
            (0.0, -0.22),
            (0.02, 0.12),
            (height * 0.6, f * 0.7),
            (height, f),
            (height - 0.03, 0.0),
            (height + 0.05, -0.2),
            (height + high, -0.32),
        ],
        31,
    )
    u, s = np.meshgrid(np.linspace(-1, 1, 11), np.linspace(0, 1, 31))
    skirt = rng.uniform(0.0, 0.2) * np.clip(1 - 2.2 * s, 0, 1) * u**2
    y, z = profile[:, :1] + 0.0 * u, profile[:, 1:] - skirt
    return [
        plate(
            np.stack([u * width / 2 * (1 - 0.15 * s), y + 0.06 * u**2 * np.clip(2 * s - 0.8, 0, 1), z], axis=-1),
            rng.uniform(0.015, 0.04),
        )
    ]


def _strip(points: Array, width: float, thick: float, dip: float = 0.0) -> Mesh:
    """A sheet of constant width along points [N, 2] of (height, z)."""
    u = np.linspace(-1, 1, 5)[None, :]
    y, z = points[:, :1] - dip * (1.0 - u**2), points[:, 1:] + 0.0 * u
    return plate(np.stack([u * width / 2 + 0.0 * z, y, z], axis=-1), thick)


def lounger(rng: np.random.Generator) -> list[Mesh]:
    """A chair to lie or lean back in."""
    kinds = {"chaise": 2, "beach": 2.5, "easy": 3.5, "deck": 1, "adirondack": 0.8, "floor": 0.7}
    return {"chaise": _chaise, "beach": _beach, "easy": _easy, "deck": _deck, "adirondack": _adirondack, "floor": _floor}[
        pick(rng, kinds)
    ](rng)


def _chaise(rng: np.random.Generator) -> list[Mesh]:
    """A long wave: legs, seat, back and a neck roll, over a frame of tubes."""
    width, thick = rng.uniform(0.48, 0.65), rng.uniform(0.03, 0.1)
    low, knee = rng.uniform(0.22, 0.34), rng.uniform(0.3, 0.45)
    head = rng.uniform(0.65, 0.95)
    knots = [(knee - rng.uniform(0.02, 0.15), 0.75), (knee, 0.4), (low, -0.1), (low + 0.15, -0.38), (head, -0.75)]
    line = curve(knots, 25)
    parts = [_strip(line, width, thick)]
    if chance(rng, 0.6):
        parts.append(rod((-width / 2, head - 0.02, -0.68), (width / 2, head - 0.02, -0.68), rng.uniform(0.04, 0.08), sides=12))
    radius = rng.uniform(0.01, 0.02)
    x = width / 2 * 0.95
    parts += both(tube([(x, y - thick / 2, z) for y, z in line[::3]], radius, 6))
    front, back = rng.uniform(0.1, 0.4), -rng.uniform(0.2, 0.5)
    for z in (front, back):
        y = float(np.interp(-z, -line[:, 1], line[:, 0])) - thick / 2
        parts += both(rod((x, y, z), (x, 0, z * rng.uniform(0.9, 1.2)), radius, sides=6))
        parts.append(rod((-x, 0.03, z), (x, 0.03, z), radius, sides=6))
    if chance(rng, 0.5):
        parts += both(rod((x, 0.02, front), (x, 0.02, back), radius, sides=6))
    return parts


def _beach(rng: np.random.Generator) -> list[Mesh]:
    """A long flat bed on legs with a raised head end; some have wheels or arms."""
    width, height = rng.uniform(0.5, 0.7), rng.uniform(0.22, 0.38)
    thick, front = rng.uniform(0.02, 0.08), rng.uniform(0.7, 1.15)
    back, rise = rng.uniform(0.5, 0.75), np.radians(rng.uniform(15, 60))
    top = (height + back * np.sin(rise), -back * np.cos(rise))
    parts = [
        _strip(np.array([(height, front), (height, front / 2), (height, 0.0)]), width, thick),
        _strip(np.array([(height, 0.0), top]), width, thick),
    ]
    if chance(rng, 0.5):
        parts += both(box((0.03, 0.05, front + 0.3), (width / 2, height - 0.02, front / 2 - 0.15)))
    for z in (front * 0.9, front * 0.3 if chance(rng, 0.4) else front * 0.88, -rng.uniform(0.1, 0.35)):
        parts += both(rod((width / 2 - 0.02, height, z), (width / 2 - 0.02, 0, z), rng.uniform(0.012, 0.025), sides=6))
    if chance(rng, 0.35):
        parts += both(wheel((width / 2 + 0.03, 0.1, -0.3), 0.1, 0.03, 0, 14)) + [
            rod((-width / 2, 0.1, -0.3), (width / 2, 0.1, -0.3), 0.01),
            *both(bar((width / 2 - 0.02, height, -0.05), (width / 2 - 0.02, 0.1, -0.3), 0.02, 0.03)),
        ]
    if chance(rng, 0.5):
        high = height + rng.uniform(0.12, 0.22)
        parts += both(box((0.05, 0.025, 0.45), (width / 2 + 0.02, high, -0.05))) + both(
            rod((width / 2, height - 0.02, 0.1), (width / 2 + 0.02, high, 0.12), 0.012, sides=6)
        )
    return parts


def _easy(rng: np.random.Generator) -> list[Mesh]:
    """A low armchair: a bent sling or cushions in an open frame of wood or tube."""
    width, height, depth = rng.uniform(0.5, 0.72), rng.uniform(0.3, 0.42), rng.uniform(0.5, 0.62)
    slope, lean, high = rng.uniform(0.05, 0.3), rng.uniform(0.25, 0.6), rng.uniform(0.45, 0.7)
    z = depth / 2
    low = height - slope * depth
    knots = [(height, z), (low + 0.02, -z * 0.7), (low + 0.08, -z), (low + 0.08 + high, -z - lean * high)]
    soft = chance(rng, 0.5)
    line = curve(knots, 17) if chance(rng, 0.6) else np.array([knots[0], (low, -z), knots[-1]])
    parts = [_strip(line, width, rng.uniform(0.015, 0.03) if not soft else rng.uniform(0.06, 0.14), rng.uniform(0, 0.03))]
    x, top = width / 2 + rng.uniform(0.0, 0.05), rng.uniform(0.5, 0.62)
    front, behind = z * rng.uniform(0.8, 1.2), -z * rng.uniform(1.0, 1.4)
    radius = rng.uniform(0.01, 0.022)
    frame = pick(rng, {"loop": 3, "posts": 3, "bent": 2, "legs": 0.8})
    if frame == "loop":
        path = [
            (x, top, behind),
            (x, top, front - 0.05),
            (x, top - 0.05, front),
            (x, 0.05, front),
            (x, radius, front - 0.05),
            (x, radius, behind + 0.05),
            (x, 0.05, behind),
        ]
        parts += both(
            sweep(path, oval(radius, radius, 2, 8) if chance(rng, 0.5) else rectangle(0.05, 0.02), side=(1, 0, 0), closed=True)
        )
        if chance(rng, 0.4):  # padded
            parts += both(
                cushion((0.08, rng.uniform(0.04, 0.1), front - behind), (x, top + 0.02, (front + behind) / 2), 0.7, 4.0)
            )
    elif frame == "posts":
        for at, splay in ((front, 0.06), (behind * 0.9, -0.1)):
            parts += both(bar((x, top, at), (x, 0, at + splay * rng.uniform(0, 1)), 2.2 * radius, 2.2 * radius))
        parts += both(bar((x, top, behind), (x, top, front + 0.03), rng.uniform(0.04, 0.1), 0.025, 1.0, (1, 0, 0)))
        parts += both(bar((x, height - 0.05, front), (x, low, behind * 0.9), 0.025, 0.05, 1.0, (1, 0, 0)))
    elif frame == "bent":
        bent = curve(
            [
                (x, height + 0.02, -z * 0.9),
                (x, top, -z * 0.2),
                (x, top, front),
                (x, top * 0.5, front + 0.06),
                (x, radius, front - 0.05),
                (x, radius, behind),
            ],
            21,
        )
        parts += both(sweep(bent, rectangle(0.06, 0.025), side=(1, 0, 0)))
    else:
        parts += base(
            rng,
            Frame(width * 0.9, depth, low, 0.02, 0.5),
            {"legs": 1, "sled": 1, "wires": 1, "crossed": 1, "office": 0.5, "pedestal": 1},
        )
    for y, at in ((low, behind * 0.8), (height - 0.03, front)):
        parts.append(rod((-x, y, at), (x, y, at), radius))
    return parts


def _deck(rng: np.random.Generator) -> list[Mesh]:
    """Two crossed frames with a cloth hung between."""
    width, thick = rng.uniform(0.5, 0.62), 0.03
    head, toe = (rng.uniform(0.75, 0.95), -0.55), (rng.uniform(0.3, 0.4), 0.45)
    line = curve([head, (0.45, -0.25), (0.26, 0.05), toe], 15)
    x = width / 2 + thick / 2
    parts = [_strip(line, width, 0.012)]
    parts += both(bar((x, *head), (x, 0, 0.55), thick, 0.045)) + both(
        bar((x - thick, *toe), (x - thick, 0, -0.5), thick, 0.045)
    )
    for y, z in (head, toe, (0.05, 0.5), (0.04, -0.45)):
        parts.append(rod((-x, y, z), (x, y, z), 0.014))
    if chance(rng, 0.4):
        parts += both(bar((x + 0.02, 0.5, 0.3), (x + 0.02, 0.5, -0.3), 0.05, 0.025))
    return parts


def _adirondack(rng: np.random.Generator) -> list[Mesh]:
    """Sloping slats, wide flat arms and a fan of boards behind."""
    width, front, behind = rng.uniform(0.5, 0.6), rng.uniform(0.36, 0.42), rng.uniform(0.18, 0.25)
    depth, lean, high = 0.5, rng.uniform(0.25, 0.5), rng.uniform(0.6, 0.8)
    parts = []
    count = int(rng.integers(4, 8))
    for t in (np.arange(count) + 0.5) / count:
        parts.append(box((width, 0.02, depth / count * 0.85), (0, front + (behind - front) * t, depth / 2 - depth * t)))
    frame = Frame(width, depth, behind, 0.02, high, lean, 0.0, 0.0, 0.85, rng.uniform(0.0, 0.3))
    boards = int(rng.integers(4, 8))
    for a in (2.0 * np.arange(boards) + 1.0) / boards - 1.0:
        top = 1.0 - rng.uniform(0.05, 0.2) * a * a
        parts.append(sweep(frame.back(a * 0.95, np.array([0.0, top])), rectangle(width * 0.8 / boards, 0.018), side=(1, 0, 0)))
    arm = rng.uniform(0.5, 0.58)
    x = width / 2 + 0.05
    parts += both(box((rng.uniform(0.09, 0.15), 0.022, 0.7), (x, arm, 0)))
    parts += both(bar((x - 0.03, arm, 0.25), (x - 0.03, 0, 0.27), 0.03, 0.09)) + both(
        bar((x - 0.04, front - 0.05, 0.28), (x - 0.04, 0.0, -0.5), 0.025, 0.1)
    )
    parts += both(bar((x - 0.03, arm, -0.33), (x - 0.03, behind - 0.05, -0.3), 0.03, 0.05))
    return parts


def _floor(rng: np.random.Generator) -> list[Mesh]:
    """Without legs: a cushion or board on the floor with a bent back."""
    width, depth, high = rng.uniform(0.42, 0.55), rng.uniform(0.42, 0.6), rng.uniform(0.35, 0.55)
    frame = Frame(width, depth, 0.06, 0.05, high, rng.uniform(-0.05, 0.4), 0.0, rng.uniform(0.0, 0.06), 0.95)
    u, v = np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-0.08, 1, 7))
    crown = rng.uniform(0.0, 0.3)
    parts = [plate(frame.back(u * (1 - crown * np.clip(v, 0, 1) ** 3), v), rng.uniform(0.015, 0.12))]
    parts.append(cushion((width, rng.uniform(0.05, 0.14), depth), (0, 0.05, 0.0), 0.8, 5.0, 0.2))
    return parts + (short_feet(rng, width, depth, 0.03) if chance(rng, 0.2) else [])
