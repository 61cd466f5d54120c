"""What a view shows, in its own axes: the maps that the prior's features are made of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..evaluation.footprint import footprint
from ..geometry.arrays import Array, Bits, Box, Indices
from ..geometry.camera import NEAR, Camera
from ..losses.mask_chamfer import MaskTarget
from .features import CELL, FAR, GRID, HALF, LEFT_OUT

# Added to each side of a box of longest side 1 before its volume is taken.
THIN = 1e-3


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
        _, principal = np.linalg.eigh((points - middle).T @ (points - middle))
        frames = []
        for axes in (np.eye(3), principal):
            low, high = trimmed_box((points - middle) @ axes)
            extent = high - low
            scale = float(extent.max()) or 1.0
            # A flat cloud has an area in place of a volume.
            volume = np.prod(extent / scale + THIN) * scale**3
            frames.append((volume, cls(middle + axes @ (low + high) / 2.0, scale)))
        return min(frames, key=lambda one: one[0])[1]


def trimmed_box(points: Array) -> tuple[Array, Array]:
    """The box of ``points`` [N, 3] without the outermost `LEFT_OUT` on each side."""
    left_out = int(LEFT_OUT * len(points))
    ordered = np.partition(points, (left_out, len(points) - 1 - left_out), axis=0)
    return ordered[left_out], ordered[-1 - left_out]


@dataclass(frozen=True, eq=False)
class Shown:
    """A view for the prior.

    rotation : [3, 3], from the axes of the cloud to those of the view. closeness : u.
    weight : how much it counts. distance, known, depth, measured : [GRID, GRID], see
        `features.Sight`.
    cells : [K, 2], the centres of the cells in the foreground.
    metric : whether the depth map has the unit of the cloud. size : the frame in pixels.
    """

    rotation: Array
    closeness: float
    weight: float
    distance: Array
    known: Array
    depth: Array
    measured: Array
    cells: Array
    metric: bool
    size: float

    @classmethod
    def of(
        cls,
        camera: Camera,
        mask: MaskTarget,
        start: Array,
        frame: Frame,
        weight: float = 1.0,
        *,
        pixels_per_cell: float = 1.0,
        depth: Array | None = None,
        metric: bool = False,
    ) -> Shown | None:
        """What a ``camera`` shows of the ``start`` [N, 3], by the cells of its ``mask``.

        ``depth`` [H, W] along z is of the cells of the mask, NaN where unknown. None where the
        frame of the start is at the camera.
        """
        middle = camera.R @ frame.centre + camera.t
        turn, rotation, closeness = np.eye(3), camera.R, 0.0
        per_unit = float(np.sqrt(camera.K[0, 0] * camera.K[1, 1]))
        if camera.model == "perspective":
            away = float(np.linalg.norm(middle))
            if middle[2] < NEAR or away < NEAR:
                return None
            turn, closeness = turn_to_front(middle), frame.scale / away
            rotation = turn @ camera.R
            # Off the axis of the picture an object is stretched away from the middle.
            per_unit /= away * (middle[2] / away) ** 1.5
        centres = (np.arange(GRID) + 0.5) * CELL - HALF
        w = np.stack(np.meshgrid(centres, centres), -1).reshape(-1, 2)
        places, away_z = camera.project(frame.centre + frame.scale * w @ rotation[:2])
        seen = np.isfinite(places).all(1) & (away_z > NEAR)
        places = np.where(seen[:, None], places, 0.0)
        left, top, right, bottom = _picture(mask)
        inner = np.clip(places, (left, top), (right - 1.0, bottom - 1.0))
        inside = _imputed(mask, start, camera)[top:bottom, left:right]
        distance = _bilinear(signed_distance(inside), inner - (left, top))
        known = seen & mask.in_image(places) if mask.truncated else seen
        if not mask.truncated:
            distance += np.linalg.norm(places - inner, axis=1)
        distance = np.where(seen, distance / (per_unit * frame.scale), FAR)
        cells = w[(distance < 0.0) & known]
        z, measured = np.zeros((2, len(places)))
        if depth is not None:
            rows, columns = np.rint(inner[:, 1]).astype(int), np.rint(inner[:, 0]).astype(int)
            nearest = np.where(mask.inside, depth, np.nan)[rows, columns]
            measured = (seen & np.isfinite(nearest) & mask.in_image(places)).astype(float)
            nearest = np.nan_to_num(nearest)
            rays = np.column_stack([places, np.ones(len(places))]) @ np.linalg.inv(camera.K).T
            z = (rays * nearest[:, None] - middle) @ turn[2] / frame.scale * measured
        square = (GRID, GRID)
        size = per_unit * frame.scale * pixels_per_cell
        return cls(
            rotation,
            closeness,
            weight,
            distance.reshape(square),
            known.reshape(square).astype(float),
            z.reshape(square),
            measured.reshape(square),
            cells,
            metric,
            size,
        )


def cells_of_maps(camera: Camera, frame: Frame) -> tuple[Indices, Indices]:
    """Row and column [H, W], in the maps of `features`, of what each pixel of a ``camera`` shows.

    ``frame`` is in the axes and the unit of the camera's scene. Beyond the maps it is the nearest
    cell.
    """
    across, down = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = np.stack([across, down, np.ones_like(across)], -1) @ np.linalg.inv(camera.K).T
    middle = camera.R @ frame.centre + camera.t
    if camera.model == "perspective":
        rays = rays @ turn_to_front(middle).T
        u = frame.scale / float(np.linalg.norm(middle))
        w = rays[..., :2] / (u * rays[..., 2:].clip(1e-9))
    else:
        w = (rays[..., :2] - middle[:2]) / frame.scale
    column, row = np.moveaxis(((w + HALF) / CELL).clip(0, GRID - 1).astype(int), -1, 0)
    return row, column


def _picture(mask: MaskTarget) -> tuple[int, int, int, int]:
    """The cells that show what is known: left, top, right and bottom, the last two exclusive.

    Beyond the border of the picture there is background, unless the object goes on there.
    """
    height, width = mask.inside.shape
    if not mask.truncated:
        return 0, 0, width, height
    left, top = (max(0, int(np.ceil(edge))) for edge in mask.bounds[:2])
    right, bottom = (int(np.floor(edge)) + 1 for edge in mask.bounds[2:])
    return left, top, min(right, width), min(bottom, height)


def _imputed(mask: MaskTarget, start: Array, camera: Camera) -> Bits:
    """[H, W], the foreground; ignored cells are as in the silhouette of the ``start`` [N, 3].

    The network has never seen a hole in what is known.
    """
    height, width = mask.inside.shape
    across, down = np.meshgrid(np.arange(width), np.arange(height))
    centres = np.stack([across, down], -1).reshape(-1, 2).astype(float)
    shown = mask.in_image(centres).reshape(height, width)
    ignored = shown & ~mask.inside & ~mask.outside
    if not ignored.any():
        return mask.inside
    return np.where(ignored, footprint(start, camera), mask.inside)


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
    x, y = places.astype(int).T
    right, down = (places - np.stack([x, y], 1)).T
    x_next, y_next = np.minimum(x + 1, width - 1), np.minimum(y + 1, height - 1)
    upper = (1.0 - right) * values[y, x] + right * values[y, x_next]
    lower = (1.0 - right) * values[y_next, x] + right * values[y_next, x_next]
    found: Array = (1.0 - down) * upper + down * lower
    return found
