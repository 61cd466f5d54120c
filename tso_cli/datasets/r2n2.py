"""The renders of ShapeNet made for 3D-R2N2 (Choy et al., 2016), used since by AtlasNet, Pixel2Mesh and many others.

    ROOT/SYNSET/MODEL/rendering/00.png                   picture with alpha, which is the mask
                                rendering_metadata.txt   a line each: azimuth, elevation, in-plane rotation (degrees),
                                                         distance ratio, field of view (25, unused)
                                renderings.txt           which picture each line is of; without it NN.png is line NN

ROOT may also be the folder that holds ShapeNetRendering. Beside ShapeNetRendering may stand points of the surfaces, taken from
ShapeNet_pcl/SYNSET/MODEL/pcl_1024_fps_trimesh.npy, else from ShapeNetVox32/SYNSET/MODEL/model.binvox.

Facts about the data, from the code that rendered it: the camera stands at 1.75 times the distance ratio and looks at the
origin; in the axes of the models (y up) its direction is (cos el cos az, sin el, cos el sin az). The lens is Blender's default,
35 mm on a sensor of 32 mm, whatever the last column says. The in-plane rotation, 0 in the published files, turns the picture.

The models of ShapeNet are centred at the origin, and so are the grids of .binvox files as `io.shapes` reads them.
"""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..geometry.camera import Camera
from ..io.images import read_image
from ..io.reading import read_bytes, shown
from ..io.shapes import grid_surface
from . import common
from .items import Dataset, Floats, Pixels, ViewItem

RENDERED, VOXELS = "ShapeNetRendering", "ShapeNetVox32"
PICTURES = "rendering"
TABLE, LIST = "rendering_metadata.txt", "renderings.txt"
FARTHEST = 1.75
LENS_MM, SENSOR_MM = 35.0, 32.0
_PICTURE = re.compile(r"([0-9]{2,9})\.png")


def open_r2n2(root: Path, strict: bool = False) -> Dataset:
    """The objects of this layout; they are named SYNSET/MODEL, in the frame and scale of ShapeNet's models."""
    if (root / RENDERED).is_dir():
        root = root / RENDERED
    place = root.resolve()
    targets, voxels = common.clouds_beside(place), place.with_name(VOXELS)
    if targets is None and voxels.is_dir():
        targets = voxels, "model.binvox", voxel_target
    return common.open_models(place.name, root, _LAYOUT, targets, strict)


def r2n2_camera(
    azimuth: float, elevation: float, ratio: float, size: tuple[int, int], rotation: float = 0.0
) -> Camera:
    """The camera of a view: from the axes of ShapeNet's models (y up) to pixels of an image of ``size`` (width, height).

    The other values are as in the table: degrees, and the distance ratio.
    """
    az, el, roll = np.radians([azimuth, elevation, rotation])
    right = np.array([np.sin(az), 0.0, -np.cos(az)])
    down = np.array([np.sin(el) * np.cos(az), -np.cos(el), np.sin(el) * np.sin(az)])
    forward = -np.array([np.cos(el) * np.cos(az), np.sin(el), np.cos(el) * np.sin(az)])
    turned = [
        np.cos(roll) * right + np.sin(roll) * down,
        np.cos(roll) * down - np.sin(roll) * right,
        forward,
    ]
    width, height = size
    focal = LENS_MM / SENSOR_MM * max(size)
    K = np.array(
        [[focal, 0.0, (width - 1) / 2.0], [0.0, focal, (height - 1) / 2.0], [0.0, 0.0, 1.0]]
    )
    return Camera(K, np.array(turned), np.array([0.0, 0.0, FARTHEST * ratio]), width, height)


def voxel_target(path: str) -> Floats:
    """Points of the boundary of the occupied voxels: [POINTS, 3] in the frame of the model."""
    return common.surface_target(*grid_surface(Path(path)))


def _pictures(folder: Path) -> list[common.Picture]:
    if not folder.is_dir():
        raise InputError(f"{folder}: does not exist, expected the pictures of this object")
    files = common.listed(folder)[1]
    if LIST in files:
        text = read_bytes(folder / LIST, "the names of the pictures", limit=1 << 24).decode(
            "utf-8", "replace"
        )
        numbered = list(enumerate(line.strip() for line in text.split("\n") if line.strip()))
    else:
        numbered = sorted(
            (int(match[1]), match[0]) for match in map(_PICTURE.fullmatch, files) if match
        )
    if not numbered:
        raise InputError(f"{folder}: holds no picture, expected 00.png and so on")
    rows = common.read_table(
        folder / TABLE, 4, 4, "azimuth, elevation, rotation and distance ratio"
    )
    pictures = []
    for line, file in numbered:
        problem = ""
        if file not in files:
            file, problem = (
                shown(file),
                f"{folder / LIST}: names {shown(file)}, expected a picture in this folder",
            )
        elif line >= len(rows):
            problem = f"{folder / TABLE}: has {len(rows)} rows, expected one for {file}"
        elif rows[line, 3] <= 0.0:
            problem = f"{folder / TABLE}: line {line + 1} has a distance ratio of {rows[line, 3]:g}, expected more than 0"
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
    return np.ascontiguousarray(pixels[..., :3]), pixels[..., 3].astype(np.float32) / np.float32(
        255.0
    )


_EXPECTED = f"SYNSET/MODEL/{PICTURES} with 00.png and {TABLE}"
_LAYOUT = common.ModelLayout("renders of 3D-R2N2", _EXPECTED, _pictures, _view, inside=PICTURES)
