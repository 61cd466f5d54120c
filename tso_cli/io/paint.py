"""The colours of a mesh's surface: colours of its corners, and the pictures on its faces.

Pictures count as they are stored, in sRGB, as the pixels of a photo do. Factors multiply these
values; glTF multiplies linear ones. A comparison with a photo does not see a factor that is the
same for all of a mesh.

Nothing is downloaded. Only files in the folder of the mesh or below are read, or in the folder that
the user named or below.
"""

from __future__ import annotations

import io
import warnings
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.arrays import Array, Indices, Pixels
from .images import FORMATS, as_colours
from .reading import shown

# Pixels of all pictures on a mesh: 16 of 8192 x 8192. To decode them takes half a minute; pictures
# of one colour take a thousandth of that on disk.
MOST_PIXELS = 1 << 30
TEXTURE_FORMATS = (*FORMATS, "TGA")
# Pictures are shrunk by a whole factor until their longer side is under twice this, px: a photo
# shows no finer paint.
LONGEST_SIDE = 1024
# Colours that differ by less are taken as equal.
ALIKE = 1.0 / 255.0
# What a picture shows outside texture coordinates 0 to 1.
Wrap = Literal["repeat", "mirror", "clamp"]


@dataclass(frozen=True, eq=False)
class Texture:
    """A picture on faces of a mesh."""

    pixels: Pixels  # [H, W, 3], the first row on top
    faces: Indices  # [K], the faces of the mesh that the picture covers
    corners: Array  # [K, 3, 2], texture coordinates of their corners: u right, v up from lower left
    wraps: tuple[Wrap, Wrap] = ("repeat", "repeat")  # of u and of v

    def at(self, rows: Indices, barycentric: Array) -> Pixels:
        """Colours [N, 3] of points in the faces ``faces[rows]``.

        ``barycentric`` [N, 2] are the points' coordinates of the second and the third corner.
        """
        first, second, third = self.corners[rows].transpose(1, 0, 2)
        b, c = barycentric[:, :1], barycentric[:, 1:]
        with np.errstate(over="ignore", invalid="ignore"):
            place = first + b * (second - first) + c * (third - first)
        place = np.stack([_wrapped(*pair) for pair in zip(place.T, self.wraps, strict=True)], 1)
        sides = np.array(self.pixels.shape[1::-1])
        # A place may be 1: np.mod may round up.
        column, from_below = np.minimum((place * sides).astype(np.int64), sides - 1).T
        return self.pixels[sides[1] - 1 - from_below, column]


def _wrapped(place: Array, wrap: Wrap) -> Array:
    """Texture coordinates [N] in 0 to 1; 0 for those that are no numbers or overflowed."""
    place = np.where(np.isfinite(place), place, 0.0)
    if wrap == "clamp":
        return np.clip(place, 0.0, 1.0)
    if wrap == "mirror":
        return 1.0 - np.abs(np.mod(place, 2.0) - 1.0)
    return np.asarray(np.mod(place, 1.0))


