"""`tso refine` as a user meets it: what it writes and prints, and one clear line for whatever cannot work."""

from __future__ import annotations

import json
import re
import shutil
import struct
import subprocess
import sys
import zlib
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tso_cli import __version__
from tso_cli.cli import main
from tso_cli.io.clouds import read_cloud, write_cloud

CHAIR = Path(__file__).parents[2] / "examples" / "chair"


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A copy of the chair example to stand in."""
    for name in ("initial.ply", "mask.png", "image.png", "camera.json", "target.ply"):
        shutil.copy(CHAIR / name, tmp_path / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def views(folder):
    """views.json and three masks that it names, of the chair seen from three sides, in three sizes."""
    from dataclasses import replace

    from tso_cli.io.cameras import CameraRecord, read_camera, write_cameras
    from tso_cli.silhouette.projection import silhouette_of

    camera, target = read_camera("camera.json", 256, 256), read_cloud("target.ply").points
    records = []
    for name, degrees, size in (("front.png", 0.0, (64, 64)), ("side.png", 80.0, (96, 80)), ("back.png", 200.0, (128, 128))):
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        turned = replace(camera, R=camera.R @ [[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]).resized(*size)
        Image.fromarray((silhouette_of(target, turned) * 255.0).astype(np.uint8)).save(name)
        records.append(CameraRecord(turned, Path(name)))
    write_cameras("views.json", records)
    return [record.mask for record in records]


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory):
    """A small view-aligned network; untrained, which is enough to run the modes."""
    from tso_cli.io.checkpoints import save_network
    from tso_cli.network.model import NetworkConfig, build_network

    path = tmp_path_factory.mktemp("checkpoint") / "small.safetensors"
    save_network(path, build_network(points=128, seed=0), NetworkConfig(points=128, version=__version__))
    return path


def tso(*arguments) -> int:
    """Run the command line in this process; returns the exit code."""
    with pytest.raises(SystemExit) as stopped:
        main([str(argument) for argument in arguments])
    return stopped.value.code


def _json(capsys):
    return json.loads(capsys.readouterr().out)


def test_the_command_of_the_readme_works_as_written(folder, capsys):
    assert tso("refine", "--mode", "points", "initial.ply", "mask.png") == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    lines = captured.out.splitlines()
    assert lines[0] == "initial.refined.ply: 1,024 points"
    assert re.fullmatch(r"  IoU    0\.\d{3} -> 0\.\d{3} with the mask", lines[1])
    assert re.fullmatch(r"  moved  \d\.\d % of the object's size on average, \d+\.\d % at most", lines[2])
    assert re.fullmatch(r"  used   camera camera.json; assumed mirror-symmetric, as the cloud is; \d+\.\d s", lines[3])
    assert len(lines) == 4
    refined, initial = read_cloud("initial.refined.ply").points, read_cloud("initial.ply").points
    assert refined.shape == initial.shape
    assert 0.0 < np.abs(refined - initial).max() < 0.2


def test_json_is_one_document_with_everything_promised(folder, capsys):
    assert tso("refine", "initial.ply", "mask.png", "--json", "-o", "out.ply", "--overlay", "out.png") == 0
    document = _json(capsys)
    promised = (
        "mode output camera steps stop_reason warnings iou_before iou_after loss_before loss_after moved_mean moved_max "
        "chamfer_to_initial symmetry_outcome seconds frame points sigma_sq device seed version"
    )
    assert set(promised.split()) <= set(document)
    assert document["mode"] == "points"
    assert document["frame"] == "input"
    assert document["points"] == 1024
    assert document["iou_after"] > document["iou_before"]
    assert document["loss_after"] < document["loss_before"]
    assert (document["stop_reason"], document["warnings"], document["symmetry_outcome"]) == ("max_steps", [], "used")
    moved = np.linalg.norm(read_cloud("out.ply").points - read_cloud("initial.ply").points, axis=1)
    assert (document["moved_mean"], document["moved_max"]) == pytest.approx((moved.mean(), moved.max()), rel=1e-4)
    assert document["version"] == __version__
    assert {"read", "optimise", "write", "total"} <= set(document["seconds"])
    with Image.open("out.png") as picture:
        assert picture.size[0] > 600


def test_the_camera_named_after_the_mask_wins_over_the_folders(folder, capsys):
    shutil.copy("camera.json", "mask.camera.json")
    Path("camera.json").write_text("not used")
    assert tso("refine", "initial.ply", "mask.png", "--steps", "0") == 0
    assert "used   camera mask.camera.json; " in capsys.readouterr().out


def test_without_a_camera_file_the_canonical_camera_is_used_and_said(folder, capsys):
    Path("camera.json").unlink()
    assert tso("refine", "initial.ply", "mask.png", "--steps", "0") == 0
    assert "used   canonical camera (no camera file was given or found beside the mask); " in capsys.readouterr().out


def test_zero_steps_write_the_start(folder):
    assert tso("refine", "initial.ply", "mask.png", "--steps", "0", "-o", "same.ply") == 0
    assert Path("same.ply").read_bytes() == Path("initial.ply").read_bytes()


def test_everything_but_the_coordinates_survives(folder, capsys):
    points = read_cloud("initial.ply").points
    lines = [
        "ply", "format ascii 1.0", "comment from a scanner", f"element vertex {len(points)}", "property uchar red",
        "property double x", "property double y", "property double z", "property float nx", "property int label",
        "element face 1", "property list uchar int vertex_indices", "end_header",
    ]  # fmt: skip
    lines += [f"{i % 256} {x!r} {y!r} {z!r} 0.5 {i}" for i, (x, y, z) in enumerate(points.tolist())]
    Path("scan.ply").write_text("\n".join([*lines, "3 0 1 2"]) + "\n")
    assert tso("refine", "scan.ply", "mask.png") == 0
    assert "normals" in capsys.readouterr().err
    before, after = (Path(name).read_text().splitlines() for name in ("scan.ply", "scan.refined.ply"))
    assert len(before) == len(after)
    moved = 0
    for old, new in zip(before, after, strict=True):
        if len(old.split()) == 6 and old[0].isdigit():
            a, b = old.split(), new.split()
            assert (a[0], a[4:]) == (b[0], b[4:])
            moved += a[1:4] != b[1:4]
        else:
            assert old == new
    assert moved > 500


def test_an_inverted_mask_says_the_same_with_the_flag(folder, capsys):
    Image.fromarray(255 - np.asarray(Image.open("mask.png").convert("L"))).save("dark.png")
    assert tso("refine", "initial.ply", "mask.png", "-o", "a.ply") == 0
    assert tso("refine", "initial.ply", "dark.png", "--invert-mask", "-o", "b.ply") == 0
    assert Path("a.ply").read_bytes() == Path("b.ply").read_bytes()


def test_ignored_pixels_change_the_result(folder, capsys):
    ignore = np.zeros((256, 256), np.uint8)
    ignore[:, 128:] = 255
    Image.fromarray(ignore).save("ignore.png")
    assert tso("refine", "initial.ply", "mask.png", "-o", "a.ply") == 0
    assert tso("refine", "initial.ply", "mask.png", "--ignore", "ignore.png", "-o", "b.ply") == 0
    assert Path("a.ply").read_bytes() != Path("b.ply").read_bytes()


def test_check_says_where_the_points_fall_and_writes_nothing(folder, capsys):
    assert tso("refine", "initial.ply", "mask.png", "--check") == 0
    out = capsys.readouterr().out
    for word in ("perspective", "inside the image", "on the mask", "IoU", "depth"):
        assert word in out
    assert tso("refine", "initial.ply", "mask.png", "--check", "--json") == 0
    assert _json(capsys)["meets"] is True
    assert not list(folder.glob("*refined*"))


def test_check_explains_a_cloud_that_does_not_meet_the_mask(folder, capsys):
    write_cloud("far.ply", read_cloud("initial.ply").points + [30.0, 0.0, 0.0])
    assert tso("refine", "far.ply", "mask.png", "--check") == 2
    captured = capsys.readouterr()
    assert "do not meet" in captured.out
    assert "behind the camera" in captured.err


def test_a_view_that_tso_render_wrote_finds_its_camera(folder, capsys):
    from tso_cli.geometry.camera import Camera
    from tso_cli.io.cameras import CameraRecord, read_camera, write_cameras

    camera = read_camera("camera.json", 256, 256)
    other = Camera.canonical(256, 256)
    write_cameras("cameras.json", [CameraRecord(other, Path("else.png")), CameraRecord(camera, Path("mask.png"))])
    Path("camera.json").unlink()
    assert tso("refine", "initial.ply", "mask.png", "--json") == 0
    assert _json(capsys)["camera"]["t"] == camera.t.tolist()


def test_a_camera_that_names_another_mask_is_warned_of(folder, capsys):
    document = json.loads(Path("camera.json").read_text())
    Path("camera.json").write_text(json.dumps({"views": [document | {"mask": "else.png"}]}))
    assert tso("refine", "initial.ply", "mask.png", "--steps", "0") == 0
    assert "else.png" in capsys.readouterr().err


def test_a_float_too_coarse_for_its_coordinates_is_warned_of(folder, capsys):
    from tso_cli.geometry.camera import Camera
    from tso_cli.io.cameras import CameraRecord, read_camera, write_cameras

    camera = read_camera("camera.json", 256, 256)
    shift = np.array([4e6, 0.0, 0.0])
    far = Camera(camera.K, camera.R, camera.t - camera.R @ shift, 256, 256)
    write_cameras("camera.json", [CameraRecord(far)], overwrite=True)
    points = read_cloud("initial.ply").points + shift
    write_cloud("coarse.ply", points, dtype="float32")
    write_cloud("fine.ply", points, dtype="float64")
    assert tso("refine", "coarse.ply", "mask.png") == 0
    assert "stored as float" in capsys.readouterr().err
    assert tso("refine", "fine.ply", "mask.png") == 0
    assert "stored as float" not in capsys.readouterr().err


def test_the_picture_is_not_left_without_its_cloud(folder, capsys, monkeypatch):
    def full(self, data):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    before = set(folder.iterdir())
    assert tso("refine", "initial.ply", "mask.png", "--overlay", "picture.png") == 2
    assert set(folder.iterdir()) == before


def test_several_masks_of_their_own_sizes_and_cameras_refine_one_cloud(views, capsys):
    assert (
        tso("refine", "initial.ply", *views, "--camera", "views.json", "--json", "-o", "out.ply", "--overlay", "out.png") == 0
    )
    document = _json(capsys)
    assert [view["mask"] for view in document["views"]] == ["front.png", "side.png", "back.png"]
    assert [view["camera"]["width"] for view in document["views"]] == [64, 96, 128]
    assert document["camera"] == document["views"][0]["camera"]
    for key in ("iou_before", "iou_after"):
        assert document[key] == pytest.approx(np.mean([view[key] for view in document["views"]]))
    assert all(view["iou_after"] > view["iou_before"] for view in document["views"])
    assert [view["weight"] for view in document["views"]] == pytest.approx([1.0, 1.0, 1.0], abs=0.2)
    with Image.open("out.png") as picture:
        assert picture.size[1] > 3 * 340


def test_three_masks_bring_the_cloud_nearer_to_the_truth_than_one(views):
    from tso_cli.evaluation.metrics import chamfer

    target = read_cloud("target.ply").points
    errors = []
    for count in (1, 3):
        assert tso("refine", "initial.ply", *views[:count], "--camera", "views.json", "-o", f"{count}.ply") == 0
        errors.append(chamfer(read_cloud(f"{count}.ply").points, target).chamfer)
    assert errors[1] < 0.97 * errors[0]


def test_named_masks_may_come_in_any_order_or_be_left_out(views, capsys):
    assert tso("refine", "initial.ply", "--camera", "views.json", "-o", "named.ply", "--json") == 0
    named = _json(capsys)["views"]
    assert tso("refine", "initial.ply", *views[::-1], "--camera", "views.json", "-o", "turned.ply", "--json") == 0
    turned = _json(capsys)["views"][::-1]
    for one, other in zip(named, turned, strict=True):
        assert (one["mask"], one["camera"]) == (other["mask"], other["camera"])
        assert one["iou_after"] == pytest.approx(other["iou_after"], abs=0.01)


def test_each_mask_may_bring_a_camera_file_of_its_own(views, capsys):
    document = json.loads(Path("views.json").read_text())
    for view, mask in zip(document["views"], views, strict=True):
        del view["mask"]
        mask.with_suffix(".camera.json").write_text(json.dumps(view))
    assert tso("refine", "initial.ply", *views, "--steps", "0", "--json") == 0
    assert [view["camera"]["width"] for view in _json(capsys)["views"]] == [64, 96, 128]


def test_masks_beside_a_file_of_all_views_need_no_camera_option(views, capsys):
    Path("views.json").rename("cameras.json")
    Path("camera.json").unlink()
    assert tso("refine", "initial.ply", *views[1:], "--steps", "0", "--json") == 0
    captured = capsys.readouterr()
    assert [view["camera"]["source"] for view in json.loads(captured.out)["views"]] == ["cameras.json"] * 2
    assert [view["camera"]["width"] for view in json.loads(captured.out)["views"]] == [96, 128]


def test_each_mask_has_an_ignore_map_of_its_own(views, capsys):
    maps = []
    for mask in views:
        with Image.open(mask) as image:
            Image.new("L", image.size).save(f"ignore-{mask}")
        maps += ["--ignore", f"ignore-{mask}"]
    common = ("refine", "initial.ply", *views, "--camera", "views.json", "--steps", "2")
    assert tso(*common, "-o", "none.ply") == 0
    assert tso(*common, *maps, "-o", "empty.ply") == 0
    np.testing.assert_allclose(read_cloud("empty.ply").points, read_cloud("none.ply").points, atol=1e-6)
    with Image.open(views[2]) as image:
        half = np.zeros(image.size[::-1], np.uint8)
    half[:60] = 255
    Image.fromarray(half).save(f"ignore-{views[2]}")
    assert tso(*common, *maps, "-o", "half.ply") == 0
    assert np.abs(read_cloud("half.ply").points - read_cloud("none.ply").points).max() > 1e-5


def test_check_prints_a_block_for_each_view(views, capsys):
    assert tso("refine", "initial.ply", *views, "--camera", "views.json", "--check") == 0
    out = capsys.readouterr().out
    assert re.findall(r"^view +(.*)$", out, re.M) == ["1 of 3, front.png", "2 of 3, side.png", "3 of 3, back.png"]
    assert re.findall(r"perspective, (\d+x\d+), from views.json", out) == ["64x64", "96x80", "128x128"]
    assert out.count("they meet") == 3
    assert tso("refine", "initial.ply", *views, "--camera", "views.json", "--check", "--json") == 0
    document = _json(capsys)
    assert document["meets"] is True
    assert [view["placement"]["points"] for view in document["views"]] == [1024] * 3


def test_a_view_that_the_others_contradict_is_discounted_and_named(views, capsys):
    other = np.zeros((80, 96), np.uint8)
    other[30:75, 5:90] = 255
    Image.fromarray(other).save("side.png")
    assert tso("refine", "initial.ply", *views, "--camera", "views.json", "-v") == 0
    captured = capsys.readouterr()
    assert "; little of side.png (contradicted by the others); " in captured.out
    assert re.findall(r"warning: (\S+): the other views contradict it", captured.err) == ["side.png"]
    weights = [float(weight) for weight in re.findall(r"loss weight ([\d.]+), ", captured.out)]
    assert weights[1] < 0.2 < 0.8 < min(weights[0], weights[2])
    trust = [float(trust) for trust in re.findall(r"inlier weight ([\d.]+), loss weight", captured.out)]
    assert trust[1] < 0.2
    assert min(trust[0], trust[2]) > 0.95


def test_pictures_of_one_side_share_a_weight_and_are_not_doubted(views, capsys):
    document = json.loads(Path("views.json").read_text())
    document["views"] = [document["views"][0]] * 3
    Path("same.json").write_text(json.dumps(document))
    assert tso("refine", "initial.ply", *views[:1] * 3, "--camera", "same.json", "--json") == 0
    captured = capsys.readouterr()
    assert "contradict" not in captured.err
    found = json.loads(captured.out)["views"]
    assert [view["trust"] for view in found] == [1.0] * 3
    assert [view["weight"] for view in found] == pytest.approx([1 / 3] * 3)


@pytest.mark.parametrize("mode", ["encoder", "encoder-decoder", "latent"])
def test_the_network_modes_refine_the_networks_cloud(mode, folder, checkpoint, capsys):
    assert tso("refine", "--mode", mode, "image.png", "mask.png", "--checkpoint", checkpoint, "--json", "--steps", "5") == 0
    document = _json(capsys)
    assert document["frame"] == "view"
    assert document["points"] == 128
    assert document["loss_after"] <= document["loss_before"]
    assert read_cloud("image.refined.ply").points.shape == (128, 3)


@pytest.fixture
def shipped(tmp_path, checkpoint, monkeypatch):
    """An installation whose shipped network is the small one."""
    from tso_cli.io import shipped

    weights = tmp_path / "installed" / "weights"
    weights.mkdir(parents=True)
    shutil.copy(checkpoint, weights / "default.safetensors")
    monkeypatch.setattr(shipped, "WEIGHTS", weights)
    return weights / "default.safetensors"


@pytest.mark.parametrize("mode", ["encoder", "encoder-decoder", "latent"])
def test_without_a_checkpoint_the_shipped_one_refines_and_is_named(mode, folder, checkpoint, shipped, capsys):
    common = ("refine", "--mode", mode, "image.png", "mask.png", "--steps", "2")
    assert tso(*common, "-o", "a.ply", "--json") == 0
    assert _json(capsys)["checkpoint"] == str(shipped)
    assert tso(*common, "-o", "b.ply", "--checkpoint", checkpoint) == 0
    assert f"used   network {checkpoint}; camera camera.json (only its K); " in capsys.readouterr().out
    assert tso(*common, "-o", "c.ply", "--checkpoint", "default") == 0
    assert "used   shipped network; " in capsys.readouterr().out
    assert Path("a.ply").read_bytes() == Path("b.ply").read_bytes() == Path("c.ply").read_bytes()


def test_a_file_called_default_is_meant_by_a_path_to_it(folder, checkpoint, shipped, capsys):
    shutil.copy(checkpoint, "default")
    common = ("refine", "--mode", "encoder", "image.png", "mask.png", "--check")
    assert tso(*common, "--checkpoint", folder / "default") == 0
    assert f"checkpoint: {folder / 'default'}\n" in capsys.readouterr().err
    assert tso(*common, "--checkpoint", "default") == 0
    assert f"checkpoint: {shipped}\n" in capsys.readouterr().err


def test_an_installation_without_its_network_is_said_so(folder, shipped, capsys):
    shipped.unlink()
    for arguments in (
        ("refine", "--mode", "encoder", "image.png", "mask.png"),
        ("refine", "--mode", "encoder", "image.png", "mask.png", "--checkpoint", "default"),
        ("lab", "examples", "--checkpoint", "default"),
    ):
        assert tso(*arguments) == 2
        captured = capsys.readouterr()
        assert captured.err.count("\n") == 1
        assert str(shipped) in captured.err
        assert "--checkpoint" in captured.err
        assert captured.out == ""
    assert not Path("image.refined.ply").exists()
    assert tso("refine", "initial.ply", "mask.png", "--steps", "1") == 0


SHIPPED = Path(__file__).parents[2] / "tso_cli" / "weights" / "default.safetensors"


@pytest.mark.skipif(not SHIPPED.exists(), reason="the network is not trained yet")
def test_the_shipped_network_is_small_view_aligned_and_refines_the_examples(folder, capsys):
    import torch
    from safetensors.torch import load_file

    from tso_cli.io.checkpoints import read_metadata
    from tso_cli.io.shipped import default_checkpoint

    assert default_checkpoint() == SHIPPED
    assert SHIPPED.stat().st_size <= 16_000_000
    assert {tensor.dtype for tensor in load_file(SHIPPED).values()} == {torch.float16}
    config, _ = read_metadata(SHIPPED)
    assert (config.frame, config.points) == ("view", 1024)
    for mode in ("encoder-decoder", "latent"):
        assert tso("refine", "--mode", mode, "image.png", "mask.png", "--steps", "10", "--json", "--overwrite") == 0
        document = _json(capsys)
        assert document["points"] == 1024
        assert document["iou_after"] > document["iou_before"] > 0.3


def test_a_view_aligned_cloud_can_be_had_in_world_coordinates(folder, checkpoint, capsys):
    common = ("refine", "--mode", "encoder", "image.png", "mask.png", "--checkpoint", checkpoint, "--steps", "1")
    assert tso(*common, "-o", "world.ply", "--frame", "world", "--json") == 0
    assert _json(capsys)["frame"] == "world"
    # in the world of the camera file, the cloud falls on the mask without further ado
    assert tso("refine", "world.ply", "mask.png", "--check", "--json") == 0
    assert _json(capsys)["placement"]["box_iou"] > 0.5


def test_a_view_aligned_cloud_can_be_placed_where_the_camera_file_has_the_object(folder, checkpoint, capsys):
    common = ("refine", "--mode", "latent", "image.png", "mask.png", "--checkpoint", checkpoint, "--steps", "1")
    distances = {}
    for placing in ("silhouette", "box", "camera"):
        assert tso(*common, "-o", f"{placing}.ply", "--place", placing, "--json") == 0
        distances[placing] = _json(capsys)["camera"]["t"][2]
    assert distances["camera"] == json.loads(Path("camera.json").read_text())["t"][2]
    assert len(set(distances.values())) == 3


def test_a_network_without_a_camera_file_sees_the_crop_through_the_canonical_camera(folder, checkpoint, capsys):
    Path("camera.json").unlink()
    arguments = ("refine", "--mode", "encoder", "image.png", "mask.png", "--checkpoint", checkpoint, "--steps", "1", "--json")
    assert tso(*arguments) == 0
    assert _json(capsys)["camera"]["K"][0][0] == 120.0
    assert tso(*arguments, "--frame", "world", "-o", "w.ply") == 2
    assert "--frame world needs" in capsys.readouterr().err
    assert tso(*arguments, "--place", "camera", "-o", "w.ply") == 2
    assert "--place camera needs" in capsys.readouterr().err


def test_a_canonical_frame_network_needs_a_camera_file(folder, tmp_path, capsys):
    from tso_cli.io.checkpoints import save_network
    from tso_cli.network.model import NetworkConfig, build_network

    config = NetworkConfig(points=128, frame="canonical", version=__version__)
    save_network(Path("canonical.safetensors"), build_network(points=128), config)
    arguments = (
        "refine",
        "--mode",
        "encoder",
        "image.png",
        "mask.png",
        "--checkpoint",
        "canonical.safetensors",
        "--steps",
        "1",
    )
    assert tso(*arguments, "--json") == 0
    assert _json(capsys)["frame"] == "canonical"
    for option in (("--place", "box"), ("--frame", "world")):
        assert tso(*arguments, *option, "--overwrite") == 2
        assert f"{' '.join(option)}, which is for view-aligned networks" in capsys.readouterr().err
    Path("camera.json").unlink()
    assert tso(*arguments, "--overwrite") == 2
    assert "R and t" in capsys.readouterr().err


def test_a_photo_turned_by_its_exif_note_says_the_same_as_one_stored_upright(folder, checkpoint, capsys):
    with Image.open("image.png") as image:
        exif = Image.Exif()
        exif[0x0112] = 6  # stored a quarter turn to the left
        image.convert("RGB").transpose(Image.Transpose.ROTATE_90).save("turned.png", exif=exif)
    common = ("--mode", "encoder", "--checkpoint", checkpoint, "--steps", "1")
    assert tso("refine", "image.png", "mask.png", *common, "-o", "a.ply") == 0
    assert tso("refine", "turned.png", "mask.png", *common, "-o", "b.ply") == 0
    assert Path("a.ply").read_bytes() == Path("b.ply").read_bytes()


def test_an_interrupt_writes_the_best_so_far(folder, capsys, monkeypatch):
    from tso_cli.refinement.objective import MaskChamferObjective

    calls = iter(range(100))
    true_call = MaskChamferObjective.__call__

    def interrupted(self, moved, reach):
        if next(calls) == 8:  # one for the anchor, one for the start
            raise KeyboardInterrupt
        return true_call(self, moved, reach)

    monkeypatch.setattr(MaskChamferObjective, "__call__", interrupted)
    assert tso("refine", "initial.ply", "mask.png", "--symmetry", "none") == 130
    assert "interrupted at step 6 of 48" in capsys.readouterr().err
    assert Path("initial.refined.ply").exists()
    # while the mirror plane is put to the test nothing has moved yet
    calls = iter(range(100))
    assert tso("refine", "initial.ply", "mask.png", "-o", "start.ply") == 130
    captured = capsys.readouterr()
    assert "warning: nothing moved: interrupted at step 0, " in captured.err
    assert "moved  nothing: interrupted at step 0, " in captured.out
    np.testing.assert_array_equal(read_cloud("start.ply").points, read_cloud("initial.ply").points)


# What is done to the folder, the arguments, and words that the one line of error must hold.
BAD = {
    "missing cloud": ("", "nowhere.ply mask.png", "nowhere.ply exist"),
    "missing mask": ("", "initial.ply nowhere.png", "nowhere.png"),
    "folder for a cloud": ("mkdir:dir.ply", "dir.ply mask.png", "dir.ply folder"),
    "folder for a mask": ("mkdir:dir.png", "initial.ply dir.png", "dir.png folder"),
    "empty cloud": ("text:bad.ply:", "bad.ply mask.png", "bad.ply empty"),
    "empty mask": ("text:bad.png:", "initial.ply bad.png", "bad.png empty"),
    "truncated cloud": ("cut:initial.ply:2000", "initial.ply mask.png", "initial.ply 1024|1,024"),
    "cloud that lies": ("swap:initial.ply:vertex 1024:vertex 9024", "initial.ply mask.png", "initial.ply 9024|9,024"),
    "zero points": ("ply:bad.ply:", "bad.ply mask.png", "bad.ply 0 points"),
    "one point": ("ply:bad.ply:0 0 0", "bad.ply mask.png", "bad.ply 1 point"),
    "NaN": ("ply:bad.ply:0 0 0;1 nan 0", "bad.ply mask.png", "bad.ply finite|nan"),
    "infinity": ("ply:bad.ply:0 0 0;1 inf 0", "bad.ply mask.png", "bad.ply finite|inf"),
    "all points equal": ("ply:bad.ply:1 1 1;1 1 1;1 1 1", "bad.ply mask.png", "bad.ply same"),
    "not a point cloud": ("text:bad.ply:hello world", "bad.ply mask.png", "bad.ply ply|PLY"),
    "picture for a cloud": ("", "image.png mask.png", "image.png .ply"),
    "mask all background": ("mask:bad.png:0", "initial.ply bad.png", "bad.png foreground"),
    "mask all foreground": ("mask:bad.png:255", "initial.ply bad.png", "bad.png every|background"),
    "a billion pixels": ("bomb:bad.png", "initial.ply bad.png", "bad.png 40000x30000|pixels"),
    "camera without a key": ("drop:camera.json:K", "initial.ply mask.png", "camera.json K missing"),
    "camera of a wrong shape": ("set:camera.json:K:[1,2,3]", "initial.ply mask.png", "camera.json K"),
    "singular K": ("set:camera.json:K:[[0,0,1],[0,0,1],[0,0,1]]", "initial.ply mask.png", "camera.json singular"),
    "R no rotation": ("set:camera.json:R:[[2,0,0],[0,1,0],[0,0,1]]", "initial.ply mask.png", "camera.json rotation"),
    "camera of another size": ("set:camera.json:width:64", "initial.ply mask.png", "camera.json 64x256 256x256"),
    "camera not JSON": ("text:camera.json:{", "initial.ply mask.png", "camera.json JSON"),
    "missing camera": ("", "initial.ply mask.png --camera nowhere.json", "nowhere.json"),
    "unknown mode": ("", "initial.ply mask.png --mode magic", "magic points encoder"),
    "checkpoint for points mode": ("", "initial.ply mask.png --checkpoint base.safetensors", "points base.safetensors"),
    "checkpoint as the cloud": ("text:base.safetensors:x", "base.safetensors mask.png", "base.safetensors checkpoint"),
    "shipped checkpoint for points mode": ("", "initial.ply mask.png --checkpoint default", "points default"),
    "pickled checkpoint": ("pickle:base.pt", "image.png mask.png ENCODER base.pt", "base.pt pickle"),
    "truncated checkpoint": ("tensor:base.safetensors", "image.png mask.png ENCODER base.safetensors", "base.safetensors"),
    "image of another size": ("resize:image.png", "image.png mask.png ENCODER CHECKPOINT", "image.png 128x128 256x256"),
    "frame in points mode": ("", "initial.ply mask.png --frame world", "--frame"),
    "place in points mode": ("", "initial.ply mask.png --place camera", "--place camera"),
    "missing output folder": ("", "initial.ply mask.png -o nowhere/out.ply", "nowhere exist"),
    "existing output": ("text:out.ply:precious", "initial.ply mask.png -o out.ply", "out.ply exists --overwrite"),
    "existing overlay": ("text:out.png:precious", "initial.ply mask.png --overlay out.png", "out.png exists --overwrite"),
    "output of another format": ("", "initial.ply mask.png -o out.obj", "out.obj .ply"),
    "negative steps": ("", "initial.ply mask.png --steps -3", "steps -3"),
    "gamma no number": ("", "initial.ply mask.png --gamma nan", "gamma"),
    "sigma tiny": ("", "initial.ply mask.png --sigma-sq 1e-30", "sigma_sq 1e-30"),
    "sigma huge": ("", "initial.ply mask.png --sigma-sq 1e5", "sigma_sq 256"),
    "gamma huge": ("", "initial.ply mask.png --gamma 1e308", "gamma"),
    "negative seed": ("", "initial.ply mask.png --seed -1", "seed -1"),
    "seed of eighty bits": ("", "initial.ply mask.png --seed 1208925819614629174706176", "seed"),
    "device without numbers": ("", "initial.ply mask.png --device meta", "meta"),
    "overlay over the mask": ("", "initial.ply mask.png --overlay mask.png --overwrite", "mask.png input"),
    "sigma zero": ("", "initial.ply mask.png --sigma-sq 0", "sigma_sq 0"),
    "unknown option": ("", "initial.ply mask.png --magic", "--magic"),
    "no mask given": ("", "initial.ply", "MASK"),
    "unknown device": ("", "initial.ply mask.png --device warp", "warp"),
    "ignore map of another size": ("resize:image.png", "initial.ply mask.png --ignore image.png", "image.png 128x128 256x256"),
    "more masks than views": ("", "initial.ply mask.png image.png --camera camera.json", "camera.json 1 view 2 masks"),
    "masks without cameras": ("unlink:camera.json", "initial.ply mask.png image.png", "camera file 2 masks"),
    "no mask and no camera": ("", "initial.ply --overlay out.png", "MASK --camera"),
    "views that name no mask": ("", "initial.ply --camera camera.json", r"camera.json views\[0\] names no mask"),
    "ignore maps for some": ("", "initial.ply mask.png --ignore mask.png --ignore mask.png", "--ignore 2 ignore maps 1 mask"),
    "two masks for a network": ("", "image.png mask.png mask.png ENCODER CHECKPOINT", "encoder MASK 2 once"),
    "no mask for a network": ("", "image.png ENCODER CHECKPOINT", "encoder MASK 0 once"),
    "two ignore maps for a network": (
        "", "image.png mask.png ENCODER CHECKPOINT --ignore mask.png --ignore mask.png", "encoder --ignore 2 once"
    ),
    "cloud elsewhere": ("move:initial.ply", "initial.ply mask.png", "mask.png --check"),
}  # fmt: skip


def _ply(rows: list[str]) -> str:
    head = [
        "ply",
        "format ascii 1.0",
        f"element vertex {len(rows)}",
        "property float x",
        "property float y",
        "property float z",
    ]
    return "\n".join([*head, "end_header", *rows]) + "\n"


def _damage(action: str) -> None:
    """Do to the current folder what a line of BAD says."""
    if not action:
        return
    verb, name, *rest = action.split(":")
    path = Path(name)
    if verb == "mkdir":
        path.mkdir()
    elif verb == "text":
        path.write_text(rest[0])
    elif verb == "cut":
        path.write_bytes(path.read_bytes()[: int(rest[0])])
    elif verb == "swap":
        path.write_bytes(path.read_bytes().replace(rest[0].encode(), rest[1].encode()))
    elif verb == "ply":
        path.write_text(_ply([row for row in rest[0].split(";") if row]))
    elif verb == "mask":
        Image.fromarray(np.full((256, 256), int(rest[0]), np.uint8)).save(path)
    elif verb == "bomb":

        def chunk(kind: bytes, data: bytes) -> bytes:
            return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))

        header = struct.pack(">IIBBBBB", 40000, 30000, 1, 0, 0, 0, 0)
        path.write_bytes(
            b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(b"\0" * 5001)) + chunk(b"IEND", b"")
        )
        assert path.stat().st_size < 1024
    elif verb == "unlink":
        path.unlink()
    elif verb == "drop":
        document = json.loads(path.read_text())
        del document[rest[0]]
        path.write_text(json.dumps(document))
    elif verb == "set":
        path.write_text(json.dumps(json.loads(path.read_text()) | {rest[0]: json.loads(rest[1])}))
    elif verb == "pickle":
        import torch

        torch.save({"weight": torch.zeros(3)}, path)
    elif verb == "tensor":
        path.write_bytes(struct.pack("<Q", 4000) + b'{"weight"')
    elif verb == "resize":
        with Image.open(path) as image:
            image.resize((128, 128)).save(path)
    elif verb == "move":
        points = read_cloud(path).points
        write_cloud(path, points + [30.0, 0.0, 0.0], overwrite=True)
    else:
        raise AssertionError(verb)


@pytest.mark.parametrize("case", BAD)
def test_what_cannot_work_gets_one_line_and_exit_code_two_and_writes_nothing(case, folder, checkpoint, capsys):
    action, arguments, words = BAD[case]
    _damage(action)
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    arguments = arguments.replace("ENCODER", "--mode encoder --checkpoint").replace("CHECKPOINT", str(checkpoint))
    code = tso("refine", *arguments.split())
    captured = capsys.readouterr()
    assert code == 2
    assert captured.out == ""
    errors = [line for line in captured.err.splitlines() if line.startswith("tso: error: ")]
    assert len(errors) == 1
    assert all(line.startswith("tso: ") for line in captured.err.splitlines())
    for word in words.split():
        assert re.search(word.replace(".", r"\."), errors[0]), f"{word!r} not in {errors[0]!r}"
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before


def test_a_file_name_with_a_line_break_still_gets_one_line(folder, capsys):
    assert tso("refine", "no\n\x1b[31mwhere.ply", "mask.png") == 2
    message = capsys.readouterr().err
    assert message.count("\n") == 1
    assert "\x1b" not in message


def test_cuda_that_is_asked_for_and_absent_is_refused(folder, capsys):
    import torch

    if torch.cuda.is_available():
        pytest.skip("this machine has CUDA")
    assert tso("refine", "initial.ply", "mask.png", "--device", "cuda") == 2
    assert "--device cuda: not available" in capsys.readouterr().err
    assert not Path("initial.refined.ply").exists()


def test_a_full_disk_leaves_no_partial_file(folder, capsys, monkeypatch):
    def full(self, data):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    before = set(folder.iterdir())
    assert tso("refine", "initial.ply", "mask.png") == 2
    assert "initial.refined.ply: cannot be written (No space left on device" in capsys.readouterr().err
    assert set(folder.iterdir()) == before


def test_the_program_starts_without_torch_and_fails_without_a_traceback(folder):
    for arguments, expected in (
        (["--version"], 0),
        (["--help"], 0),
        (["refine", "--help"], 0),
        (["refine", "no.ply", "no.png"], 2),
    ):
        code = (
            "import sys; from tso_cli.cli import main\n"
            f"try:\n    main({arguments!r})\nfinally:\n    assert 'torch' not in sys.modules, 'torch was imported'"
        )
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=folder)
        assert done.returncode == expected, done.stderr
        assert "Traceback" not in done.stderr


def test_importing_the_package_imports_no_torch():
    code = "import sys, tso_cli; assert 'torch' not in sys.modules; from tso_cli import refine; assert callable(refine)"
    subprocess.run([sys.executable, "-c", code], check=True)
