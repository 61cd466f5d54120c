"""Parts of masks and clouds that the other lacks: they are left out, and a right cloud stays."""

from dataclasses import replace

import numpy as np
import pytest

from tests.scenes import example
from tso_cli import RefineConfig, refine
from tso_cli.cloud.cloud import Cloud
from tso_cli.diagnosis.foreign_parts import parts_seen, parts_that_explain
from tso_cli.pose.causes import find_move
from tso_cli.prior import Doubts, Frame, SeenCloud, cells_of_maps, named_prior
from tso_cli.prior.features import GRID
from tso_cli.refinement.run import check
from tso_cli.refinement.scene import as_scene

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
PERSON = _painted(slice(30, 256), slice(RIGHT - 20, 240), 1.0)
BITE = _painted(slice(0, BOTTOM - 60), slice(RIGHT - 40, 256), 0.0)


@pytest.mark.parametrize("view", [ARM, STAND, PERSON, BITE], ids=["arm", "stand", "person", "bite"])
def test_a_right_cloud_stays_before_a_mask_with_something_else(view):
    result = refine(CHAIR.target, view)
    assert (result.trust.verdict, result.fit.stop_reason) == ("left", "fits")
    np.testing.assert_array_equal(result.points, CHAIR.target)


def test_a_check_names_the_part_that_a_refinement_names():
    diagnosis, *_ = check(as_scene(CHAIR.target, PERSON), RefineConfig().settings())
    assert diagnosis.findings == refine(CHAIR.target, PERSON).findings
    assert "foreign-part" in [finding.name for finding in diagnosis.findings]


def test_the_pixels_that_are_left_out_are_those_of_the_part():
    body = Cloud(CHAIR.target, "points").controlled().body
    (part,) = parts_that_explain(body, [ARM], find_move(body, [ARM])).values()
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
        move = find_move(body, [scene.view])
        assert parts_that_explain(body, [scene.view], move) == {}


@pytest.mark.parametrize("taller", [1.3, 1.5])
def test_what_a_cloud_of_other_proportions_explains_too_is_no_foreign_part(taller):
    """The back of a chair that is too tall is above the mask, and the rest of it fits."""
    body = Cloud(CHAIR.target * [1.0, taller, 1.0], "points").controlled().body
    move = find_move(body, [VIEW])
    assert move.stretched < 0.05
    assert parts_that_explain(body, [VIEW], replace(move, stretched=np.inf))
    assert parts_that_explain(body, [VIEW], move) == {}


@pytest.fixture
def sees_the_arm(monkeypatch):
    """The prior finds the cells of the arm foreign, as one that has seen such masks does."""
    foreign = np.zeros((1, GRID, GRID))
    cloud = Cloud(CHAIR.points, "points").controlled()
    camera = VIEW.camera.for_normalised(cloud.centre, cloud.scale)
    row, column = cells_of_maps(camera, Frame.of(cloud.start))
    arm = (ARM.mask > 0.5) & (VIEW.mask < 0.5)
    foreign[0, row[arm], column[arm]] = 0.9
    doubts = Doubts(foreign, np.zeros_like(foreign), np.zeros((1, 8)))
    monkeypatch.setattr(SeenCloud, "doubts", lambda seen, prior: doubts)
    return arm


def test_what_the_prior_finds_foreign_is_left_out_for_a_cloud_of_another_shape(sees_the_arm):
    cloud = Cloud(CHAIR.points, "points").controlled()
    (part,) = parts_seen(cloud, [ARM], named_prior("learned")).values()
    assert part.ignored[sees_the_arm].all()
    assert part.ignored[(VIEW.mask > 0.5)].mean() < 0.1
    result = refine(CHAIR.points, ARM)
    assert "foreign-part" in [finding.name for finding in result.findings]
    assert result.fit.outcome == "moved"
    assert refine(CHAIR.points, ARM, config=RefineConfig(prior="none")).findings == ()


def test_a_mask_that_would_be_foreign_whole_is_used_as_it_is(monkeypatch):
    doubts = Doubts(np.ones((1, GRID, GRID)), np.zeros((1, GRID, GRID)), np.zeros((1, 8)))
    monkeypatch.setattr(SeenCloud, "doubts", lambda seen, prior: doubts)
    cloud = Cloud(CHAIR.points, "points").controlled()
    assert parts_seen(cloud, [ARM], named_prior("learned")) == {}
