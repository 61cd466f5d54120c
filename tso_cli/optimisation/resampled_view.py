"""Views resampled to the window around the object: what the losses compare clouds with."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..errors import InputError
from ..geometry.arrays import Array, Box
from ..geometry.camera import NEAR, Camera
from ..geometry.resampling import area_resize, nearest_resize
from ..geometry.view import View
from ..geometry.window import window_of
from ..losses.mask_chamfer import REFERENCE_SIDE, MaskTarget

# Cells along the side of a window, and where points move: several masks together show more detail
# than the cells of one. In a small mask each pixel has several cells.
CELLS, FINE_CELLS = 64, 128


@dataclass(frozen=True, eq=False)
class ResampledView:
    """A view resampled to square cells in the window around the object (`window_of`).

    Attributes
    ----------
    mask : [h, h]. known : [h, h] known share of each cell, 0 beyond the image; None where all of
        it is known.
    camera : from normalised points to cells. sigma_sq : of the projection, cells^2.
    box : edges of the window in pixels of the mask. bounds : edges of the image in cells.
    truncated : whether the image border truncates the object, by the pixels of the `View`. In cells
        more objects touch the border.
    depth : [h, h] normalised, NaN where unknown; None without a depth map.
    """

    mask: Array
    known: Array | None
    camera: Camera
    sigma_sq: float
    box: Box
    bounds: Box
    truncated: bool
    depth: Array | None = None

    @property
    def pixels_per_cell(self) -> float:
        """Pixels of the mask along the side of a cell."""
        return (self.box[2] - self.box[0]) / self.camera.width

    @property
    def cells_per_mask_pixel(self) -> float:
        """Cells to a pixel of an enlarged mask, else 1: the mask resolves nothing finer."""
        return max(1.0, 1.0 / self.pixels_per_cell)

    @cached_property
    def target(self) -> MaskTarget:
        """The mask, prepared for the mask Chamfer loss."""
        return MaskTarget.of(
            self.mask, self.known, self.bounds, self.cells_per_mask_pixel, self.truncated
        )

    @cached_property
    def pixel_weights(self) -> tuple[Array, Array]:
        """[h, h] weights of the two terms of Eq. 4: to cover a cell, and to leave it free."""
        known = 1.0 if self.known is None else self.known
        return self.mask * known, (1.0 - self.mask) * known

    @property
    def magnification(self) -> float:
        """Pixels of a 64x64 mask per unit length at the cloud's centre.

        The silhouette loss is proportional to it.
        """
        camera = self.camera
        depth = 1.0 if camera.model == "orthographic" else max(float(camera.t[2]), NEAR)
        focal = np.sqrt(camera.K[0, 0] * camera.K[1, 1] / (camera.width * camera.height))
        return float(focal * REFERENCE_SIDE / depth)


def resample_view(
    view: View,
    sigma_sq: float,
    centre: Array,
    scale: float,
    box: Box | None = None,
    cells: int = CELLS,
) -> ResampledView:
    """Resample ``view`` for a cloud normalised by ``(X - centre) / scale``.

    Pixels are averaged by area, or interpolated linearly where cells are smaller than pixels.
    ``sigma_sq`` is in cells^2. ``box`` is the square window, by default the window of the mask
    alone. It has ``cells`` along its side.

    Raises
    ------
    InputError
        sigma_sq is under 0.01, or its square root is over a quarter of the window; or no cell is
        known to be foreground.
    """
    widest = (cells / 4.0) ** 2
    if not 0.01 <= sigma_sq <= widest:
        raise InputError(
            f"sigma_sq is {sigma_sq:g}, expected 0.01 to {widest:g}: squared cells of a window of "
            f"{cells}x{cells}"
        )
    box = window_of(view) if box is None else box
    camera = view.camera.cropped(box, cells, cells)
    mask, weight = area_resize(view.mask, box, cells, cells, weights=view.known, interpolate=True)
    depth = None if view.depth is None else nearest_resize(view.depth, box, cells) / scale
    known = None if view.known is None and weight.min() >= 1.0 - 1e-9 else weight
    bounds = _image_bounds(box, view.camera, cells)
    normalised = camera.for_normalised(centre, scale)
    resampled = ResampledView(mask, known, normalised, sigma_sq, box, bounds, view.truncated, depth)
    if not resampled.target.inside.any():
        raise InputError(
            f"{view.name}: no cell of its window of {cells}x{cells} is known to be foreground, "
            "expected some; what is known covers less than half of each"
        )
    return resampled


def _image_bounds(box: Box, camera: Camera, cells: int) -> Box:
    left, top, right, bottom = box
    across, down = cells / (right - left), cells / (bottom - top)
    return (
        (-0.5 - left) * across - 0.5,
        (-0.5 - top) * down - 0.5,
        (camera.width - 0.5 - left) * across - 0.5,
        (camera.height - 0.5 - top) * down - 0.5,
    )
