"""Cameras as other programs write them: each reader, on a file of the program itself.

The files in `files/` are as COLMAP, Blender, nerfstudio, BOP, Open3D, OpenCV, PyTorch3D and others
write them, for shapes of `examples/meshes`.
"""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.corruption import assert_reads_or_refuses, assert_refused
from tso_cli.errors import InputError
from tso_cli.geometry.distortion import Distortion
from tso_cli.io.cameras import FORMATS, read_partial_cameras
from tso_cli.io.cameras.matching import stem

FILES = Path(__file__).with_name("files")
TRUTH = json.loads((FILES / "cameras/own.json").read_text())
# Points around the origin, and depths at which points in front of a camera are tested.
RNG = np.random.default_rng(0)
POINTS = RNG.uniform(-0.5, 0.5, (20, 3))


def views_of(path, width=256, height=256, **options):
    """The complete cameras of a file."""
    path = FILES / path
    views, _ = read_partial_cameras(path, **options)
    return [view.camera(path, width, height) for view in views]


def assert_is(camera, truth, unit=1.0):
    np.testing.assert_allclose(camera.K, truth["K"], atol=1e-4)
    np.testing.assert_allclose(camera.R, truth["R"], atol=1e-6)
    np.testing.assert_allclose(camera.t, np.array(truth["t"]) * unit, atol=1e-6 * unit)


@pytest.mark.parametrize(
    "name",
    [
        "own.json",
        "t_column.json",
        "matrix44.json",
        "flat.json",
        "krt.npz",
        "P.npy",
        "open3d.json",
        "open3d_trajectory.json",
        "opencv.yaml",
        "kalibr_camchain.yaml",
        "temple_par.txt",
        "pix3d.json",
        "sam3d.json",
        "camera.npz",
        "camera.pt",
    ],
)
def test_a_camera_is_read_as_its_program_wrote_it(name):
    (camera,) = views_of(f"cameras/{name}")
    assert_is(camera, TRUTH)


@pytest.mark.parametrize("folder", ["colmap", "colmap/sparse/0", "colmap_text"])
def test_a_model_of_colmap_is_read_from_its_folder_text_or_binary(folder):
    truth = json.loads((FILES / "colmap/truth.json").read_text())["views"]
    for camera, view in zip(views_of(folder), truth, strict=True):
        assert_is(camera, view)


@pytest.mark.parametrize("path", ["bop", "bop/scene_camera.json"])
def test_a_scene_of_bop_gives_the_pose_of_its_object(path):
    truth = json.loads((FILES / "bop/truth.json").read_text())["views"]
    for camera, view in zip(views_of(path, object_id=1), truth, strict=True):
        assert_is(camera, view)
    views, name = read_partial_cameras(FILES / path)
    assert name == "bop"
    assert views[2].names == ("000002_000000", "000002")


def test_of_several_objects_in_a_scene_of_bop_one_must_be_chosen(tmp_path):
    for name in ("scene_camera.json", "scene_gt.json"):
        (tmp_path / name).write_bytes((FILES / "bop" / name).read_bytes())
    poses = json.loads((tmp_path / "scene_gt.json").read_text())
    poses["0"].append(poses["0"][0] | {"obj_id": 7})
    (tmp_path / "scene_gt.json").write_text(json.dumps(poses))
    assert_refused(
        r"holds the objects 1, 7, expected one; choose it", read_partial_cameras, tmp_path
    )
    (view,), _ = read_partial_cameras(tmp_path, object_id=7)
    assert view.names[0] == "000000_000001"
    assert_refused("no picture shows object 3", read_partial_cameras, tmp_path, object_id=3)


