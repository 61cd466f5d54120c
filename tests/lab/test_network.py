"""The mean training shape, and the nearest shape in the best quarter turn."""

from __future__ import annotations

import numpy as np
import pytest

from tso_cli.evaluation.metrics import chamfer
from tso_lab.studies.material import mean_shape
from tso_lab.studies.network import TURNS, aligned_mean, nearest_of


def cloud(seed: int, stretch: tuple[float, float, float] = (1.0, 0.6, 0.3)) -> np.ndarray:
    return (np.random.default_rng(seed).uniform(-0.5, 0.5, (256, 3)) * stretch).astype(np.float32)


def test_the_mean_is_nearer_to_all_than_any_one_of_them():
    clouds = [cloud(i, (1.0, 0.2 + 0.2 * i, 0.3)) for i in range(4)]
    answers = (mean_shape(clouds, steps=60), *clouds)
    totals = [sum(chamfer(one, other).chamfer for other in clouds) for one in answers]
    assert np.argmin(totals) == 0


def test_a_shape_that_faces_another_way_is_found_by_its_quarter_turn():
    clouds = [cloud(0), cloud(1, (0.9, 0.9, 0.9))]
    for turn in TURNS:
        assert nearest_of(clouds, clouds[0] @ turn) == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose([np.linalg.det(turn) for turn in TURNS], 1.0)


@pytest.mark.slow
def test_shapes_are_turned_to_each_other_before_their_mean_is_taken():
    clouds = [cloud(i) @ TURNS[i % 4] for i in range(4)]
    mean, careless = aligned_mean(clouds, steps=60), mean_shape(clouds, steps=60)
    assert nearest_of([mean], cloud(9)) < 0.5 * nearest_of([careless], cloud(9))
