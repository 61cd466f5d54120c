"""Masks [H, W] in [0, 1] of pictures, label images, arrays of segmenters and annotations."""

from __future__ import annotations

import functools
import re
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.arrays import Bits, Floats
from ..geometry.view import is_grey_inside
from .annotations import MOST_LISTED, read_annotation
from .annotations import SUFFIXES as ANNOTATIONS
from .archives import Check, arrays_of
from .images import FILE_LIMIT, WITH_ALPHA, check_size, decoded, grey_values, to_unit
from .reading import plain, read_array, read_bytes

if TYPE_CHECKING:
    from PIL import Image

# An image of at most this many values may be an image of labels.
MOST_VALUES = 64
# A label is a value with areas of its own: at least this share of its pixels has four neighbours
# of the same value. The soft edge of a mask has hardly any such pixels.
SOLID = 0.3
# In a palette of labels: pixels along the outlines that nobody labelled, as VOC has them.
BORDER = 255
# Formats whose losses change the values of labels.
LOSSY = ("JPEG", "WEBP")
# Files of a folder that are taken for masks; a .json there may be a camera file.
SUFFIXES = (
    ".png", ".jpg", ".jpeg", ".tif", ".tiff", ".webp", ".bmp", ".gif", ".ppm", ".pgm", ".npy",
    ".npz", ".pt",
)  # fmt: skip
# How far beyond 0 and 1 interpolation may bring the values of a mask.
UNDERSHOOT = 0.2
# What the array of masks is called in a file with several arrays, and that of their scores.
MASK_NAMES = ("masks", "mask", "segmentation", "alpha", "pred")
SCORE_NAMES = ("scores", "iou_predictions")
# The most masks in one array [N, H, W]; more are the rows of a picture.
MOST_MASKS = 64


@dataclass(frozen=True)
class MaskChoice:
    """Which object of a file with several is meant.

    label : the value in an image of labels; a colour as "R,G,B"; in an annotation a name.
    index : the place in an array of masks, or in a list of segmentations, from 0.
    """

    label: str | None = None
    index: int | None = None


def read_mask(
    path: str | Path,
    choice: MaskChoice = MaskChoice(),
    upright: bool = True,
    size: tuple[int, int] | None = None,
    known: bool = False,
) -> Floats:
    """Read a mask [H, W] in [0, 1]; inside is 1, soft values stay.

    With ``known`` a pixel that the file calls unknown is NaN, else 0: the border (255) in a palette
    of labels, as VOC has it. The values of a picture are, in this order:

    1. its alpha channel, if at least 0.1 % of it is transparent;
    2. in an image of labels (a palette, or few values with areas of their own), 1 at the one label,
       or at the ``choice``;
    3. its brightness (of a colour the largest channel).

    Integers are divided by the largest value of their type. An array is [H, W], or one of several
    [N, H, W] or [N, 1, H, W] in a .npy, .npz or .pt file; values below 0 are logits. A .json, .xml
    or .txt file is an annotation (`annotations`); ``size`` is the width and height of its picture,
    if nothing else says them. ``upright`` is as in `read_image`.

    Raises InputError if the file is not a readable mask, has over 100 megapixels, has values
    outside [0, 1], or holds several masks and none is chosen.
    """
    path = Path(path)
    data = read_bytes(path, "a mask image", FILE_LIMIT)
    suffix = path.suffix.lower()
    if suffix == ".npy":
        return _of_array({"": read_array(data, path)}, path, choice)
    if suffix in (".npz", ".pt"):
        return _of_array(arrays_of(data, path, check=_size_check(path)), path, choice)
    if suffix in ANNOTATIONS:
        return read_annotation(data, path, choice.label, choice.index, size)
    _refuse_index(path, choice)
    convert = functools.partial(_values, label=choice.label)
    values = decoded(data, path, "a mask image", convert, upright)
    if values.dtype == np.int8:  # 1 inside, 0 outside, -1 unknown
        return np.where(values < 0, np.float32(np.nan if known else 0.0), values)
    return to_unit(values, path)


