"""The pose that SAM 3D Objects gives an object, as users store it in JSON."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.spatial.transform import Rotation

from tests.corruption import assert_refused
from tests.readme import ROOT
from tests.scenes import example
from tso_cli.io.cameras import read_camera, read_partial_cameras
from tso_cli.io.clouds import read_cloud
from tso_cli.io.views import ViewFiles
from tso_cli.scene.load import load_points_scene

SIZE = 320, 240
QUATERNION = np.array([0.8, -0.3, 0.2, 0.5])  # w first, and not of length 1
TRANSLATION, SCALE = np.array([0.1, -0.2, 1.6]), 0.6
# As MoGe gives it: in shares of width and height, with the corner of the picture at 0.
SHARES = np.array([[1.5, 0.0, 0.52], [0.0, 2.0, 0.47], [0.0, 0.0, 1.0]])
# The program writes its splats as they are, and the rows of the vertices of its .glb times this.
TO_GLB = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
POSE = {
    "rotation": [QUATERNION.tolist()],
    "translation": [TRANSLATION.tolist()],
    "scale": [[SCALE] * 3],
    "intrinsics": SHARES.tolist(),
}


def seen_by_pytorch3d(points: np.ndarray) -> np.ndarray:
    """Pixels [N, 2] of splats [N, 3], step by step as `make_scene` and PyTorch3D have it.

    Points are rows: each matrix [4, 4] stands on their right, and a shift is its last row.
    """
    scaled, turned, shifted = np.eye(4), np.eye(4), np.eye(4)
    scaled[:3, :3] *= SCALE
    w, x, y, z = QUATERNION
    turned[:3, :3] = Rotation.from_quat([x, y, z, w]).as_matrix()
    shifted[3, :3] = TRANSLATION
    rows = np.c_[points, np.ones(len(points))] @ scaled @ turned @ shifted
    left, up, depth = rows[:, :3].T
    width, height = SIZE
    from_left = (SHARES[0, 2] - SHARES[0, 0] * left / depth) * width
    from_top = (SHARES[1, 2] - SHARES[1, 1] * up / depth) * height
    # The centre of the first pixel is at 0.5 there, and at 0 here.
    return np.stack([from_left, from_top], 1) - 0.5


@pytest.fixture
def stored(save):
    def store(**changes):
        document = {key: value for key, value in (POSE | changes).items() if value is not None}
        return save("pose.json", document)

    return store


def test_points_are_seen_where_pytorch3d_sees_them(stored):
    points = example("chair").target
    camera = read_camera(stored(), *SIZE)
    np.testing.assert_allclose(camera.project(points)[0], seen_by_pytorch3d(points), atol=1e-9)


@pytest.mark.parametrize(
    "changes",
    [
        {"rotation": QUATERNION.tolist(), "translation": TRANSLATION.tolist(), "scale": SCALE},
        {"rotation": [[QUATERNION.tolist()]], "scale": [SCALE]},
        {"rotation": [(-3.0 * QUATERNION).tolist()]},
        {"scale": [[SCALE - 1e-4, SCALE, SCALE + 1e-4]]},
        {"intrinsics": [SHARES.tolist()]},
        {"intrinsics": SHARES.ravel().tolist()},
        {"intrinsics": (np.diag([*SIZE, 1.0]) @ SHARES).tolist()},
        {"intrinsics": None, "K": SHARES.tolist()},
        {"iou": 0.9, "intrinsics": SHARES.tolist()},
    ],
)
def test_the_forms_that_users_store_are_the_same_camera(stored, changes):
    camera, usual = read_camera(stored(**changes), *SIZE), read_camera(stored(), *SIZE)
    for name in "KRt":
        np.testing.assert_allclose(getattr(camera, name), getattr(usual, name), atol=1e-9)


def test_a_list_of_one_object_is_that_object_and_several_are_refused(save):
    (view,), name = read_partial_cameras(save("one.json", [POSE]))
    assert name == "sam3d"
    assert view.z_up
    message = "holds the poses of 2 objects, expected that of one; write one file for each object"
    assert_refused(message, read_partial_cameras, save("two.json", [POSE, POSE]))


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"rotation": [0.0] * 4}, "rotation is a quaternion of length 0, expected w, x, y and z"),
        ({"rotation": np.eye(3).tolist()}, r"rotation is an array \[3, 3\], expected \[4\]"),
        ({"rotation": [POSE["rotation"][0]] * 2}, r"rotation is an array \[2, 4\], expected \[4\]"),
        ({"rotation": [1.0, 0.0, float("nan"), 0.0]}, r"rotation\[2\] is nan, expected a finite"),
        ({"translation": [0.0, 0.0]}, r"translation is an array \[2\], expected \[3\] numbers"),
        ({"translation": "0 0 1"}, r"translation is '0 0 1', expected \[3\] numbers"),
        ({"scale": 0.0}, "scale is 0, expected more than 0"),
        ({"scale": [[0.5, -0.5, 0.5]]}, "scale is 0.5 -0.5 0.5, expected more than 0"),
        ({"scale": [1.0, 1.0, 1.2]}, "scale is 1 1 1.2, expected three numbers that differ by at"),
        ({"scale": [1.0, 1.0]}, r"scale is an array \[2\], expected \[1\] or \[3\] numbers"),
        ({"intrinsics": [1.5, 2.0]}, r"intrinsics is an array \[2\], expected 3x3 or \[9\]"),
    ],
)
def test_a_wrong_value_is_named_with_what_was_expected(stored, changes, says):
    assert_refused(rf"pose\.json: {says}", read_partial_cameras, stored(**changes))


@pytest.fixture
def scene(tmp_path, monkeypatch, stored):
    """A mask, and the same chair as splats with z up and as a mesh with y up; its vertices."""
    monkeypatch.chdir(tmp_path)
    mesh = trimesh.load(next((ROOT / "examples/meshes/chair").glob("*.ply")), process=False)
    mesh.export("mesh.glb")
    y_up = read_cloud("mesh.glb").points
    z_up = y_up @ TO_GLB.T
    trimesh.PointCloud(z_up).export("splats.ply")
    mask = np.zeros(SIZE[::-1], np.uint8)
    column, row = seen_by_pytorch3d(z_up).round().astype(int).T
    mask[np.clip(row, 0, SIZE[1] - 1), np.clip(column, 0, SIZE[0] - 1)] = 255
    Image.fromarray(mask).save("mask.png")
    stored()
    return y_up, z_up


def test_the_pose_is_that_of_the_splats_and_is_turned_for_a_glb(scene):
    y_up, z_up = scene
    files = ViewFiles([Path("mask.png")], Path("pose.json"))
    for name, points, turned in (("splats.ply", z_up, False), ("mesh.glb", y_up, True)):
        loaded = load_points_scene(Path(name), files)
        pixels = loaded.view.camera.project(points)[0]
        np.testing.assert_allclose(pixels, seen_by_pytorch3d(z_up), atol=1e-4)
        assert ("turned for a cloud with y up" in loaded.camera_summary) == turned


def test_a_pose_without_K_takes_the_focal_length_that_is_given(scene, stored, refine):
    given = ("mesh.glb", "mask.png", "--check", "--camera", "pose.json")
    refusal = refine(*given, "--focal", "480").refusal
    assert "pose.json: has K, and --focal or --fov says it again, expected one" in refusal
    stored(intrinsics=None)
    refusal = refine(*given).refusal
    words = "name a file with K: --intrinsics FILE, or give --focal PX or --fov DEGREES"
    assert f"pose.json: has a pose but no focal length, expected both; {words}" in refusal
    angle = 2.0 * np.degrees(np.arctan(0.5 / SHARES[0, 0]))
    for words in (("--focal", "480"), ("--fov", str(angle))):
        run = refine(*given, *words, "--json")
        np.testing.assert_allclose(
            run.document["views"][0]["camera"]["K"],
            [[480.0, 0.0, 159.5], [0.0, 480.0, 119.5], [0.0, 0.0, 1.0]],
            atol=1e-6,
        )
        source = run.document["views"][0]["camera"]["source"]
        assert "with the given f" in source
    assert "expected one of the two" in refine(*given, "--focal", "480", "--fov", "40").refusal


def test_a_focal_length_alone_is_no_camera(scene, refine):
    refusal = refine("mesh.glb", "mask.png", "--check", "--focal", "480").refusal
    assert "--focal and --fov say nothing about the pose, expected --camera FILE" in refusal
