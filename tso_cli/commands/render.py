"""`tso render`: meshes -> images, masks, cameras and point clouds."""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import click

from ..errors import InputError
from ..option import opt
from ..render.settings import RenderSettings
from ..version import __version__
from . import options


class Count(click.ParamType):
    """``chair=100``."""

    name = "family=count"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        family, _, number = str(value).partition("=")
        if value != "list" and not re.fullmatch(r"[1-9]\d{0,5}", number):
            self.fail(f"{value!r} is no family and number, expected such as chair=100", param, ctx)
        return value if value == "list" else (family, int(number))


def _families() -> dict[str, str]:
    """The table that `--family list` prints."""
    from ..render.families import FAMILIES

    return dict.fromkeys(FAMILIES, "")


@dataclass(frozen=True, kw_only=True)
class RenderOptions(RenderSettings):
    """What `tso render` may be given; InputError for options that do not go together.

    source : A mesh, or a folder of meshes.
    families : Render COUNT shapes of a family too, made by rule. May be repeated; `list` names all.
    split : Render only the meshes that this split (.json) names.
    part : List of the split to render.
    categories : Render only the meshes of this category, a folder of MESH_OR_FOLDER. May be
        repeated.
    output : Folder to write to, a subfolder for each mesh.
    """

    source: Path | None = opt(None, role="argument", metavar="[MESH_OR_FOLDER]")
    families: tuple[Any, ...] = opt(
        (),
        heading="Meshes",
        names=("family",),
        metavar="NAME=COUNT",
        parser=Count(),
        table=_families,
    )
    split: Path | None = opt(None)
    part: Literal["train", "validation", "test"] = opt("train", needs=("split",))
    categories: tuple[str, ...] = opt((), names=("category",), metavar="NAME")
    output: Path = opt(options.REQUIRED, heading="Output", names=("-o", "output"))
    overwrite: bool = options.overwrite()
    seed: int = options.seed()
    as_json: bool = options.as_json()

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.source is None and not self.families:
            raise InputError("no MESH_OR_FOLDER, expected one (or --family)")
        if self.families:
            from ..render.families import FAMILIES

            for family, _ in self.families:
                if family not in FAMILIES:
                    raise InputError(
                        f"--family {family}: is no family, expected one of {', '.join(FAMILIES)}"
                    )


@options.command("render", RenderOptions)
def command(ctx: click.Context, chosen: RenderOptions) -> None:
    """Render a mesh, or all meshes of a folder: images, masks, cameras and point clouds.

    Every mesh is centred and scaled to longest side 1. Textures are looked for in the folder of the
    mesh, and in MESH_OR_FOLDER with its subfolders. Views are random; the same seed gives the same
    views. After an interruption, run the same command again: it skips meshes that are rendered.
    """
    render_meshes(chosen)


def render_meshes(chosen: RenderOptions) -> None:
    """Render, and print what was rendered."""
    from ..datasets.splits import read_part
    from ..render.folder import named_meshes, render_folder

    source, output = chosen.source, chosen.output
    settings = options.pick(RenderSettings, vars(chosen))
    names = None if chosen.split is None else read_part(chosen.split, chosen.part)
    if source is not None and (categories := chosen.categories):
        names = names or list(named_meshes(source, output))
        names = [name for name in names if name.split("/")[0] in categories]
        if not names:
            raise InputError(f"{source}: has no mesh of {' or '.join(categories)}, expected some")
    summary = render_folder(
        source,
        output,
        settings,
        chosen.seed,
        chosen.overwrite,
        options.ProgressBar("rendering"),
        names,
        dict(chosen.families),
    )
    for message in summary.failed.values():
        options.log(message)
    if summary.skipped:
        options.log(f"{len(summary.skipped)} rendered before, skipped (--overwrite renders again)")
    if chosen.as_json:
        about = {"settings": asdict(settings), "seed": chosen.seed, "version": __version__}
        options.echo_json({**asdict(summary), **about})
    else:
        width, height = settings.size
        click.echo(
            f"{len(summary.written)} objects rendered into {output} ({settings.views} views of "
            f"{width}x{height} and {settings.points} points of {settings.samples} each, "
            f"seed {chosen.seed})"
        )
    if summary.failed:
        raise InputError(
            f"{len(summary.failed)} meshes could not be rendered, all others are in {output}"
        )
