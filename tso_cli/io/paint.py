"""The colours of a mesh's surface, for the comparison with its photo.

Pictures count as they are stored, in sRGB, as the pixels of a photo do. Factors multiply these
values; glTF multiplies linear ones. The comparison does not see a factor that is the same for all
of a mesh.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.arrays import Array, Indices, Pixels
from .images import as_colours
from .reading import shown
from .textures import MOST_PIXELS, TEXTURE_FORMATS, Texture

# Of a picture, px. It is shrunk to about that: a photo shows no finer paint.
LONGEST_SIDE = 1024
# Corners whose colours differ by less have one colour.
ALIKE = 1.0 / 255.0


@dataclass(frozen=True, eq=False)
class Paint:
    """Colours of a surface: those of the corners of its faces, times the pictures on them."""

    corners: NDArray[np.float32]  # [F, 3, 3], red, green and blue of the corners of each face
    textures: tuple[Texture, ...]  # each on other faces, which are in ascending order

    @classmethod
    def of(cls, corners: Sequence[Array], textures: Sequence[Texture]) -> Paint | None:
        """The paint of parts whose ``corners`` [K, 3, 3] are given; None if it is of one colour."""
        joined = np.concatenate([np.empty((0, 3, 3)), *corners]).astype(np.float32)
        if not np.isfinite(joined).all():
            raise InputError("a colour is not finite")
        plain = len(joined) == 0 or bool((np.ptp(joined, axis=(0, 1)) < ALIKE).all())
        return None if plain and not textures else cls(joined, tuple(textures))

    def at(self, faces: Indices, shares: Array) -> Array:
        """Colours [N, 3] in [0, 1] of points in ``faces`` [N], ``shares`` [N, 3] barycentric."""
        colours: Array = np.einsum("nk,nkc->nc", shares, self.corners[faces].astype(np.float64))
        for texture in self.textures:
            row = np.searchsorted(texture.faces, faces)
            row = np.minimum(row, len(texture.faces) - 1)
            on = texture.faces[row] == faces
            colours[on] *= texture.at(row[on], shares[on, 1:]) / 255.0
        return np.clip(colours, 0.0, 1.0)


class Decoder:
    """Decodes the pictures of one mesh, up to `MOST_PIXELS` together."""

    def __init__(self) -> None:
        self._room = MOST_PIXELS

    def __call__(self, data: bytes, name: str) -> Pixels:
        """The picture in ``data`` [H, W, 3]; InputError if it cannot be decoded."""
        from PIL import Image

        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of sizes, which are checked here
                with Image.open(io.BytesIO(data), formats=TEXTURE_FORMATS) as image:
                    self._room -= image.width * image.height
                    if self._room < 0:
                        raise ValueError("too many pixels")
                    pixels = np.ascontiguousarray(as_colours(image, Path(name))[..., :3])
            factor = max(1, max(pixels.shape) // LONGEST_SIDE)
            return np.asarray(Image.fromarray(pixels).reduce(factor))
        # Decoders fail on damaged files in many ways.
        except Exception:
            why = "cannot be decoded"
            if self._room < 0:
                why = f"is one too many: expected at most {MOST_PIXELS:,} pixels in all"
            raise InputError(f"the texture {shown(name)} {why}") from None


def refuse(name: str, why: str, kind: str = "texture") -> None:
    """What a `Folder` calls for a file that it does not have. Raises InputError."""
    raise InputError(f"the {kind} {shown(name)} {why}")
