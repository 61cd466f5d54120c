"""Four legs of wood, with what joins them. Lengths in metres."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ...io.meshes import Mesh
from .chair_frame import Frame
from .parts import Array, bar, both, box, chance, oval, pick, rectangle, rod, sweep

Leg = Callable[[bool, "Array | float"], Array]
"""Points of the right front (True) or rear leg at a share of the way down."""


def legs(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """Four legs of any form, with or without stretchers and an apron."""
    top = frame.height - frame.thick * 0.7
    form = pick(rng, {"straight": 5, "tapered": 4, "sabre": 2, "bowed": 1.2, "turned": 1.5})
    round_ = form == "turned" or chance(rng, 0.4)
    thick = rng.uniform(0.018, 0.036) if round_ or chance(rng, 0.5) else rng.uniform(0.03, 0.055)
    if chance(rng, 0.12):
        thick = rng.uniform(0.055, 0.1)
    inset = thick / 2.0 + (rng.uniform(0.0, 0.06) if chance(rng, 0.5) else 0.0)
    splay = rng.uniform(0.0, 0.22) if chance(rng, 0.5) else 0.0
    splay_back = splay if chance(rng, 0.5) else rng.uniform(0.0, 0.2)
    narrow = rng.uniform(0.75, 1.0) if chance(rng, 0.3) else 1.0
    bow = {"sabre": rng.uniform(0.03, 0.08), "bowed": rng.uniform(-0.05, 0.05)}.get(form, 0.0)
    steps = {"straight": 2, "tapered": 2, "turned": 15}.get(form, 7)
    t = np.linspace(0.0, 1.0, steps)

    def leg(front: bool, at: Array | float) -> Array:
        """Points of the right leg: 0 at the seat, 1 on the floor."""
        down = np.asarray(at, dtype=np.float64)
        sign = 1.0 if front else -1.0
        x = (frame.width / 2.0 - inset) * (1.0 if front else narrow) + (splay * 0.6 * top) * down
        z = sign * (frame.depth / 2.0 - inset) + sign * (splay if front else splay_back) * top * down
        if form == "sabre":
            z = z + sign * bow * (2.0 * down**2 - down)
        elif form == "bowed":
            z = z + sign * bow * np.sin(np.pi * down)
        return np.stack(np.broadcast_arrays(x, top * (1.0 - down), z), axis=-1)

    scale = np.interp(t, [0.0, 1.0], [1.0, rng.uniform(0.45, 0.8)] if form != "straight" else [1.0, 1.0])
    if form == "turned":
        scale = 1.0 + rng.uniform(0.1, 0.35) * np.sin(rng.uniform(6, 20) * t + rng.uniform(0, 6)) * np.sin(np.pi * t)
    section = oval(thick / 2.0, thick / 2.0, 2.0, 8) if round_ else rectangle(thick, thick * rng.uniform(0.7, 1.3))
    parts = [m for front in (True, False) for m in both(sweep(leg(front, t), section, scale, (1, 0, 0)))]
    if chance(rng, 0.45):
        parts += _stretchers(rng, leg, thick * rng.uniform(0.4, 0.8), round_)
    if chance(rng, 0.4):
        parts += _apron(rng, frame, leg, top)
    return parts


def _stretchers(rng: np.random.Generator, leg: Leg, thick: float, round_: bool) -> list[Mesh]:
    """Rails between the legs near the floor."""
    side_at, cross_at = rng.uniform(0.45, 0.8), rng.uniform(0.35, 0.85)

    def rail(a: Array, b: Array) -> Mesh:
        return rod(a, b, thick / 2.0) if round_ else bar(a, b, thick, thick * 1.5)

    flip = np.array([-1.0, 1.0, 1.0])
    parts = []
    layout = pick(rng, {"box": 3, "h": 3, "sides": 2, "double": 1, "x": 0.5})
    if layout == "x":
        a, b = leg(True, side_at), leg(False, side_at)
        return [rail(a, b * flip), rail(a * flip, b)]
    for at in (side_at, side_at - 0.2) if layout == "double" else (side_at,):
        parts += both(rail(leg(True, at), leg(False, at)))
    if layout == "h":
        middle = (leg(True, side_at) + leg(False, side_at)) / 2.0
        parts.append(rail(middle, middle * flip))
    elif layout != "sides":
        parts += [rail(leg(front, cross_at), leg(front, cross_at) * flip) for front in (True, False)]
    return parts


def _apron(rng: np.random.Generator, frame: Frame, leg: Leg, top: float) -> list[Mesh]:
    """Boards under the edges of the seat."""
    high = rng.uniform(0.03, 0.09)
    a, b = leg(True, 0.0), leg(False, 0.0)
    x = frame.width - 2.0 * (frame.width / 2.0 - a[0])
    parts = both(box((0.018, high, a[2] - b[2]), (a[0], top - high / 2.0, (a[2] + b[2]) / 2.0)))
    return parts + [box((x, high, 0.018), (0.0, top - high / 2.0, z)) for z in (a[2], b[2])]
