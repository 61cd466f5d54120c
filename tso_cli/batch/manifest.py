"""The items of a batch: rows of a CSV or JSON Lines file, or the files of a folder by their names.

An item is what one run of `tso refine` is given: the name of an option -> its value.
"""

from __future__ import annotations

import codecs
import csv
import io
import json
import os
import sys
import zlib
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import Any, NamedTuple

from ..errors import InputError
from ..evaluation.pairs import CAMERAS
from ..io.clouds import SUFFIXES, output_suffix
from ..io.masks import masks_in
from ..io.output import reason
from ..io.reading import plain, read_bytes, shown
from .remote import read_remote

STDIN = Path("-")
# Columns that are not options of `tso refine` by that name.
CLOUD, MASK, OUTPUT = "cloud", "mask", "output"
EXPECTED = "a manifest of items (CSV or JSON Lines) or a folder"
SEPARATOR = ";"  # of several files in one cell
SEPARATORS = (",", ";", "\t")  # of cells
# A folder may hold its kinds of files apart.
PARTS = ("clouds", "masks", "cameras")
# In a folder, a .txt file is more often a note than a cloud, and an array may be anything.
IN_FOLDERS = tuple(suffix for suffix in SUFFIXES if suffix not in (".txt", ".npz", ".pt"))
# Endings of a cloud's mask, the preferred ones first; "" is a folder. NAME.png may be the photo
# where there is a NAME.mask.png, NAME.jpg where there is a NAME.png, and NAME.npy may be a cloud.
MASKS = (
    ("", ".mask.png"),
    (".png", ".bmp", ".tif", ".tiff", ".webp", ".gif"),
    (".npy", ".jpg", ".jpeg"),
)
RESULT = ".refined"  # what names of results end in
BY_NAME = (
    "expected NAME.png or NAME.mask.png next to NAME.ply, or the folders clouds, masks and "
    "cameras; or give a manifest (CSV with the columns cloud and mask)"
)


class Item(NamedTuple):
    """One row. ``place`` is what messages call it: "items.csv: row 3"."""

    place: str
    values: dict[str, Any]


def read_manifest(manifest: Path | str) -> Iterator[Item]:
    """The items of a manifest, of a folder, or of stdin (``-``); a text is an address.

    A CSV file names its columns in the first row; an empty cell says nothing. JSON Lines have one
    object in each line. Raises InputError with the row, and the column where there is one.
    """
    if isinstance(manifest, Path) and manifest.is_dir():
        yield from _of_folder(manifest)
        return
    text, name = _read(manifest)
    if not (beginning := text.lstrip()[:1]):
        raise InputError(f"{name}: is empty, expected {EXPECTED}")
    # Lines end at \n alone: a cell may hold U+2028 and the like.
    lines, item = io.StringIO(text, newline="\n"), None
    for item in (_of_lines if beginning in "{[" else _of_csv)(lines, name):
        if CLOUD not in item.values:
            raise InputError(f"{item.place} has no {CLOUD}, expected the file of a cloud or mesh")
        yield item
    if item is None:
        raise InputError(f"{name}: holds no item, expected one in each row")


def folder_of(manifest: Path | str) -> str:
    """What paths in a manifest are relative to; those of a folder's items are whole."""
    is_folder = isinstance(manifest, Path) and manifest.is_dir()
    return "" if is_folder else os.path.dirname(str(manifest))


def _read(manifest: Path | str) -> tuple[str, str]:
    """The text of a manifest, and what messages call it."""
    name = "stdin" if manifest == STDIN else str(manifest)
    if isinstance(manifest, str):
        data = read_remote(manifest)
    else:
        data = sys.stdin.buffer.read() if manifest == STDIN else read_bytes(manifest, EXPECTED)
    data = data.removeprefix(codecs.BOM_UTF8)
    try:
        text, place = data.decode(), data.find(b"\0")  # of UTF-16 without a mark of its own
    except UnicodeDecodeError as error:
        text, place = "", error.start
    if place >= 0:
        row = data.count(b"\n", 0, place) + 1
        raise InputError(
            f"{name}: is not UTF-8 (row {row} has the byte 0x{data[place]:02x}), expected "
            f"{EXPECTED}, in UTF-8"
        )
    # Excel for old Macs ends lines with CR alone.
    return (text if "\n" in text else text.replace("\r", "\n")), name


@lru_cache
def _column(name: str) -> str:
    return name.strip().casefold()


