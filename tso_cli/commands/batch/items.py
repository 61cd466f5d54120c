"""What each row of a manifest means as options of `tso refine`, checked before work begins."""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from contextlib import suppress
from difflib import get_close_matches
from functools import lru_cache
from os.path import expanduser, join, lexists, normpath, realpath, splitext
from pathlib import Path, PurePath
from typing import Any

from ...batch.manifest import CLOUD, MASK, OUTPUT, RESULT, SEPARATOR, Item, in_shard
from ...batch.remote import is_on_this_machine, is_remote, local_path
from ...batch.run import ItemOptions
from ...errors import InputError, prefixed
from ...io.clouds import ARRAYS, check_suffix, clouds_in
from ...io.masks import masks_in
from ...io.output import require_suffix
from ...io.reading import plain, shown
from ...option import Declared
from ..option_files import named, plain_name, value_of
from ..refine.options import RefineOptions, is_word
from ..refine.outputs import NAMED, OUTPUTS, own_suffix, record_of
from .item import options_of
from .page import INDEX, PICTURES

# Options of an item that `tso batch` has for all of them.
OF_BATCH = {
    "strict": "--strict", "overwrite": "--overwrite", "quiet": "--quiet", "as_json": "--json",
}  # fmt: skip
# The order of the options, in which the files of an item have their place in its key.
ORDER = {**dict.fromkeys(NAMED, 1), "output": 2, "source": 3, "masks": 4}


def options_of_items(
    items: Iterable[Item],
    folder: str,
    output: Path,
    strict: bool,
    shard: tuple[int, int] = (1, 1),
    manifest: Path | str = "-",
    carried: dict[str, dict[str, Any]] | None = None,
) -> list[tuple[str, ItemOptions]]:
    """The name of each item's result in the folder ``output``, and its options.

    Only items of this ``shard`` are returned and checked whole. Of all others the names of outputs
    are compared. Paths are text,
    relative to ``folder``, a path or an address. Raises InputError with row and column for what
    `tso refine` does not take, for two outputs of one name, and for an output that is an input of
    another item or the ``manifest``. ``carried`` gets the columns that are no option, by the name
    of the item.
    """
    in_this_shard: list[tuple[str, ItemOptions]] = []
    writers: dict[str, str] = {}
    readers = _Readers(folder, output)
    readers.add("the manifest", [str(manifest)])
    checked_settings: set[tuple[Any, ...]] = set()
    for item in (part for row in items for part in _of_arrays(row, folder)):
        with prefixed(f"{item.place}: "):
            columns = _columns(tuple(item.values))
        options: dict[str, Any] = {"strict": True} if strict else {}
        for title, option in columns.items():
            value = options[option.name] = _value(item, title, option, folder)
            if option.plain is Path and option.option.role != "output":
                readers.add(item.place, value if option.several else [value])
        name = _name(item, options)
        record = record_of(name)
        # Two results of one record are in one shard. Other files of one name may be in two.
        is_in_shard = in_shard(record, shard)
        files = [(OUTPUT, record)] if is_in_shard else []
        for title, option in columns.items():
            if option.name in NAMED:
                file = _below(item, title, options[option.name])
                files.append((title, file))
                options[option.name] = join(output, file)
        for title, file in files:
            if file in writers:
                raise InputError(
                    f"{item.place}: {title}: {writers[file]} writes {plain(file)} too, expected "
                    "another name"
                )
            writers[file] = item.place
        if not is_in_shard:
            continue
        options["output"] = name if is_remote(name) else join(output, name)
        options = {key: options[key] for key in sorted(options, key=lambda key: ORDER.get(key, 0))}
        if (settings := _settings(options)) not in checked_settings:
            _check(item, options, name)
            checked_settings.add(settings)
        options = {key: value for key, value in options.items() if value is not False}
        in_this_shard.append((name, options))
        more = {title or "index": v for title, v in item.values.items() if title not in columns}
        if more and carried is not None:
            carried[name] = more
    for file, writer in writers.items():
        if reader := readers.other_than(writer, file):
            raise InputError(
                f"{writer}: would write {plain(file)}, which {reader} reads, expected another name"
            )
    return in_this_shard


def _of_arrays(item: Item, folder: str) -> Iterator[Item]:
    """The item, or if its cloud is an array [B, N, 3] an item for each of these clouds.

    The i-th cloud has the i-th of B masks, or the mask i of an array, else the one mask. What
    cannot be read is left to the run of the item.
    """
    values, count = item.values, 1
    cloud = _place(str(values.get(CLOUD, "")), folder)
    if not is_remote(cloud) and not values.keys() & {"cloud-index", "cloud_index"}:
        with suppress(InputError):
            count = clouds_in(Path(cloud))
    masks = values.get(MASK, "")
    masks = [text.strip() for text in masks.split(SEPARATOR)] if isinstance(masks, str) else masks
    output = values.get(OUTPUT, f"{PurePath(cloud).stem}{RESULT}.ply")
    # What is no mask or no name is refused as that of a single cloud is.
    named = isinstance(masks, list) and all(mask and isinstance(mask, str) for mask in masks)
    if count == 1 or not named or not isinstance(output, str) or not PurePath(output).name:
        yield item
        return
    if len(masks) == 1 and Path(_place(masks[0], folder)).is_dir():
        masks = [str(file.absolute()) for file in masks_in(Path(_place(masks[0], folder)))]
    name = PurePath(output)
    stem, dot, ending = name.name.partition(".")
    for i in range(count):
        of_cloud = {"cloud-index": i, OUTPUT: str(name.with_name(f"{stem}_{i}{dot}{ending}"))}
        of_cloud[MASK] = masks[i] if len(masks) == count else masks
        if len(masks) == 1 and PurePath(masks[0]).suffix.lower() in ARRAYS:
            of_cloud["mask-index"] = i
        yield Item(f"{item.place}, cloud {i}", values | of_cloud)


