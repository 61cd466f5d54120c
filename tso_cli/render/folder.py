"""Pictures and ground truth of a mesh, or of every mesh in a folder."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Collection, Mapping
from dataclasses import asdict, dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from ..datasets.items import copied
from ..datasets.rendered import stored_record, writing
from ..errors import InputError
from ..geometry.arrays import Array, Floats
from ..geometry.points import farthest_point_sample, sample_surface
from ..io.meshes import Mesh, find_meshes, read_mesh
from ..version import __version__
from .families import Rng, shape_of
from .normalise import normalise
from .rays import RayScene, RenderedView, render_view
from .variation import paint, warp
from .viewpoints import RenderSettings, sample_cameras


@dataclass(frozen=True, eq=False)
class RenderedObject:
    """Pictures and ground truth of one mesh, scaled to longest side 1."""

    views: list[RenderedView]
    samples: Floats  # [S, 3] points of the surface
    target: Floats  # [P, 3] those samples that farthest-point sampling chooses


def ground_truth(
    mesh: Mesh, settings: RenderSettings, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Samples of the surface [samples, 3], and their farthest-point sample [points, 3]."""
    samples = sample_surface(mesh.vertices, mesh.faces, settings.samples, rng)
    return samples, samples[farthest_point_sample(samples, settings.points)]


def render_mesh(mesh: Mesh, settings: RenderSettings, rng: np.random.Generator) -> RenderedObject:
    """Normalise ``mesh``, render its views and sample its ground truth."""
    mesh = normalise(paint(mesh, rng) if settings.paint else mesh)
    scene = RayScene(mesh)
    views = [
        render_view(scene, camera, rng) for camera in sample_cameras(settings, mesh.vertices, rng)
    ]
    samples, target = ground_truth(mesh, settings, rng)
    return RenderedObject(views, samples.astype(np.float32), target.astype(np.float32))


@dataclass(frozen=True)
class RenderSummary:
    """What `render_folder` did, by the names of the objects."""

    folder: Path
    written: list[str] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)  # an earlier run had rendered them
    failed: dict[str, str] = field(default_factory=dict)  # name -> why


def render_folder(
    source: Path | None,
    output: Path,
    settings: RenderSettings,
    seed: int = 0,
    overwrite: bool = False,
    progress: Callable[[int, int, str], None] | None = None,
    only: Collection[str] | None = None,
    families: Mapping[str, int] | None = None,
) -> RenderSummary:
    """Render a mesh, or every mesh of a folder, into ``output``/NAME as `datasets.rendered` says.

    NAME is the path of the mesh below ``source`` without its suffix. Warped copies are called
    NAME~0001 and so on. Each object is written whole or not at all. It depends only on its mesh,
    its name, ``settings`` and ``seed``: after a run that was stopped, the next one skips the
    objects that are complete. If a mesh of a folder cannot be rendered, it is left out and listed
    in ``failed``.

    Parameters
    ----------
    only : names of the meshes to render; None means all.
    families : name of a family (`families.FAMILIES`) -> how many of its shapes to render too. They
        are called FAMILY/rule-00001 and so on, and have no copies.
    progress : called with the number of objects done, their total and the name of the last one.

    Raises InputError if

    - there is no mesh, none can be rendered, or one of ``only`` is missing;
    - two objects would get the same name, or one would be inside another;
    - an object was rendered with other settings and ``overwrite`` is false.

    Raises TsoError if open3d is missing or writing failed.
    """
    _check_folder(output)
    meshes = {} if source is None else named_meshes(source, output)
    if only is not None:
        names = set(only)
        if missing := sorted(names - set(meshes)):
            raise InputError(
                f"{source}: has no mesh {missing[0]} ({len(missing)} of {len(names)} are missing), "
                "expected it"
            )
        meshes = {name: path for name, path in meshes.items() if name in names}
    record = {"tso": __version__, "seed": seed, **asdict(settings)}
    summary = RenderSummary(output)
    # The copies of a mesh come one after another: one cached mesh is enough.
    within = source if source is not None and source.is_dir() else None
    read = lru_cache(1)(partial(read_mesh, within=within))
    objects: list[tuple[str, Path | str, Callable[[Rng], Mesh]]] = []
    for name, path in meshes.items():
        objects.append((name, path, partial(_read, read, path)))
        for copy in range(1, settings.copies + 1):
            objects.append((copied(name, copy), path, partial(_warped, read, path)))
    for family, count in (families or {}).items():
        for number in range(1, count + 1):
            name = f"{family}/rule-{number:05d}"
            objects.append((name, name, partial(_by_rule, family, seed, number)))
    with writing(output) as writer:
        # All objects are checked first: a conflict of settings must not come up after an hour.
        waiting = []
        for item in objects:
            if _is_rendered(output / item[0], record, overwrite):
                summary.skipped.append(item[0])
            else:
                waiting.append(item)
        for done, (name, origin, make) in enumerate(waiting, 1):
            try:
                rng = np.random.default_rng(
                    [seed, zlib.crc32(name.encode(errors="surrogateescape"))]
                )
                rendered = render_mesh(make(rng), settings, rng)
            except InputError as error:
                if len(objects) == 1:
                    raise
                message = str(error)
                summary.failed[name] = message if str(origin) in message else f"{origin}: {message}"
            else:
                views = [(view.image, view.mask, view.camera) for view in rendered.views]
                writer.write(
                    name,
                    views,
                    rendered.samples,
                    rendered.target,
                    {"mesh": Path(origin).name, **record},
                )
                summary.written.append(name)
            if progress is not None:
                progress(done, len(waiting), name)
    if summary.failed and not (summary.written or summary.skipped):
        first = next(iter(summary.failed.values()))
        raise InputError(f"none of {len(objects)} objects could be rendered, the first: {first}")
    return summary


