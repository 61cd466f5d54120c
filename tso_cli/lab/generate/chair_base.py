"""What a chair stands on. Lengths in metres."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...io.meshes import Mesh
from .chair_feet import office, pedestal
from .chair_frame import Frame
from .chair_legs import legs
from .parts import bar, both, box, chance, curve, oval, pick, rectangle, rod, sweep, tube


def base(rng: np.random.Generator, frame: Frame, kinds: dict[str, float]) -> list[Mesh]:
    """What carries the seat, of a kind drawn from ``kinds``: a key of `BASES` -> weight."""
    inside = min(1.0, 1.03 * frame.corner)
    return BASES[pick(rng, kinds)](rng, replace(frame, width=frame.width * inside, depth=frame.depth * inside))


def _sled(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """A loop on each side that runs along the floor, round or of flat steel."""
    top = frame.height - frame.thick * 0.6
    radius = rng.uniform(0.007, 0.018)
    front, back = frame.depth / 2.0 * rng.uniform(0.7, 1.0), -frame.depth / 2.0 * rng.uniform(0.7, 1.0)
    out, lean = rng.uniform(-0.02, 0.06), rng.uniform(-0.02, 0.1)
    x = frame.width / 2.0 - 0.02
    corner = 0.03
    y = radius
    path = [
        (x, top, front - corner),
        (x, top - corner, front),
        (x + out, y + corner, front + lean),
        (x + out, y, front + lean - corner),
        (x + out, y, back - lean + corner),
        (x + out, y + corner, back - lean),
        (x, top - corner, back),
        (x, top, back + corner),
    ]
    section = oval(radius, radius, 2.0, 8) if chance(rng, 0.6) else rectangle(rng.uniform(0.02, 0.05), 2.0 * radius)
    parts = both(sweep(path, section, side=(1, 0, 0), closed=chance(rng, 0.5)))
    if chance(rng, 0.6):
        parts.append(rod((-x - out, y, back - lean + corner), (x + out, y, back - lean + corner), radius))
    return parts


def _cantilever(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """One tube: under the seat, down in front, back along the floor and across behind."""
    top, radius = frame.height - frame.thick * 0.6, rng.uniform(0.009, 0.016)
    front, back = frame.depth / 2.0 * rng.uniform(0.8, 1.1), -frame.depth / 2.0 * rng.uniform(0.8, 1.2)
    x, r = frame.width / 2.0 - 0.02, rng.uniform(0.03, 0.09)
    half = [(x, top, -frame.depth / 2.0), (x, top, front - r), (x, top - 0.3 * r, front - 0.3 * r), (x, top - r, front)]
    half += [(x, radius + r, front), (x, radius + 0.3 * r, front - 0.3 * r), (x, radius, front - r), (x, radius, back + r)]
    half += [(x - 0.3 * r, radius, back + 0.3 * r), (x - r, radius, back)]
    path = np.array(half)
    return [tube(np.concatenate([path, path[::-1] * [-1, 1, 1]]), radius)]


def _tubular_arms(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """Tubes that are legs and arms in one: along the floor, up in front, back as an arm to the back's edge."""
    radius, r = rng.uniform(0.01, 0.02), rng.uniform(0.04, 0.12)
    high = min(rng.uniform(0.16, 0.26), 0.8 * frame.back_height)
    x, top, front = frame.width / 2.0 + 0.02, frame.height + high, frame.depth / 2.0 * rng.uniform(0.8, 1.2)
    end = frame.back(1.0, high / frame.back_height)
    back, reach = -frame.depth / 2.0 * rng.uniform(0.8, 1.2), rng.uniform(-0.08, 0.1)
    low = front + reach
    path = [
        (x, top, end[2]),
        (x, top, front - r),
        (x, top - 0.3 * r, front - 0.3 * r),
        (x, top - r, front),
        (x, radius + r, low),
    ]
    path += [(x, radius + 0.3 * r, low - 0.3 * r), (x, radius, low - r), (x, radius, back)]
    parts = both(tube(path, radius)) + [rod((-x, radius, back), (x, radius, back), radius)]
    level = frame.height - frame.thick / 2.0
    parts += [rod((-x, level, z), (x, level, z), radius * 0.8) for z in (front * 0.95, back * 0.5)]
    if chance(rng, 0.5):
        pad = [(x, top + radius, end[2]), (x, top + radius, front - 0.5 * r)]
        parts += both(sweep(pad, rectangle(rng.uniform(0.04, 0.08), rng.uniform(0.02, 0.06)), side=(1, 0, 0)))
    return parts


