"""Scenes to learn from: a shape, often deformed, and two views with masks as people have them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from ...errors import InputError
from ...geometry.arrays import Array, Bits, Floats
from .depths import depth_of
from .masks import (
    HALF_SIDE,
    Border,
    at_cells,
    known_window,
    seen,
    signed_distance,
    silhouette,
)
from .shapes import Shape, ShapeSet, evenly_spread
from .troubles import OUTLINES, PARTS, Marred, marred
from .views import draw_pose, draw_view
from .warps import draw_lattices, warped

VIEWS = 2
WARPED_CHANCE = 0.5
# The longest side of an object in pixels, log-uniform. Masks are drawn with MOST_CELLS at most: the
# network, which sees 40, cannot tell finer ones apart.
SIZES, MOST_CELLS = (8.0, 400.0), 192
LEAST_FOREGROUND = 12  # cells; a smaller mask says nothing about a shape
TRUNCATED_CHANCE = 0.08  # of a scene, in one of its views
# Shares of the object's extent that the border of a picture cuts off.
CUT_OFF = (0.02, 0.35)
# Draws of a view until its mask is large enough: mostly one, and some for a thin sheet.
MOST_DRAWS = 50


@dataclass(frozen=True, eq=False)
class SceneView:
    """One view of a scene; maps are [SCENE_GRID, SCENE_GRID].

    rotation, closeness : [3, 3] and a number, see `masks.seen`.
    distance : float16, see `masks.signed_distance`; of the mask as it is given.
    window : [4], see `masks.known_window`.
    foreign, hidden : bool, see `troubles.Marred`.
    outline : whether the outline is grown, shrunk or drawn badly.
    size : the longest side of the object in pixels.
    depth : float16, z of the visible surface in the axes of the view, NaN where there is none; None
        without a depth map.
    """

    rotation: Floats
    closeness: float
    distance: NDArray[np.float16]
    window: NDArray[np.uint8]
    foreign: Bits
    hidden: Bits
    outline: bool
    size: float
    depth: NDArray[np.float16] | None = None


@dataclass(frozen=True, eq=False)
class Scene:
    """A shape and VIEWS views of it.

    shape : index of the shape.
    samplings : [2, POINTS, 3], two samplings of the surface as it is seen.
    lattice : of the deformation (`warps.draw_lattices`), [SIDE^3, 3]; None for the shape as it is.
    """

    shape: int
    samplings: Floats
    views: tuple[SceneView, ...]
    lattice: Floats | None = None


@dataclass(frozen=True)
class Chances:
    """What scenes have next to a shape and two views.

    marred : chance of a view whose mask has a trouble. depth_maps : of a scene with depth maps.
    """

    marred: float = 0.4
    depth_maps: float = 0.4


CHANCES = Chances()


def draw_scene(
    shapes: ShapeSet, of_shapes: Array, rng: np.random.Generator, chances: Chances = CHANCES
) -> Scene:
    """One random scene; ``of_shapes`` are the chances of the shapes (`ShapeSet.chances`).

    A shape that is too thin to be seen is replaced by another one; InputError if all are.
    """
    for _ in range(MOST_DRAWS):
        index = int(rng.choice(len(of_shapes), p=of_shapes))
        shape = shapes.shapes[index]
        vertices, samplings, lattice = shape.vertices, shape.samplings, None
        if rng.random() < WARPED_CHANCE:
            lattice = _draw_lattice(shape, rng)
            vertices = deformed(shape, lattice)
            samplings = np.stack([evenly_spread(vertices, shape.faces, rng) for _ in range(2)])
        pose = draw_pose(rng)
        truncated = int(rng.integers(VIEWS)) if rng.random() < TRUNCATED_CHANCE else None
        with_depth = rng.random() < chances.depth_maps
        second = shapes.shapes[int(rng.choice(len(of_shapes), p=of_shapes))]
        views = []
        for view in range(VIEWS):
            drawn = _View.draw(vertices, shape.faces, pose, view == truncated, rng)
            if drawn is None:
                break
            depth = None
            if with_depth:
                depth = depth_of(vertices, shape.faces, drawn.rotation, drawn.closeness)
            views.append(drawn.scene_view(second, pose, depth, rng, chances.marred))
        if len(views) == VIEWS:
            return Scene(index, samplings, tuple(views), lattice)
    raise InputError(
        f"{shape.name}: none of its masks has {LEAST_FOREGROUND} cells of foreground, "
        f"nor of {MOST_DRAWS - 1} other shapes, expected shapes that can be seen"
    )


@dataclass(frozen=True, eq=False)
class _View:
    """A view of a shape with its true mask [cells, cells] and the border of the picture."""

    rotation: Array
    closeness: float
    size: float
    mask: Bits
    border: Border

    @classmethod
    def draw(
        cls,
        vertices: Floats,
        faces: NDArray[np.int32],
        pose: Array,
        truncated: bool,
        rng: np.random.Generator,
    ) -> _View | None:
        """One view; None if no mask shows enough."""
        for _ in range(MOST_DRAWS):
            rotation, closeness = draw_view(rng, pose)
            size = float(np.exp(rng.uniform(*np.log(SIZES))))
            cells = min(MOST_CELLS, round(2.0 * HALF_SIDE * size))
            mask = silhouette(seen(vertices, rotation, closeness), faces, cells)
            border = Border.whole(cells)
            if truncated and mask.any():
                border = draw_border(mask, rng)
            if _shows_an_outline(mask, border):
                return cls(rotation, closeness, size, mask, border)
        return None

    def scene_view(
        self,
        second: Shape,
        pose: Array,
        depth: Floats | None,
        rng: np.random.Generator,
        marred_chance: float,
    ) -> SceneView:
        """The view with a mask that may have a trouble; ``second`` is another object."""
        given = Marred.none(self.mask)
        if rng.random() < marred_chance:
            trouble = str(rng.choice([*PARTS, "object", *OUTLINES]))
            other = None
            if trouble == "object":
                rotation, closeness = draw_view(rng, pose)
                image = seen(second.vertices, rotation, closeness) * rng.uniform(0.5, 1.2)
                other = silhouette(image, second.faces, len(self.mask))
                other = other if other.any() else None
            changed = marred(self.mask, trouble, rng, other)
            if changed is not None and _shows_an_outline(changed.given, self.border):
                given = changed
        if depth is not None:
            depth = np.where(at_cells(given.given & ~given.foreign) > 0.5, depth, np.nan)
        return SceneView(
            self.rotation.astype(np.float32),
            self.closeness,
            signed_distance(given.given, self.border).astype(np.float16),
            known_window(self.border, len(self.mask)),
            at_cells(given.foreign) > 0.5,
            at_cells(given.hidden) > 0.5,
            given.trouble in OUTLINES,
            self.size,
            None if depth is None else depth.astype(np.float16),
        )


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


def numbered_scene(
    shapes: ShapeSet, of_shapes: Array, seed: int, number: int, chances: Chances = CHANCES
) -> Scene:
    """The scene of a number: it depends on its number, ``seed``, shapes and chances alone."""
    return draw_scene(shapes, of_shapes, np.random.default_rng([seed, 1, number]), chances)
