"""What a view shows, in its own axes: the maps that the prior's features are made of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..geometry.arrays import Array, Bits, Box
from ..geometry.camera import Camera
from ..losses.mask_chamfer import MaskTarget
from .features import CELL, GRID, HALF, LEFT_OUT


@dataclass(frozen=True)
class Frame:
    """Where a cloud is and how large: points are taken as (x - centre) / scale."""

    centre: Array  # [3]
    scale: float

    @classmethod
    def of(cls, points: Array) -> Frame:
        """By the box of the ``points`` [N, 3]: of the axes, or of the principal axes if smaller.

        A cloud that lies at an angle to its axes has too large a box there.
        """
        middle = points.mean(0)
        _, principal = np.linalg.eigh(np.cov((points - middle).T))
        found = []
        for axes in (np.eye(3), principal):
            low, high = trimmed_box((points - middle) @ axes)
            found.append((np.prod(high - low), middle + axes @ (low + high) / 2.0, high - low))
        _, centre, extent = min(found, key=lambda one: one[0])
        return cls(centre, float(extent.max()) or 1.0)


def trimmed_box(points: Array) -> tuple[Array, Array]:
    """The box of ``points`` [N, 3] without the outermost `LEFT_OUT` on each side."""
    left_out = int(LEFT_OUT * len(points))
    ordered = np.partition(points, (left_out, len(points) - 1 - left_out), axis=0)
    return ordered[left_out], ordered[-1 - left_out]


@dataclass(frozen=True, eq=False)
class Shown:
    """A view for the prior.

    rotation : [3, 3], from the axes of the cloud to those of the view. closeness : u.
    weight : how much it counts. distance, known : [GRID, GRID].
    cells : [K, 2], the centres of the cells in the foreground.
    """

    rotation: Array
    closeness: float
    weight: float
    distance: Array
    known: Array
    cells: Array

    @classmethod
    def of(
        cls,
        camera: Camera,
        mask: MaskTarget,
        known: Array | None,
        frame: Frame,
        weight: float = 1.0,
    ) -> Shown:
        """``known`` [H, W] is of the cells of the ``mask``, None where all of it is known."""
        middle = camera.R @ frame.centre + camera.t
        rotation, closeness = camera.R, 0.0
        focal = float(np.sqrt(camera.K[0, 0] * camera.K[1, 1]))
        if camera.model == "perspective":
            rotation = turn_to_front(middle) @ camera.R
            away = float(np.linalg.norm(middle))
            closeness, focal = frame.scale / away, focal / away
        centres = (np.arange(GRID) + 0.5) * CELL - HALF
        w = np.stack(np.meshgrid(centres, centres), -1).reshape(-1, 2)
        places, _ = camera.project(frame.centre + frame.scale * w @ rotation[:2])
        height, width = mask.inside.shape
        inner = np.clip(places, 0.0, (width - 1.0, height - 1.0))
        beyond = np.linalg.norm(places - inner, axis=1)
        distance = _bilinear(signed_distance(mask.inside), inner)
        pixel = np.rint(inner).astype(int)
        is_known = np.ones(len(w), bool) if known is None else known[pixel[:, 1], pixel[:, 0]] > 0.5
        if mask.truncated:
            # Beyond the border of the picture the object may go on.
            is_known &= mask.in_image(places)
            beyond = np.where(mask.in_image(places), beyond, 0.0)
        distance = (distance + beyond) / (focal * frame.scale)
        cells = w[(distance < 0.0) & is_known]
        distance, shown = distance.reshape(GRID, GRID), is_known.reshape(GRID, GRID)
        return cls(rotation, closeness, weight, distance, shown.astype(float), cells)


def turn_to_front(direction: Array) -> Array:
    """The least rotation [3, 3] that turns a ``direction`` [3] to the z axis."""
    x, y, z = direction / np.linalg.norm(direction)
    if z <= -1.0 + 1e-9:
        return np.diag([1.0, -1.0, -1.0])
    across = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])
    turned: Array = np.eye(3) + across + across @ across / (1.0 + z)
    return turned


def signed_distance(inside: Bits) -> Array:
    """[H, W] cells from each cell to the outline of ``inside`` [H, W], negative inside."""
    outside = _distance_to(inside) - 0.5
    return np.where(inside, 0.5 - _distance_to(~inside), outside)


def _distance_to(marked: Bits) -> Array:
    """[H, W] cells to the nearest of the ``marked`` cells; far where there are none."""
    height, width = marked.shape
    if not marked.any():
        return np.full(marked.shape, float(height + width))
    box: Box = (-0.5, -0.5, width - 0.5, height - 0.5)
    nearest = MaskTarget(marked, ~marked, box).nearest_foreground
    return np.hypot(
        nearest[..., 0] - np.arange(height)[:, None], nearest[..., 1] - np.arange(width)
    )


def _bilinear(values: Array, places: Array) -> Array:
    """``values`` [H, W] at ``places`` [N, 2], which are within them."""
    height, width = values.shape
    x = np.minimum(places[:, 0].astype(int), width - 2)
    y = np.minimum(places[:, 1].astype(int), height - 2)
    right, down = (places - np.stack([x, y], 1)).T
    upper = (1.0 - right) * values[y, x] + right * values[y, x + 1]
    lower = (1.0 - right) * values[y + 1, x] + right * values[y + 1, x + 1]
    found: Array = (1.0 - down) * upper + down * lower
    return found
