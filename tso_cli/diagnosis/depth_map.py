"""What a depth map holds: depth along z, or something else that is called depth, and noise.

The foremost surface of the cloud decides. The cloud may be of another shape and a little out of
place, so only what is clear is named. Figures are of right maps in 2,100 views of training and
validation shapes, with right, near and other starts and fields of view of 28 to 90 degrees.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np

from ..geometry.arrays import Array, Bits
from ..geometry.depth_kind import FITTED
from ..geometry.points import longest_side
from ..geometry.view import View
from ..losses.projection import pixels_under
from .findings import Finding

Contents = Literal["z", "inverse", "affine", "ray", "unit", "unrelated"]
# Blocks along the longer side of the mask. The foremost point of each counts.
BLOCKS = 20
# With fewer blocks only another unit is named. So it is with less relief of the cloud, in its
# longest sides, apart from distance along the ray.
FEWEST_BLOCKS, LEAST_RELIEF = 24, 0.15
# Right maps are 0.57 to 1.62 times the cloud's depths.
OTHER_UNIT = 2.0
# The rank correlation of right maps with the cloud is at least -0.57.
INVERSE = -0.7
# A map is of a kind only if it is related to the cloud at all.
RELATED = 0.3
# One of 1,456 right maps has more relief, in that of the cloud.
MOST_RELIEF = 2.5
# Read as distance along the ray, right maps are off the cloud by at least 0.59 of what they are off
# along z.
RAY = 0.5
# A dense map that is known on less of the mask is of another picture. In a dense map most known
# pixels have a known neighbour.
LEAST_COVERED, DENSE = 0.6, 0.8
# Of the robust line: how often its weights are found, and its scale in median distances.
ROUNDS, ROBUST = 30, 1.5
# The median size of a normal variable, in its deviations.
MEDIAN_OF_NORMAL = 0.6745
# Fewer second differences say nothing of the noise.
FEWEST_DIFFERENCES = 24
# A pixel is averaged with those up to this many away. Farther ones are often of another surface, as
# are depths that are this many deviations of the noise away.
REACH, ANOTHER_SURFACE = 2, 2.0


@dataclass(frozen=True, eq=False)
class SeenSurface:
    """The foremost surface of a cloud where a map is known: [B] numbers, one for each block.

    values : of the map. depth : of the cloud, along z. ray : as `Camera.ray_lengths`.
    size : longest side of the cloud. covered : share of the mask on which a dense map is known.
    """

    values: Array
    depth: Array
    ray: Array
    size: float
    covered: float

    @classmethod
    def of(cls, points: Array, view: View) -> SeenSurface:
        """Of ``points`` [N, 3], as a ``view`` with a depth map sees them."""
        from scipy.ndimage import binary_erosion

        assert view.depth is not None
        px, depth = view.camera.project(points)
        height, width = view.mask.shape
        pixel, within = pixels_under(px, depth > 0.0, height, width)
        (row, column), depth = np.divmod(pixel[within], width), depth[within]
        left, top, right, bottom = view.box()
        block = max(1, round(max(right - left, bottom - top) / BLOCKS))
        # The border of a map mixes the depths of the object and of what is behind it.
        interior = binary_erosion(view.inside, iterations=max(1, block // 3))
        known = (interior & np.isfinite(view.depth))[row, column]
        column, row, depth = column[known], row[known], depth[known]
        key = (row // block) * width + column // block
        order = np.lexsort((depth, key))
        first = order[np.flatnonzero(np.diff(key[order], prepend=-1))]
        column, row = column[first], row[first]
        ray = view.camera.ray_lengths(row, column)
        return cls(view.depth[row, column], depth[first], ray, longest_side(points), _covered(view))

    @cached_property
    def rank(self) -> float:
        """Spearman's rank correlation of map and cloud; 0 where one of them is constant."""
        ranks = [_ranks(self.values), _ranks(self.depth)]
        norm = np.prod([np.linalg.norm(rank) for rank in ranks])
        return float(ranks[0] @ ranks[1] / norm) if norm else 0.0

    @cached_property
    def times(self) -> float:
        """How many times the cloud's depths the map's values are."""
        return float(np.median(self.values / self.depth))

    @property
    def apart(self) -> float:
        """How much farther than the cloud the map is, in longest sides of the cloud."""
        return float(np.median(self.values - self.depth)) / self.size

    @property
    def relief(self) -> float:
        """Of the map, brought to the cloud's unit, relative to that of the cloud."""
        return _spread(self.values) / _spread(self.depth) / self.times

    @property
    def flat(self) -> bool:
        """Whether the cloud is: then its depths say nothing of what the map holds."""
        return _spread(self.depth) < LEAST_RELIEF * self.size

    def off(self, depth: Array) -> Array:
        """[2], how far ``depth`` [B] is off the cloud, and how far without a common shift.

        The medians, in longest sides.
        """
        error = depth - self.depth
        return np.median(np.abs([error, error - np.median(error)]), axis=1) / self.size

    def contents(self, any_size: bool = False) -> Contents:
        """What the map holds; "z" where nothing else is clear.

        ``any_size`` : the size of the cloud is not known, and so neither is the unit.
        """
        if self.covered < LEAST_COVERED:
            return "unrelated"
        in_unit = any_size or not len(self.depth) or 1.0 / OTHER_UNIT < self.times < OTHER_UNIT
        few = len(self.depth) < FEWEST_BLOCKS
        if not few and not self.flat:
            if self.rank < (INVERSE if in_unit else -RELATED):
                return "inverse"
            related = self.rank > RELATED
            least = 0.0 if in_unit else 1.0 / MOST_RELIEF
            if not least < self.relief < MOST_RELIEF:
                return "affine" if related else "unrelated"
            if not related and not in_unit:
                return "unrelated"
        if not in_unit:
            return "unit"
        if few or any_size:
            return "z"
        nearer = self.off(self.values / self.ray) < RAY * self.off(self.values)
        return "ray" if nearer.all() else "z"

    @property
    def figures(self) -> dict[str, float]:
        """What a finding says."""
        if not len(self.depth):
            return {"rank": 0.0, "covered": self.covered}
        off, of_ray = (self.off(depth)[0] for depth in (self.values, self.values / self.ray))
        relief = 0.0 if self.flat else self.relief
        return {
            "rank": self.rank, "covered": self.covered, "times": self.times, "relief": relief,
            "off": float(off), "of_ray": float(of_ray),
        }  # fmt: skip


