"""Masks and pictures: files in, arrays out, upright whatever the camera noted about its orientation."""

from __future__ import annotations

import functools
import io
import os
import threading
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .output import atomic_output, check_output, reason
from .reading import read_array, read_bytes, require_memory

if TYPE_CHECKING:
    from PIL import Image

PIXEL_LIMIT = 100_000_000
BYTES_A_PIXEL = 16  # what a mask takes at its most
LARGEST_DEPTH = 1e15  # beyond it squares of depths overflow in sums
FORMATS = ("PNG", "JPEG", "TIFF", "WEBP", "GIF", "BMP", "PPM")
LEAST_TRANSPARENT = 1e-3  # share of an alpha channel that is a mask
_FILE_LIMIT = 1 << 31
_one_by_one = threading.Lock()
Convert = Callable[["Image.Image", Path], NDArray[Any]]
_WITH_ALPHA = ("RGBA", "LA", "PA", "RGBa", "La")


def read_mask(path: str | Path, invert: bool = False) -> NDArray[np.float32]:
    """Read a picture or .npy file as a mask [H, W] in [0, 1], inside 1, or with ``invert`` what is dark; soft values stay.

    - An alpha channel of which at least 0.1 % is outside is the mask; else the brightness is (the largest channel of a colour).
    - A palette whose used colours are all grey counts by its greys; of any other, index 0 is outside, the rest inside.
    - Integers are divided by the largest value of their type, or are labels 0 and 1, with a warning, if the largest is 1.

    Raises InputError if the file is not a readable image, has over 100 megapixels, or values outside [0, 1].
    """
    path = Path(path)
    mask = _to_unit(_read_values(path, "a mask image", "a mask [H, W]", "bfiu", _mask_values), path)
    return np.float32(1.0) - mask if invert else mask


def read_depth(path: Path, scale: float = 1.0) -> NDArray[np.float64]:
    """Read a depth map [H, W] from a picture of one grey channel or a .npy file, ``scale`` units of the camera to a step.

    0, NaN and infinity are unknown: NaN. Raises InputError if the file is not such a map, or a depth is negative.
    """
    with np.errstate(invalid="ignore"):  # signalling NaN
        depth = _read_values(
            path, "a depth map", "a depth map [H, W]", "fiu", _depth_values
        ).astype(np.float64)
    depth[~np.isfinite(depth) | (depth == 0.0)] = np.nan
    least = np.nanmin(depth, initial=np.inf)
    if least < 0.0:
        raise InputError(f"{path}: its smallest depth is {least:g}, expected 0 (unknown) or more")
    if least == np.inf:
        raise InputError(f"{path}: holds no depth > 0, expected some (0 means unknown)")
    largest = float(np.nanmax(depth)) * scale
    if not 1.0 / LARGEST_DEPTH <= largest <= LARGEST_DEPTH:
        expected = (
            f"at least {1.0 / LARGEST_DEPTH:g}" if largest < 1.0 else f"at most {LARGEST_DEPTH:g}"
        )
        raise InputError(
            f"{path}: its largest depth, times {scale:g}, is {largest:g}, expected {expected}"
        )
    return depth * scale


def _read_values(path: Path, what: str, form: str, kinds: str, convert: Convert) -> NDArray[Any]:
    """[H, W] from a picture by ``convert``, or from a .npy file with one of numpy's ``kinds``."""
    data = read_bytes(path, what, _FILE_LIMIT)
    if path.suffix.lower() != ".npy":
        return _decode(data, path, what, convert)
    array = read_array(data, path)
    if array.ndim != 2 or array.dtype.kind not in kinds or 0 in array.shape:
        raise InputError(f"{path}: holds {array.dtype} {list(array.shape)}, expected {form}")
    _check_size(array.shape[1], array.shape[0], path)
    return array


def read_image(path: str | Path) -> NDArray[np.uint8]:
    """Read a picture as [H, W, 3], or [H, W, 4] where it has an alpha channel; InputError as `read_mask`."""
    path = Path(path)
    return _decode(read_bytes(path, "an image", _FILE_LIMIT), path, "an image", _colours)


def as_colours(image: Image.Image, path: Path) -> NDArray[np.uint8]:
    """A picture opened by Pillow, as `read_image` gives it; InputError where it is too large, or what Pillow raises."""
    _check_size(image.width, image.height, path)
    _load(image)
    return _colours(image, path)


def write_image(path: Path, array: NDArray[np.uint8], overwrite: bool = False) -> None:
    """Write ``array``, [H, W], [H, W, 3] or [H, W, 4] of uint8 (or bool, [H, W]), as PNG."""
    from PIL import Image

    check_output(path, overwrite)
    with atomic_output(path, overwrite) as temporary:
        Image.fromarray(array).save(temporary, format="PNG")


def _check_size(width: int, height: int, path: Path) -> None:
    if width * height > PIXEL_LIMIT:
        raise InputError(
            f"{path}: is {width}x{height}, {width * height:,} pixels, expected at most {PIXEL_LIMIT:,}"
        )
    require_memory(path, BYTES_A_PIXEL * width * height)


def _load(image: Image.Image) -> None:
    """Decode a picture that is open; OSError with what libtiff would print of a damaged one, and then go on."""
    if image.format != "TIFF":
        image.load()
        return
    with _one_by_one:
        ours, theirs = os.pipe()
        os.set_blocking(theirs, False)  # what is too long is lost
        stderr = os.dup(2)
        os.dup2(theirs, 2)
        try:
            image.load()
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
            os.close(theirs)
            said = os.read(ours, 200)
            os.close(ours)
            if said:
                raise OSError(said.decode("ascii", "replace"))


