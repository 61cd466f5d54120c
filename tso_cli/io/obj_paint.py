"""The colours of an OBJ file's faces: map_Kd of their materials, or Kd where there is none."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from ..geometry.arrays import Array, Indices
from .paint import Paint, Pictures, Texture, Wrap

# Options of map_Kd before the name of the file, with their values.
_OPTION = re.compile(
    r"-(\w+)((?:\s+(?:on|off|[rgbmlz]|sphere|cube_\w+|[-+]?[\d.]+(?:e[-+]?\d+)?)(?=\s))+)\s+",
    re.IGNORECASE,
)


@dataclass
class Material:
    """A material of an .mtl file; scale and offset [2] are of texture coordinates."""

    colour: tuple[float, ...] = (1.0, 1.0, 1.0)
    picture: str = ""  # the name of the file
    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)
    wrap: Wrap = "repeat"


def painted(
    names: Sequence[bytes],
    materials: Mapping[bytes, Material],
    corners: Indices,
    coordinates: Array,
    pictures: Pictures,
) -> Paint:
    """The paint of triangles whose materials have ``names`` [F].

    ``corners`` [F, 3] index the texture ``coordinates`` [M, 2]; -1 is a corner that has none.
    """
    of_name = {b"": Material()}
    for name in dict.fromkeys(names):
        # A comment may follow a name, which may have a # too.
        shorter = name.partition(b" #")[0].strip()
        material = materials.get(name) or materials.get(shorter)
        if name and materials and material is None:
            text = name.decode("utf-8", "replace")
            pictures.miss(text, "is in none of its material files", "material")
        of_name[name] = material or Material()
    colours = np.array([of_name[name].colour for name in names]).reshape(-1, 1, 3)
    of_faces, textures = np.array(names, dtype=object), []
    for name, material in of_name.items():
        faces = np.flatnonzero((of_faces == name) & (corners >= 0).all(1))
        pixels = pictures.of_file(material.picture) if material.picture else None
        if pixels is None:
            continue
        places = coordinates[corners[faces]] * material.scale + material.offset
        if len(faces) == 0:
            pictures.miss(material.picture, "has no coordinates on the mesh")
        elif not np.isfinite(places).all():
            pictures.miss(material.picture, "has coordinates that are not finite")
        else:
            colours[faces] = 1.0
            textures.append(Texture(pixels, faces, places, (material.wrap, material.wrap)))
    return Paint.of_parts([np.repeat(colours, 3, axis=1)], textures)


def read_materials(libraries: Iterable[str], pictures: Pictures) -> dict[bytes, Material]:
    """The materials of the .mtl files ``libraries`` by their names."""
    materials: dict[bytes, Material] = {}
    for library in libraries:
        path = pictures.file(library, "material file")
        lines = b"" if path is None else path.read_bytes().replace(b"\r", b"\n")
        name, material = b"", Material()
        for line in re.split(rb"\n|^\xef\xbb\xbf", lines.replace(b"\t", b" ")):
            key, _, rest = line.strip().partition(b" ")
            if key.lower() == b"newmtl":
                name = rest.strip()
                material = materials[name] = Material()
            elif key.lower() == b"kd":
                with suppress(ValueError):
                    colour = tuple(float(word) for word in rest.split()[:3])
                    if len(colour) == 3 and np.isfinite(colour).all():
                        material.colour = colour
                        continue
                text = name.decode("utf-8", "replace")
                pictures.miss(text, "has a Kd that is not three numbers", "material")
            elif key.lower() == b"map_kd":
                _read_picture(material, rest.strip().decode("utf-8", "replace"))
    return materials


def _read_picture(material: Material, text: str) -> None:
    """Read the value of a map_Kd: options, and the name of the file."""
    while option := _OPTION.match(text):
        text = text[option.end() :]
        name, values = option[1].lower(), option[2].split()
        with suppress(ValueError):  # of words in place of numbers
            if name == "clamp":
                material.wrap = "clamp" if values == ["on"] else "repeat"
            elif name == "s":
                material.scale = _pair(values, 1.0)
            elif name == "o":
                material.offset = _pair(values, 0.0)
    material.picture = text


def _pair(words: list[str], missing: float) -> tuple[float, float]:
    """The first two of one to three numbers."""
    first, second, *_ = [*map(float, words), missing]
    return first, second
