"""Arrays and pictures as text that a page holds."""

from __future__ import annotations

import base64
import io
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from ...geometry.arrays import Array

STEPS = 65535  # of a number in 16 bits


def packed(values: Array, low: Array | None = None, high: Array | None = None) -> dict[str, Any]:
    """Numbers [N, D] in 16 bits between ``low`` and ``high`` [D], the least and the largest."""
    low = values.min(0) if low is None else low
    high = values.max(0) if high is None else high
    span = np.where(high > low, high - low, 1.0)
    steps = np.rint(np.clip((values - low) / span, 0.0, 1.0) * STEPS).astype("<u2")
    return {"low": low.tolist(), "span": (span / STEPS).tolist(), "data": text_of(steps)}


def text_of(array: NDArray[Any]) -> str:
    """The bytes of an array, in base64."""
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode("ascii")


def picture_uri(image: Image.Image, photo: bool) -> str:
    """A data URI: JPEG of a photo, else PNG."""
    stream = io.BytesIO()
    if photo:
        image.convert("RGB").save(stream, format="JPEG", quality=82)
    else:
        image.save(stream, format="PNG", optimize=True)
    kind = "jpeg" if photo else "png"
    return f"data:image/{kind};base64,{base64.b64encode(stream.getvalue()).decode('ascii')}"
