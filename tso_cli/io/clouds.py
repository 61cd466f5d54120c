"""Point clouds, and meshes whose vertices move: reads many formats; writes the file again."""

from __future__ import annotations

import io
import math
import warnings
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError, TsoError
from ..geometry.arrays import Array, Bits, Indices
from ..geometry.points import as_triangles, longest_side
from .meshes import MOVABLE, read_mesh, read_movable
from .movable import MovableFile, in_words
from .output import check_output, write_file
from .paint import Paint, Pictures
from .ply import PlyFile, new_ply
from .reading import is_there, plain, read_array, read_bytes, require_memory, shown
from .similarity import Similarity, similarity_of

MESHES = (".off", ".stl")
ARRAYS = (".npy", ".npz", ".pt")
TABLES = (".xyz", ".txt", ".csv", ".pts", ".pcd")
SUFFIXES = (*MOVABLE, *MESHES, *ARRAYS, *TABLES)
# Files that are known and not read: what to do.
_SPLATS = "export the splats as an uncompressed .ply"
ADVICE = {
    **dict.fromkeys((".splat", ".spz", ".ksplat", ".sog"), _SPLATS),
    **dict.fromkeys((".las", ".laz", ".e57"), "convert it to .ply, with CloudCompare or PDAL"),
    **dict.fromkeys((".fbx", ".blend", ".usd", ".usdz", ".dae", ".3ds"), "export it as .glb"),
    ".pcl": "convert it to .pcd or .ply", ".drc": "decode it to .ply: draco_decoder",
    **dict.fromkeys((".png", ".jpg", ".jpeg"), "expected a cloud first, and its masks after it"),
}  # fmt: skip
# What files of a kind begin with -> their suffixes.
_MAGIC = {
    b"ply\n": (".ply",), b"ply\r": (".ply",), b"glTF": (".glb", ".gltf"),
    b"\x93NUMPY": (".npy",), b"PK\x03\x04": (".npz", ".pt"),
}  # fmt: skip
# Written without a file to move: points alone, or with faces where there are some.
NEW = (".ply", ".npy", ".xyz")
POINTS_ONLY = (".npy", ".xyz")
# The points of a COLMAP model, and where a model may lie in a folder.
COLMAP_POINTS = ("points3D.bin", "points3D.txt")
MODEL_PLACES = ("", "0", "sparse/0", "sparse", "colmap/sparse/0")
MOST_COLUMNS = 100  # of a table of points; more are an image
# Squares of larger coordinates overflow.
_LARGEST = 1e100
# The most memory that a point takes in a refinement, if it only follows the control points.
BYTES_PER_POINT = 250


@dataclass(frozen=True, eq=False)
class PointCloud:
    """A cloud, or the vertices of a mesh, as read from a file."""

    points: Array  # [N, 3], in the file's order and units
    path: Path
    precision: str = "float64"  # or "float32", the type to write coordinates with
    # Set if the file can be written again with other coordinates.
    source: MovableFile | None = field(default=None, repr=False)
    triangles: Indices | None = field(default=None, repr=False)  # of a mesh without ``source``
    rgb: Array | None = field(default=None, repr=False)  # colours [N, 3] without ``source``

    def colours(self) -> Array | None:
        """Red, green and blue [N, 3] of the points, in [0, 1]; None if there are none."""
        return self.source.read_colours() if self.source else self.rgb

    def paint(self) -> Paint | None:
        """The colours of the surface of a mesh with textures or materials; None for one colour.

        A warning says why a texture cannot be used; then there are none.
        """
        if self.source is None:
            return None
        pictures = Pictures(self.path)
        paint = self.source.paint(pictures)
        if pictures.missing:
            why = pictures.missing[0]
            warnings.warn(f"{self.path}: its textures are not used: {why}", stacklevel=2)
            return None
        return None if paint is None or paint.is_plain else paint

    def faint(self) -> Bits | None:
        """[N], splats of an opacity under 5 %; None if the file has no splats."""
        return self.source.read_faint() if self.source else None

    def faces(self) -> Indices | None:
        """Triangles [F, 3] of the points; None if the file has no faces.

        Raises InputError if a face names a point that does not exist.
        """
        return self.source.read_faces() if self.source else self.triangles


