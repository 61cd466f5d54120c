"""Weights of the points that a point is interpolated from."""

import numpy as np

from tso_cli.cloud.interpolation import falling_weights


def test_interpolation_weights_sum_to_one_and_fall_to_nothing_at_the_last_node():
    weights = falling_weights(np.array([[0.0, 0.5, 1.0, 2.0], [3.0, 3.0, 3.0, 3.0]]))
    np.testing.assert_allclose(weights.sum(1), 1.0)
    assert (np.diff(weights[0]) < 0.0).all()
    assert weights[0, -1] < 1e-6
    np.testing.assert_allclose(weights[1], 0.25)
