"""Which further mask of an object would determine most of its shape."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..evaluation.footprint import footprint
from ..geometry.arrays import Array
from ..geometry.camera import Camera
from ..geometry.rotations import from_vectors
from ..geometry.window import MARGIN, window_around
from ..losses.mask_chamfer import MaskTarget
from ..optimisation.objective import ViewTarget
from ..optimisation.resampled_view import CELLS
from .determined import Evidence, normal_blocks

# Where a further camera may stand: degrees to the right of the first camera, and above it.
DIRECTIONS: list[tuple[int, int]] = [
    *((azimuth, elevation) for elevation in (0, 45, -45) for azimuth in range(-135, 181, 45)),
    (0, 90),
]
DIRECTIONS.remove((0, 0))


@dataclass(frozen=True, eq=False)
class BestView:
    """Where a further mask is expected to determine most.

    azimuth, elevation : degrees to the right of the first camera and above it, around the object.
    camera : the first one, there, at the same distance. determined : with such a mask.
    """

    azimuth: int
    elevation: int
    camera: Camera
    determined: float


def best_view(evidence: Evidence, normalised: Camera, camera: Camera, centre: Array) -> BestView:
    """The one of `DIRECTIONS` whose mask of the cloud as it is determines most.

    ``normalised`` is the first camera for normalised points; ``camera`` is the same for the result,
    whose ``centre`` [3] is the origin of the normalised points.
    """
    shares = [expected_share(evidence, around(normalised, *where)) for where in DIRECTIONS]
    best = int(np.argmax(shares))
    where = DIRECTIONS[best]
    return BestView(*where, around(camera, *where, centre), shares[best])


def expected_share(evidence: Evidence, camera: Camera) -> float:
    """The mean confidence with a mask of the cloud as it is; without one where it is not seen."""
    pixels, _, visible = camera.project_visible(evidence.points)
    blocks: Array | float = 0.0
    if visible.any():
        low, high = pixels[visible].min(0), pixels[visible].max(0)
        margin = MARGIN * float((high - low).max())
        (left, top), (right, bottom) = (low - margin).tolist(), (high + margin).tolist()
        camera = camera.cropped(window_around((left, top, right, bottom)), CELLS, CELLS)
        mask = MaskTarget.of(footprint(evidence.points, camera).astype(float))
        view = ViewTarget(camera, mask, None, 1.0)
        blocks = normal_blocks(evidence.points, view)
    return float(evidence.confidence(blocks).mean())


def around(camera: Camera, azimuth: float, elevation: float, centre: Array | None = None) -> Camera:
    """``camera`` on its way around ``centre`` [3] (default: the origin), which it sees unmoved."""
    right, up = np.radians([azimuth, elevation])
    turn = from_vectors(np.array([up, 0.0, 0.0])) @ from_vectors(np.array([0.0, right, 0.0]))
    middle = camera.t if centre is None else camera.R @ centre + camera.t
    return replace(camera, R=turn @ camera.R, t=turn @ (camera.t - middle) + middle)
