"""What each row of a manifest means as options of `tso refine`, checked before work begins."""

from __future__ import annotations

import sys
from collections.abc import Iterable
from functools import lru_cache
from os.path import join, normpath, splitext
from pathlib import Path, PurePath
from typing import Any, NamedTuple

from ...batch.manifest import CLOUD, MASK, OUTPUT, SEPARATOR, Item, in_shard
from ...batch.remote import is_remote
from ...batch.run import Given
from ...errors import InputError, prefixed
from ...io.clouds import check_suffix, output_suffix
from ...io.output import require_suffix
from ...io.reading import plain, shown
from ...option import Declared
from ..option_files import named, plain_name, value_of
from ..refine.options import RefineOptions, is_word
from ..refine.outputs import NAMED, OUTPUTS, record_of
from .item import options_of
from .page import INDEX, PICTURES

# Options of an item that `tso batch` has for all of them.
OF_BATCH = {
    "strict": "--strict", "overwrite": "--overwrite", "quiet": "--quiet", "as_json": "--json",
}  # fmt: skip
# The order of the options, in which the files of an item have their place in its key.
ORDER = {**dict.fromkeys(NAMED, 1), "output": 2, "source": 3, "masks": 4}


class Column(NamedTuple):
    """A column of a manifest, and the option of `tso refine` that it sets."""

    title: str
    option: Declared


def options_of_items(
    items: Iterable[Item],
    folder: str,
    output: Path,
    strict: bool,
    shard: tuple[int, int] = (1, 1),
) -> list[tuple[str, Given]]:
    """The name of each item's result in the folder ``output``, and its options.

    Of all items there are those of the ``shard``; only those are checked whole. Paths are text,
    relative to ``folder``, a path or an address. Raises InputError with row and column for what
    `tso refine` does not take, and for two outputs of one name.
    """
    of_shard: list[tuple[str, Given]] = []
    places: dict[str, str] = {}
    checked: set[tuple[Any, ...]] = set()
    for item in items:
        columns = _columns_of(item)
        given: dict[str, Any] = {"strict": True} if strict else {}
        given |= {column.option.name: _value(item, column, folder) for column in columns}
        name = _name(item, given)
        record = record_of(name)
        # Two results of one record are in one shard. Other files of one name may be in two.
        own = in_shard(record, shard)
        written = [(OUTPUT, record)] if own else []
        for column in columns:
            if column.option.name in NAMED:
                below = _below(item, column.title, given[column.option.name])
                written.append((column.title, below))
                given[column.option.name] = join(output, below)
        _claim(item, written, places)
        if not own:
            continue
        given["output"] = name if is_remote(name) else join(output, name)
        given = {key: given[key] for key in sorted(given, key=lambda key: ORDER.get(key, 0))}
        if (settings := _settings(given)) not in checked:
            _check(item, given, name)
            checked.add(settings)
        of_shard.append((name, {key: value for key, value in given.items() if value is not False}))
    return of_shard


def _claim(item: Item, written: list[tuple[str, str]], places: dict[str, str]) -> None:
    """Note the files (column, name) that an item writes; InputError if another one writes one."""
    for title, file in written:
        if file in places:
            raise InputError(
                f"{item.place}: {title}: {places[file]} writes {plain(file)} too, expected another "
                "name"
            )
        places[file] = item.place


def written_by(given: Given) -> list[str]:
    """The files that an item with these options writes: its result, its record, then others.

    Result and record are paths or addresses, the others are paths.
    """
    result = given["output"]
    return [result, record_of(result), *(given[name] for name in NAMED if given.get(name))]


def _columns_of(item: Item) -> tuple[Column, ...]:
    try:
        return _columns(tuple(item.values))
    except InputError as error:
        raise InputError(f"{item.place}: {error}") from None


@lru_cache(maxsize=1024)
def _columns(titles: tuple[str, ...]) -> tuple[Column, ...]:
    """The columns of these titles."""
    columns: dict[str, Column] = {}
    for title in titles:
        option = named(RefineOptions).get(plain_name(title))
        if plain_name(title) == "config" or (
            option and (option.option.role == "run" or option.name == "strict")
        ):
            by = OF_BATCH.get(option.name) if option else None
            why = f"the option {by} sets it for all" if by else "tso batch sets it itself"
            raise InputError(f"the column {shown(title)} is not for one item: {why}")
        if option is None:
            raise InputError(
                f"the column {shown(title)} is no option of tso refine for an item, expected "
                f"{CLOUD}, {MASK}, camera, {OUTPUT}, steps and so on"
            )
        if option.name in columns:
            raise InputError(
                f"the columns {plain(columns[option.name].title)} and {plain(title)} are the same "
                "option, expected one of them"
            )
        columns[option.name] = Column(title, option)
    return tuple(columns.values())


def _value(item: Item, column: Column, folder: str) -> Any:
    """What a cell holds; a path as text, and that of an output as it is."""
    option, value = column.option, item.values[column.title]
    if option.several and isinstance(value, str):
        value = [text.strip() for text in value.split(SEPARATOR)]
    elif isinstance(value, list) and not option.several:
        raise InputError(f"{item.place}: {column.title} has {len(value)} values, expected one")
    if option.option.role == "output":
        return value if isinstance(value, str) else ""
    try:
        if value == []:
            raise InputError(f"[], expected {option.expected}")
        made = value_of(option, value, lambda text: text if is_remote(text) else join(folder, text))
    except InputError as error:
        raise InputError(f"{item.place}: {column.title} is {error}") from None
    if option.name == "masks" and len(set(map(normpath, made))) < len(made):
        raise InputError(
            f"{item.place}: {column.title} is {shown(item.values[column.title])}, expected each "
            "mask once"
        )
    return sys.intern(made) if option.plain is str and isinstance(made, str) else made


def _settings(given: Given) -> tuple[Any, ...]:
    """What of an item's options is checked: any path is a path, so rows that share it are alike."""
    table = named(RefineOptions)
    return tuple(
        (name, value)
        if table[name].plain is not Path or is_word(name, value)
        else (name, len(value) if isinstance(value, tuple) else splitext(value)[1])
        for name, value in given.items()
    )


def _name(item: Item, given: Given) -> str:
    """The name of the result: a path below the folder of the batch, or an address."""
    if "output" in given:
        return _below(item, OUTPUT, given["output"])
    if "source" not in given:
        raise InputError(f"{item.place}: has no {CLOUD}, expected one")
    cloud = Path(given["source"])
    return f"{cloud.stem}.refined{_own_suffix(cloud, given.get('mode', 'points'))}"


def _own_suffix(cloud: Path, mode: str) -> str:
    return output_suffix(cloud) if mode == "points" else ".ply"


def _below(item: Item, title: str, name: str) -> str:
    """The plain form of a path below the folder of the batch; of a result it may be an address."""
    path = PurePath(name)
    if not path.parts or path.is_absolute() or ".." in path.parts:
        raise InputError(
            f"{item.place}: {title} is {shown(item.values[title])}, expected a name below the "
            "folder of -o"
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


def _check(item: Item, given: Given, name: str) -> None:
    """Raise InputError with row and column for what `tso refine` does not take; reads no file."""
    with prefixed(f"{item.place}: "):
        chosen = options_of(given)
        with prefixed(f"{OUTPUT}: "):
            check_suffix(Path(name), _own_suffix(chosen.source, chosen.mode))
        for written in NAMED:
            if (file := getattr(chosen, written)) is not None:
                with prefixed(f"{written.replace('_', '-')}: "):
                    require_suffix(file, OUTPUTS[written].suffix)
