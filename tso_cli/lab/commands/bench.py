"""`tso bench`: speed on this machine, accuracy against seconds, and how wrong the input may be."""

from __future__ import annotations

import math
import time
from pathlib import Path

import click

from ...commands import options
from ...commands.options import LazyGroup
from ..bench import PARTS
from . import records
from .tools import load

SPEED = "How fast commands, refinements and their parts are."
STUDIES = {
    "pareto": ("", "What accuracy costs in seconds, and what is worth it."),
    "budget": ("", "What `--budget auto` saves, and what that costs."),
    "stability": ("", "How wrong the input may be, and whether the tool says so."),
}


class _Bench(LazyGroup):
    """Those that are studies have the command of one."""

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        return records.command_of(load(cmd_name)) if cmd_name in STUDIES else self.commands.get(cmd_name)


@click.group("bench", cls=_Bench, sections={"Commands": {"speed": ("", SPEED), **STUDIES}})
def command() -> None:
    """Measure speed, accuracy or stability, and keep the answer as JSON beside a chart and a page."""


@command.command("speed")
@click.option("--only", multiple=True, type=click.Choice(list(PARTS)), help="May be repeated.  [default: all]")
@click.option(
    "--seconds",
    type=click.FloatRange(min=0.0, min_open=True),
    default=0.5,
    show_default=True,
    help="Measure each contestant about so long, and at least three times.",
)
@records.output_option
@options.seed
@options.overwrite
@options.as_json
def speed(only: tuple[str, ...], seconds: float, output: Path | None, seed: int, overwrite: bool, as_json: bool) -> None:
    """Commands, single objects, batches, kernels and training, beside other ways of doing the same.

    command: whole processes; object: `refine` with one to four views; parts: what it consists of; batch: many objects in one
    call, on one thread and on all cores; silhouette, chamfer: the kernels at growing sizes; training: images a second. All of
    it takes some ten minutes.

    Contestants for the same work take turns on the CPU. Other packages (chamferdist, pykeops, point_cloud_utils, pytorch3d)
    are measured where they are installed.
    """
    if not math.isfinite(seconds):
        raise click.BadParameter(f"{seconds} is no finite number.", param_hint="'--seconds'")
    records.check_outputs(output, overwrite)
    from ..bench.shown import STUDY
    from ..bench.speed import speed as measure
    from ..bench.timing import Setting
    from ..study import answer

    begun = time.monotonic()

    def report(name: str) -> None:
        options.log(f"tso: {time.monotonic() - begun:4.0f} s  {name}")

    record = measure(Setting(seconds, seed, report), only)
    if output is not None:
        records.write_record(record, STUDY.parts, output)
        records.write_page(STUDY, record, output)
    if as_json:
        options.echo_json(record)
    else:
        click.echo(answer(STUDY, record))
