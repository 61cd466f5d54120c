"""Reading triangle meshes."""

from __future__ import annotations

import io
import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .output import atomic_output, check_output

SUFFIXES = (".ply", ".obj", ".off", ".stl", ".glb")


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles of one object, in the file's own frame and units.

    Parameters
    ----------
    vertices : [V, 3] float64.
    faces : [F, 3] int64, indices of vertices.
    colours : [F, 3] uint8, one RGB colour a face (vertex colours averaged), or None where the file has none.
    """

    vertices: NDArray[np.float64]
    faces: NDArray[np.int64]
    colours: NDArray[np.uint8] | None = None


def find_meshes(folder: Path | str) -> list[Path]:
    """All mesh files under ``folder``, sorted, subfolders included; hidden files and folders are left out.

    Raises InputError if it is not a folder, cannot be listed, or holds no mesh.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise InputError(f"{folder}: not a folder, expected one with meshes ({', '.join(SUFFIXES)})")
    try:
        found = sorted(
            path
            for path in folder.rglob("*")
            if path.suffix.lower() in SUFFIXES
            and path.is_file()
            and not any(part.startswith(".") for part in path.relative_to(folder).parts)
        )
    except OSError as error:
        raise InputError(f"{folder}: cannot be listed ({error.strerror or error})") from None
    if not found:
        raise InputError(f"{folder}: no mesh in this folder or below, expected {', '.join(SUFFIXES)} files")
    return found


def read_mesh(path: Path | str) -> Mesh:
    """Read a triangle mesh; vertices are neither merged nor moved, polygons become triangles.

    Parameters
    ----------
    path : a .ply, .obj, .off, .stl or .glb file.

    Raises
    ------
    InputError
        The file is missing, a folder, empty, of another format, damaged, or without a face; a coordinate is not finite; a
        face names a vertex that does not exist; all faces together have no area.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder, expected a mesh file ({', '.join(SUFFIXES)})")
    if path.suffix.lower() not in SUFFIXES:
        raise InputError(f"{path}: ends in {path.suffix or 'nothing'!r}, expected a mesh: {', '.join(SUFFIXES)}")
    try:
        content = path.read_bytes()
    except FileNotFoundError:
        raise InputError(f"{path}: no such file, expected a mesh") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None
    if not content:
        raise InputError(f"{path}: the file is empty, expected a mesh")
    vertices, faces, colours = _parse(path, content)
    if vertices.ndim != 2 or vertices.shape[1:] != (3,) or len(vertices) == 0:
        raise InputError(f"{path}: no vertices, expected a mesh")
    if faces.ndim != 2 or faces.shape[1:] != (3,) or len(faces) == 0:
        raise InputError(f"{path}: {len(vertices):,} vertices but no face, expected a mesh (a point cloud has no surface)")
    if faces.min() < 0 or faces.max() >= len(vertices):
        wrong = faces.min() if faces.min() < 0 else faces.max()
        raise InputError(f"{path}: a face names vertex {wrong}, expected 0 to {len(vertices) - 1}")
    bad = ~np.isfinite(vertices).all(axis=1)
    if bad.any():
        raise InputError(f"{path}: {int(bad.sum())} of {len(vertices):,} vertices are NaN or infinite, expected numbers")
    corners = vertices[faces]
    with np.errstate(over="ignore", invalid="ignore"):
        area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    if not np.isfinite(area) or area <= 0.0:
        raise InputError(f"{path}: the area of its {len(faces):,} faces is {area:g}, expected a surface")
    return Mesh(vertices, faces, colours)


def _parse(path: Path, content: bytes) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.uint8] | None]:
    """Vertices, faces and colours as the file states them, unchecked."""
    import trimesh

    # The library logs its own complaints with a traceback; the one line raised below replaces them.
    log = logging.getLogger("trimesh")
    before, log.disabled = log.disabled, True
    try:
        with np.errstate(all="ignore"):
            mesh = trimesh.load_mesh(
                io.BytesIO(content), file_type=path.suffix.lower()[1:], process=False, resolver=_resolver(path)
            )
            vertices = np.array(mesh.vertices, dtype=np.float64)
            faces = np.array(mesh.faces, dtype=np.int64)
    except Exception as error:  # a damaged file makes the parser fail in any way there is
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        raise InputError(f"{path}: not a readable {path.suffix.lower()} mesh ({reason})") from None
    finally:
        log.disabled = before
    return vertices, faces, _face_colours(mesh, len(faces))


def _resolver(path: Path) -> object:
    from trimesh.resolvers import FilePathResolver

    return FilePathResolver(str(path))


def _face_colours(mesh: object, count: int) -> NDArray[np.uint8] | None:
    """RGB of every face [F, 3], or None where the file states no colour or one that cannot be read."""
    try:
        visual = mesh.visual  # type: ignore[attr-defined]
        if visual.kind is None:
            return None
        if visual.kind == "texture":
            visual = visual.to_color()
        colours = np.asarray(visual.face_colors)[:, :3].astype(np.uint8)
    except Exception:  # colour only decorates the picture: a missing texture must not stop the work
        return None
    return colours if colours.shape == (count, 3) else None


def write_mesh(path: Path | str, mesh: Mesh, overwrite: bool = False) -> None:
    """Write vertices (float32) and faces as binary little-endian PLY; colours are left out.

    Raises InputError where ``path`` must not be written, TsoError where writing fails.
    """
    path = Path(path)
    if path.suffix.lower() != ".ply":
        raise InputError(f"{path}: ends in {path.suffix or 'nothing'!r}, expected .ply (the mesh format written here)")
    check_output(path, overwrite)
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(mesh.vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(mesh.faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.empty(len(mesh.faces), dtype=[("count", "u1"), ("corners", "<i4", 3)])
    rows["count"] = 3
    rows["corners"] = mesh.faces
    with atomic_output(path) as temporary:
        temporary.write_bytes(header.encode("ascii") + mesh.vertices.astype("<f4").tobytes() + rows.tobytes())