def masks_in(path: Path) -> list[Path]:
    """The mask files of a folder in the order of their names, 2.png before 10.png.

    A file is its own list.

    Raises InputError if a folder holds none.
    """
    if not path.is_dir():
        return [path]
    files = [
        file
        for file in sorted(path.iterdir(), key=_by_numbers)
        if file.suffix.lower() in SUFFIXES and not file.name.startswith(".") and file.is_file()
    ]
    if not files:
        raise InputError(f"{path}: holds no mask, expected files such as {', '.join(SUFFIXES[:4])}")
    return files


def _size_check(path: Path) -> Check:
    """Refuses arrays whose two longest sides make no picture that may be read."""

    def check(shape: tuple[int, ...]) -> None:
        if len(shape) > 1:
            height, width = sorted(shape)[-2:]
            check_size(width, height, path)

    return check


def _by_numbers(path: Path) -> tuple[list[tuple[str, int]], str]:
    """Sorts names with their numbers as numbers."""
    parts = re.findall(r"([^0-9]*)([0-9]*)", path.name)
    return [(text, int(digits[:1000] or -1)) for text, digits in parts], path.name


def _refuse_index(path: Path, choice: MaskChoice) -> None:
    if choice.index is not None:
        raise InputError(
            f"{path}: is one mask, `mask_index` {choice.index} chooses one of an array; "
            "choose one of several labels: `label` N"
        )


def _values(image: Image.Image, path: Path, label: str | None) -> NDArray[Any]:
    """The values of `read_mask` [H, W]: bool, uint8, uint16 or float; int8 where -1 is unknown."""
    alpha = _alpha(image) if label is None else None
    if alpha is not None:
        return alpha
    if image.format in LOSSY:
        if label is not None:
            raise InputError(
                f"{path}: is a {image.format} file, whose losses change labels, expected a .png "
                "for `label`"
            )
        brightness = _brightest(image.convert("RGB").split())
        _refuse_photo(brightness, path)
        return brightness
    picture = _picture_of(image, path)
    if picture.codes.dtype.kind in "bf":
        return picture.codes
    if image.mode == "P" and picture.brightness.dtype == bool and label != str(BORDER):
        border = picture.codes == BORDER
        labels = np.where(border, np.uint8(0), picture.codes)
        if border.any() and labels_of(labels):
            pixels = _label_of(labels, labels != 0, path, label)
            return np.where(border, -1, labels != 0 if pixels is None else pixels).astype(np.int8)
    pixels = _label_of(picture.codes, picture.brightness, path, label, picture.colours)
    if pixels is not None:
        return pixels
    if picture.may_be_photo:
        _refuse_photo(picture.brightness, path)
    return picture.brightness


def _alpha(image: Image.Image) -> NDArray[Any] | None:
    """The alpha channel [H, W]; None if there is none, or it is no mask."""
    transparency = "transparency" in image.info and image.mode in ("P", "L", "RGB")
    if not transparency and image.mode not in WITH_ALPHA:
        return None
    with_channel = image if image.mode in ("RGBA", "LA") else image.convert("RGBA")
    alpha = np.asarray(with_channel.getchannel("A"))
    # The alpha channel is no mask if an editor left a few pixels of it transparent, or if it is
    # slightly transparent everywhere.
    return alpha if np.count_nonzero(alpha < 128) >= 1e-3 * alpha.size else None


class _Picture(NamedTuple):
    """codes, brightness : [H, W], a number for each label, and the mask if there are no labels.

    colours : codes are colours.
    """

    codes: NDArray[Any]
    brightness: NDArray[Any]
    may_be_photo: bool = False
    colours: bool = False