@dataclass(frozen=True, eq=False)
class Paint:
    """Colours of a surface: those of the corners of its faces, times the pictures on them."""

    corners: NDArray[np.float32]  # [F, 3, 3], red, green and blue of the corners of each face
    textures: tuple[Texture, ...] = ()  # each on other faces

    @classmethod
    def of_parts(cls, corners: Sequence[Array], textures: Sequence[Texture]) -> Paint:
        """The paint of parts whose ``corners`` [K, 3, 3] are given; InputError if not finite."""
        joined = np.concatenate([np.empty((0, 3, 3)), *corners]).astype(np.float32)
        if not np.isfinite(joined).all():
            raise InputError("a colour is not finite")
        return cls(joined, tuple(textures))

    @classmethod
    def of_vertices(cls, colours: Array, faces: Indices) -> Paint:
        """The paint of ``faces`` [F, 3] whose vertices have ``colours`` [V, 3] in [0, 1]."""
        return cls(colours.astype(np.float32)[faces])

    @classmethod
    def of_faces(cls, colours: Pixels) -> Paint:
        """The paint of faces that have ``colours`` [F, 3] of 0 to 255."""
        return cls(np.repeat(colours[:, None] / np.float32(255.0), 3, axis=1))

    @property
    def is_plain(self) -> bool:
        """Whether the surface has one colour."""
        alike = len(self.corners) == 0 or bool((np.ptp(self.corners, axis=(0, 1)) < ALIKE).all())
        return alike and not self.textures

    @cached_property
    def texture_of_face(self) -> Indices:
        """[F], the number of the texture of each face, -1 for none."""
        numbers = np.full(len(self.corners), -1)
        for number, texture in enumerate(self.textures):
            numbers[texture.faces] = number
        return numbers

    @cached_property
    def _row_of_face(self) -> Indices:
        """[F], which of the faces of its texture each face is."""
        rows = np.zeros(len(self.corners), np.int64)
        for texture in self.textures:
            rows[texture.faces] = np.arange(len(texture.faces))
        return rows

    def at(self, faces: Indices, shares: Array) -> Array:
        """Colours [N, 3] in [0, 1] of points in ``faces`` [N], ``shares`` [N, 3] barycentric."""
        colours: Array = np.einsum("nk,nkc->nc", shares, self.corners[faces].astype(np.float64))
        numbers = self.texture_of_face[faces]
        for number in np.unique(numbers[numbers >= 0]).tolist():
            textured = numbers == number
            rows = self._row_of_face[faces[textured]]
            pixels = self.textures[number].at(rows, shares[textured, 1:])
            colours[textured] *= pixels / 255.0
        return np.clip(colours, 0.0, 1.0)


class Pictures:
    """The pictures that the mesh in ``path`` names or holds, `MOST_PIXELS` together at most.

    within : the folder that files must be in, or below (None: the folder of ``path``).
    longest : pictures are shrunk until their longer side is about that, px.
    missing : a line about each file or picture that cannot be used.
    """

    def __init__(self, path: Path, within: Path | None = None, longest: int = LONGEST_SIDE) -> None:
        self.missing: list[str] = []
        self._folder = path.absolute().parent.resolve()
        self._within = self._folder if within is None else within.resolve()
        self._longest, self._room = longest, MOST_PIXELS
        self._decoded: dict[bytes, Pixels | None] = {}  # many materials may share a picture

    def file(self, name: str, what: str = "texture") -> Path | None:
        """The file that the mesh calls ``name``; None if it is missing or elsewhere."""
        slashed = name.strip().replace("\\", "/")
        if slashed.startswith("-"):
            # Options of map_Kd that are not known come before the name.
            slashed = slashed.split()[-1]
        for candidate in (slashed, slashed.rpartition("/")[2]):
            with suppress(OSError, ValueError):  # of names that no file can have
                place = (self._folder / candidate).resolve()
                if place.is_relative_to(self._within) and place.is_file():
                    return place
        self.miss(name, "is not in this folder or below", what)
        return None

    def of_file(self, name: str) -> Pixels | None:
        """The picture [H, W, 3] in the file that the mesh calls ``name``, or None."""
        path = self.file(name)
        return None if path is None else self.decoded(path.read_bytes(), name)

    def decoded(self, data: bytes, name: str) -> Pixels | None:
        """The picture in ``data`` [H, W, 3], or None."""
        if data not in self._decoded:
            self._decoded[data] = self._decode(data, name)
        return self._decoded[data]

    def _decode(self, data: bytes, name: str) -> Pixels | None:
        from PIL import Image

        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of sizes, which are checked here
                with Image.open(io.BytesIO(data), formats=TEXTURE_FORMATS) as image:
                    self._room -= image.width * image.height
                    if self._room < 0:
                        raise ValueError("too many pixels")
                    pixels = np.ascontiguousarray(as_colours(image, Path(name))[..., :3])
            factor = max(1, max(pixels.shape) // self._longest)
            return np.asarray(Image.fromarray(pixels).reduce(factor))
        # Decoders fail on damaged files in many ways.
        except Exception:
            why = "cannot be decoded"
            if self._room < 0:
                why = f"is one too many: expected at most {MOST_PIXELS:,} pixels in all"
            self.miss(name, why)
            return None

    def miss(self, name: str, why: str, what: str = "texture") -> None:
        """Add a line to ``missing``: the texture ``name`` cannot be used, and ``why``."""
        instead = "white" if what == "material" else "the material's colour"
        line = f"the {what} {shown(name)} {why}, {instead} is used"
        if line not in self.missing:
            self.missing.append(line)
