"""Upholstered armchairs: thick blocks, tubs and wings. Lengths in metres."""

from __future__ import annotations

import numpy as np

from ...io.meshes import Mesh
from .chair_base import base
from .chair_feet import short_feet, star
from .chair_frame import Frame
from .hidden import without_hidden
from .parts import both, box, chance, cushion, loft, moved, oval, pick, plate, rectangle, rod, slab, sweep


def armchair(rng: np.random.Generator) -> list[Mesh]:
    """An armchair of any upholstered kind."""
    kinds = {"block": _block, "tub": _tub, "wing": _wing, "pads": _pads}
    parts = kinds[pick(rng, {"block": 5, "tub": 3, "wing": 1.5, "pads": 1})](rng)
    return without_hidden(parts) if chance(rng, 0.6) else parts


def _soft(rng: np.random.Generator, size: tuple[float, float, float], centre: tuple[float, float, float], hard: float) -> Mesh:
    """A block with edges from sharp (``hard`` 1) to round (0)."""
    if hard > 0.8:
        return box(size, centre)
    return cushion(size, centre, 0.15 + 0.7 * (1.0 - hard) * min(1.0, 0.2 / size[1]), 4.0 + 10.0 * hard)


def _block(rng: np.random.Generator) -> list[Mesh]:
    """Seat, two arms and a back, each a thick block."""
    arm, behind = rng.uniform(0.06, 0.28), rng.uniform(0.1, 0.32)
    inner, inner_depth = rng.uniform(0.42, 0.68), rng.uniform(0.42, 0.7)
    width, depth = inner + 2 * arm, inner_depth + behind
    feet = rng.uniform(0.02, 0.18) if chance(rng, 0.65) else 0.0
    seat, arm_top = rng.uniform(0.36, 0.48), rng.uniform(0.5, 0.7)
    top = rng.uniform(0.68, 1.1) if chance(rng, 0.75) else arm_top
    hard, front = rng.choice([0.2, 0.5, 0.7, 1.0]), depth / 2.0
    cushioned = rng.uniform(0.1, 0.2)
    ahead = rng.uniform(-0.04, 0.03)
    under = seat - cushioned
    parts = [box((inner + 0.02, under - feet, depth - 0.04), (0, (under + feet) / 2, 0))]
    parts.append(
        _soft(
            rng,
            (inner, cushioned, inner_depth + 0.03),
            (0, seat - cushioned / 2, front - inner_depth / 2 + ahead),
            min(hard, 0.75),
        )
    )
    # The back leans: a block sheared backward and lowered into the seat.
    lean = rng.uniform(0.0, 0.3) * (top - seat)
    wide = width if chance(rng, 0.5) else inner + 0.02
    tall = top - feet
    block = _soft(rng, (wide, tall, behind * rng.uniform(0.8, 1.0)), (0, feet + tall / 2, -front + behind / 2), hard)
    parts.append(_leaned(block, seat, lean))
    if chance(rng, 0.45):
        high = max(top - seat, 0.2) * rng.uniform(0.8, 1.15)
        pad = cushion((inner * 0.96, 0.15, high), (0, 0, 0), 0.8, 4.0, 0.1)
        pad = Mesh(pad.vertices[:, [0, 2, 1]] * [1, 1, 1], pad.faces[:, ::-1])
        parts.append(_leaned(moved(pad, 1.0, (0, seat + high / 2, -front + behind + 0.05)), seat, lean))
    shape = pick(rng, {"block": 4, "roll": 2, "slope": 2, "open": 1})
    x, tall = inner / 2 + arm / 2, arm_top - feet
    length = depth * rng.uniform(0.85, 1.0)
    z = (depth - length) / 2.0 * rng.choice([-1.0, 1.0])
    if shape == "roll":
        parts += both(box((arm * 0.7, tall - arm / 2, length), (x, feet + (tall - arm / 2) / 2, z)))
        parts += both(
            rod(
                (x, arm_top - arm / 2, z - length / 2),
                (x, arm_top - arm / 2, z + length / 2),
                arm / 2 * rng.uniform(1.0, 1.3),
                sides=14,
            )
        )
    elif shape == "slope":
        low = rng.uniform(0.6, 0.95)
        outline = np.array(
            [
                [feet, length / 2],
                [feet, -length / 2],
                [arm_top * rng.uniform(1.0, 1.3), -length / 2],
                [feet + tall * low, length / 2 * rng.uniform(0.9, 1.1)],
            ]
        )
        parts += both(slab(outline + [0, z], x - arm / 2, x + arm / 2, 0))
    elif shape == "open":
        thick = rng.uniform(0.03, 0.06)
        parts += both(_soft(rng, (max(arm, 0.05), thick, length), (x, arm_top - thick / 2, z), 0.6))
        parts += [
            m for at in (z - length * 0.42, z + length * 0.42) for m in both(box((0.05, arm_top, 0.06), (x, arm_top / 2, at)))
        ]
    else:
        parts += both(_soft(rng, (arm, tall, length), (x, feet + tall / 2, z), hard))
    if chance(rng, 0.12):  # a raised footrest
        reach = rng.uniform(0.2, 0.45)
        parts.append(box((inner * 0.95, 0.08, reach), (0, seat * rng.uniform(0.4, 0.9), front + reach / 2)))
    return parts + (short_feet(rng, width, depth, feet + 0.05) if feet else [])


