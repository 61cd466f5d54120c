"""The bound of what one mask can tell: what lies across the view is undone, depth is not."""

from __future__ import annotations

import numpy as np
import pytest

from tso_cli.evaluation.metrics import chamfer
from tso_cli.geometry.view import View
from tso_cli.render.viewpoints import look_at
from tso_lab.studies.bounds import across_the_view
from tso_lab.studies.cases import Case

from .studying import rng

CAMERA = look_at(30.0, 20.0, 2.0, (64, 64))
MASK = np.pad(np.ones((32, 32), dtype=np.float32), 16)
"""Any; a bound depends on the camera alone."""


def case(initial: np.ndarray, target: np.ndarray) -> Case:
    view = View(MASK, CAMERA)
    return Case("other", "car", "car/a", 0, "car/b", initial, target, target, (view,), 0.0)


def ratio(initial: np.ndarray, target: np.ndarray) -> float:
    """Bound over the distance of the start."""
    return across_the_view(case(initial, target)) / chamfer(initial, target).chamfer


def in_the_object(camera_axes: np.ndarray) -> np.ndarray:
    return camera_axes @ CAMERA.R


@pytest.fixture
def shell() -> np.ndarray:
    """[600, 3] points on an ellipsoid, in the axes of the camera."""
    directions = rng().normal(size=(600, 3))
    return directions / np.linalg.norm(directions, axis=1, keepdims=True) * [0.5, 0.3, 0.4]


@pytest.fixture
def panel() -> np.ndarray:
    """[400, 3] points of a flat panel that faces the camera, in its axes."""
    return np.column_stack([rng().uniform(-0.5, 0.5, size=(400, 2)), np.zeros(400)])


def test_a_shape_squeezed_across_the_view_comes_back(shell):
    squeezed = shell * [0.8, 1.1, 1.0]
    assert ratio(in_the_object(squeezed), in_the_object(shell)) < 1e-6


def test_a_shape_bent_across_the_view_comes_back(shell):
    bent = shell + np.column_stack([0.4 * shell[:, 1] ** 2, *np.zeros((2, len(shell)))])
    assert ratio(in_the_object(bent), in_the_object(shell)) < 0.05


def test_what_differs_in_depth_alone_stays(panel):
    behind = panel + [0.0, 0.0, 0.2]
    assert ratio(in_the_object(panel), in_the_object(behind)) == pytest.approx(1.0)


def test_the_part_of_a_shift_that_lies_in_depth_stays(panel):
    moved = panel + [0.02, 0.0, 0.2]
    bound = across_the_view(case(in_the_object(panel), in_the_object(moved)))
    assert bound == pytest.approx(2.0 * 0.2**2, rel=1e-3)


def test_most_of_a_squeeze_in_depth_stays(shell):
    assert ratio(in_the_object(shell * [1.0, 1.0, 0.9]), in_the_object(shell)) > 0.9


def test_a_start_that_is_the_truth_has_nothing_to_gain(shell):
    assert across_the_view(case(shell, shell)) == 0.0


def test_a_start_that_is_flat_along_an_axis_has_a_bound(panel):
    assert 0.0 < ratio(panel, 1.05 * panel) < 0.5