@pytest.mark.parametrize(
    ("path", "focal", "size"),
    [
        ("nerf/transforms_train.json", 480.0, (256, 256)),
        ("nerfstudio", 480.0, (256, 256)),
        ("blender/transforms.json", 444.444412, (320, 240)),
        ("blender/scene.glb", 444.444412, (320, 240)),
    ],
)
def test_a_point_in_front_of_an_opengl_camera_is_seen_where_its_program_sees_it(path, focal, size):
    width, height = size
    cameras = views_of(path, width, height)
    table = FILES / (path if path.endswith("json") else f"{path}/transforms.json")
    if path.endswith("glb"):
        table = FILES / "blender/transforms.json"
    frames = json.loads(table.read_text())["frames"]
    # glTF turns Blender's z up into y up.
    turn = np.eye(3)[[0, 2, 1]] * [[1], [1], [-1]] if path.endswith("glb") else np.eye(3)
    for camera, frame in zip(cameras, frames, strict=True):
        to_world = np.array(frame["transform_matrix"])
        # In the axes of OpenGL: right, up, and at the depth -z.
        right, up, depth = POINTS[:, 0], POINTS[:, 1], 2.0 + POINTS[:, 2]
        world = np.stack([right, up, -depth], 1) @ to_world[:3, :3].T + to_world[:3, 3]
        pixels, found = camera.project(world @ turn.T)
        np.testing.assert_allclose(found, depth, atol=1e-6)
        expected = np.stack([focal * right / depth, -focal * up / depth], 1)
        middle = [(width - 1) / 2, (height - 1) / 2]
        np.testing.assert_allclose(pixels, expected + middle, atol=2e-3)


def test_a_list_of_cameras_of_gaussian_splatting_is_camera_to_world(tmp_path):
    R, t = np.array(TRUTH["R"]), np.array(TRUTH["t"])
    entry = {
        "id": 0, "img_name": "00000", "width": 256, "height": 256, "fx": 480.0, "fy": 480.0,
        "rotation": R.T.tolist(), "position": (-R.T @ t).tolist(),
    }  # fmt: skip
    (tmp_path / "cameras.json").write_text(json.dumps([entry]))
    (camera,) = views_of(tmp_path / "cameras.json")
    assert_is(camera, TRUTH)


def test_pix3d_has_x_to_the_left_and_y_up_and_millimetres():
    (camera,) = views_of("cameras/pix3d.json")
    entry = json.loads((FILES / "cameras/pix3d.json").read_text())[0]
    left, up, depth = POINTS[:, 0], POINTS[:, 1], 2.0 + POINTS[:, 2]
    model = (np.stack([left, up, depth], 1) - entry["trans_mat"]) @ np.array(entry["rot_mat"])
    focal = 60.0 / 32.0 * 256
    expected = np.stack([127.5 - focal * left / depth, 127.5 - focal * up / depth], 1)
    np.testing.assert_allclose(camera.project(model)[0], expected, atol=1e-9)


def test_pytorch3d_in_pixels_is_as_in_normalised_coordinates(tmp_path):
    stored = dict(np.load(FILES / "cameras/camera.npz"))
    half = 128.0
    np.savez(
        tmp_path / "screen.npz",
        R=stored["R"],
        T=stored["T"],
        focal_length=stored["focal_length"] * half,
        principal_point=np.array([[128.0, 128.0]]),
        image_size=np.array([[256, 256]]),
        in_ndc=False,
    )
    (camera,) = views_of(tmp_path / "screen.npz")
    assert_is(camera, TRUTH)


def test_the_principal_point_of_pytorch3d_points_left_and_up(tmp_path):
    stored = dict(np.load(FILES / "cameras/camera.npz"))
    np.savez(tmp_path / "c.npz", **stored, principal_point=np.array([[0.1, 0.2]]))
    (camera,) = views_of(tmp_path / "c.npz")
    np.testing.assert_allclose(camera.K[:2, 2], [127.5 - 12.8, 127.5 - 25.6], atol=1e-9)


def test_a_line_of_3d_r2n2_looks_at_the_origin(tmp_path):
    (tmp_path / "rendering_metadata.txt").write_text("40 25 0 0.8 25\n130 30 0 0.7 25\n")
    first, second = views_of(tmp_path / "rendering_metadata.txt", 137, 137)
    pixels, depth = first.project(np.zeros((1, 3)))
    np.testing.assert_allclose(pixels, [[68.0, 68.0]], atol=1e-9)
    np.testing.assert_allclose(depth, [1.75 * 0.8])
    assert second.t[2] == pytest.approx(1.75 * 0.7)
    views, _ = read_partial_cameras(tmp_path / "rendering_metadata.txt")
    assert [view.label for view in views] == ["00.png", "01.png"]


def test_the_names_of_the_pictures_come_with_the_cameras():
    for path, labels in (
        ("colmap", ["000.png", "001.png", "002.png", "003.png"]),
        ("nerf/transforms_train.json", ["r_0", "r_1", "r_2", "r_3"]),
        ("nerfstudio", [f"frame_0000{i}.png" for i in range(1, 5)]),
        ("blender/scene.glb", ["Cam"]),
    ):
        views, _ = read_partial_cameras(FILES / path)
        assert [view.label for view in views] == labels


