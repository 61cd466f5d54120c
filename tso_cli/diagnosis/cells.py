"""Silhouettes of clouds and masks in coarse cells, and their IoU."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..geometry.arrays import Array, Bits
from ..geometry.view import View, object_box
from ..losses.projection import pixels_under
from .hypotheses import Assumption, axes_of, mask_changes

# Cells along the longer side of the mask's bounding box.
CELLS = 16
# A cell is foreground if more than this share of its pixels is.
FOREGROUND_SHARE = 0.1
# An inverted mask is foreground along at least this share of the picture's border.
INVERTED_BORDER = 0.6
# The number of a cell is its row times this, plus its column.
ROW = 1 << 32


class Cells(NamedTuple):
    """The cells of a grid that are foreground."""

    low: Array  # [2], column and row of the corner of the first cell, px
    edge: float  # of a cell, px
    inside: set[int]

    @classmethod
    def of(cls, inside: Bits) -> Cells:
        """Of a mask [H, W]; the grid begins at the corner of the object's box."""
        left, top, right, bottom = object_box(inside)
        edge = -(-max(right - left, bottom - top) // CELLS)
        rows, columns = -(-(bottom - top) // edge), -(-(right - left) // edge)
        padded = np.zeros((rows * edge, columns * edge), bool)
        padded[: bottom - top, : right - left] = inside[top:bottom, left:right]
        shares = padded.reshape(rows, edge, columns, edge).mean((1, 3))
        row, column = np.nonzero(shares > FOREGROUND_SHARE)
        return cls(np.array([left, top]) - 0.5, edge, set((row * ROW + column).tolist()))

    @classmethod
    def around(cls, pixels: Array, edge: float) -> Cells:
        """The cells that ``pixels`` [N, 2] fall in; the grid begins at pixel 0."""
        empty = cls(np.zeros(2), edge, set())
        return empty._replace(inside=empty._under(pixels))

    def iou(self, pixels: Array) -> float:
        """IoU of these cells and the cells that ``pixels`` [N, 2] fall in."""
        covered = self._under(pixels)
        return len(covered & self.inside) / max(1, len(covered | self.inside))

    def _under(self, pixels: Array) -> set[int]:
        column, row = np.floor((pixels - self.low) / self.edge).astype(np.int64).T
        return set((row * ROW + column).tolist())


class Outline:
    """A view as it was read, to be compared with a cloud under assumptions.

    Attributes
    ----------
    may_be_inverted : whether the mask under the ``given`` assumptions is foreground along most of
        the border. No other mask is tried as an inverted one: the background around a truncated
        object, or around a speck, would pass for an object.
    """

    def __init__(self, view: View, given: Sequence[Assumption] = ()) -> None:
        self.view, self.given = view, tuple(given)
        inverted = "inverted" in mask_changes(view, given)
        inside, other = view.inside, ~view.inside
        if view.known is not None:
            other = other & view.known
        if inverted:
            inside, other = other, inside
        border = np.ones(inside.shape, bool) if view.known is None else view.known.copy()
        border[1:-1, 1:-1] = False
        self.may_be_inverted = bool(border.any() and inside[border].mean() >= INVERTED_BORDER)
        self.cells = {inverted: Cells.of(inside)}
        if self.may_be_inverted:
            self.cells[not inverted] = Cells.of(other)
        self.foreground_cells = len(self.cells[inverted].inside)

    def iou(self, points: Array, assumptions: Sequence[Assumption]) -> float:
        """IoU of the mask and ``points`` [N, 3] in cells, under ``assumptions`` alone."""
        return self.ious(points, assumptions, [self])[0]

    def ious(
        self, points: Array, assumptions: Sequence[Assumption], masks: Sequence[Outline]
    ) -> list[float]:
        """The same for this camera and other ``masks``; 0 for a mask of another size."""
        view, camera = self.view, self.view.camera
        of_view = [one for one in assumptions if one.is_about(view)]
        for assumption in of_view:
            camera = assumption.hypothesis.camera(camera)
        changes = mask_changes(view, of_view)
        compared = [
            mask.cells.get("inverted" in changes)
            if mask.view.mask.shape == view.mask.shape
            else None
            for mask in masks
        ]
        if not any(compared):
            return [0.0] * len(masks)
        pixels, _ = camera.project(points @ axes_of(of_view).T)
        # Flipping the projection has the same effect as flipping the mask.
        if "left-right" in changes:
            pixels[:, 0] = camera.width - 1.0 - pixels[:, 0]
        if "upside-down" in changes:
            pixels[:, 1] = camera.height - 1.0 - pixels[:, 1]
        return [
            cells.iou(on_known_pixels(pixels, mask.view)) if cells else 0.0
            for cells, mask in zip(compared, masks, strict=True)
        ]


def on_known_pixels(pixels: Array, view: View) -> Array:
    """The rows of ``pixels`` [N, 2] that fall on known pixels of the image."""
    finite = np.asarray(np.isfinite(pixels).all(1))
    pixel, visible = pixels_under(pixels, finite, *view.mask.shape)
    return pixels[visible if view.known is None else visible & view.known.ravel()[pixel]]