def _row(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = {_column(name): value for name, value in pairs}
    if len(values) < len(pairs):
        raise InputError(_twice([name for name, _ in pairs]))
    return values


def _twice(names: Iterable[str]) -> str:
    columns = list(map(_column, names))
    twice = next(name for name in columns if columns.count(name) > 1)
    return f"has the column {plain(twice)} twice, expected it once"


def _of_lines(lines: Iterator[str], name: str) -> Iterator[Item]:
    for number, line in enumerate(lines, 1):
        if not line.strip():
            continue
        place = f"{name}: row {number}"
        try:
            values = json.loads(line, object_pairs_hook=_row)
        except InputError as error:
            raise InputError(f"{place} {error}") from None
        except (ValueError, RecursionError) as error:
            raise InputError(
                f"{place} is not JSON ({reason(error)}), expected one object in each line"
            ) from None
        if not isinstance(values, dict):
            raise InputError(f"{place} is {shown(values)}, expected an object such as "
                             '{"cloud": "a.ply", "mask": "a.png"}')  # fmt: skip
        yield Item(place, {key: value for key, value in values.items() if value is not None})


def _of_csv(lines: Iterator[str], name: str) -> Iterator[Item]:
    first = next(lines)
    separator = _separator(first, name)
    rows = csv.reader(chain([first], lines), delimiter=separator, strict=True)
    quotes = "; several masks in one cell need quotes" if separator == SEPARATOR else ""
    try:
        header = list(map(_column, next(rows)))
        if len(set(filter(None, header))) < len([*filter(None, header)]):
            raise InputError(f"{name}: {_twice(filter(None, header))}")
        for row in rows:
            cells = list(map(str.strip, row))
            if not any(cells):
                continue
            # A cell may hold line breaks: the number is that of the line where the row ends.
            place = f"{name}: row {rows.line_num}"
            if len(cells) != len(header):
                raise InputError(
                    f"{place} has {len(cells)} cells, expected {len(header)} as in the first "
                    f"row{quotes}"
                )
            yield Item(place, {key: cell for key, cell in zip(header, cells, strict=True) if cell})
    except csv.Error as error:
        raise InputError(f"{name}: row {rows.line_num} is not CSV ({error})") from None


def _separator(header: str, name: str) -> str:
    """What separates the names of the columns: with it, one of them is `cloud`."""
    for separator in SEPARATORS:
        with suppress(csv.Error):
            cells = next(csv.reader([header], delimiter=separator), [])
            if CLOUD in map(_column, cells):
                return separator
    raise InputError(
        f"{name}: its first row is {plain(header.strip())}, expected the columns {CLOUD}, {MASK} "
        "and so on, with commas, semicolons or tabs between them"
    )


def _of_folder(folder: Path) -> Iterator[Item]:
    """Each cloud with the mask, or the folder of masks, and the camera that have its name."""
    places = [folder / part if (folder / part).is_dir() else folder for part in PARTS]
    clouds, masks, cameras = places
    # There, a folder NAME holds the masks.
    camera_ranks = [(ending,) for ending in (CAMERAS if cameras == folder else ("", *CAMERAS))]
    items: dict[str, Path] = {}
    without = []
    for path in sorted(clouds.rglob("*")):
        relative = path.relative_to(clouds)
        name = relative.with_suffix("").as_posix()
        hidden = any(part.startswith(".") for part in relative.parts)
        other = path.suffix.lower() not in IN_FOLDERS or name.endswith(RESULT)
        if hidden or other or not path.is_file():
            continue
        mask = _named(masks / name, MASKS, path, _holds_masks)
        if mask is None:
            without.append(relative)
            continue
        if name in items:
            raise InputError(
                f"{folder}: {items[name]} and {relative} have one name, expected one cloud of a "
                "name; or give a manifest"
            )
        items[name] = relative
        values = {CLOUD: str(path), MASK: str(mask)}
        if camera := _named(cameras / name, camera_ranks, path, Path.is_dir):
            values["camera"] = str(camera)
        values[OUTPUT] = f"{name}{RESULT}{output_suffix(path)}"
        yield Item(f"{folder}: {relative}", values)
    if without:
        names = ", ".join(map(str, without[:3]))
        more = f" and {len(without) - 3:,} more" if len(without) > 3 else ""
        raise InputError(f"{folder}: found no mask for the clouds {names}{more}; {BY_NAME}")
    if not items:
        raise InputError(f"{folder}: holds no cloud; {BY_NAME}")


def _holds_masks(folder: Path) -> bool:
    try:
        return folder.is_dir() and bool(masks_in(folder))
    except InputError:
        return False


def _named(
    name: Path, ranks: Iterable[tuple[str, ...]], cloud: Path, is_folder: Callable[[Path], bool]
) -> Path | None:
    """The file of that name, or the folder for the ending "", other than the cloud itself.

    It is of the first of the ``ranks`` of endings that has one. Raises InputError if that has two.
    """
    for endings in ranks:
        candidates = {Path(f"{name}{ending}"): ending for ending in endings}
        files = [
            path
            for path, ending in candidates.items()
            if path != cloud and (path.is_file() if ending else is_folder(path))
        ]
        if len(files) > 1:
            raise InputError(
                f"{cloud}: its mask may be {files[0]} or {files[1]}, expected one of the two; or "
                f"name it NAME{MASKS[0][1]}"
            )
        if files:
            return files[0]
    return None


def in_shard(name: str, shard: tuple[int, int]) -> bool:
    """Whether the i-th of n parts has an item, for ``shard`` (i, n) with i from 1 to n.

    The item's name alone decides, so that items of one name are in one part.
    """
    index, count = shard
    return zlib.crc32(name.encode(errors="surrogatepass")) % count == index - 1
