"""Families of shapes by rule."""

import numpy as np
import pytest

from tso_cli.render.families import FAMILIES, shape_of


@pytest.mark.parametrize("family", FAMILIES)
def test_a_seed_is_a_shape_of_a_family_with_longest_side_1(family):
    shapes = [shape_of(family, [seed]) for seed in (0, 0, 1, 2, 3)]
    np.testing.assert_array_equal(shapes[0].vertices, shapes[1].vertices)
    for shape in shapes:
        size = np.ptp(shape.vertices, axis=0)
        assert size.max() == pytest.approx(1.0)
        assert 0.0 <= shape.faces.min() <= shape.faces.max() < len(shape.vertices)
    sizes = {tuple(np.ptp(shape.vertices, axis=0).round(4)) for shape in shapes[1:]}
    assert len({len(shape.vertices) for shape in shapes[1:]} | sizes) > 1


def test_there_are_thirty_families():
    assert len(FAMILIES) >= 30
