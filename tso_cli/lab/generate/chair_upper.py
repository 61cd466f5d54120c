"""Seats, backs and arms of chairs. Lengths in metres; see `Frame` for where they meet."""

from __future__ import annotations

import numpy as np

from ...io.meshes import Mesh
from .chair_frame import Frame
from .parts import Array, both, box, chance, curve, cushion, oval, pick, plate, rectangle, rod, slab, sweep, tube


def seat(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """The seat: a board, a cushion, slats, or a hollowed sheet."""
    w, d, top, thick = frame.width, frame.depth, frame.height, frame.thick
    middle = (0.0, top - thick / 2.0, 0.0)
    power = frame.square
    kinds = {"board": 4.0, "cushion": 3.0, "board and cushion": 1.5}
    kind = pick(rng, kinds if power < 5.0 else kinds | {"slats": 0.8, "hollow": 1.5})
    if kind == "slats":
        count, along = int(rng.integers(4, 10)), chance(rng, 0.5)
        length = w if along else d
        wide = length / count * rng.uniform(0.55, 0.85)
        at = (np.arange(count) + 0.5) / count * length - length / 2.0
        slats = [box((wide, 0.02, d) if along else (w, 0.02, wide), (a, top, 0) if along else (0, top, a)) for a in at]
        rim = [box((w, thick, 0.03), (0, middle[1], z)) for z in (-d * 0.4, d * 0.4)]
        return slats + (rim if along else [box((0.03, thick, d), (x, middle[1], 0)) for x in (-w * 0.4, w * 0.4)])
    if kind == "hollow":
        u, v = np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 11))
        dip, edge = rng.uniform(0.0, 0.04), rng.uniform(0.0, 0.03)
        y = top - thick / 2.0 + dip * (u**2 - 0.5) * rng.uniform(0, 1) - edge * np.clip(v, 0, 1) ** 4 + dip * (v**2 - 0.5) * 0.5
        narrow = 1.0 - rng.uniform(0.0, 0.2) * (1.0 - v) / 2.0
        return [plate(np.stack([u * w / 2.0 * narrow, y, v * d / 2.0], axis=-1), thick)]
    parts = []
    if kind == "cushion":
        return [
            cushion((w, thick, d), middle, rng.uniform(0.3, 1.0), min(power, 12.0), rng.uniform(0.0, 0.4) * chance(rng, 0.5))
        ]
    outline = oval(w / 2.0, d / 2.0, power, 16)
    # Narrower behind than in front: a trapezoid.
    outline[:, 0] *= 1.0 - (rng.uniform(0.0, 0.25) if chance(rng, 0.5) else 0.0) * (1.0 - outline[:, 1] / (d / 2.0)) / 2.0
    parts.append(slab(outline, top - thick, top))
    if kind == "board and cushion":
        parts.append(cushion((w * 0.94, 0.05, d * 0.92), (0, top + 0.02, 0.01), 0.8, max(power, 3.0), 0.2))
    return parts


def back(rng: np.random.Generator, frame: Frame, kinds: dict[str, float] | None = None) -> list[Mesh]:
    """The back, of a kind drawn from ``kinds`` (a key of `BACKS` -> weight)."""
    weights = {"panel": 3.5, "posts": 5.0, "hoop": 1.6, "floating": 1.5, "captain": 0.7}
    return BACKS[pick(rng, kinds or weights)](rng, frame)


def _sheet(frame: Frame, low: float, high: float, thick: float, width: float, crown: float, foot: float, power: float) -> Mesh:
    """Part of the back between fractions ``low`` and ``high`` of its height, with a rounded top."""
    u, s = np.meshgrid(np.linspace(-1, 1, 11), np.linspace(0, 1, 9))
    # The outline narrows toward its upper and lower ends.
    narrow = 1.0 - 0.6 * crown * s**power - foot * (1.0 - s) ** power
    v = low + (high - low) * s * (1.0 - 0.6 * crown * (high - low) * np.abs(u) ** 2.5)
    return plate(frame.back(u * width * narrow, v), thick)


