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
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ..errors import InputError
from ..geometry.arrays import Array, Indices, Pixels
from ..signals import waiting_signals
from .images import FORMATS, PIXEL_LIMIT, as_colours
from .reading import require_memory, shown

# Pixels of all pictures on a mesh: 16 of 8192 x 8192. They take 4 GB and half a minute; pictures of
# one colour take a thousandth of that on disk.
MOST_PIXELS = 1 << 30
TEXTURE_FORMATS = (*FORMATS, "TGA")
# Bytes of a pixel of each picture, and of the one that is decoded.
_KEPT, _DECODING = 3, 16
Tint = tuple[float, float, float]
# What a picture shows outside texture coordinates 0 to 1.
Wrap = Literal["repeat", "mirror", "clamp"]


@dataclass(frozen=True, eq=False)
class Texture:
    """A picture on faces of a mesh."""

    pixels: Pixels  # [H, W, 3], the first row on top
    faces: Indices  # [K], the faces of the mesh that the picture covers
    corners: Array  # [K, 3, 2], texture coordinates of their corners: u right, v up from lower left
    tint: Tint | None = None  # the factors of red, green and blue by which the colours are seen
    wraps: tuple[Wrap, Wrap] = ("repeat", "repeat")  # of u and of v

    def at(self, rows: Indices, barycentric: Array) -> Pixels:
        """Colours [N, 3] of points in the faces ``faces[rows]``.

        ``barycentric`` [N, 2] are the points' coordinates of the second and the third corner.
        """
        first, second, third = self.corners[rows].transpose(1, 0, 2)
        b, c = barycentric[:, :1], barycentric[:, 1:]
        with np.errstate(over="ignore", invalid="ignore"):
            place = first + b * (second - first) + c * (third - first)
        place = np.stack([_wrapped(*one) for one in zip(place.T, self.wraps, strict=True)], 1)
        sides = np.array(self.pixels.shape[1::-1])
        # A place may be 1: np.mod may round up.
        column, from_below = np.minimum((place * sides).astype(np.int64), sides - 1).T
        return self.tinted(self.pixels[sides[1] - 1 - from_below, column])

    def tinted(self, colours: Pixels) -> Pixels:
        """Colours [..., 3] of the picture as the mesh shows them."""
        if self.tint is None:
            return colours
        return np.rint(colours * np.array(self.tint)).astype(np.uint8)


