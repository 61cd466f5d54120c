"""Small arrays inside JSON records: a few KB of text in place of a line a number."""

from __future__ import annotations

import base64
from typing import Any

import numpy as np
from numpy.typing import NDArray

LARGEST = 32_767


def pack(array: NDArray[np.generic], step: float) -> dict[str, Any]:
    """``array`` in whole multiples of ``step``: {"shape", "step", "type", "base64"}, values row by row, low byte first.

    The type is "uint8" where all values fit, else "int16", in which what is not finite or too large becomes the largest value.
    """
    scaled = np.rint(np.asarray(array, dtype=np.float64) / step)
    scaled = np.clip(np.nan_to_num(scaled, nan=LARGEST), -LARGEST, LARGEST)
    kind = "uint8" if scaled.size and scaled.min() >= 0.0 and scaled.max() <= 255.0 else "int16"
    values = scaled.astype(np.dtype(kind).newbyteorder("<"))
    text = base64.b64encode(values.tobytes()).decode("ascii")
    return {"shape": list(values.shape), "step": step, "type": kind, "base64": text}


def unpack(packed: dict[str, Any]) -> NDArray[np.float64]:
    """The array that `pack` was given, to half a step."""
    values = np.frombuffer(base64.b64decode(packed["base64"]), dtype=np.dtype(packed["type"]).newbyteorder("<"))
    return values.reshape(packed["shape"]).astype(np.float64) * packed["step"]
