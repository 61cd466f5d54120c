"""Cameras of scan apps, trackers and networks: each shows a shape where the true camera shows it.

The files in `files/scans` are as programs write them, of the camera in `files/cameras/own.json`.
"""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.corruption import assert_refused
from tso_cli.geometry.camera import Camera
from tso_cli.io.cameras import paired, read_partial_cameras

FILES = Path(__file__).with_name("files")
SCANS = FILES / "scans"
TRUE = Camera(**json.loads((FILES / "cameras/own.json").read_text()))
POINTS = np.random.default_rng(0).uniform(-0.5, 0.5, (20, 3))
E = np.vstack([np.c_[TRUE.R, TRUE.t], [0.0, 0.0, 0.0, 1.0]])
C2W = np.linalg.inv(E)
# Of ARKit: y up and z backward, pixels counted from the corner.
ARKIT = C2W @ np.diag([1.0, -1.0, -1.0, 1.0])
ARKIT_K = TRUE.K + [[0.0, 0.0, 0.5], [0.0, 0.0, 0.5], [0.0, 0.0, 0.0]]


def views_of(path):
    """The complete cameras of a file; one without a focal length gets the true K."""
    views, _ = read_partial_cameras(path)
    cameras = []
    for view in views:
        if view.intrinsics is None:
            cameras.append(Camera(TRUE.K, view.R, view.t, 256, 256))
        else:
            cameras.append(view.camera(path, 256, 256))
    return cameras


def assert_sees(camera):
    for seen, wanted in zip(camera.project(POINTS), TRUE.project(POINTS), strict=True):
        np.testing.assert_allclose(seen, wanted, atol=1e-3)


def saved(path, content):
    if path.suffix == ".npz":
        np.savez(path, **content)
    else:
        path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


@pytest.mark.filterwarnings("ignore:.*raw.glb")
@pytest.mark.parametrize(
    ("path", "name"),
    {
        "polycam": "arkit",
        "polycam/keyframes/corrected_cameras": "arkit",
        "polycam/keyframes/corrected_cameras/512345678901234.json": "arkit",
        "scanner_app": "arkit",
        "scanner_app/frame_00000.json": "arkit",
        "record3d": "arkit",
        "record3d/metadata": "arkit",
        "stray": "trajectory",
        "stray/odometry.csv": "trajectory",
        "tum.txt": "trajectory",
        "scannet": "scannet",
        "scannet/pose/0.txt": "scannet",
        "realitycapture.csv": "realitycapture",
        "vggt.npz": "matrices",
        "dust3r.npz": "matrices",
        "mapanything.json": "tso",
    }.items(),
)
def test_a_scan_shows_a_shape_where_the_true_camera_shows_it(path, name):
    assert read_partial_cameras(SCANS / path)[1] == name
    (camera,) = views_of(SCANS / path)
    assert_sees(camera)


def test_polycam_is_in_the_frame_of_its_mesh_where_a_file_says_this(tmp_path):
    shutil.copytree(SCANS / "polycam", tmp_path / "capture")
    with pytest.warns(UserWarning, match=r"mesh_info\.json: the cloud is taken to be in the frame"):
        (in_mesh,) = views_of(tmp_path / "capture")
    (tmp_path / "capture/mesh_info.json").unlink()
    (raw,) = views_of(tmp_path / "capture")
    assert_sees(in_mesh)
    assert np.abs(raw.t - in_mesh.t).max() > 0.1


@pytest.mark.parametrize("nested", [False, True])
def test_a_frame_of_arkit_is_by_columns(tmp_path, nested):
    pose, K = (matrix.T if nested else matrix.T.ravel() for matrix in (ARKIT, ARKIT_K))
    document = {"transform": pose.tolist(), "intrinsics": K.tolist(), "imageResolution": [256, 256]}
    (camera,) = views_of(saved(tmp_path / "frame.json", document))
    assert_sees(camera)


def test_a_mask_finds_its_picture_of_a_folder_by_the_name(tmp_path):
    folder = tmp_path / "scan"
    shutil.copytree(SCANS / "scannet", folder)
    moved = C2W + [[0.0, 0.0, 0.0, 1.0], *np.zeros((3, 4))]
    np.savetxt(folder / "pose/10.txt", moved)
    views, _ = read_partial_cameras(folder)
    # The pose of 1.txt is infinite: the tracking was lost.
    assert [view.names for view in views] == [("0",), ("10",)]
    ((view,), by_name) = paired(folder, views, [tmp_path / "10.png"])
    assert by_name
    np.testing.assert_allclose(view.t, TRUE.t - TRUE.R[:, 0], atol=1e-9)
    assert_refused(r"pose\[0\]\[0\] is -inf", read_partial_cameras, folder / "pose/1.txt")


