"""Poses of a cloud relative to a mask, improved by Gauss-Newton steps.

Residuals are distances between nearest neighbours in the image, both ways.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from ..geometry.arrays import Array
from ..geometry.rotations import from_vectors

# Distances under half a pixel, px, are inside a pixel and count as 0.
TOLERANCE = 0.5


class Step:
    """Limits and weights of one Gauss-Newton step."""

    # The linear model holds for steps up to this, in radians and in logarithms of scale and focal
    # length.
    LARGEST = 0.4
    # Levenberg-Marquardt damping, relative and absolute.
    DAMPING, LEAST_DAMPING = 1e-3, 1e-6
    # One standard deviation of the prior on the focal length weighs as much as residuals of this
    # share of the image, and this weight fixes the focal length.
    PRIOR_RESIDUAL, FIXED_WEIGHT = 0.02, 1e9
    # Largest scale / focal. With this value the points of a cloud of radius 0.87 (longest side 1)
    # keep at least a tenth of the depth of its centre.
    LARGEST_NEARNESS = 1.0


@dataclass(frozen=True, eq=False)
class Poses:
    """P poses of one cloud of longest side 1 with its centre at the origin.

    ``scale`` gives the size and ``focal`` the perspective. The depth of the centre is focal /
    scale.
    """

    R: Array  # [P, 3, 3] world to camera
    centre: Array  # [P, 2] pixel of the cloud's centre
    scale: Array  # [P] px per unit at the depth of the centre
    focal: Array  # [P] px

    def __len__(self) -> int:
        return len(self.R)

    def __getitem__(self, rows: NDArray[np.generic] | slice) -> Poses:
        return Poses(self.R[rows], self.centre[rows], self.scale[rows], self.focal[rows])

    @classmethod
    def joined(cls, parts: Sequence[Poses]) -> Poses:
        """The poses of several batches in one."""
        names = (field.name for field in fields(cls))
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))

    def resized(self, factor: float) -> Poses:
        """The same poses for an image with ``factor`` times as many pixels along a side."""
        # Pixel centres lie at integers.
        centre = (self.centre + 0.5) * factor - 0.5
        return Poses(self.R, centre, self.scale * factor, self.focal * factor)


@dataclass(frozen=True, eq=False)
class Target:
    """The mask, resampled to a small square around the object."""

    mask: Array  # [S, S] in [0, 1]
    known: Array  # [S, S] weight of each pixel
    principal: Array  # [2] principal point of the whole picture, in these pixels
    truncated: bool  # the picture cuts off the object, so points outside the picture are no error

    def foreground(self) -> NDArray[np.bool_]:
        """[S, S] the object: known pixels with over half of the largest coverage."""
        observed = self.mask * (self.known > 0.0)
        return np.asarray(observed > 0.5 * observed.max())

    def inside(self) -> Array:
        """[M, 2] column and row of the object's pixels."""
        return np.argwhere(self.foreground())[:, ::-1].astype(np.float64)


def project(points: Array, poses: Poses, principal: Array) -> tuple[Array, Array, Array]:
    """Pixels [P, N, 2] of ``points`` [N, 3], rotated points [P, N, 3], inverse depth [P, N].

    A point whose depth is under 0.05 of the centre's depth is projected from there.
    """
    rotated = points @ poses.R.transpose(0, 2, 1)
    nearness = (poses.scale / poses.focal)[:, None]
    inverse = 1.0 / np.maximum(1.0 + nearness * rotated[..., 2], 0.05)
    plane = poses.scale[:, None, None] * rotated[..., :2] + (poses.centre - principal)[:, None]
    return principal + plane * inverse[..., None], rotated, inverse


