"""The network's input from a photo: the same crop in training and in refinement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.arrays import Box
from ..geometry.camera import CANONICAL_DISTANCE, CANONICAL_FOCAL_AT_64, Camera
from ..geometry.resampling import area_resize
from ..geometry.view import View

# Side of the square that the canonical camera sees at the object's distance, in units of the cloud:
# 1.07.
CANONICAL_SIDE = 64.0 * CANONICAL_DISTANCE / CANONICAL_FOCAL_AT_64


@dataclass(frozen=True, eq=False)
class NetworkInput:
    """The network's input, and the mask and camera of the crop, which losses compare with.

    image : float32 [3, size, size] in [0, 1].
    mask : float32 [size, size] in [0, 1], the photo's mask, resampled like the photo; 0 where it is
        unknown.
    camera : the photo's camera, cropped like the photo.
    known : bool [size, size], False where more than half of a pixel lies outside the photo or is
        ignored.
    box : left, top, right, bottom edges of the crop in the photo, px.
    """

    image: NDArray[np.float32]
    mask: NDArray[np.float32]
    camera: Camera
    known: NDArray[np.bool_]
    box: Box

    def view(self, name: str = "mask") -> View:
        """Mask and camera of the crop as a view."""
        return View(self.mask, self.camera, None if self.known.all() else self.known, name)


def crop_box(mask_box: Box, crop_share: float) -> Box:
    """The square around ``mask_box``: its side is the box's longer side over ``crop_share``."""
    left, top, right, bottom = (float(edge) for edge in mask_box)
    half = max(right - left, bottom - top) / crop_share / 2.0
    u, v = (left + right) / 2.0, (top + bottom) / 2.0
    return u - half, v - half, u + half, v + half


def whole_box(camera: Camera, name: str = "mask") -> Box:
    """The square of the photo that shows `CANONICAL_SIDE` units around the world's origin.

    The canonical camera shows the same square. Like the uncropped pictures that CAPNet trains with,
    it shows the size of the object. Raises InputError if the origin is not in front of the camera.
    """
    depth = float(camera.t[2]) if camera.model == "perspective" else 1.0
    if depth <= 0.0:
        raise InputError(
            f"{name}: the camera has the object at depth {camera.t[2]:g}, "
            "expected it in front (> 0)"
        )
    u, v = (camera.K[:2, :2] @ camera.t[:2] / depth + camera.K[:2, 2]).tolist()
    half = 0.5 * CANONICAL_SIDE * float(camera.K[0, 0]) / depth
    return u - half, v - half, u + half, v + half


def network_input(
    image: NDArray[np.uint8],
    view: View,
    size: int = 64,
    crop_share: float = 0.9,
    background: str = "black",
) -> NetworkInput:
    """Crop, composite and resample a photo to the network's input, by exact area averaging.

    Parameters
    ----------
    image : [H, W, 3] or [H, W, 4].
    view : mask [H, W] and camera of the photo.
    size : pixels of the network's input along each side.
    crop_share : longer side of the object's box over the side of the crop (`crop_box`); 0 takes
        `whole_box`.
    background : "black" and "white" cut out the object by its mask and put it on this colour.
        "keep" leaves the photo as it is; then transparent pixels and pixels outside the photo are
        black.

    Raises InputError if the sizes of image and mask differ, or if the crop misses the object.
    """
    height, width = view.mask.shape
    if image.shape[:2] != (height, width):
        raise InputError(
            f"{view.name}: the image is {image.shape[1]}x{image.shape[0]}, "
            f"the mask {width}x{height} (width x height), expected the same size"
        )
    box = crop_box(view.box(), crop_share) if crop_share else whole_box(view.camera, view.name)

    # Only the part of a large photo that the crop covers is composited.
    left, top = max(0, int(np.floor(box[0] + 0.5))), max(0, int(np.floor(box[1] + 0.5)))
    part = (
        slice(top, max(top, int(np.ceil(box[3] + 0.5)))),
        slice(left, max(left, int(np.ceil(box[2] + 0.5)))),
    )
    shifted = (box[0] - left, box[1] - top, box[2] - left, box[3] - top)
    pixels, alpha = np.split(image[part].astype(np.float32) / np.float32(255.0), [3], axis=2)
    mask = view.mask[part]
    fill = 1.0 if background == "white" else 0.0
    if background != "keep":
        pixels = pixels * mask[:, :, None] + np.float32(fill) * (1.0 - mask[:, :, None])
    elif alpha.shape[2]:
        pixels = pixels * alpha
    values, coverage = area_resize(pixels, shifted, size, size)
    values = values * coverage[:, :, None] + fill * (1.0 - coverage[:, :, None])
    cropped, known_share = area_resize(
        mask, shifted, size, size, None if view.known is None else view.known[part]
    )
    known = known_share >= 0.5
    if not crop_share and not (cropped[known] > 0.5).any():
        raise InputError(
            f"{view.name}: nothing of the object lies in the {CANONICAL_SIDE:.2f} units around the "
            "world's origin that the network sees, expected a camera in the scale of the "
            "training set"
        )
    return NetworkInput(
        image=np.ascontiguousarray(np.clip(values, 0.0, 1.0).transpose(2, 0, 1), dtype=np.float32),
        mask=np.where(known, np.clip(cropped, 0.0, 1.0), 0.0).astype(np.float32),
        camera=view.camera.cropped(box, size, size),
        known=known,
        box=box,
    )
