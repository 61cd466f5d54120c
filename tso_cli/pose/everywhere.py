"""Placements of a cloud that fit its masks, searched in all directions, and their scores."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..geometry.arrays import Array, Floats, Indices
from ..geometry.points import farthest_point_sample
from ..geometry.rotations import angle_between, spread
from ..geometry.view import View
from .levenberg import Freedom, improve
from .misfit import NearestMisfit
from .placement import SHIFT, SIZE, UNKNOWNS, Placements
from .search import TELLS_PLACE, Comparison, search_from, some_views
from .target import Target

# Points of a cloud that are scored in the end. Larger clouds are thinned at random before farthest
# points are chosen, to save time.
SCORED_POINTS, THINNED_POINTS = 1024, 4096


@dataclass(frozen=True)
class _Stage:
    """One of the two searches by nearest neighbours: the faster one or the finer one."""

    side: int  # of the square, cells
    points: int  # of the cloud
    count: int  # most placements that are improved
    degrees: float  # a placement within this angle of a better one is dropped
    steps: int
    robust: float  # scale of distances, cells

    def improved(
        self,
        placements: Placements,
        score: Array,
        points: Array,
        targets: Sequence[Target],
        freedom: Freedom,
    ) -> Placements:
        """The distinct placements of the highest scores [P], drawn to the masks."""
        placements = placements[distinct(placements.R, score, self.degrees, self.count)]
        misfit = NearestMisfit(points[: self.points], targets, self.robust)
        return improve(placements, misfit, freedom, self.steps)[0]


COARSE = _Stage(side=32, points=256, count=48, degrees=20.0, steps=12, robust=6.0)
FINE = _Stage(side=64, points=512, count=16, degrees=10.0, steps=20, robust=4.0)
# Width in cells of the border around the square that collects the points outside.
BORDER = 2
# Viewing directions are 16 degrees apart, and in-plane rotations 20 degrees.
DIRECTIONS, TURNS = 150, 18
# Placements that are looked at together; it bounds the memory.
AT_ONCE = 600
# Because of perspective the box of a cloud is only roughly proportional to its size. Two
# corrections are enough.
CORRECTIONS = 2
# Weight of the place along a single ray, which several rays outweigh.
SINGLE_RAY = 1e-6
# The centre of the cloud.
CENTRE = np.zeros((1, 3))
# Views of the first search, at most: they tell directions apart, and cost time for each.
COARSE_VIEWS = 4
# Other poses of the end are this far apart, degrees.
APART = 20.0
# If none of the placements fits, this number of the best is searched around.
AROUND = 3
# Colours in [0, 1] that differ by this on average are of another side of the object.
REPAINTED = 0.1


@dataclass(frozen=True, eq=False)
class Poses:
    """Placements that fit, best first, none within 20 degrees of a better one.

    missed : [P], as `Comparison.missed`. iou : [P], `closed_iou`.
    """

    placements: Placements
    missed: Array
    iou: Array

    def __getitem__(self, rows: Indices) -> Poses:
        return Poses(self.placements[rows], self.missed[rows], self.iou[rows])


def search_everywhere(
    comparison: Comparison, points: Array, views: Sequence[View], freedom: Freedom
) -> Poses:
    """The placements that fit ``views``, from starts in all directions.

    1. 2,700 placements are scored by coarse silhouettes.
    2. The best 48 distinct ones are improved by distances between nearest neighbours.
    3. The best 16 of them are improved at twice the resolution, and then by their contours.

    ``comparison`` is of the cloud and the views. ``points`` [N, 3] are those of the cloud that
    `spread_indices` names.
    """
    coarse = tuple(Target.of(view, COARSE.side) for view in some_views(views, COARSE_VIEWS))
    placements, score = starts(points[: COARSE.points], coarse, freedom)
    placements = COARSE.improved(placements, score, points, coarse, freedom)
    score = closed_iou(points[: FINE.points], placements, coarse, spacing(points[: FINE.points]))
    by_cells = FINE.improved(placements, score, points, comparison.targets, freedom)
    by_cells = comparison.at_depth(by_cells, freedom)
    gap = spacing(points)
    placements, value = comparison.settled(by_cells, freedom)
    placements = placements[distinct(placements.R, -value, APART, len(placements))]
    if comparison.missed(placements[:1])[0] > TELLS_PLACE:
        # The best are searched from many starts around each.
        few = min(AROUND, len(placements))
        around = [search_from(comparison, freedom, placements[i : i + 1]) for i in range(few)]
        around.sort(key=lambda result: result.missed)
        placements = Placements.joined([*(result.placement for result in around), placements[few:]])
        if comparison.missed(placements[:1])[0] > TELLS_PLACE:
            # The contours of another shape do not tell where it is.
            iou = closed_iou(points, by_cells, comparison.targets, gap)
            placements = by_cells[distinct(by_cells.R, iou, APART, len(by_cells))]
    iou = closed_iou(points, placements, comparison.targets, gap)
    return Poses(placements, comparison.missed(placements), iou)


def starts(points: Array, targets: Sequence[Target], freedom: Freedom) -> tuple[Placements, Array]:
    """Placements in all rotations, and their scores (`coarse_iou`).

    With its place and size, the box of the projected ``points`` [N, 3] has the middle and the size
    of the mask's box in each view, as far as ``freedom`` lets it.
    """
    rotations = targets[0].camera.R.T @ spread(DIRECTIONS, TURNS)
    t = _meeting_point(targets)
    size = size_of_object(targets, t) if freedom.basis[SIZE].any() else 1.0
    batches, scores = [], []
    for R in (rotations[i : i + AT_ONCE] for i in range(0, len(rotations), AT_ONCE)):
        placements = Placements.at(R, np.tile(t, (len(R), 1)), np.full(len(R), size))
        for _ in range(CORRECTIONS):
            placements = _with_boxes(points, placements, targets, freedom)
        batches.append(placements)
        scores.append(coarse_iou(points, placements, targets))
    return Placements.joined(batches), np.concatenate(scores)


def _box(target: Target) -> tuple[Array, float]:
    """Middle [2] and size of the object's box, in cells."""
    low, high = target.cells.min(0) - 0.5, target.cells.max(0) + 0.5
    return (low + high) / 2.0, float(np.sqrt(np.prod(high - low)))


