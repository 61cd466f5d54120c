"""ShapeNet as the authors of CAPNet have it, with the renderer of Tulsiani et al. (DRC, 2017).

    ROOT/ShapeNet_rendered/SYNSET/MODEL/render_K.png    picture number K, from 0
                                        depth_K.png     its depth; below 254 (of 255) is the object
                                        view.txt        line K: azimuth, elevation (degrees), then perhaps tilt, distance
                                        camera_K.mat    not used
    ROOT/ShapeNet_pcl/SYNSET/MODEL/pcl_1024_fps_trimesh.npy     points of the surface; the folder may be ShapeNet_v1_pcl
    ROOT/splits/SYNSET_{train,val,test}_list.txt or .npy        see `splits`

Facts about the data, from the code published with the paper: it turns a point (a, b, c) of the cloud into p = (-b, -c, a),
then X = R_el R_az p - (0, 0, 2), where R_az turns about x and R_el about y, and projects row = 120 X_x / |X_z| + 32,
column = 120 X_y / |X_z| + 32 at 64x64. In OpenCV axes that is (X_y, X_x, -X_z), so that the whole change of axes is one
rotation: at azimuth and elevation 0 the camera stands at +a, with b up. The middle of the image is at (W-1)/2 here, since the
centre of pixel 0 is at 0: half a pixel from theirs. They load camera_K.mat and do not use it; it describes the same camera
(60 mm on a sensor of 32 mm, distance 2) in the axes of the renderer, Blender.

The renderer writes tilt 0 and distance 2 into columns 3 and 4. The distance is used, a view with a tilt is left out.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.camera import CANONICAL_DISTANCE, Array, Camera
from ..io.images import read_image
from . import common
from .items import Dataset, Floats, Pixels, ViewItem

RENDERED = "ShapeNet_rendered"
SPLITS = "splits"
BACKGROUND = 254
# Numbers of a model's pictures, and azimuth, elevation, distance of each.
Views = tuple[NDArray[np.int32], Array]
_PICTURE = re.compile(r"render_(0|[1-9][0-9]{0,8})\.png")
# (a, b, c) of the cloud -> p; X -> OpenCV axes.
_CLOUD_AXES = np.array([[0.0, -1.0, 0.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
_IMAGE_AXES = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])


def open_shapenet(folder: Path | str, strict: bool = False, progress: common.Progress | None = None) -> Dataset:
    """The objects of this layout; they are named SYNSET/MODEL, in the frame and scale of their clouds.

    Parameters
    ----------
    folder : ROOT, or ROOT/ShapeNet_rendered.
    strict : the first object or view that cannot be used is an error.
    progress : called after every model.

    Returns
    -------
    Targets are the clouds; None where an object has none. All pictures of a category have the size of its
    first that can be read: no other is opened here.

    Raises
    ------
    InputError
        There is no usable object; or, with ``strict``, one is not.
    """
    root = Path(folder)
    if not (root / RENDERED).is_dir() and root.resolve().name == RENDERED:
        root = root.resolve().parent
    models = root / RENDERED
    common.require_folder(models, "the pictures of the ShapeNet models")
    clouds = common.cloud_folder(root)
    skipped = common.Skipped(strict)

    def depths(name: str, known: Views) -> Iterator[Path]:
        return (models / name / f"depth_{number}.png" for number in known[0].tolist())

    def build(name: str, known: Views, size: tuple[int, int]) -> common.LazyViews:
        return common.LazyViews(len(known[0]), partial(_view, str(models / name), *known, size))

    def look(name: str) -> Views:
        return _views_of(models / name, name, skipped)

    def cloud(name: str) -> tuple[Path, Callable[[str], Floats]]:
        assert clouds is not None
        return clouds / name / common.CLOUD, common.cloud_target

    shape = None if clouds is None else cloud
    objects = common.objects_of(models, skipped, progress, look, depths, build, shape, apart_from=SPLITS)
    described = f"{root.resolve().name} (ShapeNet of the CAPNet authors)"
    return common.finished(objects, described, skipped, f"{RENDERED}/SYNSET/MODEL with render_0.png, depth_0.png, view.txt")


def shapenet_camera(azimuth: float, elevation: float, size: tuple[int, int], distance: float = CANONICAL_DISTANCE) -> Camera:
    """The camera of a view: from the axes (a, b, c) of the clouds to pixels.

    Parameters
    ----------
    azimuth, elevation : as in view.txt, degrees.
    size : width, height in pixels.
    distance : from the origin, in units of the cloud.
    """
    az, el = np.radians(azimuth), np.radians(elevation)
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(az), -np.sin(az)], [0.0, np.sin(az), np.cos(az)]])
    about_y = np.array([[np.cos(el), 0.0, np.sin(el)], [0.0, 1.0, 0.0], [-np.sin(el), 0.0, np.cos(el)]])
    rotation = _IMAGE_AXES @ about_y @ about_x @ _CLOUD_AXES
    K = Camera.canonical(*size).K
    return Camera(K, rotation, np.array([0.0, 0.0, distance]), *size)


def _views_of(folder: Path, name: str, skipped: common.Skipped) -> Views:
    """Numbers [V] of the usable pictures of a model, and azimuth, elevation, distance of each [V, 3]."""
    files = common.listed(folder)[1]
    numbers = sorted(int(match[1]) for match in map(_PICTURE.fullmatch, files) if match)
    if not numbers:
        raise InputError(f"{folder}: holds no picture, expected render_0.png and so on")
    rows = common.read_table(folder / "view.txt", 2, 4, "azimuth and elevation in degrees")
    kept, angles = [], []
    for number in numbers:
        row = rows[number] if number < len(rows) else None
        if row is None:
            why = f"{folder / 'view.txt'}: has {len(rows)} rows, expected one for render_{number}.png"
        elif f"depth_{number}.png" not in files:
            why = f"{folder / f'depth_{number}.png'}: does not exist, expected the depth of render_{number}.png"
        elif row[2] != 0.0 and not np.isnan(row[2]):
            why = f"{folder / 'view.txt'}: line {number + 1} has a tilt of {row[2]:g} degrees, expected 0"
        elif row[3] <= 0.0:
            why = f"{folder / 'view.txt'}: line {number + 1} has a distance of {row[3]:g}, expected more than 0"
        else:
            kept.append(number)
            angles.append((row[0], row[1], CANONICAL_DISTANCE if np.isnan(row[3]) else row[3]))
            continue
        skipped.add(f"{name}/render_{number}.png", why)
    if not kept:
        raise InputError(f"{folder}: none of its {len(numbers)} pictures can be used")
    return np.array(kept, dtype=np.int32), np.array(angles)


def _view(folder: str, numbers: NDArray[np.int32], angles: Array, size: tuple[int, int], index: int) -> ViewItem:
    number = int(numbers[index])
    azimuth, elevation, distance = angles[index].tolist()
    camera = shapenet_camera(azimuth, elevation, size, distance)
    picture, depth = (Path(folder) / f"{kind}_{number}.png" for kind in ("render", "depth"))
    return ViewItem(str(picture), camera, partial(_load, picture, depth, camera))


def _load(picture: Path, depth: Path, camera: Camera) -> tuple[Pixels, Floats]:
    image, far = read_image(picture)[..., :3], read_image(depth)
    for path, pixels in ((picture, image), (depth, far)):
        common.sized(path, pixels, camera, "as the first picture of its category")
    # The authors' code looks at the blue channel; 16-bit depth comes in steps of 1/255 too.
    return image, (far[..., 2] < BACKGROUND).astype(np.float32)
