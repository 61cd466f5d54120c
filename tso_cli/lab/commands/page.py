"""`tso lab page`: records shown."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import click

from ...commands import options
from ...errors import InputError
from ...io.output import atomic_output
from ...io.reading import shown
from ..studies import QUESTIONS
from ..study import Record, Shown, page
from .records import read_record

BENCHES = {"speed": "bench.study", "stability": "stability.study"}


def load(name: str) -> Any:
    """The `Study` of that name, or what shows the record of `tso bench speed`."""
    return import_module(f"tso_cli.lab.{BENCHES.get(name) or f'studies.{QUESTIONS[name][0]}'}").STUDY


def write_page(study: Shown, record: Record, output: Path) -> None:
    """The chart and the page of the record at ``output``, beside it."""
    study.draw(output.with_suffix(".png"), record, True)
    with atomic_output(output.with_suffix(".md")) as temporary:
        more = sorted(path.name for path in output.parent.glob(f"{output.stem}.*.png"))
        temporary.write_text(page(study, record, output.name, more))


@click.command("page")
@click.argument("records", nargs=-1, required=True, type=options.FilePath())
def command(records: tuple[Path, ...]) -> None:
    """Write the pages and charts of RECORDS anew, beside them, and run nothing."""
    for path in records:
        record = read_record(path)
        name = record.get("study", record.get("bench"))
        if name not in (*QUESTIONS, *BENCHES):
            raise InputError(f"{path}: is of the study {shown(name)}, expected one of {', '.join((*QUESTIONS, *BENCHES))}")
        if not record.get("complete", True):
            raise InputError(f"{path}: is not complete, expected a finished record (--resume finishes it)")
        write_page(load(name), record, path)
        click.echo(path.with_suffix(".md"))
