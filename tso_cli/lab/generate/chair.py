"""Chairs of many kinds. Lengths in metres while they are put together; front +z, symmetric about x = 0."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ...io.meshes import Mesh
from .chair_base import base
from .chair_feet import ring
from .chair_frame import Frame
from .chair_shell import lounger, shell
from .chair_soft import armchair
from .chair_upper import arms, back, seat
from .parts import both, box, chance, cushion, join, moved, pick, plate, rod


def generate(rng: np.random.Generator) -> Mesh:
    """One chair: dining, armchair, lounger, office chair, one-piece shell or bar stool."""
    kind = pick(rng, {"dining": 36, "armchair": 21, "lounger": 13, "office": 10, "shell": 12, "bar": 8})
    mesh = join(KINDS[kind](rng))
    stretch = np.exp(rng.normal(0.0, 0.08, 3))
    return moved(mesh, stretch)


def _square(rng: np.random.Generator) -> float:
    """Power of a seat's outline, from round to square."""
    return float(rng.choice([2.0, 3.0, 6.0, 30.0], p=[0.17, 0.13, 0.2, 0.5]))


def _dining(rng: np.random.Generator) -> list[Mesh]:
    """Seat, base, back and sometimes arms, each of any kind."""
    armed = chance(rng, 0.3)
    frame = Frame(
        width=rng.uniform(0.48, 0.6) if armed else rng.uniform(0.37, 0.52),
        depth=rng.uniform(0.37, 0.52),
        height=rng.uniform(0.4, 0.5) if chance(rng, 0.85) else rng.uniform(0.28, 0.42),
        thick=rng.uniform(0.015, 0.05) if chance(rng, 0.7) else rng.uniform(0.05, 0.14),
        back_height=rng.uniform(0.36, 0.58) if chance(rng, 0.75) else rng.uniform(0.24, 0.75),
        lean=rng.uniform(0.0, 0.28),
        bend=rng.uniform(0.0, 0.2) * chance(rng, 0.3),
        wrap=rng.uniform(0.0, 0.1) * chance(rng, 0.5),
        back_width=rng.uniform(0.8, 1.0),
        flare=rng.uniform(-0.15, 0.15) * chance(rng, 0.5),
        square=_square(rng),
    )
    if armed and chance(rng, 0.25):
        return (
            seat(rng, frame) + back(rng, frame, {"panel": 3, "floating": 2, "posts": 1}) + base(rng, frame, {"tubular arms": 1})
        )
    kinds = {
        "legs": 12,
        "sled": 1.2,
        "cantilever": 1.2,
        "crossed": 1,
        "rocker": 0.5,
        "panels": 0.7,
        "block": 0.2,
        "hairpins": 0.8,
        "wires": 0.5,
        "pedestal": 0.6,
    }
    parts = seat(rng, frame) + back(rng, frame) + base(rng, frame, kinds)
    return parts + (arms(rng, frame) if armed else [])


def _office(rng: np.random.Generator) -> list[Mesh]:
    """A padded seat and back on a column over a star of casters."""
    frame = Frame(
        width=rng.uniform(0.42, 0.54),
        depth=rng.uniform(0.42, 0.52),
        height=rng.uniform(0.42, 0.54),
        thick=rng.uniform(0.04, 0.12),
        back_height=rng.uniform(0.4, 0.75),
        lean=rng.uniform(0.05, 0.25),
        bend=rng.uniform(-0.1, 0.1),
        wrap=rng.uniform(0.0, 0.08),
        back_width=rng.uniform(0.8, 1.0),
        flare=rng.uniform(-0.2, 0.1),
    )
    parts = [
        cushion((frame.width, frame.thick, frame.depth), (0, frame.height - frame.thick / 2, 0), 0.6, rng.uniform(2.5, 8), 0.1)
    ]
    if chance(rng, 0.2):
        parts += back(rng, frame)
    else:
        low, crown = rng.uniform(-0.05, 0.35), rng.uniform(0.0, 0.35)
        u, s = np.meshgrid(np.linspace(-1, 1, 11), np.linspace(0, 1, 11))
        wide = 1.0 - crown * np.abs(2 * s - 1) ** rng.uniform(2, 5)
        parts.append(plate(frame.back(u * wide, low + (1 - low) * s), rng.uniform(0.03, 0.11)))
        x, y = 0.0, frame.height - frame.thick
        if low > 0:
            behind = frame.back(0.0, low + 0.15) - [0, 0, 0.02]
            parts += [rod((x, y, -0.1), (x, y, behind[2]), 0.02), rod((x, y, behind[2]), behind, 0.02)]
        if chance(rng, 0.2):
            parts.append(moved(cushion((0.26, 0.14, 0.07), (0, 0, 0), 0.8, 3), 1.0, frame.back(0.0, 1.15)))
    if chance(rng, 0.65):
        parts += arms(rng, frame, {"tee": 4, "tube": 2, "rest": 1, "board": 0.3})
    return parts + base(rng, frame, {"office": 9, "pedestal": 0.6, "sled": 0.4})


def _bar(rng: np.random.Generator) -> list[Mesh]:
    """A small seat on long legs, with a low back or none."""
    wide = rng.uniform(0.28, 0.44)
    frame = Frame(
        width=wide,
        depth=wide * rng.uniform(0.9, 1.1),
        height=rng.uniform(0.6, 0.82) if chance(rng, 0.8) else rng.uniform(0.42, 0.55),
        thick=rng.uniform(0.02, 0.1),
        back_height=rng.uniform(0.15, 0.4),
        lean=rng.uniform(0.0, 0.25),
        wrap=rng.uniform(0.0, 0.1),
        back_width=rng.uniform(0.8, 1.0),
        square=_square(rng),
    )
    if chance(rng, 0.2):  # low and stout
        frame = replace(frame, width=rng.uniform(0.3, 0.42), depth=rng.uniform(0.3, 0.42), height=rng.uniform(0.26, 0.45))
    parts = seat(rng, frame)
    # Some stools have no back at all.
    if chance(rng, 0.6) and frame.height > 0.45:
        parts += back(rng, frame, {"panel": 3, "posts": 2, "floating": 3, "hoop": 1})
    parts += base(rng, frame, {"legs": 6, "pedestal": 3, "sled": 0.7, "wires": 0.6, "hairpins": 0.3})
    level, foot = frame.height * rng.uniform(0.25, 0.45), wide * 0.5
    if frame.height < 0.45:
        return parts
    if chance(rng, 0.4):
        parts.append(ring(level, foot * rng.uniform(0.7, 1.1), 0.01))
    elif chance(rng, 0.3):
        parts += both(box((0.02, 0.03, wide * 0.85), (wide * 0.43, level, 0)))
        parts += [box((wide * 0.85, 0.03, 0.02), (0, level, z)) for z in (-wide * 0.43, wide * 0.43)]
    return parts


KINDS = {"dining": _dining, "armchair": armchair, "lounger": lounger, "office": _office, "shell": shell, "bar": _bar}
