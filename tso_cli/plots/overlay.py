"""The picture of a refinement: mask and silhouette, and the cloud, before and after.

Drawn with Pillow: matplotlib would take five times as long as a small refinement.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from ..evaluation.footprint import Solid, WindowImages, common_window, grid_of, in_window
from ..geometry.arrays import Array, Box, Pixels
from ..geometry.camera import Camera
from ..geometry.points import evenly
from ..geometry.view import View
from ..refinement import RefineResult

Row = list[tuple[str, Image.Image]]
Colour = tuple[float, float, float]

# What the colours of mask and silhouette mean. They are safe for colour-blind readers.
COLOURS: dict[str, Colour] = {
    "agree": (0.62, 0.65, 0.68),
    "mask without silhouette": (0.0, 0.45, 0.70),
    "silhouette without mask": (0.90, 0.45, 0.0),
    "unknown": (0.93, 0.90, 0.80),
}
# Colours of points from near to far: yellow, green, blue, violet, each darker than the one before.
NEAR_TO_FAR = np.array(
    [(253, 231, 37), (94, 201, 98), (33, 145, 140), (59, 82, 139), (68, 1, 84)], np.float64
)

# How much of a photo is seen: alone, and under the colours of mask and silhouette.
PHOTO, PHOTO_UNDER = 0.45, 0.25
GREY = np.array([0.299, 0.587, 0.114])  # how bright red, green and blue look

# Pixels: side of a panel, space around it, height of its title, height of the legend.
PANEL, GAP, TITLE, LEGEND = 340, 24, 32, 44


def compare(images: WindowImages, photo: Pixels | None = None) -> NDArray[np.float64]:
    """Picture [H, W, 3] of mask and silhouette, in the colours of `COLOURS`.

    ``photo`` [H, W, 3] is dimmed behind them, in grey: its colours would be taken for theirs.
    """
    picture = np.ones((*images.mask.shape, 3))
    picture[images.mask & images.silhouette] = COLOURS["agree"]
    picture[images.mask & ~images.silhouette] = COLOURS["mask without silhouette"]
    picture[~images.mask & images.silhouette] = COLOURS["silhouette without mask"]
    if images.known is not None:
        picture[~images.known] = COLOURS["unknown"]
    if photo is None:
        return picture
    share = np.where((picture == 1.0).all(2, keepdims=True), PHOTO, PHOTO_UNDER)
    grey = photo @ GREY / 255.0
    return (1.0 - share) * picture + share * grey[..., None]


def photo_in_window(photo: Pixels | None, camera: Camera, box: Box) -> Pixels | None:
    """The part of a photo that `in_window` compares, in its cells; None for no photo.

    ``photo`` [h, w, 3] is the whole image of ``camera``, of any resolution.
    """
    if photo is None:
        return None
    (left, top, right, bottom), width, height, _, _ = grid_of(camera, box)
    high, wide = photo.shape[:2]
    across, down = wide / camera.width, high / camera.height
    # Rounding may leave an edge slightly outside.
    edges = (
        max((left + 0.5) * across, 0.0),
        max((top + 0.5) * down, 0.0),
        min((right + 0.5) * across, wide),
        min((bottom + 0.5) * down, high),
    )
    image = Image.fromarray(np.ascontiguousarray(photo))
    return np.asarray(image.resize((width, height), Image.Resampling.BOX, edges))


def draw_overlay(
    path: Path, result: RefineResult, views: Sequence[View], photos: Sequence[Pixels | None] = ()
) -> None:
    """Write a picture of a result to ``path``.

    For one view there are two rows, before and after: mask against silhouette, the cloud seen from
    the camera, and the cloud seen from the camera's right. For several views there is one row each,
    for at most six views. Masks and silhouettes are cropped to the square in which their IoU is
    measured. ``photos`` [h, w, 3] of the whole images are dimmed behind them.
    """
    heading, photos = None, photos or [None] * len(views)
    if len(views) == 1:
        rows = _before_and_after(result, views[0], photos[0])
    else:
        chosen = evenly(len(views), most=6)
        rows = [_row_of_view(result, views, number, photos[number]) for number in chosen]
        which = f"{len(views)} views"
        if len(chosen) < len(views):
            which = f"{len(chosen)} of {which}, evenly chosen"
        what = "mask against silhouette before and after, and the refined cloud from each camera"
        heading = f"{which}: {what}"
    colours = dict(COLOURS)
    if all(view.known is None for view in views):
        del colours["unknown"]
    # This level takes 60 % of the time and 108 % of the size of the default level 6.
    _draw(rows, heading, colours).save(path, format="PNG", compress_level=1)


def write_thumbnail(path: Path, result: RefineResult, views: Sequence[View]) -> None:
    """Write mask and silhouette of the first view, before and after, side by side as PNG."""
    side, gap = 96, 4  # px
    stages = stages_of(result, views[0], 0)
    window = common_window(stages)
    canvas = Image.new("RGB", (2 * side + gap, side), "white")
    for number, (solid, stage) in enumerate(stages):
        colours = np.rint(compare(in_window(solid, stage, window)) * 255.0).astype(np.uint8)
        square = Image.fromarray(colours).resize((side, side), Image.Resampling.BOX)
        canvas.paste(square, (number * (side + gap), 0))
    canvas.quantize(16).save(path, format="PNG", optimize=True)


def _before_and_after(result: RefineResult, view: View, photo: Pixels | None) -> list[Row]:
    stages = zip(
        ("before", "after"),
        _silhouettes(result, view, 0, photo),
        _from_camera(result, view),
        (result.views[0].iou_before, result.views[0].iou_after),
        strict=True,
    )
    # The camera's axes: x right, y down, z away. Seen from the camera's right, z points to the
    # right.
    return [
        [
            (f"{name}: IoU {iou:.3f}", silhouette),
            (f"{name}: from the camera", _dots(x, y, z)),
            (f"{name}: from the camera's right", _dots(z, y, -x)),
        ]
        for name, silhouette, (x, y, z), iou in stages
    ]


def _row_of_view(
    result: RefineResult, views: Sequence[View], number: int, photo: Pixels | None
) -> Row:
    view, fit = views[number], result.views[number]
    silhouette_before, silhouette_after = _silhouettes(result, view, number, photo)
    return [
        (f"view {number + 1} before: IoU {fit.iou_before:.3f}", silhouette_before),
        (f"after: IoU {fit.iou_after:.3f}, weight {fit.inlier_weight:.2f}", silhouette_after),
        (f"after: from camera {number + 1}", _dots(*_from_camera(result, view)[1])),
    ]


def _from_camera(result: RefineResult, view: View) -> list[NDArray[np.float64]]:
    """The clouds [3, N] before and after in the camera's axes, scaled alike to fit a panel."""
    rotated = [points @ view.camera.R.T for points in result.measured]
    low = np.min([points.min(0) for points in rotated], axis=0)
    high = np.max([points.max(0) for points in rotated], axis=0)
    middle, half = (low + high) / 2.0, float((high - low).max()) * 0.53
    return [((points - middle) / half).T for points in rotated]


