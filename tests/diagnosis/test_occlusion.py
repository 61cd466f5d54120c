"""What stands before an object is noticed by its straight edge."""

from dataclasses import replace

import numpy as np
import pytest

from tests.scenes import example
from tso_cli import View, refine
from tso_cli.diagnosis.agreement import Agreement


def _behind_a_wall(view: View, degrees: float, share: float) -> tuple[View, np.ndarray]:
    """The view with so much of its object behind a wall, whose edge is turned so far; and the wall [H, W]."""
    across = np.radians(degrees)
    rows, columns = np.indices(view.mask.shape)
    side = columns * np.cos(across) + rows * np.sin(across)
    wall = side > np.quantile(side[view.inside], 1.0 - share)
    return replace(view, mask=np.where(wall, np.float32(0.0), view.mask)), wall


@pytest.mark.parametrize("name", ["chair", "car", "airplane"])
def test_a_whole_object_is_not_hidden(name):
    scene = example(name)
    assert Agreement.of(scene.points, [scene.view]).named == ()


@pytest.mark.parametrize(
    ("name", "degrees"), [("chair", 90.0), ("car", 20.0), ("car", 200.0), ("airplane", 0.0)]
)
def test_an_object_behind_a_wall_is_said_to_be_hidden_unless_the_wall_is_ignored(name, degrees):
    scene = example(name)
    view, wall = _behind_a_wall(scene.view, degrees, 0.4)
    (suspect,) = Agreement.of(scene.points, [view]).named
    assert (suspect.option, suspect.what) == (
        "--ignore FILE",
        f"something hides a part of the object in {view.name}",
    )
    assert 0.0 < suspect.score <= 1.0
    assert any("try --ignore" in warning for warning in refine(scene.points, view).warnings)
    assert Agreement.of(scene.points, [replace(view, known=~wall)]).named == ()


def test_an_object_that_the_picture_cuts_off_is_not_hidden():
    scene = example("chair")
    rows = np.flatnonzero(scene.view.inside.any(1))
    height = int(np.quantile(rows, 0.6))
    camera = replace(scene.camera, height=height)
    assert Agreement.of(scene.points, [View(scene.mask[:height], camera)]).named == ()


@pytest.mark.parametrize("times", [4, 9])
def test_a_large_picture_is_told_the_same(times):
    scene = example("car")
    K = scene.camera.K * [[times], [times], [1.0]]
    K[:2, 2] += (times - 1.0) / 2.0
    camera = replace(
        scene.camera, K=K, width=times * scene.camera.width, height=times * scene.camera.height
    )
    whole = View(scene.mask.repeat(times, 0).repeat(times, 1), camera)
    (suspect,) = Agreement.of(scene.points, [_behind_a_wall(whole, 20.0, 0.4)[0]]).named
    assert suspect.option == "--ignore FILE"
    assert Agreement.of(scene.points, [whole]).named == ()
