"""`tso convert` and `tso mask`."""

import json
import shutil
import struct
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.readme import ROOT
from tso_cli.geometry.distortion import Distortion
from tso_cli.geometry.rotations import from_quaternion, from_vectors, to_quaternion
from tso_cli.io.cameras import read_partial_cameras
from tso_cli.io.clouds import read_cloud
from tso_cli.io.images import read_image

FILES = ROOT / "tests/io/files"
FILE_OF_K = FILES / "cameras/camera_info.yaml"
CHAIR = next((ROOT / "examples/meshes/chair").glob("*.ply"))


def cameras_of(path, size=(256, 256)):
    views, _ = read_partial_cameras(Path(path))
    return [view.camera(Path(path), *(view.size or size)) for view in views]


def assert_same_cameras(found, expected, error=1e-9):
    for one, other in zip(found, expected, strict=True):
        for name in ("K", "R", "t"):
            np.testing.assert_allclose(getattr(one, name), getattr(other, name), atol=error)


@pytest.mark.parametrize("format", ["tso", "colmap", "transforms"])
@pytest.mark.parametrize("source", ["colmap", "nerfstudio", "bop", "cameras/open3d.json"])
def test_cameras_of_any_program_become_those_of_another(tso, tmp_path, source, format):
    target = tmp_path / ("model" if format == "colmap" else "cameras.json")
    size = ("--size", "256x256") if source == "bop" else ()
    run = tso("convert", FILES / source, target, "--to", format, *size)
    assert run.code == 0, run.err
    assert_same_cameras(cameras_of(target), cameras_of(FILES / source))
    names = [view.label for view in read_partial_cameras(FILES / source)[0]]
    if source == "colmap":
        assert [view.label for view in read_partial_cameras(target)[0]] == names
    again = tso("convert", FILES / source, target, "--to", format, *size)
    assert again.code == 2
    assert "--overwrite" in again.err


def test_the_distortion_of_a_lens_is_converted_or_refused(tso, tmp_path):
    (tmp_path / "cameras.txt").write_text("1 OPENCV 640 480 600 610 320 240 0.1 -0.02 1e-3 2e-3\n")
    (tmp_path / "images.txt").write_text("1 1 0 0 0 0 0 2 1 a.png\n\n")
    for format, name in (("transforms", "t.json"), ("colmap", "model")):
        assert tso("convert", tmp_path, tmp_path / name, "--to", format).code == 0
        (view,), _ = read_partial_cameras(tmp_path / name)
        lens = view.distortion
        assert lens.model == "radial-tangential"
        assert lens.coefficients[:4] == (0.1, -0.02, 1e-3, 2e-3)
        assert not any(lens.coefficients[4:])
    refusal = tso("convert", tmp_path, tmp_path / "own.json").refusal
    assert "has lens distortion" in refusal
    assert "--to colmap" in refusal
    assert Distortion("radial-tangential", (0.0, 0.0)).none


def test_cameras_without_a_size_ask_for_it(tso, tmp_path):
    refusal = tso("convert", FILES / "cameras/krt.npz", tmp_path / "c.json").refusal
    assert "expected --size WIDTHxHEIGHT" in refusal
    run = tso("convert", FILES / "cameras/krt.npz", tmp_path / "c.json", "--size", "256x256")
    assert run.out.endswith("1 camera of " + str(FILES / "cameras/krt.npz")
                            + " (K, R, t, P or 4x4 matrices)\n")  # fmt: skip
    assert "expected WIDTHxHEIGHT" in tso("convert", "a", "c.json", "--size", "256").err


def names_in(target):
    """The names of the pictures in a COLMAP model or a transforms.json."""
    if target.suffix == ".json":
        return [frame["file_path"] for frame in json.loads(target.read_text())["frames"]]
    lines = (target / "images.txt").read_text().splitlines()
    return [line.split(maxsplit=9)[9] for line in lines[1::2]]