def improve(
    points: Array,
    poses: Poses,
    target: Target,
    steps: int,
    prior: tuple[float | Array, float],
    robust: float,
) -> Poses:
    """Gauss-Newton steps that bring projected points and mask pixels together.

    Each mask pixel attracts the nearest projected point, and the nearest mask pixel attracts each
    point outside the mask.

    Parameters
    ----------
    points : [N, 3] a centred cloud of longest side 1.
    prior : mean of the focal length, px (one, or [P]), and standard deviation of its logarithm; 0
        fixes the focal length.
    robust : scale in px; a distance d has the weight 1 / (1 + (d / ``robust``)^2).
    """
    pixels = target.inside()
    for _ in range(steps):
        px, rotated, inverse = project(points, poses, target.principal)
        to_point, to_pixel = _nearest(pixels, px)
        rows = np.arange(len(poses))[:, None]
        # Index, offset and weight of each pair. Both directions have the same total weight.
        all_points = np.broadcast_to(np.arange(len(points)), to_pixel.shape)
        of_pixels = (
            to_point, pixels - px[rows, to_point], np.full(to_point.shape, 1.0 / len(pixels))
        )  # fmt: skip
        of_points = all_points, pixels[to_pixel] - px, _comparable(px, target) / len(points)
        jacobian = _jacobian(px - target.principal, rotated, inverse, poses)
        normal, gradient = np.zeros((len(poses), 7, 7)), np.zeros((len(poses), 7))
        for index, offset, pair_weight in (of_pixels, of_points):
            distance = np.linalg.norm(offset, axis=2)
            beyond = np.maximum(1.0 - TOLERANCE / np.maximum(distance, TOLERANCE), 0.0)
            weight = np.sqrt(pair_weight * (beyond > 0.0) / (1.0 + np.square(distance / robust)))
            J: Array = (jacobian[rows, index] * weight[..., None, None]).reshape(len(poses), -1, 7)
            residual = (offset * (beyond * weight)[..., None]).reshape(len(poses), -1, 1)
            normal += J.transpose(0, 2, 1) @ J
            gradient += (J.transpose(0, 2, 1) @ residual)[..., 0]
        poses = _step(poses, normal, gradient, prior, target.mask.shape[0])
    return poses


def _nearest(pixels: Array, px: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """The nearest point of each pixel [P, M], and the nearest pixel of each point [P, N].

    ``pixels`` are [M, 2], and the points ``px`` [P, N, 2].
    """
    a, b = pixels.astype(np.float32), px.astype(np.float32)
    squared = b @ (-2.0 * a.T)  # [P, N, M]
    squared += np.square(a).sum(1)
    to_pixel = squared.argmin(2)
    squared += np.square(b).sum(2)[..., None]
    return squared.argmin(1), to_pixel


def _comparable(px: Array, target: Target) -> Array:
    """[P, N] weight: 1 for a point that can be compared with the mask, 0 for other points.

    These are points on known pixels and, unless the object is truncated, points outside the square.
    """
    size = target.mask.shape[0]
    cell = np.rint(px)
    within = ((cell >= 0) & (cell < size)).all(2)
    column, row = np.where(within[..., None], cell, 0).astype(np.int64).transpose(2, 0, 1)
    known = target.known[row, column] > 0.5
    return np.where(within, known, not target.truncated).astype(np.float64)


def _jacobian(offset: Array, rotated: Array, inverse: Array, poses: Poses) -> Array:
    """[P, N, 2, 7] derivative of pixels by rotation vector, centre, log scale, log focal length."""
    nearness = (poses.scale / poses.focal)[:, None]
    J = np.zeros((*offset.shape, 7))
    x, y, z = np.moveaxis(rotated, -1, 0)
    scale = poses.scale[:, None]
    # The relative depth is d = 1 + nearness z, so the offset of a pixel falls by offset * nearness
    # dz / d.
    for axis, (dx, dy, dz) in enumerate(((0.0 * x, -z, y), (z, 0.0 * x, -x), (-y, x, 0.0 * x))):
        J[..., 0, axis] = (scale * dx - offset[..., 0] * nearness * dz) * inverse
        J[..., 1, axis] = (scale * dy - offset[..., 1] * nearness * dz) * inverse
    J[..., 0, 3] = J[..., 1, 4] = inverse
    by_nearness = offset * (nearness * z * inverse)[..., None]
    J[..., 5] = scale[..., None] * rotated[..., :2] * inverse[..., None] - by_nearness
    J[..., 6] = by_nearness
    return J


def _step(
    poses: Poses, normal: Array, gradient: Array, prior: tuple[float | Array, float], size: int
) -> Poses:
    """One damped step of each pose."""
    focal, deviation = prior
    prior_weight = Step.FIXED_WEIGHT
    if deviation:
        prior_weight = (Step.PRIOR_RESIDUAL * size / deviation) ** 2
    normal[:, 6, 6] += prior_weight
    gradient[:, 6] += prior_weight * np.log(focal / poses.focal)
    diagonal = np.einsum("pii->pi", normal)
    diagonal += Step.DAMPING * diagonal + Step.LEAST_DAMPING
    step: Array = np.asarray(np.linalg.solve(normal, gradient[..., None])[..., 0], np.float64)
    largest = np.abs(step[:, [0, 1, 2, 5, 6]]).max(1, keepdims=True)
    step /= np.maximum(largest / Step.LARGEST, 1.0)
    scale = poses.scale * np.exp(step[:, 5])
    focal = np.maximum(poses.focal * np.exp(step[:, 6]), scale / Step.LARGEST_NEARNESS)
    return Poses(from_vectors(step[:, :3]) @ poses.R, poses.centre + step[:, 3:5], scale, focal)
