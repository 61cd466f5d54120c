"""`tso refine`: the command; `RefineRun` does the work."""

from __future__ import annotations

from pathlib import Path

import click

from .. import options
from .options import RefineOptions


def _config(ctx: click.Context, parameter: click.Parameter, path: Path | None) -> None:
    if path is not None and not ctx.resilient_parsing:
        from .record import read_config

        read_config(ctx, path)


CONFIG = click.Option(
    ["--config"],
    type=options.PATH,
    is_eager=True,
    expose_value=False,
    callback=_config,
    help="Options from a file, unless they are given here: a record of --record, or TOML or JSON.",
)


@options.command("refine", RefineOptions, CONFIG)
def command(ctx: click.Context, chosen: RefineOptions) -> None:
    """Make a point cloud agree with masks and write the refined cloud.

    \b
    tso refine CLOUD MASK
    tso refine CLOUD MASK MASK ... --camera FILE
    tso refine CLOUD --camera FILE
    tso refine --mode MODE IMAGE MASK [--checkpoint FILE]

    A mask gets the view whose picture has its name, else views and masks are taken in their order.
    Without any MASK, all masks that the file names are used.

    A .ply, .glb, .gltf or .obj file comes out with other coordinates; all other attributes stay. A
    large cloud, or the surface of a mesh, moves by 1,024 control points; all other points follow.
    """
    warned = ctx.with_resource(options.Warnings(chosen.quiet)).texts
    with options.loading():
        from .run import RefineRun
    if options.CONFIG in ctx.meta:
        from .record import warn_of_changes

        warn_of_changes(ctx, chosen)
    typed = options.given(ctx, click.core.ParameterSource.DEFAULT_MAP)
    config = ["--config", str(ctx.meta[options.CONFIG])] if options.CONFIG in ctx.meta else []
    line = options.command_line("refine", RefineOptions, typed, *config)
    run = RefineRun(chosen, options.given(ctx), warned, line)
    ctx.exit(run.check() if chosen.check else run.refine())
