"""Cameras that are easily taken for something else: each is read as it is meant, or refused."""

import json
import struct
from pathlib import Path

import numpy as np
import pytest

from tests.corruption import assert_refused
from tso_cli.geometry.distortion import Distortion
from tso_cli.io.cameras import paired, read_partial_cameras

FILES = Path(__file__).with_name("files")
TRUTH = json.loads((FILES / "cameras/own.json").read_text())
K, R, T = (np.array(TRUTH[key]) for key in ("K", "R", "t"))
E = np.vstack([np.c_[R, T], [0.0, 0.0, 0.0, 1.0]])
TRANSPOSED = r"the last row of .* is .*, expected 0 0 0 1; transpose the matrix"


def read(path, **options):
    return read_partial_cameras(path, **options)[0]


def cameras_of(path, **options):
    return [view.camera(path, 256, 256) for view in read(path, **options)]


def assert_truth(camera):
    np.testing.assert_allclose(camera.K, K, atol=1e-6)
    np.testing.assert_allclose(camera.R, R, atol=1e-6)
    np.testing.assert_allclose(camera.t, T, atol=1e-6)


def write(path, content):
    if path.suffix == ".npz":
        np.savez(path, **content)
    elif path.suffix == ".npy":
        np.save(path, content)
    else:
        path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


# Matrices

TRANSPOSED_POSES = {
    "own.json": {"K": K.tolist(), "E": E.T.tolist()},
    "flat.json": {"K": K.tolist(), "w2c": E.T.ravel().tolist()},
    "c2w.npz": {"K": K, "c2w": np.linalg.inv(E).T},
    "unnamed.npy": E.T,
    "stack.npy": np.stack([E, E.T]),
    "unnamed.txt": "\n".join(" ".join(map(str, row)) for row in E.T),
    "unnamed.json": E.T.tolist(),
    "transforms.json": {"frames": [{"transform_matrix": E.T.tolist()}], "camera_angle_x": 0.6},
    "open3d.json": {
        "class_name": "PinholeCameraParameters", "extrinsic": E.ravel().tolist(),
        "intrinsic": {"width": 256, "height": 256, "intrinsic_matrix": K.T.ravel().tolist()},
    },
    "log.log": "0 0 1\n" + "\n".join(" ".join(map(str, row)) for row in E.T),
    "kaolin.json": {
        "width": 256, "height": 256, "intrinsics": {"focal_x": 480}, "extrinsics": E.T.tolist(),
    },
    "kalibr.yaml": "cam0: "
    + json.dumps({"intrinsics": [480, 480, 127, 127], "T_cam_imu": E.T.tolist()}),
}  # fmt: skip


@pytest.mark.parametrize("name", TRANSPOSED_POSES)
def test_a_transposed_matrix_is_refused_with_the_advice_to_transpose_it(tmp_path, name):
    assert_refused(TRANSPOSED, read, write(tmp_path / name, TRANSPOSED_POSES[name]))


def test_a_matrix_whose_last_row_is_not_0_0_0_1_is_refused(tmp_path):
    wrong = E + [[0], [0], [0], [0.5]]
    path = write(tmp_path / "c.npz", {"K": K, "E": wrong})
    assert_refused(r"the last row of E is 0\.5 0\.5 0\.5 1\.5, expected 0 0 0 1$", read, path)
    nearly = E + [[0], [0], [0], [1e-7]]
    assert_truth(*cameras_of(write(tmp_path / "c.npz", {"K": K, "E": nearly})))


@pytest.mark.parametrize("name", ["P.npy", "P.txt", "P.npz", "P.json", "stack.npy"])
def test_a_matrix_R_t_is_not_read_as_a_camera_with_a_focal_length_of_1_px(tmp_path, name):
    text = "\n".join(" ".join(map(str, row)) for row in E[:3])
    content = {
        "P.npy": E[:3], "P.txt": text, "P.npz": {"P": E[:3]}, "P.json": {"P": E[:3].tolist()},
        "stack.npy": np.stack([K @ E[:3], E[:3]]),
    }[name]  # fmt: skip
    place = r"\[1\]: " if name == "stack.npy" else ""
    assert_refused(
        rf"{name}: {place}P looks like \[R \| t\].*name it E .* or c2w .* and give K with it",
        read,
        write(tmp_path / name, content),
    )


