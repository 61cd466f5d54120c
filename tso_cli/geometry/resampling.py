"""Exact area resampling of a box of an image, and how much of each new pixel the image covers.

Pixel coordinates are as in `camera`: the whole image spans -0.5 to width - 0.5.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from .arrays import Array, Bits, Box


def _overlaps(start: float, stop: float, cells: int, pixels: range, least: float = 0.0) -> Array:
    """The part of each cell that lies in each of the ``pixels``: [cells, pixels].

    The cells divide [start, stop] into ``cells`` equal parts. Cells that are narrower than
    ``least`` are widened to it about their centres; ``least`` = 1 gives linear interpolation.
    """
    edges = np.linspace(start, stop, cells + 1)
    widening = max(0.0, least - (stop - start) / cells) / 2.0
    centres = pixels.start + np.arange(len(pixels), dtype=np.float64)
    low = np.maximum(edges[:-1, None] - widening, centres - 0.5)
    high = np.minimum(edges[1:, None] + widening, centres + 0.5)
    return np.maximum(high - low, 0.0) / ((stop - start) / cells + 2.0 * widening)


def _touched(start: float, stop: float, pixels: int) -> range:
    """The pixels that [start, stop] meets."""
    first = int(np.clip(np.floor(start + 0.5), 0, pixels))
    return range(first, int(np.clip(np.ceil(stop + 0.5), first, pixels)))


def area_resize(
    array: NDArray[np.generic],
    box: Box,
    width: int,
    height: int,
    weights: NDArray[np.generic] | None = None,
    interpolate: bool = False,
) -> tuple[Array, Array]:
    """Resample the region ``box`` of ``array`` to ``width`` x ``height`` pixels by area averaging.

    Every new pixel is a cell of the box. Its value is the mean of the old pixels, weighted by
    their areas in the cell. The overlaps factor into rows and columns, so that the result is two
    matrix products, ``Ry @ array @ Rx^T``.

    Parameters
    ----------
    array : [H, W] or [H, W, C].
    box : left, top, right, bottom edges in pixel coordinates; it may reach outside the array.
    weights : [H, W] in [0, 1], how much each old pixel counts; all 1 if None.
    interpolate : average over at least one old pixel; in cells smaller than a pixel this is linear
        interpolation between pixels.

    Returns
    -------
    values : [height, width] or [height, width, C], mean over the covered part of each cell; 0 in
        cells that are not covered at all.
    coverage : [height, width] in [0, 1], the part of each cell that the array, times the weights,
        covers.

    Raises InputError if the box is empty or not finite.
    """
    array = np.asarray(array)
    left, top, right, bottom = (float(edge) for edge in box)
    if not (np.isfinite([left, top, right, bottom]).all() and right > left and bottom > top):
        raise InputError(f"box is {tuple(box)}, expected finite left < right and top < bottom")

    # A photo may have a hundred million pixels: only the touched part is converted to float64.
    rows, columns = _touched(top, bottom, array.shape[0]), _touched(left, right, array.shape[1])
    region = slice(rows.start, rows.stop), slice(columns.start, columns.stop)
    part = array[region].astype(np.float64)
    weight = None if weights is None else np.asarray(weights)[region].astype(np.float64)
    if weight is not None:
        part *= weight if part.ndim == 2 else weight[:, :, None]

    def overlaps(least: float) -> tuple[Array, Array, Array]:
        """Of the rows [height, H] and columns [width, W], and the weight of each cell."""
        by_row = _overlaps(top, bottom, height, rows, least)
        by_column = _overlaps(left, right, width, columns, least)
        if weight is None:
            return by_row, by_column, np.outer(by_row.sum(1), by_column.sum(1))
        return by_row, by_column, by_row @ weight @ by_column.T

    by_row, by_column, total_weight = overlaps(1.0 if interpolate else 0.0)
    # The coverage counts the cell itself, even if the mean is over a wider one.
    coverage = overlaps(0.0)[2] if interpolate else total_weight
    flat = by_row @ part.reshape(part.shape[0], -1)
    if part.ndim == 2:
        total = flat @ by_column.T
    else:
        total = by_column @ flat.reshape(height, *part.shape[1:])
        total_weight = total_weight[:, :, None]
    values = np.divide(total, total_weight, out=np.zeros_like(total), where=total_weight > 1e-12)
    return values, np.minimum(coverage, 1.0)


def nearest_resize(array: Array, box: Box, cells: int) -> Array:
    """``array`` [H, W] at the pixel nearest to each of ``cells`` x ``cells``, NaN beyond the image.

    This is for depth maps. Their means across an edge would lie in mid-air.
    """
    left, top, right, bottom = box
    centres = (np.arange(cells) + 0.5) / cells
    rows = np.floor(top + centres * (bottom - top) + 0.5).astype(int)
    columns = np.floor(left + centres * (right - left) + 0.5).astype(int)
    height, width = array.shape
    in_image = ((rows >= 0) & (rows < height))[:, None] & ((columns >= 0) & (columns < width))
    return np.where(
        in_image, array[rows.clip(0, height - 1)[:, None], columns.clip(0, width - 1)], np.nan
    )


def blurred(mask: Array, deviation: float) -> Array:
    """A mask [S, S] after a Gaussian blur; beyond its border it goes on as at the border."""
    reach = 2
    weights = np.exp(-0.5 * np.square(np.arange(-reach, reach + 1) / deviation))
    smooth: Array = np.pad(mask, reach, mode="edge")
    for axis in (0, 1):
        parts = np.lib.stride_tricks.sliding_window_view(smooth, len(weights), axis)
        smooth = parts @ (weights / weights.sum())
    return smooth


def nearest_cell(cells: Bits, within: int) -> NDArray[np.signedinteger]:
    """Flat index [H, W] of the nearest of ``cells`` [H, W].

    It is -1 where no cell is ``within`` this many rows and columns.
    """
    bits = cells.size.bit_length()
    # Squared distance and index in one integer, so that a minimum finds both.
    kind = np.int32 if (2 * within**2).bit_length() + bits < 30 else np.int64
    none = np.iinfo(kind).max // 2
    least = np.full(cells.shape, none, dtype=kind)
    least[cells] = np.flatnonzero(cells)
    for _ in range(2):
        least = np.ascontiguousarray(least.T)
        start = least.copy()
        for step in range(1, within + 1):
            farther = start + kind(step * step << bits)
            np.minimum(least[step:], farther[:-step], out=least[step:])
            np.minimum(least[:-step], farther[step:], out=least[:-step])
    return np.where(least < none, least & ((1 << bits) - 1), -1)


def distance_to_nearest(cells: Bits, within: int) -> Array:
    """The distance [H, W] of each cell to the nearest of ``cells`` [H, W], in cells.

    It is infinite where none is ``within`` this many rows and columns.
    """
    index = nearest_cell(cells, within)
    row, column = np.indices(cells.shape)
    nearest_row, nearest_column = np.divmod(index, cells.shape[1])
    distance = np.hypot(nearest_row - row, nearest_column - column)
    return np.where(index < 0, np.inf, distance)
