"""Seats, backs, arms and bases of chairs, front +z, symmetric about x = 0, floor at y = 0. Lengths in metres."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...io.meshes import Mesh
from .parts import (
    X_AXIS,
    Array,
    bar,
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
    tube,
    turned,
)


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
        across, up = np.broadcast_arrays(np.asarray(u, dtype=np.float64), np.asarray(v, dtype=np.float64))
        x = across * self.width / 2.0 * self.back_width * min(1.0, 1.12 * self.corner) * (1.0 + self.flare * up)
        # The back follows the rear edge of a round seat.
        follow = (1.0 - self.corner) * self.depth / 2.0 * across**2
        z = -self.depth / 2.0 + 0.015 - self.lean * up * self.back_height + self.wrap * (across**2 - 1.0) + follow
        return np.stack([x, self.height + up * self.back_height, z], axis=-1)


def seat(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """A board, a cushion, slats, or a hollowed sheet."""
    w, d, top, thick = frame.width, frame.depth, frame.height, frame.thick
    kinds = {"board": 4.0, "cushion": 3.0, "board and cushion": 1.5}
    kind = pick(rng, kinds if frame.square < 5.0 else kinds | {"slats": 0.8, "hollow": 1.5})
    middle = (0.0, top - thick / 2.0, 0.0)
    if kind == "slats":
        count = int(rng.integers(4, 10))
        wide = d / count * rng.uniform(0.55, 0.85)
        slats = [box((w, 0.02, wide), (0, top, z)) for z in ((np.arange(count) + 0.5) / count - 0.5) * d]
        return slats + both(box((0.03, thick, d), (w * 0.4, middle[1], 0)))
    if kind == "hollow":
        u, v = np.meshgrid(np.linspace(-1, 1, 9), np.linspace(-1, 1, 11))
        dip, edge, narrow = draw(rng, ((0.0, 0.04), (0.0, 0.03), (0.0, 0.1)))
        y = top - thick / 2.0 + dip * (u**2 + v**2 - 1.0) / 2.0 - edge * np.clip(v, 0, 1) ** 4
        return [plate(np.stack([u * w / 2.0 * (1.0 - narrow * (1.0 - v)), y, v * d / 2.0], axis=-1), thick)]
    if kind == "cushion":
        puff = rng.uniform(0.0, 0.4) * chance(rng, 0.5)
        return [cushion((w, thick, d), middle, rng.uniform(0.3, 1.0), min(frame.square, 12.0), puff)]
    outline = oval(w / 2.0, d / 2.0, frame.square, 16)
    # Narrower behind than in front: a trapezoid.
    outline[:, 0] *= 1.0 - rng.uniform(0.0, 0.12) * chance(rng, 0.5) * (1.0 - outline[:, 1] / (d / 2.0))
    parts = [loft([flat(outline, top - thick), flat(outline, top)])]
    if kind == "board and cushion":
        parts.append(cushion((w * 0.94, 0.05, d * 0.92), (0, top + 0.02, 0.01), 0.8, max(frame.square, 3.0), 0.2))
    return parts


def back(rng: np.random.Generator, frame: Frame, kinds: dict[str, float]) -> list[Mesh]:
    """A back of a kind in `BACKS`, drawn by weight."""
    return BACKS[pick(rng, kinds)](rng, frame)


def sheet(frame: Frame, low: float, high: float, thick: float, width: float = 0.97, crown: float = 0.0) -> Mesh:
    """The back between fractions ``low`` and ``high`` of its height; ``crown`` rounds the top."""
    u, s = np.meshgrid(np.linspace(-1, 1, 11), np.linspace(0, 1, 9))
    v = low + (high - low) * s * (1.0 - 0.6 * crown * (high - low) * np.abs(u) ** 2.5)
    return plate(frame.back(u * width * (1.0 - 0.6 * crown * s**3), v), thick)


def _bar_section(rng: np.random.Generator, radius: float) -> Array:
    """A round or a flat section."""
    return oval(radius, radius, 2.0, 8) if chance(rng, 0.5) else rectangle(2.5 * radius, 2.0 * radius)


def _panel(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """A solid back from the seat up, sometimes quilted in rolls."""
    thick = rng.uniform(0.012, 0.035) if chance(rng, 0.6) else rng.uniform(0.04, 0.1)
    if chance(rng, 0.15):
        count = int(rng.integers(3, 6))
        return [sheet(frame, k / count, (k + 0.95) / count, max(thick, 0.05)) for k in range(count)]
    return [sheet(frame, -0.03, 1.0, thick, rng.uniform(0.85, 1.0), rng.uniform(0.0, 0.5) * chance(rng, 0.5))]


def _floating(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """A panel above the seat on two posts, or on one spine."""
    low, radius = rng.uniform(0.2, 0.65), rng.uniform(0.007, 0.02)
    crown = rng.uniform(0.0, 0.4) * chance(rng, 0.5)
    parts = [sheet(frame, low, 1.0, rng.uniform(0.015, 0.07), rng.uniform(0.8, 1.05), crown)]
    v = np.linspace(-0.08, (low + 1.0) / 2.0, 6)
    if chance(rng, 0.25):
        spine = rectangle(rng.uniform(0.03, 0.09), 2 * radius)
        return [*parts, sweep(frame.back(0.0, v) - [0, 0, radius], spine, side=X_AXIS)]
    posts = frame.back(rng.uniform(0.4, 0.95), v) - [0, 0, radius]
    return parts + both(sweep(posts, _bar_section(rng, radius), side=X_AXIS))


def _posts(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """Two posts and what lies between: rails, slats or a panel."""
    thick = rng.uniform(0.018, 0.05) if chance(rng, 0.88) else rng.uniform(0.05, 0.09)
    edge, above = 1.0 - thick / frame.width, rng.uniform(0.0, 0.08) * chance(rng, 0.5)
    posts = frame.back(edge, np.linspace(-0.1, 1.0 + above, 8))
    parts = both(sweep(posts, _bar_section(rng, thick / 2.0), side=X_AXIS))
    fill = pick(rng, {"ladder": 5, "slats": 6, "panel": 2})
    low = rng.uniform(0.05, 0.4)
    if fill == "panel":
        return [*parts, sheet(frame, low, rng.uniform(0.85, 1.0), rng.uniform(0.012, 0.05), edge)]
    high, arch = rng.uniform(0.025, 0.12), rng.uniform(0.0, 0.06) * chance(rng, 0.35)
    top, u = 1.0 - high / 2.0 / frame.back_height, np.linspace(-edge, edge, 9)
    bow = np.stack([0.0 * u, arch * (1.0 - u**2), 0.0 * u], axis=1)
    parts.append(sweep(frame.back(u, top) + bow, rectangle(high, rng.uniform(0.015, 0.03)), side=(0, 1, 0)))
    if fill == "ladder":
        count = int(rng.integers(0, 5))
        section = rectangle(min(rng.uniform(0.02, 0.1), 0.8 * (top - low) * frame.back_height / (count + 0.5)), 0.018)
        rails = np.linspace(low, top, count, endpoint=False)
        return parts + [sweep(frame.back(u, v) + bow, section, side=(0, 1, 0)) for v in rails]
    count = int(rng.integers(1, 9))
    wide = frame.width * rng.uniform(0.25, 0.75) / (count + 1)
    section = oval(wide / 4, wide / 4, 2, 6) if count > 2 and chance(rng, 0.3) else rectangle(wide, 0.012)
    parts.append(sweep(frame.back(u, low), rectangle(0.03, 0.02), side=(0, 1, 0)))
    at = ((2.0 * np.arange(count) + 1.0) / count - 1.0) * edge * 0.95
    return parts + [sweep(frame.back(a, np.linspace(low, top, 6)), section, side=X_AXIS) for a in at]


def _hoop(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """A bent bow from seat to seat, with spindles or a smaller bow inside."""
    radius, power = rng.uniform(0.008, 0.025), rng.uniform(2.0, 4.5)
    u, v = superellipse(np.linspace(0.0, np.pi, 21), power).T
    # Its feet stand closer together than it is wide.
    u = u * (1.0 - rng.uniform(0.0, 0.35) * (1.0 - v) ** 2)
    parts = [sweep(frame.back(u * 0.97, v), _bar_section(rng, radius))]
    if chance(rng, 0.25):
        return [*parts, tube(frame.back(u * rng.uniform(0.5, 0.8), v * rng.uniform(0.7, 0.92)), radius * 0.8, 6)]
    count, thin = int(rng.integers(3, 9)), radius * rng.uniform(0.4, 0.7)
    for a in ((2.0 * np.arange(count) + 1.0) / count - 1.0) * 0.9:
        top = float((1.0 - abs(a) ** power) ** (1.0 / power))
        parts.append(tube(frame.back(a * np.array([0.75, 1.0]), np.array([-0.02, top])), thin, 6))
    return parts


BACKS = {"panel": _panel, "posts": _posts, "hoop": _hoop, "floating": _floating}


def arms(rng: np.random.Generator, frame: Frame, kinds: dict[str, float]) -> list[Mesh]:
    """Both arms: a rest on posts, a bent tube, a closed board, or a pad on a stem (tee)."""
    kind, y = pick(rng, kinds), frame.height
    high = min(rng.uniform(0.15, 0.28), 0.8 * frame.back_height)
    x, front = frame.width / 2.0 + rng.uniform(-0.01, 0.03), frame.depth / 2.0 * rng.uniform(0.4, 1.05)
    behind = float(frame.back(1.0, high / frame.back_height)[2])
    middle = (front + behind) / 2.0
    if kind == "board":
        size = (rng.uniform(0.02, 0.05), high + frame.thick, front - behind)
        return both(box(size, (x, y + (high - frame.thick) / 2.0, middle)))
    if kind == "tee":
        z = rng.uniform(-0.1, 0.05)
        stem = tube([(x - 0.06, y - 0.04, z), (x + 0.02, y - 0.03, z), (x + 0.02, y + high, z)], rng.uniform(0.01, 0.02), 6)
        return both([stem, cushion((0.07, 0.03, rng.uniform(0.2, 0.3)), (x + 0.02, y + high, z + 0.03), 0.8, 4)])
    if kind == "tube":
        radius, r = rng.uniform(0.008, 0.018), rng.uniform(0.03, 0.08)
        path = [(x, y - 0.03, front), (x, y + high - r, front), (x, y + high - 0.3 * r, front - 0.3 * r)]
        parts = both(tube([*path, (x, y + high, front - r), (x, y + high, behind)], radius))
        if chance(rng, 0.5):
            parts += both(cushion((0.05, 0.03, 0.6 * (front - behind)), (x, y + high + 0.01, middle), 0.7, 5))
        return parts
    rise, post = rng.uniform(-0.03, 0.04), rng.uniform(0.01, 0.022)
    rest = curve([(x, y + high, behind - 0.01), (x, y + high, 0.0), (x, y + high + rise, front + 0.02)], 7)
    parts = [sweep(rest, rectangle(rng.uniform(0.03, 0.09), rng.uniform(0.015, 0.035)), side=X_AXIS)]
    for z in np.linspace(front * 0.92, behind * 0.7, int(rng.integers(2, 5)) if chance(rng, 0.3) else 1):
        parts.append(rod((x, y - frame.thick, z), (x, y + high, z), post, sides=6))
    return both(parts)


def base(rng: np.random.Generator, frame: Frame, kinds: dict[str, float]) -> list[Mesh]:
    """What carries the seat, of a kind in `BASES`, drawn by weight."""
    inside = min(1.0, 1.03 * frame.corner)
    return BASES[pick(rng, kinds)](rng, replace(frame, width=frame.width * inside, depth=frame.depth * inside))


def _legs(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """Four legs: straight, tapered, sabre or turned; with or without stretchers and an apron."""
    top, form = frame.height - frame.thick * 0.7, pick(rng, {"straight": 5, "tapered": 4, "sabre": 2, "turned": 1.5})
    round_ = form == "turned" or chance(rng, 0.4)
    thick = rng.uniform(0.018, 0.055) if chance(rng, 0.88) else rng.uniform(0.055, 0.1)
    inset = thick / 2.0 + rng.uniform(0.0, 0.06) * chance(rng, 0.5)
    splay, splay_back, narrow = rng.uniform(0.0, 0.22) * chance(rng, 0.5), rng.uniform(0.0, 0.2), rng.uniform(0.85, 1.0)
    bow = rng.uniform(0.03, 0.08) * (form == "sabre")
    t = np.linspace(0.0, 1.0, {"sabre": 7, "turned": 15}.get(form, 2))

    def leg(front: bool, down: Array | float) -> Array:
        """Points of the right leg at shares of the way down."""
        down, sign = np.asarray(down, dtype=np.float64), 1.0 if front else -1.0
        x = (frame.width / 2.0 - inset) * (1.0 if front else narrow) + splay * 0.6 * top * down
        out = (splay if front else splay_back) * top * down + bow * (2.0 * down**2 - down)
        return np.stack(np.broadcast_arrays(x, top * (1.0 - down), sign * (frame.depth / 2.0 - inset + out)), axis=-1)

    scale = 1.0 + t * (rng.uniform(-0.5, -0.2) if form in ("tapered", "sabre") else 0.0)
    if form == "turned":
        scale = 1.0 + rng.uniform(0.1, 0.35) * np.sin(rng.uniform(6, 20) * t + rng.uniform(0, 6)) * np.sin(np.pi * t)
    section = oval(thick / 2.0, thick / 2.0, 2.0, 8) if round_ else rectangle(thick, thick * rng.uniform(0.7, 1.3))
    parts = [part for front in (True, False) for part in both(sweep(leg(front, t), section, scale, X_AXIS))]
    flip = np.array([-1.0, 1.0, 1.0])
    if chance(rng, 0.45):
        at, cross, radius = rng.uniform(0.45, 0.8), rng.uniform(0.35, 0.85), thick * rng.uniform(0.2, 0.4)
        parts += both(rod(leg(True, at), leg(False, at), radius))
        if chance(rng, 0.4):
            middle = (leg(True, at) + leg(False, at)) / 2.0
            parts.append(rod(middle, middle * flip, radius))
        elif chance(rng, 0.6):
            parts += [rod(leg(front, cross), leg(front, cross) * flip, radius) for front in (True, False)]
    if chance(rng, 0.4):
        high, a, b = rng.uniform(0.03, 0.09), leg(True, 0.0), leg(False, 0.0)
        y = top - high / 2.0
        parts += both(box((0.018, high, a[2] - b[2]), (b[0], y, (a[2] + b[2]) / 2.0)))
        parts += [box((2.0 * corner[0], high, 0.018), (0.0, y, corner[2])) for corner in (a, b)]
    return parts


def _sled(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """A loop on each side that runs along the floor."""
    top, radius = frame.height - frame.thick * 0.6, rng.uniform(0.007, 0.018)
    front, behind = frame.depth / 2.0 * rng.uniform(0.7, 1.0), -frame.depth / 2.0 * rng.uniform(0.7, 1.0)
    lean, r, x = rng.uniform(-0.02, 0.1), 0.03, frame.width / 2.0 - 0.02
    out = x + rng.uniform(-0.02, 0.06)
    path = [(x, top, front - r), (x, top - r, front), (out, radius + r, front + lean), (out, radius, front + lean - r)]
    path += [(out, radius, behind - lean + r), (out, radius + r, behind - lean), (x, top - r, behind), (x, top, behind + r)]
    parts = both(sweep(path, _bar_section(rng, radius), side=X_AXIS, closed=chance(rng, 0.5)))
    z = behind - lean + r
    return [*parts, rod((-out, radius, z), (out, radius, z), radius)] if chance(rng, 0.6) else parts


def _cantilever(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """One tube: under the seat, down in front, back along the floor and across behind."""
    top, radius = frame.height - frame.thick * 0.6, rng.uniform(0.009, 0.016)
    front, behind = frame.depth / 2.0 * rng.uniform(0.8, 1.1), -frame.depth / 2.0 * rng.uniform(0.8, 1.2)
    x, r = frame.width / 2.0 - 0.02, rng.uniform(0.03, 0.09)
    path = [(x, top, -frame.depth / 2.0), (x, top, front - r), (x, top - 0.3 * r, front - 0.3 * r), (x, top - r, front)]
    path += [(x, radius + r, front), (x, radius + 0.3 * r, front - 0.3 * r), (x, radius, front - r), (x, radius, behind + r)]
    half = np.array([*path, (x - 0.3 * r, radius, behind + 0.3 * r), (x - r, radius, behind)])
    return [tube(np.concatenate([half, half[::-1] * [-1, 1, 1]]), radius)]


def _pedestal(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """A column on a disc, a trumpet foot or a star of arms."""
    top, foot, column = frame.height - frame.thick * 0.6, rng.uniform(0.18, 0.3), rng.uniform(0.02, 0.045)
    kind = pick(rng, {"disc": 2, "tulip": 2, "star": 3})
    if kind == "tulip":
        t = np.linspace(0.0, 1.0, 9)
        radii = column + (foot - column) * (1.0 - t) ** rng.uniform(4, 9) + rng.uniform(0.0, 0.1) * t**4
        return [turned((0, 0, 0), (0, top, 0), t, radii, 20)]
    parts = [rod((0, 0.02, 0), (0, top, 0), column)]
    if kind == "star":
        return parts + star(rng, foot * 1.1, int(rng.integers(4, 6)), False)
    return [*parts, turned((0, 0, 0), (0, 0.03, 0), [0, 0.4, 1], [foot, foot, column * 1.2], 20)]


def star(rng: np.random.Generator, reach: float, count: int, casters: bool) -> list[Mesh]:
    """Arms from the foot of a column outward, on wheels where ``casters``."""
    ground, width = 0.06 if casters else 0.015, rng.uniform(0.025, 0.05)
    hub, parts = np.array([0.0, ground + rng.uniform(0.04, 0.08), 0.0]), []
    for angle in rng.choice([0.0, np.pi / count]) + 2.0 * np.pi * np.arange(count) / count:
        out, across = np.array([np.sin(angle), 0.0, np.cos(angle)]), np.array([-np.cos(angle), 0.0, np.sin(angle)])
        tip = out * reach + [0.0, ground, 0.0]
        parts.append(bar(hub, tip, width * 1.2, width * 0.9, 0.6, across))
        if casters:
            axle = tip - [0.0, ground - 0.028, 0.0]
            parts.append(rod(axle - 0.026 * across, axle + 0.026 * across, 0.028, sides=10))
    return parts


def _office(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """A gas column on a star with casters, and a plate under the seat."""
    top = frame.height - frame.thick * 0.8
    parts = star(rng, rng.uniform(0.26, 0.36), 4 if chance(rng, 0.15) else 5, not chance(rng, 0.15))
    parts.append(turned((0, 0.06, 0), (0, top, 0), [0, 0.45, 0.45, 1], [0.032, 0.03, 0.018, 0.018], 10))
    return [*parts, box((0.16, 0.05, 0.22), (0, top - 0.02, 0))]


def _crossed(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """Folding legs: an X on each side."""
    top, thick = frame.height - frame.thick * 0.5, rng.uniform(0.015, 0.04)
    x, z, spread = frame.width / 2.0 - thick / 2.0, frame.depth / 2.0, rng.uniform(0.8, 1.15)
    parts = []
    for at, sign in ((x, 1.0), (x - thick, -1.0)):
        parts += both(bar((at, top, -sign * z * 0.8), (at, 0, sign * z * spread), thick * 0.7, thick))
        foot = (0.12 * top, sign * z * spread * 0.8)
        parts.append(rod((-at, *foot), (at, *foot), thick * 0.4))
    return parts


def _panels(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """A solid board on each side, with or without one behind."""
    top, thick = frame.height - frame.thick * 0.7, rng.uniform(0.02, 0.06)
    x = frame.width / 2.0 - thick / 2.0
    parts = both(box((thick, top, frame.depth * rng.uniform(0.7, 1.0)), (x, top / 2.0, 0)))
    if chance(rng, 0.5):
        high = top * rng.uniform(0.2, 1.0)
        parts.append(box((2 * x, high, thick), (0, top - high / 2.0, -frame.depth / 2.0 * rng.uniform(0.0, 0.9))))
    return parts


def _wires(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """Thin rods from under the seat outward to four feet, braced against each other."""
    top, radius, near = frame.height - frame.thick * 0.6, rng.uniform(0.006, 0.014), rng.uniform(0.15, 0.6)
    x, z = frame.width / 2.0 * rng.uniform(0.75, 1.0), frame.depth / 2.0 * rng.uniform(0.8, 1.05)
    parts = []
    for sign in (1.0, -1.0):
        head, foot = np.array([x * near, top, sign * z * near]), np.array([x, 0.0, sign * z])
        parts += [rod(head, foot, radius, sides=6), rod(head * [-0.6, 1, 1], 0.55 * foot + 0.45 * head, radius * 0.7, sides=6)]
    return both(parts)


BASES = {
    "legs": _legs,
    "sled": _sled,
    "cantilever": _cantilever,
    "pedestal": _pedestal,
    "office": _office,
    "crossed": _crossed,
    "panels": _panels,
    "wires": _wires,
}


def short_feet(rng: np.random.Generator, width: float, depth: float, high: float) -> list[Mesh]:
    """Feet under an armchair, from the floor to y = ``high``."""
    thick, inset, splay = rng.uniform(0.015, 0.04), rng.uniform(0.03, 0.1), rng.uniform(1.0, 1.08)
    section, end = _bar_section(rng, thick), rng.uniform(0.4, 1.0)
    parts = []
    for z in (depth / 2.0 - inset, -depth / 2.0 + inset):
        head = np.array([width / 2.0 - inset, high, z])
        parts += both(sweep([head, head * [splay, 0, splay]], section, [1.0, end], X_AXIS))
    return parts
