"""Exact nearest neighbours: all pairs of small clouds, a k-d tree or compiled loops on the CPU, chunked distances elsewhere."""

from __future__ import annotations

import torch
from torch import Tensor

from .choice import compiled_pays

# Clouds up to this size are compared pair by pair in compiled code; in larger ones a k-d tree finds its way faster.
COMPARE_ALL_UP_TO = 8192
# Clouds up to this size are compared pair by pair by a matrix product: for one refinement of 1,024 points that is as fast as
# k-d trees, whose import takes a quarter of a second.
MULTIPLY_UP_TO = 1500
PAIRS_PER_PRODUCT = 1 << 17
# Pairs compared at once where there is no k-d tree.
PAIRS_PER_CHUNK = 1 << 26


def nearest(queries: Tensor, data: Tensor) -> Tensor:
    """Index into ``data`` of the point nearest to each query.

    Parameters
    ----------
    queries : [Q, D]
    data : [N, D], N >= 1

    Returns
    -------
    [Q] int64 on the queries' device. Nothing is differentiable here; gather with the index and subtract.
    """
    queries, data = queries.detach(), data.detach()
    if queries.device.type == "cpu":
        if len(data) <= MULTIPLY_UP_TO:
            return _multiplied(queries, data)
        from scipy.spatial import cKDTree

        tree = cKDTree(data.numpy(), balanced_tree=False, compact_nodes=False)
        return torch.from_numpy(_query(tree, queries)[1])
    size = max(1, PAIRS_PER_CHUNK // len(data))
    return torch.cat([torch.cdist(part, data).argmin(1) for part in queries.split(size)])


def nearest_both_ways(a: Tensor, b: Tensor) -> tuple[Tensor, Tensor]:
    """Nearest neighbours between the clouds of B pairs, both ways.

    Parameters
    ----------
    a : [B, N, 3]
    b : [B, M, 3]

    Returns
    -------
    Index into ``b`` of the point nearest to each of ``a`` [B, N], and into ``a`` of that nearest to each of ``b`` [B, M].
    Nothing is differentiable here; gather with the index and subtract.
    """
    smaller, larger = (a, b) if a.shape[1] <= b.shape[1] else (b, a)
    if compiled_pays(smaller) and larger.shape[1] <= COMPARE_ALL_UP_TO:
        from .compiled_nearest import nearest_both_ways as compare

        return compare(a, b)
    pairs = list(zip(a, b, strict=True))
    return torch.stack([nearest(x, y) for x, y in pairs]), torch.stack([nearest(y, x) for x, y in pairs])


def nearest_points(pixels: Tensor, points_px: Tensor, valid: Tensor) -> Tensor:
    """Which projected point is nearest to each chosen pixel.

    Parameters
    ----------
    pixels : [M, H, W] bool, those that ask.
    points_px, valid : [M, N, 2] column and row, [M, N] bool: points that are False are not there.

    Returns
    -------
    [M, H, W] int64 index into the image's points; -1 at other pixels, and everywhere where an image has no valid point.
    """
    index = torch.full(pixels.shape, -1, dtype=torch.int64, device=pixels.device)
    for i in range(len(pixels)):
        alive = torch.nonzero(valid[i]).squeeze(1)
        rows, columns = torch.nonzero(pixels[i], as_tuple=True)
        if len(alive) and len(rows):
            centres = torch.stack([columns, rows], 1).to(points_px.dtype)
            index[i, rows, columns] = alive[nearest(centres, points_px[i, alive])]
    return index


def nearest_marked(marked: Tensor, compiled: bool = False) -> tuple[Tensor, Tensor]:
    """Row and column [M, H, W] of the marked pixel nearest to each pixel, -1 in images without one.

    Parameters
    ----------
    marked : [M, H, W] bool.
    compiled : by compiled loops (on the CPU) or by one distance transform per image.
    """
    if compiled:
        from .compiled_nearest import nearest_marked as transform

        return transform(marked)
    from scipy.ndimage import distance_transform_edt

    index = torch.full((2, *marked.shape), -1, dtype=torch.int64)
    for i, image in enumerate(marked.cpu()):
        if image.any():
            found = distance_transform_edt(~image.numpy(), return_distances=False, return_indices=True)
            index[:, i] = torch.from_numpy(found)
    rows, columns = index.to(marked.device)
    return rows, columns


def _multiplied(queries: Tensor, data: Tensor) -> Tensor:
    """As :func:`nearest`, by |q - d|^2 = |q|^2 - 2 q d + |d|^2 in float64."""
    # about the centre, where the numbers are small and little of them cancels
    data = data.double()
    centre = data.mean(0)
    data = data - centre
    half = data.square().sum(1) / 2.0
    found = []
    for part in (queries.double() - centre).split(max(1, PAIRS_PER_PRODUCT // len(data))):
        # numpy's argmin is three times as fast as torch's
        index = torch.from_numpy(torch.addmm(half, part, data.T, alpha=-1.0).numpy().argmin(1))
        # A distance of 0 is the least there is. Of others rounding moves the square by 2e-8 of it at most, less than float32
        # can tell apart, unless they are this small.
        squared = (part - data[index]).square().sum(1)
        close = torch.nonzero((squared > 0.0) & (squared < 1e-7 * part.square().sum(1))).squeeze(1)
        if len(close):
            index[close] = torch.cdist(part[close], data, compute_mode="donot_use_mm_for_euclid_dist").argmin(1)
        found.append(index)
    return torch.cat(found)


def _query(tree, queries: Tensor, k: int = 1):  # type: ignore[no-untyped-def]
    # Threads cost more than they bring for small clouds.
    return tree.query(queries.numpy(), k=k, workers=-1 if len(queries) > 4096 else 1)


class StaticNearest:
    """Nearest neighbours between a cloud that stays and its own moved copy.

    Early in an optimisation a moved point is still nearest to its own start. Where the triangle inequality proves that, no
    search is made; the answers are exact either way.

    Parameters
    ----------
    start : [N, D], the cloud that stays.
    """

    def __init__(self, start: Tensor) -> None:
        self.start = start.detach()
        self.own = torch.arange(len(start), device=start.device)
        self._tree = None
        self.spacing: Tensor | None = None
        if start.device.type == "cpu" and len(start) > 1:
            if len(start) <= MULTIPLY_UP_TO:
                pairs = torch.cdist(self.start, self.start, compute_mode="donot_use_mm_for_euclid_dist")
                spacing = pairs.fill_diagonal_(torch.inf).amin(1)
            else:
                from scipy.spatial import cKDTree

                self._tree = cKDTree(self.start.numpy())
                spacing = torch.from_numpy(_query(self._tree, self.start, k=2)[0][:, 1])
            # A hair less than the true spacing, so that rounding cannot prove what is not so.
            self.spacing = spacing.to(start.dtype) * (1.0 - 1e-5)

    def __call__(self, moved: Tensor) -> tuple[Tensor, Tensor]:
        """Index of the nearest moved point for each start [N], and of the nearest start for each moved point [N]."""
        moved = moved.detach()
        if self.spacing is None:
            return nearest(self.start, moved), nearest(moved, self.start)
        distance = (moved - self.start).norm(dim=1)
        to_start, to_moved = self.own, self.own
        # |m_i - s_j| >= |s_i - s_j| - |m_i - s_i|, so s_i is nearest to m_i while m_i moved under half the spacing at s_i.
        doubtful = torch.nonzero(2.0 * distance >= self.spacing).squeeze(1)
        if len(doubtful):
            asking = moved[doubtful]
            found = nearest(asking, self.start) if self._tree is None else torch.from_numpy(_query(self._tree, asking)[1])
            to_start = to_start.index_copy(0, doubtful, found)
        # |s_i - m_j| >= |s_i - s_j| - |m_j - s_j|, and no point moved further than the furthest.
        doubtful = torch.nonzero(distance + distance.max() >= self.spacing).squeeze(1)
        if len(doubtful):
            to_moved = to_moved.index_copy(0, doubtful, nearest(self.start[doubtful], moved))
        return to_moved, to_start
