"""What a cloud is given beside its points."""

import numpy as np
import pytest

from tests.corruption import assert_refused
from tso_cli.cloud.cloud import Cloud

POINTS = np.random.default_rng(0).normal(size=(324, 3))


@pytest.mark.parametrize(
    ("colours", "words"),
    [
        (np.zeros((2, 3)), r"colours have shape \[2, 3\], expected \[324, 3\]"),
        (np.linspace(0, 300, 972).reshape(-1, 3), "colours span 0 to 300, expected 0 to 1"),
        ("red", "what is given as colours is not an array of real numbers"),
        (np.full((324, 3), np.nan), "colours"),
    ],
)
def test_unusable_colours_are_refused(colours, words):
    assert_refused(words, Cloud, POINTS, "points", colours)


def test_uint8_stands_for_fractions():
    fractions = np.random.default_rng(1).random(POINTS.shape)
    as_uint8 = np.rint(255.0 * fractions).astype(np.uint8)
    of_uint8, of_fractions = (
        Cloud(POINTS, "points", values).colours for values in (as_uint8, as_uint8 / 255.0)
    )
    np.testing.assert_allclose(of_uint8, of_fractions, atol=1e-6)
