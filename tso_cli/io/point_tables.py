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
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import InputError
from ..geometry.arrays import Array
from .guard import reading
from .output import reason
from .reading import TextTable, plain, require_memory, shown

AXES = ("x", "y", "z")
# What a column of x is called: plainly, by scanners, and by ParaView.
_NAMES = ("{0}", "point_{0}", "pos_{0}", "points:{1}", "points_{1}")
_SEPARATORS = ("\t", ";", ",")  # of a .csv file without blanks between its values
LONGEST_LINE = 1 << 20  # characters
_FIRST_ROWS = 1000  # which say what the columns after the first three hold
_COLMAP_POINT = struct.Struct("<3d")  # x, y and z
_FIRST_LINES = 10  # of a .csv file, which say what separates its values
_PCD_KINDS = {"F": "f", "I": "i", "U": "u"}
Columns = tuple[int, int, int]


def read_points(
    data: bytes, path: Path, bytes_per_point: int, columns: Columns | None = None
) -> Array:
    """The points [N, 3] of a table; InputError if it is damaged or has no x, y and z.

    ``columns`` : the places of x, y and z in a row, from 0 (None: by their names, or the first).
    """
    suffix = path.suffix.lower()
    if data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        raise InputError(f"{path}: is UTF-16 text, expected UTF-8; save it as CSV UTF-8")
    if suffix == ".pcd":
        return _of_pcd(data, path, bytes_per_point)
    data = data.removeprefix(codecs.BOM_UTF8)
    _refuse_long_lines(data, path)
    if suffix == ".csv" or (suffix != ".pts" and _is_like_csv(data)):
        require_memory(path, bytes_per_point * data.count(b"\n"))
        return _of_csv(data, path, columns)
    # A line of numbers takes at most 800 bytes while it is read.
    require_memory(path, 800 * data.count(b"\n"))
    table = TextTable(data, path)
    table.drop_comments()
    stated_count = -1
    if len(table.counts) > 1 and table.counts[0] == 1:
        # The first line of a .pts file, and of some others, is the number of points.
        stated_count = table.values(table.first[:1])[0]
        table.first, table.counts = table.first[1:], table.counts[1:]
        table.numbers = table.numbers[1:]
    _require_columns(table, 1 + max(columns or (2,)), ", separated by blanks")
    if stated_count >= 0:
        _check_count(path, len(table.first), stated_count, "its first line")
    points = table.values(table.first[:, None] + np.array(columns or (0, 1, 2)))
    if columns is None and table.counts.size and table.counts.min() > 3:
        more = table.first[:_FIRST_ROWS, None] + np.arange(3, min(table.counts.min(), 6))
        try:
            values = table.values(more)
        except InputError:
            values = np.empty((0, 0))  # of columns with words
        _refuse_others(points, values, path)
    if columns is None and table.counts.max(initial=3) > 3 and suffix != ".pts":
        warn_of_columns(path)
    return points


def _is_like_csv(data: bytes) -> bool:
    """Whether commas or semicolons separate the values of a table, or names stand above them."""
    first = data[:4096].strip().partition(b"\n")[0]
    words = [word.strip(b"\"'/#").lower() for word in re.split(rb"[\s,;]+", first)]
    return _separator(data) in ",;" or any(f.format("x", 0).encode() in words for f in _NAMES)


def _refuse_others(points: Array, more: Array, path: Path) -> None:
    """Raise InputError if the first columns hold numbers of lines, or colours, before x, y and z.

    ``points`` [N, 3] : these columns. ``more`` [M, C] : the next ones, of the first rows.
    """
    lines, whole = points[:, 0], (points == np.rint(points)).all()
    steps = np.diff(lines)
    counts = len(lines) > 3 and bool((lines == np.rint(lines)).all()) and steps[0] != 0.0
    if counts and (steps == steps[0]).all():
        what, places = "its first column counts its lines", "2,3,4"
    elif more.shape[1:] == (3,) and whole and (points >= 0.0).all() and (points <= 255.0).all():
        if (more == np.rint(more)).all():
            return  # coordinates of voxels
        what, places = "its first three columns are whole numbers up to 255, as of colours", "4,5,6"
    else:
        return
    raise InputError(
        f"{path}: {what}, expected x, y and z first; tso convert writes other columns: `columns` "
        f"{places}"
    )


