"""The command of a study: the same for all of them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import click

from ...commands import options
from ...io.shipped import named_checkpoint
from ..study import Option, Progress, Record, Study, answer
from . import records
from .page import write_page
from .records import Reporter, check_outputs, earlier_record, write_record


def command_of(study: Study) -> click.Command:
    """`tso lab NAME`, or `tso bench NAME`."""

    def run(output: Path | None, overwrite: bool, as_json: bool, resume: bool = False, **values: Any) -> None:
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

        unfinished = output.with_name(f"{output.stem}.unfinished.safetensors") if output else None
        earlier = earlier_record(study.name, output, resume)
        record = study.run(Progress(Reporter(), earlier, keep, unfinished, overwrite or resume), **values)
        if output is not None:
            write_page(study, {**record, "command": command_line}, output)
        if as_json:
            options.echo_json(record)
        else:
            click.echo(answer(study, record))

    decorators = [*map(_click_option, study.options), records.output]
    if study.kept:
        again = f"Go on from the record at -o, kept {study.kept}, if there is one."
        decorators.append(click.option("--resume", is_flag=True, help=again))
    function: Callable[..., Any] = run
    for decorate in reversed([*decorators, options.overwrite, options.as_json]):
        function = decorate(function)
    return click.command(study.name, help=f"{study.question}\n\n{study.about}")(function)


def _click_option(option: Option) -> Callable[..., Any]:
    kind: Any = option.kind
    if option.choices:
        kind = click.Choice(option.choices)
    elif option.kind is Path:
        kind = options.FilePath()
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
        show_default=not (option.default is None or option.default is False or option.default == ()),
        help=option.help,
        **settings,
    )


def _command_line(study: Study, values: dict[str, Any]) -> str:
    """The command line that makes the record; folders and files of this machine by their last names."""
    words = [f"tso {study.group} {study.name}"]
    for option in study.options:
        value = values[option.parameter]
        if option.required:
            words.append(f"{option.flag} DIR")
        elif option.kind is bool:
            words += [option.flag] * value
        elif value != option.default:
            values_of = value if option.multiple else [value]
            words += [f"{option.flag} {item.name if isinstance(item, Path) else item}" for item in values_of]
    return " ".join(words)
