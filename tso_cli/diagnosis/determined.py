"""How far masks and depth maps determine a shape.

The data term is linearised at the result (Gauss-Newton). Each cell of a mask's contour has two
residuals: its offset in pixels from the point nearest to it. Each pixel of a depth map has one: the
offset along the camera's axis from the point nearest to its surface. Their normal matrix J^T W J is
compared with the curvature of a position prior. The share of its motions that the evidence fixes
is the "number of well-determined parameters" of MacKay ("Bayesian Interpolation", 1992), divided by
the number of parameters.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..geometry.arrays import Array, Bits, Indices
from ..losses.depth import DepthTarget, robust
from ..losses.mask_chamfer import REFERENCE_POINTS, MaskTarget
from ..losses.nearest import nearest, nearest_few
from ..losses.projection import project_differentiably
from ..optimisation.objective import ViewTarget
from ..optimisation.presets import PRIOR_WEIGHT
from ..optimisation.problem import Problem

# A flipped view counts as a quarter of a real view: that the object is symmetric is a guess.
FLIPPED_EVIDENCE = 0.25
# A contour cell that is many times this far from its point, px of an image of 64, says nothing.
ROBUST_SCALE = 3.0
# Points whose evidence is averaged: a point moves much as those around it do.
NEIGHBOURS = 12


def all_blocks(points: Array, problem: Problem, weights: Sequence[float]) -> Array:
    """[N, 3, 3], the blocks of normalised ``points`` [N, 3] in the normal matrix of all views.

    ``weights`` are of the given views.
    """
    blocks = np.zeros((len(points), 3, 3))
    for number, view in enumerate(problem.targets(weights).views):
        share = 1.0 if number < len(problem.given) else FLIPPED_EVIDENCE
        blocks += share * normal_blocks(points, view)
    return blocks


def shares_fixed(points: Array, blocks: Array) -> Array:
    """[N] in [0, 1]: the share of each point's motions that the evidence fixes.

    ``blocks`` [N, 3, 3] are of all views. With D the mean block of a point and its neighbours, and
    p the weight of the position prior, the share is ``1 - tr(p (D + p I)^-1) / 3``: posterior over
    prior variance, the mean of three directions.
    """
    prior = PRIOR_WEIGHT * REFERENCE_POINTS / len(points)
    near = nearest_few(points, points, min(NEIGHBOURS, len(points)))
    variance = np.linalg.inv(blocks[near].mean(1) + prior * np.eye(3))
    fixed: Array = 1.0 - prior * np.trace(variance, axis1=1, axis2=2) / 3.0
    return np.clip(fixed, 0.0, 1.0)


def normal_blocks(points: Array, view: ViewTarget) -> Array:
    """[N, 3, 3], what a view adds to the normal matrix for each of the ``points`` [N, 3].

    A residual is weighted by `robust`, and a cell of the contour also by its length, so that a
    finer grid says the same.
    """
    blocks = np.zeros((len(points), 3, 3))
    projected = project_differentiably(points, view.camera)
    px = projected.points_px
    (candidates,) = np.nonzero(view.mask.observed(px, projected.valid))
    if not len(candidates):
        return blocks
    scale = view.mask.scale
    cells = np.argwhere(contour(view.mask))[:, ::-1].astype(float)
    owner = candidates[nearest(cells, px[candidates])]
    squared = np.square(px[owner] - cells).sum(1) * scale**2
    _, slope = robust(squared, ROBUST_SCALE)
    of_points = np.bincount(owner, view.weight * scale * slope, len(points)).astype(np.float64)
    for axis in scale * np.eye(2):
        row = projected.pull_back(np.tile(axis, (len(points), 1)))
        blocks += of_points[:, None, None] * row[:, :, None] * row[:, None]
    if view.depth is not None:
        along = view.camera.R[2]
        of_points = view.weight * _of_depth(points, candidates, view.depth)
        blocks += of_points[:, None, None] * np.outer(along, along)
    return blocks


def contour(target: MaskTarget) -> Bits:
    """[H, W] the foreground cells next to a cell that is known to be background."""
    outside = np.pad(target.outside, 1)
    bordering = outside[:-2, 1:-1] | outside[2:, 1:-1] | outside[1:-1, :-2] | outside[1:-1, 2:]
    return np.asarray(target.inside & bordering)


def _of_depth(points: Array, candidates: Indices, target: DepthTarget) -> Array:
    """[N], how firmly a depth map holds each point along the axis of the camera."""
    owner = candidates[nearest(target.surface, points[candidates])]
    per_unit = np.square(target.per_unit)
    squared = np.square(points[owner] - target.surface).sum(1) * per_unit
    _, slope = robust(squared, ROBUST_SCALE)
    weight = target.pixel_area * slope * per_unit
    return np.bincount(owner, weight, len(points)).astype(np.float64)
