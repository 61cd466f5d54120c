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


@click.command(
    "render",
    cls=options.Command,
    headings={"split": "Meshes", "views": "Images", "samples": "Points", "output": "Output"},
)
@click.argument("source", metavar="MESH_OR_FOLDER", type=PATH)
@option("--split", "Render only the meshes that this split (.json) names.", type=PATH)
@choice("--part", "List of the split to render.", "train", "validation", "test")
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
def command(source: Path, output: Path, seed: int, as_json: bool, **chosen: Any) -> None:
    """Render a mesh, or all meshes of a folder: images, masks, cameras and point clouds.

    Every mesh is centred and scaled to longest side 1. Textures are looked for in the folder of the
    mesh, and in MESH_OR_FOLDER with its subfolders. Views are random; the same seed gives the same
    views. After an interruption, run the same command again: it skips meshes that are rendered.
    """
    from ..datasets.splits import read_part
    from ..render import RenderSettings, render_folder

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
            f"{len(summary.written)} objects rendered into {output} ({settings.views} views of "
            f"{width}x{height} and {settings.points} points of {settings.samples} each, "
            f"seed {seed})"
        )
    if summary.failed:
        raise InputError(
            f"{len(summary.failed)} meshes could not be rendered, all others are in {output}"
        )
