"""What each row of a manifest means as arguments of `tso refine`, checked before work begins."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from ..batch.manifest import CLOUD, MASK, OUTPUT, SEPARATOR, Item
from ..batch.remote import is_remote
from ..errors import InputError
from ..io.clouds import output_suffix
from ..io.reading import plain, shown
from .batch_item import context_of, refine_command
from .options import FilePath
from .refine_record import OF_RUN, WRITTEN, in_folder, parameter_of, record_of

# Options that a batch sets itself for each item.
SET_BY_BATCH = (*OF_RUN, "strict", "config")
PARAMETERS = {parameter.name: parameter for parameter in refine_command.params}
SWITCHES = {"true": True, "1": True, "yes": True, "false": False, "0": False, "no": False}


def arguments_of(
    items: Sequence[Item], folder: Path, output: Path, more: list[str]
) -> list[tuple[str, tuple[str, ...]]]:
    """The name of each item's result in the folder ``output``, and its arguments.

    Paths are relative to ``folder``. ``more`` are arguments of every item. Raises InputError with
    row and column for what `tso refine` does not take, and for two results of one name.
    """
    named: list[tuple[str, tuple[str, ...]]] = []
    places: dict[str, str] = {}
    checked: set[tuple[str, ...]] = set()
    for item in items:
        name, arguments, settings = _arguments(item, folder, output)
        if settings not in checked:  # any path is a path, so rows with equal settings are alike
            _check(item, arguments)
            checked.add(settings)
        if name in places:
            raise InputError(
                f"{item.place} has the output {plain(name)}, as {places[name]} has; expected "
                f"another: name it in the column {OUTPUT}"
            )
        places[name] = item.place
        named.append((name, (*more, *arguments)))
    return named


def written_by(output: Path, arguments: Sequence[str]) -> list[Path]:
    """The files that an item with this result writes."""
    flags = ["--" + name.replace("_", "-") for name in WRITTEN]
    more = [Path(arguments[place + 1]) for place, word in enumerate(arguments) if word in flags]
    return [output, record_of(output), *more]


def _arguments(item: Item, folder: Path, output: Path) -> tuple[str, list[str], tuple[str, ...]]:
    """The name of an item's result, its arguments, and what of them are no paths."""
    positional: list[str] = []
    words: list[str] = []
    settings: list[str] = []
    for column, value in item.values.items():
        name = parameter_of(column)
        parameter = PARAMETERS.get(name)
        if parameter is None or name in SET_BY_BATCH:
            raise InputError(
                f"{item.place}: the column {shown(column)} is no option of tso refine for an item, "
                f"expected {CLOUD}, {MASK}, camera, {OUTPUT}, steps and so on"
            )
        if name == "output":
            continue
        values = _values(item, column, value, parameter)
        flag = max(parameter.opts, key=len)
        is_path = isinstance(parameter.type, FilePath)
        settings.append(flag)
        if isinstance(parameter, click.Option) and parameter.is_flag:
            words += [flag] if _is_true(item, column, values) else []
            continue
        placed = [
            str(in_folder(one, parameter, output if name in WRITTEN else folder)) for one in values
        ]
        if isinstance(parameter, click.Argument):
            # The cloud comes before its masks, whatever the order of the columns.
            positional = [*placed, *positional] if name == "source" else [*positional, *placed]
        else:
            words += [word for one in placed for word in (flag, one)]
        settings += [] if is_path else placed
    name = _name(item)
    place = name if is_remote(name) else str(output / name)
    return name, [*words, "-o", place, "--", *positional], tuple(settings)


def _name(item: Item) -> str:
    """The name of the result: a path below the folder of the batch, or an address."""
    cloud = Path(str(item.values[CLOUD]))
    points = item.values.get("mode", "points") == "points"
    suffix = output_suffix(cloud) if points else ".ply"
    name = str(item.values.get(OUTPUT, f"{cloud.stem}.refined{suffix}"))
    if is_remote(name):
        return name
    if Path(name).is_absolute() or ".." in Path(name).parts:
        raise InputError(
            f"{item.place}: {OUTPUT} is {plain(name)}, expected a name below the folder of -o"
        )
    return Path(name).as_posix()


def _values(item: Item, column: str, value: Any, parameter: click.Parameter) -> list[Any]:
    several = parameter.nargs == -1 or getattr(parameter, "multiple", False)
    values = value if isinstance(value, list) else [value]
    if several and isinstance(value, str):
        values = [one.strip() for one in value.split(SEPARATOR)]
    if not several and len(values) != 1:
        raise InputError(f"{item.place}: {column} has {len(values)} values, expected one")
    for one in values:
        if isinstance(one, (dict, list)) or one == "":
            raise InputError(f"{item.place}: {column} is {shown(value)}, expected a value")
        if one == "list":
            raise InputError(f"{item.place}: {column} is list, expected a name from that list")
    return values


def _is_true(item: Item, column: str, values: list[Any]) -> bool:
    found = SWITCHES.get(str(values[0]).casefold())
    if found is None:
        raise InputError(f"{item.place}: {column} is {shown(values[0])}, expected true or false")
    return found


def _check(item: Item, arguments: list[str]) -> None:
    """Raise InputError with row and column for a value that `tso refine` does not take."""
    try:
        context_of(arguments)
    except click.UsageError as error:
        parameter = getattr(error, "param", None)
        column = f": {parameter.name.replace('_', '-')}" if parameter is not None else ""
        raise InputError(f"{item.place}{column}: {error.format_message()}") from None