def _panel(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """A solid back from the seat up."""
    thick = rng.uniform(0.012, 0.035) if chance(rng, 0.6) else rng.uniform(0.04, 0.1)
    crown = rng.uniform(0.0, 0.5) if chance(rng, 0.5) else 0.0
    foot = rng.uniform(0.0, 0.4) if chance(rng, 0.3) else 0.0
    parts = [_sheet(frame, -0.03, 1.0, thick, rng.uniform(0.85, 1.0), crown, foot, rng.uniform(2, 5))]
    if chance(rng, 0.15):  # quilted in rolls
        parts = []
        count = int(rng.integers(3, 6))
        for k in range(count):
            parts.append(_sheet(frame, k / count, (k + 0.95) / count, max(thick, 0.05), 0.97, 0.03, 0.03, 4.0))
    return parts


def _floating(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """A panel some way above the seat on two posts, or on one spine."""
    thick, low = rng.uniform(0.015, 0.07), rng.uniform(0.2, 0.65)
    crown = rng.uniform(0.0, 0.4) if chance(rng, 0.5) else 0.0
    parts = [_sheet(frame, low, 1.0, thick, rng.uniform(0.8, 1.05), crown, crown * rng.uniform(0, 1), rng.uniform(2, 5))]
    v = np.linspace(-0.08, (low + 1.0) / 2.0, 6)
    radius = rng.uniform(0.007, 0.02)
    if chance(rng, 0.25):
        parts.append(sweep(frame.back(0.0, v) - [0, 0, radius], rectangle(rng.uniform(0.03, 0.09), 2 * radius), side=(1, 0, 0)))
    else:
        section = oval(radius, radius, 2, 8) if chance(rng, 0.6) else rectangle(3 * radius, 2 * radius)
        parts += both(sweep(frame.back(rng.uniform(0.4, 0.95), v) - [0, 0, radius], section, side=(1, 0, 0)))
    return parts


def _posts(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """Two posts and what lies between: rails, slats, spindles, a cross or a panel."""
    thick = rng.uniform(0.018, 0.05) if chance(rng, 0.88) else rng.uniform(0.05, 0.09)
    round_ = chance(rng, 0.3)
    section = oval(thick / 2, thick / 2, 2, 8) if round_ else rectangle(thick, thick * rng.uniform(0.6, 1.0))
    above = rng.uniform(0.0, 0.08) if chance(rng, 0.5) else 0.0
    edge = 1.0 - thick / frame.width
    parts = both(sweep(frame.back(edge, np.linspace(-0.1, 1.0 + above, 8)), section, side=(1, 0, 0)))

    def rail(v: float, high: float, deep: float = 0.02, arch: float = 0.0) -> Mesh:
        u = np.linspace(-edge, edge, 9)
        path = frame.back(u, v) + np.stack([0 * u, arch * (1.0 - u**2), 0 * u], axis=1)
        return sweep(path, rectangle(high, deep), side=(0, 1, 0))

    arch = rng.uniform(0.0, 0.06) if chance(rng, 0.35) else 0.0
    high = rng.uniform(0.025, 0.12)
    top = 1.0 - high / 2.0 / frame.back_height
    fill = pick(rng, {"ladder": 4, "slats": 4, "open": 1, "panel": 2, "cross": 0.8, "splat": 1})
    if fill == "panel":
        low = rng.uniform(0.05, 0.4)
        parts.append(_sheet(frame, low, rng.uniform(0.85, 1.0), rng.uniform(0.012, 0.05), edge, 0.0, 0.0, 2.0))
        return parts
    parts.append(rail(top, high, rng.uniform(0.015, 0.03), arch))
    if fill == "ladder":
        count, deep = int(rng.integers(1, 5)), rng.uniform(0.012, 0.025)
        low = rng.uniform(0.15, 0.5)
        wide = min(rng.uniform(0.02, 0.1), 0.8 * (top - low) * frame.back_height / (count + 0.5))
        parts += [rail(v, wide, deep, arch) for v in np.linspace(low, top, count, endpoint=False)]
    elif fill in ("slats", "splat"):
        low = rng.uniform(0.0, 0.3)
        if low > 0.06:
            parts.append(rail(low, rng.uniform(0.02, 0.05)))
        count = 1 if fill == "splat" else int(rng.integers(2, 9))
        wide = frame.width * (rng.uniform(0.2, 0.5) if fill == "splat" else rng.uniform(0.25, 0.75) / count)
        v = np.linspace(low - 0.02, top, 6)
        slim = oval(wide / 4, wide / 4, 2, 6) if fill == "slats" and chance(rng, 0.3) else rectangle(wide, 0.012)
        at = (2.0 * np.arange(count) + 1.0) / count - 1.0
        parts += [sweep(frame.back(a * edge * 0.95, v), slim, side=(1, 0, 0)) for a in at]
    elif fill == "cross":
        low, s = rng.uniform(0.0, 0.3), np.linspace(0.0, 1.0, 7)
        parts.append(rail(low + 0.03, 0.03))
        for sign in (1.0, -1.0):
            parts.append(
                sweep(frame.back(sign * edge * (2 * s - 1), low + (top - low) * s), rectangle(0.03, 0.015), side=(1, 0, 0))
            )
    return parts


def _hoop(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """A bent bow from seat to seat, with spindles, a smaller bow, slats or nothing inside."""
    radius = rng.uniform(0.008, 0.02) if chance(rng, 0.85) else rng.uniform(0.02, 0.045)
    t = np.linspace(0.0, np.pi, 21)
    square = rng.uniform(2.0, 4.5)
    reach = (np.abs(np.cos(t)) ** square + np.abs(np.sin(t)) ** square) ** (-1.0 / square)
    u, v = np.cos(t) * reach, np.sin(t) * reach
    section = oval(radius, radius, 2, 8) if chance(rng, 0.6) else rectangle(2.5 * radius, 2.0 * radius)
    # Its feet stand closer together than it is wide.
    waist = 1.0 - rng.uniform(0.0, 0.35) * (1.0 - v) ** 2
    parts = [sweep(frame.back(u * 0.97 * waist, v), section)]
    fill = pick(rng, {"spindles": 3, "bow": 2, "open": 1, "panel": 1, "rails": 1})
    if fill == "bow":
        size = rng.uniform(0.5, 0.8)
        parts.append(tube(frame.back(u * size * waist, v * rng.uniform(0.7, 0.92)), radius * 0.8, 6))
    elif fill == "spindles":
        count = int(rng.integers(3, 9))
        for a in ((2.0 * np.arange(count) + 1.0) / count - 1.0) * 0.9:
            end = float((1.0 - abs(a) ** square) ** (1.0 / square))
            parts.append(tube(frame.back(a * np.array([0.75, 1.0]), np.array([-0.02, end])), radius * rng.uniform(0.4, 0.7), 6))
    elif fill == "panel":
        parts.append(
            plate(frame.back(np.stack([u * 0.95 * s for s in np.linspace(-1, 1, 7)])[:, :11], np.stack([v[:11]] * 7)), 0.012)
        )
    elif fill == "rails":
        for at in rng.uniform(0.25, 0.8, int(rng.integers(1, 4))):
            end = 0.95 * float((1.0 - at**square) ** (1.0 / square))
            parts.append(sweep(frame.back(np.linspace(-end, end, 7), at), rectangle(0.04, 0.015), side=(0, 1, 0)))
    return parts


def _captain(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """A heavy rail round three sides at the height of arms, higher behind, on spindles; or two bent bows."""
    w, d, y = frame.width, frame.depth, frame.height
    t = np.linspace(-0.45, np.pi + 0.45, 19)
    x, z = (w / 2.0 + 0.02) * np.cos(t), -(d / 2.0 + 0.03) * np.sin(t)
    z = np.where(z > 0.0, z * 1.6, z)
    arm = rng.uniform(0.17, 0.26)
    top = arm if chance(rng, 0.4) else min(frame.back_height, arm + rng.uniform(0.05, 0.25))
    behind = np.clip(np.sin(t), 0.0, 1.0) ** 2
    level = y + arm + (top - arm) * behind
    lean = frame.lean * (level - y) * behind
    path = np.stack([x, level, z - lean], axis=1)
    thin = chance(rng, 0.35)
    section = oval(0.014, 0.014, 2, 8) if thin else rectangle(rng.uniform(0.03, 0.07), rng.uniform(0.02, 0.035))
    parts = [sweep(path, section, side=(0, 1, 0))]
    if not thin and top > arm:
        upper = path[5:14]
        parts.append(sweep(upper + [0, 0.02, 0], rectangle(rng.uniform(0.05, 0.1), 0.025), side=(0, 1, 0)))
    every = 1 if chance(rng, 0.5) else 2
    chosen = range(1, 18, every) if not thin or chance(rng, 0.5) else (1, 5, 13, 17)
    return parts + [
        rod(path[k] * [0.85, 0, 0.85] + [0, y - 0.01, 0], path[k], rng.uniform(0.006, 0.013), sides=6) for k in chosen
    ]


BACKS = {"panel": _panel, "posts": _posts, "hoop": _hoop, "floating": _floating, "captain": _captain}


def arms(rng: np.random.Generator, frame: Frame, kinds: dict[str, float] | None = None) -> list[Mesh]:
    """Both arms: a rest on posts, a bent tube, a closed board, or one bow round the back."""
    kind = pick(rng, kinds or {"rest": 4, "tube": 2, "board": 1, "bow": 1.5, "tee": 0.3})
    w, d, y = frame.width, frame.depth, frame.height
    high = min(rng.uniform(0.15, 0.28), 0.8 * frame.back_height)
    v = high / frame.back_height
    x = w / 2.0 + rng.uniform(-0.01, 0.03)
    behind = float(frame.back(1.0, v)[2])
    front = d / 2.0 * rng.uniform(0.4, 1.05)
    if kind == "board":
        thick = rng.uniform(0.02, 0.05)
        return both(
            box((thick, high + frame.thick, front - behind), (x, y + (high - frame.thick) / 2.0, (front + behind) / 2.0))
        )
    if kind == "tee":
        z = rng.uniform(-0.1, 0.05)
        stem = tube([(x - 0.06, y - 0.04, z), (x + 0.02, y - 0.03, z), (x + 0.02, y + high, z)], rng.uniform(0.01, 0.02), 6)
        return both(stem) + both(cushion((0.07, 0.03, rng.uniform(0.2, 0.3)), (x + 0.02, y + high, z + 0.03), 0.8, 4))
    if kind == "tube":
        radius, r = rng.uniform(0.008, 0.018), rng.uniform(0.03, 0.08)
        path = [
            (x, y - 0.03, front),
            (x, y + high - r, front),
            (x, y + high - 0.3 * r, front - 0.3 * r),
            (x, y + high, front - r),
        ]
        parts = both(tube([*path, (x, y + high, behind)], radius))
        if chance(rng, 0.5):
            parts += both(cushion((0.05, 0.03, 0.6 * (front - behind)), (x, y + high + 0.01, (front + behind) / 2.0), 0.7, 5))
        return parts
    post = rng.uniform(0.01, 0.022)
    if kind == "bow":
        t = np.linspace(-0.5, 1.0, 9) * np.pi / 2.0
        right = [(x, y + high, front * 0.8)] + [
            (x * np.cos(a), y + high, behind * 0.2 + (behind * 0.85) * np.sin(a)) for a in t[4:]
        ]
        bow = np.array(right)
        bow = np.concatenate([bow, bow[-2::-1] * [-1, 1, 1]])
        parts = [sweep(bow, rectangle(rng.uniform(0.02, 0.05), rng.uniform(0.02, 0.06)), side=(0, 1, 0))]
        count = int(rng.integers(1, 6))
        return parts + [
            m
            for z in np.linspace(front * 0.7, behind * 0.6, count)
            for m in both(rod((x * 0.88, y - 0.01, z), (x, y + high, z), post * 0.7, sides=6))
        ]
    rise = rng.uniform(-0.03, 0.04)
    wide, thick = rng.uniform(0.03, 0.09), rng.uniform(0.015, 0.035)
    rest = curve([(x, y + high, behind - 0.01), (x, y + high - abs(rise) / 2, 0.0), (x, y + high + rise, front + 0.02)], 7)
    parts = both(sweep(rest, rectangle(wide, thick), side=(1, 0, 0)))
    foot: Array = np.array([x, y - frame.thick, front * 0.92])
    parts += both(rod(foot, (x, y + high + rise, front * 0.92 - rng.uniform(0, 0.06)), post, sides=6))
    if chance(rng, 0.3):
        count = int(rng.integers(1, 5))
        parts += [
            m
            for z in np.linspace(behind * 0.7, front * 0.6, count)
            for m in both(rod((x, y - 0.02, z), (x, y + high - abs(rise) / 2, z), post * 0.7, sides=6))
        ]
    return parts
