"""Masks as people have them: foreground that is not the object, and object that is not foreground.

A trouble changes a mask [H, W] of an object, by numbers relative to its extent in the mask.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter

from ...geometry.arrays import Array, Bits

Rng = np.random.Generator
# An addition or a loss of under this share of the object is no trouble, and one of over the second
# leaves no object. Foreign things are at most this many times as large.
LEAST, MOST, MOST_FOREIGN = 0.015, 0.6, 2.0
DRAWS = 20  # of a trouble, until it is neither too small nor too large


@dataclass(frozen=True, eq=False)
class Marred:
    """A mask after a trouble.

    given : [H, W], the mask. foreign : [H, W], foreground that is not the object.
    hidden : [H, W], object that is not foreground. trouble : its name, "" for none.
    """

    given: Bits
    foreign: Bits
    hidden: Bits
    trouble: str = ""

    @classmethod
    def none(cls, mask: Bits) -> Marred:
        """The ``mask`` as it is."""
        nothing = np.zeros_like(mask)
        return cls(mask, nothing, nothing)


def marred(mask: Bits, trouble: str, rng: Rng, other: Bits | None = None) -> Marred | None:
    """The ``mask`` with a trouble; None if no draw of it is neither too small nor too large.

    other : the mask of a second object, for the trouble "object".
    """
    outline = trouble in OUTLINES
    for _ in range(DRAWS):
        if trouble == "object":
            if other is None:
                return None
            given = mask | _next_to(mask, other, rng)
        else:
            given = (OUTLINES if outline else PARTS)[trouble](mask, _Box.of(mask), rng)
        foreign, hidden = given & ~mask, mask & ~given
        share = (foreign.sum() + hidden.sum()) / mask.sum()
        if outline and given.any():
            none = np.zeros_like(mask)
            return Marred(given, none, none, trouble)
        if (
            share >= LEAST
            and hidden.sum() <= MOST * mask.sum()
            and foreign.sum() <= MOST_FOREIGN * mask.sum()
        ):
            return Marred(given, foreign, hidden, trouble)
    return None


@dataclass(frozen=True, eq=False)
class _Box:
    """The box of an object in a mask: middle [2] and half sides [2], columns first."""

    middle: Array
    half: Array
    grid: Array  # [2, H, W], columns and rows

    @classmethod
    def of(cls, mask: Bits) -> _Box:
        rows, columns = np.nonzero(mask)
        low = np.array([columns.min(), rows.min()], float)
        high = np.array([columns.max(), rows.max()], float)
        grid = np.stack(np.meshgrid(np.arange(mask.shape[1]), np.arange(mask.shape[0])))
        return cls((low + high) / 2.0, (high - low + 1.0) / 2.0, grid.astype(float))

    @property
    def size(self) -> float:
        return 2.0 * float(self.half.max())

    def place(self, rng: Rng, mask: Bits) -> Array:
        """A random place of the object, column and row."""
        rows, columns = np.nonzero(mask)
        number = rng.integers(len(rows))
        return np.array([columns[number], rows[number]], float)

    def from_place(self, place: Array) -> Array:
        """[2, H, W]."""
        return self.grid - place[:, None, None]


def _strip(box: _Box, start: Array, end: Array, width: Array) -> Bits:
    """Cells within half of ``width`` (at start and end) of a segment."""
    along = end - start
    length = float(along @ along) or 1.0
    offset = box.from_place(start)
    share = np.clip(np.einsum("c,chw->hw", along, offset) / length, 0.0, 1.0)
    apart = np.hypot(*(offset - along[:, None, None] * share))
    return np.asarray(apart <= (width[0] + (width[1] - width[0]) * share) / 2.0)


def _direction(rng: Rng) -> Array:
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return np.array([np.cos(angle), np.sin(angle)])


# Foreground that is not the object.


def _arm(mask: Bits, box: _Box, rng: Rng) -> Bits:
    """From a place of the object outward, with a hand or finger ends."""
    start = box.place(rng, mask)
    end = start + box.size * rng.uniform(0.6, 1.6) * _direction(rng)
    width = box.size * rng.uniform(0.06, 0.22) * np.array([rng.uniform(0.7, 1.3), 1.0])
    given = mask | _strip(box, start, end, width)
    for _ in range(rng.integers(0, 5)):
        tip = start + box.size * rng.uniform(0.05, 0.2) * _direction(rng)
        given |= _strip(box, start, tip, width * 0.3)
    return given


def _stand(mask: Bits, box: _Box, rng: Rng) -> Bits:
    """A post below the object, often with a foot."""
    column = box.middle[0] + box.half[0] * rng.uniform(-0.6, 0.6)
    top = np.array([column, box.middle[1] + box.half[1] * rng.uniform(0.0, 0.9)])
    foot = np.array([column, box.middle[1] + box.half[1] + box.size * rng.uniform(0.1, 0.5)])
    width = np.full(2, box.size * rng.uniform(0.04, 0.3))
    given = mask | _strip(box, top, foot, width)
    if rng.random() < 0.6:
        across = np.array([box.size * rng.uniform(0.1, 0.5), 0.0])
        given |= _strip(box, foot - across, foot + across, width * rng.uniform(0.3, 1.0))
    return given


def _shadow(mask: Bits, box: _Box, rng: Rng) -> Bits:
    """A flat ellipse at the lower end, or the silhouette sheared over the ground."""
    low = box.middle + [0.0, box.half[1] * rng.uniform(0.7, 1.0)]
    if rng.random() < 0.5:
        at = low + [box.half[0] * rng.uniform(-0.5, 0.8), 0.0]
        radii = box.half * [rng.uniform(0.6, 1.5), rng.uniform(0.08, 0.35)]
        offset = box.from_place(at) / radii[:, None, None]
        return mask | (np.square(offset).sum(0) <= 1.0)
    # A cell of the ground shows the part of the object whose shadow falls there.
    shear, flat = rng.uniform(-1.5, 1.5), rng.choice([-1.0, 1.0]) * rng.uniform(0.15, 0.6)
    right, down = box.from_place(low)
    up = down / flat
    columns = np.rint(low[0] + right - shear * np.abs(down)).astype(int)
    rows = np.rint(low[1] - np.abs(up)).astype(int)
    height, width = mask.shape
    seen = (columns >= 0) & (columns < width) & (rows >= 0) & (down * flat >= 0.0)
    return mask | (seen & mask[rows.clip(0, height - 1), columns.clip(0, width - 1)])


def _next_to(mask: Bits, other: Bits, rng: Rng) -> Bits:
    """Another object's mask, shifted so that both touch or overlap."""
    box, second = _Box.of(mask), _Box.of(other)
    toward = _direction(rng)
    reach = (box.half + second.half) * rng.uniform(0.6, 1.05)
    shift = np.rint(box.middle + toward * reach - second.middle).astype(int)
    rows, columns = np.nonzero(other)
    rows, columns = rows + shift[1], columns + shift[0]
    kept = (rows >= 0) & (rows < mask.shape[0]) & (columns >= 0) & (columns < mask.shape[1])
    found = np.zeros_like(mask)
    found[rows[kept], columns[kept]] = True
    return found