def test_a_file_without_a_pose_and_a_file_without_K_say_what_completes_them():
    assert_refused(
        "camera_info.yaml: has K but no pose, expected R and t; `camera` fit with `intrinsics`",
        views_of,
        "cameras/camera_info.yaml",
    )
    assert_refused(
        "open3d_trajectory.log: frame 0: has a pose but no focal length, expected both; name",
        views_of,
        "cameras/open3d_trajectory.log",
    )


def test_a_lens_of_colmap_comes_with_its_distortion(tmp_path):
    (tmp_path / "cameras.txt").write_text(
        "# Camera list\n1 OPENCV 640 480 600 610 320 240 0.1 -0.02 0.001 0.002\n"
        "2 SIMPLE_RADIAL 640 480 600 320 240 0.05\n3 OPENCV_FISHEYE 640 480 6 6 3 2 1 2 3 4\n"
    )
    opencv, radial, fisheye = read_partial_cameras(tmp_path / "cameras.txt")[0]
    assert opencv.distortion == Distortion("radial-tangential", (0.1, -0.02, 0.001, 0.002))
    assert radial.distortion == Distortion("radial-tangential", (0.05,))
    assert fisheye.distortion == Distortion("equidistant", (1.0, 2.0, 3.0, 4.0))
    np.testing.assert_allclose(
        opencv.intrinsics(640, 480), [[600, 0, 319.5], [0, 610, 239.5], [0, 0, 1]]
    )
    (tmp_path / "cameras.txt").write_text("1 FOV 640 480 600 610 320 240 0.1\n")
    assert_refused("colmap image_undistorter", read_partial_cameras, tmp_path / "cameras.txt")


@pytest.mark.parametrize(
    ("begins", "says"),
    [
        (b"SQLite format 3\0rest", "a COLMAP database"),
        (b"<?xml version='1.0'?>\n<document version='2.0.0'><chunk/></document>", "Metashape"),
        (b"NVM_V3 \n1\n", "VisualSFM"),
        (b"\x80\x04\x95rest", "a pickle"),
        (b"BLENDER-v402", "export the scene with its cameras as .glb"),
    ],
)
def test_a_file_that_is_recognised_and_not_read_says_how_to_go_on(tmp_path, begins, says):
    (tmp_path / "cameras.bin").write_bytes(begins)
    assert_refused(says, read_partial_cameras, tmp_path / "cameras.bin")


def test_a_named_format_is_read_whatever_the_file_looks_like(tmp_path):
    assert_refused("expected one of tso, transforms", read_partial_cameras, FILES, "nerf")
    for name in FORMATS:
        # Every reader refuses what is not its own in one line.
        assert_refused(".", read_partial_cameras, FILES / "cameras/opencv.yaml", name) if (
            name != "opencv"
        ) else read_partial_cameras(FILES / "cameras/opencv.yaml", name)


ALONE = sorted(
    path.relative_to(FILES).as_posix()
    for path in FILES.rglob("*")
    if path.is_file() and "truth" not in path.name and path.parent.name not in ("0", "colmap_text")
)


@pytest.mark.parametrize("name", ALONE)
def test_damaged_camera_files_are_read_or_refused_in_one_line(tmp_path, name):
    path = tmp_path / Path(name).name
    path.write_bytes((FILES / name).read_bytes())

    def read(path):
        for view in read_partial_cameras(path)[0]:
            if view.intrinsics is not None and view.R is not None:
                view.camera(path, *(view.size or (256, 256)))

    _, refused = assert_reads_or_refuses(read, path, 40)
    assert refused > 0


@pytest.mark.parametrize("suffix", [".bin", ".txt"])
@pytest.mark.parametrize("name", ["cameras", "images"])
def test_damaged_models_of_colmap_are_read_or_refused_in_one_line(tmp_path, suffix, name):
    folder = FILES / ("colmap/sparse/0" if suffix == ".bin" else "colmap_text")
    for file in folder.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    damaged = tmp_path / f"{name}{suffix}"

    def read(path):
        damaged.write_bytes(path.read_bytes())
        try:
            read_partial_cameras(tmp_path)
        except InputError as error:
            named = str(error).replace(damaged.name, path.name)
            # The folder is named where no single file is to blame.
            raise InputError(named.replace(f"{tmp_path}: ", f"{path}: ")) from None

    copy = tmp_path / f"good{suffix}"
    copy.write_bytes(damaged.read_bytes())
    assert_reads_or_refuses(read, copy, 60)


