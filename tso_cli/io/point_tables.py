"""Tables of points: .xyz and .txt, .csv, .pts, and .pcd of the Point Cloud Library."""

from __future__ import annotations

import codecs
import csv
import io
import itertools
import re
import struct
import warnings
from array import array
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..geometry.arrays import Array
from .output import reason
from .reading import TextTable, plain, require_memory, shown

AXES = ("x", "y", "z")
# What a column of x is called: plainly, by scanners, and by ParaView.
_NAMES = ("{0}", "point_{0}", "pos_{0}", "points:{1}", "points_{1}")
_SEPARATORS = ("\t", ";", ",")  # of a .csv file without blanks between its values
LONGEST_LINE = 1 << 20  # characters
_COLMAP_POINT = struct.Struct("<3d")  # x, y and z
_FIRST_LINES = 10  # of a .csv file, which say what separates its values
_PCD_TYPES = {
    ("F", 4): "<f4", ("F", 8): "<f8", ("I", 1): "i1", ("I", 2): "<i2", ("I", 4): "<i4",
    ("I", 8): "<i8", ("U", 1): "u1", ("U", 2): "<u2", ("U", 4): "<u4", ("U", 8): "<u8",
}  # fmt: skip


def read_points(data: bytes, path: Path, bytes_per_point: int) -> Array:
    """The points [N, 3] of a table; InputError if it is damaged or has no x, y and z."""
    suffix = path.suffix.lower()
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise InputError(f"{path}: is UTF-16 text, expected UTF-8; save it as CSV UTF-8")
    if suffix == ".pcd":
        return _of_pcd(data, path, bytes_per_point)
    _refuse_long_lines(data, path)
    if suffix == ".csv":
        require_memory(path, bytes_per_point * data.count(b"\n"))
        return _of_csv(data, path)
    # A line of numbers takes at most 800 bytes while it is read.
    require_memory(path, 800 * data.count(b"\n"))
    table = TextTable(data, path)
    table.drop_comments()
    stated_count = -1
    if suffix == ".pts" and len(table.counts) > 1 and table.counts[0] == 1:
        # The first line of a .pts file is the number of points.
        stated_count = table.values(table.first[:1])[0]
        table.first, table.counts = table.first[1:], table.counts[1:]
        table.numbers = table.numbers[1:]
    short = table.counts < 3
    if short.any():
        row = int(short.argmax())
        count = table.counts[row]
        raise InputError(
            f"{path}: line {table.numbers[row]} has {count} column{'s' if count > 1 else ''}, "
            f"expected at least 3, separated by blanks{_of_commas(table, row)}"
        )
    if stated_count >= 0:
        _check_count(path, len(table.first), stated_count, "its first line")
    points = table.values(table.first[:, None] + np.arange(3))
    if table.counts.max(initial=3) > 3 and suffix != ".pts":
        warn_of_columns(path)
    return points


