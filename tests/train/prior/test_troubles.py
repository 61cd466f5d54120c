"""Masks as people have them."""

import numpy as np
import pytest

from tso_cli.train.prior.troubles import MOST, MOST_FOREIGN, OUTLINES, PARTS, marred

DISC = np.hypot(*(np.mgrid[:96, :96] - 48.0)) < 25.0


@pytest.mark.parametrize("trouble", [*PARTS, "object"])
def test_a_part_that_is_wrong_is_marked_and_neither_tiny_nor_all(trouble):
    for seed in range(6):
        result = marred(DISC, trouble, np.random.default_rng(seed), other=DISC)
        assert result is not None
        np.testing.assert_array_equal(result.given, (DISC & ~result.hidden) | result.foreign)
        assert not (result.foreign & DISC).any()
        assert not (result.hidden & ~DISC).any()
        assert result.foreign.sum() + result.hidden.sum() > 0
        assert result.hidden.sum() <= MOST * DISC.sum()
        assert result.foreign.sum() <= MOST_FOREIGN * DISC.sum()


@pytest.mark.parametrize("trouble", OUTLINES)
def test_an_outline_that_is_wrong_leaves_the_foreground_to_the_object(trouble):
    result = marred(DISC, trouble, np.random.default_rng(0))
    assert not result.foreign.any()
    assert not result.hidden.any()
    changed = (result.given != DISC).sum()
    assert (changed > 0) or trouble == "smooth"
    grows = {"grown": 1, "shrunk": -1}.get(trouble, 0)
    assert np.sign(int(result.given.sum()) - int(DISC.sum())) == grows or not grows
