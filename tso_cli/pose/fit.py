"""Pose, distance and focal length of a camera from a mask and a cloud, by search from many starts."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from ..geometry.camera import CANONICAL_FOCAL_AT_64, Camera
from ..geometry.points import as_points, bounding_box_normalisation, farthest_point_sample
from ..geometry.resampling import area_resize
from ..geometry.rotations import angle_between
from ..geometry.view import View
from .alignment import Poses, Target, improve
from .starts import apart, closed_iou, starts

Array = NDArray[np.float64]

# The canonical camera's focal length, as a multiple of the image's longer side, and how far the logarithm may well be off.
FOCAL = CANONICAL_FOCAL_AT_64 / 64.0
FOCAL_DEVIATION = 0.35
# Side of the square around the object, in sides of the mask's box.
MARGIN = 1.3
# The square's side in pixels, the points used and the Gauss-Newton steps of the search and of its end.
SEARCH_SIZE, SEARCH_POINTS, SEARCH_STEPS = 32, 256, 12
FINE_SIZE, FINE_POINTS, FINE_STEPS = 64, 512, 20
SCORED_POINTS, FEWEST_POINTS = 1024, 16
# Poses followed in the search, and how many of them to the end; those nearer than this to a better one are its doubles.
FOLLOWED, FINISHED = 48, 12
START_DOUBLES, DOUBLES = 20.0, 10.0
# Poses farther apart than this are different answers.
DIFFERENT = 20.0
# Clouds are thinned to this before farthest points are chosen.
THINNED = 4096
# A pose is sure if its IoU is at least the first and that of the next best answer is lower by the second.
SURE_IOU, SURE_GAP = 0.75, 0.05
# Focal lengths tried, in multiples of the prior, and the loss of IoU up to which one fits as well.
FOCAL_FACTORS = np.array([0.5, 0.7, 1.0, 1.4, 2.0])
AS_WELL = 0.01


@dataclass(frozen=True)
class Alternative:
    """Another pose that fits: its camera, its IoU, and how far from the best it is turned, in degrees."""

    camera: Camera
    iou: float
    degrees: float


@dataclass(frozen=True)
class FittedCamera:
    """A camera found from mask and cloud, and how sure it is.

    Attributes
    ----------
    camera : perspective, principal point in the middle of the image.
    iou : of mask and cloud, both widened by the distance between points, so that the cloud's gaps do not count.
    confidence : ``iou`` less that of the best alternative; small where the mask does not tell them apart.
    alternatives : poses over 20 degrees from the best (and from each other) that are no symmetry of the cloud, best first.
    focal_range : px, shortest and longest of the focal lengths tried (half to twice the prior) that fit as well (IoU within
        0.01) once the rest of the pose is fitted to them. Wide: the mask does not say how strong the perspective is.
    """

    camera: Camera
    iou: float
    confidence: float
    alternatives: tuple[Alternative, ...]
    focal_range: tuple[float, float]

    def describe(self) -> str:
        """In words, for the log."""
        toward = np.clip(-self.camera.R[2], -1.0, 1.0)
        azimuth, elevation = math.degrees(math.atan2(toward[0], toward[2])) % 360.0, math.degrees(math.asin(toward[1]))
        focal, (low, high) = self.camera.K[0, 0], self.focal_range
        words = f"fitted, IoU {self.iou:.2f}, azimuth {azimuth:.0f}, elevation {elevation:.0f} (y up); "
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
        """Why it is not sure, in words."""
        if self.iou < SURE_IOU or not self.alternatives:
            return f"it brings the cloud onto the mask with an IoU of {self.iou:.3f}, which is sure from {SURE_IOU} on"
        other = self.alternatives[0]
        return f"one turned by {other.degrees:.0f} degrees fits about as well (IoU {other.iou:.2f}, its own {self.iou:.2f})"


def fit_camera(
    points: ArrayLike, mask: ArrayLike, known: NDArray[np.bool_] | None = None, focal: float | None = None, name: str = "mask"
) -> FittedCamera:
    """Find the camera that sees ``points`` where the mask is.

    2,700 poses over all directions are scored by coarse silhouettes; the best 48 that differ are improved by Gauss-Newton on
    two-way nearest neighbours (every mask pixel draws the nearest projected point, every stray point goes to the nearest mask
    pixel), then the best 12 at twice the resolution. No random numbers decide.

    Parameters
    ----------
    points : [N, 3], any unit; at least 16.
    mask : [H, W] in [0, 1]. known : [H, W], False where it says nothing.
    focal : px, about which the focal length is held (standard deviation 0.35 of its logarithm); None for the canonical 1.875
        times the longer side of the image.
    name : what messages call the mask.

    Returns
    -------
    FittedCamera, for the frame and unit of ``points``. Size and distance are fixed by those.

    Raises
    ------
    InputError
        The cloud has no extent or under 16 points, or the mask no object or no background.
    """
    array = as_points(points)
    if len(array) < FEWEST_POINTS:
        raise InputError(f"the cloud holds {len(array)} points, expected at least {FEWEST_POINTS} to fit a camera to a mask")
    centre, unit = bounding_box_normalisation(array)
    local = _spread_points((array - centre) / unit)
    image = np.asarray(mask, dtype=np.float32)
    if image.ndim != 2:
        raise InputError(f"{name}: mask has shape {list(image.shape)}, expected [H, W]")
    height, width = image.shape
    view = View(image, Camera.canonical(width, height), known, name)
    crop = _Crop.around(view)
    prior = focal if focal is not None else FOCAL * max(width, height)

    coarse, fine = crop.target(view, SEARCH_SIZE), crop.target(view, FINE_SIZE)
    held = prior * SEARCH_SIZE / crop.side, FOCAL_DEVIATION
    some, fewer = local[:FINE_POINTS], local[:SEARCH_POINTS]
    poses, score = starts(some, coarse, held[0])
    poses = improve(fewer, poses[apart(poses, score, START_DOUBLES, FOLLOWED)], coarse, SEARCH_STEPS, held, 6.0)
    score = closed_iou(some, poses, coarse, _spacing(some))
    zoom = FINE_SIZE / SEARCH_SIZE
    poses, held = poses[apart(poses, score, DOUBLES, FINISHED)].resized(zoom), (held[0] * zoom, FOCAL_DEVIATION)
    poses = improve(some, poses, fine, FINE_STEPS, held, 4.0)
    reach = _spacing(local)
    score = closed_iou(local, poses, fine, reach)
    order = apart(poses, score, DIFFERENT, len(poses))
    poses, score = poses[order], score[order]

    others = [i for i in range(1, len(poses)) if not _same_by_symmetry(local, poses.R[0], poses.R[i], reach)]
    best = poses[:1]
    alternatives = tuple(
        Alternative(
            crop.camera(poses[i : i + 1], view, centre, unit), float(score[i]), float(angle_between(poses.R[i], poses.R[0]))
        )
        for i in others
    )
    return FittedCamera(
        crop.camera(best, view, centre, unit),
        float(score[0]),
        float(score[0] - score[others[0]]) if others else float(score[0]),
        alternatives,
        crop.in_pixels(_focal_range(local, some, best, fine, held[0], float(score[0]), reach)),
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
        left, top, right, bottom = view.box()
        cut = left < 0 or top < 0 or right > view.camera.width - 1 or bottom > view.camera.height - 1
        return Target(mask, known, (middle - [self.left, self.top]) * (size / self.side) - 0.5, cut)

    def in_pixels(self, lengths: Array) -> tuple[float, float]:
        """The shortest and longest of ``lengths``, taken from the fine target's pixels to the image's."""
        return float(lengths.min()) * self.side / FINE_SIZE, float(lengths.max()) * self.side / FINE_SIZE

    def camera(self, poses: Poses, view: View, centre: Array, unit: float) -> Camera:
        """The one pose, of the fine target, as a camera of the image that sees the cloud in its own units."""
        zoom = self.side / FINE_SIZE
        K = view.camera.K.copy()
        K[0, 0] = K[1, 1] = poses.focal[0] * zoom
        at = (poses.centre[0] + 0.5) * zoom + [self.left, self.top]
        # The product of many small turns, made a rotation to the last bit.
        u, _, vt = np.linalg.svd(poses.R[0])
        R = u @ vt
        t = np.append(at - K[:2, 2], K[0, 0]) / (poses.scale[0] * zoom)
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
    """Whether the cloud, turned as the two camera rotations differ, lies on itself to within its own spacing."""
    from scipy.spatial import cKDTree

    turned = points @ (first.T @ second)
    there, _ = cKDTree(points).query(turned)
    back, _ = cKDTree(turned).query(points)
    return bool(max(np.square(there).mean(), np.square(back).mean()) < spacing**2)


def _focal_range(points: Array, some: Array, best: Poses, target: Target, prior: float, score: float, reach: float) -> Array:
    """The focal lengths, px of the target, that fit as well as the best pose once the rest is fitted to them."""
    count = len(FOCAL_FACTORS)
    R, centre, scale = (np.repeat(part, count, 0) for part in (best.R, best.centre, best.scale))
    tried = Poses(R, centre, scale, prior * FOCAL_FACTORS)
    fitted = improve(some, tried, target, FINE_STEPS // 2, (tried.focal, 0.0), 4.0)
    fits = closed_iou(points, fitted, target, reach) >= score - AS_WELL
    return np.append(fitted.focal[fits], best.focal)
