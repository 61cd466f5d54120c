"""The shapes that a prior learns from: meshes of categories, normalised and sampled."""

from __future__ import annotations

import hashlib
import math
import zlib
from collections import Counter
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...datasets.variants import shape_type
from ...errors import InputError
from ...geometry.arrays import Array, Floats
from ...geometry.points import farthest_point_sample, sample_surface
from ...io.meshes import Mesh, find_meshes, read_mesh
from ...render.families import FAMILIES, shape_of
from ...render.normalise import normalise

Progress = Callable[[int, int, str], None]

POINTS = 512  # of one sampling: what the network sees of a cloud
# Points that one sampling is chosen from. The more, the more evenly spread is the sampling.
CANDIDATES = 2500
# Larger meshes take long to draw, and their details are finer than a mask shows.
MOST_FACES = 150_000
RULED_SHARE = 0.4  # of the chances, where there are meshes too
# Of the longest side. The sine of a processor differs from another's in the last bit. Coordinates
# of shapes by rule are often fractions: steps begin at an irrational number, so none is at an edge.
FINGERPRINT_STEP = 1e-3
UPRIGHT_AXES = (0, 2)  # y is up: a mirror plane that is upright has its normal along x or z


@dataclass(frozen=True, eq=False)
class Shape:
    """A mesh with longest side 1, centred on its bounding box.

    category : the folder of the mesh.
    kind : the name that its variants share, with the category.
    samplings : [2, POINTS, 3], evenly spread; the first k points of each are evenly spread too.
    mirror_axis : 0 (x) or 2 (z), the axis along which the shape resembles its mirror image more.
    by_rule : whether it is of a family (`render.families`), and not read from a file.
    """

    name: str
    category: str
    kind: str
    vertices: Floats  # [V, 3]
    faces: NDArray[np.int32]  # [F, 3]
    samplings: Floats
    mirror_axis: int
    by_rule: bool = False

    @classmethod
    def of(cls, mesh: Mesh, name: str, category: str, kind: str, by_rule: bool = False) -> Shape:
        """Of a normalised mesh; the samplings depend on its name too."""
        rng = np.random.default_rng([0, zlib.crc32(name.encode())])
        samplings = np.stack([evenly_spread(mesh.vertices, mesh.faces, rng) for _ in range(2)])
        vertices, faces = mesh.vertices.astype(np.float32), mesh.faces.astype(np.int32)
        axis = mirror_axis(samplings[0])
        return cls(name, category, kind, vertices, faces, samplings, axis, by_rule)


@dataclass(frozen=True, eq=False)
class ShapeSet:
    """Shapes of categories with at least two kinds each, and what was left out (name -> why)."""

    shapes: list[Shape]
    skipped: dict[str, str] = field(default_factory=dict)

    def chances(self) -> Array:
        """The chance [S] of every shape to be drawn; the sum is 1.

        Shapes by rule have RULED_SHARE of the chances, meshes the rest. Within each, a category
        counts by the square root of its number of kinds, so that a large category neither drowns
        the others nor is seen as rarely. The kinds of a category, and the variants of a kind, have
        equal chances.
        """
        groups = [(shape.by_rule, shape.category) for shape in self.shapes]
        variants = Counter((shape.by_rule, shape.kind) for shape in self.shapes)
        kinds = Counter(
            group for group, _ in {(g, s.kind) for g, s in zip(groups, self.shapes, strict=True)}
        )
        weights = np.array(
            [
                kinds[group] ** -0.5 / variants[shape.by_rule, shape.kind]
                for group, shape in zip(groups, self.shapes, strict=True)
            ]
        )
        ruled = np.array([shape.by_rule for shape in self.shapes])
        for part, share in ((ruled, RULED_SHARE), (~ruled, 1.0 - RULED_SHARE)):
            weights[part] = share * weights[part] / weights[part].sum()
        chances: Array = weights / weights.sum()
        return chances

    def __add__(self, other: ShapeSet) -> ShapeSet:
        return ShapeSet([*self.shapes, *other.shapes], self.skipped | other.skipped)

    def fingerprint(self) -> str:
        """Changes when a shape does, and not by the rounding of another processor."""
        digest = hashlib.sha256()
        for shape in self.shapes:
            digest.update(f"{shape.name} {shape.kind}".encode())
            digest.update(shape.faces.tobytes())
            steps = np.floor(shape.vertices / FINGERPRINT_STEP + math.sqrt(2))
            digest.update(steps.astype("<i4").tobytes())
        return digest.hexdigest()[:16]


