"""Pictures on meshes: the colours of points of the surface, as stored (sRGB).

Nothing is downloaded. Only files in the folder of the mesh or below are read, or in the folder that
the user named or below.
"""

from __future__ import annotations

import base64
import io
import json
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..geometry.arrays import Array, Indices, Pixels
from ..signals import waiting_signals
from .images import FORMATS, PIXEL_LIMIT, as_colours
from .reading import require_memory, shown

_FORMATS = (*FORMATS, "TGA")
# Bytes of a pixel of each picture, and of the one that is decoded.
_KEPT, _DECODING = 8, 16


@dataclass(frozen=True, eq=False)
class Texture:
    """A picture on faces of a mesh; outside texture coordinates 0 to 1 it repeats."""

    pixels: Pixels  # [H, W, 3], the first row on top
    faces: Indices  # [K], the faces of the mesh that the picture covers
    corners: Array  # [K, 3, 2], texture coordinates of their corners: u right, v up from lower left

    def at(self, rows: Indices, barycentric: Array) -> Pixels:
        """Colours [N, 3] of points in the faces ``faces[rows]``.

        ``barycentric`` [N, 2] are the points' coordinates of the second and the third corner.
        """
        first, second, third = self.corners[rows].transpose(1, 0, 2)
        place = first + barycentric[:, :1] * (second - first) + barycentric[:, 1:] * (third - first)
        sides = np.array(self.pixels.shape[1::-1])
        # np.mod may round up to 1.
        column, from_below = np.minimum((np.mod(place, 1.0) * sides).astype(np.int64), sides - 1).T
        return self.pixels[sides[1] - 1 - from_below, column]


class Pictures:
    """The pictures on the parts of a mesh.

    path, content : the file of the mesh and its bytes.
    decode : whether pictures are wanted; if not, they are only removed from the parts.
    within : the folder that the pictures must be in, or below (None: the folder of ``path``).
    resolver : what trimesh shall use to read the files that ``path`` names.
    missing : a line about every picture that cannot be used.
    """

    def __init__(
        self, path: Path, content: bytes, decode: bool, within: Path | None = None
    ) -> None:
        self.missing: list[str] = []
        self.resolver: Any = _Folder(path, within, self._miss, self._opens)
        self._path, self._decode = path, decode
        self._known: dict[int, tuple[Any, Pixels | None]] = {}
        self._pixels = [0, 0]  # of all pictures, and of the largest
        for name, data in _embedded(content) if decode and path.suffix.lower() == ".glb" else ():
            if not self._opens(data):
                self._miss(name, "cannot be decoded")

    def take(self, geometry: Any) -> Pixels | None:
        """Take the picture [H, W, 3] off a part; None if there is none that can be used.

        The part keeps only its plain colour.
        """
        # Pictures only decorate: an unusual material must not stop the work.
        try:
            return self._taken(geometry) if geometry.visual.kind == "texture" else None
        except Exception:
            return None

    def _taken(self, geometry: Any) -> Pixels | None:
        with waiting_signals():
            from trimesh.visual.material import SimpleMaterial

        visual = geometry.visual
        material = visual.material
        factor = getattr(material, "baseColorFactor", None)
        image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
        # trimesh would copy and decode all pictures of the material for each place of the part.
        visual.material = SimpleMaterial(diffuse=material.main_color)
        if image is None or not self._decode:
            return None
        name = str(image.info.get("file_path") or material.name or f"number {len(self._known)}")
        if np.shape(visual.uv) != (len(geometry.vertices), 2) or not np.isfinite(visual.uv).all():
            self._miss(name, "has no coordinates on the mesh")
            return None
        if id(image) not in self._known:
            # The image is kept, so that no other image gets its id.
            self._known[id(image)] = image, self._decoded(image, name)
        pixels = self._known[id(image)][1]
        if pixels is None or factor is None or (factor[:3] == 255).all():
            return pixels
        return np.rint(pixels * (factor[:3] / 255.0)).astype(np.uint8)

    def _decoded(self, image: Any, name: str) -> Pixels | None:
        if image.format is None:
            return None  # trimesh made it for an .obj that has coordinates and no material
        try:
            if image.format not in _FORMATS:
                raise InputError(f"{name}: is {image.format}, expected {', '.join(_FORMATS)}")
            return as_colours(image, Path(name))[..., :3]
        # Decoders fail on damaged files in many ways.
        except Exception:
            self._miss(name, "cannot be decoded")
            return None

    def _opens(self, content: bytes) -> bool:
        """Whether ``content`` is a picture; InputError where there is no memory for all of them."""
        from PIL import Image

        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # its size is checked here
                with Image.open(io.BytesIO(content), formats=_FORMATS) as image:
                    size = image.width * image.height
        except Exception:
            return False
        if self._decode and size <= PIXEL_LIMIT:  # a larger one is not decoded
            self._pixels = [self._pixels[0] + size, max(self._pixels[1], size)]
            require_memory(self._path, _KEPT * self._pixels[0] + _DECODING * self._pixels[1])
        return True

    def _miss(self, name: str, why: str, kind: str = "texture") -> None:
        problem = f"the {kind} {shown(name)} {why}"
        if problem not in self.missing:
            self.missing.append(problem)


class _Folder:
    """The files below ``within`` that the mesh ``path`` may name.

    ``miss`` is called for pictures that are missing or damaged, ``opens`` says whether one is
    readable.
    """

    def __init__(
        self,
        path: Path,
        within: Path | None,
        miss: Callable[..., None],
        opens: Callable[[bytes], bool],
    ) -> None:
        self._folder, self._miss = path.absolute().parent.resolve(), miss
        self._opens = opens
        self._within = self._folder if within is None else within.resolve()

    def get(self, name: str) -> bytes:
        picture = not name.strip().lower().endswith((".mtl", ".bin"))
        slashed = name.strip().replace("\\", "/")
        if slashed.startswith("-"):
            # Options of map_Kd, such as a scale, come before the name. They are ignored.
            slashed = slashed.split()[-1]
        for candidate in (slashed, slashed.rpartition("/")[2]):
            place = (self._folder / candidate).resolve()
            if place.is_relative_to(self._within) and place.is_file():
                content = place.read_bytes()
                if picture and not self._opens(content):
                    self._miss(name, "cannot be decoded")
                return content
        if not slashed.lower().endswith(".bin"):
            self._miss(
                name, "is not in this folder or below", "texture" if picture else "material file"
            )
        raise FileNotFoundError(name)

    __getitem__ = get


def _embedded(content: bytes) -> list[tuple[str, bytes]]:
    """Names and contents of the base colours in a .glb file; trimesh ignores damaged ones."""
    found: dict[int, tuple[str, bytes]] = {}
    try:
        length = int.from_bytes(content[12:16], "little")
        header, buffer = json.loads(content[20 : 20 + length]), content[28 + length :]
        for material in header.get("materials", ()):
            texture = material.get("pbrMetallicRoughness", {}).get("baseColorTexture")
            number = None if texture is None else header["textures"][texture["index"]].get("source")
            if number is None:
                continue
            image = header["images"][number]
            if "bufferView" in image:
                view = header["bufferViews"][image["bufferView"]]
                start = view.get("byteOffset", 0)
                data = buffer[start : start + view["byteLength"]]
            elif "base64," in image["uri"]:
                data = base64.b64decode(image["uri"].partition("base64,")[2])
            else:
                continue  # a file, which the resolver sees
            found[number] = str(image.get("name") or f"number {number}"), data
    # trimesh reports what is wrong with the file.
    except Exception:
        pass
    return list(found.values())
