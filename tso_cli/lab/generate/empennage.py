"""Tails of aeroplanes. Unit: the length of the fuselage."""

from __future__ import annotations

import numpy as np

from ...io.meshes import Mesh
from .airframe import Body, fin, half_wing, surface
from .parts import both, chance, pick


def tail(rng: np.random.Generator, body: Body, kinds: dict[str, float]) -> list[Mesh]:
    """Fin and tailplane of a kind drawn from ``kinds``: low, t, cross, v or twin -> weight."""
    kind = pick(rng, kinds)
    sweep = rng.uniform(0.3, 0.9) if body.width < 0.13 or chance(rng, 0.5) else rng.uniform(0.0, 0.4)
    high, chord = rng.uniform(0.11, 0.19), rng.uniform(0.11, 0.19)
    rounded = sweep < 0.4 and chance(rng, 0.5)
    end = body.length / 2.0
    x = end - chord - rng.uniform(0.0, 0.05)
    y = body.top(x + 0.6 * chord) - 0.015
    semi, flat, slope = rng.uniform(0.15, 0.22), chord * rng.uniform(0.6, 0.85), sweep * rng.uniform(0.5, 0.9)
    rise = rng.uniform(-0.02, 0.12)

    def plane(at: float, level: float, inner: float = 0.0) -> list[Mesh]:
        return both(
            half_wing((at, level, inner), semi, flat, flat * rng.uniform(0.4, 0.8), slope, rise, 0.09, rounded=rounded), 2
        )

    low = float(body.axis(x + 0.5 * flat)) + rng.uniform(0.0, 0.3) * body.height * float(body.size(x))
    if kind == "v":
        edge = np.array([[x, low, 0.0], [x + slope * semi, low + 0.7 * semi, 0.75 * semi]])
        return both(surface(edge, [flat, 0.6 * flat], 0.09), 2)
    if kind == "twin":
        tips = both(
            fin(
                (x + slope * semi, low + rise * semi - 0.3 * high, semi * 0.97),
                high,
                flat,
                0.6 * flat,
                0.3 * sweep,
                rounded=rounded,
            ),
            2,
        )
        return plane(x, low) + tips
    parts = [fin((x, y, 0.0), high, chord, chord * rng.uniform(0.35, 0.65), sweep, rounded=rounded and kind == "low")]
    if chance(rng, 0.35):  # a strake that leads up to the fin
        parts.append(
            surface(
                [[x - 0.8 * chord, y, 0.0], [x + 0.35 * sweep * high, y + 0.35 * high, 0.0]], [1.4 * chord, 0.5 * chord], 0.03
            )
        )
    share = {"low": 0.0, "cross": rng.uniform(0.3, 0.6), "t": 0.97}[kind]
    if share == 0.0:
        return parts + plane(end - flat - rng.uniform(0.0, 0.08), low, 0.2 * body.half_width(end - flat))
    return parts + plane(x + sweep * high * share, y + share * high)
