"""What one mask can tell at most: the best deformation across its line of sight."""

from __future__ import annotations

from math import comb

import numpy as np
from scipy.spatial import cKDTree

from tso_cli.evaluation.metrics import chamfer
from tso_cli.geometry.arrays import Array, Indices

from .cases import Case

DEGREE = 3
"""Of the polynomials along each side of the box: 4 x 4 x 4 control points."""
LEAST_GAIN = 1e-3
"""Of the distance. A round that gains less is the last."""
DAMPING = 1e-4
"""Of the mean diagonal of the linear system. On validation shapes 10 times as much leaves up to
6 % more distance, a tenth changes it by under 1 %. Without damping the system may be singular."""


def across_the_view(case: Case) -> float:
    """Chamfer distance that is left after the best smooth deformation across the first view.

    The points of ``case.initial`` move perpendicular to the viewing direction of the first view;
    their depth stays. A lattice of 4 x 4 x 4 Bernstein polynomials over the box of these points
    moves them. It is fitted to ``case.target``, from a start of zero: a round pairs each point with
    the nearest one of the other cloud, both ways, and solves a damped least-squares system.

    The distance is measured as results are, and is at most the distance of the start. It is

    - generous: the lattice knows the truth, also inside and behind the silhouette;
    - not a strict bound: the search is local. It leaves out depth, and parts that the lattice
      cannot make. A mirror plane or knowledge of similar shapes can do better.
    """
    start, target = case.initial, case.target
    across = case.views[0].camera.R[:2]  # [2, 3], x and y of the camera in the axes of the points
    lattice = _lattice(start)
    controls = np.zeros((lattice.shape[1], 2))
    points, distance = start, chamfer(start, target).chamfer
    while True:
        of_start, of_target = _pairs(points, target)
        wanted = (target[of_target] - start[of_start]) @ across.T
        weights = 1.0 / np.repeat([len(start), len(target)], [len(start), len(target)])
        controls = _solved(lattice[of_start], wanted, weights, controls)
        points = start + lattice @ controls @ across
        before, distance = distance, chamfer(points, target).chamfer
        if not before - distance > LEAST_GAIN * before:
            return min(before, distance)


def _lattice(points: Array) -> Array:
    """[N, 64], the share of each control point in the displacement of each of ``points`` [N, 3]."""
    extents = np.ptp(points, axis=0)
    # A flat cloud has an extent of 0.
    place = (points - points.min(0)) / np.where(extents > 0.0, extents, 1.0)
    terms = (comb(DEGREE, k) * place**k * (1.0 - place) ** (DEGREE - k) for k in range(DEGREE + 1))
    x, y, z = np.moveaxis(np.stack(list(terms), -1), 1, 0)
    return np.einsum("ni,nj,nk->nijk", x, y, z).reshape(len(points), -1)


def _pairs(points: Array, target: Array) -> tuple[Indices, Indices]:
    """[N + M] indices into both clouds: the nearest of each of the N points, then of the M."""
    nearest_target = cKDTree(target).query(points)[1]
    nearest_point = cKDTree(points).query(target)[1]
    of_points = np.concatenate([np.arange(len(points)), nearest_point])
    return of_points, np.concatenate([nearest_target, np.arange(len(target))])


def _solved(rows: Array, targets: Array, weights: Array, controls: Array) -> Array:
    """Control points [64, 2] that move ``rows`` [P, 64] by ``targets`` [P, 2], in least squares.

    Damping holds them near ``controls`` [64, 2], those of the last round.
    """
    weighted = rows.T * weights
    system = weighted @ rows
    damping = DAMPING * np.trace(system) / len(system)
    right_side = weighted @ targets + damping * controls
    solution: Array = np.linalg.solve(system + damping * np.eye(len(system)), right_side)
    return solution
