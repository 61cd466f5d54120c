"""The recipes for other cameras: what they write sees points where the other program does."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.readme import DOCS, python_blocks
from tso_cli.io.cameras import read_cameras

POINTS = np.random.default_rng(0).uniform(-0.5, 0.5, (20, 3))


@pytest.fixture(scope="module")
def recipes():
    names: dict[str, object] = {}
    for block in python_blocks(DOCS / "conventions.md"):
        exec(block, names)
    return names


def seen_by_one_camera(recipes, folder, views):
    """The pixels of `POINTS` by the camera file of one view."""
    recipes["write"](folder / "camera.json", views)
    (record,) = read_cameras(folder / "camera.json")
    return record.camera.project(POINTS)[0]


def test_a_camera_of_colmap_sees_what_colmap_sees_half_a_pixel_aside(recipes, tmp_path):
    R, t = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix(), np.array([0.1, -0.2, 4.0])
    qx, qy, qz, qw = Rotation.from_matrix(R).as_quat()
    (tmp_path / "cameras.txt").write_text("# comment\n7 PINHOLE 640 480 500 510 320.5 241\n")
    (tmp_path / "images.txt").write_text(
        f"# comment\n1 {qw} {qx} {qy} {qz} 0.1 -0.2 4 7 a.png\n10.5 20.5 -1\n"
    )
    in_camera = POINTS @ R.T + t
    of_colmap = in_camera[:, :2] / in_camera[:, 2:] * [500.0, 510.0] + [320.5, 241.0]
    pixels = seen_by_one_camera(recipes, tmp_path, recipes["from_colmap"](tmp_path))
    assert pixels == pytest.approx(of_colmap - 0.5)


def test_a_camera_of_nerf_looks_along_its_negative_z_with_y_up(recipes, tmp_path):
    to_world = np.eye(4)
    to_world[:3, :3] = Rotation.from_euler("y", 0.4).as_matrix()
    to_world[:3, 3] = to_world[:3, :3] @ [0.0, 0.0, 3.0]
    frame = {"file_path": "a.png", "transform_matrix": to_world.tolist()}
    (tmp_path / "transforms.json").write_text(
        json.dumps({"camera_angle_x": np.pi / 2.0, "frames": [frame]})
    )
    right, up, backward = ((POINTS - to_world[:3, 3]) @ to_world[:3, :3]).T
    # A field of view of 90 degrees has a focal length of half the width.
    expected = np.stack([right, -up], 1) / -backward[:, None] * 100.0 + [99.5, 49.5]
    views = recipes["from_transforms"](tmp_path / "transforms.json", 200, 100)
    assert seen_by_one_camera(recipes, tmp_path, views) == pytest.approx(expected)


def test_a_pose_of_opencv_is_taken_as_it_is(recipes, tmp_path):
    K = np.array([[500.0, 0.0, 319.5], [0.0, 500.0, 239.5], [0.0, 0.0, 1.0]])
    rvec, tvec = np.array([[0.1], [0.7], [-0.3]]), np.array([[0.0], [0.1], [5.0]])
    in_camera = Rotation.from_rotvec(rvec.ravel()).apply(POINTS) + tvec.ravel()
    expected = (in_camera / in_camera[:, 2:]) @ K.T
    views = [recipes["from_opencv"]("a.png", 640, 480, K, rvec, tvec)]
    assert seen_by_one_camera(recipes, tmp_path, views) == pytest.approx(expected[:, :2])
