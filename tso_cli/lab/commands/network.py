"""`tso lab network`."""

from __future__ import annotations

from pathlib import Path

import click

from ...commands import options
from .records import Reporter, answer, check_outputs, keep


@click.command("network")
@click.option("--meshes", type=options.FilePath(), required=True, help="Folder with CATEGORY/NAME for every name of the split.")
@click.option("--split", "split_file", type=options.FilePath(), help="JSON file.  [default: that of the shipped network]")
@click.option("--checkpoint", type=options.FilePath(), default=Path("default"), show_default=True, help="View-aligned network.")
@click.option("--category", "categories", multiple=True, help="May be repeated.  [default: chair, car, airplane]")
@answer
@options.seed
@options.overwrite
@options.as_json
def command(
    meshes: Path,
    split_file: Path | None,
    checkpoint: Path,
    categories: tuple[str, ...],
    output: Path | None,
    seed: int,
    overwrite: bool,
    as_json: bool,
) -> None:
    """The base network on unseen shapes, beside the mean training shape and the nearest training shape."""
    check_outputs(output, overwrite)
    from ...io.shipped import CATEGORIES, named_checkpoint
    from ...plots.table import text_table
    from ..charts.network_chart import LABELS, draw_network_study
    from ..studies.material import Source
    from ..studies.network import study_network
    from ..studies.parts import SPLIT

    source = Source(meshes, split_file or SPLIT, seed=seed, categories=categories or CATEGORIES)
    record = study_network(named_checkpoint(checkpoint), source, Reporter())
    keep(record, output, draw_network_study, overwrite)
    if as_json:
        options.echo_json(record)
        return
    rows = [
        [part, category, own["shapes"], *(1e3 * own[name] for name in LABELS), own["over_mean_view"], own["over_nearest"]]
        for part, categories_of in record["summary"].items()
        for category, own in categories_of.items()
    ]
    click.echo(text_table(["part", "category", "shapes", *LABELS.values(), "/ mean, view", "/ nearest"], rows))
    click.echo(f"Chamfer x1000: {record['convention']}; mean over shapes and views, seed {seed}, cpu")
