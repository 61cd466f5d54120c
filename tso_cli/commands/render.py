"""`tso render`: meshes -> images, masks, cameras and point clouds."""

from __future__ import annotations

import re
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from ..errors import InputError
from ..version import __version__
from . import options
from .options import PATH, choice, flag, option, output


class Size(click.ParamType):
    """``64`` or ``128x96`` (width x height)."""

    name = "pixels"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, int]:
        if isinstance(value, tuple):
            return value
        match = re.fullmatch(r"(\d{1,6})(?:x(\d{1,6}))?", str(value))
        if match is None:
            self.fail(
                f"{value!r} is not a size, expected pixels such as 64, "
                "or width x height such as 128x96",
                param,
                ctx,
            )
        return int(match[1]), int(match[2] or match[1])


class Count(click.ParamType):
    """``chair=100``."""

    name = "family=count"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, int]:
        family, _, number = str(value).partition("=")
        if family != "list" and not re.fullmatch(r"[1-9]\d{0,5}", number):
            self.fail(f"{value!r} is no family and number, expected such as chair=100", param, ctx)
        return family, int(number or 0)


def list_families(
    ctx: click.Context, param: click.Parameter, value: tuple[tuple[str, int], ...]
) -> dict[str, int]:
    """The families and their numbers; prints the names of all families for ``list``."""
    if not value:
        return {}
    from ..render.families import FAMILIES

    for family, _ in value:
        if family == "list":
            click.echo("\n".join(FAMILIES))
            ctx.exit()
        if family not in FAMILIES:
            raise InputError(
                f"--family {family}: is no family, expected one of {', '.join(FAMILIES)}"
            )
    return dict(value)


@click.command(
    "render",
    cls=options.Command,
    headings={"families": "Meshes", "views": "Images", "samples": "Points", "output": "Output"},
)
@click.argument("source", metavar="[MESH_OR_FOLDER]", required=False, type=PATH)
@option(
    "--family",
    "Render COUNT shapes of a family too, made by rule. May be repeated; `list` names all.",
    "families",
    type=Count(),
    multiple=True,
    metavar="NAME=COUNT",
    is_eager=True,
    callback=list_families,
)
@option("--split", "Render only the meshes that this split (.json) names.", type=PATH)
@choice("--part", "List of the split to render.", "train", "validation", "test")
@option(
    "--category",
    "Render only the meshes of this category, a folder of MESH_OR_FOLDER. May be repeated.",
    "categories",
    multiple=True,
    metavar="NAME",
)
@option("--copies", "Randomly warped copies to add of each mesh, for training.", default=0)
@flag("--paint", "Give the parts of each mesh random colours, for training.")
@option("--views", "Images of each mesh.", default=24)
@option("--size", "Size of the images: a side, or WIDTHxHEIGHT.", type=Size(), default="64")
@option(
    "--elevation",
    "Range of the camera's elevation, degrees.",
    type=float,
    nargs=2,
    metavar="FROM TO",
    default=(-5, 40),
)
@option(
    "--azimuth",
    "Range of the camera's azimuth, degrees. At 0 the camera looks from +z.",
    type=float,
    nargs=2,
    metavar="FROM TO",
    default=(0, 360),
)
@option("--samples", "Points to sample from the surface of each mesh.", default=16384)
@option("--points", "Points to keep of these samples as ground truth, evenly spread.", default=1024)
@output("Folder to write to, a subfolder for each mesh.", required=True)
@options.overwrite
@options.seed
@options.as_json
def command(source: Path | None, output: Path, seed: int, as_json: bool, **chosen: Any) -> None:
    """Render a mesh, or all meshes of a folder: images, masks, cameras and point clouds.

    Every mesh is centred and scaled to longest side 1. Textures are looked for in the folder of the
    mesh, and in MESH_OR_FOLDER with its subfolders. Views are random; the same seed gives the same
    views. After an interruption, run the same command again: it skips meshes that are rendered.
    """
    from ..datasets.splits import read_part
    from ..render import RenderSettings, render_folder
    from ..render.folder import named_meshes

    if source is None and not chosen["families"]:
        raise InputError("no MESH_OR_FOLDER, expected one (or --family)")
    settings = options.pick(RenderSettings, chosen)
    names = None if chosen["split"] is None else read_part(chosen["split"], chosen["part"])
    if source is not None and (categories := chosen["categories"]):
        names = names or list(named_meshes(source, output))
        names = [name for name in names if name.split("/")[0] in categories]
        if not names:
            raise InputError(f"{source}: has no mesh of {' or '.join(categories)}, expected some")
    summary = render_folder(
        source,
        output,
        settings,
        seed,
        chosen["overwrite"],
        options.ProgressBar("rendering"),
        names,
        chosen["families"],
    )
    for message in summary.failed.values():
        options.log(message)
    if summary.skipped:
        options.log(f"{len(summary.skipped)} rendered before, skipped (--overwrite renders again)")
    if as_json:
        options.echo_json(
            {**asdict(summary), "settings": asdict(settings), "seed": seed, "version": __version__}
        )
    else:
        width, height = settings.size
        click.echo(
            f"{len(summary.written)} objects rendered into {output} ({settings.views} views of "
            f"{width}x{height} and {settings.points} points of {settings.samples} each, "
            f"seed {seed})"
        )
    if summary.failed:
        raise InputError(
            f"{len(summary.failed)} meshes could not be rendered, all others are in {output}"
        )