def _leaned(part: Mesh, pivot: float, lean: float) -> Mesh:
    """``part`` sheared backward above height ``pivot``, by ``lean`` metres half a metre higher."""
    points = part.vertices.copy()
    points[:, 2] -= lean * np.clip(points[:, 1] - pivot, 0.0, None) / 0.5
    return Mesh(points, part.faces)


def _tub(rng: np.random.Generator) -> list[Mesh]:
    """A wall bent round the seat in a U, as high in front as an arm and behind as a back."""
    width, depth = rng.uniform(0.62, 1.05), rng.uniform(0.6, 0.95)
    thick = rng.uniform(0.04, 0.24)
    feet = rng.uniform(0.03, 0.25) if chance(rng, 0.7) else 0.0
    seat, arm_top = rng.uniform(0.36, 0.46), rng.uniform(0.5, 0.68)
    top = arm_top if chance(rng, 0.25) else rng.uniform(0.68, 1.05)
    # Along the U: from the right arm's front round the back to the left arm's front.
    square, t = rng.uniform(2.0, 5.0), np.linspace(-0.5, np.pi + 0.5, 27)
    reach = (np.abs(np.cos(t)) ** square + np.abs(np.sin(t)) ** square) ** (-1.0 / square)
    x, z = (width - thick) / 2 * np.cos(t) * reach, -(depth - thick) / 2 * np.sin(t) * reach
    straight = np.clip(-np.sin(t), 0.0, None) / np.sin(0.5)
    z = np.where(straight > 0, straight * (depth / 2 - thick / 4), z)
    x = np.where(straight > 0, np.sign(x) * (width - thick) / 2 * (1.0 - rng.uniform(0, 0.1) * straight), x)
    rise = np.clip(np.sin(t), 0.0, 1.0) ** rng.uniform(0.7, 4.0)
    height = arm_top + (top - arm_top) * rise
    lean, flare = rng.uniform(0.0, 0.25), rng.uniform(0.0, 0.2)
    low = feet if chance(rng, 0.7) else min(seat - 0.16, feet + 0.2)
    levels = np.linspace(0.0, 1.0, 6)
    y = low + levels[:, None] * (height - low)
    out = 1.0 + flare * levels[:, None] * (y - low)
    grid = np.stack([x * out, y, z * out - lean * np.clip(y - seat, 0, None) * rise], axis=-1)
    soft = 0.4 + 0.6 * np.sin(np.pi * np.clip(levels, 0.02, 0.85))[:, None] if chance(rng, 0.5) else np.ones((6, 1))
    parts = [plate(grid, np.broadcast_to(thick * soft, y.shape))]
    parts.append(cushion((width - thick, seat - 0.1 - low, depth - thick), (0, (seat - 0.1 + low) / 2, 0.0), 0.1, 4.0))
    parts.append(cushion((width - 1.6 * thick, 0.14, depth - thick), (0, seat - 0.07, thick * 0.4), 0.7, 4.0, 0.15))
    if feet or low > feet:
        if chance(rng, 0.25):
            parts += [*star(rng, width * 0.38, 4, False), rod((0, 0.05, 0), (0, low + 0.01, 0), 0.03)]
        else:
            parts += short_feet(rng, width * 0.76, depth * 0.76, low + 0.05)
    return parts


