"""Airliners, freighters and business jets. Unit: the length of the fuselage, nose toward -x."""

from __future__ import annotations

import numpy as np

from ...io.meshes import Mesh
from .airframe import Body, gear, half_wing, jet, mirror_all, propeller, spindle
from .empennage import tail
from .parts import bar, both, chance, ellipsoid, rod, turned


def airliner(rng: np.random.Generator) -> list[Mesh]:
    """Swept low wing; engines under it or at the tail."""
    across = rng.uniform(0.075, 0.14)
    rear = chance(rng, 0.25)
    body = Body(
        across,
        across * rng.uniform(0.95, 1.15),
        nose=rng.uniform(0.08, 0.16),
        tail=rng.uniform(0.28, 0.42),
        blunt=rng.uniform(0.5, 0.75),
        tip=rng.uniform(0.05, 0.2),
        rise=rng.uniform(0.5, 0.9),
        droop=rng.uniform(0.0, 0.4),
        hump=rng.uniform(0.1, 0.25) * chance(rng, 0.1),
    )
    semi, sweep = rng.uniform(0.38, 0.54), rng.uniform(0.42, 0.75)
    root, tip = rng.uniform(0.16, 0.25), rng.uniform(0.03, 0.07)
    x = rng.uniform(-0.16, -0.02) + (0.05 if rear else 0.0)
    y, rise = -0.32 * body.height, rng.uniform(0.04, 0.14)
    z = 0.3 * across
    winglet = rng.uniform(0.02, 0.05) if chance(rng, 0.4) else 0.0
    parts = [
        body.mesh(),
        *both(
            half_wing(
                (x, y, z), semi - z, root, tip, sweep, rise, rng.uniform(0.09, 0.13), rng.uniform(0.0, 0.35), winglet=winglet
            ),
            2,
        ),
    ]
    parts += tail(rng, body, {"t": 1} if rear else {"low": 1})
    radius, length = rng.uniform(0.022, 0.048), rng.uniform(0.09, 0.15)
    if rear:
        at, out = rng.uniform(0.16, 0.26), body.half_width(0.2) + 0.9 * radius
        up = 0.15 * body.height
        parts += mirror_all(
            [
                jet((at, up, out), length * 1.2, radius * 0.85),
                bar((at + 0.1, up, 0), (at + 0.1, up, out), 0.07, 0.012, side=(1, 0, 0)),
            ]
        )
        if chance(rng, 0.3):  # a third one at the foot of the fin
            parts.append(spindle((0.22, body.top(0.2) + 0.6 * radius, 0), 0.3, radius, 1.0))
    else:
        for share in (rng.uniform(0.3, 0.4), rng.uniform(0.6, 0.7))[: 2 if chance(rng, 0.22) else 1]:
            out = share * semi
            edge, under = x + sweep * (out - z), y + rise * (out - z)
            front = edge - rng.uniform(0.3, 0.75) * length
            drop = under - radius * rng.uniform(0.8, 1.3)
            parts += mirror_all(
                [
                    jet((front, drop, out), length, radius),
                    bar((front + 0.5 * length, drop, out), (edge + 0.05, under, out), 0.008, 0.05, side=(0, 0, 1)),
                ]
            )
    if chance(rng, 0.5):
        low = -0.5 * body.height - rng.uniform(0.03, 0.06) - (0.0 if rear else radius * 0.7)
        parts += gear(rng, body, x + root * 0.9, low, rng.uniform(0.012, 0.02), rng.uniform(0.04, 0.08))
    return parts


def turboprop(rng: np.random.Generator) -> list[Mesh]:
    """Straight wing, high or low, with two or four propellers."""
    across, high = rng.uniform(0.09, 0.15), chance(rng, 0.5)
    body = Body(
        across,
        across * rng.uniform(0.95, 1.3),
        nose=rng.uniform(0.13, 0.25),
        tail=rng.uniform(0.3, 0.5),
        tip=rng.uniform(0.05, 0.2),
        rise=rng.uniform(0.4, 0.9),
        droop=rng.uniform(0.2, 0.6),
        square=rng.uniform(2, 3),
    )
    semi, root = rng.uniform(0.5, 0.68), rng.uniform(0.13, 0.22)
    tip, sweep, rise = root * rng.uniform(0.4, 0.9), rng.uniform(0.0, 0.12), rng.uniform(0.0, 0.12)
    x, z = rng.uniform(-0.2, -0.08), 0.25 * across
    y = (0.46 if high else -0.32) * body.height
    parts = [
        body.mesh(),
        *both(half_wing((x, y, z), semi - z, root, tip, sweep, rise, rng.uniform(0.12, 0.17), rounded=chance(rng, 0.3)), 2),
    ]
    disc, sweep_radius = chance(rng, 0.5), rng.uniform(0.06, 0.1)
    for share in (rng.uniform(0.28, 0.38), rng.uniform(0.56, 0.65))[: 2 if chance(rng, 0.25) else 1]:
        out = share * semi
        nacelle, length = rng.uniform(0.02, 0.035), rng.uniform(0.16, 0.3)
        front = np.array(
            [x + sweep * out - rng.uniform(0.3, 0.5) * length, y + rise * out + rng.uniform(-0.5, 0.3) * nacelle, out]
        )
        parts += mirror_all(
            [spindle(front, length, nacelle, rng.uniform(1.0, 1.5)), *propeller(rng, front, sweep_radius, 0.5 * nacelle, disc)]
        )
    parts += tail(rng, body, {"low": 3, "t": 3, "cross": 1, "twin": 0.6})
    if chance(rng, 0.1):  # a radar dish
        top = body.top(0.02) + 0.06
        parts += [
            turned((0.06, top, 0), (0.06, top + 0.035, 0), [0, 0.5, 1], [0.12, 0.19, 0.12], 24),
            rod((0.06, 0, 0), (0.06, top, 0), 0.02),
        ]
    if chance(rng, 0.5):
        low = -0.5 * body.height - rng.uniform(0.04, 0.09)
        parts += gear(
            rng, body, x + 0.6 * root, low, rng.uniform(0.016, 0.025), across * 0.4 if high and chance(rng, 0.5) else 0.3 * semi
        )
    return parts


