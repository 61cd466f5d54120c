"""Fighters, and aeroplanes that fit no other kind. Unit: the length of the fuselage, nose toward -x."""

from __future__ import annotations

import numpy as np

from ...io.meshes import Mesh
from .airframe import Body, canopy, fin, half_wing, jet, mirror_all, propeller, spindle, surface
from .empennage import tail
from .parts import bar, both, box, chance, pick, rod, turned


def fighter(rng: np.random.Generator) -> list[Mesh]:
    """A jet fighter: pointed nose, intakes, delta, swept or short trapezoid wings."""
    across = rng.uniform(0.06, 0.13)
    body = Body(
        across,
        across * rng.uniform(0.9, 1.3),
        nose=rng.uniform(0.25, 0.45),
        tail=rng.uniform(0.15, 0.4),
        blunt=rng.uniform(0.7, 1.1),
        tip=rng.uniform(0.5, 0.85),
        rise=rng.uniform(-0.1, 0.3),
        droop=rng.uniform(0.0, 0.4),
        square=rng.uniform(2, 4),
    )
    plan = pick(rng, {"delta": 4, "swept": 4, "short": 3})
    z, y = 0.35 * across, rng.uniform(-0.35, 0.4) * body.height
    if plan == "delta":
        root, semi = rng.uniform(0.38, 0.58), rng.uniform(0.24, 0.36)
        tip, sweep = rng.uniform(0.01, 0.08), rng.uniform(1.05, 1.7)
        x = rng.uniform(0.36, 0.46) - root
    elif plan == "swept":
        root, semi = rng.uniform(0.2, 0.32), rng.uniform(0.3, 0.45)
        tip, sweep, x = rng.uniform(0.06, 0.14), rng.uniform(0.6, 1.15), rng.uniform(-0.18, 0.0)
    else:
        root, semi = rng.uniform(0.18, 0.3), rng.uniform(0.2, 0.36)
        tip, sweep, x = rng.uniform(0.06, 0.12), rng.uniform(0.25, 0.7), rng.uniform(-0.1, 0.08)
    rise = rng.uniform(-0.1, 0.06)
    parts = [body.mesh(16), *both(half_wing((x, y, z), semi - z, root, tip, sweep, rise, rng.uniform(0.04, 0.07)), 2)]
    if chance(rng, 0.35):  # strakes before the wing
        parts += both(surface([[x - 0.2, y, 0.2 * across], [x + 0.02, y, z + 0.05]], [0.3, 0.05], 0.03), 2)
    parts.append(canopy(body, rng.uniform(-0.28, -0.15), rng.uniform(0.14, 0.24), rng.uniform(0.015, 0.04), 0.7))
    if chance(rng, 0.4):
        parts.append(
            rod((-0.5 - rng.uniform(0.03, 0.1), float(body.axis(-0.5)), 0), (-0.47, float(body.axis(-0.5)), 0), 0.003, 0.006, 6)
        )
    parts += _intakes(rng, body)
    parts += _fighter_tail(rng, body, plan == "delta")
    if chance(rng, 0.4):
        for share in (0.4, 0.7)[: int(rng.integers(1, 3))]:
            out, long = share * semi, rng.uniform(0.15, 0.3)
            at = np.array([x + sweep * out - 0.2 * long, y + rise * out - 0.035, out])
            parts += mirror_all(
                [
                    spindle(at, long, rng.uniform(0.008, 0.022)),
                    bar(at + [0.5 * long, 0, 0], at + [0.5 * long, 0.035, 0], 0.006, 0.06, side=(0, 0, 1)),
                ]
            )
    if chance(rng, 0.2):
        parts += both(
            rod(
                (x + sweep * semi - 0.08, y + rise * semi, semi),
                (x + sweep * semi + tip + 0.05, y + rise * semi, semi),
                0.007,
                sides=6,
            ),
            2,
        )
    if chance(rng, 0.2):
        for leg, side in ((-0.25, 0.0), (0.12, 0.07), (0.12, -0.07)):
            parts += [
                rod((leg, 0, side), (leg, -0.5 * body.height - 0.05, side), 0.006, sides=6),
                turned(
                    (leg, -0.5 * body.height - 0.06, side - 0.008),
                    (leg, -0.5 * body.height - 0.06, side + 0.008),
                    [0, 1],
                    [0.02, 0.02],
                    10,
                ),
            ]
    return parts


