"""`tso refine`: the command; `RefineRun` does the work."""

from __future__ import annotations

from pathlib import Path

import click

from ..options import CONFIG, PATH, Warnings, command_line, explicit_options, loading
from ..options import command as command_of
from .options import RefineOptions


def _config(ctx: click.Context, parameter: click.Parameter, path: Path | None) -> None:
    if path is not None and not ctx.resilient_parsing:
        from .record import read_config

        read_config(ctx, path)


CONFIG_OPTION = click.Option(
    ["--config"],
    type=PATH,
    is_eager=True,
    expose_value=False,
    callback=_config,
    help="Options from a file, unless they are given here: a record of --record, or TOML or JSON.",
)


@command_of("refine", RefineOptions, CONFIG_OPTION)
def command(ctx: click.Context, options: RefineOptions) -> None:
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
    messages = ctx.with_resource(Warnings(options.quiet)).texts
    with loading():
        from .run import RefineRun
    config: Path | None = ctx.meta.get(CONFIG)
    if config is not None:
        from .record import warn_of_changes

        warn_of_changes(ctx, options)
    typed = explicit_options(ctx, click.core.ParameterSource.DEFAULT_MAP)
    by_file = [] if config is None else ["--config", str(config)]
    line = command_line("refine", RefineOptions, typed, *by_file)
    run = RefineRun(options, explicit_options(ctx), messages, line, config)
    ctx.exit(run.check() if options.check else run.refine())
