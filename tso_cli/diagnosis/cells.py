"""Silhouettes of clouds and masks in coarse cells, and their IoU under many assumptions at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..geometry.arrays import Array, Bits, Indices
from ..geometry.camera import Camera
from ..geometry.view import View, object_box
from .assumptions import Assumption, axes_of, camera_under, mask_change
from .hypotheses import Hypothesis

# Cells along the longer side of the mask's bounding box.
CELLS = 16
# A cell is foreground if more than this share of its pixels is.
FOREGROUND_SHARE = 0.1
# A mask of fewer cells matches too much by chance, as does a cloud that shrinks to a point.
FEWEST_CELLS = 10
# An inverted mask is foreground along at least this share of the picture's border.
INVERTED_BORDER = 0.6


@dataclass(frozen=True, eq=False)
class Cells:
    """The foreground of a mask in cells of a grid that begins at the corner of the object's box.

    low : [2], column and row of that corner, px. edge : of a cell, px.
    inside : [rows, columns], the cells that are foreground.
    """

    low: Array
    edge: int
    inside: Bits

    @classmethod
    def of(cls, inside: Bits) -> Cells:
        """Of a mask [H, W]."""
        left, top, right, bottom = object_box(inside)
        edge = -(-max(right - left, bottom - top) // CELLS)
        rows, columns = -(-(bottom - top) // edge), -(-(right - left) // edge)
        padded = np.zeros((rows * edge, columns * edge), bool)
        padded[: bottom - top, : right - left] = inside[top:bottom, left:right]
        shares = padded.reshape(rows, edge, columns, edge).mean((1, 3))
        return cls(np.array([left, top]) - 0.5, edge, shares > FOREGROUND_SHARE)

    @property
    def count(self) -> int:
        return int(self.inside.sum())

    def ious(self, x: Array, y: Array, visible: Bits) -> Array:
        """[C], IoU of these cells and the cells that the visible points of C clouds fall in.

        ``x``, ``y`` and ``visible`` are [C, N]. Points that are farther from the object's box than
        its longer side count as if they were nearer.
        """
        # `CELLS` cells at each side lie around the object's box.
        rows, columns = (length + 2 * CELLS for length in self.inside.shape)
        numbers = self._numbers(y, 1, rows) * columns + self._numbers(x, 0, columns)
        covered = np.zeros((len(x), rows * columns), bool)
        covered[np.nonzero(visible)[0], numbers[visible]] = True
        inner = covered.reshape(-1, rows, columns)[:, CELLS:-CELLS, CELLS:-CELLS]
        common = inner[:, self.inside].sum(1)
        ious: Array = common / np.maximum(1, covered.sum(1) + self.count - common)
        return ious

    def _numbers(self, places: Array, axis: int, count: int) -> Indices:
        """The rows or columns that ``places`` fall in, of ``count`` around the object's box."""
        with np.errstate(invalid="ignore"):
            numbers = (places - self.low[axis]) * (1.0 / self.edge) + CELLS
            return np.clip(numbers, 0.0, count - 0.5).astype(np.int64)

    def stretched(self, places: Array, visible: Bits, axis: int) -> Array:
        """``places`` [C, N] along x (``axis`` 0) or y, so that the visible ones fill the box."""
        low = np.where(visible, places, np.inf).min(1, keepdims=True)
        high = np.where(visible, places, -np.inf).max(1, keepdims=True)
        size = self.edge * self.inside.shape[1 - axis] - 1e-6
        with np.errstate(invalid="ignore"):
            filled: Array = self.low[axis] + (places - low) * (size / np.maximum(high - low, 1e-9))
        return filled


def visible_in(view: View, x: Array, y: Array) -> Bits:
    """Which of the places ``x`` and ``y``, px, fall on known pixels of a view's image."""
    height, width = view.mask.shape
    visible: Bits = (x > -0.5) & (x < width - 0.5) & (y > -0.5) & (y < height - 0.5)
    if view.known is not None:
        row, column = (np.rint(place[visible]).astype(int) for place in (y, x))
        visible[visible] = view.known[row, column]
    return visible