def _ray(target: Target) -> tuple[Array, Array]:
    """Where the ray through the middle of the mask begins [3], and its way to depth 1 [3]."""
    camera, (middle, _) = target.camera, _box(target)
    plane = np.linalg.solve(camera.K[:2, :2], middle - camera.K[:2, 2])
    if camera.model == "orthographic":
        return camera.R.T @ (np.append(plane, 0.0) - camera.t), camera.R[2]
    return camera.position, camera.R.T @ np.append(plane, 1.0)


def _meeting_point(targets: Sequence[Target]) -> Array:
    """Where the rays through the middles of the masks meet [3]."""
    normal, right = np.zeros((3, 3)), np.zeros(3)
    for target in targets:
        begin, ray = _ray(target)
        across = np.eye(3) - np.outer(ray, ray) / (ray @ ray)
        normal += across
        right += across @ begin
    # Along a single ray the cloud stands where its size fits.
    begin, ray = _ray(targets[0])
    fitting = begin + ray * targets[0].camera.K[0, 0] / _box(targets[0])[1]
    point: Array = np.linalg.solve(normal + SINGLE_RAY * np.eye(3), right + SINGLE_RAY * fitting)
    return point


def size_of_object(targets: Sequence[Target], at: Array | None = None) -> float:
    """About the longest side of the object that stands ``at`` a point, where the rays meet; 1 if it
    is behind a camera.
    """
    at = _meeting_point(targets) if at is None else at
    logs = []
    for target in targets:
        camera, depth = target.camera, 1.0
        if camera.model == "perspective":
            depth = float(camera.R[2] @ at + camera.t[2])
        if depth <= 0.0:
            return 1.0
        logs.append(np.log(_box(target)[1] * depth / camera.K[0, 0]))
    return float(np.exp(np.mean(logs)))


