"""Triangles on a grid of samples as a compiled loop.

A refinement does not need it, so `tso compile` does not make it.
"""

from __future__ import annotations

import numpy as np

from .jit import kept_on_disk


@kept_on_disk
def cover(corners, faces, marks):  # type: ignore[no-untyped-def]
    """Set those of ``marks`` [H, W] (uint8) to 1 that lie in one of the triangles ``faces`` [F, 3].

    ``corners`` [V, 2] are columns and rows in ``marks``: the mark [r, c] lies at (c, r). A mark on
    an edge counts. Parts of triangles outside the grid are left out.
    """
    height, width = marks.shape
    for f in range(len(faces)):
        low, high = np.inf, -np.inf
        for k in range(3):
            low = min(low, corners[faces[f, k], 1])
            high = max(high, corners[faces[f, k], 1])
        first, last = max(np.ceil(low), 0.0), min(np.floor(high), height - 1.0)
        for row in range(int(first), int(last) + 1):
            left, right = np.inf, -np.inf
            for k in range(3):
                x, y = corners[faces[f, k], 0], corners[faces[f, k], 1]
                following = faces[f, (k + 1) % 3]
                dx, dy = corners[following, 0] - x, corners[following, 1] - y
                # An edge along the row has both ends on other edges.
                if dy != 0.0 and min(y, y + dy) <= row <= max(y, y + dy):
                    crossing = x + (row - y) * dx / dy
                    left, right = min(left, crossing), max(right, crossing)
            begin, end = max(np.ceil(left), 0.0), min(np.floor(right), width - 1.0)
            for column in range(int(begin), int(end) + 1):
                marks[row, column] = 1
