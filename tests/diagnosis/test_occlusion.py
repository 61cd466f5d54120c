"""What stands before an object hides a part of it, and that part of the picture is unknown."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from tests.scenes import example, seen, turned
from tso_cli import Camera, RefineConfig, View, refine
from tso_cli.diagnosis.findings import Finding
from tso_cli.diagnosis.symptoms import occluder
from tso_cli.evaluation.metrics import chamfer

from .common import EXAMPLES


def _behind_a_wall(view: View, degrees: float, share: float) -> tuple[View, np.ndarray]:
    """The view with a ``share`` of its object behind a turned wall; and the wall [H, W]."""
    across = np.radians(degrees)
    rows, columns = np.indices(view.mask.shape)
    side = columns * np.cos(across) + rows * np.sin(across)
    wall = side > np.quantile(side[view.inside], 1.0 - share)
    return replace(view, mask=np.where(wall, np.float32(0.0), view.mask)), wall


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_whole_object_is_not_occluded(name):
    scene = example(name)
    assert occluder(scene.view, 0, scene.points) is None


def _behind_a_ball(view: View, share: float) -> tuple[View, np.ndarray]:
    """The view with a ``share`` of its object behind a ball, and the ball [H, W]."""
    rows, columns = np.indices(view.mask.shape)
    left, top, right, bottom = view.box()
    away = np.hypot(columns - right, rows - (top + bottom) / 2.0)
    ball = away < np.quantile(away[view.inside], share)
    return replace(view, mask=np.where(ball, np.float32(0.0), view.mask)), ball


HIDDEN = [
    ("chair", partial(_behind_a_wall, degrees=90.0, share=0.4)),
    ("car", partial(_behind_a_wall, degrees=20.0, share=0.4)),
    ("car", partial(_behind_a_wall, degrees=200.0, share=0.4)),
    ("airplane", partial(_behind_a_wall, degrees=0.0, share=0.4)),
    ("chair", partial(_behind_a_ball, share=0.4)),
    ("car", partial(_behind_a_ball, share=0.4)),
]


@pytest.mark.parametrize(("name", "hide"), HIDDEN)
def test_an_object_behind_something_is_occluded_unless_that_is_unknown(name, hide):
    scene = example(name)
    view, before = hide(scene.view)
    finding, hidden = occluder(view, 2, scene.target)
    assert finding == Finding("occluder", (2,), finding.score, finding.gain, values=finding.values)
    assert not finding.suspicious
    assert 20.0 < finding.values["share"] < 60.0
    gone = scene.view.inside & ~view.inside
    assert hidden[gone].mean() > 0.85
    assert not hidden[view.inside].any()
    assert occluder(replace(view, known=~before), 2, scene.target) is None


# The example's start is another aeroplane, which fits the rest too badly.
@pytest.mark.parametrize(("name", "hide"), [one for one in HIDDEN if one[0] != "airplane"])
def test_a_cloud_does_not_follow_the_outline_of_what_hides_it(name, hide):
    scene = example(name)
    view, _ = hide(scene.view)
    result = refine(scene.points, view, config=RefineConfig(accept_doubtful=True))
    assert "occluder" in [finding.name for finding in result.findings]
    before, after = (
        chamfer(points, scene.target).chamfer for points in (scene.points, result.points)
    )
    assert after < 1.05 * before


def test_a_part_that_other_masks_do_not_show_is_a_part_that_the_object_lacks():
    scene = example("car")
    length = scene.target[:, np.ptp(scene.target, axis=0).argmax()]
    without = scene.target[length < np.quantile(length, 0.7)]
    view, *others = (
        seen(without, turned(scene.camera, angle)) for angle in (0.0, 60.0, 120.0, 180.0)
    )
    assert occluder(view, 0, scene.target)
    assert occluder(view, 0, scene.target, others) is None


def test_a_part_that_other_masks_show_is_hidden():
    scene = example("car")
    view, _ = _behind_a_wall(scene.view, 20.0, 0.4)
    others = [seen(scene.target, turned(scene.camera, angle)) for angle in (60.0, 120.0)]
    assert occluder(view, 0, scene.target, others)


def _ragged(rows: int) -> tuple[View, np.ndarray]:
    """A mask of 16 x 10 cells of 8 px, and a cloud that covers the lower ``rows`` of them.

    Above the mask the cloud has slats that touch the mask along its whole width.
    """
    inside = np.zeros((160, 160), np.float32)
    inside[64:144, 16:144] = 1.0
    cells = np.zeros((20, 20), bool)
    cells[18 - rows : 18, 2:18] = True
    cells[5, 2:18] = cells[5:8, 2:18:2] = True
    row, column = np.nonzero(cells.repeat(4, 0).repeat(4, 1))
    camera = Camera(np.eye(3), np.eye(3), np.array([0.0, 0.0, 5.0]), 160, 160, "orthographic")
    points = np.stack([2.0 * column + 0.5, 2.0 * row + 0.5, np.zeros(len(row))], 1)
    return View(inside, camera), points


def test_a_part_that_touches_the_mask_broadly_needs_two_masks_that_show_it():
    view, points = _ragged(rows=8)
    shows = View(np.pad(np.ones((140, 140), np.float32), 10), view.camera)
    for others, found in (([], False), ([shows], False), ([shows, shows], True)):
        assert (occluder(view, 0, points, others) is not None) == found


def test_a_part_that_touches_the_mask_broadly_is_hidden_if_the_rest_agrees_very_well():
    view, points = _ragged(rows=10)
    assert occluder(view, 0, points)


@pytest.mark.filterwarnings("error")
def test_a_cloud_that_fills_the_hole_of_a_frame_is_not_occluded():
    # 15 cells across: the middle of one cell is the middle of the mask.
    away = np.abs(np.mgrid[:160, :160] - 79.5).max(0)
    view = View(np.float32((away > 45) & (away < 75)), _ragged(8)[0].camera)
    row, column = np.nonzero(away < 75)
    points = np.stack([column, row, np.zeros(len(row))], 1)[::5]
    assert occluder(view, 0, points.astype(float)) is None


def test_a_cloud_that_is_too_large_at_all_sides_is_not_occluded():
    scene = example("chair")
    middle = scene.target.mean(0)
    assert occluder(scene.view, 0, middle + 1.4 * (scene.target - middle)) is None


def test_an_object_that_the_picture_cuts_off_is_not_occluded():
    scene = example("chair")
    rows = np.flatnonzero(scene.view.inside.any(1))
    height = int(np.quantile(rows, 0.6))
    view = View(scene.mask[:height], replace(scene.camera, height=height))
    assert occluder(view, 0, scene.points) is None


@pytest.mark.parametrize("times", [4, 9])
def test_in_a_large_picture_the_same_is_found(times):
    scene = example("car")
    K = scene.camera.K * [[times], [times], [1.0]]
    K[:2, 2] += (times - 1.0) / 2.0
    width, height = times * scene.camera.width, times * scene.camera.height
    camera = replace(scene.camera, K=K, width=width, height=height)
    whole = View(scene.mask.repeat(times, 0).repeat(times, 1), camera)
    assert occluder(_behind_a_wall(whole, 20.0, 0.4)[0], 0, scene.points)
    assert occluder(whole, 0, scene.points) is None
