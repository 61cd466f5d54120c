"""`tso lab sigma`."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import click

from ...commands import options
from .records import Reporter, answer, check_outputs, keep


@click.command("sigma")
@click.option("--meshes", type=options.FilePath(), required=True, help="Folder with CATEGORY/NAME for every name of the split.")
@click.option(
    "--split",
    "split_file",
    type=options.FilePath(),
    help="JSON file, or a folder of lists.  [default: that of the shipped network]",
)
@click.option("--part", type=click.Choice(["test", "validation", "train"]), default="test", show_default=True)
@click.option("--category", "categories", multiple=True, help="May be repeated.  [default: 3, or all of --split]")
@click.option("--limit", type=click.IntRange(min=1), help="At most so many shapes of each category.")
@click.option("--views", type=click.IntRange(min=1), default=4, show_default=True, help="Random views of each shape.")
@answer
@options.seed
@options.overwrite
@options.as_json
def command(
    meshes: Path,
    split_file: Path | None,
    part: str,
    categories: tuple[str, ...],
    limit: int | None,
    views: int,
    output: Path | None,
    seed: int,
    overwrite: bool,
    as_json: bool,
) -> None:
    """How wide the Gaussian should be: sigma^2 against the error of the true cloud's silhouette.

    Each shape's true cloud of 1,024 points is projected at 64x64 and compared with the mask. The chart shows the projections
    of one shape of each category beside its mask.
    """
    check_outputs(output, overwrite)
    from ...io.shipped import CATEGORIES
    from ...plots.table import text_table
    from ..charts.sigma_chart import draw_sigma_study
    from ..studies.parts import SPLIT
    from ..studies.sigma import study_sigma

    chosen = categories or (() if split_file else CATEGORIES)
    record, maps = study_sigma(meshes, split_file or SPLIT, part, chosen, limit, views, seed=seed, report=Reporter())
    keep(record, output, partial(draw_sigma_study, maps=maps), overwrite)
    if as_json:
        options.echo_json(record)
        return
    summary = record["summary"]
    rows = [
        [f"{sigma_sq:g}", *(own["l1"][k] for own in summary.values())]
        for k, sigma_sq in enumerate(record["settings"]["sigma_sq"])
    ]
    click.echo(text_table(["sigma^2", *summary], rows, decimals=4))
    click.echo()
    rows = [
        [name, own["shapes"], f"{own['best']:g}", own["l1_at_best"], own["paper"] and f"{own['paper']:g}", own["l1_at_paper"]]
        for name, own in summary.items()
    ]
    click.echo(text_table(["category", "shapes", "best sigma^2", "error", "the paper's", "error there"], rows, decimals=4))
    click.echo(f"error: {record['convention']['l1']}; sigma^2 in {record['convention']['sigma_sq']}, 1,024 points")
    click.echo()
    for claim in record["claims"]:
        click.echo(f"{'holds' if claim['holds'] else 'does not hold'}: {claim['claim']} ({claim['found']})")
