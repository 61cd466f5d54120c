"""`tso lab evidence`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from ...commands import options
from ...io.shipped import DEFAULT, named_checkpoint
from .records import Reporter, answer, check_outputs, earlier_record, keep, resume, so_far

QUESTIONS = ("framing", "depth", "colours", "missing", "wrong", "cameras", "placing", "rates", "meshes")
JUDGED = ("cases", "mean_ratio", "worst_ratio", "worse")
"""What the record has of every row; the rest is told of some."""


@click.command("evidence")
@click.option("--meshes", type=options.FilePath(), required=True, help="Folder with CATEGORY/NAME for every name of the split.")
@click.option("--checkpoint", type=options.FilePath(), default=DEFAULT, show_default=True, help="View-aligned network.")
@click.option("--split", "split_file", type=options.FilePath(), help="[default: that of the shipped network]")
@click.option("--part", type=click.Choice(["test", "validation"]), default="validation", show_default=True)
@click.option("--question", "questions", multiple=True, type=click.Choice(QUESTIONS), help="May be repeated.  [default: all]")
@click.option("--limit", type=click.IntRange(min=1), help="At most so many shapes of each category.")
@click.option("--views", type=click.IntRange(min=1), default=2, show_default=True, help="Random views of each shape.")
@answer
@resume("after every group of shapes")
@options.device
@options.seed
@options.overwrite
@options.as_json
def command(
    meshes: Path,
    checkpoint: Path,
    split_file: Path | None,
    part: str,
    questions: tuple[str, ...],
    limit: int | None,
    views: int,
    output: Path | None,
    resume: bool,
    device: str,
    seed: int,
    overwrite: bool,
    as_json: bool,
) -> None:
    """What other evidence than one right mask of the whole object is worth.

    Objects in larger photos (framing), depth maps (depth), photos of painted objects (colours), objects of which a part is
    missing (missing), wrong views among right ones (wrong), cameras that are off (cameras), predictions whose distance is not
    known (placing), the learning rates of the network's variants (rates), and starts that are meshes (meshes).
    """
    check_outputs(output, overwrite, resume)
    from ..charts.evidence_chart import draw_evidence_study
    from ..studies.evidence import EvidenceConfig, study_evidence
    from ..studies.evidence_questions import QUESTIONS as KNOWN
    from ..studies.parts import SPLIT

    wanted = tuple(dict.fromkeys(questions)) or QUESTIONS
    network = None
    if any("network" in KNOWN[name].kinds for name in wanted):
        network = named_checkpoint(checkpoint)
        options.log(f"tso: checkpoint: {network}")
    config = EvidenceConfig(wanted, part, limit, views, seed, device)
    earlier = earlier_record("evidence", output, resume)
    record = study_evidence(meshes, config, split_file or SPLIT, network, earlier, so_far(output), Reporter())
    keep(record, output, draw_evidence_study, overwrite or resume)
    if as_json:
        options.echo_json(record)
    else:
        _print(record)


def _print(record: dict[str, Any]) -> None:
    from ...plots.table import text_table

    for question, kinds in record["summary"].items():
        every = [
            (kind, category, row, own)
            for kind, categories in kinds.items()
            for category, found in categories.items()
            for row, own in found.items()
        ]
        # Not every row tells everything: of three views there is no fourth.
        told = dict.fromkeys(key for *_, own in every for key in own if key not in JUDGED)
        rows = [[*names, *(own.get(key) for key in (*JUDGED, *told))] for *names, own in every]
        click.echo(text_table(["kind", "category", question, "cases", "ratio", "worst", "worse", *told], rows))
        click.echo()
    settings = record["settings"]
    click.echo(
        f"ratio: Chamfer after/before, mean of the cases' own; worse: cases over 1; {settings['points']:,} points, masks of "
        f"{settings['size']}x{settings['size']}"
    )