def _decode(data: bytes, path: Path, what: str, convert: Convert) -> NDArray[Any]:
    """Open, turn upright and ``convert``; whatever Pillow raises or warns of becomes one line that names the file."""
    from PIL import Image, ImageOps

    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            with Image.open(io.BytesIO(data), formats=FORMATS) as image:
                # The header gives the size; nothing has been decoded yet.
                _check_size(image.width, image.height, path)
                _load(image)
                ImageOps.exif_transpose(image, in_place=True)
                array: NDArray[Any] = convert(image, path)
    except InputError:
        raise
    except Image.UnidentifiedImageError:
        raise InputError(
            f"{path}: is not a readable image, expected {what} ({', '.join(FORMATS)})"
        ) from None
    except Image.DecompressionBombError as error:
        raise InputError(
            f"{path}: {reason(error)}; expected at most {PIXEL_LIMIT:,} pixels"
        ) from None
    # Decoders fail on damaged files in many ways (struct.error, SyntaxError, KeyError, ...): all mean the same here.
    except Exception as error:
        raise InputError(f"{path}: is not readable as {what} ({reason(error)})") from None
    for warning in caught:
        if not issubclass(warning.category, (Image.DecompressionBombWarning, DeprecationWarning)):
            text = reason(RuntimeError(warning.message))
            warnings.warn(f"{path}: {text}", stacklevel=4)
    return array


def _mask_values(image: Image.Image, path: Path) -> NDArray[Any]:
    """[H, W]: bool, uint8, uint16 or float."""
    from PIL import ImageChops

    if image.mode in _WITH_ALPHA or (
        "transparency" in image.info and image.mode in ("P", "L", "RGB")
    ):
        alpha = np.asarray(
            (image if image.mode in ("RGBA", "LA") else image.convert("RGBA")).getchannel("A")
        )
        # A few pixels that an editor left transparent, or a picture that is translucent all over, are no mask.
        if np.count_nonzero(alpha < 128) >= LEAST_TRANSPARENT * alpha.size:
            return alpha
    if image.mode == "P":
        return _palette_values(image)
    if image.mode in ("1", "L", "F"):
        return np.asarray(image)
    if image.mode.startswith("I;16"):
        return np.asarray(image).astype(np.uint16)
    if image.mode == "I":
        values = np.asarray(image)
        if values.min() < 0 or values.max() > 65535:
            raise InputError(
                f"{path}: its values span {values.min()} to {values.max()}, expected 0 to 65535"
            )
        return values.astype(np.uint16)
    return np.asarray(functools.reduce(ImageChops.lighter, image.convert("RGB").split()))


def _depth_values(image: Image.Image, path: Path) -> NDArray[Any]:
    if image.mode not in ("L", "I", "F") and not image.mode.startswith("I;16"):
        raise InputError(
            f"{path}: is a picture of mode {image.mode}, expected a depth map of one grey channel, 16 bits"
        )
    return np.asarray(image)


def _palette_values(image: Image.Image) -> NDArray[Any]:
    index = np.asarray(image)
    used = np.flatnonzero(image.histogram())
    shown = image.resize((256, 1))
    shown.putdata(range(256))
    colours = np.asarray(shown.convert("RGB"))[0, used]
    grey = (colours == colours[:, :1]).all()
    # A palette that shows different indices alike says nothing: then the indices are the labels.
    if grey and (used.size == 1 or colours.min() != colours.max()):
        return np.asarray(image.convert("L"))
    return index != 0


def _to_unit(array: NDArray[Any], path: Path) -> NDArray[np.float32]:
    if array.dtype.kind == "f":
        with np.errstate(invalid="ignore"):  # signalling NaN
            values = np.asarray(array, dtype=np.float64)
        low, high = float(values.min()), float(values.max())
        if not (low >= 0.0 and high <= 1.0):
            raise InputError(f"{path}: its values span {low:g} to {high:g}, expected 0 to 1")
        return values.astype(np.float32)
    if array.dtype == bool:
        return array.astype(np.float32)
    if int(array.min()) < 0:
        raise InputError(f"{path}: its smallest value is {array.min()}, expected 0 or more")
    largest = int(array.max())
    if largest == 1:
        warnings.warn(
            f"{path}: its largest value is 1, read as labels 0 (outside) and 1 (inside)",
            stacklevel=3,
        )
        return array.astype(np.float32)
    full = 255 if array.dtype.itemsize == 1 else 65535
    if array.dtype.itemsize > 2 and largest <= 255:
        full = 255  # numpy makes wide integers by itself; they say nothing about the scale
    if largest > full:
        raise InputError(f"{path}: its largest value is {largest}, expected at most {full}")
    return (np.arange(full + 1) / full).astype(np.float32)[array]


def _colours(image: Image.Image, path: Path) -> NDArray[np.uint8]:
    if image.mode.startswith("I;16") or image.mode in ("I", "F"):
        # Pillow would cut these off at 255.
        grey = np.rint(_to_unit(_mask_values(image, path), path) * 255.0).astype(np.uint8)
        return np.repeat(grey[..., None], 3, axis=2)
    alpha = image.mode in _WITH_ALPHA or "transparency" in image.info
    return np.array(image.convert("RGBA" if alpha else "RGB"), dtype=np.uint8)
