"""What each row of a manifest means as arguments of `tso refine`, checked before work begins."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from os.path import join, normpath, splitext
from pathlib import Path, PurePath
from typing import Any, NamedTuple

import click

from ..batch.manifest import CLOUD, MASK, OUTPUT, SEPARATOR, Item, in_shard
from ..batch.remote import is_remote
from ..errors import InputError
from ..io.clouds import check_suffix, output_suffix
from ..io.output import require_suffix
from ..io.reading import plain, shown
from .batch_item import context_of, refine_command
from .batch_page import INDEX, PICTURES
from .option_files import parameter_of
from .options import WORDS, FilePath
from .refine_outputs import NAMED, OUTPUTS
from .refine_record import OF_RUN, record_of
from .refine_run import check_options

# Options that a batch sets itself for each item.
SET_BY_BATCH = (*OF_RUN, "strict", "config")
# Those of them that `tso batch` has as options.
OF_BATCH = {
    "strict": "--strict", "overwrite": "--overwrite", "quiet": "--quiet", "as_json": "--json",
}  # fmt: skip
PARAMETERS = {parameter.name: parameter for parameter in refine_command.params}
SWITCHES = {"true": True, "1": True, "yes": True, "false": False, "0": False, "no": False}
# Options that name another file to write.
FLAGS = tuple(f"--{name.replace('_', '-')}" for name in NAMED)
# The order in which the columns become arguments.
ORDER = {**dict.fromkeys(NAMED, 1), "output": 2, "source": 3, "masks": 4}


class Column(NamedTuple):
    """A column of a manifest, and the parameter of `tso refine` that it sets."""

    title: str
    name: str
    flag: str
    several: bool
    is_path: bool
    is_switch: bool


def arguments_of(
    items: Iterable[Item],
    folder: str,
    output: Path,
    more: list[str],
    shard: tuple[int, int] = (1, 1),
) -> list[tuple[str, tuple[str, ...]]]:
    """The name of each item's result in the folder ``output``, and its arguments.

    Of all items there are those of the ``shard``; only those are checked whole. Paths are relative
    to ``folder``, a path or an address. ``more`` are arguments of every item. Raises InputError
    with row and column for what `tso refine` does not take, and for two outputs of one name.
    """
    named: list[tuple[str, tuple[str, ...]]] = []
    places: dict[str, str] = {}
    checked: set[tuple[str, ...]] = set()
    for item in items:
        columns = _columns_of(item)
        given = {column.name: item.values[column.title] for column in columns}
        name = _name(item, given)
        record = record_of(name)
        # Two results of one record are in one shard. Other files of one name may be in two.
        own = in_shard(record, shard)
        written = [(OUTPUT, record)] if own else []
        for column in columns:
            if column.name in NAMED:
                written.append((column.title, _below(item, column.title, given[column.name])))
        _claim(item, written, places)
        if not own:
            continue
        place = name if is_remote(name) else join(output, name)
        arguments, settings = _arguments(item, columns, folder, output, place)
        if settings not in checked:  # any path is a path, so rows with equal settings are alike
            _check(item, [*more, *arguments], name)
            checked.add(settings)
        named.append((name, (*more, *arguments)))
    return named


def _claim(item: Item, written: list[tuple[str, str]], places: dict[str, str]) -> None:
    """Note the files (column, name) that an item writes; InputError if another one writes one."""
    for title, file in written:
        if file in places:
            raise InputError(
                f"{item.place}: {title}: {places[file]} writes {plain(file)} too, expected another "
                "name"
            )
        places[file] = item.place


def written_by(arguments: Sequence[str]) -> list[str]:
    """The files that an item with these arguments writes: its result, its record, then others.

    Result and record are paths or addresses, the others are paths.
    """
    end = arguments.index("--")
    result, others = arguments[end - 1], []
    for number in range(end - 4, -1, -2):  # `_arguments` puts them there
        if arguments[number] not in FLAGS:
            break
        others.append(arguments[number + 1])
    return [result, record_of(result), *others]


def _columns_of(item: Item) -> tuple[Column, ...]:
    try:
        return _columns(tuple(item.values))
    except InputError as error:
        raise InputError(f"{item.place}: {error}") from None


@lru_cache(maxsize=1024)
def _columns(titles: tuple[str, ...]) -> tuple[Column, ...]:
    """The columns of these titles, in the order of their arguments."""
    found: dict[str, Column] = {}
    for title in titles:
        name = parameter_of(title)
        parameter = PARAMETERS.get(name)
        if name in SET_BY_BATCH:
            option = OF_BATCH.get(name)
            by = f"the option {option} sets it for all" if option else "tso batch sets it itself"
            raise InputError(f"the column {shown(title)} is not for one item: {by}")
        if parameter is None or not parameter.expose_value:
            raise InputError(
                f"the column {shown(title)} is no option of tso refine for an item, expected "
                f"{CLOUD}, {MASK}, camera, {OUTPUT}, steps and so on"
            )
        if name in found:
            raise InputError(
                f"the columns {plain(found[name].title)} and {plain(title)} are the same option, "
                "expected one of them"
            )
        found[name] = Column(
            title,
            name,
            max(parameter.opts, key=len),
            parameter.nargs == -1 or getattr(parameter, "multiple", False),
            isinstance(parameter.type, FilePath),
            getattr(parameter, "is_flag", False),
        )
    return tuple(sorted(found.values(), key=lambda one: ORDER.get(one.name, 0)))


def _arguments(
    item: Item, columns: tuple[Column, ...], folder: str, output: Path, place: str
) -> tuple[list[str], tuple[str, ...]]:
    """The arguments of an item, and its settings: what of them is no path but is checked."""
    words: list[str] = []
    files: list[str] = []
    settings = [splitext(place)[1]]
    for column in columns:
        if column.name == "output":
            continue
        values = _values(item, column)
        settings += [column.flag, str(len(values))]
        if column.is_switch:
            words += [column.flag] if _is_true(item, column, values) else []
            settings += words[-1:]
            continue
        if column.name in NAMED:
            values = [join(output, normpath(value)) for value in values]
            settings.append(splitext(values[0])[1])
        elif column.is_path:
            known = WORDS.get(column.name, ())
            word = values[0] if values[0] in known else ""
            settings += [splitext(values[0])[1] if column.name == "source" else "", word]
            values = [
                value if value in known or is_remote(value) else join(folder, value)
                for value in values
            ]
        else:
            values = [sys.intern(value) for value in values]  # of many rows
            settings += values
        if column.name in ("source", "masks"):
            files += values
        else:
            words += [word for value in values for word in (column.flag, value)]
    return [*words, "-o", place, "--", *files], tuple(settings)


def _name(item: Item, given: dict[str, Any]) -> str:
    """The name of the result: a path below the folder of the batch, or an address."""
    if "output" in given:
        return _below(item, OUTPUT, given["output"])
    cloud = Path(str(given["source"]))
    return f"{cloud.stem}.refined{_own_suffix(cloud, given.get('mode', 'points'))}"


def _own_suffix(cloud: Path, mode: str) -> str:
    return output_suffix(cloud) if mode == "points" else ".ply"


def _below(item: Item, title: str, name: Any) -> str:
    """The plain form of a path below the folder of the batch; of a result it may be an address."""
    path = PurePath(name if isinstance(name, str) else "")
    if not path.parts or path.is_absolute() or ".." in path.parts:
        raise InputError(
            f"{item.place}: {title} is {shown(name)}, expected a name below the folder of -o"
        )
    if is_remote(name):
        if title == OUTPUT:
            return name
        raise InputError(
            f"{item.place}: {title} is {plain(name)}, expected a name below the folder of -o; "
            f"only {OUTPUT} may be an address"
        )
    plainly = path.as_posix()
    of_batch = plainly == INDEX or (plainly.startswith(f"{PICTURES}/") and plainly.endswith(".png"))
    if of_batch or (title != OUTPUT and plainly.endswith(record_of(""))):
        raise InputError(
            f"{item.place}: {title} is {plain(name)}, which tso batch writes itself, expected "
            "another name"
        )
    return plainly


def _values(item: Item, column: Column) -> list[str]:
    """What a cell holds, as words."""
    value = item.values[column.title]
    values = value if isinstance(value, list) else [value]
    if column.several and isinstance(value, str):
        values = [one.strip() for one in value.split(SEPARATOR)]
    if not column.several and len(values) != 1:
        raise InputError(f"{item.place}: {column.title} has {len(values)} values, expected one")
    kinds, expected = (str, "a path") if column.is_path else ((str, int, float), "a value")
    for one in values or [""]:
        if not isinstance(one, kinds) or one == "":
            raise InputError(f"{item.place}: {column.title} is {shown(value)}, expected {expected}")
        if one == "list" and not column.is_path:
            raise InputError(
                f"{item.place}: {column.title} is list, expected a name from that list"
            )
    if column.name == "masks" and len(set(map(normpath, values))) < len(values):
        raise InputError(f"{item.place}: {column.title} is {shown(value)}, expected each mask once")
    return [str(one) for one in values]


def _is_true(item: Item, column: Column, values: list[str]) -> bool:
    found = SWITCHES.get(values[0].casefold())
    if found is None:
        raise InputError(
            f"{item.place}: {column.title} is {shown(values[0])}, expected true or false"
        )
    return found


def _check(item: Item, arguments: list[str], name: str) -> None:
    """Raise InputError with row and column for what `tso refine` does not take; reads no file."""
    try:
        chosen = context_of(arguments).params
        with _at(OUTPUT):
            check_suffix(Path(name), _own_suffix(chosen["source"], chosen["mode"]))
        for written in NAMED:
            if chosen[written] is not None:
                with _at(written.replace("_", "-")):
                    require_suffix(chosen[written], OUTPUTS[written].suffix)
        check_options(chosen)
    except click.UsageError as error:
        parameter = getattr(error, "param", None)
        column = f": {parameter.name.replace('_', '-')}" if parameter is not None else ""
        raise InputError(f"{item.place}{column}: {error.format_message()}") from None
    except InputError as error:
        raise InputError(f"{item.place}: {error}") from None


@contextmanager
def _at(column: str) -> Iterator[None]:
    """Let errors begin with ``column``."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{column}: {error}") from None
