"""The items of a batch: rows of a CSV or JSON Lines file, or the files of a folder by their names.

An item is what one run of `tso refine` is given: the name of an option -> its value.
"""

from __future__ import annotations

import csv
import io
import json
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

from ..errors import InputError
from ..evaluation.pairs import CAMERAS, MASKS
from ..io.clouds import SUFFIXES
from ..io.output import reason
from ..io.reading import plain, read_bytes, shown

One = TypeVar("One")
STDIN = Path("-")
# Columns that are not options of `tso refine` by that name.
CLOUD, MASK, OUTPUT = "cloud", "mask", "output"
EXPECTED = "a manifest of items (CSV or JSON Lines) or a folder"
SEPARATOR = ";"  # of several files in one cell
# A folder may hold its kinds of files apart.
PARTS = ("clouds", "masks", "cameras")
# In a folder, a .txt file is more often a note than a cloud, and an array may be anything.
IN_FOLDERS = tuple(suffix for suffix in SUFFIXES if suffix not in (".txt", ".npz", ".pt"))
RESULT = ".refined"  # what names of results end in


@dataclass(frozen=True)
class Item:
    """One row. ``place`` is what messages call it: "items.csv: row 3"."""

    place: str
    values: dict[str, Any]


def read_manifest(path: Path) -> list[Item]:
    """The items of a manifest, of a folder, or of stdin (``-``).

    A CSV file names its columns in the first row; an empty cell says nothing. JSON Lines have one
    object in each line. Raises InputError with the row, and the column where there is one.
    """
    if path.is_dir():
        return _of_folder(path)
    if path == STDIN:
        data, path = sys.stdin.buffer.read(), Path("stdin")
    else:
        data = read_bytes(path, EXPECTED)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not text, expected {EXPECTED}") from None
    lines = text.lstrip()[:1] in ("{", "[")
    items = list(_of_lines(text, path) if lines else _of_csv(text, path))
    if not items:
        raise InputError(f"{path}: holds no item, expected one in each row")
    for item in items:
        if CLOUD not in item.values:
            raise InputError(f"{item.place} has no {CLOUD}, expected the file of a cloud or mesh")
    return items


def _of_lines(text: str, path: Path) -> Iterator[Item]:
    for number, line in enumerate(text.splitlines(), 1):
        if not line.strip():
            continue
        place = f"{path}: row {number}"
        try:
            values = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise InputError(
                f"{place} is not JSON ({reason(error)}), expected one object in each line"
            ) from None
        if not isinstance(values, dict):
            raise InputError(f"{place} is {shown(values)}, expected an object such as "
                             '{"cloud": "a.ply", "mask": "a.png"}')  # fmt: skip
        yield Item(place, {key: value for key, value in values.items() if value is not None})


def _of_csv(text: str, path: Path) -> Iterator[Item]:
    rows = csv.reader(io.StringIO(text), strict=True)
    try:
        header = [name.strip() for name in next(rows, [])]
        if CLOUD not in header:
            raise InputError(
                f"{path}: its columns are {plain(', '.join(header))}, expected {CLOUD}, {MASK} "
                "and so on in the first row"
            )
        twice = next((name for name in header if header.count(name) > 1), None)
        if twice is not None:
            raise InputError(f"{path}: has the column {plain(twice)} twice, expected it once")
        for row in rows:
            # A cell may hold line breaks: the number is that of the line where the row ends.
            place = f"{path}: row {rows.line_num}"
            if not any(cell.strip() for cell in row):
                continue
            if len(row) != len(header):
                raise InputError(
                    f"{place} has {len(row)} cells, expected {len(header)} as in the first row"
                )
            cells = zip(header, (cell.strip() for cell in row), strict=True)
            yield Item(place, {name: cell for name, cell in cells if cell})
    except csv.Error as error:
        raise InputError(f"{path}: row {rows.line_num} is not CSV ({error})") from None


def _of_folder(folder: Path) -> list[Item]:
    """Each cloud with the mask, or the folder of masks, and the camera that have its name."""
    places = [folder / part if (folder / part).is_dir() else folder for part in PARTS]
    clouds, masks, cameras = places
    items, without = [], []
    for path in sorted(clouds.rglob("*")):
        relative = path.relative_to(clouds)
        name = relative.with_suffix("").as_posix()
        hidden = any(part.startswith(".") for part in relative.parts)
        if hidden or path.suffix.lower() not in IN_FOLDERS or name.endswith(RESULT):
            continue
        mask = _named(masks / name, ("", *MASKS), path)
        if mask is None:
            without.append(relative)
            continue
        values = {CLOUD: str(path), MASK: str(mask)}
        apart = ("",) if cameras != folder else ()  # there, a folder NAME holds the masks
        if camera := _named(cameras / name, (*apart, *CAMERAS), path):
            values["camera"] = str(camera)
        items.append(Item(f"{folder}: {relative}", values))
    if not items or without:
        names = ", ".join(map(str, without[:3])) or "none"
        more = f" and {len(without) - 3:,} more" if len(without) > 3 else ""
        raise InputError(
            f"{folder}: found no mask for the clouds {names}{more}; expected NAME.png or "
            "NAME.mask.png next to NAME.ply, or the folders clouds, masks and cameras; or give a "
            "manifest (CSV with the columns cloud and mask)"
        )
    return items


def _named(name: Path, endings: tuple[str, ...], cloud: Path) -> Path | None:
    """The file of that name, or the folder if ``endings`` have "", other than the cloud itself."""
    for ending in endings:
        path = Path(f"{name}{ending}")
        found = path.is_dir() and path != cloud.parent if not ending else path.is_file()
        if found and path != cloud:
            return path
    return None


def shard_of(items: list[One], shard: tuple[int, int]) -> list[One]:
    """Every n-th item from the i-th on, for ``shard`` (i, n) with i from 1 to n."""
    index, count = shard
    return items[index - 1 :: count]
