"""Parts of masks and clouds that the other lacks: they are left out, and a right cloud stays."""

from dataclasses import replace

import numpy as np
import pytest

from tests.scenes import example
from tso_cli import refine
from tso_cli.cloud.cloud import Cloud
from tso_cli.diagnosis.foreign_parts import parts_that_explain

CHAIR = example("chair")
VIEW = CHAIR.view
BOTTOM = int(np.flatnonzero((VIEW.mask > 0.5).any(1))[-1])
COLUMNS = np.flatnonzero((VIEW.mask > 0.5).any(0))
LEFT, RIGHT = int(COLUMNS[0]), int(COLUMNS[-1])


def _painted(rows, columns, value):
    mask = VIEW.mask.copy()
    mask[rows, columns] = value
    return replace(VIEW, mask=mask)


ARM = _painted(slice(120, 140), slice(RIGHT - 16, 240), 1.0)
STAND = _painted(slice(BOTTOM - 40, BOTTOM + 6), slice(LEFT - 20, RIGHT + 20), 1.0)
BITE = _painted(slice(0, BOTTOM - 60), slice(RIGHT - 40, 256), 0.0)


@pytest.mark.parametrize("view", [ARM, STAND, BITE], ids=["arm", "stand", "bite"])
def test_a_right_cloud_stays_before_a_mask_with_something_else(view):
    result = refine(CHAIR.target, view)
    assert (result.trust.verdict, result.fit.stop_reason) == ("left", "fits")
    np.testing.assert_array_equal(result.points, CHAIR.target)


def test_the_pixels_that_are_left_out_are_those_of_the_part():
    body = Cloud(CHAIR.target, "points").controlled().body
    (part,) = parts_that_explain(body, [ARM]).values()
    assert part.ignored[124:136, RIGHT + 16 : 240].all()
    assert part.ignored[VIEW.mask > 0.5].mean() < 0.1
    assert part.in_mask > part.in_cloud == 0.0


def test_a_floor_in_the_cloud_stays_where_it_is_and_pulls_nothing():
    x, z = np.random.default_rng(0).uniform(-0.8, 0.8, (2, 400))
    floor = np.stack([x, np.full(400, CHAIR.target[:, 1].min()), z], 1)
    cloud = np.concatenate([CHAIR.target, floor])
    result = refine(cloud, VIEW)
    np.testing.assert_array_equal(result.points, cloud)


def test_what_another_shape_lacks_is_no_foreign_part():
    """Else the masks would say nothing of what is wrong with the shape."""
    for name in ("chair", "car", "airplane"):
        scene = example(name)
        body = Cloud(scene.points, "points").controlled().body
        assert parts_that_explain(body, [scene.view]) == {}
