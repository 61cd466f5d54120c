"""Vintage cars and racing cars: those whose wheels stand free of the body. Lengths in metres, front +z."""

from __future__ import annotations

import numpy as np

from ...io.meshes import Mesh
from .car_body import fender
from .parts import bar, both, box, chance, cushion, ellipsoid, loft, oval, rod, turned, wheel


def vintage(rng: np.random.Generator) -> list[Mesh]:
    """A narrow bonnet, an upright cabin, free mudguards and large wheels."""
    length, track, radius = rng.uniform(3.2, 4.4), rng.uniform(1.35, 1.7), rng.uniform(0.33, 0.46)
    low, deck = radius * rng.uniform(0.8, 1.1), rng.uniform(0.95, 1.15)
    z = length / 2 - radius
    wide, cabin = rng.uniform(0.55, 0.8), rng.uniform(1.0, 1.35)
    start = rng.uniform(-0.1, 0.35)
    sides = [(z + 0.1, 0.85, deck - 0.06), (start + 0.1, 1.15, deck)]
    hood = np.stack(
        [
            np.column_stack([oval(wide / 2 * w, (top - low) / 2, 5, 16) + [0, (top + low) / 2], np.full(16, at)])
            for at, w, top in sides
        ]
    )
    parts = [loft(hood)]
    rear = -z - rng.uniform(-0.1, 0.25)
    if chance(rng, 0.6):
        roof = rng.uniform(1.6, 1.9)
        parts.append(
            cushion(
                (cabin, roof - low, start + 0.1 - rear),
                (0, (roof + low) / 2, (start + 0.1 + rear) / 2),
                0.15 * rng.uniform(0.3, 1.5),
                rng.uniform(5, 12),
            )
        )
    else:
        tub = box((cabin, deck - low, start - rear), (0, (deck + low) / 2, (start + rear) / 2), (1.0, 1.0))
        parts += [tub, box((cabin * 0.9, rng.uniform(0.3, 0.5), 0.03), (0, deck + 0.18, start))]
        parts += [box((cabin * 0.9, 0.5, 0.15), (0, deck + 0.1, (start + rear) / 2 - 0.1))]
        if chance(rng, 0.5):  # a canvas roof
            parts += [
                box((cabin, 0.04, 0.7 * (start - rear)), (0, 1.7, (0.3 * start + rear) / 2)),
                *both(rod((cabin * 0.47, deck, rear * 0.6), (cabin * 0.47, 1.7, rear * 0.6), 0.02)),
            ]
    tyre = rng.uniform(0.12, 0.2)
    x = track / 2
    for at, front, behind in (
        (z, rng.uniform(0.2, 0.7), np.pi * rng.uniform(0.8, 1.05)),
        (-z, rng.uniform(0.0, 0.4), np.pi * rng.uniform(0.8, 1.05)),
    ):
        parts += both(wheel((x, radius, at), radius, tyre, 0, 20, rng.uniform(0.4, 0.8)))
        parts += both(fender((x, radius, at), radius * 1.18, tyre * 1.7, front, behind))
        parts.append(rod((-x, radius, at), (x, radius, at), 0.04))
    parts += both(box((tyre * 1.7, 0.05, 2 * z - 2 * radius), (x, radius * 0.75, 0)))
    parts += both(box((0.35 * track, 0.1, 2 * z), (0.18 * track, low, 0)))
    if chance(rng, 0.8):
        parts += both(ellipsoid((0.12, 0.12, 0.12), (wide / 2 + 0.1, deck - 0.12, z + 0.02)))
        parts += both(rod((0, deck - 0.15, z), (wide / 2 + 0.1, deck - 0.15, z), 0.02))
    return [*parts, box((track * 0.95, 0.08, 0.06), (0, radius, length / 2 + 0.12))] if chance(rng, 0.6) else parts


def formula(rng: np.random.Generator) -> list[Mesh]:
    """A racing car: slender body, open wheels, wings."""
    length, track = rng.uniform(3.4, 5.0), rng.uniform(1.5, 2.0)
    front_radius, radius = rng.uniform(0.26, 0.34), rng.uniform(0.3, 0.36)
    low, z = 0.1, length / 2
    old = chance(rng, 0.25)
    at = np.array([1.0, 0.85, 0.45, 0.15, -0.1, -0.45, -0.8, -0.95]) * z
    wide = np.array([0.1, 0.17, 0.24, 0.34, 0.36, 0.3, 0.2, 0.1]) * rng.uniform(0.85, 1.3)
    top = np.array([0.3, 0.38, 0.52, 0.62, 0.55, 0.9 if not old else 0.75, 0.6, 0.45])
    rings = [
        np.column_stack([oval(w, (t - low) / 2, 3, 16) + [0, (t + low) / 2], np.full(16, a)])
        for w, t, a in zip(wide, top, at, strict=True)
    ]
    parts = [loft(np.stack(rings)), ellipsoid((0.14, 0.18, 0.16), (0, 0.72, -0.05 * z))]
    if not old:
        pod = rng.uniform(0.3, 0.5)
        parts += both(cushion((pod, 0.4, 0.9 * z * rng.uniform(0.7, 1.0)), (0.3 + pod / 2, 0.34, -0.2 * z), 0.4, 5))
        parts.append(box((track * rng.uniform(0.8, 1.0), 0.03, 0.35), (0, 0.16, z * 0.97)))
        parts += both(box((0.03, 0.2, 0.4), (track * 0.45, 0.2, z * 0.97)))
        wing = rng.uniform(0.75, 1.0)
        parts.append(box((track * 0.55, 0.04, 0.35), (0, wing, -z)))
        parts += both(box((0.03, 0.45, 0.45), (track * 0.275, wing - 0.12, -z))) + [
            box((0.08, wing - 0.3, 0.15), (0, wing / 2 + 0.12, -z * 0.95))
        ]
    for place, r, tyre in ((0.68 * z, front_radius, rng.uniform(0.22, 0.34)), (-0.72 * z, radius, rng.uniform(0.28, 0.42))):
        parts += both(wheel((track / 2 - tyre / 2, r, place), r, tyre, 0, 20, 0.5))
        parts += both(bar((0.1, r + 0.1, place + 0.15), (track / 2 - tyre, r, place), 0.05, 0.03)) + both(
            bar((0.1, r - 0.05, place - 0.15), (track / 2 - tyre, r, place), 0.05, 0.03)
        )
    return (
        [*parts, turned((0, 0.85, -0.2 * z), (0, 0.75, -0.4 * z), [0, 1], [0.14, 0.16], 12)]
        if chance(rng, 0.5) and not old
        else parts
    )
