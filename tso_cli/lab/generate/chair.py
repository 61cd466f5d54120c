"""Chairs, front +z, symmetric about x = 0, floor at y = 0. Lengths in metres."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...io.meshes import Mesh
from .chair_parts import Frame, arms, back, base, seat, sheet, short_feet, star
from .parts import (
    X_AXIS,
    Array,
    Range,
    both,
    box,
    chance,
    curve,
    cushion,
    draw,
    oval,
    pick,
    plate,
    rectangle,
    rod,
    superellipse,
    sweep,
    tube,
    wheel,
)

# Standard deviation of the logarithms by which a chair is stretched along x, y and z.
SPREAD = 0.08
WEIGHTS = {"dining": 36, "armchair": 21, "lounger": 13, "office": 10, "shell": 12, "bar": 8}
# Ranges of the fields of `Frame` but the last.
FRAMES: dict[str, tuple[Range, ...]] = {
    "dining": ((0.37, 0.54), (0.37, 0.52), (0.38, 0.5), (0.015, 0.06), (0.3, 0.6), (0, 0.3), (0, 0.1), (0.8, 1), (-0.1, 0.1)),
    "office": ((0.42, 0.54), (0.42, 0.52), (0.42, 0.54), (0.04, 0.12), (0.4, 0.75), (0, 0.3), (0, 0.1), (0.8, 1), (-0.2, 0.1)),
    "bar": ((0.28, 0.44), (0.28, 0.44), (0.6, 0.82), (0.02, 0.1), (0.15, 0.4), (0, 0.25), (0, 0.1), (0.8, 1), (0, 0)),
    "wing": ((0.48, 0.6), (0.55, 0.7), (0.4, 0.48), (0.15, 0.15), (0.6, 0.85), (0.1, 0.3), (0, 0.15), (1, 1), (-0.1, 0.1)),
}


def build(rng: np.random.Generator, kind: str) -> list[Mesh]:
    """The parts of a chair of a kind in `WEIGHTS`."""
    return KINDS[kind](rng)


def _frame(rng: np.random.Generator, kind: str) -> Frame:
    square = float(rng.choice([2.0, 3.0, 6.0, 30.0], p=[0.17, 0.13, 0.2, 0.5]))
    return replace(Frame(*draw(rng, FRAMES[kind])), square=square)


def _dining(rng: np.random.Generator) -> list[Mesh]:
    """Seat, base, back and sometimes arms, each of any kind."""
    frame = _frame(rng, "dining")
    if chance(rng, 0.3):
        frame = replace(frame, thick=rng.uniform(0.05, 0.14))
    backs = {"panel": 3.5, "posts": 5.0, "hoop": 1.6, "floating": 1.5}
    bases = {"legs": 12, "sled": 1.5, "cantilever": 1.5, "crossed": 1, "panels": 0.8, "wires": 1, "pedestal": 0.6}
    if armed := chance(rng, 0.3):
        frame = replace(frame, width=frame.width + 0.09)
    parts = seat(rng, frame) + back(rng, frame, backs) + base(rng, frame, bases)
    return parts + (arms(rng, frame, {"rest": 5, "tube": 2, "board": 1}) if armed else [])


def _office(rng: np.random.Generator) -> list[Mesh]:
    """A padded seat and back on a column over a star of casters."""
    frame = replace(_frame(rng, "office"), square=30.0)
    size, top = (frame.width, frame.thick, frame.depth), frame.height - frame.thick
    parts = [cushion(size, (0, top + frame.thick / 2, 0), 0.6, rng.uniform(2.5, 8), 0.1)]
    low = rng.uniform(-0.05, 0.35)
    parts.append(sheet(frame, low, 1.0, rng.uniform(0.03, 0.11), 1.0, rng.uniform(0.0, 0.35)))
    if low > 0:
        behind = frame.back(0.0, low + 0.15) - [0, 0, 0.02]
        parts += [rod((0, top, -0.1), (0, top, behind[2]), 0.02), rod((0, top, behind[2]), behind, 0.02)]
    if chance(rng, 0.2):
        parts.append(cushion((0.26, 0.14, 0.07), frame.back(0.0, 1.15), 0.8, 3))
    if chance(rng, 0.65):
        parts += arms(rng, frame, {"tee": 4, "tube": 2, "rest": 1})
    return parts + base(rng, frame, {"office": 9, "pedestal": 0.6, "sled": 0.4})


def _bar(rng: np.random.Generator) -> list[Mesh]:
    """A small seat on long legs, with a low back or none; or a low stool."""
    frame = _frame(rng, "bar")
    if low := chance(rng, 0.25):
        frame = replace(frame, height=rng.uniform(0.26, 0.5))
    parts = seat(rng, frame) + base(rng, frame, {"legs": 6, "pedestal": 3, "sled": 0.7, "wires": 0.9})
    if not low and chance(rng, 0.6):
        parts += back(rng, frame, {"panel": 3, "posts": 2, "floating": 3, "hoop": 1})
    if not low and chance(rng, 0.5):
        angle, radius = np.linspace(0.0, 2.0 * np.pi, 20, endpoint=False), frame.width * rng.uniform(0.35, 0.55)
        level = np.full(20, frame.height * rng.uniform(0.25, 0.45))
        ring = np.stack([radius * np.sin(angle), level, radius * np.cos(angle)], axis=1)
        parts.append(tube(ring, 0.01, 6, closed=True))
    return parts


def _shell(rng: np.random.Generator) -> list[Mesh]:
    """Seat and back bent from one sheet, on any base."""
    width, depth, height, high, lean = draw(rng, ((0.42, 0.62), (0.4, 0.55), (0.4, 0.48), (0.28, 0.55), (0.08, 0.4)))
    front, hollow, end, taper, waist = draw(rng, ((0.0, 0.05), (0.0, 0.04), (0.0, 0.45), (0.0, 0.35), (0.0, 0.25)))
    z = depth / 2
    profile = [(height - front, z), (height + 0.01, z * 0.75), (height - hollow, -z * 0.3), (height + 0.03, -z * 0.8)]
    profile += [(height + high * 0.35, -z - 0.35 * lean * high), (height + high, -z - lean * high)]
    line = curve(profile, 19)
    s, u = np.linspace(0, 1, 19)[:, None], np.linspace(-1, 1, 13)[None, :]
    ends = np.abs(2 * s - 1)
    wide = width / 2 * (1.0 - end * ends ** rng.uniform(3, 8)) * (1.0 - taper * chance(rng, 0.3) * s)
    wide = wide * (1.0 - waist * chance(rng, 0.4) * np.exp(-((s - 0.5) ** 2) / 0.02))
    # Bucket shells curl upward beside the seat and forward beside the back.
    curl = rng.uniform(0.0, 0.22) * chance(rng, 0.6) * np.abs(u) ** rng.uniform(2, 4)
    bowl = np.clip(1.15 - ends, 0, 1) if chance(rng, 0.5) else np.clip(1.2 - s, 0.2, 1)
    beside_back = np.clip((s - 0.45) / 0.2, 0, 1)
    y = line[:, :1] + curl * bowl * (1.0 - 0.6 * beside_back)
    # A rounded upper edge.
    y = y - rng.uniform(0.0, 0.12) * np.abs(u) ** 3 * np.clip((s - 0.8) / 0.2, 0, 1)
    thick = rng.uniform(0.008, 0.03) if chance(rng, 0.7) else rng.uniform(0.03, 0.09)
    parts = [plate(np.stack([u * wide, y, line[:, 1:] + curl * beside_back * rng.uniform(0.2, 1.0)], axis=-1), thick)]
    if chance(rng, 0.2):
        parts.append(cushion((width * 0.8, 0.04, depth * 0.8), (0, height + 0.01, 0), 0.8, 4))
    frame = Frame(width * 0.85, depth * 0.85, height - 0.02, 0.03, high)
    return parts + base(rng, frame, {"legs": 4, "wires": 2, "pedestal": 2, "sled": 1.5, "office": 0.6, "cantilever": 0.5})


def _strip(points: Array, width: float, thick: float) -> Mesh:
    """A sheet of constant width along points [N, 2] of (height, z)."""
    u = np.linspace(-1, 1, 5)[None, :]
    y, z = points[:, :1] + 0.0 * u, points[:, 1:] + 0.0 * u
    return plate(np.stack([u * width / 2 + 0.0 * z, y, z], axis=-1), thick)


def _lounger(rng: np.random.Generator) -> list[Mesh]:
    """A chair to lie or lean back in."""
    return {"chaise": _chaise, "beach": _beach, "easy": _easy}[pick(rng, {"chaise": 2, "beach": 2.5, "easy": 4.5})](rng)


def _chaise(rng: np.random.Generator) -> list[Mesh]:
    """A long wave, legs to head, over a frame of tubes."""
    width, thick, low, knee, head = draw(rng, ((0.48, 0.65), (0.03, 0.1), (0.22, 0.34), (0.3, 0.45), (0.65, 0.95)))
    knots = [(knee - rng.uniform(0.02, 0.15), 0.75), (knee, 0.4), (low, -0.1), (low + 0.15, -0.38), (head, -0.75)]
    line, radius, x = curve(knots, 25), rng.uniform(0.01, 0.02), width / 2 * 0.95
    parts = [_strip(line, width, thick), *both(tube([(x, y - thick / 2, z) for y, z in line[::3]], radius, 6))]
    if chance(rng, 0.6):
        parts.append(rod((-width / 2, head - 0.02, -0.68), (width / 2, head - 0.02, -0.68), rng.uniform(0.04, 0.08), sides=12))
    for z in (rng.uniform(0.1, 0.4), -rng.uniform(0.2, 0.5)):
        y = float(np.interp(-z, -line[:, 1], line[:, 0])) - thick / 2
        parts += both(rod((x, y, z), (x, 0, z * rng.uniform(0.9, 1.2)), radius, sides=6))
        parts.append(rod((-x, 0.03, z), (x, 0.03, z), radius, sides=6))
    return parts


def _beach(rng: np.random.Generator) -> list[Mesh]:
    """A long flat bed on legs with a raised head end; some have wheels or arms."""
    width, height, thick, front, length = draw(rng, ((0.5, 0.7), (0.22, 0.38), (0.02, 0.08), (0.7, 1.15), (0.5, 0.75)))
    rise = np.radians(rng.uniform(15, 60))
    head, x = (height + length * np.sin(rise), -length * np.cos(rise)), width / 2 - 0.02
    middle = (height, 0.0)
    parts = [_strip(np.array(ends), width, thick) for ends in (((height, front), middle), (middle, head))]
    for z in (front * rng.uniform(0.3, 0.9), front * 0.92, -rng.uniform(0.1, 0.35)):
        parts += both(rod((x, height, z), (x, 0, z), rng.uniform(0.012, 0.025), sides=6))
    if chance(rng, 0.35):
        parts += both(wheel(np.array([x + 0.05, 0.1, -0.3]), 0.1, 0.03, 0, 14))
        parts.append(rod((-x - 0.05, 0.1, -0.3), (x + 0.05, 0.1, -0.3), 0.01))
    if chance(rng, 0.5):
        high = height + rng.uniform(0.12, 0.22)
        parts += both([box((0.05, 0.025, 0.45), (x + 0.04, high, -0.05)), rod((x, height, 0.1), (x + 0.04, high, 0.12), 0.012)])
    return parts


def _easy(rng: np.random.Generator) -> list[Mesh]:
    """A low armchair: a bent sling or cushion in an open frame of wood or tube."""
    width, height, depth, slope = draw(rng, ((0.5, 0.72), (0.3, 0.42), (0.5, 0.62), (0.05, 0.3)))
    lean, high, top, radius = draw(rng, ((0.25, 0.6), (0.45, 0.7), (0.5, 0.62), (0.01, 0.022)))
    z, low, x = depth / 2, height - slope * depth, width / 2 + rng.uniform(0.0, 0.05)
    line = curve([(height, z), (low + 0.02, -z * 0.7), (low + 0.08, -z), (low + 0.08 + high, -z - lean * high)], 17)
    parts = [_strip(line, width, rng.uniform(0.015, 0.03) if chance(rng, 0.5) else rng.uniform(0.06, 0.14))]
    front, behind = z * rng.uniform(0.8, 1.2), -z * rng.uniform(1.0, 1.4)
    for y, at in ((low, behind * 0.8), (height - 0.03, front)):
        parts.append(rod((-x, y, at), (x, y, at), radius))
    form = pick(rng, {"loop": 4, "bent": 2, "legs": 1})
    if form == "legs":
        frame = Frame(width * 0.9, depth, low, 0.02, 0.5)
        return parts + base(rng, frame, {"legs": 2, "sled": 1, "wires": 1, "crossed": 1, "pedestal": 1})
    if form == "bent":
        knots = [(x, height + 0.02, -z * 0.9), (x, top, -z * 0.2), (x, top, front), (x, top * 0.5, front + 0.06)]
        bent = curve([*knots, (x, radius, front - 0.05), (x, radius, behind)], 21)
        return parts + both(sweep(bent, rectangle(0.06, 0.025), side=X_AXIS))
    path = [(x, top, behind), (x, top, front - 0.05), (x, top - 0.05, front), (x, 0.05, front), (x, radius, front - 0.05)]
    section = oval(radius, radius, 2, 8) if chance(rng, 0.5) else rectangle(0.05, 0.02)
    parts += both(sweep([*path, (x, radius, behind + 0.05), (x, 0.05, behind)], section, side=X_AXIS, closed=True))
    if chance(rng, 0.4):
        pad = (0.08, rng.uniform(0.04, 0.1), front - behind)
        parts += both(cushion(pad, (x, top + 0.02, (front + behind) / 2), 0.7, 4.0))
    return parts


def _armchair(rng: np.random.Generator) -> list[Mesh]:
    """An upholstered armchair."""
    return {"block": _block, "tub": _tub, "wing": _wing}[pick(rng, {"block": 5, "tub": 3, "wing": 2})](rng)


def _block(rng: np.random.Generator) -> list[Mesh]:
    """Seat, two arms and a back, each a thick block."""
    arm, behind, inner, inner_depth = draw(rng, ((0.06, 0.28), (0.1, 0.32), (0.42, 0.68), (0.42, 0.7)))
    seat_top, arm_top, padding, length = draw(rng, ((0.36, 0.48), (0.5, 0.7), (0.1, 0.2), (0.85, 1.0)))
    width, depth, feet = inner + 2 * arm, inner_depth + behind, rng.uniform(0.02, 0.18) * chance(rng, 0.65)
    top = rng.uniform(0.68, 1.1) if chance(rng, 0.75) else arm_top
    hard, front, under = rng.choice([0.2, 0.5, 0.7, 1.0]), depth / 2, seat_top - padding
    lean = rng.uniform(0.0, 0.3) * (top - seat_top)

    def block(size: tuple[float, float, float], centre: tuple[float, float, float]) -> Mesh:
        return box(size, centre) if hard > 0.8 else cushion(size, centre, 0.15 + 0.7 * (1 - hard), 4.0 + 10.0 * hard)

    parts = [box((inner + 0.02, under - feet, depth - 0.04), (0, (under + feet) / 2, 0))]
    parts.append(cushion((inner, padding, inner_depth + 0.03), (0, seat_top - padding / 2, front - inner_depth / 2), 0.6, 8.0))
    size = (width if chance(rng, 0.5) else inner + 0.02, top - feet, behind * rng.uniform(0.8, 1.0))
    parts.append(_leaned(block(size, (0, (feet + top) / 2, -front + behind / 2)), seat_top, lean))
    if chance(rng, 0.45):
        high = max(top - seat_top, 0.2) * rng.uniform(0.8, 1.15)
        pad = cushion((inner * 0.96, high, 0.15), (0, seat_top + high / 2, -front + behind + 0.05), 0.15, 4.0)
        parts.append(_leaned(pad, seat_top, lean))
    x, z = inner / 2 + arm / 2, (1.0 - length) * depth / 2 * rng.choice([-1.0, 1.0])
    form = pick(rng, {"block": 5, "roll": 2, "open": 1})
    length *= depth
    if form == "open":
        posts = [box((0.05, arm_top, 0.06), (x, arm_top / 2, z + side * 0.42 * length)) for side in (-1, 1)]
        parts += both([cushion((max(arm, 0.05), 0.05, length), (x, arm_top - 0.025, z), 0.4, 10.0), *posts])
    else:
        parts += both(block((arm, arm_top - feet, length), (x, (feet + arm_top) / 2, z)))
    if form == "roll":
        parts += both(rod((x, arm_top, z - length / 2), (x, arm_top, z + length / 2), arm * rng.uniform(0.5, 0.65), sides=14))
    if chance(rng, 0.12):
        reach = rng.uniform(0.2, 0.45)
        parts.append(box((inner * 0.95, 0.08, reach), (0, seat_top * rng.uniform(0.4, 0.9), front + reach / 2)))
    return parts + (short_feet(rng, width, depth, feet + 0.05) if feet else [])


def _leaned(part: Mesh, pivot: float, lean: float) -> Mesh:
    """``part`` sheared backward above height ``pivot``, by ``lean`` half a metre higher."""
    shear = np.clip(part.vertices[:, 1:2] - pivot, 0.0, None) / 0.5 * [0.0, 0.0, lean]
    return Mesh(part.vertices - shear, part.faces)


def _tub(rng: np.random.Generator) -> list[Mesh]:
    """A wall bent round the seat in a U, as high in front as an arm and behind as a back."""
    width, depth, thick, seat_top, arm_top = draw(rng, ((0.62, 1.0), (0.6, 0.95), (0.04, 0.24), (0.36, 0.46), (0.5, 0.68)))
    lean, flare, narrow = draw(rng, ((0.0, 0.25), (0.0, 0.2), (0.0, 0.1)))
    feet = rng.uniform(0.03, 0.25) * chance(rng, 0.7)
    top = arm_top if chance(rng, 0.25) else rng.uniform(0.68, 1.05)
    # From the right arm's front round the back to the left arm's front.
    t = np.linspace(-0.5, np.pi + 0.5, 27)
    x, z = ((superellipse(t, rng.uniform(2.0, 5.0)) * [width - thick, thick - depth]) / 2).T
    straight = np.clip(-np.sin(t), 0.0, None) / np.sin(0.5)
    z = np.where(straight > 0, straight * (depth / 2 - thick / 4), z)
    x = np.where(straight > 0, np.sign(x) * (width - thick) / 2 * (1.0 - narrow * straight), x)
    rise, levels = np.clip(np.sin(t), 0.0, 1.0) ** rng.uniform(0.7, 4.0), np.linspace(0.0, 1.0, 6)[:, None]
    y = feet + levels * (arm_top + (top - arm_top) * rise - feet)
    out = 1.0 + flare * levels * (y - feet)
    grid = np.stack([x * out, y, z * out - lean * np.clip(y - seat_top, 0, None) * rise], axis=-1)
    soft = 0.4 + 0.6 * np.sin(np.pi * np.clip(levels, 0.02, 0.85)) if chance(rng, 0.5) else np.ones((6, 1))
    parts = [plate(grid, np.broadcast_to(thick * soft, y.shape))]
    parts.append(cushion((width - thick, seat_top - 0.1 - feet, depth - thick), (0, (seat_top - 0.1 + feet) / 2, 0), 0.1, 4.0))
    parts.append(cushion((width - 1.6 * thick, 0.14, depth - thick), (0, seat_top - 0.07, thick * 0.4), 0.7, 4.0, 0.15))
    if not feet:
        return parts
    if chance(rng, 0.25):
        return [*parts, *star(rng, width * 0.38, 4, False), rod((0, 0.05, 0), (0, feet + 0.01, 0), 0.03)]
    return parts + short_feet(rng, width * 0.76, depth * 0.76, feet + 0.05)


def _wing(rng: np.random.Generator) -> list[Mesh]:
    """A tall padded back whose edges turn forward, over padded arms."""
    frame, feet = replace(_frame(rng, "wing"), square=30.0), rng.uniform(0.08, 0.25)
    inner, depth, under = frame.width, frame.depth, frame.height - 0.12
    parts = [sheet(frame, -0.15, 1.0, rng.uniform(0.07, 0.15), 1.05, rng.uniform(0.0, 0.4))]
    parts.append(box((inner + 0.04, under - feet, depth), (0, (under + feet) / 2, 0)))
    parts.append(cushion((inner, 0.15, depth), (0, frame.height - 0.07, 0.03), 0.7, 6.0, 0.1))
    arm, high = rng.uniform(0.06, 0.14), frame.height + rng.uniform(0.15, 0.25)
    x = inner / 2 + arm / 2
    parts += both(cushion((arm, high - feet, depth * rng.uniform(0.8, 1.0)), (x, (high + feet) / 2, 0.0), 0.25, 4.0))
    if chance(rng, 0.5):
        parts += both(rod((x, high, -depth / 2), (x, high, depth / 2 + 0.02), arm * 0.65, sides=12))
    return parts + short_feet(rng, inner + arm, depth, feet + 0.04)


KINDS = {"dining": _dining, "armchair": _armchair, "lounger": _lounger, "office": _office, "shell": _shell, "bar": _bar}
