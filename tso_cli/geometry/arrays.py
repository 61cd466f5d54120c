"""Types that the rooms share: arrays, named by the type of their values, and a box of pixels."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]  # coordinates, distances, losses: all that the method computes with
Floats = NDArray[np.float32]  # masks and points of a data set, as they are stored
Pixels = NDArray[np.uint8]  # pictures
Bits = NDArray[np.bool_]  # yes or no for each pixel or point
Indices = NDArray[np.int64]  # indices of points, vertices or triangles

# Left, top, right and bottom edges in pixel coordinates: the whole image is -0.5 to width - 0.5.
Box = tuple[float, float, float, float]
