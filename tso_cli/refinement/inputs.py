"""Masks and cameras in the forms that `refine` accepts -> views."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from torch import Tensor

from ..errors import InputError
from ..geometry.camera import Camera
from ..geometry.view import View


def as_views(masks: Any, cameras: Camera | Sequence[Camera] | None = None) -> tuple[View, ...]:
    """One `View` for each mask; raises InputError if masks and cameras do not pair up."""
    if isinstance(masks, View):
        masks = [masks]
    if isinstance(masks, Sequence) and masks and all(isinstance(mask, View) for mask in masks):
        if cameras is not None:
            raise InputError("views bring their own cameras, expected none beside them")
        return tuple(masks)
    if isinstance(masks, (Tensor, np.ndarray)) and masks.ndim == 2:
        masks = [masks]
    try:
        arrays = [_as_array(mask) for mask in masks]
    except (TypeError, ValueError):
        raise InputError("masks are no arrays of numbers, expected one [H, W] or a sequence of them") from None
    if any(mask.ndim != 2 for mask in arrays):
        raise InputError(f"a mask has shape {[list(m.shape) for m in arrays if m.ndim != 2][0]}, expected [H, W]")
    if cameras is None:
        cameras = [Camera.canonical(mask.shape[-1], mask.shape[0]) for mask in arrays]
    elif isinstance(cameras, Camera):
        cameras = [cameras]
    if len(arrays) == 0 or len(arrays) != len(cameras):
        raise InputError(f"found {len(arrays)} masks and {len(cameras)} cameras, expected one camera for each mask")
    return tuple(View(mask, camera, name=f"mask {i}") for i, (mask, camera) in enumerate(zip(arrays, cameras, strict=True)))


def _as_array(mask: Any) -> NDArray[np.float32]:
    if isinstance(mask, Tensor):
        mask = mask.detach().cpu().numpy()
    return np.asarray(mask, dtype=np.float32)