def _picture_of(image: Image.Image, path: Path) -> _Picture:
    if image.mode == "P":
        if _is_grey(image):
            grey = np.asarray(image.convert("L"))
            return _Picture(grey, grey)
        index = np.asarray(image)
        palette = np.array(image.getpalette("RGB") or [0] * 768).reshape(-1, 3)
        black = np.flatnonzero((palette == 0).all(1))
        if index.size and 0 not in black and len(black) and (index == black[0]).any():
            # The background is the black entry, wherever the palette has it.
            order = np.arange(256, dtype=np.uint8)
            order[0], order[black[0]] = black[0], 0
            index = order[index]
        return _Picture(index, index != 0)
    if image.mode in ("1", "L", "F", "I") or image.mode.startswith("I;16"):
        grey = grey_values(image, path)
        # A map of probabilities is dark around the object; a photo may have a white background.
        bright = grey.dtype == np.uint8 and bool(np.median(_border(grey)) > 127)
        return _Picture(grey, grey, may_be_photo=bright)
    # A map of probabilities has one channel; a picture in colours may be a photo.
    bands = image.convert("RGB").split()
    red, green, blue = (np.asarray(band) for band in bands)
    if np.array_equal(red, green) and np.array_equal(green, blue):
        return _Picture(red, _brightest(bands), may_be_photo=True)
    codes = red.astype(np.uint32) << 16 | green.astype(np.uint32) << 8 | blue
    return _Picture(codes, _brightest(bands), may_be_photo=True, colours=True)


def _brightest(bands: tuple[Image.Image, ...]) -> NDArray[np.uint8]:
    """The largest value [H, W] of the channels of a picture."""
    from PIL import ImageChops

    return np.asarray(functools.reduce(ImageChops.lighter, bands))


def _refuse_photo(brightness: NDArray[np.uint8], path: Path) -> None:
    """Raise InputError for a picture that is grey over large parts."""
    values = brightness.astype(np.float32) / np.float32(255.0)
    if is_grey_inside(values, values > 0.5, np.ones(values.shape, bool)):
        raise InputError(
            f"{path}: is a photo, grey over large parts, expected a mask; segment the object first "
            "(rembg, SAM), or give a picture with a transparent background; labels belong into "
            ".png files"
        )


def _is_grey(image: Image.Image) -> bool:
    """Whether the used colours of a palette are grey, and not all the same."""
    indices = np.flatnonzero(image.histogram())
    whole_palette = image.resize((256, 1))
    whole_palette.putdata(range(256))
    colours = np.asarray(whole_palette.convert("RGB"))[0, indices]
    grey = bool((colours == colours[:, :1]).all())
    # A palette with one colour for different indices says nothing: then the indices are labels.
    return grey and (indices.size == 1 or colours.min() != colours.max())


def _label_of(
    codes: NDArray[Any],
    brightness: NDArray[Any],
    path: Path,
    label: str | None,
    colours: bool = False,
) -> Bits | None:
    """The pixels of one label of ``codes`` [H, W]; None if the ``brightness`` is the mask.

    Raises InputError if there are several and none is chosen, or the chosen one is not there.
    """
    sizes = labels_of(codes)
    if label is not None:
        code = _code(label, colours)
        if code not in sizes:
            raise _which(path, sizes, colours, f"has no label {plain(label)}")
        return np.asarray(codes == code)
    if len(sizes) > 1:
        raise _which(path, sizes, colours, "holds several labels")
    if not sizes:
        return None
    (code,) = sizes
    pixels: Bits = codes == code
    # A bright label on a dark background is a mask as it is, with its soft edges; `to_unit` knows
    # 0 and 1.
    of_zero_and_one = code == 1 and codes is brightness
    dark = ~pixels & ~_next_to(pixels)
    as_it_is = _is_bright(brightness[pixels]) and not (dark.any() and _is_bright(brightness[dark]))
    return None if of_zero_and_one or as_it_is else pixels


