"""Triangle meshes: reads PLY, OBJ, glTF, OFF and STL; writes them without textures."""

from __future__ import annotations

import io
import logging
import re
import struct
import warnings
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..geometry.arrays import Array, Indices
from ..geometry.points import require_vertices
from ..geometry.polygons import triangulated
from ..signals import waiting_signals
from .movable import MovableFile
from .output import reason, write_file
from .paint import Paint, Pictures
from .ply import PlyFile, new_ply
from .reading import read_bytes, require_memory, shown

# Files that are written again with other vertices; every other value stays.
MOVABLE = (".ply", ".glb", ".gltf", ".obj")
SUFFIXES = (*MOVABLE, ".off", ".stl")
# Pictures on a mesh that is rendered are shrunk until their longer side is about that, px.
FINEST_PICTURE = 4096
_HEADER, _TRIANGLE = 84, 50  # bytes of a binary STL file
_COUNTS = re.compile(rb"OFF\s*(?:#[^\n]*\n\s*)*(\d{1,18})\s+(\d{1,18})[^\n]*")


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles of one object, in the file's own frame and units."""

    vertices: Array  # [V, 3]
    faces: Indices  # [F, 3], indices of vertices
    paint: Paint | None = None


def find_meshes(folder: Path) -> list[Path]:
    """All mesh files in ``folder`` and below, sorted; hidden files and folders are left out.

    Raises InputError if ``folder`` is not a folder or holds no mesh.
    """
    if not folder.is_dir():
        raise InputError(
            f"{folder}: not a folder, expected one with meshes ({', '.join(SUFFIXES)})"
        )
    meshes = [
        path
        for path in sorted(folder.rglob("*"))
        if path.suffix.lower() in SUFFIXES
        and path.is_file()
        and not any(part.startswith(".") for part in path.relative_to(folder).parts)
    ]
    if not meshes:
        raise InputError(
            f"{folder}: no mesh in this folder or below, expected {', '.join(SUFFIXES)} files"
        )
    return meshes


