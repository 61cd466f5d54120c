"""Cars of many kinds, front +z, symmetric about x = 0. Lengths in metres while they are put together."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...io.meshes import Mesh
from .car_body import Knots, Shape, extras, interior
from .car_special import formula, vintage
from .parts import both, box, chance, join, loft, moved, pick

# Side views: share of the length from the nose, share of the height.
PROFILES: dict[str, Knots] = {
    "sedan": (
        (0, 0.42),
        (0.03, 0.52),
        (0.28, 0.63),
        (0.43, 0.96),
        (0.52, 1.0),
        (0.66, 0.97),
        (0.82, 0.69),
        (0.97, 0.65),
        (1, 0.5),
    ),
    "hatch": ((0, 0.42), (0.04, 0.53), (0.25, 0.65), (0.42, 0.97), (0.54, 1.0), (0.82, 0.93), (0.96, 0.65), (1, 0.45)),
    "estate": ((0, 0.42), (0.03, 0.54), (0.27, 0.64), (0.41, 0.97), (0.5, 1.0), (0.87, 0.96), (0.97, 0.66), (1, 0.45)),
    "suv": ((0, 0.45), (0.02, 0.6), (0.26, 0.66), (0.37, 0.97), (0.46, 1.0), (0.9, 0.97), (0.98, 0.65), (1, 0.4)),
    "van": ((0, 0.35), (0.04, 0.45), (0.12, 0.53), (0.27, 0.94), (0.34, 1.0), (0.97, 0.98), (0.995, 0.9), (1, 0.5)),
    "pickup": (
        (0, 0.45),
        (0.02, 0.57),
        (0.26, 0.62),
        (0.36, 0.97),
        (0.4, 1.0),
        (0.54, 0.98),
        (0.585, 0.63),
        (0.99, 0.62),
        (1, 0.5),
    ),
    "sports": (
        (0, 0.3),
        (0.04, 0.48),
        (0.34, 0.68),
        (0.5, 0.97),
        (0.57, 1.0),
        (0.68, 0.95),
        (0.9, 0.73),
        (0.98, 0.7),
        (1, 0.5),
    ),
    "wedge": ((0, 0.28), (0.1, 0.45), (0.3, 0.62), (0.46, 0.97), (0.55, 1.0), (0.66, 0.9), (0.8, 0.75), (0.99, 0.7), (1, 0.4)),
    "round": (
        (0, 0.3),
        (0.08, 0.52),
        (0.3, 0.62),
        (0.4, 0.92),
        (0.52, 1.0),
        (0.66, 0.93),
        (0.85, 0.62),
        (0.96, 0.4),
        (1, 0.28),
    ),
    "micro": ((0, 0.35), (0.06, 0.5), (0.2, 0.6), (0.38, 0.96), (0.5, 1.0), (0.85, 0.95), (0.97, 0.6), (1, 0.4)),
    "open": ((0, 0.48), (0.04, 0.68), (0.32, 0.88), (0.36, 0.95), (0.72, 0.95), (0.97, 0.9), (1, 0.6)),
    "box": (
        (0, 0.55),
        (0.005, 0.6),
        (0.28, 0.62),
        (0.38, 0.99),
        (0.42, 1.0),
        (0.72, 1.0),
        (0.84, 0.63),
        (0.995, 0.62),
        (1, 0.55),
    ),
    "jeep": ((0, 0.5), (0.01, 0.56), (0.33, 0.58), (0.38, 0.97), (0.4, 1.0), (0.96, 1.0), (0.985, 0.6), (1, 0.5)),
}
# Ranges of length, width, height, clearance and wheel radius in metres, and of the rounding of the profile.
RANGES: dict[str, tuple[tuple[float, float], ...]] = {
    "sedan": ((4.2, 5.1), (1.65, 1.9), (1.36, 1.52), (0.14, 0.22), (0.29, 0.35), (0.01, 0.06)),
    "hatch": ((3.5, 4.4), (1.55, 1.85), (1.38, 1.58), (0.14, 0.22), (0.28, 0.34), (0.01, 0.06)),
    "estate": ((4.2, 5.0), (1.65, 1.9), (1.4, 1.6), (0.14, 0.22), (0.29, 0.35), (0.01, 0.05)),
    "suv": ((4.0, 5.0), (1.75, 2.0), (1.6, 1.95), (0.2, 0.32), (0.34, 0.42), (0.01, 0.04)),
    "van": ((4.2, 6.2), (1.7, 2.1), (1.85, 2.7), (0.18, 0.3), (0.31, 0.38), (0.01, 0.04)),
    "pickup": ((4.6, 5.6), (1.7, 2.05), (1.6, 1.95), (0.22, 0.38), (0.34, 0.44), (0.008, 0.03)),
    "sports": ((3.9, 4.8), (1.7, 2.0), (1.1, 1.34), (0.1, 0.17), (0.3, 0.36), (0.03, 0.08)),
    "wedge": ((4.0, 4.7), (1.8, 2.05), (1.0, 1.22), (0.09, 0.15), (0.3, 0.36), (0.01, 0.06)),
    "round": ((3.6, 4.4), (1.5, 1.85), (1.4, 1.6), (0.15, 0.25), (0.28, 0.36), (0.05, 0.1)),
    "micro": ((2.4, 3.4), (1.4, 1.65), (1.4, 1.65), (0.14, 0.22), (0.26, 0.32), (0.02, 0.08)),
    "open": ((3.7, 4.7), (1.6, 1.9), (0.9, 1.1), (0.12, 0.2), (0.28, 0.35), (0.01, 0.06)),
    "box": ((3.6, 5.0), (1.5, 2.1), (1.2, 1.7), (0.14, 0.35), (0.26, 0.42), (0.0, 0.02)),
    "jeep": ((3.3, 4.7), (1.55, 1.95), (1.65, 2.0), (0.25, 0.4), (0.35, 0.46), (0.0, 0.02)),
}
WEIGHTS = {
    "sedan": 18,
    "hatch": 13,
    "estate": 6,
    "suv": 9,
    "van": 7,
    "pickup": 5,
    "sports": 11,
    "wedge": 5,
    "round": 7,
    "micro": 3,
    "open": 6,
    "box": 6,
    "jeep": 4,
    "vintage": 4,
    "formula": 4,
}


def generate(rng: np.random.Generator) -> Mesh:
    """One car: from saloons and vans to racing cars and toys."""
    mesh = join(KINDS[pick(rng, WEIGHTS)](rng))
    # Cartoon cars are shorter and higher than real ones.
    stretch = np.exp(rng.normal(0.0, 0.03, 3))
    if chance(rng, 0.1):
        stretch = stretch * [1.0, rng.uniform(1.0, 1.2), rng.uniform(0.75, 1.0)]
    return moved(mesh, stretch)


def _shape(rng: np.random.Generator, kind: str, **change: Any) -> Shape:
    """Measures of a car of this kind."""
    length, width, height, clearance, radius, smooth = (float(rng.uniform(*limits)) for limits in RANGES[kind])
    knots = np.array(PROFILES[kind])
    moved_knots = knots + rng.normal(0.0, 1.0, knots.shape) * [0.018, 0.015]
    # Ends stay ends, the order stays, and the highest point stays 1.
    s = np.maximum.accumulate(np.clip(moved_knots[:, 0], 0.0, 1.0) + np.arange(len(knots)) * 1e-4)
    s = (s - s[0]) / (s[-1] - s[0])
    y = moved_knots[:, 1] / moved_knots[:, 1].max()
    values: dict[str, Any] = dict(
        length=length,
        width=width,
        height=height,
        clearance=clearance,
        profile=tuple(zip(s.tolist(), y.tolist(), strict=True)),
        belt=(rng.uniform(0.54, 0.63), rng.uniform(0.58, 0.68)),
        tumble=rng.uniform(0.15, 0.55),
        nose=rng.uniform(0.1, 0.9),
        rear=rng.uniform(0.1, 0.8),
        smooth=smooth,
        bulge=rng.uniform(0.0, 0.09),
        front_axle=rng.uniform(0.155, 0.23),
        rear_axle=rng.uniform(0.76, 0.83),
        radius=radius,
        tyre=rng.uniform(0.16, 0.26),
        inset=rng.uniform(-0.02, 0.06),
        arch=0.0 if chance(rng, 0.15) else rng.uniform(1.06, 1.3),
    )
    if kind in ("box", "jeep"):
        values |= dict(
            nose=rng.uniform(0, 0.2),
            rear=rng.uniform(0, 0.2),
            bulge=rng.uniform(0, 0.03),
            tumble=rng.uniform(0.0, 0.4),
            inset=rng.uniform(-0.2, 0.04),
        )
    return Shape(**(values | change))


def _saloon(rng: np.random.Generator, kind: str) -> list[Mesh]:
    """A closed body of any kind in `PROFILES`."""
    change: dict[str, Any] = {}
    if kind == "van":
        change = dict(
            tumble=rng.uniform(0.02, 0.2),
            belt=(0.4, 0.45),
            front_axle=rng.uniform(0.13, 0.2),
            nose=rng.uniform(0.2, 0.8),
            rear=rng.uniform(0, 0.2),
        )
    elif kind in ("round", "micro"):
        change = dict(
            nose=rng.uniform(0.5, 1.2), rear=rng.uniform(0.5, 1.2), bulge=rng.uniform(0.05, 0.15), tumble=rng.uniform(0.3, 0.6)
        )
    elif kind == "sports":
        change = dict(bulge=rng.uniform(0.03, 0.1), tumble=rng.uniform(0.4, 0.8), nose=rng.uniform(0.4, 1.0))
    shape = _shape(rng, kind, **change)
    parts = [shape.mesh(chance(rng, 0.3)), *shape.wheels(rng), *extras(rng, shape)]
    if chance(rng, 0.3):
        parts += interior(rng, shape)
    if kind == "box" and chance(rng, 0.3):  # an engine that looks out of the bonnet
        parts.append(box((0.5, 0.2, 0.6), (0, float(shape.top(0.15)) + 0.05, float(shape.z(0.15)))))
    if kind in ("wedge", "sports", "box") and chance(rng, 0.3):
        deck, z = float(shape.top(0.96)), float(shape.z(0.95))
        rise = rng.uniform(0.12, 0.35)
        parts.append(box((shape.width, 0.04, rng.uniform(0.2, 0.4)), (0, deck + rise, z)))
        parts += both(box((0.05, rise + 0.08, 0.2), (shape.width * 0.38, deck + rise / 2 - 0.02, z)))
    return parts


def _pickup(rng: np.random.Generator) -> list[Mesh]:
    """A cab and an open bed."""
    start = rng.uniform(0.56, 0.62)
    depth = rng.uniform(0.3, 0.5) if chance(rng, 0.8) else 0.0
    shape = _shape(rng, "pickup", rear=rng.uniform(0, 0.15), hollow=(start + 0.03, 0.975, depth) if depth else None)
    return [shape.mesh(chance(rng, 0.2)), *shape.wheels(rng), *extras(rng, shape)]


def _open(rng: np.random.Generator) -> list[Mesh]:
    """A roadster: hollow body, windscreen, seats."""
    start, end = rng.uniform(0.36, 0.42), rng.uniform(0.6, 0.75)
    shape = _shape(rng, "open", belt=(0.8, 0.85), tumble=rng.uniform(0.2, 0.6), hollow=(start, end, rng.uniform(0.35, 0.55)))
    parts = [shape.mesh(chance(rng, 0.2)), *shape.wheels(rng), *extras(rng, shape, 0.6)]
    x, high = shape.width * 0.4, rng.uniform(0.25, 0.42)
    y, z, back = float(shape.top(start - 0.02)) - 0.03, float(shape.z(start - 0.03)), rng.uniform(0.1, 0.5)
    glass = np.array([[[-x, y, z], [x, y, z], [x, y, z - 0.02], [-x, y, z - 0.02]]])
    upper = (glass - [0, 0, back]) * [0.85, 1, 1] + [0, high, 0]
    parts.append(loft(np.concatenate([glass, upper])))
    return parts + interior(rng, shape)


def _closed(kind: str) -> Any:
    return lambda rng: _saloon(rng, kind)


KINDS = {kind: _closed(kind) for kind in PROFILES} | {
    "pickup": _pickup,
    "open": _open,
    "vintage": vintage,
    "formula": formula,
}
