"""Triangle meshes: reads PLY, OBJ, OFF, STL and GLB; writes them without textures."""

from __future__ import annotations

import io
import logging
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..geometry.arrays import Array, Indices, Pixels
from ..signals import waiting_signals
from .gltf_scene import with_base_colours
from .mesh_checks import check_glb, check_off, check_ply, check_stl, parted
from .obj import simplified
from .output import reason, write_file
from .ply import new_ply
from .reading import read_bytes
from .textures import Pictures, Texture, Tint

GREY = (170, 170, 170)  # the colour of faces that have no colour
CHECKS = {"ply": check_ply, "off": check_off, "stl": check_stl, "glb": check_glb}
# What makes of a file one that trimesh reads well.
SIMPLER = {"obj": simplified, "off": parted, "glb": with_base_colours}
SUFFIXES = (".ply", ".obj", ".off", ".stl", ".glb")


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles of one object, in the file's own frame and units."""

    vertices: Array  # [V, 3]
    faces: Indices  # [F, 3], indices of vertices
    colours: Pixels | None = None  # [F, 3], one RGB colour per face, the mean of vertex colours
    textures: tuple[Texture, ...] = ()  # a texture replaces the colours of its faces


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

    With ``textures`` the pictures on the mesh are read too: baseColorTexture (times
    baseColorFactor) of .glb and map_Kd of .obj. They must be inside the file, or in the folder
    ``within`` (None: the folder of the mesh) or below. If a picture cannot be read, a warning says
    so and the material's colour is used.

    Raises InputError if the file cannot be read, holds no face or no area, if a face names a
    missing vertex, or if a coordinate is not finite.
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
    if textures and pictures.missing:
        more = f" ({len(pictures.missing)} in all)" if len(pictures.missing) > 1 else ""
        warnings.warn(
            f"{path}: {pictures.missing[0]}{more}, the material's colour is used", stacklevel=2
        )
    return mesh


def _parse(path: Path, content: bytes, pictures: Pictures) -> Mesh:
    """All parts of the file as one mesh, each part at the place that the file gives it.

    Raises InputError if the file cannot be read or a face names a missing vertex.
    """
    parts, pictured = _load_parts(path, content, pictures)
    vertices, faces = [np.empty((0, 3))], [np.empty((0, 3), np.int64)]
    colours, coloured, textures = [], False, []
    first_vertex, first_face = 0, 0
    for part, points, triangles in parts:
        if triangles.size and not 0 <= triangles.min() <= triangles.max() < len(points):
            wrong = triangles.min() if triangles.min() < 0 else triangles.max()
            raise InputError(
                f"{path}: a face names vertex {wrong}, expected 0 to {len(points) - 1}"
            )
        picture = pictured.get(part.metadata.get("name"))
        if picture is not None:
            numbers = np.arange(first_face, first_face + len(triangles))
            corners = np.asarray(part.visual.uv, dtype=np.float64)[triangles]
            textures.append(Texture(picture[0], numbers, corners, picture[1]))
        of_part = _face_colours(part, len(triangles))
        coloured = coloured or of_part is not None
        grey = np.full((len(triangles), 3), GREY, np.uint8)
        colours.append(grey if of_part is None else of_part)
        vertices.append(points)
        faces.append(triangles + first_vertex)
        first_vertex, first_face = first_vertex + len(points), first_face + len(triangles)
    return Mesh(
        np.concatenate(vertices),
        np.concatenate(faces),
        np.concatenate(colours) if coloured else None,
        tuple(textures),
    )


def _load_parts(
    path: Path, content: bytes, pictures: Pictures
) -> tuple[list[tuple[Any, Array, Indices]], dict[str, tuple[Pixels, Tint | None]]]:
    """Each part of the file with its vertices and faces, and the pictures of geometries."""
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
            kind = path.suffix.lower()[1:]
            if kind in CHECKS:
                CHECKS[kind](content, path)
            if kind in SIMPLER:
                content = SIMPLER[kind](content)
            scene = trimesh.load_scene(
                io.BytesIO(content), file_type=kind, process=False, resolver=pictures.resolver
            )
            pictured = pictures.take(scene.geometry)
            parts = []
            for part in scene.dump():
                vertices = np.array(getattr(part, "vertices", ()), dtype=np.float64)
                faces = np.array(getattr(part, "faces", ()), dtype=np.int64)
                parts.append((part, vertices.reshape(-1, 3), faces.reshape(-1, 3)))
    except InputError:
        raise
    # A damaged file can make the parser raise anything.
    except Exception as error:
        raise InputError(
            f"{path}: is not a readable {path.suffix.lower()} mesh ({reason(error)}), "
            "expected a whole file"
        ) from None
    finally:
        log.setLevel(before)
    return parts, pictured


def _face_colours(part: Any, count: int) -> Pixels | None:
    """RGB of every face [F, 3]; None if the file has no colour or one that cannot be read."""
    # Colours only decorate the picture: an unusual material must not stop the work.
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
