"""`tso refine` says what moved apart from what to think of it."""

import numpy as np
import pytest

from tests.scenes import EXAMPLES, about
from tso_cli.commands.refine.run import EXIT_UNCHANGED
from tso_cli.diagnosis.trust import LEAST_CONFIDENCE, MOST_OF_DOUBTFUL
from tso_cli.io.clouds import read_cloud, write_cloud
from tso_cli.refinement import judge

CHAIR = ("initial.ply", "mask.png")
# Its start is near its true shape.
CAR = (str(EXAMPLES / "car" / "initial.ply"), str(EXAMPLES / "car" / "mask.png"))
OF_A_VERDICT = ("verdict", "moved", "moved_as", "stop_reason")


@pytest.fixture
def unsure(monkeypatch):
    """The model is sure of nothing."""
    monkeypatch.setattr(judge, "confidence_of", lambda _: (LEAST_CONFIDENCE / 2.0, "motion"))


@pytest.fixture
def turned(folder):
    """The true chair, turned a little."""
    points = read_cloud("target.ply").points @ about("y", 5.0).T
    write_cloud(folder / "turned.ply", points)


def of(refine, *arguments):
    """What is said, and whether the points of the output are those of the input."""
    document = refine(*arguments, "-o", "out.ply", "--json", "--overwrite").document
    same = np.array_equal(read_cloud(arguments[0]).points, read_cloud("out.ply").points)
    return tuple(document[name] for name in OF_A_VERDICT), same


def test_what_moved_and_fits_better(folder, refine):
    assert of(refine, *CHAIR) == (("fits better", True, "nothing", "max_steps"), False)
    assert refine(*CHAIR, "--strict", "-o", "strict.ply").code == 0


def test_a_doubtful_result_moved_if_it_moved_little(folder, unsure, refine):
    assert of(refine, *CAR) == (("doubtful", True, "nothing", "max_steps"), False)
    moved = read_cloud("out.ply").points - read_cloud(CAR[0]).points
    size = np.ptp(read_cloud(CAR[0]).points, axis=0).max()
    assert np.sqrt(np.square(moved).sum(1).mean()) <= MOST_OF_DOUBTFUL * size


def test_a_doubtful_result_that_would_move_far_is_left(folder, unsure, refine):
    assert of(refine, *CHAIR) == (("doubtful", False, "nothing", "doubtful"), True)
    accepted = (*CHAIR, "--accept-doubtful")
    assert of(refine, *accepted) == (("doubtful", True, "nothing", "max_steps"), False)


def test_a_start_that_fits_is_left(folder, refine):
    assert of(refine, "target.ply", "mask.png") == (("left", False, "nothing", "fits"), True)


def test_what_moved_as_one_by_default_moved_and_is_doubtful(turned, refine):
    assert of(refine, "turned.ply", "mask.png") == (("doubtful", True, "pose", "fits"), False)
    assert refine("turned.ply", "mask.png", "--strict", "-o", "strict.ply").code == 3


def test_a_camera_that_moved_moved_though_no_point_did(turned, refine):
    (_, moved, as_one, _), same = of(refine, "turned.ply", "mask.png", "--move", "camera", "--only")
    assert (moved, as_one, same) == (True, "camera", True)


@pytest.mark.parametrize("arguments", [("target.ply",), ("initial.ply", "--steps", "0")])
def test_strict_writes_a_cloud_that_is_left_and_says_so_by_its_code(folder, refine, arguments):
    source, *options = arguments
    words = (source, "mask.png", *options, "-o", "left.ply")
    assert refine(*words).code == 0
    run = refine(*words, "--strict", "--overwrite")
    assert run.code == EXIT_UNCHANGED == 4
    np.testing.assert_array_equal(read_cloud("left.ply").points, read_cloud(source).points)
