"""Point clouds: reads PLY (text and binary), .npy and tables of numbers; writes PLY."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from ..errors import InputError, TsoError
from ..geometry.arrays import Array, Indices
from ..geometry.points import longest_side
from .output import check_output, write_file
from .ply import PlyFile, new_ply
from .reading import TextTable, read_array, read_bytes, require_memory

SUFFIXES = (".ply", ".npy", ".xyz", ".txt")
# Squares of larger coordinates overflow.
_LARGEST = 1e100
# The most memory that a point takes in a refinement, if it only follows the control points.
BYTES_PER_POINT = 250


@dataclass(frozen=True, eq=False)
class PointCloud:
    """A cloud as read from a file."""

    points: Array  # [N, 3], in the file's order and units
    path: Path
    precision: str = "float64"  # or "float32", the type to write coordinates with
    # Set if the cloud was read from PLY, to write the file again with other coordinates.
    ply: PlyFile | None = field(default=None, repr=False)

    def colours(self) -> Array:
        """Red, green and blue [N, 3] of the points, in [0, 1]; InputError if there are none."""
        colours = self.ply.read_colours() if self.ply else None
        if colours is None:
            raise InputError(
                f"{self.path}: its points have no colours, "
                "expected a PLY file with red, green and blue"
            )
        return colours

    def faces(self) -> Indices | None:
        """Triangles [F, 3] of the points; None if the file has no faces.

        Raises InputError if a face names a point that does not exist.
        """
        return self.ply.read_faces() if self.ply else None


def read_cloud(path: str | Path, extended: bool = True) -> PointCloud:
    """Read a point cloud, or a mesh in PLY as its vertices; ``faces()`` of the result joins them.

    The suffix of the file decides how it is read:

    - .ply : text or binary;
    - .npy : an array [N, 3];
    - .xyz, .txt : at least three numbers per line, x y z first; lines that start with # are
      comments.

    Raises InputError if the file cannot be read, holds no point, or holds a coordinate that is not
    finite. With ``extended`` it also raises InputError if all points are equal.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES and not path.is_dir():
        raise InputError(
            f"{path}: the suffix {suffix!a} is not that of a point cloud, or of a mesh in PLY, "
            f"expected {', '.join(SUFFIXES)}"
        )
    data = read_bytes(path, "a point cloud")
    try:
        if suffix == ".ply":
            ply = PlyFile(data, path, BYTES_PER_POINT)
            precision = "float32" if set(ply.kinds) == {"f4"} else "float64"
            cloud = PointCloud(ply.read(), path, precision, ply)
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
    points: Array,
    like: PointCloud | None = None,
    overwrite: bool = False,
    dtype: Literal["float32", "float64"] | None = None,
) -> None:
    """Write ``points`` [N, 3] as a .ply file.

    If ``like`` was read from a PLY file, the new file is that file with other coordinates; every
    other byte stays. A warning names what is wrong after the move: normals, and the rotations and
    scales of Gaussian splats. Another warning says by how much the
    file's float rounds the result, if that is over 1e-4 of the cloud's longest side.

    Otherwise the type of the coordinates is ``dtype``, or the precision of ``like``. If neither is
    given, it is float32 as long as rounding moves no point by over a millionth of the cloud's
    longest side.

    Raises InputError if ``path`` is not a .ply or cannot be written, or if ``points`` and ``like``
    differ in number; TsoError if a coordinate is not finite or too large for its type. After an
    error nothing is written.
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
                    f"{path}: its coordinates are stored as float, as in {like.path}: rounding "
                    f"moves points by up to {rounding:.2g}, the cloud's longest side is "
                    f"{extent:.3g}; store the input as double to keep the result",
                    stacklevel=2,
                )
        data = like.ply.with_points(points)
        if (stale := like.ply.stale_after_moving) and data is not like.ply.data:
            warnings.warn(
                f"{path}: the {stale} are those of {like.path}, before the points moved",
                stacklevel=2,
            )
    else:
        precise = "float32" if rounding <= 1e-6 * extent else "float64"
        data = new_ply(points, dtype or (like.precision if like is not None else precise))
    write_file(path, data, overwrite)


def _from_array(data: bytes, path: Path) -> PointCloud:
    array = read_array(data, path)
    if array.ndim != 2 or array.shape[1] != 3 or array.dtype.kind not in "fiu":
        raise InputError(
            f"{path}: holds {array.dtype} {list(array.shape)}, expected numbers [N, 3]"
        )
    require_memory(path, BYTES_PER_POINT * len(array))
    precision = "float32" if array.dtype.kind == "f" and array.dtype.itemsize <= 4 else "float64"
    with np.errstate(all="ignore"):
        return PointCloud(np.ascontiguousarray(array, dtype=np.float64), path, precision)


def _from_text(data: bytes, path: Path) -> PointCloud:
    # A line of numbers takes at most 800 bytes while it is read.
    require_memory(path, 800 * data.count(b"\n"))
    table = TextTable(data, path)
    table.drop_comments()
    short = table.counts < 3
    if short.any():
        row = int(short.argmax())
        raise InputError(
            f"{path}: line {table.numbers[row]} has {table.counts[row]} columns, "
            "expected at least 3, separated by blanks"
        )
    points = table.values(table.first[:, None] + np.arange(3))
    if table.counts.max(initial=3) > 3:
        warnings.warn(
            f"{path}: only the first three of its columns are used, as x y z", stacklevel=3
        )
    return PointCloud(points, path)


def _check(points: Array, path: Path, extended: bool) -> None:
    count, least = len(points), 2 if extended else 1
    if count < least:
        noun = "point" if count == 1 else "points"
        raise InputError(f"{path}: {count} {noun}, expected at least {least}")
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        index = int(finite.argmin())
        raise InputError(
            f"{path}: {count - int(finite.sum())} of {count} points have a coordinate that is not "
            f"finite, the first is point {index} {points[index].tolist()}, expected numbers"
        )
    largest = np.abs(points).max()
    if largest > _LARGEST:
        raise InputError(f"{path}: a coordinate of {largest:g}, expected at most {_LARGEST:g}")
    if extended and longest_side(points) <= 1.0 / _LARGEST:
        raise InputError(
            f"{path}: all {count} points are the same {points[0].tolist()}, expected different ones"
        )