def _border(values: NDArray[Any]) -> NDArray[Any]:
    """The pixels along the border of [H, W]."""
    return np.concatenate([values[0], values[-1], values[:, 0], values[:, -1]])


def _next_to(pixels: Bits) -> Bits:
    """The pixels [H, W] that touch ``pixels``, as a soft edge does."""
    grown = np.zeros_like(pixels)
    grown[1:] |= pixels[:-1]
    grown[:-1] |= pixels[1:]
    grown[:, 1:] |= pixels[:, :-1]
    grown[:, :-1] |= pixels[:, 1:]
    return grown


def _is_bright(values: NDArray[Any]) -> bool:
    if values.dtype == bool:
        return True
    return bool((values > np.iinfo(values.dtype).max // 2).all())


def _code(label: str, colours: bool) -> int:
    try:
        numbers = [int(part) for part in label.split(",")]
        if len(numbers) != (3 if colours else 1) or min(numbers) < 0:
            raise ValueError
    except ValueError:
        expected = "a colour R,G,B" if colours else "a whole number"
        raise InputError(f"`label` is {plain(label)}, expected {expected}") from None
    return numbers[0] if not colours else numbers[0] << 16 | numbers[1] << 8 | numbers[2]


def _which(path: Path, sizes: dict[int, int], colours: bool, what: str) -> InputError:
    names = []
    for code, pixels in sorted(sizes.items(), key=lambda item: -item[1])[:MOST_LISTED]:
        name = f"{code >> 16},{code >> 8 & 255},{code & 255}" if colours else str(code)
        names.append(f"{name} ({pixels:,} px)")
    more = ", ..." if len(sizes) > MOST_LISTED else ""
    form = "R,G,B" if colours else "N"
    return InputError(
        f"{path}: {what}, expected one of {', '.join(names) or 'none'}{more}: `label` {form}"
    )


def labels_of(codes: NDArray[Any]) -> dict[int, int]:
    """The labels in ``codes`` [H, W] and their pixels, without the background.

    A label is a value with areas of its own (`SOLID`). The background is 0; without any 0, it is
    the value that most pixels along the border have. A mask has one label, and other values only
    along its soft edge.
    """
    if codes.dtype == bool or codes.size < 9:
        return {}
    if codes.dtype == np.uint8:
        counts = np.bincount(codes.ravel(), minlength=256)
        values = np.flatnonzero(counts)
        sizes = counts[values]
    else:
        values, sizes = np.unique(codes, return_counts=True)
    if len(values) > MOST_VALUES:
        return {}
    middle = codes[1:-1, 1:-1]
    same = (middle == codes[:-2, 1:-1]) & (middle == codes[2:, 1:-1])
    same &= (middle == codes[1:-1, :-2]) & (middle == codes[1:-1, 2:])
    solid = {int(v): int(n) for v, n in zip(values, sizes, strict=True)
             if np.count_nonzero(same & (middle == v)) >= SOLID * n}  # fmt: skip
    border = _border(codes)
    background = 0
    if 0 not in values:
        edge, many = np.unique(border, return_counts=True)
        background = int(edge[many.argmax()])
    solid.pop(background, None)
    return solid


def _of_array(arrays: dict[str, Any], path: Path, choice: MaskChoice) -> Floats:
    """A mask of a .npy, .npz or .pt file."""
    fitting = {name: np.asarray(array) for name, array in arrays.items() if np.ndim(array) >= 2}
    named = [name for name in MASK_NAMES if name in fitting]
    if len(fitting) != 1 and not named:
        shapes = ", ".join(
            f"{plain(name) if name else 'an array'} {list(np.shape(a))}"
            for name, a in arrays.items()
        )
        raise InputError(
            f"{path}: holds {shapes or 'no array'}, expected one mask [H, W], or one called "
            f"{' or '.join(MASK_NAMES[:2])}"
        )
    array = fitting[named[0]] if named else next(iter(fitting.values()))
    shape = list(array.shape)
    while array.ndim > 3 and 1 in array.shape[:2]:
        # A batch [N, 1, H, W] or [1, N, H, W].
        array = array.reshape(array.shape[0] * array.shape[1], *array.shape[2:])
    if array.ndim == 3 and array.shape[0] != 1 and array.shape[2] == 1:
        array = array[..., 0]
    # A last side of 3 or 4 is that of colours.
    stack = array.ndim == 3 and array.shape[0] <= MOST_MASKS and array.shape[2] > 4
    if (
        array.size
        and (stack or array.ndim == 3 and array.shape[0] == 1)
        and array.dtype.kind in "bfiu"
    ):
        scores = [np.ravel(arrays[name]) for name in SCORE_NAMES if name in arrays]
        array = _one_of(array, path, choice, scores[0] if scores else np.empty(0))
    else:
        _refuse_index(path, choice)
    if array.ndim != 2 or array.dtype.kind not in "bfiu" or 0 in array.shape:
        raise InputError(f"{path}: holds {array.dtype} {shape}, expected a mask [H, W]")
    check_size(array.shape[1], array.shape[0], path)
    if array.dtype.kind == "f" and choice.label is not None:
        with np.errstate(invalid="ignore"):
            if not (array == np.rint(array)).all() or array.min() < 0.0 or array.max() > 1e9:
                raise InputError(f"{path}: holds no whole numbers, expected labels for `label`")
        array = array.astype(np.int64)
    if array.dtype == bool and choice.label is not None:
        raise InputError(f"{path}: holds true and false, expected labels for `label`")
    if array.dtype.kind == "f":
        return to_unit(_of_floats(array, path), path)
    if array.dtype.kind in "iu" and int(array.min()) >= 0:
        # Of arrays, 255 is white whatever the type says.
        codes = array.astype(np.uint8) if int(array.max()) <= 255 else array
        pixels = _label_of(codes, codes, path, choice.label)
        return to_unit(array if pixels is None else pixels, path)
    return to_unit(array, path)


def _one_of(
    array: NDArray[Any], path: Path, choice: MaskChoice, scores: NDArray[Any]
) -> NDArray[Any]:
    """One mask of [N, H, W]; masks that are all the same are one.

    ``scores`` : of the masks, or of other things.
    """
    if choice.index is None:
        if (array == array[:1]).all():
            return np.asarray(array[0])
        fits = len(scores) == len(array) and scores.dtype.kind in "fiu"
        words = [f", score {s:.3g}" if fits else "" for s in (scores if fits else array)]
        sizes = [
            f"{i} ({np.count_nonzero(mask > 0):,} px{words[i]})" for i, mask in enumerate(array)
        ]
        more = ", ..." if len(sizes) > MOST_LISTED else ""
        raise InputError(
            f"{path}: holds {len(array)} masks, expected one of "
            f"{', '.join(sizes[:MOST_LISTED])}{more}: `mask_index` N"
        )
    if not 0 <= choice.index < len(array):
        raise InputError(
            f"{path}: has no mask {choice.index}, expected `mask_index` 0 to {len(array) - 1}"
        )
    return np.asarray(array[choice.index])


def _of_floats(array: NDArray[Any], path: Path) -> NDArray[Any]:
    with np.errstate(invalid="ignore"):
        low, high = float(array.min()), float(array.max())
    if -UNDERSHOOT <= low < 0.0 and high <= 1.0 + UNDERSHOOT:
        # Interpolation of a mask overshoots a little.
        return np.clip(array, 0.0, 1.0)
    if low < 0.0 < high and np.isfinite([low, high]).all():
        warnings.warn(
            f"{path}: its values span {low:.3g} to {high:.3g}, read as logits: inside is over 0",
            stacklevel=4,
        )
        return array > 0.0
    if low >= 0.0 and 1.0 < high <= 255.0 and (array == np.rint(array)).all():
        return (array / 255.0).astype(np.float32)
    return array
