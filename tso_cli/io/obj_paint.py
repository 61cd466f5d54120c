"""The colours of an OBJ file's faces: map_Kd of their materials, or Kd where there is none."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from ..geometry.arrays import Array
from .paint import Paint, Pictures, Texture


@dataclass
class _Material:
    colour: tuple[float, ...] = (1.0, 1.0, 1.0)
    picture: str = ""  # the name of the file


def read_paint(text: bytes, libraries: Iterable[str], pictures: Pictures, count: int) -> Paint:
    """The paint of the ``count`` triangles of a ``text``, which is `simplified`.

    ``libraries`` name the .mtl files. Errors of any kind say that a file is damaged.
    """
    materials = {b"": _Material()}
    for library in libraries:
        if (path := pictures.file(library, "material file")) is not None:
            materials |= _materials(path.read_bytes())
    places, corners, names, current = [[0.0, 0.0]], [], [], b""
    for line in text.split(b"\n"):
        key, _, rest = line.strip().replace(b"\t", b" ").partition(b" ")
        if key == b"vt":
            numbers = [float(word) for word in rest.split()[:2]]
            places.append([*numbers, 0.0][:2])
        elif key == b"usemtl":
            current = rest.strip()
        elif key == b"f":
            # 0 stands for a corner without texture coordinates; others count from 1.
            named = [int((word.split(b"/") + [b""])[1] or 0) for word in rest.split()]
            fan = [(named[0], *named[k : k + 2]) for k in range(1, len(named) - 1)]
            corners += fan
            names += [current] * len(fan)
    if len(names) != count:
        raise InputError(f"{len(names)} triangles have a material, expected {count}")
    of_corners, of_faces = np.array(corners).reshape(-1, 3), np.array(names, dtype=object)
    of_used = {name: materials.get(name, _Material()) for name in dict.fromkeys(names)}
    colours = np.array([of_used[name].colour for name in names]).reshape(-1, 1, 3)
    textures = []
    for name, material in of_used.items():
        faces = np.flatnonzero((of_faces == name) & (of_corners > 0).all(1))
        pixels = pictures.of_file(material.picture) if material.picture else None
        if pixels is not None and len(faces) == 0:
            pictures.miss(material.picture, "has no coordinates on the mesh")
        elif pixels is not None:
            colours[faces] = 1.0
            textures.append(Texture(pixels, faces, _at(places, of_corners[faces])))
    return Paint.of_parts([np.repeat(colours, 3, axis=1)], textures)


def _at(places: list[list[float]], corners: Array) -> Array:
    coordinates: Array = np.array(places)[corners]
    if not np.isfinite(coordinates).all():
        raise InputError("texture coordinates are not finite")
    return coordinates


def _materials(text: bytes) -> dict[bytes, _Material]:
    """The materials of a .mtl file by their names."""
    materials: dict[bytes, _Material] = {}
    current = _Material()
    for line in text.replace(b"\r", b"\n").replace(b"\t", b" ").split(b"\n"):
        key, _, rest = line.strip().partition(b" ")
        if key.lower() == b"newmtl":
            current = materials[rest.strip()] = _Material()
        elif key.lower() == b"kd":
            current.colour = tuple(float(word) for word in rest.split()[:3])
        elif key.lower() == b"map_kd":
            current.picture = rest.strip().decode("utf-8", "replace")
    return materials
