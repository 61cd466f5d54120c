"""Tables of points: .xyz and .txt, .csv, .pts, and .pcd of the Point Cloud Library."""

from __future__ import annotations

import re
import warnings
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..geometry.arrays import Array
from .reading import TextTable, plain, require_memory

AXES = ("x", "y", "z")
_PCD_TYPES = {
    ("F", 4): "<f4", ("F", 8): "<f8", ("I", 1): "i1", ("I", 2): "<i2", ("I", 4): "<i4",
    ("I", 8): "<i8", ("U", 1): "u1", ("U", 2): "<u2", ("U", 4): "<u4", ("U", 8): "<u8",
}  # fmt: skip
_SEPARATORS = bytes.maketrans(b",;", b"  ")


def read_points(data: bytes, path: Path, bytes_per_point: int) -> Array:
    """The points [N, 3] of a table; InputError if it is damaged or has no x, y and z."""
    suffix = path.suffix.lower()
    if suffix == ".pcd":
        return _of_pcd(data, path, bytes_per_point)
    # A line of numbers takes at most 800 bytes while it is read.
    require_memory(path, 800 * data.count(b"\n"))
    columns = (0, 1, 2)
    if suffix == ".csv":
        columns, data = _of_header(data, path)
        data = data.translate(_SEPARATORS)
    table = TextTable(data, path)
    table.drop_comments()
    if suffix == ".pts" and len(table.counts) > 1 and table.counts[0] == 1:
        # The first line of a .pts file is the number of points.
        table.first, table.counts = table.first[1:], table.counts[1:]
        table.numbers = table.numbers[1:]
    needed = max(columns) + 1
    short = table.counts < needed
    if short.any():
        row = int(short.argmax())
        raise InputError(
            f"{path}: line {table.numbers[row]} has {table.counts[row]} columns, "
            f"expected at least {needed}, separated by blanks"
        )
    points = table.values(table.first[:, None] + np.array(columns))
    if table.counts.max(initial=3) > 3 and suffix not in (".csv", ".pts"):
        warnings.warn(
            f"{path}: only the first three of its columns are used, as x y z", stacklevel=4
        )
    return points


def _of_header(data: bytes, path: Path) -> tuple[tuple[int, int, int], bytes]:
    """The columns of x, y and z of a .csv file, and its text with the header blanked."""
    line, _, _ = data.lstrip(b"\xef\xbb\xbf").partition(b"\n")
    words = [word.strip(b" \t\r\"'/#").lower() for word in re.split(rb"[,;\t]", line)]
    if not any(re.search(rb"[a-df-z]", word) for word in words):
        return (0, 1, 2), data
    names = [word.decode("ascii", "replace") for word in words]
    places = []
    for axis in AXES:
        found = [
            i for i, name in enumerate(names) if name in (axis, f"point_{axis}", f"pos_{axis}")
        ]
        if len(found) != 1:
            raise InputError(
                f"{path}: its columns are {plain(', '.join(names))}, expected x, y and z"
            )
        places.append(found[0])
    start = data.index(line)
    return (places[0], places[1], places[2]), b" " * (start + len(line)) + data[start + len(line) :]


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
        require_memory(path, bytes_per_point * len(table.first))
        columns = np.array([places[names.index(axis)] for axis in AXES])
        points = table.values(table.first[:, None] + columns)
    elif form == "binary":
        both = enumerate(zip(types, counts, strict=True))
        of_point = np.dtype([(f"f{i}", kind, (n,)) for i, (kind, n) in both])
        size = of_point.itemsize
        count = total if total >= 0 else (len(data) - body) // size
        if body + count * size > len(data):
            raise InputError(f"{path}: ends early, expected {count:,} points of {size} bytes")
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
