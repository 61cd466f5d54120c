"""`tso lab points`."""

from __future__ import annotations

from pathlib import Path

import click

from ...commands import options
from .records import Reporter, answer, check_outputs, keep


@click.command("points")
@click.option("--meshes", type=options.FilePath(), required=True, help="Folder with a folder of meshes for each category.")
@click.option(
    "--category",
    "categories",
    multiple=True,
    type=click.Choice(["chair", "airplane", "car"]),
    help="May be repeated.  [default: all three]",
)
@click.option("--limit", type=click.IntRange(min=1), help="At most so many shapes of each category.")
@answer
@click.option("--steps", type=click.IntRange(min=0), default=50, show_default=True)
@click.option("--learning-rate", type=float, help="[default: 5e-4]")
@click.option("--gamma", type=float, help="[default: 1e6]")
@click.option("--sigma-sq", type=float, help="px^2 of the 64x64 mask.  [default: 0.4]")
@options.device
@options.seed
@options.overwrite
@options.as_json
def command(
    meshes: Path,
    categories: tuple[str, ...],
    limit: int | None,
    output: Path | None,
    steps: int,
    learning_rate: float | None,
    gamma: float | None,
    sigma_sq: float | None,
    device: str,
    seed: int,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Points mode on real shapes: start from another shape's cloud, see one 64x64 mask, be judged by Chamfer to the truth."""
    check_outputs(output, overwrite)
    from ...plots.table import text_table
    from ...refinement import RefineConfig
    from ..charts.charts import draw_points_study
    from ..studies.points import study_points
    from ..studies.protocol import INITIAL_CHAMFER

    config = RefineConfig("points", steps, learning_rate, gamma, sigma_sq, device, preset="paper")
    chosen = categories or tuple(INITIAL_CHAMFER)
    record = study_points(meshes, config, chosen, seed, limit, Reporter())
    keep(record, output, draw_points_study, overwrite)
    if as_json:
        options.echo_json(record)
        return
    rows = [
        [
            category,
            s["cases"],
            1e3 * s["chamfer_before"],
            1e3 * s["chamfer_after"],
            s["ratio_of_means"],
            s["mean_ratio"],
            s["worst_ratio"],
            s["worse"],
            s["iou_before"],
            s["iou_after"],
            s["median_seconds"],
        ]
        for category, s in record["summary"].items()
    ]
    header = [
        "category",
        "cases",
        "before",
        "after",
        "after/before",
        "mean ratio",
        "worst",
        "worse",
        "IoU before",
        "after",
        "s",
    ]
    click.echo(text_table(header, rows))
    click.echo(f"Chamfer x1000: {record['convention']}")
    click.echo(
        "after/before: of the means; mean ratio, worst: of the cases' own; worse: cases over 1; s: median seconds a case"
    )