def _intakes(rng: np.random.Generator, body: Body) -> list[Mesh]:
    """Air intakes beside or under the fuselage, and the nozzles."""
    kind = pick(rng, {"sides": 4, "under": 1, "none": 2})
    parts = []
    front, back = rng.uniform(-0.2, -0.02), rng.uniform(0.2, 0.46)
    wide, high = body.width * rng.uniform(0.3, 0.6), body.height * rng.uniform(0.5, 0.85)
    if kind == "sides":
        out, level = 0.45 * body.width, rng.uniform(-0.2, 0.1) * body.height
        long = back - front
        part = box((high, long, wide), (0, 0, 0), (rng.uniform(0.6, 1.0), rng.uniform(0.4, 0.9)))
        # Lying along x: the box's own y is the way back.
        part = Mesh(
            part.vertices[:, [1, 0, 2]] * [1, 1, 1] + [(front + back) / 2, level, out + 0.25 * wide], part.faces[:, ::-1]
        )
        parts += both(part, 2)
    elif kind == "under":
        parts.append(box((0.4, 0.5 * body.height, body.width * 0.8), (front + 0.2, -0.5 * body.height, 0)))
    radius = 0.42 * min(body.width, body.height)
    if chance(rng, 0.4):
        parts += both(
            turned(
                (0.38, 0, 0.5 * body.width),
                (0.52, 0, 0.5 * body.width),
                [0, 0.7, 1, 0.9],
                np.array([1, 1, 0.75, 0.2]) * radius,
                14,
            ),
            2,
        )
    else:
        parts.append(
            turned(
                (0.42, float(body.axis(0.45)), 0),
                (0.53, float(body.axis(0.45)), 0),
                [0, 0.6, 1, 0.9],
                np.array([1, 0.95, 0.8, 0.2]) * radius,
                14,
            )
        )
    return parts


def _fighter_tail(rng: np.random.Generator, body: Body, delta: bool) -> list[Mesh]:
    """One fin or two; a tailplane, foreplanes or neither."""
    high, chord = rng.uniform(0.12, 0.2), rng.uniform(0.16, 0.3)
    sweep = rng.uniform(0.6, 1.3)
    x = rng.uniform(0.42, 0.5) - chord
    y = body.top(x + 0.5 * chord) - 0.015
    tip = chord * rng.uniform(0.25, 0.5)
    if chance(rng, 0.35):
        parts = both(
            fin((x, y - 0.01, 0.4 * body.width), high * 0.9, chord * 0.8, tip * 0.8, sweep, rng.uniform(-0.1, 0.4), 0.05), 2
        )
    else:
        parts = [fin((x, y, 0), high, chord, tip, sweep, 0.0, 0.05)]
    flat = rng.uniform(0.1, 0.18)
    if not delta or chance(rng, 0.3):
        slope = rng.uniform(0.4, 1.0)
        plane = half_wing(
            (rng.uniform(0.4, 0.47) - flat, rng.uniform(-0.2, 0.1) * body.height, 0.3 * body.width),
            rng.uniform(0.12, 0.18),
            flat,
            flat * 0.4,
            slope,
            rng.uniform(-0.3, 0.05),
            0.05,
        )
        parts += both(plane, 2)
    elif chance(rng, 0.5):
        at = rng.uniform(-0.22, -0.1)
        parts += both(
            half_wing(
                (at, 0.2 * body.height, 0.3 * body.width), rng.uniform(0.08, 0.14), 0.7 * flat, 0.2 * flat, 0.9, 0.0, 0.05
            ),
            2,
        )
    return parts


def odd(rng: np.random.Generator) -> list[Mesh]:
    """A flying wing, a pusher with foreplanes, twin booms, a fast delta with engine pods, a space plane, a disc-like wing."""
    return {
        "wing": _flying_wing,
        "pusher": _pusher,
        "booms": _booms,
        "pods": _pods,
        "space": _space_plane,
        "round": _round_wing,
    }[pick(rng, {"wing": 1.5, "pusher": 1, "booms": 1, "pods": 1.2, "space": 1.2, "round": 1})](rng)


def _flying_wing(rng: np.random.Generator) -> list[Mesh]:
    root, semi, sweep = rng.uniform(0.35, 0.6), rng.uniform(0.5, 0.9), rng.uniform(0.5, 0.9)
    parts = both(
        half_wing((0, 0, 0), semi, root, root * rng.uniform(0.1, 0.4), sweep, rng.uniform(0, 0.06), rng.uniform(0.1, 0.2)), 2
    )
    parts.append(spindle((-0.03, 0.02, 0), root, 0.07, rng.uniform(0.6, 1.2)))
    if chance(rng, 0.5):
        parts += both(spindle((0.35 * root, 0.05, 0.15), 0.5 * root, 0.035), 2)
    if chance(rng, 0.4):
        parts += both(fin((sweep * semi, 0.02, semi), 0.12, 0.12, 0.06, 0.6), 2)
    return parts


def _pusher(rng: np.random.Generator) -> list[Mesh]:
    body = Body(rng.uniform(0.12, 0.17), rng.uniform(0.13, 0.19), nose=0.4, tail=0.35, tip=0.35, rise=0.1)
    semi, sweep = rng.uniform(0.6, 0.85), rng.uniform(0.3, 0.7)
    root = rng.uniform(0.16, 0.24)
    parts = [body.mesh(), *both(half_wing((0.1, -0.01, 0), semi, root, root * 0.45, sweep, 0.03, 0.1), 2)]
    parts += both(half_wing((-0.42, 0.0, 0), rng.uniform(0.25, 0.4), 0.08, 0.06, 0.1, 0.0, 0.12), 2)
    parts += both(fin((0.1 + sweep * semi, 0.0, semi), rng.uniform(0.12, 0.2), 0.12, 0.07, 0.6), 2)
    parts += propeller(rng, (0.52, 0, 0), rng.uniform(0.12, 0.16), 0.025, chance(rng, 0.5))
    return [*parts, canopy(body, -0.12, 0.36, 0.03, 0.8)]


