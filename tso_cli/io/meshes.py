"""Reading triangle meshes."""

from __future__ import annotations

import io
import logging
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .output import reason, write_file
from .ply import new_ply
from .reading import read_bytes
from .textures import Pictures, Texture

Array = NDArray[np.float64]
GREY = (170, 170, 170)
"""Colour of what has none."""
SUFFIXES = (".ply", ".obj", ".off", ".stl", ".glb")


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles of one object, in the file's own frame and units."""

    vertices: Array  # [V, 3]
    faces: NDArray[np.int64]  # [F, 3], indices of vertices
    colours: NDArray[np.uint8] | None = (
        None  # [F, 3], one RGB colour a face (vertex colours averaged)
    )
    textures: tuple[Texture, ...] = ()  # used in place of the colours of their faces


def find_meshes(folder: Path) -> list[Path]:
    """All mesh files under ``folder``, sorted, without hidden ones; InputError if it is not a folder or holds no mesh."""
    if not folder.is_dir():
        raise InputError(
            f"{folder}: not a folder, expected one with meshes ({', '.join(SUFFIXES)})"
        )
    meshes = [
        path
        for path in sorted(folder.rglob("*"))
        if path.suffix.lower() in SUFFIXES and path.is_file()
    ]
    meshes = [
        path
        for path in meshes
        if not any(part.startswith(".") for part in path.relative_to(folder).parts)
    ]
    if not meshes:
        raise InputError(
            f"{folder}: no mesh in this folder or below, expected {', '.join(SUFFIXES)} files"
        )
    return meshes


def read_mesh(path: Path, textures: bool = True, within: Path | None = None) -> Mesh:
    """Read a triangle mesh; faces stay in order and vertices in place, polygons become triangles.

    With ``textures`` also pictures on it: baseColorTexture (times baseColorFactor) of .glb, map_Kd of .obj, inside the file or
    in the folder ``within`` (None: the file's own) or below. One that cannot be read gives a warning and the material's colour.

    Raises InputError if the file cannot be read, holds no face, one of a missing vertex, or no area; or is not finite.
    """
    if path.suffix.lower() not in SUFFIXES and path.is_file():
        raise InputError(
            f"{path}: the suffix is {path.suffix!a}, expected a mesh: {', '.join(SUFFIXES)}"
        )
    content = read_bytes(path, f"a mesh ({', '.join(SUFFIXES)})")
    pictures = Pictures(path, content, textures, within)
    mesh = _parse(path, content, pictures)
    vertices, faces = mesh.vertices, mesh.faces
    if len(vertices) == 0:
        raise InputError(f"{path}: no vertices, expected a mesh")
    if len(faces) == 0:
        raise InputError(
            f"{path}: {len(vertices):,} vertices but no face, expected a mesh (a point cloud has no surface)"
        )
    bad = ~np.isfinite(vertices).all(axis=1)
    if bad.any():
        raise InputError(
            f"{path}: {int(bad.sum())} of {len(vertices):,} vertices are NaN or infinite, expected numbers"
        )
    corners = vertices[faces]
    with np.errstate(over="ignore", invalid="ignore"):
        area = np.linalg.norm(
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
        ).sum()
    if not np.isfinite(area) or area <= 0.0:
        raise InputError(
            f"{path}: the area of its {len(faces):,} faces is {area:g}, expected a surface"
        )
    if textures and pictures.missing:
        more = f" ({len(pictures.missing)} in all)" if len(pictures.missing) > 1 else ""
        warnings.warn(
            f"{path}: {pictures.missing[0]}{more}, the material's colour stands in", stacklevel=2
        )
    return mesh


def _parse(path: Path, content: bytes, pictures: Pictures) -> Mesh:
    """All parts of the file, each where the file places it; only that faces name vertices is checked."""
    import trimesh

    # The library and its parts log their own complaints with a traceback; the one line raised below replaces them.
    log = logging.getLogger("trimesh")
    before = log.level
    log.setLevel(logging.CRITICAL + 1)
    try:
        with np.errstate(all="ignore"), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            kind = path.suffix.lower()[1:]
            scene = trimesh.load_scene(
                io.BytesIO(content), file_type=kind, process=False, resolver=pictures.resolver
            )
            images = {name: pictures.take(geometry) for name, geometry in scene.geometry.items()}
            parts: list[Any] = scene.dump()
            vertices = [
                np.array(getattr(part, "vertices", ()), dtype=np.float64).reshape(-1, 3)
                for part in parts
            ]
            faces = [
                np.array(getattr(part, "faces", ()), dtype=np.int64).reshape(-1, 3)
                for part in parts
            ]
    # A damaged file makes the parser fail in any way there is.
    except Exception as error:
        raise InputError(
            f"{path}: is not a readable {path.suffix.lower()} mesh ({reason(error)})"
        ) from None
    finally:
        log.setLevel(before)
    colours = [
        _face_colours(part, len(triangles)) for part, triangles in zip(parts, faces, strict=True)
    ]
    textures, joined, first_vertex, first_face = [], [np.empty((0, 3), np.int64)], 0, 0
    for part, points, triangles in zip(parts, vertices, faces, strict=True):
        if triangles.size and not 0 <= triangles.min() <= triangles.max() < len(points):
            wrong = triangles.min() if triangles.min() < 0 else triangles.max()
            raise InputError(
                f"{path}: a face names vertex {wrong}, expected 0 to {len(points) - 1}"
            )
        image = images.get(part.metadata.get("name"))
        if image is not None:
            numbers = np.arange(first_face, first_face + len(triangles))
            textures.append(
                Texture(image, numbers, np.asarray(part.visual.uv, dtype=np.float64)[triangles])
            )
        joined.append(triangles + first_vertex)
        first_vertex, first_face = first_vertex + len(points), first_face + len(triangles)
    known = [
        np.full((len(f), 3), GREY, np.uint8) if c is None else c
        for c, f in zip(colours, faces, strict=True)
    ]
    painted = any(c is not None for c in colours)
    return Mesh(
        np.concatenate([np.empty((0, 3)), *vertices]),
        np.concatenate(joined),
        np.concatenate(known) if painted else None,
        tuple(textures),
    )


def _face_colours(part: Any, count: int) -> NDArray[np.uint8] | None:
    """RGB of every face [F, 3], or None where the file states no colour or one that cannot be read."""
    # Colour only decorates the picture: an odd material must not stop the work.
    try:
        visual = part.visual
        if visual.kind == "texture":
            colours = np.tile(
                np.asarray(visual.material.main_color)[:3].astype(np.uint8), (count, 1)
            )
        else:
            colours = np.asarray(visual.face_colors)[:, :3].astype(np.uint8)
        return colours if visual.kind is not None and colours.shape == (count, 3) else None
    except Exception:
        return None


def write_mesh(path: Path, mesh: Mesh, overwrite: bool = False) -> None:
    """Write vertices (float32) and faces as binary little-endian PLY; colours are left out."""
    write_file(path, new_ply(mesh.vertices, "float32", faces=mesh.faces), overwrite)
