"""What commands that answer with a record share: where the answer goes, and how progress is shown."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from ...commands import options
from ...errors import InputError
from ...io.output import atomic_output, check_output, reason
from ...io.reading import read_bytes

output = click.option(
    "-o", "--output", type=options.FilePath(), help="Write the record here (.json), a chart (.png) and a page (.md) beside it."
)


def check_outputs(output: Path | None, overwrite: bool, resume: bool = False) -> None:
    """Refuse outputs that cannot be written before the long work starts; with ``resume`` they may be there."""
    if resume and output is None:
        raise InputError("--resume goes on from a record, expected its name after -o")
    if output is not None:
        if output.suffix.lower() != ".json":
            raise InputError(f"{output}: the suffix is {output.suffix!r}, expected .json (the chart goes beside it as .png)")
        for suffix in (".json", ".png", ".md"):
            check_output(output.with_suffix(suffix), overwrite or resume)


def earlier_record(study: str, output: Path | None, resume: bool) -> dict[str, Any] | None:
    """The record to resume, None where there is none or ``resume`` is false.

    Raises InputError if the file is no record, or one of ``study`` that another method made: the cases of two methods do not
    mix. A record of another study is for the study to refuse.
    """
    if output is None or not resume or not output.exists():
        return None
    from ..studies.fingerprint import differences

    record = read_record(output)
    try:
        changes = differences(record) if record.get("study") == study else []
    except (AttributeError, TypeError, ValueError) as error:
        raise InputError(f"{output}: its fingerprint is damaged ({reason(error)}), expected a record as it was kept") from None
    if changes:
        raise InputError(
            f"{output}: was made by another method ({changes[0]}), expected one made by the method as it is (with --overwrite "
            "in place of --resume it is made anew)"
        )
    return record


def read_record(path: Path) -> dict[str, Any]:
    """The record of a study; InputError if the file is none."""
    try:
        record = json.loads(read_bytes(path, "the record of a study"))
    except (ValueError, RecursionError):
        raise InputError(f"{path}: is not JSON, expected the record of a study") from None
    if not isinstance(record, dict):
        raise InputError(f"{path}: holds no JSON object, expected the record of a study")
    return record


def write_record(record: dict[str, Any], parts: Sequence[str], output: Path) -> None:
    """Write the record over the one before, a case a line, with ``parts`` of the fingerprint of the method as it is."""
    from ..studies.fingerprint import today

    record = {**record, "fingerprint": {part: today(part) for part in parts}}
    cases = record.pop("cases", None)
    text = json.dumps(record, indent=1)
    if cases is not None:
        lines = ",\n".join(json.dumps(case, separators=(",", ":")) for case in cases)
        text = f'{text[:-2]},\n "cases": [\n{lines}\n]}}'
    with atomic_output(output) as temporary:
        temporary.write_text(text + "\n")


class Reporter:
    """A progress bar for each part of the work."""

    def __init__(self) -> None:
        self._bar: options.ProgressBar | None = None

    def __call__(self, what: str, done: int, total: int) -> None:
        if self._bar is None or self._bar.label != f"tso: {what}":
            self._bar = options.ProgressBar(f"tso: {what}", delay=0.5)
        self._bar(done, total)
