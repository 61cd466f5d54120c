"""Pictures: files in, arrays out; writes PNG. `masks` reads masks, `depth_maps` depth maps.

A picture that the camera marked as rotated is turned upright, unless the stored raster is asked
for.
"""

from __future__ import annotations

import io
import os
import re
import threading
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.arrays import Floats, Pixels
from .output import atomic_output, check_output, reason
from .reading import is_there, read_bytes, require_memory

if TYPE_CHECKING:
    from PIL import Image

PIXEL_LIMIT = 100_000_000
FORMATS = ("PNG", "JPEG", "TIFF", "WEBP", "GIF", "BMP", "PPM")
FILE_LIMIT = 1 << 31
# Standard error is redirected while a TIFF is decoded: one thread at a time.
_stderr_lock = threading.Lock()
Known = TypeVar("Known")
Convert = Callable[["Image.Image", Path], NDArray[Any]]
_OPENEXR = b"\x76\x2f\x31\x01"  # how such a file begins
WITH_ALPHA = ("RGBA", "LA", "PA", "RGBa", "La")
_ORIENTATION, _EXIF, _FOCAL_35MM = 0x0112, 0x8769, 0xA405
# Of a picture on 35 mm film, in mm; EXIF compares diagonals.
DIAGONAL_OF_FILM = 43.27
# A focal length of more diagonals, or of less than one over that, is a wrong entry.
MOST_SHARE = 50.0


def read_image(path: str | Path, upright: bool = True) -> Pixels:
    """Read a picture as [H, W, 3], or as [H, W, 4] if it has an alpha channel.

    ``upright`` turns it as its EXIF orientation says. Raises InputError if the file is not a
    readable image or has over 100 megapixels.
    """
    path = Path(path)
    data = read_bytes(path, "an image", FILE_LIMIT)
    return decoded(data, path, "an image", _colours, upright)


def resized(image: Pixels, width: int, height: int) -> Pixels:
    """A picture [H, W, C] of another size; the same one if it has that size."""
    from PIL import Image

    if image.shape[:2] == (height, width):
        return image
    how = Image.Resampling.LANCZOS
    return np.asarray(Image.fromarray(np.ascontiguousarray(image)).resize((width, height), how))


def orientation(path: Path) -> int:
    """The EXIF orientation of a picture, 1 for an upright one and for other files."""
    return _of_header(path, lambda image: int(image.getexif().get(_ORIENTATION, 1)), 1)


def focal_length_of_exif(path: Path) -> float | None:
    """The focal length of a photo, as a share of its diagonal, by its EXIF data; None without any.

    EXIF gives the focal length of a lens that shows as much on 35 mm film.
    """
    focal = _of_header(path, lambda image: image.getexif().get_ifd(_EXIF).get(_FOCAL_35MM), None)
    try:
        share = float(focal) / DIAGONAL_OF_FILM if focal else 0.0
    except (TypeError, ValueError):
        return None
    return share if MOST_SHARE > share > 1.0 / MOST_SHARE else None


def size_of_picture(path: Path) -> tuple[int, int] | None:
    """Width and height of a picture that is turned upright; None for other files."""
    size = _of_header(path, lambda image: image.size, None)
    return (size[1], size[0]) if size and orientation(path) >= 5 else size


def has_alpha(path: Path) -> bool:
    """Whether a file is a picture with an alpha channel."""
    return _of_header(
        path, lambda image: image.mode in WITH_ALPHA or "transparency" in image.info, False
    )


def _of_header(path: Path, read: Callable[[Image.Image], Known], otherwise: Known) -> Known:
    """What ``read`` says of a picture whose pixels are not decoded; else ``otherwise``."""
    from PIL import Image

    if not is_there(path):  # opening a pipe would wait for its writer
        return otherwise
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            with path.open("rb") as stream, Image.open(stream, formats=FORMATS) as image:
                return read(image)
    except Exception:  # the reader of the file says what is wrong with it
        return otherwise


def as_colours(image: Image.Image, path: Path) -> Pixels:
    """A picture that Pillow has opened, as `read_image` gives it.

    Raises InputError if the picture is too large, and whatever Pillow raises.
    """
    check_size(image.width, image.height, path)
    _load(image)
    return _colours(image, path)


def write_image(path: Path, array: Pixels, overwrite: bool = False) -> None:
    """Write ``array`` as PNG: uint8 [H, W], [H, W, 3] or [H, W, 4], or bool [H, W]."""
    from PIL import Image

    check_output(path, overwrite)
    with atomic_output(path, overwrite) as temporary:
        Image.fromarray(array).save(temporary, format="PNG")