def test_pictures_are_named_by_paths_that_lead_from_the_new_file_to_them(tso, tmp_path):
    shutil.copytree(FILES / "nerfstudio", tmp_path / "scene")
    (tmp_path / "out").mkdir()
    for to, name in (("transforms", "out/t.json"), ("colmap", "out/model")):
        target = tmp_path / name
        assert tso("convert", tmp_path / "scene", target, "--to", to).code == 0
        folder = target if to == "colmap" else target.parent
        names = names_in(target)
        assert [Path(name).name for name in names] == [f"frame_0000{i}.png" for i in range(1, 5)]
        assert all((folder / name).is_file() for name in names)


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("bop", "000002_000000.png"),
        ("blender/scene.glb", "Cam.png"),
        ("cameras/open3d.json", "view_0.png"),
        ("colmap", "002.png"),
    ],
)
def test_a_view_without_a_picture_has_a_name_that_a_file_may_have(tso, tmp_path, source, expected):
    for to, name in (("transforms", "t.json"), ("colmap", "model")):
        target = tmp_path / name
        size = () if source in ("cameras/open3d.json", "colmap") else ("--size", "256x256")
        assert tso("convert", FILES / source, target, "--to", to, *size).code == 0
        assert expected in names_in(target)


def test_two_pictures_of_one_name_are_refused_for_colmap(tso, tmp_path):
    view = json.loads((FILES / "cameras/own.json").read_text()) | {"image": "a.png"}
    (tmp_path / "c.json").write_text(json.dumps([view, view]))
    refusal = tso("convert", tmp_path / "c.json", tmp_path / "model", "--to", "colmap").refusal
    assert "a.png: 2 views have this name, expected one" in refusal
    assert not (tmp_path / "model").exists()


def test_the_format_of_the_first_file_may_be_named_as_in_refine(tso, tmp_path):
    stored = np.load(FILES / "cameras/camera.npz")
    np.savez(tmp_path / "c.npz", R=stored["R"], T=stored["T"])
    source = (tmp_path / "c.npz", tmp_path / "c.json", "--size", "256x256")
    assert "differ between OpenCV and PyTorch3D" in tso("convert", *source).refusal
    refusal = tso("convert", *source, "--camera-format", "pytorch3d").refusal
    assert "has a pose but no focal length" in refusal
    refusal = tso("convert", "a.ply", "b.ply", "--camera-format", "bop").refusal
    assert "--camera-format is for cameras" in refusal
    assert tso("convert", "--camera-format", "list").out.startswith("tso ")


def test_cameras_that_do_not_exist_and_outputs_of_another_suffix_are_refused(tso, tmp_path):
    for name in ("nothing", "nothing.json", "nothing/sparse"):
        refusal = tso("convert", tmp_path / name, tmp_path / "c.json").refusal
        assert "does not exist, expected a camera file" in refusal
    for to in ("tso", "transforms"):
        run = tso("convert", FILES / "cameras/own.json", tmp_path / "c.ply", "--to", to)
        assert "the suffix is '.ply', expected .json" in run.refusal
    run = tso("convert", "a", "c.json", "--size", "100000x100000")
    assert run.code == 2
    assert "expected at most 100,000,000 pixels" in run.err


@pytest.mark.parametrize("suffix", [".ply", ".npy", ".xyz", ".glb", ".obj", ".off", ".stl"])
def test_a_mesh_is_converted_by_the_suffix_of_the_target(tso, tmp_path, suffix):
    target = tmp_path / f"chair{suffix}"
    assert tso("convert", CHAIR, target).code == 0
    before, after = read_cloud(CHAIR).points, read_cloud(target, extended=False).points
    np.testing.assert_allclose(after.max(0), before.max(0), atol=1e-5)
    np.testing.assert_allclose(after.min(0), before.min(0), atol=1e-5)


@pytest.mark.parametrize("suffix", [".ply", ".glb", ".obj", ".off", ".stl"])
def test_coordinates_of_a_map_survive_or_a_warning_says_by_how_much_not(tso, tmp_path, suffix):
    (tmp_path / "map.obj").write_text(
        "v 4512345.678 512345.123 10.5\nv 4512346.678 512345.123 10.5\n"
        "v 4512345.678 512346.123 10.75\nf 1 2 3\n"
    )
    target = tmp_path / f"b{suffix}"
    run = tso("convert", tmp_path / "map.obj", target)
    assert run.code == 0
    before, after = read_cloud(tmp_path / "map.obj").points, read_cloud(target).points
    if suffix in (".glb", ".stl"):
        assert f"are stored as float, as in every {suffix} file: rounding moves" in run.err
        assert "write .ply, .obj or .off to keep the result" in run.err
        assert np.abs(after.max(0) - before.max(0)).max() > 0.1
    else:
        assert np.array_equal(after, before)
        assert "float" not in run.err


