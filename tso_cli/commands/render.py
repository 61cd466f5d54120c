"""`tso render`: meshes -> pictures, masks, cameras and ground truth."""

from __future__ import annotations

import re
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from ..datasets.splits import read_part
from ..errors import InputError
from ..render import RenderSettings, render_folder
from ..version import __version__
from . import options


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
                f"{value!r} is not a size, expected pixels such as 64, or width x height such as 128x96",
                param,
                ctx,
            )
        return int(match[1]), int(match[2] or match[1])


@click.command(
    "render",
    cls=options.Command,
    headings={"split": "Meshes", "views": "Pictures", "samples": "Points", "output": "Output"},
)
@click.argument("source", metavar="MESH_OR_FOLDER", type=options.FilePath())
@click.option(
    "--split", type=options.FilePath(), help="Render only the meshes that this split names; .json."
)
@click.option(
    "--part",
    type=click.Choice(["train", "validation", "test"]),
    default="train",
    help="Which list of the split.",
)
@click.option(
    "--copies",
    type=int,
    default=0,
    help="Add so many randomly warped copies of each mesh, for training.",
)
@click.option(
    "--paint", is_flag=True, help="Random colours on the parts of each mesh, for training."
)
@click.option("--views", type=int, default=24, help="Pictures of each object.")
@click.option("--size", type=Size(), default="64", help="Pixels, or WIDTHxHEIGHT.")
@click.option("--elevation", type=float, nargs=2, default=(-5, 40), help="Range in degrees.")
@click.option(
    "--azimuth", type=float, nargs=2, default=(0, 360), help="Range in degrees; 0 looks from +z."
)
@click.option("--samples", type=int, default=16384, help="Points sampled from the surface.")
@click.option("--points", type=int, default=1024, help="How many of them the target keeps.")
@click.option(
    "-o", "--output", type=options.FilePath(), required=True, help="Folder to write NAME/... into."
)
@options.overwrite
@options.seed
@options.as_json
def command(source: Path, output: Path, seed: int, as_json: bool, **chosen: Any) -> None:
    """Render a mesh, or all meshes of a folder: pictures, masks, cameras and ground truth.

    Every mesh is centred and scaled to longest side 1. Textures are read from its folder, the rendered folder and those below.
    Views are random, reproducible from the seed. Started again after an interruption, the command skips what is rendered.
    """
    settings = options.pick(RenderSettings, chosen)
    names = None if chosen["split"] is None else read_part(chosen["split"], chosen["part"])
    summary = render_folder(
        source, output, settings, seed, chosen["overwrite"], options.ProgressBar("rendering"), names
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
            f"{len(summary.written)} objects rendered into {output} ({settings.views} views of {width}x{height} and "
            f"{settings.points} points of {settings.samples} each, seed {seed})"
        )
    if summary.failed:
        raise InputError(
            f"{len(summary.failed)} meshes could not be rendered, all others are in {output}"
        )
