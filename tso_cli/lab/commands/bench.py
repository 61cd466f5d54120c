"""`tso bench`: speed on this machine."""

from __future__ import annotations

import math
import os
import time
from pathlib import Path

import click

from ...commands import options
from . import records
from .page import write_page

PARTS = ("silhouette", "chamfer", "terms", "step", "batch", "threads", "training", "start-up")


@click.group("bench")
def command() -> None:
    """Measure this machine, and keep the answer as JSON beside a chart and a page."""


@command.command("speed")
@click.option("--only", multiple=True, type=click.Choice(PARTS), help="May be repeated.  [default: all]")
@click.option("--full", is_flag=True, help="Large sizes too: up to 1,000,000 points at 1,024x1,024.")
@click.option("--threads", type=click.IntRange(1, os.cpu_count() or 1), default=1, show_default=True, help="CPU threads.")
@click.option(
    "--seconds",
    type=click.FloatRange(min=0.0, min_open=True),
    default=0.5,
    show_default=True,
    help="Measure each contestant about so long.",
)
@records.output
@options.device
@options.seed
@options.overwrite
@options.as_json
def speed(
    only: tuple[str, ...],
    full: bool,
    threads: int,
    seconds: float,
    output: Path | None,
    device: str,
    seed: int,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Kernels, losses, steps, batches, training and start-up, beside other ways of doing the same.

    All of it takes some five minutes, a quarter of an hour with --full; a part about one. silhouette, chamfer: the kernels at
    growing sizes; terms: each loss beside the projector; step: one step of every mode and its parts; batch: many clouds in one
    call; threads: the same on one thread and on all cores; training: images a second; start-up: whole processes.

    Contestants for the same work take turns in one process, on cpu or cuda. Other packages (chamferdist, pykeops,
    point_cloud_utils, pytorch3d, gsplat) are measured where they are installed.
    """
    if not math.isfinite(seconds):
        raise click.BadParameter(f"{seconds} is no finite number.", param_hint="'--seconds'")
    records.check_outputs(output, overwrite)
    from ...device import resolve
    from ..bench.speed import speed as measure
    from ..bench.study import STUDY
    from ..bench.timing import Setting
    from ..study import answer

    begun = time.monotonic()

    def report(name: str) -> None:
        options.log(f"tso: {time.monotonic() - begun:4.0f} s  {name}")

    record = measure(Setting(resolve(device), threads, seconds, full, seed, report), only)
    if output is not None:
        records.write_record(record, STUDY.parts, output)
        write_page(STUDY, record, output)
    if as_json:
        options.echo_json(record)
    else:
        click.echo(answer(STUDY, record))
