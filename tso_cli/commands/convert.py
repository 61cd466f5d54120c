"""`tso convert`: clouds, meshes and cameras from one format to another."""

from __future__ import annotations

import os
import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import click

from ..errors import InputError, prefixed
from ..io.output import check_output, write_file
from ..option import check, declared, opt
from . import options

if TYPE_CHECKING:
    from ..geometry.camera import Camera
    from ..io.cameras import PartialCamera

PICTURE = re.compile(r"\.(png|jpe?g|tiff?|webp|bmp)$", re.IGNORECASE)
MESHES = (".glb", ".obj", ".off", ".stl")


class Size(click.ParamType):
    """WIDTHxHEIGHT."""

    name = "WIDTHxHEIGHT"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, int]:
        from ..io.images import PIXEL_LIMIT

        sides = str(value).split("x")
        if len(sides) != 2 or not all(side.isdecimal() and int(side) > 0 for side in sides):
            self.fail(f"{value!r}, expected WIDTHxHEIGHT in pixels, such as 640x480.", param, ctx)
        width, height = map(int, sides)
        if width * height > PIXEL_LIMIT:
            self.fail(f"{value!r}, expected at most {PIXEL_LIMIT:,} pixels.", param, ctx)
        return width, height


class Columns(click.ParamType):
    """Three numbers of columns, from 1."""

    name = "X,Y,Z"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, int, int]:
        words = str(value).split(",")
        if len({*words}) != 3 or not all(re.fullmatch("[1-9][0-9]?", word) for word in words):
            self.fail(f"{value!r}, expected three columns from 1, such as 2,3,4.", param, ctx)
        x, y, z = (int(word) - 1 for word in words)
        return x, y, z


@dataclass(frozen=True, kw_only=True)
class ConvertOptions:
    """What `tso convert` may be given.

    to : Convert cameras, to this format: tso's own, a COLMAP model (a folder of text files), or a
        transforms.json.
    size : Size of the pictures, if A does not say it.
    intrinsics : Camera file whose K is used for the cameras of A.
    columns : Columns of x, y and z in a table of points, from 1.
    """

    source: Path = opt(options.REQUIRED, role="argument", metavar="A")
    target: Path = opt(options.REQUIRED, role="argument", metavar="B")
    to: Literal["tso", "colmap", "transforms"] | None = opt(None)
    camera_format: str | None = options.camera_format()
    size: tuple[int, int] | None = opt(None, parser=Size())
    intrinsics: Path | None = opt(None)
    object_id: int | None = options.object_id()
    columns: tuple[int, int, int] | None = opt(None, parser=Columns())
    overwrite: bool = options.overwrite()

    def __post_init__(self) -> None:
        check(self)


@options.command("convert", ConvertOptions)
def command(ctx: click.Context, chosen: ConvertOptions) -> None:
    """Convert the cloud, mesh or cameras of A to B.

    \b
    tso convert scan.pcd scan.ply
    tso convert model.obj model.glb
    tso convert sparse/0 cameras.json
    tso convert cameras.json model --to colmap

    Cameras are converted if B is a .json file, or with --to. Otherwise the suffix of B
    says how the cloud or mesh is written: .ply, .npy, .xyz, or a mesh as .glb, .obj, .off or .stl.
    """
    if chosen.to is not None or chosen.target.suffix.lower() == ".json":
        _convert_cameras(chosen)
        return
    for name in ("camera_format", "size", "object_id", "intrinsics"):
        if getattr(chosen, name) is not None:
            flag = declared(ConvertOptions)[name].flag
            raise InputError(
                f"{flag} is for cameras, found {chosen.target} as a cloud or mesh to write"
            )
    _convert_cloud(chosen)


def _convert_cloud(chosen: ConvertOptions) -> None:
    from ..io.clouds import MOVABLE, NEW, check_rounding, read_cloud, warn_of_losses, write_cloud

    source, target, overwrite = chosen.source, chosen.target, chosen.overwrite
    suffix = target.suffix.lower()
    own = suffix in MOVABLE and suffix == source.suffix.lower()
    if suffix not in (*NEW, *MESHES) and not own:
        raise InputError(
            f"{target}: the suffix is {target.suffix!r}, expected {', '.join((*NEW, *MESHES))}, or "
            "for cameras .json, or --to"
        )
    check_output(target, overwrite)
    cloud = read_cloud(source, extended=False, columns=chosen.columns)
    faces = cloud.faces()
    if suffix in MESHES and not own and faces is None:
        raise InputError(f"{source}: has no faces, expected a mesh for {suffix}")
    if not own and suffix != ".ply":
        warn_of_losses(cloud, suffix)
    if faces is not None and suffix in MESHES and not own:
        from ..io.meshes import new_mesh

        if suffix in (".glb", ".stl"):
            in_all = f"in every {suffix} file"
            check_rounding(target, cloud.points, in_all, "write .ply, .obj or .off")
        write_file(target, new_mesh(suffix, cloud.points, faces), overwrite)
    else:
        write_cloud(target, cloud.points, like=cloud, overwrite=overwrite)
    surface = f", {len(faces):,} triangles" if faces is not None else ""
    click.echo(f"{target}: {len(cloud.points):,} points{surface}")


