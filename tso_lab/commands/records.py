"""The command of every study: its options, where its record goes, and how progress is shown."""

from __future__ import annotations

import json
from importlib import import_module
from pathlib import Path
from typing import Any

import click

from tso_cli.commands import options
from tso_cli.errors import InputError, needed_by
from tso_cli.io.output import atomic_output, check_output, sole_writer
from tso_cli.io.reading import read_bytes, shown
from tso_cli.io.shipped import named_checkpoint

from ..options import FOLDERS, option
from ..study import Progress, Record, Study, answer, page, undamaged

# The options that every study has.
OF_RECORDS = (
    option(
        "--output",
        "Write the record here (.json), with a chart (.png) and a page (.md) of the same name.",
        Path,
        short="-o",
    ),
    option(
        "--resume",
        "Go on from the record at -o, if there is one; it is kept after every job.",
        bool,
        False,
    ),
    option("--overwrite", "Replace outputs that exist.", bool, False),
    option("--json", "Print one JSON document on stdout.", bool, False, name="as_json"),
)


def check_outputs(output: Path | None, overwrite: bool, resume: bool = False) -> None:
    """Refuse outputs that cannot be written, before the long work starts.

    With ``resume`` they may exist. Until the command ends, other processes cannot write them.
    """
    if resume and output is None:
        raise InputError("--resume goes on from a record, expected its name after -o")
    if output is not None:
        if output.suffix.lower() != ".json":
            expected = "expected .json (the chart has the suffix .png)"
            raise InputError(f"{output}: the suffix is {output.suffix!r}, {expected}")
        click.get_current_context().with_resource(sole_writer(output))
        for suffix in (".json", ".png", ".md"):
            check_output(output.with_suffix(suffix), overwrite or resume)


def earlier_record(study: str, output: Path | None, resume: bool) -> Record | None:
    """The record to resume, None where there is none or ``resume`` is false.

    Raises InputError if the file is no record, or a record of ``study`` that another method made:
    cases of two methods do not mix. The study itself refuses a record of another study.
    """
    if output is None or not resume or not output.exists():
        return None
    from ..studies.fingerprint import differences

    record = read_record(output)
    with undamaged(f"{output}: the record"):
        changes = differences(record) if record.get("study") == study else []
    if changes:
        found = f"was made by another method ({changes[0]})"
        hint = "(with --overwrite in place of --resume it is made anew)"
        raise InputError(f"{output}: {found}, expected one made by the method as it is {hint}")
    return record


def read_record(path: Path) -> Record:
    """The record of a study; InputError if the file holds none."""

    def refused(constant: str) -> None:
        raise InputError(f"{path}: holds the number {constant}, expected one that JSON has")

    content = read_bytes(path, "the record of a study")
    try:
        record = json.loads(content, parse_constant=refused)
        json.dumps(record, ensure_ascii=False).encode()
    except UnicodeEncodeError as error:
        found = shown(error.object[error.start : error.end])
        raise InputError(f"{path}: holds half a letter ({found}), expected whole ones") from None
    except (ValueError, RecursionError):
        raise InputError(f"{path}: is not JSON, expected the record of a study") from None
    if not isinstance(record, dict):
        raise InputError(f"{path}: holds no JSON object, expected the record of a study")
    return record


def write_record(record: Record, output: Path) -> None:
    """Write the record, over the earlier one, with a line for each case.

    What is no number becomes null, as JSON has no other word for it.
    """
    record = options.json_values(record)
    cases = ",\n".join(json.dumps(case, separators=(",", ":")) for case in record.pop("cases"))
    with atomic_output(output) as temporary:
        temporary.write_text(f'{json.dumps(record, indent=1)[:-2]},\n "cases": [\n{cases}\n]}}\n')


def with_fingerprint(record: Record, study: Study, command_line: str) -> Record:
    """The record with the command that makes it and the fingerprint of the method as it is."""
    from ..studies.fingerprint import today

    fingerprint = {part: today(part) for part in study.parts}
    return {**record, "command": command_line, "fingerprint": fingerprint}


def write_page(study: Study, record: Record, output: Path) -> None:
    """The chart and the page of the record at ``output``."""
    study.draw(output.with_suffix(".png"), record, True)
    with atomic_output(output.with_suffix(".md")) as temporary:
        more = sorted(path.name for path in output.parent.glob(f"{output.stem}.*.png"))
        temporary.write_text(page(study, record, output.name, more), encoding="utf-8")


class Reporter:
    """A progress bar for each part of the work."""

    def __init__(self) -> None:
        self._bar: options.ProgressBar | None = None

    def __call__(self, what: str, done: int, total: int) -> None:
        if self._bar is None or self._bar.label != f"tso: {what}":
            self._bar = options.ProgressBar(f"tso: {what}", delay=0.5)
        self._bar(done, total)


def command_of(study: Study) -> click.Command:
    """`tso lab NAME`."""

    def run(
        output: Path | None, overwrite: bool, as_json: bool, resume: bool, **values: Any
    ) -> None:
        check_outputs(output, overwrite, resume)
        if output is not None or values.get("pictures"):
            with needed_by("charts need"):  # they are drawn after hours
                import_module("matplotlib")
        command_line = _command_line(study, values)
        for declared in study.options:
            if declared.several:
                values[declared.name] = tuple(dict.fromkeys(values[declared.name]))
        if values.get("checkpoint"):
            values["checkpoint"] = named_checkpoint(values["checkpoint"])
            options.log(f"tso: checkpoint: {values['checkpoint']}")

        def keep(record: Record) -> None:
            if output is not None:
                write_record(with_fingerprint(record, study, command_line), output)

        earlier = earlier_record(study.name, output, resume)
        source = f"{output}: the record to go on from"
        progress = Progress(Reporter(), earlier, keep, overwrite or resume, source)
        record = study.run(progress, **values)
        if output is not None:
            write_page(study, {**record, "command": command_line}, output)
        if as_json:
            options.echo_json(record)
        else:
            click.echo(answer(study, record))

    parameters = [options.parameter(declared) for declared in (*study.options, *OF_RECORDS)]
    help_text = "\n\n".join(filter(None, (study.question, study.about)))
    return click.Command(study.name, callback=run, params=parameters, help=help_text)


def _command_line(study: Study, values: dict[str, Any]) -> str:
    """The command line that makes the record; of this machine's paths it has the last names."""
    words = [study.command]
    for declared in study.options:
        value = values[declared.name]
        if declared.flag in FOLDERS and value is not None:
            words.append(f"{declared.flag} DIR")
        elif declared.plain is bool:
            words += [declared.flag] if value else []
        elif value != declared.default:
            for item in value if declared.several else [value]:
                words.append(f"{declared.flag} {item.name if isinstance(item, Path) else item}")
    return " ".join(words)