def read_colmap(data: bytes, path: Path, bytes_per_point: int) -> tuple[Array, Array]:
    """The points [N, 3] of a COLMAP model and their colours [N, 3] in [0, 1].

    A row has a number, x, y, z, red, green and blue, an error, and the track of the point.
    """
    if path.suffix.lower() == ".txt":
        _refuse_long_lines(data, path)
        require_memory(path, 800 * data.count(b"\n"))
        table = TextTable(data, path)
        table.drop_comments()
        _require_columns(table, 8, ": POINT3D_ID X Y Z R G B ERROR")
        values = table.values(table.first[:, None] + np.arange(1, 7))
        points, colours = values[:, :3], values[:, 3:]
    else:
        coordinates, bytes_of_colours, at = array("d"), bytearray(), 8
        with reading(path, "a whole points3D.bin; write the model again"):
            (stated_count,) = struct.unpack_from("<Q", data)
            # A point has 43 bytes and 8 more for each picture of its track.
            require_memory(path, bytes_per_point * min(stated_count, len(data) // 43))
            for _ in range(stated_count):
                coordinates.extend(_COLMAP_POINT.unpack_from(data, at + 8))
                bytes_of_colours += data[at + 32 : at + 35]
                at += 51 + 8 * struct.unpack_from("<Q", data, at + 43)[0]
            if at != len(data):
                raise ValueError(f"{stated_count:,} points take {at:,} of {len(data):,} bytes")
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


def _require_columns(table: TextTable, least: int, words: str) -> None:
    """Raise InputError at a line with fewer columns; ``words`` say more of them."""
    if (short := table.counts < least).any():
        row = int(short.argmax())
        count = table.counts[row]
        has = f"line {table.numbers[row]} has {count} column{'s' if count > 1 else ''}"
        raise InputError(f"{table.path}: {has}, expected at least {least}{words}")


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


def _of_csv(data: bytes, path: Path, chosen: Columns | None) -> Array:
    """The points of a .csv file: the columns called x, y and z, or the first three."""
    begun: list[list[str]] = []  # the rows of a file without names
    separator = _separator(data)
    if separator in "\t;":
        data = data.replace(b",", b".")  # commas are decimal where they do not separate
    text = io.TextIOWrapper(io.BytesIO(data), encoding="utf-8-sig", errors="replace", newline=None)
    rows = csv.reader(text, delimiter=separator, skipinitialspace=True, strict=True)
    # float() would read 1_0 as 10, and digits of other scripts.
    number = float if data.isascii() and b"_" not in data else _number
    values = array("d")
    try:
        columns, first, named = _header(rows, path, chosen)
        begin, middle, end = columns
        for row in itertools.chain(first, rows):
            if not row or row[0].startswith("#"):
                continue
            if chosen is None and named == LONGEST_LINE and len(begun) < _FIRST_ROWS:
                begun.append(row[3:6])
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
    points = np.array(values).reshape(-1, 3)
    with suppress(ValueError):  # of columns with words, or of rows of several lengths
        more = np.array([row for row in begun if row], dtype=np.float64)
        if more.ndim == 2:
            _refuse_others(points, more, path)
    return points


def _separator(data: bytes) -> str:
    """What stands between values in each of the first lines: tab, semicolon or comma, or blanks."""
    lines = [line.strip() for line in data[: 1 << 20].splitlines()]
    lines = [re.sub(rb'"[^"]*"', b"", line) for line in lines if line][:_FIRST_LINES]
    # A comment may have any words, but a header may begin like a comment.
    lines = [line for line in lines if not line.startswith(b"#")] or lines
    return next((s for s in _SEPARATORS if all(s.encode() in line for line in lines)), " ")


def _header(rows: Iterator[list[str]], path: Path, chosen: Columns | None) -> _Header:
    """The columns of a .csv file: those ``chosen``, by the names in its header, or the first three.

    A row with a word in place of a chosen number is a header.
    """
    for row in rows:
        if chosen is not None:
            wordy = re.search(r"[a-df-z]", " ".join(row[i] for i in chosen if i < len(row)).lower())
            return _Header(chosen, [] if wordy else [row], LONGEST_LINE)
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
    header = {}
    with reading(path, "a header with the FIELDS x, y and z, and SIZE and TYPE of each field"):
        for line in data[: match.start()].decode("ascii", "replace").splitlines():
            name, *words = line.split() or ["#"]
            header[name.upper()] = words
        names = header["FIELDS"]
        columns = [names.index(axis) for axis in AXES]
        counts = [int(word) for word in header.get("COUNT", ["1"] * len(names))]
        types = zip(names, header["TYPE"], header["SIZE"], counts, strict=True)
        of_point = np.dtype([
            (f"f{i}", f"<{_PCD_KINDS[kind]}{size}", (count,))
            for i, (_, kind, size, count) in enumerate(types)
        ])  # fmt: skip
        total = int(header["POINTS"][0]) if "POINTS" in header else -1
    body, form = match.end(), match[1].decode().lower()
    if form == "ascii":
        table = TextTable(data, path, body, data.count(b"\n", 0, body))
        places = np.cumsum([0, *counts])
        if (table.counts != places[-1]).any():
            row = int((table.counts != places[-1]).argmax())
            raise InputError(
                f"{path}: line {table.numbers[row]} has {table.counts[row]} values, expected "
                f"{places[-1]}"
            )
        if total >= 0:
            _check_count(path, len(table.first), total, "POINTS")
        require_memory(path, bytes_per_point * len(table.first))
        points = table.values(table.first[:, None] + places[columns])
    elif form == "binary":
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
        with np.errstate(invalid="ignore"):
            points = np.stack([rows[f"f{i}"][:, 0] for i in columns], 1).astype(np.float64)
    else:
        raise InputError(
            f"{path}: DATA is {plain(form)}, expected ascii or binary; convert it: "
            "pcl_convert_pcd_ascii_binary IN OUT 1"
        )
    # Invalid points of an organised cloud are NaN.
    valid = np.isfinite(points).all(1)
    if not valid.all() and valid.any():
        warnings.warn(
            f"{path}: {int((~valid).sum()):,} of {len(points):,} points are NaN and left out",
            stacklevel=4,
        )
        points = points[valid]
    return points