def read_colmap(data: bytes, path: Path, bytes_per_point: int) -> tuple[Array, Array]:
    """The points [N, 3] of a COLMAP model and their colours [N, 3] in [0, 1].

    A row has a number, x, y, z, red, green and blue, an error, and the track of the point.
    """
    if path.suffix.lower() == ".txt":
        _refuse_long_lines(data, path)
        require_memory(path, 800 * data.count(b"\n"))
        table = TextTable(data, path)
        table.drop_comments()
        if (table.counts < 8).any():
            row = int((table.counts < 8).argmax())
            raise InputError(
                f"{path}: line {table.numbers[row]} has {table.counts[row]} columns, expected at "
                "least 8: POINT3D_ID X Y Z R G B ERROR"
            )
        values = table.values(table.first[:, None] + np.arange(1, 7))
        points, colours = values[:, :3], values[:, 3:]
    else:
        # A point has 43 bytes and 8 more for each picture of its track.
        stated_count = struct.unpack_from("<Q", data)[0] if len(data) >= 8 else 1
        require_memory(path, bytes_per_point * min(stated_count, len(data) // 43))
        coordinates, bytes_of_colours, at = array("d"), bytearray(), 8
        try:
            for _ in range(stated_count):
                coordinates.extend(_COLMAP_POINT.unpack_from(data, at + 8))
                bytes_of_colours += data[at + 32 : at + 35]
                at += 51 + 8 * struct.unpack_from("<Q", data, at + 43)[0]
        except struct.error:
            at = len(data) + 1
        if at != len(data):
            raise InputError(
                f"{path}: ends early, or holds more than the {stated_count:,} points that it "
                "states, expected a whole points3D.bin; write the model again"
            )
        points = np.array(coordinates).reshape(-1, 3)
        colours = np.frombuffer(bytes(bytes_of_colours), np.uint8).reshape(-1, 3).astype(np.float64)
    if not ((colours >= 0.0) & (colours <= 255.0)).all():
        raise InputError(
            f"{path}: its colours span {colours.min():g} to {colours.max():g}, expected 0 to 255"
        )
    return points, colours / 255.0


def _refuse_long_lines(data: bytes, path: Path) -> None:
    """Raise InputError at a line that is too long for a point: it would take gigabytes."""
    for begin in range(0, len(data) - LONGEST_LINE + 1, LONGEST_LINE):
        end = begin + LONGEST_LINE
        if data.find(b"\n", begin, end) < 0 and data.find(b"\r", begin, end) < 0:
            raise InputError(
                f"{path}: a line has over {LONGEST_LINE:,} characters, expected a line for each "
                "point"
            )


def _of_commas(table: TextTable, row: int) -> str:
    """The advice for a line whose values are separated by commas."""
    start = table.starts[table.first[row]]
    line = table.data[start : start + 200].splitlines()[0]
    return "; rename it to .csv, for commas" if line.count(b",") > 1 else ""


def warn_of_columns(path: Path) -> None:
    warnings.warn(f"{path}: only the first three of its columns are used, as x y z", stacklevel=5)


class _Header(NamedTuple):
    """columns : of x, y and z. first : the first row, if it has numbers. most : cells of a row."""

    columns: tuple[int, int, int]
    first: list[list[str]]
    most: int


def _check_count(path: Path, count: int, stated_count: float, where: str) -> None:
    """Raise InputError unless a file has as many points as it states."""
    if count != stated_count:
        begin = "ends early: it has" if count < stated_count else "has"
        raise InputError(
            f"{path}: {begin} {count:,} lines of points, {where} states "
            f"{stated_count:,.15g}, expected the same; write the file again"
        )


def _of_csv(data: bytes, path: Path) -> Array:
    """The points of a .csv file: the columns called x, y and z, or the first three."""
    separator = _separator(data)
    if separator in "\t;":
        data = data.replace(b",", b".")  # commas are decimal where they do not separate
    text = io.TextIOWrapper(io.BytesIO(data), encoding="utf-8-sig", errors="replace", newline=None)
    rows = csv.reader(text, delimiter=separator, skipinitialspace=True, strict=True)
    # float() would read 1_0 as 10, and digits of other scripts.
    number = float if data.isascii() and b"_" not in data else _number
    values = array("d")
    try:
        columns, first, named = _header(rows, path)
        begin, middle, end = columns
        for row in itertools.chain(first, rows):
            if not row or row[0].startswith("#"):
                continue
            if len(row) > named and any(row[named:]):
                raise InputError(
                    f"{path}: line {rows.line_num} has {len(row)} values, its header {named}, "
                    "expected as many; if commas are decimal, separate values with semicolons"
                )
            try:
                values.extend((number(row[begin]), number(row[middle]), number(row[end])))
            except (ValueError, IndexError):
                if any(row):  # spreadsheets write lines of separators alone
                    raise _wrong_row(path, rows.line_num, row, columns) from None
    except csv.Error as error:
        raise InputError(
            f"{path}: line {rows.line_num} is no row of a .csv file ({reason(error)}), expected "
            "values and separators, and quotes in pairs"
        ) from None
    return np.array(values).reshape(-1, 3)


def _separator(data: bytes) -> str:
    """What stands between values in each of the first lines: tab, semicolon or comma, or blanks."""
    lines = [line.strip() for line in data[: 1 << 20].splitlines()]
    lines = [re.sub(rb'"[^"]*"', b"", line) for line in lines if line][:_FIRST_LINES]
    # A comment may have any words, but a header may begin like a comment.
    lines = [line for line in lines if not line.startswith(b"#")] or lines
    return next((s for s in _SEPARATORS if all(s.encode() in line for line in lines)), " ")


def _header(rows: Iterator[list[str]], path: Path) -> _Header:
    """The columns of a .csv file, by the names in its header or else the first three."""
    for row in rows:
        names = [cell.strip(" \"'/#").lower() for cell in row]
        for form in _NAMES:
            axis_names = [form.format(axis, place) for place, axis in enumerate(AXES)]
            if all(names.count(name) == 1 for name in axis_names):
                x, y, z = map(names.index, axis_names)
                return _Header((x, y, z), [], len(row))
        if not any(row) or row[0].startswith("#"):
            continue
        if re.search(r"[a-df-z]", " ".join(names[:3])):
            raise InputError(
                f"{path}: its columns are {plain(', '.join(names))}, expected x, y and z; name "
                "these columns so"
            )
        if len(row) > 3 and any(row[3:]):
            warn_of_columns(path)
        return _Header((0, 1, 2), [row], LONGEST_LINE)
    return _Header((0, 1, 2), [], LONGEST_LINE)


def _number(cell: str) -> float:
    return float(cell if cell.isascii() and "_" not in cell else "")


def _wrong_row(path: Path, line: int, row: list[str], columns: tuple[int, ...]) -> InputError:
    """The error of a row whose x, y or z is not a number."""
    if len(row) <= max(columns):
        count, least = len(row), max(columns) + 1
        return InputError(f"{path}: line {line} has {count} columns, expected at least {least}")
    words = ""
    for axis, place in zip(AXES, columns, strict=True):
        try:
            _number(row[place])
        except ValueError:
            cell = row[place].strip()
            words = f"{shown(cell) if cell else 'an empty cell'} as {axis}"
            if cell.count(".") > 1:
                words += " (commas are decimal, so it has several points)"
            break
    return InputError(
        f"{path}: line {line} has {words}, expected a number such as 0.5 or 1e-3; "
        "write one or leave the line out"
    )


def _of_pcd(data: bytes, path: Path, bytes_per_point: int) -> Array:
    match = re.search(rb"^DATA[ \t]+(\w+)[ \t]*\r?\n", data[: 1 << 16], re.MULTILINE)
    if match is None:
        raise InputError(f"{path}: has no DATA line, expected the header of a .pcd file")
    header: dict[str, list[str]] = {}
    for line in data[: match.start()].decode("ascii", "replace").splitlines():
        words = line.split()
        if words and not words[0].startswith("#"):
            header[words[0].upper()] = words[1:]
    names, form = header.get("FIELDS", []), match[1].decode().lower()
    missing = [axis for axis in AXES if axis not in names]
    if missing:
        raise InputError(
            f"{path}: its fields are {plain(' '.join(names)) or 'none'}, expected x, y and z"
        )
    if form == "binary_compressed":
        raise InputError(
            f"{path}: is compressed, expected DATA ascii or binary; convert it: "
            "pcl_convert_pcd_ascii_binary IN OUT 1"
        )
    try:
        counts = [int(word) for word in header.get("COUNT", ["1"] * len(names))]
        sizes = [int(word) for word in header["SIZE"]]
        types = [_PCD_TYPES[kind, size] for kind, size in zip(header["TYPE"], sizes, strict=True)]
        total = int(header["POINTS"][0]) if "POINTS" in header else -1
        if not len(names) == len(types) == len(counts) or min(counts) < 1 or max(counts) > 4096:
            raise ValueError
    except (KeyError, ValueError, IndexError):
        raise InputError(
            f"{path}: SIZE, TYPE, COUNT or POINTS of its header is wrong, expected one for each "
            "field"
        ) from None
    body, places = match.end(), np.cumsum([0, *counts])
    if form == "ascii":
        table = TextTable(data, path, body, data.count(b"\n", 0, body))
        if (table.counts != places[-1]).any():
            row = int((table.counts != places[-1]).argmax())
            raise InputError(
                f"{path}: line {table.numbers[row]} has {table.counts[row]} values, expected "
                f"{places[-1]}"
            )
        if total >= 0:
            _check_count(path, len(table.first), total, "POINTS")
        require_memory(path, bytes_per_point * len(table.first))
        columns = np.array([places[names.index(axis)] for axis in AXES])
        points = table.values(table.first[:, None] + columns)
    elif form == "binary":
        both = enumerate(zip(types, counts, strict=True))
        of_point = np.dtype([(f"f{i}", kind, (n,)) for i, (kind, n) in both])
        size = of_point.itemsize
        count = total if total >= 0 else (len(data) - body) // size
        if body + count * size > len(data):
            raise InputError(
                f"{path}: ends early: it has {(len(data) - body) // size:,} points of {size} "
                f"bytes, POINTS states {count:,}, expected the same; write the file again"
            )
        if rest := data[body + count * size :].strip():
            raise InputError(
                f"{path}: {len(rest):,} bytes follow its {count:,} points of {size} bytes, "
                "expected the end of the file; check POINTS and write the file again"
            )
        require_memory(path, bytes_per_point * count)
        rows = np.frombuffer(data, of_point, count, body)
        columns_of = [rows[f"f{names.index(axis)}"][:, 0] for axis in AXES]
        with np.errstate(invalid="ignore"):
            points = np.stack(columns_of, 1).astype(np.float64)
    else:
        raise InputError(f"{path}: DATA is {plain(form)}, expected ascii or binary")
    # Invalid points of an organised cloud are NaN.
    valid = np.isfinite(points).all(1)
    if not valid.all() and valid.any():
        warnings.warn(
            f"{path}: {int((~valid).sum()):,} of {len(points):,} points are NaN and left out",
            stacklevel=4,
        )
        points = points[valid]
    return points