# R and T


def test_R_and_T_with_a_3x3_K_are_those_of_opencv(tmp_path):
    for shift in (T, T[:, None]):
        path = write(tmp_path / "c.npz", {"K": K, "R": R, "T": shift})
        assert read_partial_cameras(path)[1] == "matrices"
        assert_truth(*cameras_of(path))


def test_R_and_T_alone_may_be_of_opencv_or_pytorch3d_and_are_refused(tmp_path):
    stored = dict(np.load(FILES / "cameras/camera.npz"))
    path = write(tmp_path / "c.npz", {"R": stored["R"], "T": stored["T"]})
    assert_refused("differ between OpenCV and PyTorch3D, expected K", read, path)
    (view,) = read(path, camera_format="pytorch3d")
    np.testing.assert_allclose(view.R, R, atol=1e-6)
    assert view.intrinsics is None
    path = write(tmp_path / "c.npz", {"R": stored["R"], "T": stored["T"], "in_ndc": True})
    assert read_partial_cameras(path)[1] == "pytorch3d"


# OpenCV, ROS and Kalibr


def test_what_calibrateCamera_returns_is_read_under_the_names_of_the_tutorial(tmp_path):
    from tso_cli.geometry.rotations import from_vectors

    rvecs = np.array([[[0.1], [0.2], [0.3]], [[0.0], [0.5], [0.0]]])
    tvecs = np.array([[[0.0], [0.0], [2.0]], [[0.1], [0.0], [3.0]]])
    dist = np.array([[0.1, -0.02, 1e-3, 2e-3, 0.01]])
    path = write(tmp_path / "calib.npz", {"mtx": K, "dist": dist, "rvecs": rvecs, "tvecs": tvecs})
    views = read(path)
    assert [view.title for view in views] == ["pose 0", "pose 1"]
    for view, turn, shift in zip(views, rvecs, tvecs, strict=True):
        np.testing.assert_allclose(view.R, from_vectors(turn.ravel()))
        np.testing.assert_allclose(view.t, shift.ravel())
        assert view.distortion == Distortion("radial-tangential", tuple(dist[0]))
    (alone,) = read(write(tmp_path / "calib.npz", {"mtx": K, "dist": dist}))
    assert alone.R is None
    path = write(tmp_path / "calib.npz", {"mtx": K, "rvecs": rvecs, "tvecs": tvecs[:1]})
    assert_refused("tvecs is 1 vectors, expected 2, as rvecs", read, path)


@pytest.mark.parametrize("name", ["stereo.yml", "stereo.npz"])
def test_the_world_of_a_stereo_calibration_is_its_first_camera(tmp_path, name):
    def matrix(values):
        values = np.atleast_2d(values)
        data = ", ".join(map(repr, values.ravel().tolist()))
        rows, columns = values.shape
        return (
            f" !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [ {data} ]"
        )

    values = {"M1": K, "D1": np.zeros((1, 5)), "M2": K, "D2": np.ones((1, 5)) / 10,
              "R": R, "T": T[:, None]}  # fmt: skip
    text = "".join(f"{key}:{matrix(value)}\n" for key, value in values.items())
    first, second = read(
        write(tmp_path / name, values if name.endswith("z") else f"%YAML:1.0\n---\n{text}")
    )
    np.testing.assert_array_equal(first.R, np.eye(3))
    np.testing.assert_array_equal(first.t, np.zeros(3))
    assert first.distortion.none
    np.testing.assert_allclose(second.R, R)
    np.testing.assert_allclose(second.t, T)
    assert second.distortion.coefficients == (0.1,) * 5