class _Readers:
    """Which rows read files below the folder ``output``; ``folder`` is that of the manifest."""

    def __init__(self, folder: str, output: Path) -> None:
        self._folder, self._real = join(folder, "") if folder else "", realpath(folder)
        self._below = join(realpath(output), "")
        self._places: dict[str, set[str]] = {}

    def add(self, place: str, files: Iterable[str | None]) -> None:
        for file in files:
            name = (file or "").removeprefix(self._folder)
            real = normpath(join(self._real, name)) if name else ""
            if real.startswith(self._below):
                self._places.setdefault(real[len(self._below) :], set()).add(place)

    def other_than(self, writer: str, file: str) -> str:
        """A row that reads what the row ``writer`` writes, or "". A row may replace its input."""
        return min(self._places.get(file, set()) - {writer}, default="")


@lru_cache(maxsize=1024)
def _columns(titles: tuple[str, ...]) -> dict[str, Declared]:
    """The titles of columns that set an option of `tso refine`, each with the option.

    Other columns are the user's own, unless their names are nearly those of options.
    """
    title_of: dict[str, str] = {}
    columns: dict[str, Declared] = {}
    for title in titles:
        option = named(RefineOptions).get(plain_name(title))
        if plain_name(title) == "config" or (
            option and (option.option.role == "run" or option.name == "strict")
        ):
            by = OF_BATCH.get(option.name) if option else None
            why = f"the option {by} sets it for all" if by else "tso batch sets it itself"
            raise InputError(f"the column {shown(title)} is not for one item: {why}")
        if option is None:
            if nearest := _nearest(title):
                raise InputError(
                    f"the column {shown(title)} is no option of tso refine, expected {nearest}, or "
                    "another name for a column of your own"
                )
            continue
        if option.name in title_of:
            raise InputError(
                f"the columns {plain(title_of[option.name])} and {plain(title)} are the same "
                "option, expected one of them"
            )
        title_of[option.name], columns[title] = title, option
    return columns


def _nearest(title: str) -> str:
    """The option whose name is nearly ``title``, or ""."""
    name = plain_name(title)
    name = name.removesuffix("_path").removesuffix("_file")
    return next(iter(get_close_matches(name, named(RefineOptions), 1, 0.8)), "")


def _place(text: str, folder: str) -> str:
    """Where the path of a cell leads; an address stays."""
    text = local_path(text)
    if is_remote(text):
        return text
    path = join(folder, expanduser(text))
    # A backslash of Windows, unless it is of the name of a file.
    return path if "\\" not in path or lexists(path) else path.replace("\\", "/")


def _value(item: Item, title: str, option: Declared, folder: str) -> Any:
    """What a cell holds; a path as text, and that of an output as it is."""
    value = item.values[title]
    if option.several and isinstance(value, str):
        value = [text.strip() for text in value.split(SEPARATOR)]
    elif isinstance(value, list) and not option.several:
        raise InputError(f"{item.place}: {title} has {len(value)} values, expected one")
    if option.option.role == "output":
        return value if isinstance(value, str) else ""
    with prefixed(f"{item.place}: {title} is "):
        if value == []:
            raise InputError(f"[], expected {option.expected}")
        value = value_of(option, value, lambda text: _place(text, folder))
        if option.name == "masks" and len(set(map(normpath, value))) < len(value):
            raise InputError(f"{shown(item.values[title])}, expected each mask once")
    return sys.intern(value) if option.plain is str and isinstance(value, str) else value


def _settings(options: ItemOptions) -> tuple[Any, ...]:
    """What the checks depend on: rows whose options differ only in names of files have the same."""
    table = named(RefineOptions)
    return tuple(
        (name, value)
        if table[name].plain is not Path or is_word(name, value)
        else (name, len(value) if isinstance(value, tuple) else splitext(value)[1])
        for name, value in options.items()
    )


def _name(item: Item, options: ItemOptions) -> str:
    """The name of the result: a path below the folder of the batch, or an address."""
    if "output" in options:
        return _below(item, OUTPUT, options["output"])
    if "source" not in options:
        raise InputError(f"{item.place}: has no {CLOUD}, expected one")
    cloud = Path(options["source"])
    return f"{cloud.stem}.refined{own_suffix(cloud, options.get('mode', 'points'))}"


def _below(item: Item, title: str, name: str) -> str:
    """The plain form of a path below the folder of the batch; of a result it may be an address."""
    path = PurePath(name if is_remote(name) else name.replace("\\", "/"))
    outside = path.is_absolute() or ".." in path.parts or path.parts[:1] == ("~",)
    if not path.parts or outside or is_on_this_machine(name):
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
    file = path.as_posix()
    of_page = file == INDEX or (file.startswith(f"{PICTURES}/") and file.endswith(".png"))
    if of_page or (title != OUTPUT and file.endswith(record_of(""))):
        raise InputError(
            f"{item.place}: {title} is {plain(name)}, which tso batch writes itself, expected "
            "another name"
        )
    return file


def _check(item: Item, options: ItemOptions, name: str) -> None:
    """Raise InputError with row and column for what `tso refine` does not take; reads no file."""
    with prefixed(f"{item.place}: "):
        refine_options = options_of(options)
        with prefixed(f"{OUTPUT}: "):
            check_suffix(Path(name), own_suffix(refine_options.source, refine_options.mode))
        for option in NAMED:
            if (file := getattr(refine_options, option)) is not None:
                with prefixed(f"{option.replace('_', '-')}: "):
                    require_suffix(file, OUTPUTS[option].suffix)