def test_record3d_has_a_K_for_each_picture_and_may_have_no_pose(tmp_path):
    document = json.loads((SCANS / "record3d/metadata").read_text())
    poses, K = document["poses"] * 2, document.pop("perFrameIntrinsicCoeffs")
    other = [[500.0, 510.0, 120.5, 130.5]]
    path = saved(
        tmp_path / "metadata", document | {"poses": poses, "perFrameIntrinsicCoeffs": K + other}
    )
    np.testing.assert_allclose(views_of(path)[1].K, [[500, 0, 120], [0, 510, 130], [0, 0, 1]])
    (view,), _ = read_partial_cameras(saved(path, document | {"poses": []}))
    np.testing.assert_allclose(view.intrinsics(256, 256), TRUE.K)
    assert view.R is None


def test_odometry_may_have_a_K_for_each_picture(tmp_path):
    header, row = (SCANS / "stray/odometry.csv").read_text().splitlines()
    lines = f"{header}, fx, fy, cx, cy\n{row}, 480, 480, 128, 128\n"
    (camera,) = views_of(saved(tmp_path / "odometry.csv", lines))
    assert_sees(camera)
    assert_refused(
        r"line 2: a row is 9 values, expected 13", read_partial_cameras,
        saved(tmp_path / "odometry.csv", f"{header}, fx, fy, cx, cy\n{row}\n"),
    )  # fmt: skip
    tum = (SCANS / "tum.txt").read_text()
    path = saved(tmp_path / "tum.txt", tum + "1305031102.2 0 0 0\n")
    assert_refused(r"pose 1: qw is missing, expected a position", read_partial_cameras, path)


def test_realitycapture_says_the_principal_point_in_mm_and_the_lens(tmp_path):
    header, row = (SCANS / "realitycapture.csv").read_text().splitlines()
    cells = row.split(",")
    cells[8:13] = ["0.9", "-0.45", "0.1", "-0.02", "0.01"]
    (view,), _ = read_partial_cameras(saved(tmp_path / "a.csv", f"{header}\n{','.join(cells)}\n"))
    # 36 mm are the longer side of 256 pixels.
    np.testing.assert_allclose(view.intrinsics(256, 256)[:2, 2], [127.5 + 6.4, 127.5 - 3.2])
    assert view.distortion.coefficients == (0.1, -0.02, 0.0, 0.0, 0.01)
    assert view.image == tmp_path / "mask.png"
    cells[-1] = "0.001"
    path = saved(tmp_path / "a.csv", f"{header}\n{','.join(cells)}\n")
    assert_refused("line 2: t2 is 0.001, expected 0; export undist", read_partial_cameras, path)


def test_networks_store_a_batch_of_one_scene(tmp_path):
    second = np.linalg.inv(C2W + np.eye(4, k=3))
    poses, K = np.stack([E, second])[:, :3], np.stack([TRUE.K] * 2)
    path = saved(tmp_path / "a.npz", {"extrinsic": poses[None], "intrinsic": K[None]})
    first, other = views_of(path)
    assert_sees(first)
    np.testing.assert_allclose(other.t, second[:3, 3])


def test_a_focal_length_of_dust3r_has_its_principal_point_or_that_of_the_middle(tmp_path):
    content = {"cams2world": C2W[None], "focals": np.array([480.0])}
    assert_sees(*views_of(saved(tmp_path / "a.npz", content)))
    path = saved(tmp_path / "a.npz", content | {"pp": np.array([[100.0, 90.0]])})
    np.testing.assert_allclose(views_of(path)[0].K[:2, 2], [100.0, 90.0])


TRANSPOSED_K = {
    "flat.json": {"K": TRUE.K.T.ravel().tolist(), "E": E.tolist()},
    "nested.json": {"intrinsics": TRUE.K.T.tolist()},
    "a.npz": {"K": TRUE.K.T},
    "a.txt": "\n".join(" ".join(map(str, row)) for row in TRUE.K.T),
    "a.csv": "\n".join(",".join(map(str, row)) for row in TRUE.K.T),
}


@pytest.mark.parametrize("name", TRANSPOSED_K)
def test_a_transposed_K_is_said_to_be_one(tmp_path, name):
    assert_refused(
        r"the last row of K is 127\.5 127\.5 1, expected 0 0 1; transpose the matrix",
        read_partial_cameras,
        saved(tmp_path / name, TRANSPOSED_K[name]),
    )


@pytest.mark.filterwarnings("ignore:.*unknown keys")
@pytest.mark.parametrize("name", ["a.json", "a.npz"])
def test_a_pose_whose_direction_is_not_said_is_named(tmp_path, name):
    K, pose = (matrix.tolist() if name == "a.json" else matrix for matrix in (TRUE.K, C2W))
    path = saved(tmp_path / name, {"K": K, "camera_pose": pose, "T_world_cam": pose})
    (view,), _ = read_partial_cameras(path)
    assert_refused(
        "has K, and camera_pose and T_world_cam may be the pose, expected the name w2c",
        view.camera, path, 256, 256,
    )  # fmt: skip
