"""Depth maps: pictures of one grey channel, .npy and .npz files; the confidence of phones."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.arrays import Array
from ..geometry.view import LARGEST_DEPTH
from .archives import arrays_of
from .images import FILE_LIMIT, PIXEL_LIMIT, check_size, decoded
from .reading import is_there, plain, read_array, read_bytes

if TYPE_CHECKING:
    from PIL import Image

# What arrays of a .npz file are called that hold depths, and those that hold points.
_DEPTHS = ("depth", "depth_map", "depths", "depthmaps", "depth_z")
_POINTS = ("points",)  # of MoGe, in the axes of the camera
# How sensors and networks mark an unknown depth, in units of the file; 65535 is -1 in 16 bits.
_UNKNOWN = (0.0, -1.0, 65535.0)


def read_depth(path: Path, scale: float = 1.0, upright: bool = True, signed: bool = False) -> Array:
    """Read a depth map [H, W] from a picture of one grey channel, a .npy or a .npz file.

    The values of the file times ``scale`` are in units of the camera. 0, -1, 65535, NaN, infinity
    and what the confidence of a phone calls low mean unknown and become NaN. Where depths may be
    ``signed``, -1 and 65535 are depths. Raises InputError if the file is not such a map, or if a
    depth is negative and not ``signed``.
    """
    data = read_bytes(path, "a depth map", FILE_LIMIT)
    suffix = path.suffix.lower()
    if suffix in (".npy", ".npz"):
        values = _picture(read_array(data, path)) if suffix == ".npy" else _of_archive(data, path)
        if values.ndim != 2 or values.dtype.kind not in "fiu" or 0 in values.shape:
            raise InputError(
                f"{path}: holds {values.dtype} {list(values.shape)}, expected a depth map [H, W]"
            )
        check_size(values.shape[1], values.shape[0], path)
    else:
        values = decoded(data, path, "a depth map", _grey, upright)
    with np.errstate(invalid="ignore"):  # signalling NaN
        depth = values.astype(np.float64)
    depth[~np.isfinite(depth) | np.isin(depth, _UNKNOWN[:1] if signed else _UNKNOWN)] = np.nan
    if file := confidence_of(path):
        confidence = decoded(read_bytes(file, "a confidence map"), file, "a map", _grey, upright)
        if confidence.shape != depth.shape:
            raise InputError(
                f"{file}: is {confidence.shape[1]}x{confidence.shape[0]}, the depth map {path} is "
                f"{depth.shape[1]}x{depth.shape[0]}, expected the same; or give it another name"
            )
        depth[confidence == 0] = np.nan
    least = np.nanmin(depth, initial=np.inf)
    if least < 0.0 and not signed:
        raise InputError(
            f"{path}: its smallest depth is {least:g}, expected 0 (unknown) or more, or another "
            "`depth_kind`"
        )
    if least == np.inf:
        raise InputError(f"{path}: holds no depth > 0, expected some (0 means unknown)")
    largest = float(np.nanmax(np.abs(depth))) * scale
    if not 1.0 / LARGEST_DEPTH <= largest <= LARGEST_DEPTH:
        expected = (
            f"at least {1.0 / LARGEST_DEPTH:g}" if largest < 1.0 else f"at most {LARGEST_DEPTH:g}"
        )
        raise InputError(
            f"{path}: its largest depth, times {scale:g}, is {largest:g}, expected {expected}"
        )
    return depth * scale


def confidence_of(path: Path) -> Path | None:
    """The confidence of a phone's depth map: ``confidence/N.png`` or ``conf_N.png``; None for none.

    Its least value is 0, which means low: of 0, 1 and 2, or of 0, 127 and 255.
    """
    folder, name, file = path.absolute().parent, f"{path.stem}.png", None
    if folder.name == "depth":
        file = folder.with_name("confidence") / name
    elif name.startswith("depth_"):
        file = path.with_name(name.replace("depth", "conf", 1))
    return file if file is not None and is_there(file) else None


def at_size(depth: Array, width: int, height: int) -> Array:
    """The nearest depths of a map of the same picture, with other pixels."""
    rows, columns = (
        (2 * np.arange(pixels) + 1) * size // (2 * pixels)
        for pixels, size in zip((height, width), depth.shape, strict=True)
    )
    return np.asarray(depth[np.ix_(rows, columns)])


def _of_archive(data: bytes, path: Path) -> NDArray[Any]:
    """The depths of an archive: z of its points if it has no other; NaN outside of its mask."""
    arrays = arrays_of(data, path, limit=8 * PIXEL_LIMIT)
    key = next((key for key in (*_DEPTHS, *_POINTS) if key in arrays), None)
    if key is None:
        names = ", ".join(map(plain, arrays)) or "no array of numbers"
        raise InputError(f"{path}: holds {names}, expected an array called {_DEPTHS[0]}")
    values: NDArray[Any] = np.asarray(arrays[key])
    if key in _POINTS and values.shape[-1:] == (3,):
        values = values[..., 2]
    values = _picture(values)
    if "mask" not in arrays:
        return values
    mask = _picture(np.asarray(arrays["mask"]))
    if mask.shape != values.shape:
        raise InputError(
            f"{path}: its mask is of shape {list(mask.shape)}, "
            f"expected that of its depths, {list(values.shape)}"
        )
    return np.where(np.nan_to_num(mask), values, np.nan)


def _picture(values: NDArray[Any]) -> NDArray[Any]:
    """[H, W] of the one picture in [1, H, W], [H, W, 1] and so on; others as they are."""
    while values.ndim > 2 and 1 in (values.shape[0], values.shape[-1]):
        values = values[0] if len(values) == 1 else values[..., 0]
    return values


def _grey(image: Image.Image, path: Path) -> NDArray[Any]:
    if image.mode not in ("L", "I", "F") and not image.mode.startswith("I;16"):
        raise InputError(
            f"{path}: is a picture of mode {image.mode}, "
            "expected a depth map of one grey channel, 16 bits"
        )
    return np.asarray(image)