def read_mesh(path: Path, textures: bool = True, within: Path | None = None) -> Mesh:
    """Read a triangle mesh; polygons become triangles, the order of vertices and faces stays.

    With ``textures`` its paint is read too: baseColorTexture (times baseColorFactor) of .glb and
    .gltf, map_Kd of .obj, or the colours of the vertices. Pictures must be inside the file, or in
    the folder ``within`` (None: the folder of the mesh) or below. If a picture cannot be read, a
    warning says so and the material's colour is used.

    Raises InputError if the file cannot be read, holds no face or no area, if a face names a
    missing vertex, or if a coordinate is not finite.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES and path.is_file():
        raise InputError(
            f"{path}: the suffix is {path.suffix!a}, expected a mesh: {', '.join(SUFFIXES)}"
        )
    content = read_bytes(path, f"a mesh ({', '.join(SUFFIXES)})")
    source = read_movable(content, path) if suffix in MOVABLE else None
    if source is None:
        vertices, faces = (_of_off if suffix == ".off" else _of_stl)(content, path)
    else:
        vertices, triangles = source.read(), source.read_faces()
        faces = np.empty((0, 3), np.int64) if triangles is None else triangles
    if len(vertices) == 0:
        raise InputError(f"{path}: no vertices, expected a mesh")
    if len(faces) == 0:
        raise InputError(
            f"{path}: {len(vertices):,} vertices but no face, "
            "expected a mesh (a point cloud has no surface)"
        )
    bad = ~np.isfinite(vertices).all(axis=1)
    if bad.any():
        raise InputError(
            f"{path}: {int(bad.sum())} of {len(vertices):,} vertices are NaN or infinite, "
            "expected numbers"
        )
    origin, first, second = vertices[faces].transpose(1, 0, 2)
    with np.errstate(over="ignore", invalid="ignore"):
        area = np.linalg.norm(np.cross(first - origin, second - origin), axis=1).sum()
    if not np.isfinite(area) or area <= 0.0:
        raise InputError(
            f"{path}: the area of its {len(faces):,} faces is {area:g}, expected a surface"
        )
    if source is None or not textures:
        return Mesh(vertices, faces)
    pictures = Pictures(path, within, FINEST_PICTURE)
    paint = source.paint(pictures)
    if paint is None:
        with suppress(InputError):  # of colours that are none
            colours = source.read_colours()
            paint = None if colours is None else Paint.of_vertices(colours, faces)
    elif not paint.textures and (paint.corners == 1.0).all():
        paint = None  # no material says anything
    if pictures.missing:
        more = f" ({len(pictures.missing)} in all)" if len(pictures.missing) > 1 else ""
        warnings.warn(f"{path}: {pictures.missing[0]}{more}", stacklevel=2)
    return Mesh(vertices, faces, paint)


def read_movable(data: bytes, path: Path, bytes_per_point: int = 0) -> MovableFile:
    """The file ``path``, whose suffix is one of `MOVABLE` and whose bytes are ``data``.

    Raises InputError if it is damaged, or if there is no memory for ``bytes_per_point`` bytes for
    each point of a .ply file.
    """
    suffix = path.suffix.lower()
    if suffix == ".ply":
        return PlyFile(data, path, bytes_per_point)
    if suffix == ".obj":
        from .obj import ObjFile

        return ObjFile(data, path)
    from .gltf import GltfFile

    return GltfFile(data, path)


def _of_stl(content: bytes, path: Path) -> tuple[Array, Indices]:
    """Vertices [V, 3] and faces [F, 3] of a .stl file, which trimesh reads."""
    _check_stl(content, path)
    with waiting_signals():
        import trimesh
    # trimesh logs its own errors with a traceback. The one line that is raised below replaces them.
    log = logging.getLogger("trimesh")
    before = log.level
    log.setLevel(logging.CRITICAL + 1)
    try:
        # trimesh takes Ctrl-C in the middle of a file for a part that cannot be read.
        with np.errstate(all="ignore"), warnings.catch_warnings(), waiting_signals():
            warnings.simplefilter("ignore")
            mesh = trimesh.load_mesh(io.BytesIO(content), file_type="stl", process=False)
            vertices = np.array(mesh.vertices, dtype=np.float64).reshape(-1, 3)
            return vertices, np.array(mesh.faces, dtype=np.int64).reshape(-1, 3)
    # A damaged file can make the parser raise anything.
    except Exception as error:
        raise InputError(
            f"{path}: is not a readable .stl mesh ({reason(error)}), expected a whole file"
        ) from None
    finally:
        log.setLevel(before)


def _of_off(content: bytes, path: Path) -> tuple[Array, Indices]:
    """Vertices [V, 3] and faces [F, 3] of a .off file; colours and normals are left out."""
    match = _COUNTS.search(content)
    if match is None:
        raise InputError(
            f"{path}: has no counts of vertices and faces after OFF, expected a whole OFF file"
        )
    count, faces = int(match[1]), int(match[2])
    require_memory(path, 400 * min(count + faces, len(content)))
    vertices: list[list[float]] = []
    polygons: list[list[int]] = []
    first = content.count(b"\n", 0, match.end()) + 1
    for number, line in enumerate(content[match.end() :].splitlines(), first):
        words = line.partition(b"#")[0].split()
        if not words or len(polygons) == faces:
            continue
        if len(vertices) < count:
            vertices.append(_place(words, number, path))
            continue
        try:
            length = int(words[0])
            polygons.append([int(word) for word in words[1 : length + 1]])
            if length < 0 or len(polygons[-1]) < length:
                raise ValueError
        except ValueError:
            expected = "the count of corners of a face and its vertices"
            raise _wrong_line(words, number, path, expected) from None
    if len(vertices) < count or len(polygons) < faces:
        nouns = ("vertex" if count == 1 else "vertices", "face" if faces == 1 else "faces")
        raise InputError(
            f"{path}: ends early: it has {len(vertices) + len(polygons):,} lines after its counts, "
            f"which state {count:,} {nouns[0]} and {faces:,} {nouns[1]}, expected a line for each"
        )
    corners = np.array([corner for polygon in polygons for corner in polygon], dtype=np.int64)
    require_vertices(corners, count, str(path))
    points, lengths = np.array(vertices).reshape(-1, 3), np.array([len(p) for p in polygons], int)
    return points, corners[triangulated(points, corners, lengths)]


def _check_stl(content: bytes, path: Path) -> None:
    """Raise InputError if an STL file, text or binary, is not whole."""
    triangles = struct.unpack_from("<I", content, 80)[0] if len(content) >= _HEADER else 0
    body = len(content) - _HEADER
    if body == triangles * _TRIANGLE:
        return
    if not (re.match(rb"\s*solid", content) and re.search(rb"\bfacet\b", content, re.IGNORECASE)):
        raise InputError(
            f"{path}: has {max(body, 0):,} bytes after its header, expected {_TRIANGLE} for each "
            f"of the {triangles:,} triangles that it states; the file ends early or is no STL file"
        )
    counts = dict.fromkeys(("solid", "endsolid", "facet", "endfacet", "vertex"), 0)
    for number, line in enumerate(content.splitlines(), 1):
        words = line.split()
        name = words[0].lower().decode("ascii", "replace") if words else ""
        counts[name] = counts.get(name, 0) + 1
        if name == "vertex":
            _place(words[1:], number, path)
    for name in ("facet", "solid"):
        begun, ended = counts[name], counts[f"end{name}"]
        if begun != ended:
            raise InputError(
                f"{path}: ends early: it has {begun:,} lines with {name} and {ended:,} with "
                f"end{name}, expected the same; export it again"
            )
    if counts["vertex"] != 3 * counts["facet"]:
        raise InputError(
            f"{path}: has {counts['vertex']:,} vertices in {counts['facet']:,} facets, expected 3 "
            "in each; export it again"
        )


def _place(words: list[bytes], number: int, path: Path) -> list[float]:
    """x, y and z at the beginning of a line; InputError if it has no three numbers."""
    with suppress(ValueError):
        place = [float(word) for word in words[:3]]
        if len(place) == 3:
            return place
    raise _wrong_line(words, number, path, "x, y and z")


def _wrong_line(words: list[bytes], number: int, path: Path, expected: str) -> InputError:
    text = shown(b" ".join(words).decode("ascii", "backslashreplace"))
    return InputError(f"{path}: line {number} has {text}, expected {expected}")


def new_mesh(suffix: str, points: Array, faces: Indices) -> bytes:
    """The bytes of a .obj, .off, .stl or .glb file of ``points`` and ``faces``, without colours.

    Text has the digits that give the same numbers again.
    """
    if suffix in (".stl", ".glb"):
        with waiting_signals():
            import trimesh

        mesh = trimesh.Trimesh(points, faces, process=False)
        data = mesh.export(file_type=suffix[1:])
        assert isinstance(data, bytes)
        return data
    single = points.astype(np.float32)
    rows = (single if np.array_equal(single, points) else points).astype("S32").astype(str)
    if suffix == ".obj":
        lines = [f"v {x} {y} {z}" for x, y, z in rows.tolist()]
        lines += [f"f {a} {b} {c}" for a, b, c in (faces + 1).tolist()]
    else:
        lines = ["OFF", f"{len(points)} {len(faces)} 0"]
        lines += [f"{x} {y} {z}" for x, y, z in rows.tolist()]
        lines += [f"3 {a} {b} {c}" for a, b, c in faces.tolist()]
    return "\n".join([*lines, ""]).encode()


def write_mesh(path: Path, mesh: Mesh, overwrite: bool = False) -> None:
    """Write vertices (float32) and faces as binary PLY; colours and textures are left out."""
    write_file(path, new_ply(mesh.vertices, "float32", faces=mesh.faces), overwrite)
