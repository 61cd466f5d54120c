"""A mesh file, or a folder of them: rendered into a folder, object by object."""

from __future__ import annotations

import zlib
from collections.abc import Callable, Collection
from dataclasses import asdict, dataclass, field
from functools import lru_cache, partial
from pathlib import Path

import numpy as np

from ..datasets.items import copied
from ..datasets.rendered import stored_record, sweep, write_object
from ..errors import InputError
from ..io.meshes import find_meshes, read_mesh
from ..version import __version__
from .objects import normalise, render_mesh
from .variation import warp
from .viewpoints import RenderSettings


@dataclass(frozen=True)
class RenderSummary:
    """What render_folder did.

    written, skipped : names of the objects rendered now and of those that were there already; failed : name -> why not.
    """

    folder: Path
    written: list[str] = field(default_factory=list)
    skipped: list[str] = field(default_factory=list)
    failed: dict[str, str] = field(default_factory=dict)


def render_folder(
    source: Path | str,
    output: Path | str,
    settings: RenderSettings,
    seed: int = 0,
    overwrite: bool = False,
    progress: Callable[[int, int, str], None] | None = None,
    only: Collection[str] | None = None,
) -> RenderSummary:
    """Render a mesh, or every mesh of a folder, into ``output``/NAME as `datasets.rendered` describes.

    NAME is the file's path below ``source`` without suffix, NAME~0001 and so on its warped copies. An object is written whole
    or not at all and depends only on its mesh, its name, ``settings`` and ``seed``, so that a run that was stopped can be
    started again and goes on: what is there and was made alike is skipped, and what a killed run left of an object is removed.
    A mesh of a folder that cannot be rendered is left out and named in ``failed``.

    Parameters
    ----------
    progress : called with objects done, objects in all and the name of the last one.
    only : names of the meshes to render; None renders all.

    Raises
    ------
    InputError
        There is no mesh, or one of ``only`` is missing; ``output`` cannot be a folder; two meshes have one name; an object is
        there that other settings made and ``overwrite`` is false; no mesh could be rendered.
    TsoError
        open3d is missing, or writing failed.
    """
    source, output = Path(source), Path(output)
    if seed < 0:
        raise InputError(f"seed is {seed}, expected 0 or more")
    _check_folder(output)
    meshes = _names(source, output)
    if only is not None:
        missing = sorted(set(only) - set(meshes))
        if missing:
            raise InputError(
                f"{source}: has no mesh {missing[0]} ({len(missing)} of {len(set(only))} are missing), expected it"
            )
        meshes = {name: path for name, path in meshes.items() if name in set(only)}
    record = {"tso": __version__, "seed": seed, **asdict(settings)}
    summary = RenderSummary(output)
    waiting: list[tuple[str, Path, int]] = []
    # All of what is there is looked at before the work starts: a clash of settings should not show after an hour.
    objects = [(copied(name, copy), path, copy) for name, path in meshes.items() for copy in range(settings.copies + 1)]
    sweep(output / name for name, _, _ in objects)
    for name, path, copy in objects:
        found = stored_record(output / name)
        if found is None or overwrite:
            waiting.append((name, path, copy))
            continue
        for key, value in record.items():
            value = list(value) if isinstance(value, tuple) else value
            # More copies may be asked for later.
            if key not in ("tso", "copies") and found.get(key) != value:
                raise InputError(
                    f"{output / name}: was rendered with {key} {found.get(key)}, now it is {value}; "
                    "expected the same settings, --overwrite or another output folder"
                )
        summary.skipped.append(name)
    # The copies of a mesh follow it, so one is kept.
    read = lru_cache(1)(partial(read_mesh, within=Path(source) if Path(source).is_dir() else None))
    for done, (name, path, copy) in enumerate(waiting):
        try:
            rng = np.random.default_rng([seed, zlib.crc32(name.encode())])
            mesh = read(path)
            rendered = render_mesh(warp(normalise(mesh), rng) if copy else mesh, settings, rng, name)
        except InputError as error:
            if len(objects) == 1:
                raise
            summary.failed[name] = str(error) if str(path) in str(error) else f"{path}: {error}"
        else:
            views = [(view.image, view.mask, view.camera) for view in rendered.views]
            write_object(output / name, views, rendered.samples, rendered.target, {"mesh": path.name, **record}, overwrite)
            summary.written.append(name)
        if progress is not None:
            progress(done + 1, len(waiting), name)
    if summary.failed and not (summary.written or summary.skipped):
        raise InputError(f"none of {len(objects)} objects could be rendered, the first: {next(iter(summary.failed.values()))}")
    return summary


def _check_folder(output: Path) -> None:
    if output.exists() and not output.is_dir():
        raise InputError(f"{output}: is a file, expected the name of a folder to write to")
    parent = output.resolve().parent
    if not parent.is_dir():
        raise InputError(f"{output}: the folder {parent} does not exist, expected one to write to")


def _names(source: Path, output: Path) -> dict[str, Path]:
    """Name of each object -> its mesh."""
    if not source.is_dir():
        return {source.stem: source}
    inside = output.resolve()
    meshes: dict[str, Path] = {}
    for path in find_meshes(source):
        if inside != source.resolve() and inside in path.resolve().parents:
            continue  # written by an earlier run
        name = path.relative_to(source).with_suffix("").as_posix()
        if name in meshes:
            raise InputError(f"{path}: would be rendered as {name}, as would {meshes[name]}; expected different names")
        meshes[name] = path
    for name, path in meshes.items():
        above = next((parent.as_posix() for parent in Path(name).parents if parent.as_posix() in meshes), None)
        if above is not None:
            raise InputError(f"{path}: would be rendered inside {above}, made of {meshes[above]}; expected another name")
    if not meshes:
        raise InputError(f"{source}: no mesh in this folder beside those of {output}")
    return meshes
