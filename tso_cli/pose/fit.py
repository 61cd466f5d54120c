"""Pose, distance and focal length of a camera from a mask and a cloud, from many starts."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import InputError
from ..geometry.arrays import Array, Floats
from ..geometry.camera import Camera, intrinsics
from ..geometry.points import as_points, bounding_box_normalisation
from ..geometry.rotations import angle_between, nearest_rotation
from ..geometry.view import View
from .appearance import appearance, decides
from .everywhere import (
    Candidates,
    same_by_symmetry,
    search_everywhere,
    spacing,
    spread_indices,
)
from .levenberg import Freedom
from .placement import FOCAL, SHIFT, TURN, UNKNOWNS, Placements
from .search import EXPLAINED, SURE_GAP, Comparison


class Focal:
    """The prior on the focal length, and the focal lengths that are tried."""

    # In longer sides of the image: 47 degrees, between a phone's main lens (0.75) and the narrow
    # views of renderers (1.9). The deviation is that of its logarithm.
    MEAN, DEVIATION = 1.15, 0.4
    # Tried, in multiples of the best. One fits as well if it misses no larger share of the contour
    # than this beyond what the best misses.
    FACTORS = np.geomspace(1.0 / 3.0, 3.0, 11)
    TOLERANCE = 0.05


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
    focal_range : px, shortest and longest of the focal lengths tried (a third of the best to three
        times it) that fit about as well.
    """

    camera: Camera
    iou: float
    missed: float
    alternatives: tuple[Alternative, ...]
    focal_range: tuple[float, float]

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
            raise InputError(
                f"pose {number} was asked for, expected at most {count}: 1 + {count} poses were "
                "found"
            )
        one = self.alternatives[number - 1]
        own = Alternative(self.camera, self.iou, self.missed, 0.0)
        turned = [
            replace(other, degrees=float(angle_between(other.camera.R, one.camera.R)))
            for other in (own, *self.alternatives)
            if other is not one
        ]
        return replace(
            self,
            camera=one.camera,
            iou=one.iou,
            missed=one.missed,
            alternatives=tuple(turned),
            focal_range=(float(one.camera.K[0, 0]),) * 2,
        )

    @property
    def gap(self) -> float:
        """How much more of the contour the best alternative misses that looks like the photo."""
        rivals = [one.missed for one in self.alternatives if not one.unlike_photo]
        return min(rivals, default=1.0) - self.missed

    @property
    def why_unsure(self) -> str:
        """Why the camera is not sure, if it is not."""
        if self.missed > EXPLAINED:
            return (
                f"the cloud misses {self.missed:.0%} of the mask's contour, "
                f"expected at most {EXPLAINED:.0%}"
            )
        rivals = [one for one in self.alternatives if not one.unlike_photo]
        other = min(rivals, key=lambda one: one.missed)
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
    array = as_points(points)
    if len(array) < FEWEST_POINTS:
        raise InputError(
            f"the cloud holds {len(array)} points, "
            f"expected at least {FEWEST_POINTS} to fit a camera to a mask"
        )
    centre, unit = bounding_box_normalisation(array)
    local = (array - centre) / unit
    shown = np.asarray(mask, dtype=np.float32)
    height, width = shown.shape
    unknowns: list[slice | int] = [TURN, SHIFT]
    if K is None:
        focal = Focal.MEAN * max(width, height) if focal is None else focal
        K = intrinsics(focal, width, height)
        unknowns.append(FOCAL)
    view = View(
        shown, Camera(np.asarray(K, np.float64), np.eye(3), np.zeros(3), width, height), known, name
    )
    deviations = np.full(UNKNOWNS, np.inf)
    if FOCAL in unknowns:
        deviations[FOCAL] = Focal.DEVIATION if deviation is None else deviation
    freedom = replace(Freedom.of(Placements.unmoved(), *unknowns), deviation=deviations)
    comparison = Comparison.of(local, [view])
    found = search_everywhere(comparison, local, [view], freedom)
    seen = np.zeros(len(found.missed))
    if image is not None and colours is not None:
        with_photo = replace(view, image=image)
        seen = appearance(local, np.asarray(colours, np.float64), found.placements, with_photo)
        found, seen = _by_photo(found, seen)
    placements, index = found.placements, spread_indices(local)
    spread = local[index]
    gap = spacing(spread)
    painted = None if colours is None else np.asarray(colours, np.float64)[index]
    degrees = angle_between(placements.R, placements.R[0])
    cameras = [
        _camera(view.camera, placements[i : i + 1], centre, unit) for i in range(len(placements))
    ]
    alternatives = tuple(
        Alternative(
            cameras[i],
            float(found.iou[i]),
            float(found.missed[i]),
            float(degrees[i]),
            decides(float(seen[0]), float(seen[i])),
        )
        for i in range(1, len(placements))
        if not same_by_symmetry(spread, placements.R[0], placements.R[i], gap, painted)
    )
    focal_range = _focal_range(comparison, found) if FOCAL in unknowns else (1.0, 1.0)
    low, high = (float(view.camera.K[0, 0] * factor) for factor in focal_range)
    return FittedCamera(
        cameras[0], float(found.iou[0]), float(found.missed[0]), alternatives, (low, high)
    )


def _by_photo(found: Candidates, seen: Array) -> tuple[Candidates, Array]:
    """The candidates, with the one first that the photo shows to be right, if it fits alike."""
    alike = (found.missed <= found.missed[0] + ALIKE) | (found.iou >= found.iou[0] - ALIKE)
    best = int(np.where(alike, seen, -np.inf).argmax())
    if not decides(float(seen[best]), float(seen[0])):
        return found, seen
    order = np.array([best, *(i for i in range(len(seen)) if i != best)])
    return Candidates(found.placements[order], found.missed[order], found.iou[order]), seen[order]


def _camera(camera: Camera, placement: Placements, centre: Array, unit: float) -> Camera:
    """The camera of the cloud as given, for its one ``placement`` before ``camera``."""
    # The product of many small rotations is a rotation only up to rounding.
    R, K = nearest_rotation(placement.R[0]), camera.K.copy()
    K[:2, :2] *= placement.focal[0]
    return replace(camera, K=K, R=R, t=unit * placement.t[0] - R @ centre)


def _focal_range(comparison: Comparison, found: Candidates) -> tuple[float, float]:
    """The smallest and largest factor of the focal length that fits as well as the best.

    The rest of the pose is fitted to each.
    """
    best = found.placements[np.zeros(len(Focal.FACTORS), np.int64)]
    # The cloud keeps its size in the picture.
    further = Focal.FACTORS[:, None] * [0.0, 0.0, 1.0] + [1.0, 1.0, 0.0]
    held = replace(best, focal=best.focal * Focal.FACTORS, t=best.t * further)
    held, _ = comparison.settled(held, Freedom.of(Placements.unmoved(), TURN, SHIFT))
    as_well = comparison.missed(held) <= found.missed[0] + Focal.TOLERANCE
    factors = np.append(held.focal[as_well], best.focal[0])
    return float(factors.min()), float(factors.max())
