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
from .output import reason
from .paint import Pictures, Wrap

_WRAPS: dict[int, Wrap] = {10497: "repeat", 33648: "mirror", 33071: "clamp"}
_TRANSFORM = "KHR_texture_transform"


@dataclass(frozen=True, eq=False)
class Coat:
    """What a material shows: its factor [3], times a picture.

    coordinates : which TEXCOORD of the vertices places the picture.
    scale, offset : [2], of these coordinates.
    """

    factor: Array
    name: str = ""  # of the picture
    picture: Pixels | None = None
    coordinates: int = 0
    wraps: tuple[Wrap, Wrap] = ("repeat", "repeat")
    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)

    def placed(self, coordinates: Array) -> Array:
        """Places [N, 2] as `Texture` has them: u right, v up. glTF has v down."""
        moved = coordinates * self.scale + self.offset
        return np.stack([moved[:, 0], 1.0 - moved[:, 1]], 1)


class Materials:
    """The materials of a scene's ``document``, each read when it is met.

    ``bytes_of`` gives the bytes of a buffer view.
    """

    def __init__(
        self, document: dict[str, Any], bytes_of: Callable[[int], bytes], pictures: Pictures
    ) -> None:
        self._document, self._bytes_of, self._pictures = document, bytes_of, pictures
        self._decoded: dict[int, tuple[str, Pixels | None]] = {}

    def coat(self, number: int | None) -> Coat:
        """The material ``number``; white if there is none, or if it is damaged."""
        if number is None:
            return Coat(np.ones(3))
        try:
            return self._read(self._document["materials"][number])
        except Exception as error:
            self._pictures.miss(f"number {number}", f"cannot be read ({reason(error)})", "material")
            return Coat(np.ones(3))

    def _read(self, material: dict[str, Any]) -> Coat:
        base = base_colour_of(material)
        factor = np.array(base.get("baseColorFactor", [1.0] * 4), dtype=np.float64)[:3]
        if factor.shape != (3,) or not np.isfinite(factor).all():
            raise InputError("its baseColorFactor is not four numbers")
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
            *self._picture(texture),
            moved.get("texCoord", picture.get("texCoord", 0)),
            (across, down),
            (float(u), float(v)),
            (float(right), float(below)),
        )

    def _picture(self, texture: dict[str, Any]) -> tuple[str, Pixels | None]:
        """The name of the picture of a texture and, if it can be used, its pixels [H, W, 3]."""
        # A form such as WebP has its own source; the plain one is for readers without this form.
        sources = [texture, *texture.get("extensions", {}).values()]
        number = next(source["source"] for source in sources if "source" in source)
        if number not in self._decoded:
            image = self._document["images"][number]
            name, uri = str(image.get("name") or f"number {number}"), image.get("uri", "")
            if "bufferView" in image:
                pixels = self._pictures.decoded(self._bytes_of(image["bufferView"]), name)
            elif uri[:5].lower() == "data:":
                pixels = self._pictures.decoded(base64.b64decode(uri.partition(",")[2]), name)
            else:
                name = unquote(image["uri"])
                pixels = self._pictures.of_file(name)
            self._decoded[number] = name, pixels
        return self._decoded[number]