def _wrapped(place: Array, wrap: Wrap) -> Array:
    """Texture coordinates [N] in 0 to 1; 0 for those that are no numbers or overflowed."""
    place = np.where(np.isfinite(place), place, 0.0)
    if wrap == "clamp":
        return np.clip(place, 0.0, 1.0)
    if wrap == "mirror":
        return 1.0 - np.abs(np.mod(place, 2.0) - 1.0)
    return np.asarray(np.mod(place, 1.0))


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
        self.resolver: Any = Folder(path, within, self._miss)
        self._path, self._decode = path, decode
        # Parts and materials may share a picture: by its bytes it is known again.
        self._waiting: dict[bytes, tuple[Any, str]] = {}  # pictures to decode, and their names
        for name, data in _embedded(content) if decode and path.suffix.lower() == ".glb" else ():
            if not _opens(data):
                self._miss(name, "cannot be decoded")

    def take(self, parts: dict[str, Any]) -> dict[str, tuple[Pixels, Tint | None]]:
        """Take the pictures off ``parts``, which keep only their plain colours.

        Returns the picture [H, W, 3] and the tint of each part that has one that can be used.
        Raises InputError if the pictures are too large to be decoded together.
        """
        found: dict[str, tuple[bytes, Tint | None]] = {}
        for name, part in parts.items():
            # Pictures only decorate: an unusual material must not stop the work.
            with suppress(Exception):
                if part.visual.kind == "texture" and (taken := self._taken(part)):
                    found[name] = taken
        self._check_sizes()
        # A picture that is decoded is forgotten: only its colours stay.
        decoded = {data: self._decoded(*self._waiting.pop(data)) for data in list(self._waiting)}
        known = {data: pixels for data, pixels in decoded.items() if pixels is not None}
        return {name: (known[data], tint) for name, (data, tint) in found.items() if data in known}

    def _taken(self, geometry: Any) -> tuple[bytes, Tint | None] | None:
        """The bytes of the picture on a part and its tint."""
        with waiting_signals():
            from trimesh.visual.material import SimpleMaterial

        visual = geometry.visual
        material = visual.material
        factor = getattr(material, "baseColorFactor", None)
        image = getattr(material, "baseColorTexture", None) or getattr(material, "image", None)
        # trimesh would copy and decode all pictures of the material for each place of the part.
        visual.material = SimpleMaterial(diffuse=material.main_color)
        # trimesh makes an image without a format for an .obj that has coordinates and no material.
        if image is None or image.format is None or not self._decode:
            return None
        name = str(image.info.get("file_path") or material.name or f"number {len(self._waiting)}")
        if np.shape(visual.uv) != (len(geometry.vertices), 2) or not np.isfinite(visual.uv).all():
            self._miss(name, "has no coordinates on the mesh")
            return None
        data = image.fp.getvalue()
        self._waiting.setdefault(data, (image, name))
        if factor is None or (factor[:3] == 255).all():
            return data, None
        red, green, blue = (factor[:3] / 255.0).tolist()
        return data, (red, green, blue)

    def _check_sizes(self) -> None:
        """Raise InputError if the pictures have too many pixels, or there is no memory for all.

        Their headers state their sizes: nothing has been decoded yet.
        """
        sizes = [image.width * image.height for image, _ in self._waiting.values()]
        sizes = [size for size in sizes if size <= PIXEL_LIMIT]  # a larger one is not decoded
        if sum(sizes) > MOST_PIXELS:
            raise InputError(
                f"{self._path}: its textures have {sum(sizes):,} pixels together, "
                f"expected at most {MOST_PIXELS:,}; make them smaller"
            )
        require_memory(self._path, _KEPT * sum(sizes) + _DECODING * max(sizes, default=0))

    def _decoded(self, image: Any, name: str) -> Pixels | None:
        try:
            if image.format not in TEXTURE_FORMATS:
                raise InputError(
                    f"{name}: is {image.format}, expected {', '.join(TEXTURE_FORMATS)}"
                )
            return np.ascontiguousarray(as_colours(image, Path(name))[..., :3])
        # Decoders fail on damaged files in many ways.
        except Exception:
            self._miss(name, "cannot be decoded")
            return None

    def _miss(self, name: str, why: str, kind: str = "texture") -> None:
        problem = f"the {kind} {shown(name)} {why}"
        if problem not in self.missing:
            self.missing.append(problem)


class Folder:
    """The files below ``within`` that the mesh ``path`` may name.

    ``miss`` is called for pictures that are missing or damaged.
    """

    def __init__(self, path: Path, within: Path | None, miss: Callable[..., None]) -> None:
        self._folder, self._miss = path.absolute().parent.resolve(), miss
        self._read: dict[Path, bytes] = {}  # many materials may name one file
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
                if place not in self._read:
                    self._read[place] = place.read_bytes()
                    if picture and not _opens(self._read[place]):
                        self._miss(name, "cannot be decoded")
                return self._read[place]
        if not slashed.lower().endswith(".bin"):
            self._miss(
                name, "is not in this folder or below", "texture" if picture else "material file"
            )
        raise FileNotFoundError(name)

    __getitem__ = get


def _opens(content: bytes) -> bool:
    """Whether ``content`` is a picture."""
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # sizes are checked later, all together
            Image.open(io.BytesIO(content), formats=TEXTURE_FORMATS).close()
    except Exception:
        return False
    return True


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
