"""Scenes of the study of harm: a true shape, pictures of it, and a cloud to refine."""

from __future__ import annotations

import csv
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates

from tso_cli.errors import InputError
from tso_cli.geometry.arrays import Array
from tso_cli.geometry.points import sample_surface
from tso_cli.geometry.view import View
from tso_cli.io.shipped import CATEGORIES, example_meshes
from tso_cli.optimisation.symmetry import find_mirror_plane
from tso_cli.render.rays import RayScene, render_view
from tso_cli.render.settings import RenderSettings
from tso_cli.render.viewpoints import fitting_distance, look_at

from ..studies.cases import SAMPLES, CaseBuilder, farthest_point_subset
from ..studies.shapes import Shape, shapes_of_part

Rng = np.random.Generator
Bits = NDArray[np.bool_]
STARTS = ("exact", "other")
POINTS, MOST_VIEWS = 1024, 4
SIDES, FURTHER = (32, 64, 96, 128, 256, 400), (1.2, 2.2)
"""Pixels of a picture each way; the distances of cameras, over that which fills the picture."""
BUILDER_SIZE = 64
"""Pixels of the masks of `CaseBuilder`, of which only the start is used."""
# Of warped starts: deviations of the logarithm of an axis' scale, of the shear, and of the noise on
# a lattice of so many nodes each way (longest side 1).
STRETCH, SHEAR, BEND, NODES = 0.12, 0.08, 0.04, 4


@dataclass(frozen=True, eq=False)
class Scene:
    """What is refined. The longest side of the true shape is 1.

    initial : [N, 3], the start, whose first ``own`` points are of the object.
    dense : [16384, 3], points of the true surface. views : 1 or 4.
    world : the true mesh. beside : draws the silhouette [H, W] of another object.
    """

    initial: Array
    own: int
    dense: Array
    views: tuple[View, ...]
    world: RayScene
    beside: Callable[[], Bits]


@dataclass(frozen=True, eq=False)
class Gallery:
    """The scenes of ``shapes``. What is random depends on ``seed`` and the shape's name alone.

    builder : makes the starts of shapes that its split names; other starts are warped truths.
    """

    shapes: Sequence[Shape]
    seed: int = 0
    builder: CaseBuilder | None = None
    listed: frozenset[str] = frozenset()
    _scenes: dict[str, dict[str, Scene]] = field(default_factory=dict)

    def shape(self, number: int) -> Shape:
        """The shapes follow each other without end."""
        return self.shapes[number % len(self.shapes)]

    def scene(self, number: int, start: str, views: int) -> Scene:
        """The scene of `shape` with that start, seen by so many cameras."""
        shape = self.shape(number)
        if shape.name not in self._scenes:
            self._scenes[shape.name] = self._build(number)
        scene = self._scenes[shape.name][start]
        return replace(scene, views=scene.views[:views])

    def rng(self, *words: str) -> Rng:
        """Of the seed and ``words``."""
        return np.random.default_rng([self.seed, *(zlib.crc32(word.encode()) for word in words)])

    def _build(self, number: int) -> dict[str, Scene]:
        """By start, with all views."""
        shape = self.shape(number)
        mesh, rng = shape.mesh(), self.rng(shape.name, "harm")
        dense, exact, again = (
            sample_surface(mesh.vertices, mesh.faces, SAMPLES, rng) for _ in range(3)
        )
        world, side = RayScene(mesh), int(rng.choice(SIDES))
        views = tuple(_seen(world, side, f"mask {i}", rng) for i in range(MOST_VIEWS))
        if self.builder is not None and shape.name in self.listed:
            other = self.builder.cases(shape, "other")[0].initial
        else:
            other = farthest_point_subset(warped(again, rng), POINTS)
        start, beside = farthest_point_subset(exact, POINTS), partial(self._beside, number)
        scene = Scene(start, POINTS, dense, views, world, beside)
        return {"exact": scene, "other": replace(scene, initial=other)}

    def _beside(self, number: int) -> Bits:
        """The silhouette of the next shape, in its first view."""
        return self.scene(number + 1, STARTS[0], 1).views[0].inside


def gallery(
    meshes: Path | None, split: Path | None, part: str, unseen: Path | None, seed: int
) -> Gallery:
    """Of the listed shapes in ``meshes`` and those in ``unseen``, in random order.

    With neither they are three shipped examples.
    """
    builder, listed = None, list[Shape]()
    if meshes is not None:
        listed = shapes_of_part(meshes, split, part)
        builder = CaseBuilder(meshes, split, 1, BUILDER_SIZE, POINTS, seed)
    shapes = [*listed, *(unseen_shapes(unseen) if unseen else ())] or example_shapes()
    order = np.random.default_rng(seed).permutation(len(shapes))
    names = frozenset(shape.name for shape in listed)
    return Gallery([shapes[i] for i in order], seed, builder, names)


def unseen_shapes(folder: Path) -> list[Shape]:
    """The shapes that ``folder``/index.csv names, with their categories, outside of every list."""
    try:
        rows = list(csv.DictReader((folder / "index.csv").read_text().splitlines()))
        paths = [(row["category"], folder / row["file"]) for row in rows]
    except (OSError, KeyError, TypeError, UnicodeDecodeError):
        expected = "expected a table with the columns file and category"
        raise InputError(f"{folder / 'index.csv'}: cannot be read, {expected}") from None
    # The folder's name keeps them apart from shapes of the same name in the lists.
    return [Shape(f"{category}/{folder.name}/{path.stem}", path) for category, path in paths]


def example_shapes() -> list[Shape]:
    """The first shipped mesh of each category."""
    paths = example_meshes()
    firsts = [next(p for p in paths if p.parent.name == category) for category in CATEGORIES]
    return [Shape(f"{path.parent.name}/{path.stem}", path) for path in firsts]


def warped(points: Array, rng: Rng) -> Array:
    """``points`` [N, 3] of longest side 1, stretched, sheared and bent; their mirror plane stays.

    That is the upright one of the coordinate planes, normal to x or z, which fits better.
    """
    normal = np.abs(find_mirror_plane(points).plane.normal)
    order = [0, 1, 2] if normal[0] >= normal[2] else [2, 1, 0]
    change = np.diag(np.exp(STRETCH * rng.normal(size=3)))
    change[2, 1] = SHEAR * rng.normal()
    noise = BEND * rng.normal(size=(NODES, NODES, NODES, 3))
    noise = (noise + noise[::-1] * [-1.0, 1.0, 1.0]) / np.sqrt(2.0)
    places = points[:, order]
    nodes = (places.T + 0.5) * (NODES - 1)
    bent = [map_coordinates(noise[..., i], nodes, order=2, mode="nearest") for i in range(3)]
    result: Array = ((places + np.stack(bent, 1)) @ change.T)[:, order]
    return result


def _seen(world: RayScene, side: int, name: str, rng: Rng) -> View:
    """A mask of ``side`` pixels each way, with room around the object."""
    ranges = RenderSettings()
    angles = rng.uniform(*ranges.azimuth), rng.uniform(*ranges.elevation)
    camera = look_at(*angles, 1.0, (side, side))
    distance = fitting_distance(world.mesh.vertices, camera) * rng.uniform(*FURTHER)
    camera = look_at(*angles, distance, (side, side))
    mask = render_view(world, camera).mask.astype(np.float32) / 255.0
    return View(mask, camera, name=name)