def ruled_shapes(
    count: int, seed: int, without: Collection[str] = (), progress: Progress | None = None
) -> ShapeSet:
    """``count`` shapes of each family but those in ``without``; each depends on ``seed`` alone."""
    families = [family for family in FAMILIES if family not in without]
    shapes = []
    for family in families:
        for number in range(count):
            name = f"{family}/rule-{number:05d}"
            mesh = shape_of(family, [seed, 5, number])
            shapes.append(Shape.of(mesh, name, family, name, by_rule=True))
            if progress:
                progress(len(shapes), count * len(families), "")
    return ShapeSet(shapes)


def read_shapes(
    folder: Path,
    without: Collection[str] = (),
    strict: bool = False,
    progress: Progress | None = None,
    only: Collection[str] | None = None,
) -> ShapeSet:
    """The meshes FOLDER/CATEGORY/NAME; meshes right in ``folder`` are one category of its name.

    Left out are categories in ``without``, meshes that cannot be read (an InputError with
    ``strict``), meshes of over MOST_FACES faces, and categories with a single kind of object. With
    ``only``, all meshes CATEGORY/NAME are left out that are not among these names.

    Raises InputError if no category with two kinds is left, or one of ``without`` is not there.
    """
    paths: dict[Path, str] = {}
    for path in find_meshes(folder):
        inside = path.relative_to(folder).parts
        paths[path] = inside[0] if len(inside) > 1 else folder.resolve().name
    if only is not None:
        paths = {
            path: category
            for path, category in paths.items()
            if path.relative_to(folder).with_suffix("").as_posix() in set(only)
        }
    stems = Counter((category, path.stem) for path, category in paths.items())
    known = sorted(set(paths.values()))
    if unknown := [name for name in without if name not in known]:
        raise InputError(
            f"{folder}: has no category {unknown[0]!r} to leave out, "
            f"expected one of {', '.join(known)}"
        )
    paths = {path: category for path, category in paths.items() if category not in without}
    shapes, skipped = [], {}
    for number, (path, category) in enumerate(paths.items(), 1):
        # In some collections all meshes have one name, each in a folder of its own.
        name = path.stem
        if stems[category, name] > 1:
            name = "/".join(path.with_suffix("").relative_to(folder).parts[1:]) or name
        try:
            shapes.append(_read_shape(path, name, category))
        except InputError as error:
            if strict:
                raise
            skipped[str(path)] = str(error)
        if progress:
            progress(number, len(paths), "")
    kinds = Counter({shape.kind: shape.category for shape in shapes}.values())
    for category in sorted({*paths.values()} - {name for name in kinds if kinds[name] > 1}):
        skipped[category] = (
            f"{folder}: has {kinds[category]} usable objects of the category {category!r}, "
            "expected 2 at least (variants of one object count once)"
        )
    shapes = [shape for shape in shapes if kinds[shape.category] > 1]
    if not shapes:
        why = next(iter(skipped.values()), f"{folder}: all categories are left out")
        raise InputError(
            f"{folder}: no category can be learned from; the first reason: {why}; "
            "expected FOLDER/CATEGORY/NAME with two meshes of one category at least"
        )
    return ShapeSet(shapes, skipped)


def _read_shape(path: Path, inside: str, category: str) -> Shape:
    """The shape of one file, named ``inside`` its category; InputError if it cannot be used."""
    mesh = read_mesh(path, textures=False)
    if len(mesh.faces) > MOST_FACES:
        raise InputError(
            f"{path}: has {len(mesh.faces):,} faces, expected at most {MOST_FACES:,}; simplify it"
        )
    name = f"{category}/{inside}"
    return Shape.of(normalise(mesh), name, category, f"{category}/{shape_type(inside)}")


def evenly_spread(vertices: NDArray[Any], faces: NDArray[Any], rng: np.random.Generator) -> Floats:
    """Points [POINTS, 3] of the surface, in the order of farthest-point sampling."""
    candidates = sample_surface(vertices, faces, CANDIDATES, rng)
    return candidates[farthest_point_sample(candidates, POINTS)].astype(np.float32)


def mirror_axis(points: Floats) -> int:
    """The axis, x or z, along which the centred ``points`` resemble their mirror image more."""
    few = points[:128]

    def difference(axis: int) -> float:
        image = few.copy()
        image[:, axis] *= -1.0
        squared = np.square(few[:, None] - image[None]).sum(2)
        return float(squared.min(0).mean() + squared.min(1).mean())

    return min(UPRIGHT_AXES, key=difference)