def test_a_matrix_of_opencv_that_ends_early_says_how_many_numbers_it_has(tmp_path):
    matrix = "camera_matrix: !!opencv-matrix\n  rows: 3\n  cols: 3\n  dt: d\n  data: [1., 0.]\n"
    assert_refused(
        r"K: data is 2 numbers, expected rows x cols = 3 x 3", read,
        write(tmp_path / "c.yaml", matrix),
    )  # fmt: skip


@pytest.mark.parametrize("value", [".nan", ".Nan", ".NaN", "-.Inf", ".inf"])
def test_a_number_of_yaml_that_is_not_finite_is_named(tmp_path, value):
    text = f"camera_matrix:\n  rows: 3\n  cols: 3\n  data: [1.0, 0, {value}, 0, 1, 0, 0, 0, 1]\n"
    assert_refused(
        r"K\[0\]\[2\] is (nan|-?inf), expected a finite number", read,
        write(tmp_path / "c.yaml", text),
    )  # fmt: skip


@pytest.mark.parametrize(
    "text",
    ["K: [1, 2\nD: }", "K: &a [1]\nD: *a", "K: " + "[" * 500, "K: " + "- " * 60 + "1", "K: \x01"],
)
def test_what_is_wrong_with_yaml_is_said_in_one_short_line(tmp_path, text):
    path = write(tmp_path / "c.yaml", text)
    with pytest.raises(Exception, match=r"c\.yaml: is not YAML \(") as caught:
        read(path)
    assert len(str(caught.value)) - len(str(path)) < 120
    assert "<unicode string>" not in str(caught.value)


def test_numbers_of_yaml_may_have_an_exponent_without_a_point(tmp_path):
    text = "camera_matrix: [48e1, 0, 1.275e2, 0, 480, 127.5, 0, 0, 1e0]\n"
    (view,) = read(write(tmp_path / "c.yaml", text))
    np.testing.assert_array_equal(view.intrinsics(256, 256), K)


def message(names="KDRP", focal=480.0, stamp=1):
    k, d, r, p = names
    return (
        f"header: \n  seq: {stamp}\n  frame_id: \"camera\"\nheight: 256\nwidth: 256\n"
        f"distortion_model: \"plumb_bob\"\n{d}: [0.1, -0.2, 0.0, 0.0, 0.0]\n"
        f"{k}: [{focal}, 0.0, 127.5, 0.0, {focal}, 127.5, 0.0, 0.0, 1.0]\n"
        f"{r}: [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]\n"
        f"{p}: [{focal}, 0.0, 127.5, 9.0, 0.0, {focal}, 127.5, 0.0, 0.0, 0.0, 1.0, 0.0]\n---\n"
    )  # fmt: skip


@pytest.mark.parametrize("names", ["KDRP", "kdrp"])
def test_messages_of_camera_info_are_one_camera_without_a_pose(tmp_path, names):
    path = write(tmp_path / "info.yaml", message(names) + message(names, stamp=2))
    (view,) = read(path)
    np.testing.assert_array_equal(view.intrinsics(256, 256), K)
    assert view.size == (256, 256)
    assert view.distortion.coefficients[:2] == (0.1, -0.2)
    # R of camera_info rectifies the picture, and P is of the rectified one.
    assert view.R is None
    assert view.t is None
    write(path, message(names) + message(names, focal=500.0))
    assert_refused("holds 2 messages with different K, expected one camera", read, path)


def test_cam0_is_the_world_of_a_camchain_without_an_imu(tmp_path):
    lens = {"intrinsics": [480.0, 480.0, 127.5, 127.5], "resolution": [256, 256]}
    chain = {"cam0": lens, "cam1": lens | {"T_cn_cnm1": E.tolist()}}
    lines = [f"{name}: {json.dumps(values)}" for name, values in chain.items()]
    first, second = cameras_of(write(tmp_path / "c.yaml", "\n".join(lines)))
    np.testing.assert_array_equal(first.R, np.eye(3))
    np.testing.assert_array_equal(first.t, np.zeros(3))
    assert_truth(second)
    (alone,) = read(write(tmp_path / "c.yaml", lines[0]))
    assert alone.R is None
    lines = [*lines, f"cam2: {json.dumps(lens | {'T_cam_imu': E.tolist()})}"]
    path = write(tmp_path / "c.yaml", "\n".join(lines))
    assert_refused("cam1: T_cn_cnm1 follows a camera without a pose", read, path)