def wrong_maps(points: Array, views: Sequence[View], any_size: bool = False) -> list[Finding]:
    """The maps of kind "auto" that hold something else than depth along z.

    ``points`` [N, 3] are those of a cloud in its place; ``any_size`` as in `SeenSurface.contents`.
    """
    findings = []
    for number, view in enumerate(views):
        if view.depth is not None and view.depth_kind == "auto":
            surface = SeenSurface.of(points, view)
            if (contents := surface.contents(any_size)) != "z":
                findings.append(Finding(f"depth-{contents}", (number,), values=surface.figures))
    return findings


def _covered(view: View) -> float:
    """1 where the map is sparse."""
    assert view.depth is not None
    known = np.isfinite(view.depth)
    pairs = np.count_nonzero(known[:, 1:] & known[:, :-1])
    if pairs < DENSE * np.count_nonzero(known):
        return 1.0
    return np.count_nonzero(known & view.inside) / np.count_nonzero(view.inside)


def _ranks(values: Array) -> Array:
    """About their mean; equal values have equal ranks."""
    _, place, counts = np.unique(values, return_inverse=True, return_counts=True)
    ranks = (np.cumsum(counts) - counts / 2.0)[place]
    return np.asarray(ranks - len(values) / 2.0)


def _spread(values: Array) -> float:
    low, high = np.quantile(values, [0.1, 0.9])
    return float(high - low)


def along_z(view: View) -> View:
    """The view with distances along the ray brought to depth along z."""
    if view.depth is None or view.depth_kind != "ray":
        return view
    row, column = np.ogrid[: view.depth.shape[0], : view.depth.shape[1]]
    return replace(view, depth=view.depth / view.camera.ray_lengths(row, column), depth_kind="z")


def fitted(points: Array, views: Sequence[View]) -> tuple[list[View], list[Finding]]:
    """The views with the maps that are known up to two numbers fitted, and what is noted.

    ``points`` [N, 3] are those of a cloud in its place. A map that cannot be fitted is left out.
    """
    rows = [_fitted(points, view, number) for number, view in enumerate(views)]
    return [view for view, _ in rows], [finding for _, finding in rows if finding]