def test_a_coordinate_that_no_float_can_hold_is_refused(tso, tmp_path):
    (tmp_path / "far.obj").write_text("v 0 0 0\nv 1e39 0 0\nv 0 1 0\nf 1 2 3\n")
    run = tso("convert", tmp_path / "far.obj", tmp_path / "far.glb")
    assert run.code != 0
    assert "a coordinate does not fit into float, as in every .glb file" in run.err
    assert not (tmp_path / "far.glb").exists()


def test_what_cannot_be_converted_is_refused(tso, tmp_path, folder):
    assert "has no faces" in tso("convert", "initial.ply", tmp_path / "a.glb").refusal
    assert (
        "or for cameras .json, or --to" in tso("convert", "initial.ply", tmp_path / "a.las").refusal
    )
    assert (
        "is for cameras"
        in tso("convert", "initial.ply", tmp_path / "a.npy", "--size", "1x1").refusal
    )


OBJECT = """mtllib paint.mtl
usemtl red
v 0 0 0 1 0 0
v 1 0 0 0 1 0
v 0 1 0 0 0 1
vt 0 0
f 1/1 2/1 3/1
"""


def test_a_file_of_the_same_suffix_is_the_same_file(tso, tmp_path):
    (tmp_path / "a.obj").write_text(OBJECT)
    assert tso("convert", tmp_path / "a.obj", tmp_path / "b.obj").err == ""
    assert (tmp_path / "b.obj").read_text() == OBJECT


def test_colours_and_normals_go_into_a_ply(tso, tmp_path):
    normals = "vn 0 0 1\nf 1//1 2//1 3//1\n"
    (tmp_path / "a.obj").write_text(OBJECT.partition("vt")[0].partition("red\n")[2] + normals)
    assert tso("convert", tmp_path / "a.obj", tmp_path / "a.ply").err == ""
    cloud = read_cloud(tmp_path / "a.ply")
    assert cloud.colours().tolist() == np.eye(3).tolist()
    assert cloud.source.read_normals().tolist() == [[0.0, 0.0, 1.0]] * 3


@pytest.mark.parametrize(
    ("suffix", "lost"),
    [
        (".ply", "materials and texture coordinates"),
        (".glb", "materials, texture coordinates and colours"),
        (".npy", "faces, materials, texture coordinates and colours"),
    ],
)
def test_a_warning_names_what_another_format_loses(tso, tmp_path, suffix, lost):
    (tmp_path / "a.obj").write_text(OBJECT)
    run = tso("convert", tmp_path / "a.obj", tmp_path / f"b{suffix}")
    assert f"its {lost} do not go into {suffix}; write .obj to keep them" in run.err


def test_a_warning_names_the_file_that_must_lie_next_to_the_result(tso, tmp_path):
    (tmp_path / "a.obj").write_text(OBJECT)
    (tmp_path / "paint.mtl").write_text("newmtl red\n")
    (tmp_path / "out").mkdir()
    target = tmp_path / "out/a.obj"
    instead = f"copy it there, or write {tmp_path / 'a.obj'} instead"
    assert (
        f"names paint.mtl, which is not in {target.parent}; {instead}"
        in tso("convert", tmp_path / "a.obj", target).err
    )
    assert tso("convert", tmp_path / "a.obj", tmp_path / "b.obj").err == ""


