"""`tso study`: parse, call, print."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from ..errors import InputError
from ..files.output import atomic_output, check_output
from . import options


@click.group("study")
def command() -> None:
    """Ask a question of the method, on many shapes, and keep the answer as JSON beside a chart."""


def _outputs(output: Path | None, overwrite: bool) -> None:
    """Refuse outputs that cannot be written before the long work starts."""
    if output is not None:
        if output.suffix.lower() != ".json":
            raise InputError(f"{output}: the suffix is {output.suffix!r}, expected .json (the chart goes beside it as .png)")
        for path in (output, output.with_suffix(".png")):
            check_output(path, overwrite)


def _keep(record: dict[str, Any], output: Path | None, draw: Callable[..., None], overwrite: bool) -> None:
    """Write the record and its chart, if they are wanted."""
    if output is not None:
        with atomic_output(output) as temporary:
            temporary.write_text(json.dumps(record, indent=1) + "\n")
        draw(output.with_suffix(".png"), record, overwrite)


class _Reporter:
    """A progress bar for each part of a study."""

    def __init__(self) -> None:
        self._bar: options.ProgressBar | None = None

    def __call__(self, what: str, done: int, total: int) -> None:
        if self._bar is None or self._bar.label != f"tso: {what}":
            self._bar = options.ProgressBar(f"tso: {what}", delay=0.5)
        self._bar(done, total)


@command.command("points")
@click.option("--meshes", type=options.FilePath(), required=True, help="Folder with a folder of meshes for each category.")
@click.option(
    "--category",
    "categories",
    multiple=True,
    type=click.Choice(["chair", "airplane", "car"]),
    help="May be repeated.  [default: all three]",
)
@click.option("--limit", type=click.IntRange(min=1), help="At most so many shapes of each category.")
@click.option("-o", "--output", type=options.FilePath(), help="Write the record here (.json) and a chart beside it (.png).")
@click.option("--steps", type=click.IntRange(min=0), default=50, show_default=True)
@click.option("--learning-rate", type=float, help="[default: 5e-4]")
@click.option("--gamma", type=float, help="[default: 1e6]")
@click.option("--sigma-sq", type=float, help="px^2 of the 64x64 mask.  [default: 0.4]")
@options.device
@options.seed
@options.overwrite
@options.as_json
def points(
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
    _outputs(output, overwrite)
    from ..refinement import RefineConfig
    from ..report.charts import draw_points_study
    from ..report.table import text_table
    from ..studies.points import study_points
    from ..studies.protocol import INITIAL_CHAMFER

    config = RefineConfig("points", steps, learning_rate, gamma, sigma_sq, device)
    chosen = categories or tuple(INITIAL_CHAMFER)
    record = study_points(meshes, config, chosen, seed, limit, _Reporter())
    _keep(record, output, draw_points_study, overwrite)
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


@command.command("examples")
@click.option("--checkpoint", type=options.FilePath(), help="View-aligned network; adds the two network modes.")
@click.option("-o", "--output", type=options.FilePath(), help="Write the record here (.json) and a chart beside it (.png).")
@options.overwrite
@options.as_json
def examples(checkpoint: Path | None, output: Path | None, overwrite: bool, as_json: bool) -> None:
    """The shipped examples: IoU, Chamfer and time of every mode with the paper's settings."""
    _outputs(output, overwrite)
    from ..report.charts import draw_examples_study
    from ..report.table import text_table
    from ..studies.examples import study_examples

    record = study_examples(checkpoint, _Reporter())
    _keep(record, output, draw_examples_study, overwrite)
    if as_json:
        options.echo_json(record)
        return
    rows = [
        [
            r["example"],
            r["mode"],
            r["iou_before"],
            r["iou_after"],
            1e3 * r["chamfer_before"],
            1e3 * r["chamfer_after"],
            r["ratio"],
            r["seconds"],
        ]
        for r in record["examples"]
    ]
    click.echo(text_table(["example", "mode", "IoU before", "after", "Chamfer before", "after", "ratio", "seconds"], rows))
    for name, meaning in record["convention"].items():
        click.echo(f"{name}: {meaning}" + (", x1000" if name == "chamfer" else ""))
