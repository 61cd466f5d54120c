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

The models of ShapeNet are centred at the origin, and so are the grids of .binvox files as `files.shapes` reads them.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..geometry.camera import Array, Camera
from ..io.images import read_image
from ..io.reading import read_bytes, shown
from . import common
from .items import Dataset, Floats, Pixels, ViewItem

RENDERED, VOXELS = "ShapeNetRendering", "ShapeNetVox32"
PICTURES = "rendering"
TABLE, LIST = "rendering_metadata.txt", "renderings.txt"
FARTHEST = 1.75
LENS_MM, SENSOR_MM = 35.0, 32.0
# File names of a model's pictures, and a row of the table for each.
Views = tuple[list[str], Array]
_PICTURE = re.compile(r"([0-9]{2,9})\.png")


def open_r2n2(folder: Path | str, strict: bool = False, progress: common.Progress | None = None) -> Dataset:
    """The objects of this layout; they are named SYNSET/MODEL, in the frame and scale of ShapeNet's models.

    Parameters
    ----------
    folder : ROOT, or the folder that holds ShapeNetRendering.
    strict : the first object or view that cannot be used is an error.
    progress : called after every model.

    Returns
    -------
    Targets are clouds or points of the voxels' boundary; None where an object has no such file. All pictures of a category
    have the size of its first that can be read: no other is opened here.

    Raises
    ------
    InputError
        There is no usable object; or, with ``strict``, one is not.
    """
    root = Path(folder)
    if (root / RENDERED).is_dir():
        root = root / RENDERED
    common.require_folder(root, "the renders of 3D-R2N2")
    beside = root.resolve().parent
    clouds, voxels = common.cloud_folder(beside), beside / VOXELS
    target_of: Callable[[str], tuple[Path, Callable[[str], Floats]]] | None = None
    if clouds is not None:
        target_of = partial(_file_and_reader, clouds, common.CLOUD, common.cloud_target)
    elif voxels.is_dir():
        target_of = partial(_file_and_reader, voxels, "model.binvox", voxel_target)
    skipped = common.Skipped(strict)

    def look(name: str) -> Views:
        return _views_of(root / name / PICTURES, name, skipped)

    def pictures(name: str, known: Views) -> Iterator[Path]:
        return (root / name / PICTURES / file for file in known[0])

    def build(name: str, known: Views, size: tuple[int, int]) -> common.LazyViews:
        return common.LazyViews(len(known[0]), partial(_view, str(root / name / PICTURES), *known, size))

    objects = common.objects_of(root, skipped, progress, look, pictures, build, target_of)
    described = f"{root.resolve().name} (renders of 3D-R2N2)"
    return common.finished(objects, described, skipped, f"SYNSET/MODEL/{PICTURES} with 00.png and {TABLE}")


def r2n2_camera(azimuth: float, elevation: float, ratio: float, size: tuple[int, int], rotation: float = 0.0) -> Camera:
    """The camera of a view: from the axes of ShapeNet's models (y up) to pixels.

    Parameters
    ----------
    azimuth, elevation, rotation : as in the table, degrees; the last is the in-plane rotation.
    ratio : distance from the origin in units of 1.75.
    size : width, height in pixels.
    """
    az, el, roll = np.radians([azimuth, elevation, rotation])
    right = np.array([np.sin(az), 0.0, -np.cos(az)])
    down = np.array([np.sin(el) * np.cos(az), -np.cos(el), np.sin(el) * np.sin(az)])
    forward = -np.array([np.cos(el) * np.cos(az), np.sin(el), np.cos(el) * np.sin(az)])
    turned = [np.cos(roll) * right + np.sin(roll) * down, np.cos(roll) * down - np.sin(roll) * right, forward]
    width, height = size
    focal = LENS_MM / SENSOR_MM * max(size)
    K = np.array([[focal, 0.0, (width - 1) / 2.0], [0.0, focal, (height - 1) / 2.0], [0.0, 0.0, 1.0]])
    return Camera(K, np.array(turned), np.array([0.0, 0.0, FARTHEST * ratio]), width, height)


def voxel_target(path: str) -> Floats:
    """Points of the boundary of the occupied voxels: [POINTS, 3] in the frame of the model."""
    from ..io.shapes import grid_surface

    return common.surface_target(*grid_surface(path))


def _file_and_reader(folder: Path, file: str, read: Callable[[str], Floats], name: str) -> tuple[Path, Callable[[str], Floats]]:
    return folder / name / file, read


def _views_of(folder: Path, name: str, skipped: common.Skipped) -> Views:
    """File names of the usable pictures of a model, and the first four columns of the table for each [V, 4]."""
    if not folder.is_dir():
        raise InputError(f"{folder}: does not exist, expected the pictures of this object")
    files = common.listed(folder)[1]
    if LIST in files:
        text = read_bytes(folder / LIST, "the names of the pictures", limit=1 << 24).decode("utf-8", "replace")
        numbered = list(enumerate(line.strip() for line in text.split("\n") if line.strip()))
    else:
        numbered = sorted((int(match[1]), match[0]) for match in map(_PICTURE.fullmatch, files) if match)
    if not numbered:
        raise InputError(f"{folder}: holds no picture, expected 00.png and so on")
    rows = common.read_table(folder / TABLE, 4, 4, "azimuth, elevation, rotation and distance ratio")
    kept, chosen = [], []
    for line, file in numbered:
        if file not in files:
            why = f"{folder / LIST}: names {shown(file)}, expected a picture in this folder"
        elif line >= len(rows):
            why = f"{folder / TABLE}: has {len(rows)} rows, expected one for {file}"
        elif rows[line, 3] <= 0.0:
            why = f"{folder / TABLE}: line {line + 1} has a distance ratio of {rows[line, 3]:g}, expected more than 0"
        else:
            # The same few names in every folder: one string each.
            kept.append(sys.intern(file))
            chosen.append(rows[line])
            continue
        skipped.add(f"{name}/{file if file in files else shown(file)}", why)
    if not kept:
        raise InputError(f"{folder}: none of its {len(numbered)} pictures can be used")
    return kept, np.array(chosen)


def _view(folder: str, files: list[str], rows: Array, size: tuple[int, int], index: int) -> ViewItem:
    azimuth, elevation, rotation, ratio = rows[index].tolist()
    camera = r2n2_camera(azimuth, elevation, ratio, size, rotation)
    picture = Path(folder) / files[index]
    return ViewItem(str(picture), camera, partial(_load, picture, camera))


def _load(picture: Path, camera: Camera) -> tuple[Pixels, Floats]:
    pixels = read_image(picture)
    common.sized(picture, pixels, camera, "as the first picture of its category")
    if pixels.shape[2] != 4:
        raise InputError(f"{picture}: has no alpha channel, expected the mask there")
    return np.ascontiguousarray(pixels[..., :3]), pixels[..., 3].astype(np.float32) / np.float32(255.0)