def _booms(rng: np.random.Generator) -> list[Mesh]:
    body = Body(0.14, 0.17, length=rng.uniform(0.5, 0.7), nose=0.35, tail=0.35, tip=0.4, rise=0.1)
    out, root = rng.uniform(0.15, 0.24), rng.uniform(0.18, 0.24)
    level = rng.uniform(-0.05, 0.06)
    parts = [body.mesh(), *both(half_wing((-0.15, level, 0), rng.uniform(0.6, 0.85), root, root * 0.6, 0.03, 0.03, 0.13), 2)]
    parts += mirror_all(
        [spindle((-0.3, level, out), 0.95, 0.035, 1.2), fin((0.5, level, out), 0.13, 0.13, 0.08, 0.4, rounded=True)]
    )
    parts.append(surface([[0.53, level + 0.02, -out], [0.53, level + 0.02, out]], [0.1, 0.1], 0.08))
    if chance(rng, 0.6):
        parts += mirror_all(propeller(rng, (-0.3, level, out), 0.12, 0.02, chance(rng, 0.5)))
    return parts


def _pods(rng: np.random.Generator) -> list[Mesh]:
    body = Body(rng.uniform(0.05, 0.09), rng.uniform(0.05, 0.07), nose=0.45, tail=0.4, blunt=0.9, tip=0.15, rise=0.2)
    root, semi = rng.uniform(0.45, 0.65), rng.uniform(0.22, 0.32)
    parts = [
        body.mesh(),
        *both(half_wing((0.46 - root, 0, 0), semi, root, rng.uniform(0.03, 0.12), rng.uniform(1.0, 1.6), 0, 0.03), 2),
    ]
    parts += both(surface([[-0.42, 0, 0.0], [0.0, 0, body.width * 0.8]], [0.85, 0.3], 0.02), 2)
    out, radius = rng.uniform(0.13, 0.2), rng.uniform(0.025, 0.045)
    pod = jet((rng.uniform(-0.1, 0.1), 0, out), rng.uniform(0.35, 0.5), radius)
    return parts + mirror_all(
        [pod, fin((0.25, radius * 0.8, out), rng.uniform(0.08, 0.14), 0.16, 0.09, 0.5, rng.uniform(-0.3, 0.1), 0.05)]
    )


def _space_plane(rng: np.random.Generator) -> list[Mesh]:
    across = rng.uniform(0.16, 0.22)
    body = Body(
        across,
        across * rng.uniform(0.9, 1.1),
        nose=rng.uniform(0.2, 0.3),
        tail=0.1,
        blunt=rng.uniform(0.5, 0.7),
        tip=0.95,
        rise=0.0,
        droop=0.4,
        square=rng.uniform(2.5, 5),
    )
    root, semi = rng.uniform(0.45, 0.6), rng.uniform(0.3, 0.42)
    wing = half_wing(
        (0.47 - root, -0.42 * body.height, 0.3 * across),
        semi - 0.3 * across,
        root,
        rng.uniform(0.08, 0.15),
        rng.uniform(1.0, 1.3),
        0.05,
        0.07,
    )
    strake = surface(
        [[-0.25, -0.42 * body.height, 0.3 * across], [0.2, -0.42 * body.height, 0.3 * across + 0.12]], [0.6, 0.1], 0.04
    )
    parts = [
        body.mesh(),
        *both(wing, 2),
        *both(strake, 2),
        fin((0.26, 0.45 * body.height, 0), rng.uniform(0.18, 0.26), 0.24, 0.11, 0.85),
    ]
    for y, z in ((0.2, 0.0), (-0.15, 0.06), (-0.15, -0.06)):
        parts.append(turned((0.47, y * across, z), (0.57, y * across, z), [0, 1, 0.9], [0.025, 0.05, 0.02], 12))
    return parts + both(spindle((0.32, 0.3 * body.height, 0.3 * across), 0.2, 0.045), 2)


def _round_wing(rng: np.random.Generator) -> list[Mesh]:
    body = Body(rng.uniform(0.12, 0.18), rng.uniform(0.12, 0.16), length=0.9, nose=0.25, tail=0.6, tip=0.1, rise=0.2)
    chord = rng.uniform(0.5, 0.85)
    wing = half_wing(
        (-0.4, -0.02, 0),
        rng.uniform(0.42, 0.7),
        chord,
        chord * rng.uniform(0.6, 1.0),
        0.0,
        rng.uniform(0, 0.05),
        0.13,
        elliptic=True,
    )
    parts = [body.mesh(), *both(wing, 2), *propeller(rng, (-0.45, float(body.axis(-0.45)), 0), 0.16, 0.03, chance(rng, 0.5))]
    return [*parts, *tail(rng, body, {"low": 2, "cross": 1}), canopy(body, -0.1, 0.25, 0.03)]