def test_yaml_runs_nothing_and_has_no_aliases(tmp_path):
    for text in (
        "camera_matrix: !!python/object/apply:os.system ['touch x']\n",
        "a: &a [1, 1]\ncamera_matrix: *a\n",
        "camera_matrix: !!opencv-matrix [1, 2]\n",
    ):
        (tmp_path / "c.yaml").write_text(text)
        assert_refused(r"c\.yaml: is not YAML", read_partial_cameras, tmp_path / "c.yaml")
    (tmp_path / "c.xml").write_text('<?xml version="1.0"?><!DOCTYPE a><opencv_storage/>')
    assert_refused("declares a document type", read_partial_cameras, tmp_path / "c.xml")


def test_opencv_writes_xml_too(tmp_path):
    data = " ".join(map(str, np.ravel(TRUTH["K"])))
    turn = " ".join(map(str, np.ravel(TRUTH["R"])))
    (tmp_path / "c.xml").write_text(
        '<?xml version="1.0"?>\n<opencv_storage>\n<image_width>256</image_width>\n'
        "<image_height>256</image_height>\n"
        f'<camera_matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt><data>{data}'
        f"</data></camera_matrix>\n<R><rows>3</rows><cols>3</cols><data>{turn}</data></R>\n"
        f"<T><rows>3</rows><cols>1</cols><data>{' '.join(map(str, TRUTH['t']))}</data></T>\n"
        "</opencv_storage>\n"
    )
    (camera,) = views_of(tmp_path / "c.xml")
    assert_is(camera, TRUTH)


def test_the_stem_of_a_mask_is_that_of_its_picture():
    for name in ("000.png.png", "000.jpg", "images\\000.JPG", "a/000_mask.png", "000"):
        assert stem(name) == "000"


@pytest.mark.parametrize("name", ["Reader", "Reader()"])
def test_a_reader_of_another_package_is_found_by_its_entry_point(tmp_path, monkeypatch, name):
    """As in docs/files.md: a package may register a reader, a class or an object."""
    module, package = f"my_package_{len(name)}", tmp_path / "package"
    about = package / "my_package-1.dist-info"
    about.mkdir(parents=True)
    source = f"from tests.io.plugin_example import Reader\nreader = {name}\n"
    (package / f"{module}.py").write_text(source)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: my_package\nVersion: 1\n")
    (about / "entry_points.txt").write_text(f"[tso.cameras]\nnumbers = {module}:reader\n")
    monkeypatch.syspath_prepend(package)
    (tmp_path / "c.numbers").write_text("NUMBERS 480 127.5 127.5 0 0 2\n")
    views, name = read_partial_cameras(tmp_path / "c.numbers")
    assert name == "numbers"
    assert views[0].camera(tmp_path, 256, 256).t[2] == 2.0


def test_a_fisheye_of_opencv_is_said_by_its_own_key(tmp_path):
    (tmp_path / "c.yml").write_text(
        "%YAML:1.0\n---\nfisheye_model: 1\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n"
        "   dt: d\n   data: [ 480., 0., 127.5, 0., 480., 127.5, 0., 0., 1. ]\n"
        "distortion_coefficients: !!opencv-matrix\n   rows: 4\n   cols: 1\n   dt: d\n"
        "   data: [ 0.1, 0.2, 0.3, 0.4 ]\n"
    )
    (view,), _ = read_partial_cameras(tmp_path / "c.yml")
    assert view.distortion == Distortion("equidistant", (0.1, 0.2, 0.3, 0.4))


def test_distortion_that_would_be_dropped_is_refused(tmp_path):
    np.savez(tmp_path / "c.npz", K=TRUTH["K"], R=TRUTH["R"], t=TRUTH["t"], dist=[0.1, 0, 0, 0, 0])
    (tmp_path / "c.json").write_text(json.dumps(TRUTH | {"k1": 0.1}))
    for name in ("c.npz", "c.json"):
        assert_refused(
            "is lens distortion, which this format", read_partial_cameras, tmp_path / name
        )
    np.savez(tmp_path / "c.npz", K=TRUTH["K"], R=TRUTH["R"], t=TRUTH["t"], dist=[0.0, 0, 0, 0, 0])
    assert len(read_partial_cameras(tmp_path / "c.npz")[0]) == 1