def stages_of(result: RefineResult, view: View, number: int) -> list[tuple[Solid, View]]:
    """What is seen before (given camera) and after (refined camera), and what sees it."""
    before, after = result.solids
    return [(before, view), (after, replace(view, camera=result.cameras[number]))]


def _silhouettes(
    result: RefineResult, view: View, number: int, photo: Pixels | None
) -> list[Image.Image]:
    """Mask against silhouette, before and after."""
    stages = stages_of(result, view, number)
    box = common_window(stages)
    behind = photo_in_window(photo, view.camera, box)
    return [_fitted(compare(in_window(solid, stage, box), behind)) for solid, stage in stages]


def _draw(rows: list[Row], heading: str | None, colours: dict[str, Colour]) -> Image.Image:
    """Rows of three titled panels between heading and legend."""
    font = ImageFont.load_default(16)
    over = TITLE if heading else 0
    picture = Image.new(
        "RGB", (3 * (PANEL + GAP) + GAP, over + len(rows) * (PANEL + TITLE) + LEGEND), "white"
    )
    draw = ImageDraw.Draw(picture)
    if heading:
        draw.text((picture.width / 2, over - 8), heading, "black", font, anchor="ms")
    for i, row in enumerate(rows):
        for j, (title, panel) in enumerate(row):
            left = GAP + j * (PANEL + GAP) + (PANEL - panel.width) // 2
            top = over + TITLE + i * (PANEL + TITLE) + (PANEL - panel.height) // 2
            picture.paste(panel, (left, top))
            draw.rectangle(
                (left - 1, top - 1, left + panel.width, top + panel.height), outline="black"
            )
            draw.text((left + panel.width / 2, top - 8), title, "black", font, anchor="ms")
    left, middle_y = GAP, picture.height - LEGEND // 2
    for label, colour in colours.items():
        draw.rectangle(
            (left, middle_y - 6, left + 30, middle_y + 6), tuple(round(255 * c) for c in colour)
        )
        draw.text((left + 40, middle_y), label, "black", font, anchor="lm")
        left += 40 + round(font.getlength(label)) + GAP
    return picture


def _fitted(colours: NDArray[np.float64]) -> Image.Image:
    """[H, W, 3] in [0, 1] as a panel."""
    image = Image.fromarray(np.rint(colours * 255.0).astype(np.uint8))
    scale = PANEL / max(image.size)
    width, height = (max(1, round(side * scale)) for side in image.size)
    return image.resize(
        (width, height), Image.Resampling.NEAREST if scale >= 1.0 else Image.Resampling.BOX
    )


def near_to_far(shares: Array) -> Pixels:
    """The colours [N, 3] of shares [N]: yellow for 0, dark violet for 1."""
    at = shares * (len(NEAR_TO_FAR) - 1.0)
    stops = np.arange(len(NEAR_TO_FAR))
    channels = [np.interp(at, stops, channel) for channel in NEAR_TO_FAR.T]
    return np.rint(np.stack(channels, 1)).astype(np.uint8)


def _dots(
    across: NDArray[np.float64], down: NDArray[np.float64], depth: NDArray[np.float64]
) -> Image.Image:
    """A panel of points; ``across`` and ``down`` are in [-1, 1]. Near points hide far points."""
    supersampling = 3
    side = PANEL * supersampling
    radius = supersampling * float(np.clip(48.0 / np.sqrt(len(depth)), 0.4, 1.9))
    around = np.arange(-int(radius), int(radius) + 1)
    disc = (around[:, None] * side + around)[np.hypot(around[:, None], around) <= radius]
    order = np.argsort(-depth)
    pixel = np.rint((np.stack([across, down]) + 1.0) * (side / 2)).astype(np.int64)
    shade = np.rint(np.interp(depth, (depth.min(), depth.max()), (0.0, 254.0))).astype(np.uint8)
    canvas = np.full(side * side, 255, np.uint8)
    # If several points are assigned to one pixel, the last one stays.
    canvas[((pixel[1] * side + pixel[0])[order, None] + disc).ravel()] = shade[order].repeat(
        len(disc)
    )
    image = Image.fromarray(canvas.reshape(side, side))
    image.putpalette(near_to_far(np.linspace(0.0, 1.0, 255)).tobytes() + b"\xff\xff\xff")
    return image.convert("RGB").resize((PANEL, PANEL), Image.Resampling.BOX)
