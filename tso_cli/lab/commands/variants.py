"""`tso lab tso`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ...commands import options
from ...io.shipped import CATEGORIES, DEFAULT, named_checkpoint
from .records import Reporter, answer, check_outputs, earlier_record, keep, resume, so_far


@click.command("tso")
@click.option("--meshes", type=options.FilePath(), required=True, help="Folder with CATEGORY/NAME for every name of the split.")
@click.option("--checkpoint", type=options.FilePath(), default=DEFAULT, show_default=True, help="View-aligned network.")
@click.option(
    "--split",
    "split_file",
    type=options.FilePath(),
    help="JSON file, or a folder of lists.  [default: that of the shipped network]",
)
@click.option("--part", type=click.Choice(["test", "validation"]), default="test", show_default=True)
@click.option("--category", "categories", multiple=True, help="May be repeated.  [default: 3, or all of --split]")
@click.option("--limit", type=click.IntRange(min=1), help="At most so many shapes of each category.")
@click.option("--views", type=click.IntRange(min=1), default=4, show_default=True, help="Random views of each shape.")
@answer
@resume("after every shape")
@click.option("--steps", type=click.IntRange(min=0), default=50, show_default=True)
@options.device
@options.seed
@options.overwrite
@options.as_json
def command(
    meshes: Path,
    checkpoint: Path,
    split_file: Path | None,
    part: str,
    categories: tuple[str, ...],
    limit: int | None,
    views: int,
    output: Path | None,
    resume: bool,
    steps: int,
    device: str,
    seed: int,
    overwrite: bool,
    as_json: bool,
) -> None:
    """The paper's table of test-stage optimisation, on shapes that the network never saw.

    The network predicts each view of each shape; the prediction is judged before and after moving the encoder (E), the whole
    network (E and D) and the points (p), with the paper's settings. The record at -o is written after every shape; --resume
    goes on from it.
    """
    check_outputs(output, overwrite, resume)
    checkpoint = named_checkpoint(checkpoint)
    options.log(f"tso: checkpoint: {checkpoint}")
    from ..charts.variants_chart import draw_variants_study
    from ..studies.parts import SPLIT
    from ..studies.variants import VariantsConfig, study_variants

    chosen = categories or (() if split_file else CATEGORIES)
    config = VariantsConfig(part, chosen, limit, views, steps=steps, seed=seed, device=device)
    earlier = earlier_record("tso", output, resume)
    record = study_variants(meshes, checkpoint, config, split_file or SPLIT, earlier, so_far(output), Reporter())
    keep(record, output, draw_variants_study, overwrite or resume)
    if as_json:
        options.echo_json(record)
    else:
        _print(record)


def _print(record: dict[str, Any]) -> None:
    from ...plots.table import text_table
    from ..studies.variants_summary import LETTERS, VARIANTS

    summary, paper = record["summary"], record["paper"]
    rows: list[list[Any]] = []
    for name, theirs in paper.items():
        own = summary["all"]["capnet"][name]
        change = 100.0 * (own["ratio_of_means"] - 1.0) if name in VARIANTS else None
        rows.append(
            [LETTERS[name], *(1e3 * own[key] for key in ("forward", "backward", "chamfer")), change]
            + [*theirs, 100.0 * (theirs[2] / paper["before"][2] - 1.0) if name in VARIANTS else None]
        )
    header = ["", "forward", "backward", "Chamfer", "%", "paper's forward", "backward", "Chamfer", "%"]
    click.echo(text_table(header, rows, decimals=2))
    click.echo()
    rows = [
        [
            category,
            LETTERS[name],
            own["cases"],
            1e3 * own["capnet"]["before"]["chamfer"],
            1e3 * of["chamfer"],
            *(of[key] for key in ("ratio_of_means", "median_ratio", "worst_ratio", "worse")),
            own["plain"][name]["ratio_of_means"],
            of["visible_ratio"],
            of["occluded_ratio"],
            own["iou"]["before"],
            own["iou"][name],
            own["median_seconds"][name],
        ]
        for category, own in summary.items()
        for name in VARIANTS
        if (of := own["capnet"][name])
    ]
    header = ["category", "moves", "cases", "before", "after", "ratio", "median", "worst", "worse"]
    click.echo(text_table([*header, "plain", "visible", "occluded", "IoU before", "after", "s"], rows))
    click.echo("Chamfer x1000, the paper's protocol: squared distances, mean over points, each cloud scaled by its own box")
    click.echo(
        "ratio: after/before of the means; median, worst: of the cases' own; worse: cases over 1; plain: ratio without "
        "scaling; visible, occluded: ratio of the forward distance of the target's points that the view sees, and of the others"
    )
    click.echo()
    for claim in record["claims"]:
        click.echo(f"{'holds' if claim['holds'] else 'does not hold'}: {claim['claim']} ({claim['found']})")
