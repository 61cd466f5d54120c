"""Masks of meshes, and the maps of signed distances that the network sees of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from ...geometry.arrays import Array, Bits, Floats
from ...geometry.raster import ACROSS, mostly_covered

SCENE_GRID = 48  # cells along a side of a map of a scene; the network sees `features.GRID`
HALF_SIDE = 0.9  # a map shows [-HALF_SIDE, HALF_SIDE]^2, in longest sides of the object


@dataclass(frozen=True)
class Border:
    """The cells of a mask that the picture shows: columns ``left`` to ``right`` - 1, and so on."""

    left: int
    top: int
    right: int
    bottom: int

    @classmethod
    def whole(cls, cells: int) -> Border:
        """The border of a picture that shows all ``cells`` of each side."""
        return cls(0, 0, cells, cells)


def seen(points: NDArray[np.floating], rotation: Array, closeness: float) -> NDArray[np.floating]:
    """Image coordinates w [..., N, 2] of object points [..., N, 3], in longest sides of the object.

    With y = R x in the view's axes, w = (y_x, y_y) / (1 + u y_z).
    """
    turned = points @ rotation.T.astype(points.dtype)
    image: NDArray[np.floating] = turned[..., :2] / (1.0 + closeness * turned[..., 2:])
    return image


def silhouette(image: NDArray[np.floating], faces: NDArray[np.int32], cells: int) -> Bits:
    """The mask [cells, cells] of triangles with corners ``image`` [V, 2] (see `seen`).

    A cell is foreground if more than half of its samples lie in a triangle.
    """
    corners = (image + HALF_SIDE) * (ACROSS * cells / (2.0 * HALF_SIDE)) - 0.5
    return mostly_covered(corners.astype(np.float64)[faces], cells, cells)


def signed_distance(mask: Bits, border: Border) -> Floats:
    """Distances from the outline of ``mask``, negative inside, in longest sides.

    [SCENE_GRID, SCENE_GRID].

    Only what the picture shows counts. Beyond its border stands the distance of the nearest cell
    inside. The part that is shown must have foreground and background.
    """
    cells = len(mask)
    picture = mask[border.top : border.bottom, border.left : border.right]
    outside = distance_transform_edt(~picture)
    inside = distance_transform_edt(picture)
    # The outline lies half a cell from the centres of the cells next to it.
    cell = 2.0 * HALF_SIDE / cells
    distance = np.where(picture, 0.5 - inside, outside - 0.5) * cell
    centres = (np.arange(SCENE_GRID, dtype=np.float64) + 0.5) * (cells / SCENE_GRID) - 0.5
    rows = _interpolation(centres - border.top, picture.shape[0])
    columns = _interpolation(centres - border.left, picture.shape[1])
    return (rows @ distance @ columns.T).astype(np.float32)


def at_cells(mask: Bits) -> Floats:
    """``mask`` [C, C] at the centres of the cells of a map of a scene, interpolated."""
    cells = len(mask)
    if not mask.any():
        return np.zeros((SCENE_GRID, SCENE_GRID), np.float32)
    centres = (np.arange(SCENE_GRID, dtype=np.float64) + 0.5) * (cells / SCENE_GRID) - 0.5
    weights = _interpolation(centres, cells)
    return (weights @ mask.astype(np.float64) @ weights.T).astype(np.float32)


def _interpolation(places: Array, count: int) -> Array:
    """The matrix [P, count] of linear interpolation at ``places`` [P]; the ends go on for ever."""
    places = np.clip(places, 0.0, count - 1.0)
    low = np.minimum(places.astype(np.int64), max(count - 2, 0))
    weights = np.zeros((len(places), count))
    number = np.arange(len(places))
    weights[number, np.minimum(low + 1, count - 1)] = places - low
    weights[number, low] += 1.0 - (places - low)
    return weights


def known_window(border: Border, cells: int) -> NDArray[np.uint8]:
    """Those columns and rows of a map whose centres the picture shows.

    They are left, top, right and bottom [4]; right and bottom do not belong to it.
    """
    centres = (np.arange(SCENE_GRID) + 0.5) * (cells / SCENE_GRID)
    low = np.searchsorted(centres, [border.left, border.top])
    high = np.searchsorted(centres, [border.right, border.bottom])
    return np.concatenate([low, high]).astype(np.uint8)
