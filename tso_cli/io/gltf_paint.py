"""The base colours of a glTF scene's materials: a factor, and a picture with its coordinates."""

from __future__ import annotations

import base64
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any
from urllib.parse import unquote

import numpy as np

from ..errors import InputError
from ..geometry.arrays import Array, Pixels
from .gltf_scene import base_colour_of
from .paint import Decoder
from .textures import Folder, Wrap

_WRAPS: dict[int, Wrap] = {10497: "repeat", 33648: "mirror", 33071: "clamp"}
_TRANSFORM = "KHR_texture_transform"


@dataclass(frozen=True, eq=False)
class Coat:
    """What a material shows: its factor [3], times a picture.

    coordinates : which TEXCOORD of the vertices places the picture.
    scale, offset : [2], of these coordinates.
    """

    factor: Array
    picture: Pixels | None = None
    coordinates: int = 0
    wraps: tuple[Wrap, Wrap] = ("repeat", "repeat")
    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)

    def placed(self, coordinates: Array) -> Array:
        """Places [N, 2] as `Texture` has them: u right, v up. glTF has v down."""
        moved = coordinates * self.scale + self.offset
        if not np.isfinite(moved).all():
            raise InputError("texture coordinates are not finite")
        return np.stack([moved[:, 0], 1.0 - moved[:, 1]], 1)


class Materials:
    """The materials of a scene's ``document``, each read when it is met.

    ``bytes_of`` gives the bytes of a buffer view. Errors of any kind say that the document is
    damaged or a picture missing.
    """

    def __init__(
        self, document: dict[str, Any], bytes_of: Callable[[int], bytes], folder: Folder
    ) -> None:
        self._document, self._bytes_of, self._folder = document, bytes_of, folder
        self._pictures: dict[int, Pixels] = {}
        self._decode = Decoder()

    def coat(self, number: int | None) -> Coat:
        """The material ``number``; None is that of a primitive without one, which is white."""
        if number is None:
            return Coat(np.ones(3))
        base = base_colour_of(self._document["materials"][number])
        factor = np.array(base.get("baseColorFactor", [1.0] * 4), dtype=np.float64)[:3]
        picture = base.get("baseColorTexture")
        if picture is None:
            return Coat(factor)
        texture = self._document["textures"][picture["index"]]
        sampler = self._document["samplers"][texture["sampler"]] if "sampler" in texture else {}
        across, down = (_WRAPS[sampler.get(key, 10497)] for key in ("wrapS", "wrapT"))
        moved = picture.get("extensions", {}).get(_TRANSFORM, {})
        if moved.get("rotation", 0.0) != 0.0:
            raise InputError("a texture is rotated on its mesh, which tso does not read")
        u, v = moved.get("scale", (1.0, 1.0))
        right, below = moved.get("offset", (0.0, 0.0))
        return Coat(
            factor,
            self._picture(texture),
            moved.get("texCoord", picture.get("texCoord", 0)),
            (across, down),
            (float(u), float(v)),
            (float(right), float(below)),
        )

    def _picture(self, texture: dict[str, Any]) -> Pixels:
        # A form such as WebP has its own source; the plain one is for readers without this form.
        sources = [texture, *texture.get("extensions", {}).values()]
        number = next(one["source"] for one in sources if "source" in one)
        if number not in self._pictures:
            self._pictures[number] = self._decoded(number)
        return self._pictures[number]

    def _decoded(self, number: int) -> Pixels:
        image = self._document["images"][number]
        if "bufferView" in image:
            name = str(image.get("name") or f"number {number}")
            return self._decode(self._bytes_of(image["bufferView"]), name)
        uri = image["uri"]
        if uri[:5].lower() == "data:":
            return self._decode(base64.b64decode(uri.partition(",")[2]), f"number {number}")
        return self._decode(self._folder.get(unquote(uri)), uri)