# Others


def test_a_file_of_middlebury_that_ends_early_is_refused(tmp_path):
    lines = (FILES / "cameras/temple_par.txt").read_text().splitlines()
    path = write(tmp_path / "temple_par.txt", "\n".join(["3", *lines[1:]]))
    assert_refused("the number of pictures is 3, expected 1, as there are lines", read, path)


def test_cameras_of_idr_are_in_the_frame_of_the_world(tmp_path):
    world = np.vstack([K @ E[:3], [0.0, 0.0, 0.0, 1.0]])
    path = write(
        tmp_path / "cameras_sphere.npz",
        {f"world_mat_{i}": world for i in range(11)} | {"scale_mat_0": np.eye(4) * 2.0},
    )
    with pytest.warns(UserWarning, match="scale_mat is left out: the cloud must be in the frame"):
        views, name = read_partial_cameras(path)
    assert name == "idr"
    assert views[10].names == ("010", "000010")
    for view in views:
        assert_truth(view.camera(path, 256, 256))


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin", "images.txt", "points3D.bin"])
def test_a_file_of_a_colmap_model_stands_for_its_folder(tmp_path, name):
    folder = FILES / ("colmap/sparse/0" if name.endswith("bin") else "colmap_text")
    for file in folder.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    (tmp_path / "points3D.bin").write_bytes(bytes(8))
    assert len(read(tmp_path / name)) == 4
    (tmp_path / name.replace("images", "cameras").replace("points3D", "cameras")).unlink()
    if name != "cameras.bin":
        assert_refused("is a part of a COLMAP model, expected its folder", read, tmp_path / name)


def test_a_colmap_model_may_have_a_binary_and_a_text_file(tmp_path):
    for name, folder in (("cameras.bin", "colmap/sparse/0"), ("images.txt", "colmap_text")):
        (tmp_path / name).write_bytes((FILES / folder / name).read_bytes())
    truth = cameras_of(FILES / "colmap")
    for camera, other in zip(cameras_of(tmp_path), truth, strict=True):
        np.testing.assert_allclose(camera.K, other.K)
        np.testing.assert_allclose(camera.t, other.t)
    (tmp_path / "images.txt").unlink()
    (view,) = read(tmp_path / "cameras.bin")
    assert view.R is None


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin"])
def test_a_huge_count_in_a_file_of_colmap_is_refused_at_once(tmp_path, name):
    for file in (FILES / "colmap/sparse/0").iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    data = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(struct.pack("<Q", 2**63) + data[8:])
    assert_refused("ends early", read, tmp_path)


def test_objects_of_bop_are_listed_in_the_order_of_their_numbers(tmp_path):
    for name in ("scene_camera.json", "scene_gt.json"):
        (tmp_path / name).write_bytes((FILES / "bop" / name).read_bytes())
    poses = json.loads((tmp_path / "scene_gt.json").read_text())
    poses["0"] += [poses["0"][0] | {"obj_id": number} for number in (10, 2)]
    write(tmp_path / "scene_gt.json", poses)
    assert_refused("holds the objects 1, 2, 10, expected one", read, tmp_path)
    assert_refused(
        "no picture shows object 3, expected one of 1, 2, 10: `object` ID", read, tmp_path,
        object_id=3,
    )  # fmt: skip
    assert_refused(
        "holds the poses of objects without K, expected scene_camera.json or its folder", read,
        tmp_path / "scene_gt.json",
    )  # fmt: skip


def test_pix3d_quotes_the_focal_length_of_the_file(tmp_path):
    (entry,) = json.loads((FILES / "cameras/pix3d.json").read_text())
    path = write(tmp_path / "pix3d.json", [entry | {"focal_length": -16.0}])
    assert_refused(r"entry 0: focal_length is -16, expected more than 0 \(mm\)", read, path)


