"""Pictures and ground truth of a mesh, and of a folder of mesh files in a folder of objects."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Collection
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..datasets.items import copied
from ..datasets.rendered import stored_record, writing
from ..errors import InputError
from ..geometry.points import Array, farthest_point_sample, sample_surface
from ..io.meshes import Mesh, find_meshes, read_mesh
from ..version import __version__
from .rays import RayScene, RenderedView, render_view
from .variation import paint, warp
from .viewpoints import RenderSettings, sample_cameras


@dataclass(frozen=True, eq=False)
class RenderedObject:
    """Pictures and ground truth of one mesh, longest side 1.

    samples : [S, 3] float32 points of the surface; target : [P, 3] float32, the farthest-point subset of them.
    """

    views: list[RenderedView]
    samples: NDArray[np.float32]
    target: NDArray[np.float32]


def normalise(mesh: Mesh) -> Mesh:
    """The mesh centred on its bounding box and scaled to longest side 1, without the vertices that no face uses."""
    used, faces = np.unique(mesh.faces, return_inverse=True)
    vertices = mesh.vertices[used]
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    vertices = (vertices - (low + high) / 2.0) / (high - low).max()
    return replace(mesh, vertices=vertices, faces=faces.reshape(mesh.faces.shape).astype(np.int64))


def ground_truth(
    mesh: Mesh, settings: RenderSettings, rng: np.random.Generator
) -> tuple[Array, Array]:
    """Surface samples [samples, 3] and the farthest-point subset of them [points, 3]."""
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
    """What `render_folder` did.

    written, skipped : names of the objects rendered by it, and of those rendered before; failed : name -> why.
    """

    folder: Path
    written: list[str] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)


def render_folder(
    source: Path,
    output: Path,
    settings: RenderSettings,
    seed: int = 0,
    overwrite: bool = False,
    progress: Callable[[int, int, str], None] | None = None,
    only: Collection[str] | None = None,
) -> RenderSummary:
    """Render a mesh, or every mesh of a folder, into ``output``/NAME as `datasets.rendered` describes.

    NAME is the file's path below ``source`` without suffix, NAME~0001 and so on its warped copies; ``only`` names the meshes to
    render. An object is written whole or not at all and depends only on its mesh, its name, ``settings`` and ``seed``: a run
    after a stopped one skips what is complete. A mesh of a folder that cannot be rendered is left out and named in ``failed``.
    ``progress`` is called with the number of objects done, their total and the name of the last one.

    Raises InputError if there is no mesh, one of ``only`` is missing or none can be rendered, names collide, or an object was
    rendered with other settings and ``overwrite`` is false; TsoError if open3d is missing or writing failed.
    """
    _check_folder(output)
    meshes = _names(source, output)
    if only is not None:
        names = set(only)
        missing = sorted(names - set(meshes))
        if missing:
            raise InputError(
                f"{source}: has no mesh {missing[0]} ({len(missing)} of {len(names)} are missing), expected it"
            )
        meshes = {name: path for name, path in meshes.items() if name in names}
    record = {"tso": __version__, "seed": seed, **asdict(settings)}
    summary = RenderSummary(output)
    objects = [
        (copied(name, copy), path, copy)
        for name, path in meshes.items()
        for copy in range(settings.copies + 1)
    ]
    with writing(output) as writer:
        # Before the work starts, so that a clash of settings does not show after an hour.
        waiting = []
        for name, path, copy in objects:
            if _is_rendered(output / name, record, overwrite):
                summary.skipped.append(name)
            else:
                waiting.append((name, path, copy))
        # The copies of a mesh come one after another, so one mesh is cached.
        read = lru_cache(1)(partial(read_mesh, within=source if source.is_dir() else None))
        for done, (name, path, copy) in enumerate(waiting, 1):
            try:
                rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
                mesh = read(path)
                rendered = render_mesh(warp(normalise(mesh), rng) if copy else mesh, settings, rng)
            except InputError as error:
                if len(objects) == 1:
                    raise
                summary.failed[name] = str(error) if str(path) in str(error) else f"{path}: {error}"
            else:
                views = [(view.image, view.mask, view.camera) for view in rendered.views]
                writer.write(
                    name, views, rendered.samples, rendered.target, {"mesh": path.name, **record}
                )
                summary.written.append(name)
            if progress is not None:
                progress(done, len(waiting), name)
    if summary.failed and not (summary.written or summary.skipped):
        raise InputError(
            f"none of {len(objects)} objects could be rendered, the first: {next(iter(summary.failed.values()))}"
        )
    return summary


def _is_rendered(folder: Path, record: dict[str, Any], overwrite: bool) -> bool:
    """Whether the object is complete and stays; InputError if its settings differ from those of ``record``."""
    stored = stored_record(folder)
    if stored is None or overwrite:
        return False
    for key, value in record.items():
        value = list(value) if isinstance(value, tuple) else value
        if key not in ("tso", "copies") and stored.get(key) != value:
            raise InputError(
                f"{folder}: was rendered with {key} {stored.get(key)}, now it is {value}; "
                "expected the same settings, --overwrite or another output folder"
            )
    return True


def _check_folder(output: Path) -> None:
    if output.exists() and not output.is_dir():
        raise InputError(f"{output}: is a file, expected the name of a folder to write to")
    parent = output.resolve().parent
    if not parent.is_dir():
        raise InputError(f"{output}: the folder {parent} does not exist, expected one to write to")


def _names(source: Path, output: Path) -> dict[str, Path]:
    """Name -> mesh, for every mesh of ``source`` but those that lie in ``output``."""
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
                f"{path}: would be rendered as {name}, as would {meshes[name]}; expected different names"
            )
        meshes[name] = path
    for name, path in meshes.items():
        above = next(
            (parent.as_posix() for parent in Path(name).parents if parent.as_posix() in meshes),
            None,
        )
        if above is not None:
            raise InputError(
                f"{path}: would be rendered inside {above}, made of {meshes[above]}; expected another name"
            )
    if not meshes:
        raise InputError(f"{source}: no mesh in this folder beside those of {output}")
    return meshes
