"""Silhouettes in coarse cells, and views that are compared under assumptions."""

import numpy as np
import pytest

from tests.scenes import block
from tso_cli import Camera, View
from tso_cli.diagnosis.assumptions import Assumption, as_meant
from tso_cli.diagnosis.cells import CELLS, Cells, Outline
from tso_cli.diagnosis.hypotheses import HYPOTHESES

from .common import PLANE, assumed, changed
from .mistakes import mistaken


def test_cells_have_a_sixteenth_of_the_longer_side_of_the_box():
    cells = Cells.of(block(np.s_[4:36, 10:58]) > 0.5)
    assert cells.edge == 3
    assert cells.inside.shape == (11, CELLS)
    assert cells.count == CELLS * 11
    np.testing.assert_array_equal(cells.low, [9.5, 3.5])


def test_a_cell_is_foreground_if_over_a_tenth_of_its_pixels_are():
    inside = block(np.s_[0:4, 0:64]) > 0.5  # cells of 4 x 4 pixels
    inside[:4, 4:8] = False
    inside[0, 4] = True
    assert Cells.of(inside).count == 15
    inside[0, 5] = True
    assert Cells.of(inside).count == 16


def test_the_iou_of_cells():
    cells = Cells.of(block(np.s_[0:16, 0:32]) > 0.5)  # 8 x 16 cells of 2 x 2 pixels
    rows, columns = np.indices((16, 32)).reshape(2, -1)
    x, y = (
        np.stack([columns, columns, columns + 16, columns + 1000]) * 1.0,
        np.stack(4 * [rows]) * 1.0,
    )
    visible = np.ones(x.shape, bool)
    visible[1] = columns < 16
    np.testing.assert_allclose(cells.ious(x, y, visible), [1.0, 0.5, 1.0 / 3.0, 0.0])


def _iou(outline: Outline, points: np.ndarray, assumptions: tuple[Assumption, ...]) -> float:
    return outline.ious(points, [assumptions])[0]


@pytest.mark.parametrize("name", HYPOTHESES)
def test_a_view_under_assumptions_agrees_as_the_view_that_is_meant(name):
    points, view = mistaken(name)
    given = assumed(name)
    compared = _iou(Outline(view, given), points, given)
    meant = _iou(Outline(as_meant(view, given)), points, ())
    # The grid of a flipped mask begins at its other side.
    assert compared == pytest.approx(meant, abs=0.05)
    assert compared > 0.7


def test_a_change_that_is_assumed_twice_is_none():
    twice = 2 * assumed("mask-flipped")
    outline = Outline(PLANE.view)
    assert _iou(outline, PLANE.target, twice) == _iou(outline, PLANE.target, ())


@pytest.mark.parametrize(
    ("region", "inverted"),
    [(np.s_[20:40, 20:40], False), (np.s_[0:64, 0:30], False), (np.s_[2:64, 0:64], True)],
)
def test_a_mask_along_most_of_the_border_may_be_inverted(region, inverted):
    view = View(block(region), Camera.canonical(64, 64))
    assert Outline(view).may_be_inverted == inverted


def test_under_an_assumption_the_mask_that_is_meant_may_be_inverted():
    inverted = changed(PLANE.view, "mask-inverted")
    assert Outline(inverted).may_be_inverted
    assert not Outline(inverted, assumed("mask-inverted")).may_be_inverted
    assert Outline(PLANE.view, assumed("mask-inverted")).may_be_inverted
