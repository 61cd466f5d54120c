"""The picture of a refinement shows what is near, and shows it where it is."""

from __future__ import annotations

import numpy as np
import pytest

from tso_cli.report.overlay import NEAR_TO_FAR, PANEL, _dots, _fitted


def _panel(*points: tuple[float, float, float]) -> np.ndarray:
    return np.asarray(_dots(*np.array(points, float).T))


@pytest.mark.parametrize("order", [1, -1])
def test_a_nearer_point_hides_a_farther_one(order):
    points = [(0.0, 0.0, -0.5), (0.0, 0.0, 0.5), (0.9, 0.9, 0.2)][::order]
    np.testing.assert_array_equal(_panel(*points)[PANEL // 2, PANEL // 2], NEAR_TO_FAR[0])


def test_a_point_is_drawn_to_the_right_and_down_of_the_middle_as_far_as_it_lies():
    panel = _panel((0.5, -0.8, 1.0), (0.5, -0.8, 1.0))
    rows, columns = np.nonzero((panel < 255).any(2))
    assert rows.mean() == pytest.approx(0.1 * PANEL, abs=1.0)
    assert columns.mean() == pytest.approx(0.75 * PANEL, abs=1.0)


def test_the_dots_of_a_large_cloud_are_small_but_there():
    many = np.random.default_rng(0).uniform(-0.9, 0.9, (100_000, 3))
    assert (np.asarray(_dots(*many.T)) < 255).any(2).mean() > 0.5


@pytest.mark.parametrize(("height", "width"), [(10, 20), (1000, 2000)])
def test_an_image_fills_its_panel_and_keeps_its_shape(height, width):
    colours = np.zeros((height, width, 3))
    colours[:, width // 2 :] = (1.0, 0.5, 0.0)
    image = _fitted(colours)
    assert image.size == (PANEL, PANEL // 2)
    assert image.getpixel((PANEL - 1, 3)) == (255, 128, 0)
    assert image.getpixel((0, 3)) == (0, 0, 0)