def _read(read: Callable[[Path], Mesh], path: Path, rng: Rng) -> Mesh:
    return read(path)


def _warped(read: Callable[[Path], Mesh], path: Path, rng: Rng) -> Mesh:
    return warp(normalise(read(path)), rng)


def _by_rule(family: str, seed: int, number: int, rng: Rng) -> Mesh:
    return shape_of(family, [seed, number])


def _is_rendered(folder: Path, record: dict[str, Any], overwrite: bool) -> bool:
    """Whether the object is complete and may stay; InputError if its settings differ."""
    stored = stored_record(folder)
    if stored is None or overwrite:
        return False
    for key, value in record.items():
        value = list(value) if isinstance(value, tuple) else value
        if key not in ("tso", "copies") and stored.get(key) != value:
            raise InputError(
                f"{folder}: was rendered with {key} {stored.get(key)}, now it is {value}; "
                "expected the same settings, `overwrite` or another output folder"
            )
    return True


def _check_folder(output: Path) -> None:
    if output.exists() and not output.is_dir():
        raise InputError(f"{output}: is a file, expected the name of a folder to write to")
    parent = output.resolve().parent
    if not parent.is_dir():
        raise InputError(f"{output}: the folder {parent} does not exist, expected one to write to")


def named_meshes(source: Path, output: Path) -> dict[str, Path]:
    """Name -> mesh, for every mesh of ``source`` that does not lie in ``output``."""
    if not source.is_dir():
        return {source.stem: source}
    written = output.resolve()
    meshes: dict[str, Path] = {}
    for path in find_meshes(source):
        if written != source.resolve() and written in path.resolve().parents:
            continue
        name = path.relative_to(source).with_suffix("").as_posix()
        if name in meshes:
            raise InputError(
                f"{path}: would be rendered as {name}, and {meshes[name]} too, "
                "expected different names"
            )
        meshes[name] = path
    for name, path in meshes.items():
        for parent in map(Path.as_posix, Path(name).parents):
            if parent in meshes:
                raise InputError(
                    f"{path}: would be rendered inside {parent}, made of {meshes[parent]}, "
                    "expected another name"
                )
    if not meshes:
        raise InputError(
            f"{source}: all meshes in this folder are in {output}, "
            "expected meshes outside the folder to write to"
        )
    return meshes