def _blob(mask: Bits, box: _Box, rng: Rng) -> Bits:
    """Background that a segmenter took along: the smooth part of noise, at the outline."""
    noise = gaussian_filter(rng.standard_normal(mask.shape), box.size * rng.uniform(0.05, 0.15))
    near = np.hypot(*box.from_place(box.place(rng, mask))) < box.size * rng.uniform(0.15, 0.5)
    return mask | (near & (noise > 0.0))


# Object that is not foreground.


def _bite(mask: Bits, box: _Box, rng: Rng) -> Bits:
    radii = box.size * rng.uniform(0.08, 0.35, 2)
    offset = box.from_place(box.place(rng, mask)) / radii[:, None, None]
    return mask & (np.square(offset).sum(0) > 1.0)


def _bar(mask: Bits, box: _Box, rng: Rng) -> Bits:
    """Something straight in front."""
    place, along = box.place(rng, mask), 2.0 * box.size * _direction(rng)
    return mask & ~_strip(
        box, place - along, place + along, np.full(2, box.size * rng.uniform(0.03, 0.2))
    )


def _end(mask: Bits, box: _Box, rng: Rng) -> Bits:
    """What lies beyond a line is hidden."""
    along = np.einsum("c,chw->hw", _direction(rng), box.grid)
    return mask & (along <= np.quantile(along[mask], rng.uniform(0.6, 0.97)))


def _holes(mask: Bits, box: _Box, rng: Rng) -> Bits:
    noise = gaussian_filter(rng.standard_normal(mask.shape), box.size * rng.uniform(0.015, 0.06))
    return mask & (noise < np.quantile(noise[mask], rng.uniform(0.8, 0.98)))


# The outline: all of the foreground is the object's.


def _grown(mask: Bits, box: _Box, rng: Rng) -> Bits:
    return np.asarray(
        distance_transform_edt(~mask) <= max(1.0, box.size * rng.uniform(0.005, 0.04))
    )


def _shrunk(mask: Bits, box: _Box, rng: Rng) -> Bits:
    return np.asarray(distance_transform_edt(mask) > max(1.0, box.size * rng.uniform(0.005, 0.03)))


def _ragged(mask: Bits, box: _Box, rng: Rng) -> Bits:
    """An outline that a hand or a segmenter drew."""
    distance = distance_transform_edt(mask) - distance_transform_edt(~mask)
    noise = gaussian_filter(
        rng.standard_normal(mask.shape), max(0.7, box.size * rng.uniform(0.01, 0.06))
    )
    return np.asarray(
        distance + noise / noise.std() * max(0.7, box.size * rng.uniform(0.004, 0.02)) > 0.0
    )


def _smooth(mask: Bits, box: _Box, rng: Rng) -> Bits:
    """A mask of a smaller picture, enlarged: thin parts and corners are lost."""
    return np.asarray(
        gaussian_filter(mask.astype(float), max(0.8, box.size * rng.uniform(0.01, 0.04))) > 0.5
    )


Change = Callable[[Bits, _Box, Rng], Bits]
PARTS: dict[str, Change] = {
    "arm": _arm,
    "stand": _stand,
    "shadow": _shadow,
    "blob": _blob,
    "bite": _bite,
    "bar": _bar,
    "end": _end,
    "holes": _holes,
}
OUTLINES: dict[str, Change] = {
    "grown": _grown,
    "shrunk": _shrunk,
    "ragged": _ragged,
    "smooth": _smooth,
}
