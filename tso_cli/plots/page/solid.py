"""What the page draws in three dimensions: points or triangles, before and after, and cameras.

Coordinates are centred on the start, and its longest side is 1.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from PIL import Image

from ...geometry.arrays import Array, Indices, Pixels
from ...geometry.points import bounding_box_normalisation, scattered
from ...io.clouds import PointCloud
from ...io.paint import Paint, Pictures
from ...refinement import RefineResult
from ...scene.load import Scene
from .pictures import packed, picture_uri, text_of

# What a page shows at most, so that a browser opens it at once.
MOST_POINTS = 60_000
MOST_FACES, MOST_VERTICES = 40_000, 45_000
# Points further from the middle than this many longest sides are left out.
FARTHEST = 2.5
# Pixels along the longer side of a texture, and characters that all of them take at most.
TEXTURE_SIDES, MOST_TEXTURE = (1024, 512, 256, 128), 1_100_000
# Cells along each side in which the vertices of a large mesh are joined.
FINEST_CELLS, COARSER = 4096, 0.8


@dataclass
class MovedSurface:
    """Triangles and their looks. ``of_face`` [F] : the texture of each, -1 for none."""

    start: Array
    result: Array
    faces: Indices
    face_colours: Pixels | None = None
    vertex_colours: Pixels | None = None
    of_face: Indices | None = None
    corners: Array | None = None  # [F, 3, 2] texture coordinates


def solid_of(result: RefineResult, scene: Scene) -> dict[str, Any]:
    """The clouds or meshes of a result for the page, with sentences about what is left out."""
    centre, size = bounding_box_normalisation(result.measured[0])
    notes: list[str] = []
    start, moved = ((points - centre) / size for points in (result.initial, result.points))
    solid: dict[str, Any]
    if result.of_mesh and scene.file is not None:
        solid = _mesh(scene.file, start, moved, notes)
    else:
        solid = _points(result, scene.file, start, moved, notes)
    return {**solid, "notes": notes, "cameras": _cameras(result, centre, size)}


def _points(
    result: RefineResult, file: PointCloud | None, start: Array, moved: Array, notes: list[str]
) -> dict[str, Any]:
    distance = np.maximum(np.abs(start).max(1), np.abs(moved).max(1))
    drawn = np.flatnonzero(~result.outliers & (distance < FARTHEST))
    if len(drawn) < len(start):
        left_out = len(start) - len(drawn)
        what = "1 point is" if left_out == 1 else f"{left_out:,} points are"
        notes.append(f"{what} far from the rest, and not drawn.")
    if len(drawn) > MOST_POINTS:
        every = len(drawn)
        drawn = scattered(drawn, MOST_POINTS)
        notes.append(
            f"The cloud is thinned for this page: {len(drawn):,} of {every:,} points are drawn."
        )
    colours = file.source.read_colours() if file is not None and file.source else None
    return {
        "kind": "points",
        "count": len(drawn),
        **_stages(start[drawn], moved[drawn]),
        "colours": None if colours is None else text_of(_bytes(colours[drawn])),
    }


def _stages(start: Array, moved: Array) -> dict[str, Any]:
    """Both stages in the same steps, so that what did not move does not seem to."""
    low = np.minimum(start.min(0), moved.min(0))
    high = np.maximum(start.max(0), moved.max(0))
    lengths = np.linalg.norm(moved - start, axis=1)
    return {
        "start": packed(start, low, high),
        "result": packed(moved, low, high),
        "moved": packed(lengths[:, None], np.zeros(1)),
        "largest": float(lengths.max()),
    }


def _bytes(colours: Array) -> Pixels:
    return np.rint(np.clip(colours, 0.0, 1.0) * 255.0).astype(np.uint8)


def _mesh(file: PointCloud, start: Array, moved: Array, notes: list[str]) -> dict[str, Any]:
    faces = file.faces()
    assert faces is not None
    pictures = Pictures(file.path)
    paint = file.source.paint(pictures) if file.source else None
    notes += [f"A texture is not drawn: {line}." for line in pictures.missing]
    surface = MovedSurface(start, moved, faces)
    if paint is None:
        colours = file.colours()
        surface.vertex_colours = None if colours is None else _bytes(colours)
    else:
        _put_on(surface, paint)
    every = len(surface.faces)
    surface = _simplified(surface)
    if len(surface.faces) < every:
        notes.append(
            "The mesh is simplified for this page: vertices close to each other are joined, "
            f"{len(surface.faces):,} of {every:,} triangles are drawn. The written file has all."
        )
    groups, uv = [], None
    if surface.of_face is not None and surface.corners is not None:
        order = np.argsort(surface.of_face, kind="stable")
        of_face = surface.of_face[order]
        surface.faces = surface.faces[order]
        if surface.face_colours is not None:
            surface.face_colours = surface.face_colours[order]
        uv = packed(surface.corners[order].reshape(-1, 2))
        for texture in np.unique(of_face).tolist():
            first, last = np.searchsorted(of_face, [texture, texture + 1]).tolist()
            groups.append({"texture": texture, "first": first, "count": last - first})
    kind = "<u2" if len(surface.start) <= 65536 else "<u4"
    colours_of = {"faceColours": surface.face_colours, "vertexColours": surface.vertex_colours}
    return {
        "kind": "mesh",
        "count": len(surface.faces),
        **_stages(surface.start, surface.result),
        "faces": text_of(surface.faces.astype(kind)),
        "wide": kind == "<u4",
        "groups": groups or [{"texture": -1, "first": 0, "count": len(surface.faces)}],
        "uv": uv,
        "textures": [] if paint is None else _texture_uris(paint),
        **{name: None if c is None else text_of(c) for name, c in colours_of.items()},
    }


def _put_on(surface: MovedSurface, paint: Paint) -> None:
    """Give the surface the textures and the colours of a paint."""
    if paint.textures:
        surface.of_face = paint.texture_of_face
        surface.corners = np.zeros((len(surface.faces), 3, 2))
        for texture in paint.textures:
            surface.corners[texture.faces] = texture.corners
    if not (paint.corners == 1.0).all():
        surface.face_colours = _bytes(paint.corners.mean(1))


def _simplified(surface: MovedSurface) -> MovedSurface:
    """The surface with equal vertices joined, and with near ones joined until it is small."""
    cells = float(FINEST_CELLS)
    low = surface.start.min(0)
    while True:
        keys = np.floor((surface.start - low) * cells).astype(np.int64)
        # One number for a cell.
        codes = (keys[:, 0] * 8192 + keys[:, 1]) * 8192 + keys[:, 2]
        _, first, joined = np.unique(codes, return_index=True, return_inverse=True)
        faces = joined.reshape(-1)[surface.faces]
        a, b, c = faces.T
        kept = (a != b) & (b != c) & (c != a)
        if kept.sum() <= MOST_FACES and len(first) <= MOST_VERTICES:
            break
        cells *= COARSER

    def of_faces(values: Any) -> Any:
        return None if values is None else values[kept]

    # Vertices without a face would only widen the steps of the coordinates.
    used, numbered = np.unique(faces[kept], return_inverse=True)
    first = first[used]
    return MovedSurface(
        surface.start[first],
        surface.result[first],
        numbered.reshape(-1, 3),
        of_faces(surface.face_colours),
        None if surface.vertex_colours is None else surface.vertex_colours[first],
        of_faces(surface.of_face),
        of_faces(surface.corners),
    )


def _texture_uris(paint: Paint) -> list[str]:
    """The pictures of a paint as the mesh shows them: times the mean colour of their faces."""
    uris: list[str] = []
    tints = [tuple(_bytes(paint.corners[t.faces].mean((0, 1))).tolist()) for t in paint.textures]
    # Parts of a mesh may share a picture.
    looks = [(id(t.pixels), tint) for t, tint in zip(paint.textures, tints, strict=True)]
    for side in TEXTURE_SIDES:
        uri_of: dict[Any, str] = {}
        for look, texture in zip(looks, paint.textures, strict=True):
            if look not in uri_of:
                image = Image.fromarray(texture.pixels)
                image.thumbnail((side, side), Image.Resampling.BOX)
                tinted = np.rint(np.asarray(image) * (np.array(look[1]) / 255.0))
                uri_of[look] = picture_uri(Image.fromarray(tinted.astype(np.uint8)), photo=True)
        uris = [uri_of[look] for look in looks]
        if sum(map(len, uris)) <= MOST_TEXTURE:
            return uris
    return uris


def _cameras(result: RefineResult, centre: Array, size: float) -> list[dict[str, Any]]:
    cameras = []
    for view in result.views:
        camera = view.camera.for_normalised(centre, size)
        cameras.append({
            "name": view.name,
            "K": camera.K.tolist(),
            "R": camera.R.tolist(),
            "t": camera.t.tolist(),
            "width": camera.width,
            "height": camera.height,
            "model": camera.model,
            "window": list(view.window),
        })  # fmt: skip
    return cameras
