"""Commands that answer with a record: where the answer goes, how progress is shown, and the command of every study."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import click

from ...commands import options
from ...errors import InputError
from ...io.output import atomic_output, check_output, sole_writer
from ...io.reading import read_bytes
from ...io.shipped import named_checkpoint
from ..study import Option, Progress, Record, Study, answer, page, undamaged

output_option = click.option(
    "-o",
    "--output",
    type=options.FilePath(),
    help="Write the record here (.json), a chart (.png) and a page (.md) beside it.",
)


def check_outputs(output: Path | None, overwrite: bool, resume: bool = False) -> None:
    """Refuse outputs that cannot be written before the long work starts; with ``resume`` they may be there.

    Until the command ends, other processes are refused the same output.
    """
    if resume and output is None:
        raise InputError("--resume goes on from a record, expected its name after -o")
    if output is not None:
        if output.suffix.lower() != ".json":
            raise InputError(
                f"{output}: the suffix is {output.suffix!r}, expected .json (the chart goes beside it as .png)"
            )
        click.get_current_context().with_resource(sole_writer(output))
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
    with undamaged(f"{output}: the record"):
        changes = differences(record) if record.get("study") == study else []
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
    cases = ",\n".join(json.dumps(case, separators=(",", ":")) for case in record.pop("cases"))
    with atomic_output(output) as temporary:
        temporary.write_text(f'{json.dumps(record, indent=1)[:-2]},\n "cases": [\n{cases}\n]}}\n')


class Reporter:
    """A progress bar for each part of the work."""

    def __init__(self) -> None:
        self._bar: options.ProgressBar | None = None

    def __call__(self, what: str, done: int, total: int) -> None:
        if self._bar is None or self._bar.label != f"tso: {what}":
            self._bar = options.ProgressBar(f"tso: {what}", delay=0.5)
        self._bar(done, total)


def write_page(study: Study, record: Record, output: Path) -> None:
    """The chart and the page of the record at ``output``, beside it."""
    study.draw(output.with_suffix(".png"), record, True)
    with atomic_output(output.with_suffix(".md")) as temporary:
        more = sorted(path.name for path in output.parent.glob(f"{output.stem}.*.png"))
        temporary.write_text(page(study, record, output.name, more))


def command_of(study: Study) -> click.Command:
    """`tso lab NAME` or `tso bench NAME`."""

    def run(
        output: Path | None, overwrite: bool, as_json: bool, resume: bool, **values: Any
    ) -> None:
        check_outputs(output, overwrite, resume)
        command_line = _command_line(study, values)
        for option in study.options:
            if option.multiple:
                values[option.parameter] = tuple(dict.fromkeys(values[option.parameter]))
        if values.get("checkpoint"):
            values["checkpoint"] = named_checkpoint(values["checkpoint"])
            options.log(f"tso: checkpoint: {values['checkpoint']}")

        def keep(record: Record) -> None:
            if output is not None:
                write_record({**record, "command": command_line}, study.parts, output)

        earlier = earlier_record(study.name, output, resume)
        named = f"{output}: the record to go on from"
        record = study.run(
            Progress(Reporter(), earlier, keep, overwrite or resume, named), **values
        )
        if output is not None:
            write_page(study, {**record, "command": command_line}, output)
        if as_json:
            options.echo_json(record)
        else:
            click.echo(answer(study, record))

    resumed = click.option(
        "--resume",
        is_flag=True,
        help="Go on from the record at -o, kept after every job, if there is one.",
    )
    function: Callable[..., Any] = run
    for decorate in (
        options.as_json,
        options.overwrite,
        resumed,
        output_option,
        *map(_click_option, study.options[::-1]),
    ):
        function = decorate(function)
    return click.command(study.name, help="\n\n".join(filter(None, (study.question, study.about))))(
        function
    )


def _click_option(option: Option) -> Callable[..., Any]:
    kind: Any = options.FilePath() if option.kind is Path else option.kind
    if option.choices:
        kind = click.Choice(option.choices)
    elif option.least is not None:
        kind = click.IntRange(option.least, option.most)
    settings: dict[str, Any] = {"is_flag": True} if option.kind is bool else {"type": kind}
    if option.default is not None:  # None, where it is passed on, would satisfy a required option
        settings["default"] = option.default
    return click.option(
        option.flag,
        option.parameter,
        required=option.required,
        multiple=option.multiple,
        show_default=not (
            option.default is None or option.default is False or option.default == ()
        ),
        help=option.help,
        **settings,
    )


def _command_line(study: Study, values: dict[str, Any]) -> str:
    """The command line that makes the record; folders and files of this machine by their last names."""
    words = [study.command]
    for option in study.options:
        value = values[option.parameter]
        if option.required:
            words.append(f"{option.flag} DIR")
        elif option.kind is bool:
            words += [option.flag] * value
        elif value != option.default:
            values_of = value if option.multiple else [value]
            words += [
                f"{option.flag} {item.name if isinstance(item, Path) else item}"
                for item in values_of
            ]
    return " ".join(words)
