"""Triangles drawn on a grid of samples, against a point-in-triangle test of each sample."""

import numpy as np
import pytest

from tso_cli.geometry.raster import covered, mostly_covered


def by_signs(triangles, height, width):
    """Samples [height, width] in one of the triangles, by the signs of three cross products."""
    samples = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1).astype(float)
    inside = np.zeros((height, width), bool)
    for corners in triangles:
        sides = []
        for begin, end in zip(corners, np.roll(corners, -1, 0), strict=True):
            along, to_sample = end - begin, samples - begin
            sides.append(along[0] * to_sample[..., 1] - along[1] * to_sample[..., 0])
        inside |= (np.array(sides) > 0.0).all(0) | (np.array(sides) < 0.0).all(0)
    return inside


@pytest.mark.parametrize(("height", "width"), [(20, 33), (31, 12)])
def test_samples_in_triangles_are_covered_and_no_others(height, width):
    triangles = np.random.default_rng(0).uniform(-8.0, 40.0, (12, 3, 2))
    np.testing.assert_array_equal(
        covered(triangles, height, width), by_signs(triangles, height, width)
    )


def test_a_cell_is_covered_if_more_than_half_of_it_is():
    # In samples, three to a cell: a triangle over the left half of the first cell and a bit more.
    half = np.array(
        [[[-0.5, -0.5], [1.0, -0.5], [1.0, 9.0]], [[-0.5, -0.5], [1.0, 9.0], [-0.5, 9.0]]]
    )
    np.testing.assert_array_equal(mostly_covered(half, 1, 2), [[True, False]])
    np.testing.assert_array_equal(mostly_covered(half - [[[0.6, 0.0]]], 1, 2), [[False, False]])


def test_a_triangle_that_is_a_line_covers_nothing_between_samples():
    line = np.array([[[0.3, 0.2], [5.3, 5.2], [2.3, 2.2]]])
    assert not covered(line, 8, 8).any()