class Outline:
    """A view as it was read, to be compared with a cloud under assumptions.

    Attributes
    ----------
    may_be_inverted : whether the mask under the ``given`` assumptions is foreground along most of
        the border. No other mask is tried as an inverted one: the background around a truncated
        object, or around a speck, would pass for an object.
    """

    def __init__(self, view: View, given: Sequence[Assumption] = ()) -> None:
        self.view = view
        inverted = mask_change(view, given).inverted
        known = np.ones(view.mask.shape, bool) if view.known is None else view.known
        inside, background = view.inside, known & ~view.inside
        if inverted:
            inside, background = background, inside
        border = known.copy()
        border[1:-1, 1:-1] = False
        self.may_be_inverted = bool(border.any() and inside[border].mean() >= INVERTED_BORDER)
        self.cells = {inverted: Cells.of(inside)}
        if self.may_be_inverted:
            self.cells[not inverted] = Cells.of(background)
        self.foreground_cells = self.cells[inverted].count

    def project(
        self, points: Array, options: Sequence[Sequence[Assumption]]
    ) -> tuple[Array, Array, list[bool]]:
        """x and y [C, N] of ``points`` [N, 3] under each option, in the mask as it was read.

        And under which options the mask is inverted.
        """
        view, axes, cameras, changes = self.view, [], [], []
        # Many options have the same camera.
        cached: dict[tuple[Hypothesis, ...], Camera] = {}
        for option in options:
            of_view = [assumption for assumption in option if assumption.is_about(view)]
            axes.append(axes_of(of_view))
            changes.append(mask_change(view, of_view))
            hypotheses = (assumption.hypothesis for assumption in of_view)
            of_camera = tuple(hypothesis for hypothesis in hypotheses if hypothesis.changes_camera)
            if of_camera not in cached:
                cached[of_camera] = camera_under(view.camera, of_camera)
            cameras.append(cached[of_camera])
        R = np.stack([camera.R for camera in cameras]) @ np.stack(axes)
        t = np.stack([camera.t for camera in cameras])
        turns = np.stack([change.turn.T for change in changes])
        middle = (np.array([view.camera.width, view.camera.height]) - 1.0) / 2.0
        K = np.stack([camera.K[:2] for camera in cameras])
        K[..., 2] -= middle
        K = turns @ K
        K[..., 2] += middle
        in_camera = R @ points.T + t[..., None]
        if view.camera.model == "perspective":
            with np.errstate(divide="ignore", invalid="ignore"):
                in_camera[:, :2] *= 1.0 / np.where(in_camera[:, 2:] > 0.0, in_camera[:, 2:], np.nan)
        x, y = (K[..., :2] @ in_camera[:, :2] + K[..., 2:]).swapaxes(0, 1)
        return x, y, [change.inverted for change in changes]

    def ious(self, points: Array, options: Sequence[Sequence[Assumption]]) -> Array:
        """[C + 1], IoU of the mask and ``points`` [N, 3] in cells under each option alone.

        The last is under the first option, of points that are stretched so that their box is the
        box of the mask. A camera inside the cloud sees points everywhere, so an option loses that
        share of its IoU by which it puts more points behind the camera than the first option.
        """
        x, y, inverted = self.project(points, options)
        visible, ious = visible_in(self.view, x, y), np.zeros(len(options))
        for changed, cells in self.cells.items():
            rows = np.array(inverted) == changed
            ious[rows] = cells.ious(x[rows], y[rows], visible[rows])
        in_front = (~np.isnan(x)).mean(1)
        ious *= np.minimum(1.0, in_front / max(in_front[0], 1e-9))
        cells, visible = self.cells[inverted[0]], visible[:1]
        column, row = cells.stretched(x[:1], visible, 0), cells.stretched(y[:1], visible, 1)
        return np.append(ious, cells.ious(column, row, visible))
