"""The photo behind each mask, for pictures of the result. No loss looks at it."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..diagnosis.assumptions import as_meant, mask_change
from ..errors import InputError
from ..geometry.arrays import Box, Pixels
from ..geometry.view import View
from ..io.images import FORMATS, WITH_ALPHA
from ..io.masks import MOST_VALUES
from ..io.views import ViewFiles, load_views, named_photos, view_without_camera

if TYPE_CHECKING:
    from .load import Scene

# Pixels along each side of a photo's part.
SIDE = 512
BEYOND = (237, 230, 204)  # the colour of what is unknown
# A photo differs between its channels by more than losses make of grey.
LEAST_CHROMA = 12


def photos_of(scene: Scene, files: ViewFiles, fit: bool = False) -> list[Pixels | None]:
    """For each view the picture [H, W, 3] of its whole image, of any resolution; None for none.

    That is the photo of the network modes, else the image of the view, else the picture that the
    camera file names, else the file of its mask if that is a photo with an alpha channel or in
    colours. ``fit`` : as in `load_points_scene`.
    """
    if scene.photo is not None:
        return [scene.photo]
    views = scene.shown or scene.views
    if any(view.image is not None for view in views):
        return [None if view.image is None else _as_pixels(view.image) for view in views]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of the masks, which are read for the second time
            return _named(scene, files, fit) or _of_masks(scene, files, fit)
    except InputError:
        return [None] * len(scene.views)


def _named(scene: Scene, files: ViewFiles, fit: bool) -> list[Pixels | None]:
    """The pictures that the camera file names; none where it does not."""
    named = [] if fit else named_photos(files)
    if not named:
        return []
    views, _ = load_views(replace(files, image=named, depth=(), any_size=True))
    return [_meant(view, scene) for view in views]


def _of_masks(scene: Scene, files: ViewFiles, fit: bool) -> list[Pixels | None]:
    """The files of the masks, where they are photos."""
    if not all(map(_may_be_photo, files.masks)):
        return [None] * len(scene.views)
    # Read as an image of the view, the file is turned and undistorted as its mask was.
    pictured = replace(files, image=files.masks, depth=())
    photos: list[Pixels | None] = []
    for view in [view_without_camera(pictured)[0]] if fit else load_views(pictured)[0]:
        assert view.image is not None
        image = mask_change(view, scene.given.assumptions).of(view.image)
        pixels = _meant(replace(view, image=image), scene)
        photos.append(pixels if _is_photo(pixels, _has_alpha(view.name)) else None)
    return photos


def _meant(view: View, scene: Scene) -> Pixels:
    """The image of a view, as the scene's assumptions mean it."""
    image = as_meant(view, scene.given.assumptions).image
    assert image is not None
    return _as_pixels(image)


def cut_out(photo: Pixels, box: Box) -> Pixels:
    """The part ``box`` of a photo [H, W, 3 or 4] as [SIDE, SIDE, 3]; pale beyond its border."""
    from PIL import Image

    left, top, right, bottom = (edge + 0.5 for edge in box)
    image = Image.fromarray(np.ascontiguousarray(photo[..., :3]))
    # Reduced by whole factors first: the transform takes single pixels.
    factor = max(1, int((right - left) / SIDE))
    image = image.reduce(factor) if factor > 1 else image
    extent = (left / factor, top / factor, right / factor, bottom / factor)
    return np.asarray(
        image.transform(
            (SIDE, SIDE),
            Image.Transform.EXTENT,
            extent,
            Image.Resampling.BILINEAR,
            fillcolor=BEYOND,
        )
    )


def _as_pixels(image: Sequence[float] | np.ndarray) -> Pixels:
    return np.rint(np.asarray(image) * 255.0).astype(np.uint8)


def _mode(file: Path) -> str:
    """The mode of a picture; "" if it is none."""
    from PIL import Image

    try:
        with file.open("rb") as stream, Image.open(stream, formats=FORMATS) as image:
            return "RGBA" if "transparency" in image.info else image.mode
    except Exception:  # no picture, or no file
        return ""


def _may_be_photo(file: Path) -> bool:
    return _mode(file) in ("RGB", "YCbCr", "CMYK", "P", *WITH_ALPHA)


def _has_alpha(name: str) -> bool:
    return _mode(Path(name)) in WITH_ALPHA


def _is_photo(pixels: Pixels, alpha: bool) -> bool:
    """Whether a picture has many colours; a mask and an image of labels have few, or are grey."""
    step = max(1, int(np.sqrt(pixels.shape[0] * pixels.shape[1] / 65536)))
    sample = pixels[::step, ::step].reshape(-1, 3).astype(np.int32)
    coloured = int((sample.max(1) - sample.min(1)).max()) > LEAST_CHROMA
    codes = sample[:, 0] << 16 | sample[:, 1] << 8 | sample[:, 2]
    return (alpha or coloured) and len(np.unique(codes)) > MOST_VALUES