def test_two_poses_of_one_view_are_refused(tmp_path):
    (tmp_path / "c.json").write_text(json.dumps(TRUTH | {"w2c": np.eye(4).tolist()}))
    assert_refused("has several poses, expected one", read_partial_cameras, tmp_path / "c.json")


def test_images_of_colmap_without_their_lines_of_points_are_refused(tmp_path):
    for name in ("cameras.txt", "images.txt"):
        lines = (FILES / "colmap_text" / name).read_text().splitlines()
        kept = [line for line in lines if not line.startswith("10 10")]
        (tmp_path / name).write_text("\n".join(kept) + "\n")
    assert_refused("the line after image 1 is", read_partial_cameras, tmp_path)


def test_a_key_that_appears_twice_among_many_is_found_at_once(tmp_path):
    keys = ", ".join(f'"k{i}x": 0' for i in range(50_000))
    (tmp_path / "c.json").write_text(f'{{{keys}, "k7x": 0}}')
    assert_refused("'k7x' appears twice", read_partial_cameras, tmp_path / "c.json")


def test_tensors_that_would_fill_the_memory_or_are_no_numbers_are_refused(tmp_path):
    import torch

    torch.save({"R": torch.zeros(1).expand(10**12)}, tmp_path / "huge.pt")
    torch.save({"R": torch.eye(3).to_sparse(), "T": torch.zeros(3)}, tmp_path / "sparse.pt")
    torch.save({"R": [[1.0], [1.0, 2.0]], "T": torch.zeros(3)}, tmp_path / "ragged.pt")
    for name in ("huge.pt", "sparse.pt", "ragged.pt"):
        assert_refused(name, read_partial_cameras, tmp_path / name)


def test_a_folder_of_a_data_set_stands_for_its_cameras(tmp_path):
    assert len(read_partial_cameras(FILES / "nerf")[0]) == 4
    assert len(read_partial_cameras(FILES / "colmap/sparse")[0]) == 4
    for part in ("train", "val"):
        shutil.copy(FILES / "nerf/transforms_train.json", tmp_path / f"transforms_{part}.json")
    assert_refused(
        "holds transforms_train.json and transforms_val.json, expected one",
        read_partial_cameras, tmp_path,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("document", "says"),
    [
        ({"views": [], "intrinsics": [], "poses": []}, "a scene of Meshroom; export it for COLMAP"),
        ({"sfm_data_version": "0.3", "views": []}, "a scene of OpenMVG; export it for COLMAP"),
        ([{"cameras": {}, "shots": {}}], "a reconstruction of OpenSfM; export it for COLMAP"),
    ],
)
def test_scenes_of_other_reconstructions_say_how_to_export_them(save, document, says):
    assert_refused(f"is {says}", read_partial_cameras, save("a.json", document))


def test_a_part_of_a_colmap_model_says_what_is_missing(tmp_path):
    shutil.copy(FILES / "colmap_text/cameras.txt", tmp_path)
    message = r"holds cameras\.txt, and images\.txt or images\.bin is missing"
    assert_refused(message, read_partial_cameras, tmp_path)
    (view, *_), _ = read_partial_cameras(tmp_path / "cameras.txt")
    message = r"has K but no pose, .*; give the folder of the COLMAP model"
    assert_refused(message, view.camera, tmp_path / "cameras.txt", *view.size)
    (tmp_path / "cameras.txt").unlink()
    assert_refused("is a folder without a camera file", read_partial_cameras, tmp_path)


def test_wrong_values_of_json_are_named_without_python(save):
    view = json.loads((FILES / "cameras/own.json").read_text())
    path = save("a.json", view | {"t": [0, 1, "2,1"]})
    assert_refused(r"t\[2\] is '2,1', expected a number", read_partial_cameras, path)
    path = save("a.json", '{"K": ' + "1" * 5000 + "}")
    assert_refused("a number has thousands of digits", read_partial_cameras, path)
    assert_refused("holds nothing, expected", read_partial_cameras, save("a.json", "null"))
