"""Columns, stars of arms, footrests and the short feet of armchairs. Lengths in metres."""

from __future__ import annotations

import numpy as np

from ...io.meshes import Mesh
from .chair_frame import Frame
from .parts import bar, box, chance, mirrored, pick, rod, tube, turned, wheel


def pedestal(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """A column on a disc, a trumpet foot or a star of arms."""
    top, foot = frame.height - frame.thick * 0.6, rng.uniform(0.18, 0.3)
    column = rng.uniform(0.02, 0.045)
    kind = pick(rng, {"disc": 2, "tulip": 2, "star": 3})
    if kind == "tulip":
        t = np.linspace(0.0, 1.0, 9)
        neck = column + (foot - column) * (1.0 - t) ** rng.uniform(4, 9) + rng.uniform(0.0, 0.1) * t**4
        return [turned((0, 0, 0), (0, top, 0), t, neck, 20)]
    if kind == "disc":
        plate_ = turned((0, 0, 0), (0, 0.03, 0), [0, 0.4, 1], [foot, foot, column * 1.2], 20)
        return [plate_, rod((0, 0.02, 0), (0, top, 0), column)]
    return [rod((0, 0.06, 0), (0, top, 0), column), *star(rng, foot * 1.1, int(rng.integers(4, 6)), False)]


def star(rng: np.random.Generator, reach: float, arms: int, casters: bool) -> list[Mesh]:
    """Arms from the foot of a column outward, on wheels where ``casters``."""
    ground = 0.06 if casters else 0.015
    rise, turn = ground + rng.uniform(0.02, 0.06), rng.choice([0.0, np.pi / arms])
    width, parts = rng.uniform(0.025, 0.05), []
    for angle in turn + 2.0 * np.pi * np.arange(arms) / arms:
        out = np.array([np.sin(angle), 0.0, np.cos(angle)])
        tip = out * reach + [0, ground, 0]
        parts.append(bar((0, rise + 0.02, 0), tip, width * 1.2, width * 0.9, 0.6, (-out[2], 0.0, out[0])))
        if casters:
            across = (-out[2], 0.0, out[0])
            axle = tip - [0.0, ground - 0.028, 0.0]
            parts += [rod(axle - np.multiply(across, 0.026), axle + np.multiply(across, 0.026), 0.028, sides=10)]
    return parts


def office(rng: np.random.Generator, frame: Frame) -> list[Mesh]:
    """Gas column on a star with casters, and the plate under the seat."""
    top = frame.height - frame.thick * 0.8
    parts = star(rng, rng.uniform(0.26, 0.36), 4 if chance(rng, 0.15) else 5, not chance(rng, 0.15))
    parts.append(turned((0, 0.06, 0), (0, top, 0), [0, 0.45, 0.45, 1], [0.032, 0.03, 0.018, 0.018], 10))
    if chance(rng, 0.7):
        parts.append(box((0.16, 0.05, 0.22), (0, top - 0.02, 0)))
    return parts


def ring(height: float, radius: float, thick: float) -> Mesh:
    """A hoop lying flat, as a footrest."""
    angle = np.linspace(0.0, 2.0 * np.pi, 20, endpoint=False)
    path = np.stack([radius * np.sin(angle), np.full(20, height), radius * np.cos(angle)], axis=1)
    return tube(path, thick, 6, closed=True)


def short_feet(rng: np.random.Generator, width: float, depth: float, high: float) -> list[Mesh]:
    """Feet under an armchair, on the floor below y = ``high``."""
    kind = pick(rng, {"round": 2, "square": 2, "splayed": 1, "wheel": 0.4})
    thick, inset = rng.uniform(0.015, 0.04), rng.uniform(0.03, 0.1)
    parts = []
    for z in (depth / 2.0 - inset, -depth / 2.0 + inset):
        head = np.array([width / 2.0 - inset, high, z])
        if kind == "wheel":
            part = wheel(head * [1, 0, 1] + [0, high / 2.0, 0], high / 2.0, 0.02, 0, 10)
        elif kind == "square":
            part = bar(head, head * [1, 0, 1], thick * 1.6, thick * 1.6, rng.uniform(0.6, 1.0), (1, 0, 0))
        else:
            part = rod(head, head * ([1.05, 0, 1.08] if kind == "splayed" else [1, 0, 1]), thick, thick * rng.uniform(0.4, 1.0))
        parts += [part, mirrored(part, 0)]
    return parts
