"""Aeroplanes of many kinds, nose toward -x, symmetric about z = 0. Unit: the length of the fuselage."""

from __future__ import annotations

import numpy as np

from ...io.meshes import Mesh
from .airplane_fast import fighter, odd
from .airplane_large import airliner, business, transport, turboprop
from .airplane_light import biplane, glider, light, warbird
from .parts import chance, join, moved, pick


def generate(rng: np.random.Generator) -> Mesh:
    """One aeroplane: from airliners to gliders and toys."""
    kind = pick(
        rng,
        {
            "airliner": 26,
            "turboprop": 10,
            "transport": 5,
            "business": 8,
            "light": 17,
            "warbird": 7,
            "biplane": 5,
            "fighter": 16,
            "glider": 3,
            "odd": 5,
        },
    )
    mesh = join(KINDS[kind](rng))
    # Models and toys are often shorter, stouter or higher than the real thing.
    spread = 0.16 if chance(rng, 0.15) else 0.04
    return moved(mesh, np.exp(rng.normal(0.0, spread, 3)))


KINDS = {
    "airliner": airliner,
    "turboprop": turboprop,
    "transport": transport,
    "business": business,
    "light": light,
    "warbird": warbird,
    "biplane": biplane,
    "fighter": fighter,
    "glider": glider,
    "odd": odd,
}