def _crossed(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """Folding legs: an X on each side, seen from the side or from the front."""
    top, thick = frame.height - frame.thick * 0.5, rng.uniform(0.015, 0.04)
    x, z = frame.width / 2.0 - thick / 2.0, frame.depth / 2.0
    spread = rng.uniform(0.8, 1.15)
    if chance(rng, 0.25):  # director's chair: crosses in front and behind
        parts = []
        for at in (-z * 0.85, z * 0.85):
            parts += [
                bar((-x, top, at), (x, 0, at), thick, thick),
                bar((x, top, at + thick), (-x, 0, at + thick), thick, thick),
            ]
        return parts
    parts = both(bar((x, top, -z * 0.8), (x, 0, z * spread), thick * 0.7, thick))
    inner = x - thick
    parts += both(bar((inner, top, z * 0.8), (inner, 0, -z * spread), thick * 0.7, thick))
    for at, where in ((inner, (0.12 * top, -z * spread * 0.8)), (x, (0.12 * top, z * spread * 0.8))):
        if chance(rng, 0.7):
            parts.append(rod((-at, *where), (at, *where), thick * 0.4))
    return parts


def _rocker(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """Legs on two curved runners."""
    z = np.linspace(-1.0, 1.0, 11) * frame.depth * rng.uniform(0.75, 1.0)
    radius = rng.uniform(0.8, 1.4)
    x = frame.width / 2.0 - 0.03
    path = np.stack([np.full(11, x), 0.02 + z**2 / (2.0 * radius), z - 0.05], axis=1)
    legs = []
    for at in (frame.depth / 2.0 - 0.04, -frame.depth / 2.0 + 0.04):
        foot = float(np.interp(at * 1.1, path[:, 2], path[:, 1]))
        legs += both(rod((x, frame.height - frame.thick * 0.7, at), (x, foot, at * 1.1), rng.uniform(0.014, 0.022)))
    return both(sweep(path, rectangle(0.03, 0.035), side=(1, 0, 0))) + legs


def _panels(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """A solid board on each side, with or without one behind."""
    top, thick = frame.height - frame.thick * 0.7, rng.uniform(0.02, 0.06)
    x = frame.width / 2.0 - thick / 2.0
    parts = both(box((thick, top, frame.depth * rng.uniform(0.7, 1.0)), (x, top / 2.0, 0)))
    if chance(rng, 0.5):
        high = top * rng.uniform(0.2, 1.0)
        parts.append(box((2 * x, high, thick), (0, top - high / 2.0, -frame.depth / 2.0 * rng.uniform(0.0, 0.9))))
    return parts


def _block(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """Solid down to the floor."""
    top = frame.height - frame.thick * 0.7
    return [box((frame.width * 0.98, top, frame.depth * 0.98), (0, top / 2.0, 0), (1.0, 1.0))]


def _wires(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """Thin rods from under the seat outward to four feet, braced against each other."""
    top, radius = frame.height - frame.thick * 0.6, rng.uniform(0.006, 0.014)
    near = rng.uniform(0.15, 0.6)
    x, z = frame.width / 2.0 * rng.uniform(0.75, 1.0), frame.depth / 2.0 * rng.uniform(0.8, 1.05)
    parts = []
    for sz in (1.0, -1.0):
        head, foot = np.array([x * near, top, sz * z * near]), np.array([x, 0.0, sz * z])
        parts += both(rod(head, foot, radius, sides=6))
        if chance(rng, 0.7):
            parts += both(rod(head * [-0.6, 1, 1], foot * [1, 1, 1] + (head - foot) * 0.45, radius * 0.7, sides=6))
    if chance(rng, 0.5):
        parts += both(rod((x * near, top, z * near), (x * 0.7, top * 0.45, -z * 0.7), radius * 0.7, sides=6))
    return parts


def _hairpins(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """Each leg a rod bent into a narrow V."""
    top, radius = frame.height - frame.thick * 0.6, rng.uniform(0.006, 0.012)
    x, z, out = frame.width / 2.0 - 0.03, frame.depth / 2.0 - 0.03, rng.uniform(0.0, 0.06)
    gap = rng.uniform(0.06, 0.2)
    parts = []
    for sz in (1.0, -1.0):
        path = curve(
            [
                (x, top, sz * z),
                (x + out, 0.03, sz * (z + out) - sz * 0.01),
                (x + out, radius, sz * (z + out) - sz * 0.03),
                (x + out, 0.03, sz * (z + out) - sz * 0.05),
                (x, top, sz * (z - gap)),
            ],
            15,
        )
        parts += both(tube(path, radius, 6))
    return parts


BASES = {
    "legs": legs,
    "sled": _sled,
    "cantilever": _cantilever,
    "tubular arms": _tubular_arms,
    "pedestal": pedestal,
    "office": office,
    "crossed": _crossed,
    "rocker": _rocker,
    "panels": _panels,
    "block": _block,
    "wires": _wires,
    "hairpins": _hairpins,
}
