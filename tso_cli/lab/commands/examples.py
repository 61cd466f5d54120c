"""`tso lab examples`."""

from __future__ import annotations

from pathlib import Path

import click

from ...commands import options
from ...io.shipped import named_checkpoint
from .records import Reporter, answer, check_outputs, keep


@click.command("examples")
@click.option(
    "--checkpoint",
    type=options.FilePath(),
    help="View-aligned network, or `default`, the shipped one; adds the two network modes.",
)
@answer
@options.overwrite
@options.as_json
def command(checkpoint: Path | None, output: Path | None, overwrite: bool, as_json: bool) -> None:
    """The shipped examples: IoU, Chamfer and time of every mode with the paper's settings."""
    check_outputs(output, overwrite)
    if checkpoint is not None:
        checkpoint = named_checkpoint(checkpoint)
        options.log(f"tso: checkpoint: {checkpoint}")
    from ...plots.table import text_table
    from ..charts.charts import draw_examples_study
    from ..studies.examples import study_examples

    record = study_examples(checkpoint, Reporter())
    keep(record, output, draw_examples_study, overwrite)
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
