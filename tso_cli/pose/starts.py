"""Starting poses over all directions, and the scores of poses."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from ..geometry.rotations import angle_between, spread
from .alignment import Poses, Target, project

# Width in cells of the border around the image that collects the points outside the image.
BORDER = 2


def starts(points: Array, target: Target, focal: float) -> tuple[Poses, Array]:
    """Starting poses over all directions, and their scores (`coarse_iou`).

    With its scale and centre, the box of the projected ``points`` [N, 3] (longest side 1, centred)
    has the area and the middle of the mask's box. ``focal`` is in px of the target.
    """
    # Viewing directions are 16 degrees apart, and in-plane rotations 20 degrees.
    rotations = spread(directions=150, turns=18)
    inside = target.inside()
    low, high = inside.min(0) - 0.5, inside.max(0) + 0.5
    middle, size = (low + high) / 2.0, float(np.sqrt(np.prod(high - low)))
    batches, scores = [], []
    at_once = 600  # it bounds the memory
    for R in (rotations[i : i + at_once] for i in range(0, len(rotations), at_once)):
        poses = Poses(
            R,
            np.tile(middle, (len(R), 1)),
            np.full(len(R), min(size, focal)),
            np.full(len(R), focal),
        )
        # Because of perspective the box is only roughly proportional to the scale. Two iterations
        # are enough.
        for _ in range(2):
            px, _, _ = project(points, poses, target.principal)
            first, last = px.min(1), px.max(1)
            growth = size / np.sqrt(np.maximum(np.prod(last - first, axis=1), 1.0))
            centre = poses.centre + (middle - (first + last) / 2.0)
            poses = Poses(R, centre, np.minimum(poses.scale * growth, focal), poses.focal)
        batches.append(poses)
        scores.append(coarse_iou(points, poses, target))
    return Poses.joined(batches), np.concatenate(scores)


def coarse_iou(points: Array, poses: Poses, target: Target) -> Array:
    """Soft IoU [P] of the mask and the cells of the points, both dilated.

    If only the points were dilated, poses that make the cloud small and dense would score best.
    """
    size = target.mask.shape[0]
    px, _, _ = project(points, poses, target.principal)
    cell = np.clip(np.rint(px), -BORDER, size - 1 + BORDER).astype(np.int64) + BORDER
    wide = size + 2 * BORDER
    flat = (np.arange(len(poses))[:, None] * wide + cell[..., 1]) * wide + cell[..., 0]
    hits = (
        np.bincount(flat.ravel(), minlength=len(poses) * wide * wide)
        .reshape(-1, wide, wide)
        .astype(np.float32)
    )
    inner = slice(BORDER, -BORDER)
    silhouette = _dilated(hits)[:, inner, inner]
    mask = _dilated(np.pad(target.mask, BORDER)[None].astype(np.float32))[:, inner, inner]
    known = target.known.astype(np.float32)
    intersection = (np.minimum(silhouette, mask) * known).sum((1, 2))
    union = (np.maximum(silhouette, mask) * known).sum((1, 2))
    outside = 0.0 if target.truncated else hits.sum((1, 2)) - hits[:, inner, inner].sum((1, 2))
    iou: Array = intersection / (union + outside)
    return iou


def _dilated(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """A covered cell also covers its four neighbours, and half of its diagonal ones; at most 1."""
    soft = 2.0 * image
    for axis in (1, 2):
        soft = soft + 0.5 * (np.roll(soft, 1, axis) + np.roll(soft, -1, axis))
    covered: NDArray[np.float32] = np.minimum(soft, 1.0)
    return covered


def closed_iou(points: Array, poses: Poses, target: Target, radius: float) -> Array:
    """IoU [P] of mask and cloud, both dilated by ``radius`` (units of the cloud).

    The dilation closes the gaps between points. Unlike the IoU of a Gaussian silhouette, this IoU
    depends neither on the density of the cloud nor on its size in the picture. Unlike
    `tso_cli.evaluation.footprint`, its coverage is soft at the border of a shape, so that it ranks
    poses that differ by less than a pixel.
    """
    from scipy.ndimage import distance_transform_edt

    size = target.mask.shape[0]
    # [S S, 2] column and row
    grid = np.indices((size, size))[::-1].reshape(2, -1).T.astype(np.float32)
    to_mask = distance_transform_edt(~target.foreground())
    scores = np.empty(len(poses))
    pixels, _, _ = project(points, poses, target.principal)
    for i, (px, scale) in enumerate(zip(pixels, poses.scale, strict=True)):
        px = px.astype(np.float32)
        squared = (grid @ (-2.0 * px.T) + np.square(px).sum(1)).min(1) + np.square(grid).sum(1)
        to_point = np.sqrt(np.maximum(squared, 0.0)).reshape(size, size)
        # Coverage of pixels, which is soft at the border of a dilated shape.
        cloud, mask = (
            np.clip(radius * scale + 0.5 - distance, 0.0, 1.0) for distance in (to_point, to_mask)
        )
        intersection = (np.minimum(cloud, mask) * target.known).sum()
        scores[i] = intersection / (np.maximum(cloud, mask) * target.known).sum()
    return scores


def distinct(poses: Poses, score: Array, degrees: float, count: int) -> NDArray[np.int64]:
    """Indices of at most ``count`` poses, best first, none within ``degrees`` of a better one."""
    order = np.argsort(-score, kind="stable")
    chosen: list[int] = []
    while len(order) and len(chosen) < count:
        best = order[0]
        chosen.append(int(best))
        order = order[angle_between(poses.R[order], poses.R[best]) > degrees]
    return np.array(chosen)
