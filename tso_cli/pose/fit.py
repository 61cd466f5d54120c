"""Pose, distance and focal length of a camera from a mask and a cloud, from many starts."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from ..geometry.arrays import Array
from ..geometry.camera import CANONICAL_FOCAL_AT_64, Camera
from ..geometry.points import as_points, bounding_box_normalisation, farthest_point_sample
from ..geometry.resampling import area_resize
from ..geometry.rotations import angle_between
from ..geometry.view import View
from .alignment import Poses, Target, improve
from .starts import closed_iou, distinct, starts


class Focal:
    """The prior on the focal length, and the focal lengths that are tried."""

    MEAN = CANONICAL_FOCAL_AT_64 / 64.0  # in longer sides of the image
    DEVIATION = 0.35  # standard deviation of the logarithm
    # Tried, in multiples of the prior's. One fits as well if it loses less IoU than the tolerance.
    FACTORS = np.array([0.5, 0.7, 1.0, 1.4, 2.0])
    IOU_TOLERANCE = 0.01


# Largest difference of fx and fy, as a share, of pixels that a fit takes as square.
SQUARE = 0.02


class Points:
    """Numbers of points of a cloud."""

    FEWEST = 16
    # Larger clouds are thinned at random before farthest points are chosen, to save time.
    THINNED = 4096
    SCORED = 1024  # in the end


@dataclass(frozen=True)
class _Search:
    """One of the two searches, each faster or finer than the other."""

    size: int  # side of the square, px
    points: int  # of the cloud
    poses: int  # most poses that are improved
    degrees: float  # a pose within this angle of a better one is dropped
    steps: int  # of Gauss-Newton
    robust: float  # scale of distances, px


COARSE = _Search(size=32, points=256, poses=48, degrees=20.0, steps=12, robust=6.0)
FINE = _Search(size=64, points=512, poses=12, degrees=10.0, steps=20, robust=4.0)


@dataclass(frozen=True)
class Alternative:
    """Another pose that fits: its camera, its IoU, and its angle to the best pose in degrees."""

    camera: Camera
    iou: float
    degrees: float


@dataclass(frozen=True)
class FittedCamera:
    """A perspective camera fitted to mask and cloud, and its confidence.

    The principal point is in the middle of the image.

    iou : IoU of mask and cloud, both dilated by the distance between points to close the gaps of
        the cloud.
    confidence : ``iou`` minus the IoU of the best alternative.
    alternatives : other poses, best first. They lie over 20 degrees from the best pose and from
        each other, and are no symmetry of the cloud.
    focal_range : px, shortest and longest of the focal lengths tried (half to twice the prior)
        whose IoU is within 0.01.
    """

    camera: Camera
    iou: float
    confidence: float
    alternatives: tuple[Alternative, ...]
    focal_range: tuple[float, float]

    # A sure pose has at least this IoU, and exceeds the IoU of the best alternative by this gap.
    SURE_IOU, SURE_GAP = 0.75, 0.05

    def describe(self) -> str:
        """One line for the log."""
        toward = np.clip(-self.camera.R[2], -1.0, 1.0)
        azimuth = math.degrees(math.atan2(toward[0], toward[2])) % 360.0
        elevation = math.degrees(math.asin(toward[1]))
        other = "no other pose fits"
        if self.alternatives:
            best = self.alternatives[0]
            other = f"next best {best.iou:.2f} at {best.degrees:.0f} degrees"
        low, high = self.focal_range
        fit_as_well = f" ({low:.4g} to {high:.4g} fit as well)" if high > 1.1 * low else ""
        return (
            f"fitted, IoU {self.iou:.2f}, azimuth {azimuth:.0f}, elevation {elevation:.0f} (y up); "
            f"{other}: {'sure' if self.sure else 'unsure'}; "
            f"focal length {self.camera.K[0, 0]:.4g} px{fit_as_well}"
        )

    @property
    def sure(self) -> bool:
        """Whether the camera fits well, and no alternative fits about as well."""
        return self.iou >= self.SURE_IOU and self.confidence >= self.SURE_GAP

    @property
    def why_unsure(self) -> str:
        """Why the camera is not sure, if it is not."""
        if self.iou < self.SURE_IOU or not self.alternatives:
            return (
                f"it brings the cloud onto the mask with an IoU of {self.iou:.3f}, "
                f"expected at least {self.SURE_IOU}"
            )
        other = self.alternatives[0]
        return (
            f"a camera turned by {other.degrees:.0f} degrees fits about as well "
            f"(IoU {other.iou:.2f}, its own {self.iou:.2f})"
        )


def fit_camera(
    points: ArrayLike,
    mask: ArrayLike,
    known: NDArray[np.bool_] | None = None,
    focal: float | None = None,
    name: str = "mask",
    K: ArrayLike | None = None,
) -> FittedCamera:
    """Find the camera that projects ``points`` [N, 3] onto the mask [H, W] in [0, 1].

    1. 2,700 poses over all directions are scored by coarse silhouettes.
    2. The best 48 distinct poses are improved by Gauss-Newton steps on nearest neighbours in the
       image.
    3. The best 12 of them are improved at twice the resolution.

    The result depends on the arguments alone.

    Parameters
    ----------
    known : [H, W], False at ignored pixels.
    focal : mean of the prior on the focal length, px; None for the canonical camera's, 1.875 times
        the longer side of the image.
    K : [3, 3], if the intrinsics are known; then only the pose is fitted.

    Raises InputError if the cloud has no extent or under 16 points, the mask has no object or no
    background, or the pixels of K are not square.
    """
    array = as_points(points)
    if len(array) < Points.FEWEST:
        raise InputError(
            f"the cloud holds {len(array)} points, "
            f"expected at least {Points.FEWEST} to fit a camera to a mask"
        )
    centre, unit = bounding_box_normalisation(array)
    local = _spread_points((array - centre) / unit)
    image = np.asarray(mask, dtype=np.float32)
    height, width = image.shape
    camera, deviation = Camera.canonical(width, height), Focal.DEVIATION
    if K is not None:
        camera, deviation = replace(camera, K=np.asarray(K)), 0.0
        fx, fy = camera.K[0, 0], camera.K[1, 1]
        if abs(fx - fy) > SQUARE * fx:
            raise InputError(f"K has fx = {fx:g} and fy = {fy:g}, expected square pixels for a fit")
        focal = float(fx + fy) / 2.0
    view = View(image, camera, known, name)
    crop = _Crop.around(view)
    focal = Focal.MEAN * max(width, height) if focal is None else focal

    coarse, fine = crop.target(view, COARSE.size), crop.target(view, FINE.size)
    zoom = FINE.size / COARSE.size
    coarse_focal = focal * COARSE.size / crop.side
    fine_focal = coarse_focal * zoom
    fine_points, coarse_points = local[: FINE.points], local[: COARSE.points]
    poses, score = starts(fine_points, coarse, coarse_focal)
    poses = poses[distinct(poses, score, COARSE.degrees, COARSE.poses)]
    prior = coarse_focal, deviation
    poses = improve(coarse_points, poses, coarse, COARSE.steps, prior, COARSE.robust)
    score = closed_iou(fine_points, poses, coarse, _spacing(fine_points))
    poses = poses[distinct(poses, score, FINE.degrees, FINE.poses)].resized(zoom)
    prior = fine_focal, deviation
    poses = improve(fine_points, poses, fine, FINE.steps, prior, FINE.robust)
    spacing = _spacing(local)
    score = closed_iou(local, poses, fine, spacing)
    order = distinct(poses, score, degrees=20.0, count=len(poses))
    poses, score = poses[order], score[order]

    cameras = [crop.camera(poses[i : i + 1], view, centre, unit) for i in range(len(poses))]
    ious, degrees = score.tolist(), angle_between(poses.R, poses.R[0]).tolist()
    alternatives = tuple(
        Alternative(cameras[i], ious[i], degrees[i])
        for i in range(1, len(poses))
        if not _same_by_symmetry(local, poses.R[0], poses.R[i], spacing)
    )
    if K is not None:
        gap = ious[0] - alternatives[0].iou if alternatives else ious[0]
        cameras = [replace(one, K=camera.K) for one in cameras[:1]]
        return FittedCamera(cameras[0], ious[0], gap, alternatives, (focal, focal))
    # Focal lengths that fit as well after the rest of the pose is fitted to them.
    repeats = np.zeros(len(Focal.FACTORS), dtype=np.int64)
    fixed = replace(poses[repeats], focal=fine_focal * Focal.FACTORS)
    fixed = improve(fine_points, fixed, fine, FINE.steps // 2, (fixed.focal, 0.0), FINE.robust)
    fits = closed_iou(local, fixed, fine, spacing) >= ious[0] - Focal.IOU_TOLERANCE
    focal_lengths = np.append(fixed.focal[fits], poses.focal[0]) * crop.side / FINE.size
    return FittedCamera(
        cameras[0],
        ious[0],
        ious[0] - alternatives[0].iou if alternatives else ious[0],
        alternatives,
        (float(focal_lengths.min()), float(focal_lengths.max())),
    )


@dataclass(frozen=True)
class _Crop:
    """A square of the image around the object: left and top edge, and side, px.

    The side is 1.3 longer sides of the mask's box, so that poses beyond the mask can be scored.
    """

    left: float
    top: float
    side: float

    @classmethod
    def around(cls, view: View) -> _Crop:
        left, top, right, bottom = view.box()
        side = max(right - left, bottom - top) * 1.3
        return cls((left + right - side) / 2.0, (top + bottom - side) / 2.0, side)

    def target(self, view: View, size: int) -> Target:
        box = (self.left, self.top, self.left + self.side, self.top + self.side)
        mask, known = area_resize(view.mask, box, size, size, weights=view.known)
        principal = (view.camera.K[:2, 2] - [self.left, self.top]) * (size / self.side) - 0.5
        return Target(mask, known, principal, view.truncated)

    def camera(self, poses: Poses, view: View, centre: Array, unit: float) -> Camera:
        """The one pose, of the fine target, as a camera of the image for the cloud as given."""
        zoom = self.side / FINE.size
        K = view.camera.K.copy()
        K[0, 0] = K[1, 1] = poses.focal[0] * zoom
        # The product of many small rotations is a rotation only up to rounding.
        u, _, vt = np.linalg.svd(poses.R[0])
        R = u @ vt
        offset = (poses.centre[0] + 0.5) * zoom + [self.left, self.top] - K[:2, 2]
        t = np.append(offset, K[0, 0]) / (poses.scale[0] * zoom)
        return Camera(K, R, t * unit - R @ centre, view.camera.width, view.camera.height)


def _spread_points(points: Array) -> Array:
    """At most 1,024 of ``points``; for every k the first k of them are spread evenly."""
    if len(points) > Points.THINNED:
        points = points[np.random.default_rng(0).permutation(len(points))[: Points.THINNED]]
    return points[farthest_point_sample(points, min(Points.SCORED, len(points)))]


def _spacing(points: Array) -> float:
    """Median distance from a point to its nearest neighbour."""
    from scipy.spatial import cKDTree

    distance, _ = cKDTree(points).query(points, 2)
    return float(np.median(distance[:, 1]))


def _same_by_symmetry(points: Array, first: Array, second: Array, spacing: float) -> bool:
    """Whether the cloud looks the same to cameras with the rotations ``first`` and ``second``.

    Rotated by the difference of the two rotations it then coincides with itself to within its
    spacing.
    """
    from scipy.spatial import cKDTree

    turned = points @ (first.T @ second)
    forward, _ = cKDTree(points).query(turned)
    backward, _ = cKDTree(turned).query(points)
    return bool(max(np.square(forward).mean(), np.square(backward).mean()) < spacing**2)
