"""What stands before an object is found by its straight edge."""

from dataclasses import replace

import numpy as np
import pytest

from tests.scenes import example
from tso_cli import View
from tso_cli.diagnosis.findings import Finding
from tso_cli.diagnosis.symptoms import occluder

from .common import EXAMPLES, examined, named


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


@pytest.mark.parametrize(
    ("name", "degrees"), [("chair", 90.0), ("car", 20.0), ("car", 200.0), ("airplane", 0.0)]
)
def test_an_object_behind_a_wall_is_occluded_unless_the_wall_is_unknown(name, degrees):
    scene = example(name)
    view, wall = _behind_a_wall(scene.view, degrees, 0.4)
    found = occluder(view, 2, scene.points)
    assert found == Finding("occluder", (2,), score=found.score)
    assert 0.0 < found.score <= 1.0
    assert named(examined(scene.points, [view]).suspicious) == [("occluder", (0,))]
    assert occluder(replace(view, known=~wall), 2, scene.points) is None


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
