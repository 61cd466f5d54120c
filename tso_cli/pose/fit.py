"""Pose, distance and focal length of a camera from a mask and a cloud, from many starts."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from ..geometry.arrays import Array, Floats, Indices
from ..geometry.camera import Camera, intrinsics
from ..geometry.points import as_points, bounding_box_normalisation
from ..geometry.rotations import angle_between, nearest_rotation
from ..geometry.view import View, as_mask
from .appearance import appearance, decides
from .everywhere import Poses, search_everywhere, spread_indices, unlike_first
from .levenberg import Freedom
from .move import PoseDeviation
from .placement import FOCAL, SHIFT, TURN, UNKNOWNS, Placements
from .placing import deviation_of
from .search import EXPLAINED, SURE_GAP, Comparison

# The prior on the focal length in longer sides of the image: 47 degrees, between a phone's main
# lens (0.75) and the narrow views of renderers (1.9). The deviation is that of its logarithm.
FOCAL_MEAN, FOCAL_DEVIATION = 1.15, 0.4
# Focal lengths that are tried, in multiples of the best. One fits as well if it misses no larger
# share of the contour than this beyond what the best misses.
FOCAL_FACTORS, FOCAL_TOLERANCE = np.geomspace(1.0 / 3.0, 3.0, 11), 0.05
FEWEST_POINTS = 16
# Poses that differ by less fit a mask alike: of the share that they miss, or of the IoU.
ALIKE = 0.1


@dataclass(frozen=True)
class Alternative:
    """Another pose that fits: its camera, its IoU, and its angle to the best pose in degrees."""

    camera: Camera
    iou: float
    missed: float
    degrees: float
    unlike_photo: bool = False  # whether the photo shows that the first pose is right


@dataclass(frozen=True)
class FittedCamera:
    """A perspective camera fitted to mask and cloud, and its confidence.

    The principal point is in the middle of the image.

    iou : IoU of mask and cloud, both dilated by the distance between points to close the gaps of
        the cloud.
    missed : the share of the mask's contour that the cloud misses (`Comparison.missed`).
    alternatives : other poses, best first. They lie over 20 degrees from the best pose and from
        each other, and are no symmetry of the cloud.
    exact_to : how exact the pose is, along the axes of the camera; None if the cloud does not fit,
        and for the alternatives.
    focal_range : px, shortest and longest of the focal lengths tried (a third of the best to three
        times it) that fit about as well.
    """

    camera: Camera
    iou: float
    missed: float
    alternatives: tuple[Alternative, ...]
    focal_range: tuple[float, float]
    exact_to: PoseDeviation | None = None

    def describe(self) -> str:
        """One line for the log."""
        toward = np.clip(-self.camera.R[2], -1.0, 1.0)
        azimuth = math.degrees(math.atan2(toward[0], toward[2])) % 360.0
        elevation = math.degrees(math.asin(toward[1]))
        other = "no other pose fits"
        if self.alternatives:
            best = self.alternatives[0]
            other = f"next best {best.iou:.2f} at {best.degrees:.0f} degrees"
        return (
            f"fitted, IoU {self.iou:.2f}, azimuth {azimuth:.0f}, elevation {elevation:.0f} (y up); "
            f"{other}: {'sure' if self.sure else 'unsure'}; {self.focal_length}"
        )

    @property
    def focal_length(self) -> str:
        """In words, with the range that fits as well."""
        low, high = self.focal_range
        fit_as_well = f" ({low:.4g} to {high:.4g} fit as well)" if high > 1.1 * low else ""
        return f"focal length {self.camera.K[0, 0]:.4g} px{fit_as_well}"

    @property
    def sure(self) -> bool:
        """Whether the camera fits well, and no alternative fits about as well."""
        return self.missed <= EXPLAINED and self.gap >= SURE_GAP

    def chosen(self, number: int) -> FittedCamera:
        """The alternative of that ``number``, as the fitted camera; 0 for this one.

        Raises InputError if there is none.
        """
        if number == 0:
            return self
        if number > len(self.alternatives):
            count = len(self.alternatives)
            raise InputError(f"`pose_index` is {number}, expected at most {count}")
        best = self.alternatives[number - 1]
        first = Alternative(self.camera, self.iou, self.missed, 0.0)
        alternatives = tuple(
            replace(other, degrees=float(angle_between(other.camera.R, best.camera.R)))
            for other in (first, *self.alternatives)
            if other is not best
        )
        focal = float(best.camera.K[0, 0])
        return FittedCamera(best.camera, best.iou, best.missed, alternatives, (focal, focal))

    @property
    def rivals(self) -> list[Alternative]:
        """The alternatives that look like the photo."""
        return [other for other in self.alternatives if not other.unlike_photo]

    @property
    def gap(self) -> float:
        """How much more of the contour the best alternative misses that looks like the photo."""
        return min((rival.missed for rival in self.rivals), default=1.0) - self.missed

    @property
    def why_unsure(self) -> str:
        """Why the camera is not sure, if it is not."""
        if self.missed > EXPLAINED:
            return (
                f"the cloud misses {self.missed:.0%} of the mask's contour, "
                f"expected at most {EXPLAINED:.0%}"
            )
        rival = min(self.rivals, key=lambda rival: rival.missed)
        return (
            f"a camera turned by {rival.degrees:.0f} degrees fits about as well "
            f"(IoU {rival.iou:.2f}, its own {self.iou:.2f})"
        )


def fit_camera(
    points: ArrayLike,
    mask: ArrayLike,
    known: NDArray[np.bool_] | None = None,
    focal: float | None = None,
    name: str = "mask",
    K: ArrayLike | None = None,
    deviation: float | None = None,
    image: Floats | None = None,
    colours: Floats | None = None,
) -> FittedCamera:
    """Find the camera that projects ``points`` [N, 3] onto the mask [H, W] in [0, 1].

    The search is `search_everywhere`. The result depends on the arguments alone.

    Parameters
    ----------
    known : [H, W], False at ignored pixels.
    focal : mean of the prior on the focal length, px; None for 1.15 times the longer side of the
        image.
    K : [3, 3], if the intrinsics are known; then only the pose is fitted.
    deviation : standard deviation of the logarithm of the focal length by the prior; None for 0.4.
    image, colours : the photo [H, W, 3] and the colours of the points [N, 3], in [0, 1]; they tell
        poses apart that fit the mask alike (`appearance`).

    Raises InputError if the cloud has no extent or under 16 points, the mask has no object or no
    background, or the pixels of K are not square.
    """
    cloud = as_points(points)
    if len(cloud) < FEWEST_POINTS:
        raise InputError(
            f"the cloud holds {len(cloud)} points, "
            f"expected at least {FEWEST_POINTS} to fit a camera to a mask"
        )
    centre, unit = bounding_box_normalisation(cloud)
    normalised = (cloud - centre) / unit
    pixels = as_mask(mask, name)
    height, width = pixels.shape
    unknowns: list[slice | int] = [TURN, SHIFT]
    deviations = np.full(UNKNOWNS, np.inf)
    if K is None:
        K = intrinsics(FOCAL_MEAN * max(width, height) if focal is None else focal, width, height)
        unknowns.append(FOCAL)
        deviations[FOCAL] = FOCAL_DEVIATION if deviation is None else deviation
    camera = Camera(np.asarray(K, np.float64), np.eye(3), np.zeros(3), width, height)
    view = View(pixels, camera, known, name)
    freedom = Freedom.of(Placements.unmoved(), *unknowns, deviation=deviations)
    comparison = Comparison.of(normalised, [view])
    index = spread_indices(normalised)
    candidates = search_everywhere(comparison, normalised[index], [view], freedom)
    likeness = np.zeros(len(candidates.missed))
    paint = None if colours is None else np.asarray(colours, np.float64)
    if image is not None and paint is not None:
        photo = replace(view, image=image)
        likeness = appearance(normalised, paint, candidates.placements, photo)
        order = _order_by_photo(candidates, likeness)
        candidates, likeness = candidates[order], likeness[order]
    R = candidates.placements.R
    degrees = angle_between(R, R[0])
    cameras = [
        _camera(camera, candidates.placements[i : i + 1], centre, unit) for i in range(len(R))
    ]
    alternatives = tuple(
        Alternative(
            cameras[i],
            iou=float(candidates.iou[i]),
            missed=float(candidates.missed[i]),
            degrees=float(degrees[i]),
            unlike_photo=decides(float(likeness[0]), float(likeness[i])),
        )
        for i in unlike_first(normalised[index], R, None if paint is None else paint[index])
    )
    exact_to = None
    if candidates.missed[0] < EXPLAINED:
        exact_to = deviation_of(
            comparison, candidates.placements[:1], freedom, normalised[index], unit
        )
    factors = _focal_factors(comparison, candidates) if FOCAL in unknowns else np.ones(1)
    return FittedCamera(
        cameras[0],
        float(candidates.iou[0]),
        float(candidates.missed[0]),
        alternatives,
        focal_range=(
            float(camera.K[0, 0] * float(factors.min())),
            float(camera.K[0, 0] * float(factors.max())),
        ),
        exact_to=exact_to,
    )


def _order_by_photo(candidates: Poses, likeness: Array) -> Indices:
    """The order of the candidates with the one first that the photo shows to be right.

    It is one of those that fit about as well as the best. ``likeness`` : their `appearance` [P].
    """
    fits = candidates.missed <= candidates.missed[0] + ALIKE
    fits |= candidates.iou >= candidates.iou[0] - ALIKE
    best = int(np.where(fits, likeness, -np.inf).argmax())
    if not decides(float(likeness[best]), float(likeness[0])):
        best = 0
    return np.array([best, *(i for i in range(len(likeness)) if i != best)])


def _camera(camera: Camera, placement: Placements, centre: Array, unit: float) -> Camera:
    """The camera of the cloud as given, for its one ``placement`` before ``camera``."""
    # The product of many small rotations is a rotation only up to rounding.
    R, K = nearest_rotation(placement.R[0]), camera.K.copy()
    K[:2, :2] *= placement.focal[0]
    return replace(camera, K=K, R=R, t=unit * placement.t[0] - R @ centre)


def _focal_factors(comparison: Comparison, candidates: Poses) -> Array:
    """The factors of the focal length that fit as well as the best, and that of the best.

    The rest of the pose is fitted to each.
    """
    best = candidates.placements[np.zeros(len(FOCAL_FACTORS), np.int64)]
    # The cloud keeps its size in the picture.
    further = FOCAL_FACTORS[:, None] * [0.0, 0.0, 1.0] + [1.0, 1.0, 0.0]
    starts = replace(best, focal=best.focal * FOCAL_FACTORS, t=best.t * further)
    placements, _ = comparison.settled(starts, Freedom.of(Placements.unmoved(), TURN, SHIFT))
    as_well = comparison.missed(placements) <= candidates.missed[0] + FOCAL_TOLERANCE
    return np.append(placements.focal[as_well], best.focal[0])
