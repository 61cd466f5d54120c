"""The outline of a mask in coarse cells, to be compared with that of a cloud."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..geometry.camera import Array
from ..geometry.view import View, object_box
from ..losses.projection import pixels_under
from .hypotheses import AssumedView, Assumption, about, axes_of, mirrored

# Cells along the longer side of the mask's box, in which silhouettes are compared.
CELLS = 16
# A mistake is suspected if silhouettes agree better without it by this IoU, and at least so far; if by less than the last, they
# agree about as well.
MARGIN, LEAST_IOU, SIMILAR = 0.16, 0.4, 0.03
# An inverted mask is foreground along at least so much of the picture's border.
BORDER = 0.6
# A row of cells is so many columns further.
ROW = 1 << 32


class Outline:
    """A mask in coarse cells, to be compared with what a camera sees of a cloud."""

    def __init__(self, view: View) -> None:
        self.view = view
        self.given = view.given if isinstance(view, AssumedView) else ()
        self.camera = isinstance(view, AssumedView) and view.camera_read or view.camera
        inside = view.inside
        # Of an object that the border truncates, or a speck, the background would pass for an inverted mask.
        border = np.ones(inside.shape, bool) if view.known is None else view.known.copy()
        border[1:-1, 1:-1] = False
        self.may_be_inverted = border.any() and inside[border].mean() >= BORDER
        self.cells = {False: Cells.of(inside)}
        if self.may_be_inverted:
            self.cells[True] = Cells.of(~inside if view.known is None else ~inside & view.known)

    def iou(self, points: Array, assumptions: Sequence[Assumption]) -> float:
        """IoU of the mask's cells and those that ``points`` [N, 3] fall in, under these assumptions in place of the given."""
        return self.ious(points, assumptions, [self])[0]

    def ious(
        self, points: Array, assumptions: Sequence[Assumption], masks: Sequence[Outline]
    ) -> list[float]:
        """The same of other ``masks`` with this camera; 0 of one of another size."""
        view, given = self.view, about(self.view, self.given)
        assumptions, camera = about(view, assumptions), self.camera
        for assumption in assumptions:
            camera = assumption.of_camera(camera)
        # The mask has the given changes already; each change is its own inverse, so what occurs twice cancels.
        changes = [assumption.mask for assumption in (*given, *assumptions)] + [
            "left-right"
        ] * mirrored(view)
        inverted, across, down = (
            changes.count(name) % 2 == 1 for name in ("inverted", "left-right", "upside-down")
        )
        compared = [
            mask.cells.get(inverted) if mask.view.mask.shape == view.mask.shape else None
            for mask in masks
        ]
        if not any(compared):
            return [0.0] * len(masks)
        pixels, _ = camera.project(points @ axes_of(assumptions).T)
        # The cells stay as they are: flipping the projection has the same effect as flipping the mask.
        if across:
            pixels[:, 0] = camera.width - 1.0 - pixels[:, 0]
        if down:
            pixels[:, 1] = camera.height - 1.0 - pixels[:, 1]
        return [
            cells.iou(on_known(pixels, mask.view)) if cells else 0.0
            for cells, mask in zip(compared, masks, strict=True)
        ]


class Cells(NamedTuple):
    """Those that are foreground, of a grid in which the object's longer side has so many."""

    low: Array  # [2], column and row of the first cell's corner, px
    edge: int  # of a cell, px
    inside: set[int]

    @classmethod
    def of(cls, inside: NDArray[np.bool_]) -> Cells:
        left, top, right, bottom = object_box(inside)
        edge = -(-max(right - left, bottom - top) // CELLS)
        rows, columns = -(-(bottom - top) // edge), -(-(right - left) // edge)
        padded = np.zeros((rows * edge, columns * edge), bool)
        padded[: bottom - top, : right - left] = inside[top:bottom, left:right]
        row, column = np.nonzero(padded.reshape(rows, edge, columns, edge).mean((1, 3)) > 0.1)
        return cls(np.array([left, top]) - 0.5, edge, set((row * ROW + column).tolist()))

    def iou(self, pixels: Array) -> float:
        """IoU of the mask's cells and those that ``pixels`` [N, 2] fall in."""
        column, row = np.floor((pixels - self.low) / self.edge).astype(np.int64).T
        covered = set((row * ROW + column).tolist())
        return len(covered & self.inside) / max(1, len(covered | self.inside))


def on_known(pixels: Array, view: View) -> Array:
    """Those of ``pixels`` [N, 2] that fall on known pixels of the image."""
    pixel, visible = pixels_under(pixels, np.asarray(np.isfinite(pixels).all(1)), *view.mask.shape)
    return pixels[visible if view.known is None else visible & view.known.ravel()[pixel]]
