"""The renders of ShapeNet made for 3D-R2N2 (Choy et al., 2016), which many others use too.

    ROOT/SYNSET/MODEL/rendering/00.png                   picture; its alpha channel is the mask
                                rendering_metadata.txt   a line per picture: azimuth, elevation,
                                                         in-plane rotation (degrees), distance
                                                         ratio, field of view (25, not used)
                                renderings.txt           the picture of each line; if there is no
                                                         such file, NN.png has line NN

ROOT may also be the folder that holds ShapeNetRendering. Points of the surfaces may be in folders
next to ShapeNetRendering: ShapeNet_pcl/SYNSET/MODEL/pcl_1024_fps_trimesh.npy, or if that is missing
ShapeNetVox32/SYNSET/MODEL/model.binvox.

`io.cameras.of_r2n2` says what a line of the table means.

The models of ShapeNet are centred at the origin, and so are the grids of .binvox files as
`io.shapes` reads them.
"""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..geometry.arrays import Floats, Pixels
from ..geometry.camera import Camera
from ..io.cameras.of_r2n2 import FOCAL, pose
from ..io.cameras.record import of_longer_sides
from ..io.images import read_image
from ..io.reading import read_bytes, shown
from ..io.shapes import grid_surface
from . import common
from .items import Dataset, ViewItem

RENDERED, VOXELS = "ShapeNetRendering", "ShapeNetVox32"
PICTURES = "rendering"
TABLE, LIST = "rendering_metadata.txt", "renderings.txt"
_PICTURE = re.compile(r"([0-9]{2,9})\.png")


def open_r2n2(root: Path, strict: bool = False) -> Dataset:
    """The objects of this layout, named SYNSET/MODEL, in ShapeNet's frame and scale."""
    if (root / RENDERED).is_dir():
        root = root / RENDERED
    place = root.resolve()
    targets, voxels = common.find_clouds(place), place.with_name(VOXELS)
    if targets is None and voxels.is_dir():
        targets = common.Targets(voxels, "model.binvox", voxel_target)
    return common.open_models(place.name, root, _LAYOUT, targets, strict)


def r2n2_camera(
    azimuth: float, elevation: float, ratio: float, size: tuple[int, int], rotation: float = 0.0
) -> Camera:
    """The camera of a view, from the axes of ShapeNet's models (y up) to pixels.

    ``size`` is width, height. The other values are as in the table: degrees, and the distance
    ratio.
    """
    R, t = pose(azimuth, elevation, ratio, rotation)
    return Camera(of_longer_sides(FOCAL)(*size), R, t, *size)


def voxel_target(path: str) -> Floats:
    """Points [POINTS, 3] of the boundary of the occupied voxels, in the frame of the model."""
    return common.surface_target(*grid_surface(Path(path)))


def _pictures(folder: Path) -> list[common.Picture]:
    if not folder.is_dir():
        raise InputError(f"{folder}: does not exist, expected the pictures of this object")
    files = common.listed(folder)[1]
    if LIST in files:
        data = read_bytes(folder / LIST, "the names of the pictures", common.TABLE_LIMIT)
        text = data.decode("utf-8", "replace")
        numbered = list(enumerate(line.strip() for line in text.split("\n") if line.strip()))
    else:
        numbered = sorted(
            (int(match[1]), match[0]) for match in map(_PICTURE.fullmatch, files) if match
        )
    if not numbered:
        raise InputError(f"{folder}: holds no picture, expected 00.png and so on")
    table = folder / TABLE
    rows = common.read_table(table, 4, 4, "azimuth, elevation, rotation and distance ratio")
    pictures = []
    for line, file in numbered:
        problem = ""
        if file not in files:
            file = shown(file)
            problem = f"{folder / LIST}: names {file}, expected a picture in this folder"
        elif line >= len(rows):
            problem = f"{table}: has {len(rows)} rows, expected one for {file}"
        elif rows[line, 3] <= 0.0:
            problem = (
                f"{table}: line {line + 1} has a distance ratio of {rows[line, 3]:g}, "
                "expected more than 0"
            )
        pictures.append(common.Picture(file, rows[line : line + 1], problem, file))
    return pictures


def _view(folder: Path, file: str, row: list[float], size: tuple[int, int]) -> ViewItem:
    azimuth, elevation, rotation, ratio = row
    camera = r2n2_camera(azimuth, elevation, ratio, size, rotation)
    return ViewItem(str(folder / file), camera, partial(_load, folder / file, camera))


def _load(picture: Path, camera: Camera) -> tuple[Pixels, Floats]:
    pixels = read_image(picture)
    common.require_size(picture, pixels, camera, "as the first picture of its category")
    if pixels.shape[2] != 4:
        raise InputError(f"{picture}: has no alpha channel, expected the mask there")
    mask = pixels[..., 3].astype(np.float32) / np.float32(255.0)
    return np.ascontiguousarray(pixels[..., :3]), mask


_EXPECTED = f"SYNSET/MODEL/{PICTURES} with 00.png and {TABLE}"
_LAYOUT = common.ModelLayout("renders of 3D-R2N2", _EXPECTED, _pictures, _view, subfolder=PICTURES)
