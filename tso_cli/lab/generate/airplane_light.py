"""Light aeroplanes, warbirds, biplanes and gliders. Unit: the length of the fuselage, nose toward -x."""

from __future__ import annotations

import numpy as np

from ...io.meshes import Mesh
from .airframe import Body, canopy, floats, gear, half_wing, mirror_all, propeller, spindle
from .empennage import tail
from .parts import both, chance, pick, rod, turned


def light(rng: np.random.Generator) -> list[Mesh]:
    """A small propeller aeroplane, one engine in the nose or two on the wing."""
    across, high, twin = rng.uniform(0.11, 0.18), chance(rng, 0.45), chance(rng, 0.3)
    body = Body(
        across,
        across * rng.uniform(1.0, 1.4),
        nose=rng.uniform(0.18, 0.35),
        tail=rng.uniform(0.5, 0.65),
        blunt=rng.uniform(0.35, 0.7),
        tip=rng.uniform(0.05, 0.2),
        rise=rng.uniform(0.0, 0.7),
        droop=rng.uniform(0.0, 0.5),
        square=rng.uniform(2.2, 5.0),
    )
    semi, root = rng.uniform(0.52, 0.78), rng.uniform(0.17, 0.25)
    tip, sweep, rise = root * rng.uniform(0.45, 1.0), rng.uniform(-0.02, 0.1), rng.uniform(0.0, 0.14)
    x, z = rng.uniform(-0.28, -0.14), 0.25 * across
    y = (0.5 + rng.uniform(0.0, 0.4) if high else -0.38) * body.height
    rounded = chance(rng, 0.5)
    parts = [
        body.mesh(),
        *both(
            half_wing((x, y, 0.0 if high else z), semi - z, root, tip, sweep, rise, rng.uniform(0.11, 0.16), rounded=rounded), 2
        ),
    ]
    # The cabin: glass that reaches up to a high wing.
    rise_up = max(y - 0.45 * body.height, 0.02) if high else rng.uniform(0.02, 0.07)
    parts.append(canopy(body, x + 0.4 * root, rng.uniform(0.25, 0.45), rise_up, 0.9))
    if high and chance(rng, 0.8):
        out = rng.uniform(0.4, 0.6) * semi
        parts += both(
            rod((x + 0.4 * root, -0.4 * body.height, 0.4 * across), (x + 0.35 * root, y + rise * out, out), 0.007, sides=6), 2
        )
    disc = chance(rng, 0.55)
    if twin:
        out, length, nacelle = rng.uniform(0.28, 0.36) * semi, rng.uniform(0.2, 0.32), rng.uniform(0.03, 0.045)
        front = np.array([x + sweep * out - 0.4 * length, y + rise * out + 0.2 * nacelle, out])
        parts += mirror_all(
            [spindle(front, length, nacelle), *propeller(rng, front, rng.uniform(0.08, 0.13), 0.4 * nacelle, disc)]
        )
    else:
        parts += propeller(rng, (-0.5, float(body.axis(-0.5)), 0), rng.uniform(0.09, 0.16), 0.025, disc)
    if chance(rng, 0.12):
        parts += both(spindle((x - 0.05, y + rise * semi, semi), 0.28, 0.03), 2)
    parts += tail(rng, body, {"low": 6, "t": 1.2, "v": 0.4, "cross": 0.7})
    low = -0.5 * body.height - rng.uniform(0.06, 0.12)
    ground = pick(rng, {"none": 2.5, "nose": 4, "tail": 2, "floats": 0.6})
    if ground == "floats":
        parts += floats(body, low - 0.06, rng.uniform(0.13, 0.18), rng.uniform(0.6, 0.8))
    elif ground != "none":
        at = x + (0.1 if ground == "tail" else 0.65) * root
        parts += gear(
            rng, body, at, low, rng.uniform(0.022, 0.04), rng.uniform(0.12, 0.2), tail=ground == "tail", spats=chance(rng, 0.3)
        )
    return parts


