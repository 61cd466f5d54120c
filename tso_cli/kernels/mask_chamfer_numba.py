"""The mask Chamfer loss of a cloud by one view as a compiled loop.

Its reference is `tso_cli.losses.mask_chamfer`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .jit import compiled
from .nearest_numba import cell_edge, nearest_in_cells, nearest_marked, sort_into_cells


class CompiledView(NamedTuple):
    """A view as the loop takes it; fields are named as in `MaskTarget` and `Camera`.

    ``near`` is the least depth of a visible point, minus infinity for an orthographic camera.
    ``within`` is the distance, px, at which a point covers a pixel.
    """

    K: NDArray[np.float64]
    R: NDArray[np.float64]
    t: NDArray[np.float64]
    near: float
    inside: NDArray[np.bool_]
    outside: NDArray[np.bool_]
    nearest_in_column: NDArray[np.int64]
    bounds: NDArray[np.float64]
    truncated: bool
    within: float
    scale: float
    reference_points: float


def mask_chamfer(
    points: NDArray[np.float64],
    view: CompiledView,
) -> tuple[float, NDArray[np.float64]]:
    """The loss of ``points`` [N, 3], infinite if none is observed; its gradient [N, 3] by them."""
    height, width = view.inside.shape
    edge = cell_edge(height, width, len(points))
    found: tuple[float, NDArray[np.float64]] = _mask_chamfer(points, *view, edge)
    return found


@compiled
def _mask_chamfer(  # type: ignore[no-untyped-def]
    points, K, R, t, near, inside, outside, nearest_row, bounds, truncated, within, scale,
    reference, edge,
):  # fmt: skip
    count, (height, width) = len(points), inside.shape
    left, top, right, bottom = bounds[0], bounds[1], bounds[2], bounds[3]
    pixels, by_pixels, plane = np.empty((count, 2)), np.zeros((count, 2)), np.zeros((count, 3))
    valid, observed = np.zeros(count, np.bool_), np.zeros(count, np.bool_)
    loss, any_observed, gradient = 0.0, False, np.zeros((count, 3))
    for n in range(count):
        x = R[0, 0] * points[n, 0] + R[0, 1] * points[n, 1] + R[0, 2] * points[n, 2] + t[0]
        y = R[1, 0] * points[n, 0] + R[1, 1] * points[n, 1] + R[1, 2] * points[n, 2] + t[1]
        z = R[2, 0] * points[n, 0] + R[2, 1] * points[n, 1] + R[2, 2] * points[n, 2] + t[2]
        valid[n] = z > near
        inverse = 1.0 if near == -np.inf else (1.0 / z if valid[n] else 0.0)
        plane[n, 0], plane[n, 1], plane[n, 2] = x * inverse, y * inverse, inverse
        pixels[n, 0] = K[0, 0] * plane[n, 0] + K[0, 1] * plane[n, 1] + K[0, 2]
        pixels[n, 1] = K[1, 1] * plane[n, 1] + K[1, 2]
        in_image = (
            pixels[n, 0] >= left
            and pixels[n, 0] <= right
            and pixels[n, 1] >= top
            and pixels[n, 1] <= bottom
        )
        observed[n] = valid[n] and (in_image or not truncated)
        any_observed |= observed[n]
    if not any_observed:
        return np.inf, gradient
    area = scale * scale
    # Each point tries the few pixels around it. Most pixels find their nearest point in this way.
    reach = max(1, int(edge / 2.0))
    margin = 2 * reach + 1
    least = np.full((height + 2 * margin, width + 2 * margin), (reach + 0.5) ** 2)
    owner = np.full(least.shape, -1, np.int64)
    for n in range(count):
        x, y = pixels[n, 0], pixels[n, 1]
        # Points far outside the image are left out: their numbers would not fit an integer.
        if (
            valid[n]
            and x > -reach - 1
            and x < width + reach
            and y > -reach - 1
            and y < height + reach
        ):
            row, column = int(np.rint(y)), int(np.rint(x))
            for i in range(row - reach, row + reach + 1):
                for j in range(column - reach, column + reach + 1):
                    squared = (x - j) * (x - j) + (y - i) * (y - i)
                    if squared < least[i + margin, j + margin]:
                        least[i + margin, j + margin], owner[i + margin, j + margin] = squared, n
    cells = sort_into_cells(pixels, valid, height, width, edge)
    begin, order = cells[2], cells[5]
    place, above = 0, np.zeros(width, np.int64)
    for i in range(height):
        for j in range(width):
            n = owner[i + margin, j + margin]
            if not inside[i, j] or (n >= 0 and least[i + margin, j + margin] <= within * within):
                continue
            if n < 0 and begin[-1]:
                place = nearest_in_cells(float(j), float(i), edge, cells, place, above[j])
                above[j], n = place, order[place]
            if n < 0 or not observed[n]:
                continue
            by_x, by_y = pixels[n, 0] - j, pixels[n, 1] - i
            squared = by_x * by_x + by_y * by_y
            if squared > within * within:
                loss += squared * area * area
                by_pixels[n, 0] += 2.0 * area * area * by_x
                by_pixels[n, 1] += 2.0 * area * area * by_y
    share = reference / count * area
    for n in range(count):
        x, y = pixels[n, 0], pixels[n, 1]
        # A pixel outside the image is unknown, not background.
        if observed[n] and x >= left and x <= right and y >= top and y <= bottom:
            # The image beyond the mask's part of it is as the nearest pixel of this part.
            i = int(np.rint(min(max(y, 0.0), height - 1.0)))
            j = int(np.rint(min(max(x, 0.0), width - 1.0)))
            if outside[i, j]:
                row, column = nearest_marked(i, j, nearest_row)
                by_x, by_y = x - column, y - row
                loss += share * (by_x * by_x + by_y * by_y)
                by_pixels[n, 0] += 2.0 * share * by_x
                by_pixels[n, 1] += 2.0 * share * by_y
        u, v = by_pixels[n, 0], by_pixels[n, 1]
        if u != 0.0 or v != 0.0:
            by_x, by_y = K[0, 0] * u * plane[n, 2], (K[0, 1] * u + K[1, 1] * v) * plane[n, 2]
            by_z = 0.0 if near == -np.inf else -(by_x * plane[n, 0] + by_y * plane[n, 1])
            for axis in range(3):
                gradient[n, axis] = R[0, axis] * by_x + R[1, axis] * by_y + R[2, axis] * by_z
    return loss, gradient