def _wing(rng: np.random.Generator) -> list[Mesh]:
    """A tall padded back whose edges turn forward, over padded or rolled arms."""
    inner, depth = rng.uniform(0.48, 0.6), rng.uniform(0.55, 0.7)
    feet, seat = rng.uniform(0.08, 0.25), rng.uniform(0.4, 0.48)
    tall = rng.uniform(0.6, 0.85)
    frame = Frame(
        inner, depth, seat, 0.15, tall, rng.uniform(0.1, 0.35), 0.0, rng.uniform(0.02, 0.16), 1.05, rng.uniform(-0.15, 0.15)
    )
    u, v = np.meshgrid(np.linspace(-1, 1, 13), np.linspace(-0.15, 1, 9))
    v = v * (1.0 - rng.uniform(0.0, 0.25) * np.abs(u) ** 3)
    parts = [plate(frame.back(u * 1.05, v), rng.uniform(0.07, 0.15))]
    parts.append(box((inner + 0.04, seat - 0.12 - feet, depth), (0, (seat - 0.12 + feet) / 2, 0)))
    parts.append(cushion((inner, 0.15, depth), (0, seat - 0.07, 0.03), 0.7, 6.0, 0.1))
    arm, high = rng.uniform(0.06, 0.14), rng.uniform(0.15, 0.25)
    x = inner / 2 + arm / 2
    parts += both(
        cushion(
            (arm, seat + high - feet - 0.05, depth * rng.uniform(0.8, 1.0)),
            (x, (seat + high + feet + 0.05) / 2, 0.0),
            0.25,
            4.0,
        )
    )
    if chance(rng, 0.5):
        outline = oval(arm * 0.65, arm * 0.65, 2, 12) + [x, seat + high]
        ends = np.stack([np.column_stack([outline, np.full(12, z)]) for z in (-depth / 2, depth / 2 + 0.02)])
        parts += both(loft(ends))
    return parts + short_feet(rng, inner + arm, depth, feet + 0.04)


def _pads(rng: np.random.Generator) -> list[Mesh]:
    """Separate pads for seat, back, head and arms on a star, a pedestal or thin legs."""
    width, depth, seat = rng.uniform(0.5, 0.66), rng.uniform(0.48, 0.62), rng.uniform(0.34, 0.44)
    tall, lean = rng.uniform(0.4, 0.62), rng.uniform(0.15, 0.6)
    frame = Frame(width, depth, seat, 0.1, tall, lean, rng.uniform(-0.1, 0.1), rng.uniform(0.0, 0.12), rng.uniform(0.85, 1.05))
    parts = [cushion((width, rng.uniform(0.08, 0.18), depth), (0, seat - 0.05, 0.02), 0.8, rng.uniform(3, 6), 0.1)]
    levels = [-0.05, 1.0] if chance(rng, 0.4) else [0.02, rng.uniform(0.42, 0.6), 1.0]
    for low, high in zip(levels[:-1], levels[1:], strict=True):
        u, s = np.meshgrid(np.linspace(-1, 1, 11), np.linspace(0, 1, 7))
        narrow = 1.0 - rng.uniform(0.05, 0.3) * np.abs(2 * s - 1) ** 4
        parts.append(plate(frame.back(u * narrow, low + (high - low - 0.04) * s), rng.uniform(0.05, 0.13)))
    wide = rng.uniform(0.02, 0.08)
    for side in (0.0,) if chance(rng, 0.5) else (-0.5, 0.5):
        spine = frame.back(side, np.linspace(-0.1, 0.8, 5)) - [0, 0, 0.02]
        parts.append(sweep(spine, rectangle(wide, 0.02), side=(1, 0, 0)))
    if chance(rng, 0.5):
        head = frame.back(0.0, 1.0 + 0.12 / tall)
        parts.append(cushion((width * rng.uniform(0.4, 0.9), 0.17, 0.1), head, 0.8, 3.0))
        parts += both(rod(frame.back(0.2, 0.95), head + [0.08, 0, 0], 0.01, sides=6))
    if chance(rng, 0.75):
        x, high = width / 2 + 0.05, seat + rng.uniform(0.08, 0.2)
        parts += both(cushion((rng.uniform(0.09, 0.15), 0.08, depth * rng.uniform(0.5, 0.8)), (x, high, -0.05), 0.7, 3.0))
        parts += both(rod((x - 0.06, seat - 0.08, -0.1), (x, high, -0.12), 0.02, sides=6))
    return parts + base(rng, frame, {"office": 1, "pedestal": 3, "legs": 2, "wires": 1})
