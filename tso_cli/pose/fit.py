"""Pose, distance and focal length of a camera from a mask and a cloud, by multi-start search."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from ..geometry.camera import CANONICAL_FOCAL_AT_64, Camera
from ..geometry.points import Array, as_points, bounding_box_normalisation, farthest_point_sample
from ..geometry.resampling import area_resize
from ..geometry.rotations import angle_between
from ..geometry.view import View
from .alignment import Poses, Target, improve
from .starts import closed_iou, distinct, starts

# Prior on the focal length: that of the canonical camera, in longer sides of the image, and the deviation of its logarithm.
FOCAL = CANONICAL_FOCAL_AT_64 / 64.0
FOCAL_DEVIATION = 0.35
# Side of the square around the object, in sides of the mask's box.
MARGIN = 1.3
# Side of the square in pixels, points and Gauss-Newton steps, of the coarse and of the fine search.
COARSE_SIZE, COARSE_POINTS, COARSE_STEPS = 32, 256, 12
FINE_SIZE, FINE_POINTS, FINE_STEPS = 64, 512, 20
SCORED_POINTS, FEWEST_POINTS = 1024, 16
# Poses taken into each search, and the angle in degrees to a better pose below which one is dropped.
COARSE_POSES, FINE_POSES = 48, 12
COARSE_ANGLE, FINE_ANGLE = 20.0, 10.0
# Smallest angle between alternative poses.
ALTERNATIVE_ANGLE = 20.0
# Clouds are thinned to this before farthest points are chosen.
THINNED = 4096
# A pose is sure if its IoU is at least the first and exceeds that of the best alternative by the second.
SURE_IOU, SURE_GAP = 0.75, 0.05
# Focal lengths tried, in multiples of the prior, and the loss of IoU up to which one fits as well.
FOCAL_FACTORS = np.array([0.5, 0.7, 1.0, 1.4, 2.0])
IOU_TOLERANCE = 0.01


@dataclass(frozen=True)
class Alternative:
    """Another pose that fits: its camera, its IoU, and its angle to the best pose in degrees."""

    camera: Camera
    iou: float
    degrees: float


@dataclass(frozen=True)
class FittedCamera:
    """A perspective camera fitted to mask and cloud, its principal point in the middle of the image, and its confidence.

    iou : of mask and cloud, both dilated by the distance between points to close the cloud's gaps.
    confidence : ``iou`` less that of the best alternative.
    alternatives : poses over 20 degrees from the best (and from each other) that are no symmetry of the cloud, best first.
    focal_range : px, shortest and longest focal length tried (half to twice the prior) with an IoU within 0.01.
    """

    camera: Camera
    iou: float
    confidence: float
    alternatives: tuple[Alternative, ...]
    focal_range: tuple[float, float]

    def describe(self) -> str:
        """One line for the log."""
        toward = np.clip(-self.camera.R[2], -1.0, 1.0)
        azimuth, elevation = (
            math.degrees(math.atan2(toward[0], toward[2])) % 360.0,
            math.degrees(math.asin(toward[1])),
        )
        focal, (low, high) = self.camera.K[0, 0], self.focal_range
        words = (
            f"fitted, IoU {self.iou:.2f}, azimuth {azimuth:.0f}, elevation {elevation:.0f} (y up); "
        )
        if self.alternatives:
            words += f"next best {self.alternatives[0].iou:.2f} at {self.alternatives[0].degrees:.0f} degrees"
        else:
            words += "no other pose fits"
        words += f": {'sure' if self.sure else 'unsure'}; focal length {focal:.4g} px"
        return words + (f" ({low:.4g} to {high:.4g} fit as well)" if high > 1.1 * low else "")

    @property
    def sure(self) -> bool:
        """Whether it fits well and nothing else fits about as well."""
        return self.iou >= SURE_IOU and self.confidence >= SURE_GAP

    @property
    def doubt(self) -> str:
        """Why it is not sure."""
        if self.iou < SURE_IOU or not self.alternatives:
            return f"it brings the cloud onto the mask with an IoU of {self.iou:.3f}, which is sure from {SURE_IOU} on"
        next_best = self.alternatives[0]
        fits = f"fits about as well (IoU {next_best.iou:.2f}, its own {self.iou:.2f})"
        return f"one turned by {next_best.degrees:.0f} degrees {fits}"


def fit_camera(
    points: ArrayLike,
    mask: ArrayLike,
    known: NDArray[np.bool_] | None = None,
    focal: float | None = None,
    name: str = "mask",
) -> FittedCamera:
    """Find the camera that projects ``points`` [N, 3] onto the mask [H, W] in [0, 1]. Deterministic.

    Scores 2,700 poses over all directions by coarse silhouettes, improves the best 48 distinct ones by Gauss-Newton on two-way
    nearest neighbours in the image, then the best 12 at twice the resolution. ``known`` [H, W] is False at ignored pixels,
    ``focal`` the mean of the prior on the focal length, px (None: the canonical 1.875 times the longer side of the image).

    Raises InputError if the cloud has no extent or under 16 points, or the mask no object or no background.
    """
    array = as_points(points)
    if len(array) < FEWEST_POINTS:
        raise InputError(
            f"the cloud holds {len(array)} points, expected at least {FEWEST_POINTS} to fit a camera to a mask"
        )
    centre, unit = bounding_box_normalisation(array)
    local = _spread_points((array - centre) / unit)
    image = np.asarray(mask, dtype=np.float32)
    height, width = image.shape
    view = View(image, Camera.canonical(width, height), known, name)
    crop = _Crop.around(view)
    focal = FOCAL * max(width, height) if focal is None else focal

    coarse, fine = crop.target(view, COARSE_SIZE), crop.target(view, FINE_SIZE)
    zoom = FINE_SIZE / COARSE_SIZE
    coarse_focal = focal * COARSE_SIZE / crop.side
    fine_focal = coarse_focal * zoom
    fine_points, coarse_points = local[:FINE_POINTS], local[:COARSE_POINTS]
    poses, score = starts(fine_points, coarse, coarse_focal)
    poses = poses[distinct(poses, score, COARSE_ANGLE, COARSE_POSES)]
    poses = improve(
        coarse_points, poses, coarse, COARSE_STEPS, (coarse_focal, FOCAL_DEVIATION), 6.0
    )
    score = closed_iou(fine_points, poses, coarse, _spacing(fine_points))
    poses = poses[distinct(poses, score, FINE_ANGLE, FINE_POSES)].resized(zoom)
    poses = improve(fine_points, poses, fine, FINE_STEPS, (fine_focal, FOCAL_DEVIATION), 4.0)
    spacing = _spacing(local)
    score = closed_iou(local, poses, fine, spacing)
    order = distinct(poses, score, ALTERNATIVE_ANGLE, len(poses))
    poses, score = poses[order], score[order]

    cameras = [crop.camera(poses[i : i + 1], view, centre, unit) for i in range(len(poses))]
    ious, degrees = score.tolist(), angle_between(poses.R, poses.R[0]).tolist()
    alternatives = tuple(
        Alternative(cameras[i], ious[i], degrees[i])
        for i in range(1, len(poses))
        if not _same_by_symmetry(local, poses.R[0], poses.R[i], spacing)
    )
    # Focal lengths that fit as well once the rest of the pose is fitted to them.
    repeats = np.zeros(len(FOCAL_FACTORS), dtype=np.int64)
    fixed = replace(poses[repeats], focal=fine_focal * FOCAL_FACTORS)
    fixed = improve(fine_points, fixed, fine, FINE_STEPS // 2, (fixed.focal, 0.0), 4.0)
    fits = closed_iou(local, fixed, fine, spacing) >= ious[0] - IOU_TOLERANCE
    focal_lengths = np.append(fixed.focal[fits], poses.focal[0]) * crop.side / FINE_SIZE
    return FittedCamera(
        cameras[0],
        ious[0],
        ious[0] - alternatives[0].iou if alternatives else ious[0],
        alternatives,
        (float(focal_lengths.min()), float(focal_lengths.max())),
    )


@dataclass(frozen=True)
class _Crop:
    """A square of the image around the object: left and top edge, and side, px."""

    left: float
    top: float
    side: float

    @classmethod
    def around(cls, view: View) -> _Crop:
        left, top, right, bottom = view.box()
        side = max(right - left, bottom - top) * MARGIN
        return cls((left + right - side) / 2.0, (top + bottom - side) / 2.0, side)

    def target(self, view: View, size: int) -> Target:
        box = (self.left, self.top, self.left + self.side, self.top + self.side)
        mask, known = area_resize(view.mask, box, size, size, weights=view.known)
        middle = view.camera.K[:2, 2]
        return Target(
            mask, known, (middle - [self.left, self.top]) * (size / self.side) - 0.5, view.truncated
        )

    def camera(self, poses: Poses, view: View, centre: Array, unit: float) -> Camera:
        """The one pose, of the fine target, as a camera of the image for the cloud in its own units."""
        zoom = self.side / FINE_SIZE
        K = view.camera.K.copy()
        K[0, 0] = K[1, 1] = poses.focal[0] * zoom
        # A product of many small turns is a rotation only up to rounding.
        u, _, vt = np.linalg.svd(poses.R[0])
        R = u @ vt
        offset = (poses.centre[0] + 0.5) * zoom + [self.left, self.top] - K[:2, 2]
        t = np.append(offset, K[0, 0]) / (poses.scale[0] * zoom)
        return Camera(K, R, t * unit - R @ centre, view.camera.width, view.camera.height)


def _spread_points(points: Array) -> Array:
    """At most 1,024 of ``points``, in an order of which the first k are spread evenly too."""
    if len(points) > THINNED:
        points = points[np.random.default_rng(0).permutation(len(points))[:THINNED]]
    return points[farthest_point_sample(points, min(SCORED_POINTS, len(points)))]


def _spacing(points: Array) -> float:
    """Median distance of a point to its nearest neighbour."""
    from scipy.spatial import cKDTree

    distance, _ = cKDTree(points).query(points, 2)
    return float(np.median(distance[:, 1]))


def _same_by_symmetry(points: Array, first: Array, second: Array, spacing: float) -> bool:
    """Whether the cloud, rotated by the difference of the two camera rotations, coincides with itself to within its spacing."""
    from scipy.spatial import cKDTree

    turned = points @ (first.T @ second)
    forward, _ = cKDTree(points).query(turned)
    backward, _ = cKDTree(turned).query(points)
    return bool(max(np.square(forward).mean(), np.square(backward).mean()) < spacing**2)