def _with_boxes(
    points: Array, placements: Placements, targets: Sequence[Target], freedom: Freedom
) -> Placements:
    """One Gauss-Newton step of place and size that fits the boxes of cloud and masks."""
    count = len(placements)
    basis = freedom.basis.copy()
    basis[[*range(SHIFT.start), *range(SIZE + 1, UNKNOWNS)]] = 0.0
    u, values, _ = np.linalg.svd(basis, full_matrices=False)
    basis = u[:, values > 1e-9]
    normal = np.zeros((count, UNKNOWNS, UNKNOWNS))
    gradient = np.zeros((count, UNKNOWNS))
    for target in targets:
        middle, size = _box(target)
        px = target.project(points, placements).px
        first, last = px.min(1), px.max(1)
        extent = np.sqrt(np.maximum(np.prod(last - first, axis=1), 1.0))
        centre = target.project(CENTRE, placements)
        J = centre.jacobian(np.arange(count), np.zeros(count, np.int64))
        # The derivative of the logarithm of the cloud's size in the picture.
        growth = np.zeros((count, UNKNOWNS))
        growth[:, SIZE] = 1.0
        if target.camera.model == "perspective":
            growth[:, SHIFT] = -centre.inverse[:, 0, None] * target.camera.R[2]
        residual = middle - (first + last) / 2.0
        log = np.log(size / extent)
        # An error of the size by a factor e weighs as much as the size itself.
        normal += J.transpose(0, 2, 1) @ J + size**2 * growth[:, :, None] * growth[:, None]
        gradient += (J.transpose(0, 2, 1) @ residual[..., None])[..., 0]
        gradient += size**2 * growth * log[:, None]
    normal = basis.T @ normal @ basis
    normal += 1e-9 * np.einsum("pii->p", normal)[:, None, None] * np.eye(basis.shape[1])
    step = np.linalg.solve(normal, (gradient @ basis)[..., None])[..., 0] @ basis.T
    large = np.abs(step[:, SIZE]) + np.linalg.norm(step[:, SHIFT], axis=1) / placements.size
    return placements.stepped(step / np.maximum(large, 1.0)[:, None])


def coarse_iou(points: Array, placements: Placements, targets: Sequence[Target]) -> Array:
    """Soft IoU [P] of the masks and the cells of the points, both dilated; mean over views.

    If only the points were dilated, placements that make the cloud small and dense would score
    best.
    """
    count, ious, inner = len(placements), [], np.s_[:, BORDER:-BORDER, BORDER:-BORDER]
    for target in targets:
        px = target.project(points, placements).px
        cell = np.clip(np.rint(px), -BORDER, target.side - 1 + BORDER).astype(np.int64) + BORDER
        wide = target.side + 2 * BORDER
        flat = (np.arange(count)[:, None] * wide + cell[..., 1]) * wide + cell[..., 0]
        hits = np.bincount(flat.ravel(), minlength=count * wide * wide).astype(np.float32)
        hits = hits.reshape(-1, wide, wide)
        mask = _dilated(np.pad(target.mask, BORDER)[None].astype(np.float32))[inner]
        silhouette, known = _dilated(hits)[inner], target.known.astype(np.float32)
        intersection = (np.minimum(silhouette, mask) * known).sum((1, 2))
        union = (np.maximum(silhouette, mask) * known).sum((1, 2))
        outside = 0.0 if target.truncated else hits.sum((1, 2)) - hits[inner].sum((1, 2))
        ious.append(intersection / (union + outside))
    return np.mean(ious, 0)


def _dilated(image: Floats) -> Floats:
    """A covered cell also covers its four neighbours, and half of its diagonal ones; at most 1."""
    soft = 2.0 * image
    for axis in (1, 2):
        soft = soft + 0.5 * (np.roll(soft, 1, axis) + np.roll(soft, -1, axis))
    covered: Floats = np.minimum(soft, 1.0)
    return covered


