"""Scenes to learn from: a shape, often deformed, and two views with their masks."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from ...errors import InputError
from ...geometry.arrays import Array, Bits, Floats
from .masks import Border, known_window, seen, signed_distance, silhouette
from .shapes import Progress, Shape, ShapeSet, evenly_spread
from .views import draw_pose, draw_view
from .warps import draw_lattices, warped

# Rotation, closeness, distance and window of one view.
View = tuple[Floats, np.float32, NDArray[np.float16], NDArray[np.uint8]]

VIEWS = 2
WARPED_CHANCE = 0.5
RESOLUTIONS = (40, 48, 64, 96, 128, 192)  # cells along a side of a mask
LEAST_FOREGROUND = 25  # cells; a smaller mask says nothing about a shape
TRUNCATED_CHANCE = 0.08  # of a scene, in one of its views
# Shares of the object's extent that the border of a picture cuts off.
CUT_OFF = (0.02, 0.35)
# Draws of a view until its mask is large enough: mostly one, and some for a thin sheet.
MOST_DRAWS = 50


@dataclass(frozen=True, eq=False)
class Scene:
    """A shape and VIEWS views of it.

    shape : index of the shape.
    samplings : [2, POINTS, 3], two samplings of the surface as it is seen.
    rotation, closeness : [VIEWS, 3, 3] and [VIEWS], see `masks.seen`.
    distance : [VIEWS, SCENE_GRID, SCENE_GRID] float16, see `masks.signed_distance`.
    window : [VIEWS, 4], see `masks.known_window`.
    lattice : of the deformation (`warps.draw_lattices`), [SIDE^3, 3]; None for the shape as it is.
    """

    shape: int
    samplings: Floats
    rotation: Floats
    closeness: Floats
    distance: NDArray[np.float16]
    window: NDArray[np.uint8]
    lattice: Floats | None = None


def draw_scene(shapes: ShapeSet, chances: Array, rng: np.random.Generator) -> Scene:
    """One random scene.

    A shape that is too thin to be seen is replaced by another one; InputError if all are.
    """
    for _ in range(MOST_DRAWS):
        index = int(rng.choice(len(chances), p=chances))
        shape = shapes.shapes[index]
        vertices, samplings, lattice = shape.vertices, shape.samplings, None
        if rng.random() < WARPED_CHANCE:
            lattice = _draw_lattice(shape, rng)
            vertices = deformed(shape, lattice)
            samplings = np.stack([evenly_spread(vertices, shape.faces, rng) for _ in range(2)])
        pose = draw_pose(rng)
        truncated = int(rng.integers(VIEWS)) if rng.random() < TRUNCATED_CHANCE else None
        views = [
            _draw_view(vertices, shape.faces, pose, view == truncated, rng) for view in range(VIEWS)
        ]
        seen_views = [view for view in views if view is not None]
        if len(seen_views) == VIEWS:
            rotation, closeness, distance, window = map(np.stack, zip(*seen_views, strict=True))
            return Scene(index, samplings, rotation, closeness, distance, window, lattice)
    raise InputError(
        f"{shape.name}: none of its masks has {LEAST_FOREGROUND} cells of foreground, "
        f"nor of {MOST_DRAWS - 1} other shapes, expected shapes that can be seen"
    )


def _draw_view(
    vertices: Floats,
    faces: NDArray[np.int32],
    pose: Array,
    truncated: bool,
    rng: np.random.Generator,
) -> View | None:
    """One view as the rows of a `Scene`; None if no mask shows enough."""
    for _ in range(MOST_DRAWS):
        rotation, closeness = draw_view(rng, pose)
        cells = int(rng.choice(RESOLUTIONS))
        mask = silhouette(seen(vertices, rotation, closeness), faces, cells)
        border = Border.whole(cells)
        if truncated and mask.any():
            border = draw_border(mask, rng)
        if _shows_an_outline(mask, border):
            return (
                rotation.astype(np.float32),
                np.float32(closeness),
                signed_distance(mask, border).astype(np.float16),
                known_window(border, cells),
            )
    return None


def _draw_lattice(shape: Shape, rng: np.random.Generator) -> Floats:
    """A random deformation of the shape, [SIDE^3, 3]."""
    sizes = np.ptp(shape.vertices, axis=0)[None]
    lattice: Floats = draw_lattices(rng, sizes, np.array([shape.mirror_axis]))[0]
    return lattice


def deformed(shape: Shape, lattice: Floats) -> Floats:
    """The vertices [V, 3] of the shape after a deformation by ``lattice``, normalised again."""
    low, high = shape.vertices.min(0), shape.vertices.max(0)
    vertices, below, above, nodes = (
        torch.from_numpy(array)[None] for array in (shape.vertices, low, high, lattice)
    )
    points = warped(vertices, below, above, nodes)[0].numpy()
    low, high = points.min(0), points.max(0)
    normalised: Floats = (points - (low + high) / 2.0) / (high - low).max()
    return normalised


def draw_border(mask: Bits, rng: np.random.Generator) -> Border:
    """The border of a picture that cuts off one or two sides of the foreground of ``mask``."""
    cells = len(mask)
    edges = [0, 0, cells, cells]
    columns, rows = np.flatnonzero(mask.any(0)), np.flatnonzero(mask.any(1))
    for side in rng.permutation(4)[: rng.integers(1, 3)].tolist():
        along = columns if side in (0, 2) else rows
        extent = along[-1] + 1 - along[0]
        cut = max(1, round(rng.uniform(*CUT_OFF) * extent))
        edges[side] = int(along[0] + cut if side < 2 else along[-1] + 1 - cut)
    return Border(*edges)


def _shows_an_outline(mask: Bits, border: Border) -> bool:
    """Whether the part of ``mask`` within ``border`` has enough foreground, and background."""
    shown = mask[border.top : border.bottom, border.left : border.right]
    return bool(shown.sum() >= LEAST_FOREGROUND and not shown.all())


def draw_scenes(
    shapes: ShapeSet, count: int, seed: int, progress: Progress | None = None
) -> list[Scene]:
    """``count`` scenes. Each depends on its number, ``seed`` and the shapes alone."""
    chances = shapes.chances()
    scenes = []
    for number in range(count):
        scenes.append(draw_scene(shapes, chances, np.random.default_rng([seed, 1, number])))
        if progress:
            progress(number + 1, count, "")
    return scenes
