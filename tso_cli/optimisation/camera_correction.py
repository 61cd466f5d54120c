"""Corrections of given cameras, found with the points, kept where they explain a misfit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ..geometry.arrays import Array, Box
from ..geometry.camera import Camera
from ..geometry.rotations import cross_product_matrix, from_vectors
from ..geometry.view import View
from ..geometry.window import window_around, window_of
from ..losses.chamfer import ChamferToStart
from ..losses.projection import project_differentiably
from ..losses.silhouette import silhouette_bce
from .adam import Adam
from .loop import minimise
from .objective import MaskChamferObjective, ViewTargets
from .presets import PAPER_POINTS
from .problem import Problem
from .resampled_view import ResampledView, resample_view

# A correction is kept if it alone leaves less than this share of the start's misfit in its view.
# The silhouette of a wrong shape asks for corrections of a right camera too, but no camera makes
# a wrong shape fit.
MISFIT_LEFT = 0.38
# The misfit is the mask Chamfer loss at this robust scale, in cells. Unlike the silhouette's loss
# it is near 0 for a cloud that fits.
MISFIT_ROBUST_SCALE = 4.0
# Prior standard deviations of the error of a given camera: rotation about the cloud, and shift in
# distances to the cloud.
TURN = math.radians(2.0)
SHIFT = 0.01
# Loss of a correction by one standard deviation: a wrong cloud asks for corrections that its
# camera does not need.
CORRECTION_WEIGHT = 30.0
# Of Adam: 50 steps rotate a camera by at most 5 degrees.
LEARNING_RATE = 2e-3


def corrected_cameras(problem: Problem, until: float) -> Problem:
    """The problem with the cameras corrected that need it; ``until`` as in `minimise`.

    Points and cameras move together with the paper's settings. The points are held near their
    start, which separates a motion of all points from a motion of the camera. The cameras are held
    near the given ones. A correction is kept if with it the start itself fits the view's mask far
    better (`MISFIT_LEFT`). The displacement of the points is discarded.

    Raises KeyboardInterrupt where Ctrl-C ended the optimisation.
    """
    cloud = problem.cloud
    count = len(cloud.start)
    # Without the flipped views: the mirror image of a wrong camera is wrong as well.
    given = [windowed.resampled for windowed in problem.given]
    parameters = _PointsAndCameras(cloud.start, len(given))
    optimised = minimise(
        parameters, _WithCameras(given, cloud.start), PAPER_POINTS.steps, until=until
    )
    if optimised.interrupted:
        raise KeyboardInterrupt
    corrections = optimised.best[count:].reshape(-1, 6)
    views = []
    for view, resampled, correction in zip(problem.views, given, corrections, strict=True):
        camera = moved_camera(view.camera, correction, cloud.centre, cloud.scale)
        corrected = replace(view, camera=camera)
        box = window_around(resampled.box, window_of(corrected, cloud.control_points))
        before, after = (_misfit(problem, candidate, box) for candidate in (view, corrected))
        views.append(corrected if after < MISFIT_LEFT * before else view)
    return problem.with_views(views)


def _misfit(problem: Problem, view: View, box: Box) -> float:
    """Of the start by ``view``, in a window that holds the cloud as either camera sees it."""
    cloud = problem.cloud
    resampled = resample_view(view, problem.sigma_sq, cloud.centre, cloud.scale, box)
    objective = MaskChamferObjective(ViewTargets.of([resampled], [1.0]), MISFIT_ROBUST_SCALE)
    return objective(cloud.start)[0]


class _PointsAndCameras:
    """Points, and below them rotation and shift of each camera: [N + 2 V, 3]."""

    def __init__(self, initial: Array, views: int) -> None:
        self._rows = np.concatenate([initial, np.zeros((2 * views, 3))])
        rates = np.full((len(self._rows), 1), LEARNING_RATE)
        rates[: len(initial)] = PAPER_POINTS.learning_rate
        self._rates, self._adam = rates, Adam(1.0)

    def points(self) -> Array:
        return self._rows

    def step(self, gradient: Array) -> None:
        self._rows = self._rows + self._rates * self._adam.step(gradient)


class _WithCameras:
    """Eq. 7 of the points, with cameras that a quadratic penalty holds near the given ones."""

    def __init__(self, views: Sequence[ResampledView], initial: Array) -> None:
        self.views = views
        self._chamfer = ChamferToStart(initial)

    def __call__(self, rows: Array) -> tuple[float, Array]:
        """The loss of points and corrections [N + 2 V, 3], and its gradient."""
        count = len(self._chamfer.initial)
        points = rows[:count]
        gradient = np.zeros_like(rows)
        value, by_points = self._chamfer(points)
        value *= PAPER_POINTS.gamma
        gradient[:count] = PAPER_POINTS.gamma * by_points
        for number, view in enumerate(self.views):
            turn, shift = count + 2 * number, count + 2 * number + 1
            loss, by_points, by_turn, by_shift = moved_silhouette(
                points, view, rows[turn], rows[shift]
            )
            penalty = np.square(rows[turn] / TURN).sum() + np.square(rows[shift] / SHIFT).sum()
            value += loss + CORRECTION_WEIGHT * float(penalty)
            gradient[:count] += by_points
            gradient[turn] = by_turn + 2.0 * CORRECTION_WEIGHT / TURN**2 * rows[turn]
            gradient[shift] = by_shift + 2.0 * CORRECTION_WEIGHT / SHIFT**2 * rows[shift]
        return value, gradient


def moved_silhouette(
    points: Array, view: ResampledView, turn: Array, shift: Array
) -> tuple[float, Array, Array, Array]:
    """The silhouette's cross-entropy by a corrected camera.

    Also its gradients by points, rotation vector and shift. The rotation, in radians and the
    camera's axes, is about the cloud's centre, which separates it from the shift. The shift is in
    distances to the centre.
    """
    camera = view.camera
    distance = distance_of(camera)
    moved = replace(camera, R=from_vectors(turn) @ camera.R, t=camera.t + distance * shift)
    projected = project_differentiably(points, moved)
    if not projected.valid.any():
        return np.inf, np.zeros_like(points), np.zeros(3), np.zeros(3)
    value, gradient_px = silhouette_bce(
        projected.points_px, projected.valid, *view.pixel_weights, view.sigma_sq
    )
    in_camera = projected.in_camera(gradient_px)
    # d(exp(w) v) = (J dw) x (exp(w) v), J the left Jacobian of the rotations.
    torque = np.cross(points @ moved.R.T, in_camera).sum(0)
    return value, in_camera @ moved.R, _left_jacobian(turn).T @ torque, distance * in_camera.sum(0)


def _left_jacobian(vector: Array) -> Array:
    angle = float(np.linalg.norm(vector))
    cross = cross_product_matrix(vector)
    if angle < 1e-4:
        return np.eye(3) + 0.5 * cross
    first, second = (1.0 - math.cos(angle)) / angle**2, (angle - math.sin(angle)) / angle**3
    jacobian: Array = np.eye(3) + first * cross + second * (cross @ cross)
    return jacobian


def distance_of(camera: Camera) -> float:
    """Depth of the origin, the unit of shifts; 1 for an orthographic camera."""
    return 1.0 if camera.model == "orthographic" else abs(float(camera.t[2]))


def moved_camera(camera: Camera, values: Array, centre: Array, scale: float) -> Camera:
    """``camera``, in the units of a file, after a correction [6].

    The correction was found for the cloud normalised by (X - centre) / scale.
    """
    turn, shift = values[:3], values[3:]
    if not values.any():
        return camera
    local = camera.for_normalised(centre, scale)
    R = from_vectors(turn) @ camera.R
    t = (local.t + shift * distance_of(local)) * scale - R @ centre
    return replace(camera, R=R, t=t)