def closed_iou(
    points: Array, placements: Placements, targets: Sequence[Target], radius: float
) -> Array:
    """IoU [P] of masks and cloud, both dilated by ``radius`` (units of the cloud); mean over views.

    The dilation closes the gaps between points. Unlike the IoU of a Gaussian silhouette, this IoU
    depends neither on the density of the cloud nor on its size in the picture. Unlike
    `tso_cli.evaluation.footprint`, its coverage is soft at the border of a shape, so that it ranks
    placements that differ by less than a cell.
    """
    from scipy.ndimage import distance_transform_edt

    ious = np.empty((len(targets), len(placements)))
    for number, target in enumerate(targets):
        grid = np.indices(target.mask.shape)[::-1].reshape(2, -1).T.astype(np.float32)
        to_mask = distance_transform_edt(~target.inside)
        pixels = target.project(points, placements).px.astype(np.float32)
        inverse = target.project(CENTRE, placements).inverse[:, 0]
        cells = radius * placements.size * placements.focal * inverse * target.camera.K[0, 0]
        for i, (px, reach) in enumerate(zip(pixels, cells, strict=True)):
            squared = (grid @ (-2.0 * px.T) + np.square(px).sum(1)).min(1) + np.square(grid).sum(1)
            to_point = np.sqrt(np.maximum(squared, 0.0)).reshape(target.mask.shape)
            # Coverage of cells, which is soft at the border of a dilated shape.
            cloud, mask = (np.clip(reach + 0.5 - d, 0.0, 1.0) for d in (to_point, to_mask))
            intersection = (np.minimum(cloud, mask) * target.known).sum()
            ious[number, i] = intersection / (np.maximum(cloud, mask) * target.known).sum()
    return np.mean(ious, 0)


def distinct(R: Array, score: Array, degrees: float, count: int) -> Indices:
    """Indices of at most ``count`` rotations [P, 3, 3], best first.

    None is within ``degrees`` of a better one.
    """
    order = np.argsort(-score, kind="stable")
    indices: list[int] = []
    while len(order) and len(indices) < count:
        best = order[0]
        indices.append(int(best))
        order = order[angle_between(R[order], R[best]) > degrees]
    return np.array(indices)


def spread_indices(points: Array) -> Indices:
    """Indices of at most 1,024 of ``points``; for every k the first k of them are spread evenly."""
    index = np.arange(len(points))
    if len(points) > THINNED_POINTS:
        index = np.random.default_rng(0).permutation(len(points))[:THINNED_POINTS]
    return index[farthest_point_sample(points[index], min(SCORED_POINTS, len(index)))]


def spacing(points: Array) -> float:
    """Median distance from a point to its nearest neighbour."""
    from scipy.spatial import cKDTree

    distance, _ = cKDTree(points).query(points, 2)
    return float(np.median(distance[:, 1]))


def unlike_first(points: Array, R: Array, colours: Array | None = None) -> list[int]:
    """Indices of the rotations ``R`` [P, 3, 3] that no symmetry of the cloud makes of the first."""
    gap, others = spacing(points), range(1, len(R))
    return [i for i in others if not same_by_symmetry(points, R[0], R[i], gap, colours)]


def same_by_symmetry(
    points: Array, first: Array, second: Array, spacing: float, colours: Array | None = None
) -> bool:
    """Whether the cloud looks the same to cameras with the rotations ``first`` and ``second``.

    Rotated by the difference of the two rotations it then coincides with itself to within its
    spacing, and so do its ``colours`` [N, 3], in [0, 1].
    """
    from scipy.spatial import cKDTree

    # The axis of a symmetry goes through the mean of the points.
    points = points - points.mean(0)
    turned = points @ (first.T @ second)
    forward, nearest = cKDTree(points).query(turned)
    backward, _ = cKDTree(turned).query(points)
    if colours is not None and np.abs(colours[nearest] - colours).mean() > REPAINTED:
        return False
    return bool(max(np.square(forward).mean(), np.square(backward).mean()) < spacing**2)
