"""Files from Python: what is read and written, by names that are paths or strings."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from .errors import InputError
from .geometry.arrays import Array, Pixels
from .geometry.camera import Camera
from .geometry.view import View, as_mask
from .io.cameras import CameraRecord
from .io.cameras import read_camera as read_camera
from .io.cameras import read_cameras as _read_cameras
from .io.cameras import write_cameras as _write_cameras
from .io.clouds import read_cloud as read_cloud
from .io.clouds import write_cloud as write_cloud
from .io.depth_maps import read_depth as _read_depth
from .io.images import read_image as read_image
from .io.images import write_image
from .io.masks import read_mask as read_mask
from .io.output import atomic_output, require_output, write_file

if TYPE_CHECKING:
    from .refinement.result import RefineResult


def read_cameras(path: str | Path, size: tuple[int, int] | None = None) -> list[Camera]:
    """All cameras of a file, in its order, for pictures of this ``size``: width and height.

    The default is the size that the file says. Raises InputError if the file is wrong, or if
    neither says how large the pictures are.
    """
    return [record.camera for record in _read_cameras(path, size)]


def write_cameras(
    path: str | Path, cameras: Camera | Sequence[Camera], overwrite: bool = False
) -> None:
    """Write one camera or several as a JSON file that reads back exactly."""
    several = [cameras] if isinstance(cameras, Camera) else cameras
    _write_cameras(Path(path), [CameraRecord(camera) for camera in several], overwrite)


def read_depth(path: str | Path, scale: float = 1.0) -> Array:
    """Read a depth map [H, W] from a picture of one grey channel, a .npy or a .npz file.

    The values of the file times ``scale`` are in units of the camera; NaN is unknown. Raises
    InputError if the file is no such map.
    """
    return _read_depth(Path(path), scale)


def write_depth(path: str | Path, depth: ArrayLike, overwrite: bool = False) -> None:
    """Write a depth map [H, W] as a .npy file of float32.

    Raises InputError if the suffix or the shape is another, or the file cannot be written.
    """
    path, values = Path(path), np.asarray(depth, dtype=np.float32)
    require_output(path, ".npy", overwrite)
    _require_image(path, values, "a depth map")
    data = io.BytesIO()
    np.save(data, values)
    write_file(path, data.getvalue(), overwrite)


def write_mask(path: str | Path, mask: ArrayLike, overwrite: bool = False) -> None:
    """Write a mask [H, W] in [0, 1] as a PNG file of 8 bits.

    Raises InputError if the suffix, the shape or a value is another, or the file cannot be written.
    """
    path, values = Path(path), as_mask(mask, str(path))
    require_output(path, ".png", overwrite)
    _require_image(path, values, "a mask")
    if not (values.min(initial=0.0) >= 0.0 and values.max(initial=0.0) <= 1.0):
        raise InputError(
            f"{path}: mask values span {values.min():g} to {values.max():g}, expected 0 to 1"
        )
    write_image(path, np.rint(255.0 * values).astype(np.uint8), overwrite)


def _require_image(path: Path, values: Array | np.ndarray, what: str) -> None:
    if values.ndim != 2:
        raise InputError(f"{path}: has shape {list(values.shape)}, expected {what} [H, W]")


def draw_overlay(
    path: str | Path,
    result: RefineResult,
    views: View | Sequence[View],
    photos: Sequence[Pixels | None] = (),
    overwrite: bool = False,
) -> None:
    """Draw masks, silhouettes and cloud, before and after, as a PNG file.

    Parameters
    ----------
    views : the views that ``result`` is from.
    photos : uint8 [h, w, 3] of each view, or None. They are dimmed behind the mask.
    """
    from .plots.overlay import draw_overlay as draw

    path, several = Path(path), [views] if isinstance(views, View) else views
    require_output(path, ".png", overwrite)
    with atomic_output(path, overwrite) as temporary:
        draw(temporary, result, several, photos)
