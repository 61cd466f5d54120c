"""What may be chosen: `RefineConfig`, and the settings that it stands for."""

import pytest

from tso_cli import InputError, RefineConfig


@pytest.mark.parametrize(
    ("config", "points"),
    [
        (RefineConfig(), 1024),
        (RefineConfig(points=512), 512),
        (RefineConfig(preset="paper"), None),
    ],
)
def test_a_thousand_points_move_by_default_and_all_with_the_papers_preset(config, points):
    assert config.settings().points == points


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        (
            {"points": 100, "mode": "latent"},
            "`points` 100 is for `mode` points and `preset` best, found `mode` latent",
        ),
        ({"points": 3}, "`points` is 3, expected a whole number from 16 to 16,384"),
        ({"points": True}, "`points` is True"),
    ],
)
def test_a_number_of_points_that_means_nothing_is_refused(settings, named):
    with pytest.raises(InputError, match=named):
        RefineConfig(**settings)