def test_a_mask_that_fits_two_views_is_ambiguous_and_both_are_named(tmp_path):
    frames = [{"transform_matrix": E.tolist(), "file_path": f"{folder}/001.png"} for folder in "ab"]
    path = write(tmp_path / "t.json", {"camera_angle_x": 0.6, "frames": frames})
    assert_refused(
        r"001\.png is ambiguous: it fits 2 views, a/001\.png and b/001\.png, expected one",
        paired, path, read(path), [tmp_path / "001.png"],
    )  # fmt: skip
    ((view,), by_name) = paired(path, read(path), [tmp_path / "b/001.png"])
    assert by_name
    assert view.image == tmp_path / "b/001.png"


def test_nodes_of_a_scene_that_form_a_circle_are_refused(tmp_path):
    scene = {"asset": {"version": "2.0"}, "cameras": [{}], "nodes": [
        {"children": [1]}, {"children": [0]},
    ]}  # fmt: skip
    assert_refused(
        "node 0 is its own ancestor, expected a tree of nodes", read,
        write(tmp_path / "c.gltf", scene),
    )  # fmt: skip


def test_what_a_reader_does_not_find_is_said_in_one_line(tmp_path):
    """A file may have the keys of its format and nothing in them."""
    cases = {
        "c.npz": ({"R": np.zeros((0, 3, 3)), "T": np.zeros((0, 3)), "focal_length": np.zeros(0)},
                  r"c\.npz: cannot be read \(.*\), expected R and T"),
        "a.json": ([{"rot_mat": 1, "trans_mat": 2, "focal_length": 3, "img_size": 4}, "text"],
                   r"a\.json: entry 0: rot_mat is an array \[\], expected 3x3 numbers"),
        "b.json": ({"frames": [{"transform_matrix": np.eye(4).tolist()}, "text"]},
                   r"b\.json: frames\[1\] has another form, expected frames with"),
        "d.json": ({"frames": [{"transform_matrix": np.eye(4).tolist()}, {}]},
                   r"d\.json: frames\[1\]\.transform_matrix is missing, expected frames with"),
    }  # fmt: skip
    for name, (content, message) in cases.items():
        assert_refused(message, read, write(tmp_path / name, content))


def test_a_camera_of_a_chain_without_a_pose_has_none_and_none_follows_from_it(tmp_path):
    lens = {"intrinsics": [480.0, 480.0, 127.5, 127.5], "resolution": [256, 256]}
    step = lens | {"T_cn_cnm1": E.tolist()}
    chains = {
        "cam1: T_cn_cnm1 follows|cam2: T_cn_cnm1 follows": {
            "cam0": lens,
            "cam1": lens,
            "cam2": step,
        },
        "cam2: T_cn_cnm1 follows a camera without": {"cam0": lens, "cam2": step},
        r"cam1\.intrinsics is missing": {"cam0": lens, "cam1": {"T_cn_cnm1": E.tolist()}},
    }
    for message, chain in chains.items():
        text = "\n".join(f"{name}: {json.dumps(values)}" for name, values in chain.items())
        assert_refused(message, read, write(tmp_path / "c.yaml", text))


def test_blank_lines_between_images_of_colmap_hide_none_and_points_are_no_pose(tmp_path):
    write(tmp_path / "cameras.txt", "1 PINHOLE 200 200 100 100 100 100\n")
    rows = [f"{n} 1 0 0 0 {n} 0 0 1 {n}.png" for n in (1, 2)]
    images = tmp_path / "images.txt"
    write(images, f"\n{rows[0]}\n1 2 3\n\n\n{rows[1]}\n5 6 7 1 1 1 1 1 1\n")
    assert [view.t[0] for view in read(tmp_path)] == [1.0, 2.0]
    write(images, f"{rows[0]}\n{rows[1].replace('2.png', 'a b c.png')}\n")
    assert_refused("the line after image 1 is", read, tmp_path)
