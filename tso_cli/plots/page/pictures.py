"""What the page shows of each view: the photo, outlines, and what is missing or extra."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from PIL import Image

from ...evaluation.footprint import common_window, in_window
from ...geometry.arrays import Array, Bits, Box, Floats, Pixels
from ...geometry.points import evenly
from ...geometry.view import View
from ...refinement import RefineResult
from ..overlay import compare, stages_of
from .packing import picture_uri

MOST_VIEWS = 12
# Most views, and pixels along the longer side of a picture of each.
SIDES = ((1, 1000), (4, 700), (MOST_VIEWS, 460))
# The part of a photo that is shown is the window and this share of its side all around.
AROUND = 0.35
# If that is at least this share of the photo, the whole photo is shown.
WHOLE = 0.6
# Characters of one outline; a ragged one is simplified until it fits.
MOST_OUTLINE = 40_000
# Of a mask without a photo: background, object, unknown.
PAPER, OBJECT, UNKNOWN = (255, 255, 255), (214, 219, 224), (237, 230, 204)


def pictures_of(
    result: RefineResult, views: Sequence[View], photos: Sequence[Pixels | None]
) -> list[dict[str, Any]]:
    """For at most `MOST_VIEWS` views, evenly chosen, what `write.py` shows of it."""
    numbers = list(evenly(len(views), most=MOST_VIEWS))
    side = next(side for most, side in SIDES if len(numbers) <= most)
    return [_picture(result, views[n], int(n), photos[n], side) for n in numbers]


def _picture(
    result: RefineResult, view: View, number: int, photo: Pixels | None, side: int
) -> dict[str, Any]:
    stages = stages_of(result, view, number)
    window = common_window(stages)
    box = _part(view, window)
    left, top, right, bottom = box
    scale = side / max(right - left, bottom - top)
    if photo is None:
        scale = min(scale, 4.0)  # the pixels of a small mask need no more
    width = max(1, round((right - left) * scale))
    height = max(1, round((bottom - top) * scale))
    mask = _resized(view.mask, box, width, height)
    base = _base(view, photo, mask, box)
    silhouettes = [
        solid.silhouette(stage.camera.cropped(box, width, height)) for solid, stage in stages
    ]
    differences = []
    for solid, stage in stages:
        images = in_window(solid, stage, window)
        colours = np.rint(compare(images) * 255.0).astype(np.uint8)
        differences.append({
            "uri": picture_uri(Image.fromarray(colours).quantize(8), photo=False),
            "width": colours.shape[1],
            "height": colours.shape[0],
            "missing": _share(images.mask & ~images.silhouette, images.mask, images.known),
            "extra": _share(~images.mask & images.silhouette, images.mask, images.known),
        })  # fmt: skip
    whole = (right - left, bottom - top) == (view.camera.width, view.camera.height)
    rounded = [round(edge + 0.5) for edge in box]
    return {
        "number": number,
        "base": picture_uri(base, photo=photo is not None),
        "photo": photo is not None,
        "unknown": view.known is not None,
        "width": width,
        "height": height,
        "box": list(box),
        "part": None if whole else rounded,
        "outlines": {
            "mask": outline(mask),
            "start": outline(silhouettes[0].astype(np.float32)),
            "result": outline(silhouettes[1].astype(np.float32)),
        },
        "differences": differences,
    }


def _share(pixels: Bits, mask: Bits, known: Bits | None) -> float:
    """How many ``pixels`` there are, as a share of the mask's."""
    if known is not None:
        pixels, mask = pixels & known, mask & known
    return float(pixels.sum() / max(int(mask.sum()), 1))


def _part(view: View, window: Box) -> Box:
    """The part of the image to show, whole pixels."""
    first, last = np.array(window).reshape(2, 2)
    margin = AROUND * float((last - first).max())
    size = np.array([view.camera.width, view.camera.height])
    first = np.maximum(np.floor(first - margin + 0.5), 0.0) - 0.5
    last = np.minimum(np.ceil(last + margin + 0.5), size) - 0.5
    if ((last - first) >= WHOLE * size).all():
        first, last = np.array([-0.5, -0.5]), size - 0.5
    (left, top), (right, bottom) = first.tolist(), last.tolist()
    return left, top, right, bottom


def _resized(values: Floats, box: Box, width: int, height: int) -> Floats:
    left, top, right, bottom = (round(edge + 0.5) for edge in box)
    part = np.ascontiguousarray(values[top:bottom, left:right], np.float32)
    image = Image.fromarray(part)
    larger = width > part.shape[1]
    how = Image.Resampling.BILINEAR if larger else Image.Resampling.BOX
    return np.asarray(image.resize((width, height), how))


def _base(view: View, photo: Pixels | None, mask: Floats, box: Box) -> Image.Image:
    """The photo's part, or the mask as a pale shape."""
    height, width = mask.shape
    if photo is not None:
        across = photo.shape[1] / view.camera.width
        down = photo.shape[0] / view.camera.height
        left, top, right, bottom = (edge + 0.5 for edge in box)
        edges = (left * across, top * down, right * across, bottom * down)
        image = Image.fromarray(np.ascontiguousarray(photo))
        return image.resize((width, height), Image.Resampling.BICUBIC, edges, reducing_gap=2.0)
    share = mask[..., None]
    colours = (1.0 - share) * np.array(PAPER) + share * np.array(OBJECT)
    if view.known is not None:
        known = _resized(view.known.astype(np.float32), box, width, height)
        colours[known < 0.5] = UNKNOWN
    return Image.fromarray(np.rint(colours).astype(np.uint8)).quantize(32)


def outline(values: Floats) -> str:
    """The 0.5 outline of an image [H, W], as the path of an SVG in pixels from the upper left."""
    from skimage.measure import approximate_polygon, find_contours

    # A border, so that the outline of what is cut off closes along the edge.
    around = np.pad(values.astype(np.float64), 1)
    found: list[Array] = [contour - 0.5 for contour in find_contours(around, 0.5)]
    tolerance = 0.3
    while True:
        parts = []
        for contour in found:
            line = approximate_polygon(contour, tolerance)
            if len(line) > 3:
                numbers = " ".join(f"{x:.1f} {y:.1f}" for y, x in line[:-1].tolist())
                parts.append(f"M{numbers}Z")
        path = "".join(parts)
        if len(path) <= MOST_OUTLINE or tolerance > 16.0:
            return path[: path.rfind("M", 0, MOST_OUTLINE)] if len(path) > MOST_OUTLINE else path
        tolerance *= 2.0
