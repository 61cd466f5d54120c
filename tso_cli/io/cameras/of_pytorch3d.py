"""PyTorch3D's cameras as .npz or .pt: R [N, 3, 3] and T [N, 3], which multiply rows from the right.

X_view = X_world R + T has x to the left, y up and z forward. Intrinsics are ``focal_length`` and
``principal_point``, or ``K`` [N, 4, 4]: in normalised device coordinates unless ``in_ndc`` is
false, then in pixels of ``image_size`` (height, width) with pixel centres at halves.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...geometry.arrays import Array
from .record import PYTORCH3D, Intrinsics, PartialCamera, matrix_of, of_ndc, of_pixels
from .source import CameraSource

NEEDS = "R and T"

# Keys that, next to R and T, only PyTorch3D has.
_OWN = {"focal_length", "principal_point", "in_ndc", "image_size"}


def recognises(source: CameraSource) -> bool:
    arrays = source.arrays
    if not arrays.keys() >= {"R", "T"}:
        return False
    # OpenCV's users store R and T too, with K [3, 3].
    return np.shape(arrays["K"])[-2:] == (4, 4) if "K" in arrays else bool(_OWN & arrays.keys())


def read(source: CameraSource) -> list[PartialCamera]:
    values = source.arrays
    R = _stack(source, values, "R", (3, 3))
    T = _stack(source, values, "T", (3,))
    count = max(len(R), len(T))
    ndc = bool(np.all(values.get("in_ndc", True)))
    numbers = _intrinsics(source, values)
    sizes = _stack(source, values, "image_size", (2,)) if "image_size" in values else None
    if not ndc and sizes is None:
        raise source.error("in_ndc", "false", "image_size (height, width) with it")
    views = []
    for i in range(count):
        size = None
        if sizes is not None:
            height, width = _at(source, "image_size", sizes, i, count)
            size = source.pixels("image_size: ", width, height)
        intrinsics: Intrinsics | None = None
        if numbers is not None:
            fx, fy, px, py = _at(source, "focal_length", numbers, i, count).tolist()
            pixels = matrix_of(fx, fy, px, py, corner=True)
            intrinsics = of_ndc(fx, fy, px, py) if ndc else of_pixels(pixels, size)
        rotation = PYTORCH3D @ _at(source, "R", R, i, count).T
        shift = PYTORCH3D @ _at(source, "T", T, i, count)
        title = f"[{i}]" if count > 1 else ""
        views.append(PartialCamera(title, intrinsics, rotation, shift, size))
    return views


def _stack(source: CameraSource, values: dict[str, Any], key: str, shape: tuple[int, ...]) -> Array:
    array = source.matrix(key, values[key], shape, (-1, *shape))
    return array[None] if array.ndim == len(shape) else array


def _at(source: CameraSource, key: str, stack: Array, number: int, count: int) -> Array:
    if len(stack) not in (1, count):
        raise source.error(f"the length of {key}", str(len(stack)), f"1 or {count}")
    entry: Array = stack[number if len(stack) > 1 else 0]
    return entry


def _intrinsics(source: CameraSource, values: dict[str, Any]) -> Array | None:
    """fx, fy, px, py [N, 4]; None if the file has none."""
    if "focal_length" in values:
        focal = source.matrix("focal_length", values["focal_length"], (), (-1,), (-1, 1), (-1, 2))
        focal = focal.reshape(1 if focal.ndim == 0 else len(focal), -1)
        point = np.zeros((1, 2))
        if "principal_point" in values:
            point = _stack(source, values, "principal_point", (2,))
        count = max(len(focal), len(point))
        if {len(focal), len(point)} - {1, count}:
            raise source.error("the length of focal_length", str(len(focal)), f"1 or {count}")
        both = np.broadcast_to(focal, (count, 2)), np.broadcast_to(point, (count, 2))
        return np.concatenate(both, axis=1)
    if "K" in values:
        K = _stack(source, values, "K", (4, 4))
        return np.stack([K[:, 0, 0], K[:, 1, 1], K[:, 0, 2], K[:, 1, 2]], axis=1)
    return None