def _fitted(points: Array, view: View, number: int) -> tuple[View, Finding | None]:
    kind, depth = view.depth_kind, view.depth
    if depth is None or kind not in FITTED:
        return view, None
    surface = SeenSurface.of(points, view)
    power, what = (-1.0, "1 / depth") if kind == "inverse" else (1.0, "depth")
    values: dict[str, float | str] = {"kind": kind, "what": what}
    values |= {"rank": surface.rank, "places": len(surface.depth)}
    unfitted = without_depth(view), Finding("depth-unfitted", (number,), values=values)
    if len(surface.depth) < FEWEST_BLOCKS or power * surface.rank < RELATED:
        return unfitted
    scale, shift = line(surface.values, surface.depth**power)
    powers = scale * depth + shift
    depth = np.where(powers > 0.0, powers, np.nan) ** power
    # Far from the cloud, small errors of the two numbers count for much.
    near, far = surface.depth.min() - surface.size, surface.depth.max() + surface.size
    depth = np.where((depth > near) & (depth < far), depth, np.nan)
    if scale <= 0.0 or not np.isfinite(depth[view.inside]).any():
        return unfitted
    finding = Finding("depth-fitted", (number,), values=values | {"scale": scale, "shift": shift})
    return replace(view, depth=depth, depth_kind="z", depth_fitted=True), finding


def without_depth(view: View) -> View:
    """The view with its mask alone."""
    return replace(view, depth=None, depth_kind="auto")


def line(x: Array, y: Array) -> tuple[float, float]:
    """Slope and intercept of ``y`` [B] by ``x`` [B], robust to pairs that do not belong together.

    Least squares, weighed again in each round with the weights of Geman and McClure.
    """
    weight = np.ones(len(x))
    for _ in range(ROUNDS):
        about_x, about_y = x - weight @ x / weight.sum(), y - weight @ y / weight.sum()
        slope = (weight * about_x) @ about_y / ((weight * about_x) @ about_x)
        error = np.abs(about_y - slope * about_x)
        scale = ROBUST * np.median(error)
        if scale == 0.0:
            break
        weight = 1.0 / np.square(1.0 + np.square(error / scale))
    return float(slope), float(weight @ (y - slope * x) / weight.sum())


def without_noise(views: Sequence[View]) -> tuple[list[View], list[Finding]]:
    """The views with the depth maps smoothed whose noise is deeper than a pixel is wide."""
    rows = [_without_noise(view, number) for number, view in enumerate(views)]
    return [view for view, _ in rows], [finding for _, finding in rows if finding]


def _without_noise(view: View, number: int) -> tuple[View, Finding | None]:
    if view.depth is None:
        return view, None
    known = view.inside & np.isfinite(view.depth)
    # In a large picture most pixels are around the object.
    rows, columns = (np.flatnonzero(known.any(axis))[[0, -1]] + [0, 1] for axis in (1, 0))
    box = slice(*rows), slice(*columns)
    depth, known = view.depth[box], known[box]
    deviation = noise(depth, known)
    # The maps of some kinds have a unit of their own. An object is about as deep as it is wide.
    if deviation <= _spread(depth[known]) / np.subtract(view.box()[2:], view.box()[:2]).max():
        return view, None
    for axis in (0, 1):
        depth = _averaged(depth, known, axis, deviation)
    smoothed = view.depth.copy()
    smoothed[box] = depth
    finding = Finding("depth-noisy", (number,), values={"deviation": deviation})
    return replace(view, depth=smoothed), finding


def noise(depth: Array, known: Bits) -> float:
    """The standard deviation of noise that is independent from pixel to pixel.

    It is the median size of the second differences along rows and columns where ``depth`` [H, W] is
    ``known``, over that of normal noise. A smooth surface has hardly any, and edges are few.
    """
    values, sizes = np.where(known, depth, np.nan), []
    for part in (values, values.T):
        second = part[1:-1] - (part[:-2] + part[2:]) / 2.0
        sizes.append(np.abs(second[np.isfinite(second)]))
    joined = np.concatenate(sizes)
    if len(joined) < FEWEST_DIFFERENCES:
        return 0.0
    return float(np.median(joined) / (MEDIAN_OF_NORMAL * np.sqrt(1.5)))


def _averaged(depth: Array, known: Bits, axis: int, deviation: float) -> Array:
    """Each known pixel is the mean of those along the axis, by how near their depths are.

    A bilateral filter (Tomasi and Manduchi, 1998) with a box in space.
    """
    length, padding = depth.shape[axis], [(0, 0), (0, 0)]
    padding[axis] = REACH, REACH
    padded = np.pad(np.where(known, depth, np.inf), padding, constant_values=np.inf)
    here, total, weights = np.where(known, depth, 0.0), np.zeros(depth.shape), np.zeros(depth.shape)
    for start in range(2 * REACH + 1):
        other = padded.take(range(start, start + length), axis)
        weight = np.exp(-0.5 * np.square((other - here) / (ANOTHER_SURFACE * deviation)))
        total += weight * np.where(np.isfinite(other), other, 0.0)
        weights += weight
    return np.where(known, total / np.where(known, weights, 1.0), depth)