def test_the_points_of_colmap_are_a_cloud_with_colours(tso, tmp_path):
    (tmp_path / "points3D.txt").write_text("# no\n7 0.5 1 2 255 0 51 0.1 1 2\n8 1 1 2 0 0 0 0.1\n")
    rows = [(7, 0.5, 1.0, 2.0, 255, 0, 51, 0.1, 1, 1, 2), (8, 1.0, 1.0, 2.0, 0, 0, 0, 0.1, 0)]
    data = struct.pack("<Q", 2) + struct.pack("<Q3d3BdQii", *rows[0])
    data += struct.pack("<Q3d3BdQ", *rows[1])
    (tmp_path / "sparse/0").mkdir(parents=True)
    (tmp_path / "sparse/0/points3D.bin").write_bytes(data)
    for source in ("points3D.txt", "sparse/0/points3D.bin", "sparse"):
        run = tso("convert", tmp_path / source, tmp_path / "p.ply", "--overwrite")
        assert run.err == ""
        cloud = read_cloud(tmp_path / "p.ply")
        assert cloud.points.tolist() == [[0.5, 1.0, 2.0], [1.0, 1.0, 2.0]]
        assert cloud.colours()[0].tolist() == [1.0, 0.0, 0.2]
    (tmp_path / "sparse/0/points3D.bin").write_bytes(data[:-1])
    refusal = tso("convert", tmp_path / "sparse", tmp_path / "p.ply", "--overwrite").refusal
    assert "points3D.bin: ends early" in refusal
    (tmp_path / "points3D.txt").write_text("1 2 3\n")
    refusal = tso("convert", tmp_path / "points3D.txt", tmp_path / "p.ply", "--overwrite").refusal
    assert "line 1 has 3 columns, expected at least 8" in refusal


def test_a_quaternion_is_that_of_its_rotation():
    for vector in np.random.default_rng(0).normal(size=(20, 3)) * 2.0:
        R = from_vectors(vector)
        np.testing.assert_allclose(from_quaternion(*to_quaternion(R)), R, atol=1e-12)


def test_mask_shows_what_would_be_used_and_writes_it(tso, tmp_path, folder):
    run = tso("mask", "mask.png", "-o", tmp_path / "used.png", "--json")
    document = run.document
    assert (document["width"], document["height"]) == (256, 256)
    with Image.open("mask.png") as image:
        expected = np.asarray(image.convert("L"))
    np.testing.assert_array_equal(read_image(tmp_path / "used.png")[..., 0], expected)
    assert document["foreground"] == np.count_nonzero(expected > 127)
    text = tso("mask", FILES / "masks/palette.png", "--label", "2").out
    assert "256x256, 9,649 px inside (14.7%)" in text
    assert "columns" in text
    assert "holds several labels" in tso("mask", FILES / "masks/palette.png").refusal
    assert json.loads(tso("mask", "mask.png", "--invert-mask", "--json").out)["foreground"] > 32768
    exif = Image.Exif()
    exif[0x0112] = 6
    with Image.open("mask.png") as image:
        image.convert("L").crop((0, 0, 256, 200)).save(tmp_path / "turned.png", exif=exif)
    run = tso("mask", tmp_path / "turned.png")
    assert "turned.png: 200x256" in run.out
    assert (
        "turned    upright, by EXIF orientation 6; stored as 256x200, and tso refine with a camera "
        "file takes it as stored"
    ) in run.out
    assert "turned    upright" not in text
    assert tso("mask", tmp_path / "turned.png", "--json").document["exif_orientation"] == 6
    assert "is the input" in tso("mask", "mask.png", "-o", "mask.png", "--overwrite").refusal


@pytest.mark.parametrize(("value", "what"), [(0, "nothing"), (255, "everything")])
def test_mask_says_that_nothing_or_everything_is_inside(tso, tmp_path, value, what):
    Image.new("L", (20, 20), value).save(tmp_path / "a.png")
    assert f"{what} is inside, which tso refine refuses" in tso("mask", tmp_path / "a.png").err


def test_poses_take_k_from_another_file(tso, tmp_path):
    target = tmp_path / "c.json"
    poses = ("convert", FILES / "cameras/open3d_trajectory.log", target)
    assert "or poses and --intrinsics FILE with K" in tso(*poses, "--size", "256x256").refusal
    assert tso(*poses, "--intrinsics", FILE_OF_K).code == 0
    known = cameras_of(FILES / "cameras/open3d_trajectory.json")
    assert_same_cameras(cameras_of(target), known, error=1e-6)


def test_what_another_format_cannot_hold_names_the_camera_file(tso, tmp_path):
    view = json.loads((FILES / "cameras/own.json").read_text())
    refusal = tso("convert", FILES / "cameras/own.json", tmp_path / "c.json", "--size", "9x5")
    assert "own.json: is for a picture of 256x256, found --size 9x5" in refusal.refusal
    view["K"][0][1] = 3.5
    (tmp_path / "s.json").write_text(json.dumps(view))
    refusal = tso("convert", tmp_path / "s.json", tmp_path / "m", "--to", "colmap").refusal
    assert "s.json: view_0.png: K has a skew of 3.5" in refusal
