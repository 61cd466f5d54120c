"""Types that the rooms share: arrays, named by the type of their values, and a box of pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from ..errors import InputError

Array = NDArray[np.float64]  # coordinates, distances, losses: all that the method computes with
Floats = NDArray[np.float32]  # masks and points of a data set, as they are stored
Pixels = NDArray[np.uint8]  # pictures
Bits = NDArray[np.bool_]  # yes or no for each pixel or point
Indices = NDArray[np.int64]  # indices of points, vertices or triangles

# Left, top, right and bottom edges in pixel coordinates: the whole image is -0.5 to width - 0.5.
Box = tuple[float, float, float, float]

# Squares of larger numbers, and their sums, would not be finite.
LARGEST = 1e152


def as_numpy(values: Any) -> Any:
    """A tensor as an array; anything else as it is. torch is not imported for this."""
    if not hasattr(values, "detach"):
        return values
    tensor = values.detach().cpu()
    return (tensor.float() if "bfloat16" in str(tensor.dtype) else tensor).numpy()


def as_numbers(values: Any, name: str, dtype: DTypeLike = np.float64) -> NDArray[Any]:
    """``values`` as an array of ``dtype``, not copied if they are one.

    Raises InputError, which begins with ``name``, unless they are real numbers in equal rows. What
    is too large for ``dtype`` becomes infinite.
    """
    try:
        array = np.asarray(as_numpy(values))
        if array.dtype.kind not in "biufO":
            raise TypeError
        with np.errstate(over="ignore", invalid="ignore"):
            return array.astype(dtype, copy=False)
    except (OverflowError, TypeError, ValueError):
        raise InputError(
            f"{name} is not an array of real numbers, expected one whose rows are equally long"
        ) from None
