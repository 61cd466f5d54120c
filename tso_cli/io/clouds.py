"""Point clouds: PLY (text and binary), .npy and tables of numbers in; PLY out."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, TsoError
from ..geometry.points import longest_side
from .output import atomic_output, check_output
from .ply import PlyFile, new_ply
from .reading import TextTable, read_array, read_bytes, require_memory

Points = NDArray[np.float64]
SUFFIXES = (".ply", ".npy", ".xyz", ".txt")
_LARGEST = 1e100  # beyond it squares of coordinates overflow
BYTES_A_POINT, BYTES_A_TEXT_LINE = 250, 800
"""Most memory a point takes that follows others in a refinement; and a line of numbers while it is read."""


@dataclass(frozen=True, eq=False)
class PointCloud:
    """A cloud as read from a file."""

    points: Points  # [N, 3], in the file's order and units
    path: Path
    precision: str = "float64"  # or "float32", the type to write coordinates with
    ply: PlyFile | None = field(
        default=None, repr=False
    )  # to write it again with other coordinates

    def colours(self) -> Points:
        """Red, green and blue [N, 3] of the points, in [0, 1]; InputError where the file has none or no such numbers."""
        colours = self.ply.read_colours() if self.ply else None
        if colours is None:
            raise InputError(
                f"{self.path}: its points have no colours, expected red, green and blue of a PLY file"
            )
        return colours

    def faces(self) -> NDArray[np.int64] | None:
        """Triangles [F, 3] of the points; None where the file has no faces, InputError where they name other points."""
        return self.ply.read_faces() if self.ply else None


def read_cloud(path: str | Path, extended: bool = True) -> PointCloud:
    """Read a point cloud; of a mesh in PLY, its vertices, which ``faces()`` of the result joins.

    The suffix decides: .ply; .npy with an array [N, 3]; .xyz and .txt with three numbers or more a line, of which the first
    three count, and comment lines that start with #. Raises InputError if the file cannot be read, holds no point or one that
    is not finite, or (``extended``) has no extent.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES and not path.is_dir():
        expected = f"expected {', '.join(SUFFIXES)}"
        raise InputError(
            f"{path}: the suffix {suffix!a} is not that of a point cloud, or of a mesh in PLY, {expected}"
        )
    data = read_bytes(path, "a point cloud")
    try:
        if suffix == ".ply":
            ply = PlyFile(data, path, BYTES_A_POINT)
            cloud = PointCloud(
                ply.read(), path, "float32" if set(ply.kinds) == {"f4"} else "float64", ply
            )
        elif suffix == ".npy":
            cloud = _from_array(data, path)
        else:
            cloud = _from_text(data, path)
    except MemoryError:
        raise InputError(f"{path}: does not fit into memory") from None
    _check(cloud.points, path, extended)
    return cloud


def write_cloud(
    path: str | Path,
    points: Points,
    like: PointCloud | None = None,
    overwrite: bool = False,
    dtype: Literal["float32", "float64"] | None = None,
) -> None:
    """Write ``points`` [N, 3] as a .ply file.

    With a ``like`` from a PLY file, all of that file but the coordinates stays byte for byte; a warning says what is still of
    the old points: normals, and the rotations and scales of Gaussian splats. Else coordinates have the type ``dtype``, by
    default the precision of ``like``; without one float32 where that moves no point by over a millionth of the cloud's extent.

    Raises InputError if ``path`` is not a .ply or cannot be written, or ``points`` are not as many as those of ``like``;
    TsoError if a coordinate is not finite or too large for its type. Nothing is written then.
    """
    path = Path(path)
    if path.suffix.lower() != ".ply":
        raise InputError(
            f"{path}: the suffix is {path.suffix!a}, expected .ply for a point cloud to write"
        )
    check_output(path, overwrite)
    points = np.asarray(points, dtype=np.float64)
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        raise TsoError(f"{path}: point {finite.argmin()} is not finite, nothing was written")
    if like is not None and len(points) != len(like.points):
        raise InputError(
            f"{path}: {len(points)} points to write, expected {len(like.points)} as in {like.path}"
        )
    with np.errstate(over="ignore", invalid="ignore"):
        rounding = np.abs(points.astype(np.float32) - points).max(initial=0.0)
    extent = longest_side(points) if len(points) else 0.0
    if like is not None and like.ply is not None:
        if "f4" in like.ply.kinds:
            if np.isinf(rounding):
                raise TsoError(f"{path}: a coordinate does not fit into the float of {like.path}")
            if rounding > 1e-4 * extent:
                warnings.warn(
                    f"{path}: its coordinates are stored as float, as in {like.path}: rounding moves points by up to "
                    f"{rounding:.2g}, the cloud's longest side is {extent:.3g}; store the input as double to keep the result",
                    stacklevel=2,
                )
        data = like.ply.with_points(points)
        if (oriented := like.ply.oriented) and data is not like.ply.data:
            warnings.warn(
                f"{path}: the {oriented} are those of {like.path}, before the points moved",
                stacklevel=2,
            )
    else:
        precise = "float32" if rounding <= 1e-6 * extent else "float64"
        data = new_ply(points, dtype or (like.precision if like is not None else precise))
    with atomic_output(path, overwrite) as temporary:
        temporary.write_bytes(data)


def _from_array(data: bytes, path: Path) -> PointCloud:
    array = read_array(data, path)
    if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind not in "fiu":
        raise InputError(
            f"{path}: holds {array.dtype} {list(array.shape)}, expected numbers [N, 3]"
        )
    require_memory(path, BYTES_A_POINT * len(array))
    precision = "float32" if array.dtype.kind == "f" and array.dtype.itemsize <= 4 else "float64"
    with np.errstate(all="ignore"):
        return PointCloud(np.ascontiguousarray(array, dtype=np.float64), path, precision)


def _from_text(data: bytes, path: Path) -> PointCloud:
    require_memory(path, BYTES_A_TEXT_LINE * data.count(b"\n"))
    table = TextTable(data, path)
    table.drop_comments()
    short = table.counts < 3
    if short.any():
        row = int(short.argmax())
        raise InputError(
            f"{path}: line {table.numbers[row]} has {table.counts[row]} columns, expected at least 3, parted by blanks"
        )
    points = table.values(table.first[:, None] + np.arange(3))
    if table.counts.max(initial=3) > 3:
        warnings.warn(
            f"{path}: only the first three of its columns are used, as x y z", stacklevel=3
        )
    return PointCloud(points, path)


def _check(points: Points, path: Path, extended: bool) -> None:
    count, least = len(points), 2 if extended else 1
    if count < least:
        raise InputError(f"{path}: {count} point{'s' * (count != 1)}, expected at least {least}")
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        index = int(finite.argmin())
        raise InputError(
            f"{path}: {count - int(finite.sum())} of {count} points have a coordinate that is not finite, "
            f"the first is point {index} {points[index].tolist()}"
        )
    largest = np.abs(points).max()
    if largest > _LARGEST:
        raise InputError(f"{path}: a coordinate of {largest:g}, expected at most {_LARGEST:g}")
    if extended and longest_side(points) <= 1.0 / _LARGEST:
        raise InputError(
            f"{path}: all {count} points are the same {points[0].tolist()}, expected different ones"
        )
