"""ShapeNet as the authors of CAPNet have it, with the renderer of Tulsiani et al. (DRC, 2017).

    ROOT/ShapeNet_rendered/SYNSET/MODEL/render_K.png    picture number K, from 0
                                        depth_K.png     its depth; below 254 (of 255) is the object
                                        view.txt        line K: azimuth, elevation (degrees), and
                                                        optionally tilt and distance
                                        camera_K.mat    not used
    ROOT/ShapeNet_pcl/SYNSET/MODEL/pcl_1024_fps_trimesh.npy     points of the surface; the folder
                                                                may be ShapeNet_v1_pcl
    ROOT/splits/SYNSET_{train,val,test}_list.txt or .npy        see `splits`

Facts about the data, from the code published with the paper:

- A point (a, b, c) of the cloud becomes p = (-b, -c, a), then X = R_el R_az p - (0, 0, 2), where
  R_az turns about x and R_el about y. At 64x64 it is projected to row = 120 X_x / |X_z| + 32 and
  column = 120 X_y / |X_z| + 32.
- In OpenCV axes that is (X_y, X_x, -X_z): the whole change of axes is one rotation. At azimuth and
  elevation 0 the camera stands at +a, with b up.
- The middle of the image is (W-1)/2 here, since the centre of pixel 0 is at 0. That is half a pixel
  from the middle in the published code.
- The published code loads camera_K.mat and does not use it. The file describes the same camera
  (60 mm on a sensor of 32 mm, distance 2) in the axes of the renderer, Blender.
- The renderer writes tilt 0 and distance 2 into columns 3 and 4. Here the distance is used, and a
  view with a tilt is left out.
"""

from __future__ import annotations

import re
from functools import partial
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..geometry.arrays import Floats, Pixels
from ..geometry.camera import CANONICAL_DISTANCE, Camera
from ..io.images import read_image
from . import common
from .items import Dataset, ViewItem

RENDERED = "ShapeNet_rendered"
SPLITS = "splits"
_PICTURE = re.compile(r"render_(0|[1-9][0-9]{0,8})\.png")
# (a, b, c) of the cloud -> p; X -> OpenCV axes.
_CLOUD_AXES = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
_IMAGE_AXES = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def open_shapenet(root: Path, strict: bool = False) -> Dataset:
    """The objects of this layout, named SYNSET/MODEL.

    ``root`` is ROOT or ROOT/ShapeNet_rendered.
    """
    if not (root / RENDERED).is_dir() and root.resolve().name == RENDERED:
        root = root.resolve().parent
    models = root / RENDERED
    clouds = common.find_clouds(models)
    return common.open_models(root.resolve().name, models, _LAYOUT, clouds, strict)


def shapenet_camera(
    azimuth: float, elevation: float, size: tuple[int, int], distance: float = CANONICAL_DISTANCE
) -> Camera:
    """The camera of a view, from the axes (a, b, c) of the clouds to pixels.

    ``size`` is width, height; angles are in degrees.
    """
    az, el = np.radians(azimuth), np.radians(elevation)
    about_x = np.array(
        [[1.0, 0.0, 0.0], [0.0, np.cos(az), -np.sin(az)], [0.0, np.sin(az), np.cos(az)]]
    )
    about_y = np.array(
        [[np.cos(el), 0.0, np.sin(el)], [0.0, 1.0, 0.0], [-np.sin(el), 0.0, np.cos(el)]]
    )
    rotation = _IMAGE_AXES @ about_y @ about_x @ _CLOUD_AXES
    K = Camera.canonical(*size).K
    return Camera(K, rotation, np.array([0.0, 0.0, distance]), *size)


def _pictures(folder: Path) -> list[common.Picture]:
    files = common.listed(folder)[1]
    numbers = sorted(int(match[1]) for match in map(_PICTURE.fullmatch, files) if match)
    if not numbers:
        raise InputError(f"{folder}: holds no picture, expected render_0.png and so on")
    table = folder / "view.txt"
    rows = common.read_table(table, 2, 4, "azimuth and elevation in degrees")
    pictures = []
    for number in numbers:
        file, depth, problem = f"render_{number}.png", f"depth_{number}.png", ""
        if number >= len(rows):
            problem = f"{table}: has {len(rows)} rows, expected one for {file}"
        elif depth not in files:
            problem = f"{folder / depth}: does not exist, expected the depth of {file}"
        elif rows[number, 2] != 0.0 and not np.isnan(rows[number, 2]):
            problem = (
                f"{table}: line {number + 1} has a tilt of {rows[number, 2]:g} degrees, expected 0"
            )
        elif rows[number, 3] <= 0.0:
            problem = (
                f"{table}: line {number + 1} has a distance of {rows[number, 3]:g}, "
                "expected more than 0"
            )
        pictures.append(common.Picture(file, rows[number : number + 1], problem, depth))
    return pictures


def _view(folder: Path, file: str, row: list[float], size: tuple[int, int]) -> ViewItem:
    azimuth, elevation, _, distance = row
    distance = CANONICAL_DISTANCE if np.isnan(distance) else distance
    camera = shapenet_camera(azimuth, elevation, size, distance)
    depth = folder / file.replace("render", "depth")
    return ViewItem(str(folder / file), camera, partial(_load, folder / file, depth, camera))


def _load(picture: Path, depth: Path, camera: Camera) -> tuple[Pixels, Floats]:
    image, far = read_image(picture)[..., :3], read_image(depth)
    for path, pixels in ((picture, image), (depth, far)):
        common.require_size(path, pixels, camera, "as the first picture of its category")
    # The authors' code uses the blue channel. `read_image` gives 16-bit depth in 255ths too.
    return image, (far[..., 2] < 254).astype(np.float32)


_EXPECTED = f"{RENDERED}/SYNSET/MODEL with render_0.png, depth_0.png, view.txt"
_LAYOUT = common.ModelLayout(
    "ShapeNet of the CAPNet authors", _EXPECTED, _pictures, _view, not_a_category=SPLITS
)
