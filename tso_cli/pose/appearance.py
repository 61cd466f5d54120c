"""How well a coloured cloud agrees with the photo of a view, at each of several placements.

A mask often cannot tell the front of a car from its back; its photo can.
"""

from __future__ import annotations

import numpy as np

from ..geometry.arrays import Array, Bits, Floats
from ..geometry.resampling import area_resize
from ..geometry.view import View
from .placement import Placements
from .target import MARGIN, Target, square_around

# Cells along the square. In finer grids points on the far side show through the gaps of clouds of
# 1,000 points; in coarser ones small paint, as the lights of a car, is averaged away.
LARGEST_SIDE, LEAST_SIDE = 40, 12
# Points for each cell of the object, about half of them on its near side: with one or fewer there,
# the near side has gaps. The grid is as coarse as that asks.
POINTS_PER_CELL = 4.0
# Pixels across a cell that count; more of a large photo only take time.
PIXELS_ACROSS = 6
# A point is hidden if it lies more than this many widths of a cell behind the front point of its
# cell. Less hides parts of slanted surfaces, more shows the far side of thin parts.
STEEPEST = 3.5
# Cells that the mask covers less than this mix the object with its surroundings.
LEAST_COVERED = 0.25
# Added to colours in [0, 1] before their logarithms: noise and black paint then do not dominate.
BLACK = 0.05
# Weight of the square of brightness, relative to that of colour: light changes brightness by half,
# and colour by little.
BRIGHTNESS = 0.2
# Brightness counts without a blur of this standard deviation, in sides of the square: light changes
# slowly across an object, and paint changes fast.
SHADING = 0.125
# Variance of logarithms of colours that noise and the light of the surroundings make by themselves.
NOISE = 1e-3
# Correlations of this many cells count half. Neighbouring cells are alike, and so few cells agree
# by chance.
FEW_CELLS = 50.0
# The better of two placements that differ by this much in appearance, and itself agrees this much,
# is the right one: so in 199 of 200 rendered scenes with a wrong placement that fits the mask alike
# and such a difference. Of clouds painted like another object 90 % agree less.
DECISIVE, AGREES = 0.1, 0.25


def appearance(points: Array, colours: Array, placements: Placements, view: View) -> Array:
    """Agreement [P] of the coloured cloud with the photo inside the mask, from -1 to 1.

    It is the correlation of the logarithms of the colours of both, over cells that the cloud covers
    where it is visible. Exposure and white balance drop out, and slow changes of brightness, as
    light makes them. 0 says nothing: the cloud or the photo has one colour, few cells are covered,
    or there is no photo.

    ``points`` [N, 3] have longest side 1 and their centre at the origin; ``colours`` [N, 3] are in
    [0, 1].
    """
    if view.image is None:
        return np.zeros(len(placements))
    photo, share = _photo(view, view.image, _side(view, len(points)))
    camera = view.camera.cropped(square_around(view), *share.shape)
    target = Target(share, share > 0.0, camera, view.truncated, pixel=1.0)
    cloud, covered = _drawn(points, colours, placements, target)
    weight = covered * share
    return _correlation(_parts(cloud, weight), _parts(photo[None], weight), weight)


def decides(better: float, worse: float) -> bool:
    """Whether the photo shows that the placement of the ``better`` appearance is the right one.

    Where it does not, only the masks can order the two.
    """
    return bool(better >= AGREES and better - worse > DECISIVE)


def _side(view: View, count: int) -> int:
    """Cells along the square, so that ``count`` points leave few cells of the object empty."""
    left, top, right, bottom = view.box()
    square = (max(right - left, bottom - top) * MARGIN) ** 2
    cells = count / POINTS_PER_CELL * square / max(int(view.inside.sum()), 1)
    return int(np.clip(np.sqrt(cells), LEAST_SIDE, LARGEST_SIDE))


def _photo(view: View, image: Floats, side: int) -> tuple[Array, Array]:
    """Mean colour [S, S, 3] of the object in each cell; how much of the cell it covers [S, S]."""
    left, top, right, bottom = square_around(view)
    step = max(1, int((right - left) / side / PIXELS_ACROSS))
    box = (left / step, top / step, right / step, bottom / step)
    grid = np.s_[::step, ::step]
    colour, covered = area_resize(image[grid], box, side, side, weights=view.inside[grid])
    return colour, covered * (covered > LEAST_COVERED)


def _drawn(
    points: Array, colours: Array, placements: Placements, target: Target
) -> tuple[Array, Bits]:
    """Mean colour [P, S, S, 3] of the visible points of each cell; which cells have any."""
    count, side, camera = len(placements), target.side, target.camera
    projected = target.project(points, placements)
    row, column, within = target.at(projected.px)
    cell = (np.arange(count)[:, None] * side + row) * side + column
    front = np.full(count * side * side, np.inf)
    np.minimum.at(front, cell[within], projected.depth[within])
    width = 1.0 / (projected.inverse * placements.focal[:, None] * camera.K[0, 0])
    visible = within & (projected.depth <= front[cell] + STEEPEST * width)
    cell, painted = cell[visible], np.broadcast_to(colours, (*visible.shape, 3))[visible]
    hits = np.bincount(cell, minlength=len(front))
    total = np.stack([np.bincount(cell, channel, len(front)) for channel in painted.T], -1)
    mean = total / np.maximum(hits, 1)[:, None]
    return mean.reshape(count, side, side, 3), hits.reshape(count, side, side) > 0


def _parts(colour: Array, weight: Array) -> Array:
    """Detail of brightness, and two parts of colour, of ``colour`` [P or 1, S, S, 3]: [3, P, C].

    They are logarithms: a factor of each channel is a summand of each part.
    """
    red, green, blue = np.moveaxis(np.log(colour + BLACK), -1, 0)
    brightness = np.broadcast_to((red + green + blue) / 3.0, weight.shape)
    detail = np.sqrt(BRIGHTNESS) * (brightness - _blurred(brightness, weight))
    parts = (detail, red - green, (red + green) / 2.0 - blue)
    return np.stack(
        [np.broadcast_to(part, weight.shape).reshape(len(weight), -1) for part in parts]
    )


def _blurred(values: Array, weight: Array) -> Array:
    """Gaussian blur of ``values`` [P, S, S] over cells of positive ``weight``."""
    from scipy.ndimage import gaussian_filter

    deviation = SHADING * weight.shape[-1]
    total, of = (
        gaussian_filter(part, (0.0, deviation, deviation), mode="constant")
        for part in (values * weight, weight)
    )
    blurred: Array = np.divide(total, of, out=np.zeros_like(total), where=of > 0.0)
    return blurred


def _correlation(first: Array, second: Array, weight: Array) -> Array:
    """Correlation [P] of parts [3, P, C] about their means over cells, shrunk to 0 by noise."""
    weight = weight.reshape(len(weight), -1)
    cells = weight.sum(1)
    share = weight / np.maximum(cells, 1e-9)[:, None]
    first, second = (part - (share * part).sum(2, keepdims=True) for part in (first, second))
    squares = [(share * np.square(part)).sum((0, 2)) + NOISE for part in (first, second)]
    shrunk = cells / (cells + FEW_CELLS)
    agreement: Array = shrunk * (share * first * second).sum((0, 2))
    return agreement / np.sqrt(squares[0] * squares[1])
