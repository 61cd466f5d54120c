"""`tso refine --camera fit --depth` finds the pose of an object in the axes of a depth map."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.scenes import about, depth_of
from tso_cli.geometry.rotations import angle_between
from tso_cli.io.clouds import write_cloud

FIT = ("model.ply", "mask.png", "--camera", "fit", "--depth", "depth.npy", "--only")
K = ("--intrinsics", "camera.json")
SIZE = 0.4


@pytest.fixture
def model(folder, chair):
    """The true chair in a frame and a unit of its own; the matrix to the axes of the camera."""
    turn = about("x", 70.0) @ about("z", 130.0)
    write_cloud(folder / "model.ply", SIZE * chair.target @ turn.T + 3.0)
    np.save(folder / "depth.npy", depth_of(chair))
    truth = np.eye(4)
    truth[:3, :3] = chair.camera.R @ turn.T / SIZE
    truth[:3, 3] = chair.camera.t - truth[:3, :3] @ [3.0, 3.0, 3.0]
    return truth


def test_a_model_comes_to_the_depth_map_from_any_frame_and_unit(model, refine):
    document = refine(*FIT, *K, "--json", "--write-transform", "pose.json").document
    matrix = np.array(json.loads(Path("pose.json").read_text())["matrix"])
    assert (document["moved_as"], document["frame"]) == ("similarity", "camera")
    size = np.cbrt(np.linalg.det(matrix[:3, :3]))
    assert size * SIZE == pytest.approx(1.0, abs=0.02)
    rotations = (part[:3, :3] / np.cbrt(np.linalg.det(part[:3, :3])) for part in (matrix, model))
    degrees = float(angle_between(*rotations))
    assert degrees < 2.0
    # It says how exact it is, and is about that exact.
    assert degrees < 3.0 * np.linalg.norm(document["exact_to"]["degrees"]) < 6.0


def test_the_summary_says_how_exact_a_pose_is(model, refine):
    run = refine(*FIT, *K)
    (line,) = [line for line in run.out.splitlines() if line.startswith("  pose")]
    assert "degrees" in line
    assert line.endswith("(standard deviations)")


@pytest.mark.parametrize(
    ("more", "says"),
    [
        ((), "expected --intrinsics, --focal or --fov"),
        ((*K, "--move", "shape"), "found --move shape"),
        ((*K, "--pose-index", "1"), "--json lists the other places"),
    ],
)
def test_what_a_pose_with_depth_needs(model, refine, more, says):
    assert says in refine(*FIT, *more).refusal