def warbird(rng: np.random.Generator) -> list[Mesh]:
    """A low-wing propeller fighter or racer with a long nose."""
    across = rng.uniform(0.085, 0.15)
    body = Body(
        across,
        across * rng.uniform(1.1, 1.5),
        nose=rng.uniform(0.1, 0.3),
        tail=rng.uniform(0.5, 0.65),
        blunt=rng.uniform(0.3, 0.6),
        tip=0.08,
        rise=rng.uniform(0.1, 0.5),
        droop=rng.uniform(0.0, 0.2),
    )
    semi, root = rng.uniform(0.5, 0.66), rng.uniform(0.22, 0.32)
    x, rise, z = rng.uniform(-0.26, -0.16), rng.uniform(0.05, 0.14), 0.25 * across
    wing = half_wing(
        (x, -0.35 * body.height, z),
        semi - z,
        root,
        root * rng.uniform(0.45, 0.75),
        rng.uniform(0.0, 0.12),
        rise,
        0.12,
        rounded=True,
        elliptic=chance(rng, 0.4),
    )
    parts = [
        body.mesh(),
        *both(wing, 2),
        *propeller(rng, (-0.5, float(body.axis(-0.5)), 0), rng.uniform(0.13, 0.19), 0.035, chance(rng, 0.5)),
    ]
    parts.append(canopy(body, rng.uniform(-0.08, 0.06), rng.uniform(0.14, 0.3), rng.uniform(0.02, 0.05), 0.7))
    if chance(rng, 0.3):  # radiator
        parts.append(spindle((-0.1, -0.55 * body.height, 0), 0.25, 0.03))
    parts += tail(rng, body, {"low": 1})
    if chance(rng, 0.5):
        parts += gear(
            rng, body, x + 0.1 * root, -0.5 * body.height - rng.uniform(0.08, 0.13), 0.035, rng.uniform(0.1, 0.22), tail=True
        )
    return parts


def biplane(rng: np.random.Generator) -> list[Mesh]:
    """Two wings (seldom three) joined by struts."""
    across = rng.uniform(0.12, 0.2)
    body = Body(
        across,
        across * rng.uniform(1.0, 1.3),
        nose=rng.uniform(0.05, 0.2),
        tail=rng.uniform(0.55, 0.7),
        blunt=rng.uniform(0.2, 0.5),
        tip=0.08,
        rise=rng.uniform(0.1, 0.6),
        droop=0.0,
        square=rng.uniform(2, 4),
    )
    semi, chord = rng.uniform(0.5, 0.75), rng.uniform(0.16, 0.24)
    x, stagger = rng.uniform(-0.3, -0.2), rng.uniform(-0.08, 0.08)
    levels = [-0.45 * body.height, 0.5 * body.height + rng.uniform(0.06, 0.14)]
    if chance(rng, 0.1):
        levels.insert(1, sum(levels) / 2)
    rise, shorter = rng.uniform(0.0, 0.06), rng.uniform(0.75, 1.0)
    parts = [body.mesh()]
    for k, y in enumerate(levels):
        length = semi * (shorter if k == 0 else 1.0)
        parts += both(half_wing((x - stagger * k, y, 0.0), length, chord, chord * 0.95, 0.0, rise, 0.09, rounded=True), 2)
    for out in (0.65,) if chance(rng, 0.6) else (0.4, 0.75):
        z = out * semi * shorter
        for at in (0.2, 0.75):
            a, b = (
                (x + at * chord, levels[0] + rise * z, z),
                (x - stagger * (len(levels) - 1) + at * chord, levels[-1] + rise * z, z),
            )
            parts += both(rod(a, b, 0.006, sides=6), 2)
    for at in (0.2, 0.75):
        parts += both(
            rod(
                (x + at * chord, 0.4 * body.height, 0.3 * across),
                (x - stagger + at * chord, levels[-1], 0.5 * across),
                0.006,
                sides=6,
            ),
            2,
        )
    if chance(rng, 0.5):  # radial engine
        parts.append(turned((-0.53, 0, 0), (-0.4, 0, 0), [0, 0.15, 1], [0.4 * across, 0.58 * across, 0.58 * across], 18))
    parts += propeller(rng, (-0.53, 0, 0), rng.uniform(0.13, 0.2), 0.03, chance(rng, 0.3))
    parts += tail(rng, body, {"low": 1})
    return parts + gear(
        rng, body, x + 0.1, -0.5 * body.height - rng.uniform(0.08, 0.14), 0.045, rng.uniform(0.1, 0.16), tail=True
    )


def glider(rng: np.random.Generator) -> list[Mesh]:
    """Long slender wings on a thin fuselage."""
    across = rng.uniform(0.07, 0.11)
    body = Body(
        across,
        across * rng.uniform(1.1, 1.4),
        nose=rng.uniform(0.25, 0.35),
        tail=rng.uniform(0.5, 0.62),
        tip=rng.uniform(0.15, 0.3),
        rise=rng.uniform(0.2, 0.7),
        droop=0.3,
    )
    semi, root = rng.uniform(0.9, 1.35), rng.uniform(0.11, 0.15)
    wing = half_wing(
        (rng.uniform(-0.2, -0.1), rng.uniform(0.0, 0.4) * body.height, 0.0),
        semi,
        root,
        root * rng.uniform(0.3, 0.6),
        rng.uniform(-0.02, 0.03),
        rng.uniform(0.0, 0.08),
        0.13,
        rounded=True,
    )
    parts = [body.mesh(), *both(wing, 2), *tail(rng, body, {"t": 3, "low": 1, "v": 0.4})]
    return [*parts, canopy(body, -0.24, 0.24, 0.015, 0.85)]