def read_cloud(
    path: str | Path,
    extended: bool = True,
    index: int | None = None,
    columns: tuple[int, int, int] | None = None,
) -> PointCloud:
    """Read a point cloud, or a mesh as its vertices; ``faces()`` of the result joins them.

    The suffix of the file decides how it is read:

    - .ply : text or binary; .glb, .gltf and .obj : all meshes of the scene, at their places;
    - .off, .stl : a mesh;
    - .npy, .npz, .pt : an array [N, 3] or [1, N, 3], or the cloud ``index`` of [B, N, 3]; further
      columns are left out;
    - .xyz, .txt, .csv, .pts, .pcd : a table with x, y and z;
    - points3D.txt or points3D.bin of COLMAP, or the folder of its model : with colours;
    - others : by a reader that another package registers (`plugins`).

    Raises InputError if the file cannot be read, holds no point, or holds a coordinate that is not
    finite. With ``extended`` it also raises InputError if all points are equal. ``columns`` are the
    places of x, y and z in the rows of a table, from 0.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    model = colmap_points(path)
    plugin = None
    if model is None and suffix not in SUFFIXES and not path.is_dir():
        from .plugins import readers

        plugin = readers().get(suffix)
        if plugin is None:
            advice = ADVICE.get(suffix, f"expected {', '.join((*SUFFIXES, *readers()))}")
            raise InputError(
                f"{path}: the suffix {suffix!a} is not that of a point cloud or mesh, {advice}"
            )
    if columns is not None and (model is not None or suffix not in TABLES or suffix == ".pcd"):
        raise InputError(f"{path}: `columns` are of a table, expected .xyz, .txt, .csv or .pts")
    data = read_bytes(model or path, "a point cloud")
    for start, suffixes in _MAGIC.items():
        misnamed = suffix in SUFFIXES and suffix not in suffixes
        if model is None and misnamed and data.startswith(start):
            raise InputError(
                f"{path}: holds a {suffixes[0]} file, by its content, expected {suffix}; rename it"
            )
    try:
        if model is not None:
            from .point_tables import read_colmap

            points, rgb = read_colmap(data, model, BYTES_PER_POINT)
            cloud = PointCloud(points, path, rgb=rgb)
        elif plugin is not None:
            from .plugins import read_with

            values, faces = read_with(plugin, data, path)
            points, precision = point_array(values, path)
            triangles = None if faces is None else as_triangles(faces, len(points), str(path))
            cloud = PointCloud(points, path, precision, triangles=triangles)
        elif suffix in MOVABLE:
            source = read_movable(data, path, BYTES_PER_POINT)
            precision = "float32" if set(source.kinds) == {"f4"} else "float64"
            cloud = PointCloud(source.read(), path, precision, source)
        elif suffix in MESHES:
            mesh = read_mesh(path, textures=False)
            cloud = PointCloud(mesh.vertices, path, triangles=mesh.faces)
        elif suffix in ARRAYS:
            cloud = _of_arrays(_arrays(data, path), path, index)
        else:
            from .point_tables import read_points

            cloud = PointCloud(read_points(data, path, BYTES_PER_POINT, columns), path)
    except MemoryError:
        raise InputError(f"{path}: does not fit into memory") from None
    _check(cloud.points, path, extended)
    return cloud


def colmap_points(path: Path) -> Path | None:
    """The file of the points of a COLMAP model: ``path``, or in the folder ``path``; else None."""
    if path.name in COLMAP_POINTS:
        return path
    if path.suffix.lower() in SUFFIXES:
        return None
    places = [path / below / name for below in MODEL_PLACES for name in COLMAP_POINTS]
    return next(filter(is_there, places), None)


def write_cloud(
    path: str | Path,
    points: Array,
    like: PointCloud | None = None,
    overwrite: bool = False,
    dtype: Literal["float32", "float64"] | None = None,
    matrix: Array | None = None,
    confidence: Array | None = None,
    kept: Bits | None = None,
) -> None:
    """Write ``points`` [N, 3] as a .ply, .npy or .xyz file, or as the file they were read from.

    If ``like`` was read from a .ply, .glb, .gltf or .obj file and ``path`` has the same suffix, the
    new file is that file with other coordinates; every other byte stays. A warning names what is
    wrong after the move: normals of a PLY file, and the rotations and scales of Gaussian splats.
    Another warning says by how much the file's float rounds the result, if that is over 1e-4 of the
    cloud's longest side.

    ``matrix`` [4, 4] says that the cloud of ``like`` moved as a whole before its points moved
    further, if they did: x' = matrix x, a rotation with one factor for all lengths and a shift.
    Normals, tangents and splats move along with it, so they are right if no point moved further.

    Otherwise the type of the coordinates is ``dtype``, or the precision of ``like``. If neither is
    given, it is float32 as long as rounding moves no point by over a millionth of the cloud's
    longest side. A .ply file gets the faces and colours of ``like``, and its normals if no point
    moved, or all as one. A warning names what else the file of ``like`` holds.

    ``confidence`` [N] in [0, 1] becomes a property of the vertices of a .ply file.

    ``kept`` [N] says which points are written; the default is all. Of a .ply file the faces stay
    whose vertices all do. .glb, .gltf and .obj files hold all points.

    Raises InputError if ``path`` has another suffix or cannot be written, if ``points`` and
    ``like`` differ in number, if a file that is no .ply is to have a ``confidence``, or if
    ``matrix`` does not keep shapes; TsoError if a coordinate is not finite or too large for its
    type. After an error nothing is written.
    """
    path = Path(path)
    check_suffix(path, like.source.suffix if like is not None and like.source else "")
    check_output(path, overwrite)
    if confidence is not None and path.suffix.lower() != ".ply":
        raise InputError(f"{path}: cannot hold the confidence of points, expected a .ply file")
    if kept is not None and path.suffix.lower() not in NEW:
        expected = " or ".join(NEW)
        raise InputError(f"{path}: cannot hold some of its points alone, expected {expected}")
    points = np.asarray(points, dtype=np.float64)
    finite = np.isfinite(points).all(axis=1)
    if not finite.all():
        raise TsoError(f"{path}: point {finite.argmin()} is not finite, nothing was written")
    if like is not None and len(points) != len(like.points):
        raise InputError(
            f"{path}: {len(points)} points to write, expected {len(like.points)} as in {like.path}"
        )
    suffix, move = path.suffix.lower(), similarity_of(matrix)
    if like is not None and like.source is not None and like.source.suffix == suffix:
        if "f4" in like.source.kinds:
            check_rounding(path, points, f"in {like.path}", "store the input as double")
        data = like.source.with_points(points, matrix)
        if data is not like.source.data:
            _warn_of_stale(path, like, points, move)
        _warn_of_files(path, like, data)
    else:
        rounding, extent = _rounding(points)
        precise = "float32" if rounding <= 1e-6 * extent else "float64"
        precision = dtype or (like.precision if like is not None else precise)
        if kept is not None and suffix != ".ply":
            points, kept = points[kept], None
        data = _new_file(suffix, points, precision, like, move)
    if confidence is not None:
        data = PlyFile(data, path).with_confidence(confidence)
    if kept is not None:
        data = PlyFile(data, path).cropped(kept)
    write_file(path, data, overwrite)


def _warn_of_stale(path: Path, like: PointCloud, points: Array, move: Similarity | None) -> None:
    """Warn of what the file of ``like`` holds that is not right for ``points`` [N, 3]."""
    assert like.source is not None
    stale = [] if _keeps_shape(like, points, move) else like.source.stale_after_moving
    unturned = stale if move is None else like.source.left_behind(move.matrix)
    turned = [name for name in stale if name not in unturned]
    for names, when in (
        (unturned, "before the points moved"),
        (turned, "moved with the whole cloud, before the points moved further"),
    ):
        if names:
            warnings.warn(
                f"{path}: the {in_words(names)} are those of {like.path}, {when}", stacklevel=3
            )


def _keeps_shape(like: PointCloud, points: Array, move: Similarity | None) -> bool:
    """Whether ``points`` [N, 3] are those of ``like`` moved by ``move``, or not moved at all."""
    if move is None:
        return np.array_equal(like.points, points)
    assert like.source is not None
    return move.accounts_for(like.points, points, like.source.kinds)


def _warn_of_files(path: Path, like: PointCloud, data: bytes) -> None:
    """Warn if ``data`` names a file that lies next to the input, and not next to ``path``."""
    assert like.source is not None
    for name in like.source.files_named(data):
        file = Path(name.replace("\\", "/"))
        if is_there(like.path.parent / file) and not is_there(path.parent / file):
            warnings.warn(
                f"{path}: names {plain(name)}, which is not in {path.parent}; copy it there, or "
                f"write {like.path.parent / path.name} instead",
                stacklevel=3,
            )
            return


def warn_of_losses(like: PointCloud, suffix: str, kept: Iterable[str] = ()) -> None:
    """Warn of what the file of ``like`` holds and a new file of ``suffix`` does not.

    ``kept`` names what does go into the new file, besides points and faces.
    """
    contents = like.source.contents if like.source else ["colours"] if like.rgb is not None else []
    if suffix in POINTS_ONLY and like.faces() is not None:
        contents = ["faces", *contents]
    if lost := in_words(name for name in contents if name not in kept):
        same_suffix = like.source.suffix if like.source else ".ply"
        warnings.warn(
            f"{like.path}: its {lost} do not go into {suffix}; write {same_suffix} to keep them",
            stacklevel=3,
        )


def check_rounding(path: Path, points: Array, where: str, advice: str) -> None:
    """Warn if the float of the file ``path`` moves ``points`` by over 1e-4 of the longest side.

    Raises TsoError if a coordinate does not fit into a float. The message says ``where`` else
    coordinates are stored so, and ends with ``advice``.
    """
    rounding, extent = _rounding(points)
    if np.isinf(rounding):
        raise TsoError(
            f"{path}: a coordinate does not fit into float, as {where}, expected at most 3.4e38; "
            f"{advice}"
        )
    if rounding > 1e-4 * extent:
        warnings.warn(
            f"{path}: its coordinates are stored as float, as {where}: rounding moves points by up "
            f"to {rounding:.2g}, the cloud's longest side is {extent:.3g}; {advice} to keep the "
            "result",
            stacklevel=3,
        )


def _rounding(points: Array) -> tuple[float, float]:
    """How far float32 moves a point, and the longest side of all points."""
    with np.errstate(over="ignore", invalid="ignore"):
        rounding = np.abs(points.astype(np.float32) - points).max(initial=0.0)
    return float(rounding), longest_side(points) if len(points) else 0.0


def output_suffix(source: Path) -> str:
    """The suffix of the result of a file: formats with textures keep theirs, others get .ply."""
    suffix = source.suffix.lower()
    return suffix if suffix in MOVABLE else ".ply"


def check_suffix(path: Path, own: str = "") -> None:
    """Raise InputError unless a cloud can be written as ``path`` (`write_cloud`).

    ``own`` is the suffix of the file that it was read from, if that can be written again.
    """
    allowed = list(dict.fromkeys([*([own] if own else []), *NEW]))
    if path.suffix.lower() not in allowed:
        raise InputError(
            f"{path}: the suffix is {path.suffix!a}, expected {' or '.join(allowed)} for the "
            "points or mesh to write; for others, convert one of these: tso convert"
        )


def _new_file(
    suffix: str, points: Array, dtype: str, like: PointCloud | None, move: Similarity | None
) -> bytes:
    if suffix == ".ply":
        if like is None:
            return new_ply(points, dtype)
        source, colours, normals = like.source, None, None
        with suppress(InputError):  # what cannot be read is lost
            colours = source.read_colours() if source else like.rgb
        # Normals of a surface that has bent are wrong.
        with suppress(InputError):
            normals = source.read_normals() if source and _keeps_shape(like, points, move) else None
        if normals is not None and move is not None:
            normals = move.turned(normals)
        if source:
            written = (("colours", colours), ("normals", normals))
            warn_of_losses(like, suffix, [name for name, v in written if v is not None])
        return new_ply(points, dtype, like.faces(), normals, colours)
    values = points.astype(np.float32 if dtype == "float32" else np.float64)
    if suffix == ".npy":
        stream = io.BytesIO()
        np.save(stream, values)
        return stream.getvalue()
    return "".join(f"{x} {y} {z}\n" for x, y, z in values.astype("S32").astype(str)).encode()


def _memory_check(path: Path) -> Callable[[tuple[int, ...]], None]:
    """Refuses points [..., N, 3] that would not fit into memory."""

    def check(shape: tuple[int, ...]) -> None:
        if shape[-1:] == (3,):
            require_memory(path, BYTES_PER_POINT * math.prod(shape[:-1]))

    return check


# Names of the array of points in .npz and .pt files, and of the faces.
_POINTS = ("points", "xyz", "pos", "positions", "vertices", "verts", "pc", "pcd", "coords", "")
_FACES = ("faces", "triangles", "tris")


def clouds_in(path: Path) -> int:
    """How many clouds a file holds: B of an array [B, N, 3], else 1; InputError if damaged."""
    if path.suffix.lower() not in ARRAYS:
        return 1
    array = _points_of(_arrays(read_bytes(path, "a point cloud"), path), path)
    return len(array) if _holds_clouds(array) else 1


def _holds_clouds(array: NDArray[Any]) -> bool:
    return array.ndim == 3 and array.shape[2] == 3 and len(array) > 1


def _arrays(data: bytes, path: Path) -> dict[str, Any]:
    if path.suffix.lower() == ".npy":
        return {"": read_array(data, path)}
    from .archives import arrays_of

    return arrays_of(data, path, check=_memory_check(path))


def _points_of(arrays: dict[str, Any], path: Path) -> NDArray[Any]:
    """The array with a usual name, or the only one that fits."""
    named = [name for name in _POINTS if name in arrays]
    fitting = [name for name, array in arrays.items() if np.shape(array)[-1:] == (3,)]
    names = named[:1] or (fitting if len(fitting) == 1 else [])
    if not names:
        shapes = ", ".join(f"{shown(name)} {list(np.shape(a))}" for name, a in arrays.items())
        raise InputError(
            f"{path}: holds {shapes or 'no array'}, expected an array called points [N, 3]"
        )
    return np.asarray(arrays[names[0]])


def _of_arrays(arrays: dict[str, Any], path: Path, index: int | None) -> PointCloud:
    points, precision = point_array(_points_of(arrays, path), path, index)
    faces = next((arrays[name] for name in _FACES if name in arrays), None)
    if faces is not None:
        whole = np.asarray(faces)
        if whole.dtype.kind == "f" and (whole == np.rint(whole)).all():
            whole = whole.astype(np.int64)
        faces = as_triangles(whole, len(points), str(path))
    return PointCloud(points, path, precision, triangles=faces)


def point_array(array: NDArray[Any], path: Path, index: int | None = None) -> tuple[Array, str]:
    """Points [N, 3] of an array [N, 3 or more] or [1, N, 3 or more], and the precision.

    ``index`` chooses one of several clouds [B, N, 3]. Raises InputError for another shape, or
    another index.
    """
    if _holds_clouds(array):
        if index is None or not 0 <= index < len(array):
            raise InputError(
                f"{path}: holds {len(array)} clouds of {array.shape[1]} points, expected one "
                f"[N, 3]; choose one of them: `cloud_index` 0 to {len(array) - 1} of tso refine"
            )
        array = array[index]
    cloud = array[0] if array.ndim == 3 and len(array) == 1 else array
    fits = cloud.ndim == 2 and 3 <= cloud.shape[1] <= MOST_COLUMNS and cloud.dtype.kind in "fiu"
    if not fits:
        raise InputError(
            f"{path}: holds {array.dtype} {list(array.shape)}, expected numbers [N, 3]"
        )
    if cloud.shape[1] > 3:
        warnings.warn(
            f"{path}: only the first three of its columns are used, as x y z", stacklevel=3
        )
        cloud = cloud[:, :3]
    require_memory(path, BYTES_PER_POINT * len(cloud))
    precision = "float32" if cloud.dtype.kind == "f" and cloud.dtype.itemsize <= 4 else "float64"
    with np.errstate(all="ignore"):
        return np.ascontiguousarray(cloud, dtype=np.float64), precision


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
            f"finite, the first is point {index} {points[index].tolist()}, expected numbers; leave "
            "these points out"
        )
    largest = np.abs(points).max()
    if largest > _LARGEST:
        raise InputError(f"{path}: a coordinate of {largest:g}, expected at most {_LARGEST:g}")
    if extended and longest_side(points) <= 1.0 / _LARGEST:
        raise InputError(
            f"{path}: all {count} points are the same {points[0].tolist()}, expected different ones"
        )