def transport(rng: np.random.Generator) -> list[Mesh]:
    """A stout freighter: high wing, upswept tail, four engines."""
    across = rng.uniform(0.11, 0.17)
    body = Body(
        across,
        across * rng.uniform(1.0, 1.2),
        nose=rng.uniform(0.1, 0.18),
        tail=rng.uniform(0.35, 0.5),
        tip=0.15,
        rise=rng.uniform(0.8, 1.0),
        droop=0.3,
        square=rng.uniform(2.0, 3.5),
    )
    semi, jets = rng.uniform(0.46, 0.66), chance(rng, 0.55)
    sweep = rng.uniform(0.35, 0.6) if jets else rng.uniform(0.0, 0.1)
    root, x, y, z = rng.uniform(0.16, 0.24), rng.uniform(-0.2, -0.08), 0.45 * body.height, 0.25 * across
    rise = rng.uniform(-0.08, 0.04)
    parts = [body.mesh(), *both(half_wing((x, y, z), semi - z, root, root * rng.uniform(0.25, 0.5), sweep, rise, 0.13), 2)]
    radius, length, disc = rng.uniform(0.022, 0.04), rng.uniform(0.09, 0.16), chance(rng, 0.4)
    for share in (0.33, 0.62) if chance(rng, 0.8) else (0.36,):
        out = share * semi
        front = np.array([x + sweep * out - 0.5 * length, y + rise * out - (1.2 * radius if jets else 0.0), out])
        if jets:
            parts += mirror_all(
                [
                    jet(front, length, radius),
                    bar(front + [0.5 * length, 0, 0], front + [0.6 * length, 1.4 * radius, 0], 0.008, 0.06, side=(0, 0, 1)),
                ]
            )
        else:
            parts += mirror_all([spindle(front, length * 1.6, radius), *propeller(rng, front, 0.07, 0.5 * radius, disc)])
    parts += tail(rng, body, {"t": 3, "low": 2})
    if chance(rng, 0.6):
        parts += both(
            ellipsoid((0.14, 0.25 * body.height, 0.15 * across), (x + 0.6 * root, -0.35 * body.height, 0.45 * across)), 2
        )
    return parts + (
        gear(rng, body, x + 0.6 * root, -0.5 * body.height - 0.04, 0.018, 0.45 * across) if chance(rng, 0.4) else []
    )


def business(rng: np.random.Generator) -> list[Mesh]:
    """A small jet with its engines beside the rear fuselage."""
    across = rng.uniform(0.09, 0.14)
    body = Body(
        across,
        across * rng.uniform(1.0, 1.15),
        nose=rng.uniform(0.15, 0.28),
        tail=rng.uniform(0.35, 0.5),
        tip=rng.uniform(0.05, 0.2),
        rise=rng.uniform(0.4, 0.8),
        droop=rng.uniform(0.1, 0.5),
    )
    semi, sweep, root = rng.uniform(0.4, 0.56), rng.uniform(0.1, 0.6), rng.uniform(0.15, 0.23)
    x, z = rng.uniform(-0.1, 0.04), 0.25 * across
    rise = rng.uniform(0.03, 0.12)
    winglet = rng.uniform(0.03, 0.07) * chance(rng, 0.5)
    wing = half_wing(
        (x, -0.38 * body.height, z),
        semi - z,
        root,
        root * rng.uniform(0.25, 0.45),
        sweep,
        rise,
        0.11,
        rng.uniform(0, 0.3),
        winglet=winglet,
    )
    parts = [body.mesh(), *both(wing, 2), *tail(rng, body, {"t": 4, "cross": 1, "v": 0.4, "low": 0.5})]
    if chance(rng, 0.25):
        out = semi * rng.uniform(0.8, 1.0)
        parts += both(spindle((x + sweep * out - 0.05, -0.38 * body.height + rise * out, out), 0.22, 0.025), 2)
    radius, length, at = rng.uniform(0.026, 0.045), rng.uniform(0.12, 0.2), rng.uniform(0.1, 0.24)
    out, up = body.half_width(at) + 0.9 * radius, 0.2 * body.height
    parts += mirror_all(
        [
            jet((at, up, out), length, radius),
            bar((at + 0.4 * length, up, 0), (at + 0.4 * length, up, out), 0.5 * length, 0.015, side=(1, 0, 0)),
        ]
    )
    if chance(rng, 0.5):
        parts += gear(rng, body, x + 0.7 * root, -0.5 * body.height - rng.uniform(0.04, 0.07), 0.016, rng.uniform(0.07, 0.14))
    return parts