def check_size(width: int, height: int, path: Path) -> None:
    if width * height > PIXEL_LIMIT:
        raise InputError(
            f"{path}: is {width}x{height}, {width * height:,} pixels, "
            f"expected at most {PIXEL_LIMIT:,}"
        )
    # A pixel of a mask takes at most 16 bytes.
    require_memory(path, 16 * width * height)


def _load(image: Image.Image) -> None:
    """Decode a picture that is open.

    libtiff prints what is wrong with a damaged file to standard error and goes on. Here that
    text becomes an OSError.
    """
    if image.format != "TIFF":
        image.load()
        return
    with _stderr_lock:
        reading_end, writing_end = os.pipe()
        os.set_blocking(writing_end, False)  # text that does not fit into the pipe is lost
        stderr = os.dup(2)
        os.dup2(writing_end, 2)
        try:
            image.load()
        finally:
            os.dup2(stderr, 2)
            os.close(stderr)
            os.close(writing_end)
            printed = os.read(reading_end, 200)
            os.close(reading_end)
            if printed:
                raise OSError(printed.decode("ascii", "replace"))


def decoded(
    data: bytes, path: Path, what: str, convert: Convert, upright: bool = True
) -> NDArray[Any]:
    """Open a picture, turn it ``upright`` and ``convert`` it.

    Every error and warning of Pillow becomes one line that begins with the file.
    """
    from PIL import Image, ImageOps

    try:
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            with Image.open(io.BytesIO(data), formats=FORMATS) as image:
                # The header gives the size; nothing has been decoded yet.
                check_size(image.width, image.height, path)
                _load(image)
                if upright:
                    ImageOps.exif_transpose(image, in_place=True)
                array: NDArray[Any] = convert(image, path)
    except InputError:
        raise
    except Image.UnidentifiedImageError:
        if data.startswith(_OPENEXR):
            raise InputError(
                f"{path}: is an OpenEXR file, which tso does not read, expected {what}; convert it "
                "with OpenCV or imageio, and store the array: numpy.save('NAME.npy', array)"
            ) from None
        raise InputError(
            f"{path}: is not a readable image, expected {what} ({', '.join(FORMATS)})"
        ) from None
    except Image.DecompressionBombError as error:
        digits = re.search(r"\d+", str(error))
        count = f"{int(digits[0]):,}" if digits else "too many"
        raise InputError(
            f"{path}: has {count} pixels, expected at most {PIXEL_LIMIT:,}; make it smaller"
        ) from None
    # Decoders fail on damaged files in many ways (struct.error, SyntaxError, KeyError, ...).
    except Exception as error:
        raise InputError(f"{path}: is not readable as {what} ({reason(error)})") from None
    for warning in caught:
        if not issubclass(warning.category, (Image.DecompressionBombWarning, DeprecationWarning)):
            text = reason(RuntimeError(warning.message))
            warnings.warn(f"{path}: {text}", stacklevel=4)
    return array


def to_unit(array: NDArray[Any], path: Path) -> Floats:
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
        full = 255  # numpy makes wide integers by default: their type says nothing about the scale
    if largest > full:
        raise InputError(f"{path}: its largest value is {largest}, expected at most {full}")
    return (np.arange(full + 1) / full).astype(np.float32)[array]


def grey_values(image: Image.Image, path: Path) -> NDArray[Any]:
    """The values [H, W] of a picture with one grey channel: bool, uint8, uint16 or float."""
    if image.mode.startswith("I;16"):
        return np.asarray(image).astype(np.uint16)
    if image.mode == "I":
        values = np.asarray(image)
        if values.min() < 0 or values.max() > 65535:
            raise InputError(
                f"{path}: its values span {values.min()} to {values.max()}, expected 0 to 65535"
            )
        return values.astype(np.uint16)
    return np.asarray(image)


def _colours(image: Image.Image, path: Path) -> Pixels:
    if image.mode.startswith("I;16") or image.mode in ("I", "F"):
        # Pillow would clip these values at 255.
        grey = np.rint(to_unit(grey_values(image, path), path) * 255.0).astype(np.uint8)
        return np.repeat(grey[..., None], 3, axis=2)
    alpha = image.mode in WITH_ALPHA or "transparency" in image.info
    return np.array(image.convert("RGBA" if alpha else "RGB"), dtype=np.uint8)
