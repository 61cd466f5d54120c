"""`tso lab pose`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ...commands import options
from .records import Reporter, answer, check_outputs, earlier_record, keep, resume, so_far


@click.command("pose")
@click.option("--meshes", type=options.FilePath(), required=True, help="Folder with CATEGORY/NAME for every name of the split.")
@click.option("--split", "split_file", type=options.FilePath(), help="[default: that of the shipped network]")
@click.option("--part", type=click.Choice(["test", "validation"]), default="validation", show_default=True)
@click.option("--limit", type=click.IntRange(min=1), help="At most so many shapes of each category.")
@click.option("--views", type=click.IntRange(min=1), default=2, show_default=True, help="Random views of each shape.")
@answer
@resume("after every shape")
@options.seed
@options.overwrite
@options.as_json
def command(
    meshes: Path,
    split_file: Path | None,
    part: str,
    limit: int | None,
    views: int,
    output: Path | None,
    resume: bool,
    seed: int,
    overwrite: bool,
    as_json: bool,
) -> None:
    """How well `tso refine --camera fit` finds a camera: of the true cloud, and of other shapes' clouds."""
    check_outputs(output, overwrite, resume)
    from ..charts.pose_chart import draw_pose_study
    from ..studies.parts import SPLIT
    from ..studies.pose import PoseConfig, study_pose

    config = PoseConfig(part, limit, views, seed)
    earlier = earlier_record("pose", output, resume)
    record = study_pose(meshes, config, split_file or SPLIT, earlier, so_far(output), Reporter())
    keep(record, output, draw_pose_study, overwrite or resume)
    if as_json:
        options.echo_json(record)
    else:
        _print(record)


def _print(record: dict[str, Any]) -> None:
    from ...plots.table import text_table

    header = [
        "cloud",
        "cases",
        "median degrees",
        "within 15",
        "or mirrored in depth",
        "one of the answers",
        "sure",
        "of them right",
    ]
    rows = [[name, *own.values()] for name, own in record["summary"].items()]
    click.echo(text_table([*header, "shortest focal / true", "longest", "s"], rows))
