"""`tso lab accuracy`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ...commands import options
from ...io.output import check_output
from ...io.shipped import DEFAULT, named_checkpoint
from .records import Reporter, answer, check_outputs, earlier_record, keep, resume, so_far


@click.command("accuracy")
@click.option("--meshes", type=options.FilePath(), required=True, help="Folder with CATEGORY/NAME for every name of the split.")
@click.option("--checkpoint", type=options.FilePath(), default=DEFAULT, show_default=True, help="View-aligned network.")
@click.option("--split", "split_file", type=options.FilePath(), help="[default: that of the shipped network]")
@click.option("--part", type=click.Choice(["test", "validation", "train"]), default="test", show_default=True)
@click.option("--category", "categories", multiple=True, help="May be repeated.  [default: all five]")
@click.option("--limit", type=click.IntRange(min=1), help="At most so many shapes of each category.")
@click.option(
    "--kind",
    "kinds",
    multiple=True,
    type=click.Choice(["other", "near", "cut", "right", "network"]),
    help="Where the starts are from. May be repeated.  [default: all; with --part train all but network; with --ablation "
    "all but right]",
)
@click.option("--views", type=click.IntRange(min=1), default=2, show_default=True, help="Random views of each shape.")
@click.option("--size", type=click.IntRange(16, 1024), default=64, show_default=True, help="Of the masks, pixels each way.")
@click.option("--points", type=int, default=1024, show_default=True, help="Of initial and target clouds, 1024 to 16384.")
@click.option("--ablation", is_flag=True, help="Change one ingredient of the default preset at a time.")
@answer
@resume("after every group of shapes")
@click.option(
    "--pictures", type=options.FilePath(), help="Draw the worst, the median and the best case of each category here (.png)."
)
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
    kinds: tuple[str, ...],
    views: int,
    size: int,
    points: int,
    ablation: bool,
    output: Path | None,
    resume: bool,
    pictures: Path | None,
    device: str,
    seed: int,
    overwrite: bool,
    as_json: bool,
) -> None:
    """How much nearer to the truth a refinement comes, and how often it leads away from it.

    Starts are another shape's cloud as wrong as a trained network's (other), one near the truth (near), the first with an
    object that the border cuts (cut), the truth sampled once more (right), and the network's prediction (network). The
    record at -o is written after every group of shapes; --resume goes on from it.
    """
    check_outputs(output, overwrite, resume)
    if pictures is not None:
        check_output(pictures, overwrite or resume)
    from ..charts.accuracy_chart import draw_accuracy_study
    from ..studies.accuracy import CATEGORIES, AccuracyConfig, study_accuracy
    from ..studies.parts import SPLIT

    chosen = tuple(dict.fromkeys(categories)) or CATEGORIES
    config = AccuracyConfig(part, chosen, limit, tuple(dict.fromkeys(kinds)), views, size, points, ablation, seed, device)
    network = None
    if "network" in config.kinds:
        network = named_checkpoint(checkpoint)
        options.log(f"tso: checkpoint: {network}")
    earlier = earlier_record("accuracy", output, resume)
    split_file = split_file or SPLIT
    record = study_accuracy(meshes, config, split_file, network, earlier, so_far(output), Reporter())
    keep(record, output, draw_accuracy_study, overwrite or resume)
    if pictures is not None:
        from ..charts.accuracy_pictures import draw_cases
        from ..studies.accuracy_examples import telling_cases

        draw_cases(pictures, telling_cases(record, meshes, config, split_file, network), overwrite or resume)
    if as_json:
        options.echo_json(record)
    else:
        _print(record)


def _print(record: dict[str, Any]) -> None:
    from ...plots.table import text_table

    rows = [
        [
            kind,
            category,
            name,
            1e3 * group["before"]["chamfer"],
            1e3 * own["chamfer"],
            *(own[key] for key in ("mean_ratio", "median_ratio", "worst_ratio", "worse", "worse_by_5")),
            own["chamfer_excess"],
            own["dense_ratio"],
            *(of[key] for key in ("f_score", "emd") for of in (group["before"], own)),
            own["iou_before"],
            own["iou"],
            own["median_seconds"],
            own["batch_seconds"],
        ]
        for kind, categories in record["summary"].items()
        for category, group in categories.items()
        for name, own in group["variants"].items()
    ]
    header = [
        "kind",
        "category",
        "variant",
        "before",
        "after",
        "ratio",
        "median",
        "worst",
        "worse",
        "by 5 %",
        "excess",
        "dense",
    ]
    click.echo(text_table([*header, "F", "after", "EMD", "after", "IoU", "after", "s", "in a batch"], rows))
    click.echo("before, after: Chamfer x1000: squared distances, mean over points, both directions, longest side 1")
    click.echo(
        "ratio: after/before, mean of the cases' own; worse, by 5 %: cases over 1 and over 1.05; excess: ratio of the means "
        "less the floor that another sampling of the truth has; dense: ratio by 16,384 target points; s: median seconds a case"
    )
    bounds = [
        [kind, category, group["cases"], *(group["before"].get(f"{bound}_ratio") for bound in ("floor", "in_plane"))]
        for kind, categories in record["summary"].items()
        for category, group in categories.items()
    ]
    click.echo()
    click.echo(text_table(["kind", "category", "cases", "floor / before", "all but depth right / before"], bounds))
    click.echo()
    for claim in record["claims"]:
        click.echo(f"{'holds' if claim['holds'] else 'does not hold'}: {claim['claim']} ({claim['found']})")