def _convert_cameras(chosen: ConvertOptions) -> None:
    from ..io.cameras import CameraRecord, camera_text, form_of, read_partial_cameras
    from ..io.cameras.write_others import colmap_texts, folder_of, transforms_text
    from ..io.views import with_intrinsics

    source, target, overwrite = chosen.source, chosen.target, chosen.overwrite
    views, source_format = read_partial_cameras(source, chosen.camera_format, chosen.object_id)
    if chosen.intrinsics is not None:
        lenses, _ = read_partial_cameras(chosen.intrinsics)
        views = [
            with_intrinsics(
                view, lenses, chosen.intrinsics, view.mask or view.image or Path(view.label)
            )
            for view in views
        ]
    cameras = [_complete(view, source, chosen.size) for view in views]
    if chosen.to != "colmap":
        options.require_output(target, ".json", overwrite)
    folder = target if chosen.to == "colmap" else target.parent
    rows = [
        (_picture(view, number, folder), camera, view.distortion)
        for number, (view, camera) in enumerate(zip(views, cameras, strict=True))
    ]
    if chosen.to == "colmap":
        folder = folder_of(target, overwrite)
        with prefixed(f"{source}: "):
            texts = colmap_texts(rows)
        folder.mkdir(exist_ok=True)
        for name, text in texts.items():
            write_file(folder / name, text.encode(errors="surrogateescape"), overwrite=True)
    elif chosen.to == "transforms":
        with prefixed(f"{source}: "):
            text = transforms_text(rows)
        write_file(target, text.encode(), overwrite)
    else:
        if any(view.distortion and not view.distortion.none for view in views):
            raise InputError(
                f"{source}: has lens distortion, which tso's own format has no place for; use "
                f"{source} itself, or --to colmap"
            )
        records = [
            CameraRecord(camera, view.mask, view.image)
            for camera, view in zip(cameras, views, strict=True)
        ]
        write_file(target, camera_text(target, records).encode(), overwrite)
    count = f"{len(views)} camera{'s' if len(views) > 1 else ''}"
    click.echo(f"{target}: {count} of {source} ({form_of(source_format)})")


def _picture(view: PartialCamera, number: int, folder: Path) -> str:
    """The path of a view's picture, relative to ``folder``; else a name that a file may have."""
    from ..io.reading import is_there

    file = view.image or view.mask
    if view.names and (file is None or not is_there(file)):
        name = view.names[0].replace("\\", "/")
        return name if PICTURE.search(name) else re.sub(r"[^\w.-]+", "_", name) + ".png"
    if file is None:
        return f"view_{number}.png"
    return Path(os.path.relpath(os.path.realpath(file), os.path.realpath(folder))).as_posix()


def _complete(view: PartialCamera, source: Path, size: tuple[int, int] | None) -> Camera:
    from ..io.cameras import same_shape
    from ..io.reading import plain

    where = f"{source}: {plain(view.title)}" if view.title else str(source)
    if size and view.size and not same_shape(view.size, size):
        raise InputError(
            f"{where}: is for a picture of {view.size[0]}x{view.size[1]}, found --size "
            f"{size[0]}x{size[1]}, expected the same proportions; leave --size out"
        )
    if view.intrinsics is None or view.R is None:
        fault = "a pose but no focal length" if view.intrinsics is None else "K but no pose"
        raise InputError(
            f"{where}: has {fault}, expected both, in one file, or poses and --intrinsics "
            "FILE with K"
        )
    sides = size or view.size
    if sides is None:
        view_of = f"{view.title} " if view.title else ""
        raise InputError(
            f"{source}: {view_of}does not say the size of its picture, expected --size WIDTHxHEIGHT"
        )
    return view.camera(source, *sides)
