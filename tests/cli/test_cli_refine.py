"""`tso refine`: what it writes and prints, and one line of error for whatever cannot work."""

import json
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tso_cli import __version__
from tso_cli.evaluation.metrics import chamfer
from tso_cli.io.cameras import CameraRecord, read_camera, write_cameras
from tso_cli.io.clouds import read_cloud, write_cloud

from .conftest import save_untrained
from .run import tso

POINTS = ("refine", "initial.ply", "mask.png")
ENCODER = ("refine", "--mode", "encoder", "image.png", "mask.png", "--steps", "1")


def refined(name):
    return read_cloud(name).points


def document_of(capsys, *arguments):
    """The JSON document that a command prints."""
    assert tso(*arguments, "--json") == 0
    return json.loads(capsys.readouterr().out)


def test_four_lines_say_what_was_written_how_well_it_agrees_how_far_it_moved_and_what_was_used(folder, capsys):
    assert tso(*POINTS, "--steps", "12") == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    lines = captured.out.splitlines()
    assert lines[0] == "initial.refined.ply: 1,024 points"
    assert re.fullmatch(r"  IoU    0\.\d{3} -> 0\.\d{3} with the mask", lines[1])
    assert re.fullmatch(r"  moved  \d\.\d % of the object's size on average, \d+\.\d % at most", lines[2])
    assert re.fullmatch(r"  used   camera camera.json; assumed mirror-symmetric, as the cloud is; \d+\.\d s", lines[3])
    assert len(lines) == 4
    moved = refined("initial.refined.ply") - refined("initial.ply")
    assert 0.0 < np.abs(moved).max() < 0.2


def test_json_is_one_document_with_all_promised_entries(folder, capsys):
    document = document_of(capsys, *POINTS, "--steps", "12", "-o", "out.ply", "--overlay", "out.png")
    promised = (
        "mode output camera steps stop_reason warnings iou_before iou_after loss_before loss_after moved_mean moved_max "
        "chamfer_to_initial symmetry_outcome seconds frame points sigma_sq device seed version"
    )
    assert set(promised.split()) <= set(document)
    assert (document["mode"], document["frame"], document["points"]) == ("points", "input", 1024)
    assert document["iou_after"] > document["iou_before"]
    assert document["loss_after"] < document["loss_before"]
    assert (document["stop_reason"], document["warnings"], document["symmetry_outcome"]) == ("max_steps", [], "used")
    moved = np.linalg.norm(refined("out.ply") - refined("initial.ply"), axis=1)
    assert (document["moved_mean"], document["moved_max"]) == pytest.approx((moved.mean(), moved.max()), rel=1e-4)
    assert document["version"] == __version__
    assert {"read", "optimise", "write", "total"} <= set(document["seconds"])
    with Image.open("out.png") as picture:
        assert picture.size[0] > 600


def test_the_camera_named_after_the_mask_wins_over_the_folders_and_the_canonical_one_stands_in(folder, capsys):
    shutil.copy("camera.json", "mask.camera.json")
    Path("camera.json").write_text("not used")
    assert tso(*POINTS, "--steps", "0") == 0
    assert "used   camera mask.camera.json; " in capsys.readouterr().out
    Path("camera.json").unlink()
    Path("mask.camera.json").unlink()
    assert tso(*POINTS, "--steps", "0", "--overwrite") == 0
    assert "used   canonical camera (no camera file was given or found beside the mask); " in capsys.readouterr().out


def test_zero_steps_write_the_start(folder):
    assert tso(*POINTS, "--steps", "0", "-o", "same.ply") == 0
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
    assert tso("refine", "scan.ply", "mask.png", "--steps", "6", "--symmetry", "none") == 0
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


def test_an_inverted_mask_is_the_same_with_the_flag_and_ignored_pixels_matter(folder, capsys):
    Image.fromarray(255 - np.asarray(Image.open("mask.png").convert("L"))).save("dark.png")
    ignore = np.zeros((256, 256), np.uint8)
    ignore[:, 128:] = 255
    Image.fromarray(ignore).save("ignore.png")
    fast = ("--steps", "3", "--symmetry", "none")
    assert tso(*POINTS, *fast, "-o", "a.ply") == 0
    assert tso("refine", "initial.ply", "dark.png", "--invert-mask", *fast, "-o", "b.ply") == 0
    assert tso(*POINTS, *fast, "--ignore", "ignore.png", "-o", "c.ply") == 0
    assert Path("a.ply").read_bytes() == Path("b.ply").read_bytes() != Path("c.ply").read_bytes()


def test_check_says_where_the_points_fall_and_writes_nothing(folder, capsys):
    assert tso(*POINTS, "--check") == 0
    out = capsys.readouterr().out
    for word in ("perspective", "inside the image", "on the mask", "IoU", "depth"):
        assert word in out
    assert document_of(capsys, *POINTS, "--check")["meets"] is True
    assert not list(folder.glob("*refined*"))


def test_check_explains_a_cloud_that_does_not_meet_the_mask(folder, capsys):
    write_cloud("far.ply", read_cloud("initial.ply").points + [30.0, 0.0, 0.0])
    assert tso("refine", "far.ply", "mask.png", "--check") == 2
    captured = capsys.readouterr()
    assert "do not meet" in captured.out
    assert "behind the camera" in captured.err


def test_a_camera_that_names_another_mask_is_warned_of(folder, capsys):
    document = json.loads(Path("camera.json").read_text())
    Path("camera.json").write_text(json.dumps({"views": [document | {"mask": "else.png"}]}))
    assert tso(*POINTS, "--steps", "0") == 0
    assert "else.png" in capsys.readouterr().err


def test_a_float_too_coarse_for_its_coordinates_is_warned_of(folder, capsys):
    camera, shift = read_camera("camera.json", 256, 256), np.array([4e6, 0.0, 0.0])
    write_cameras("camera.json", [CameraRecord(replace(camera, t=camera.t - camera.R @ shift))], overwrite=True)
    for dtype, coarse in (("float32", True), ("float64", False)):
        write_cloud(f"{dtype}.ply", refined("initial.ply") + shift, dtype=dtype)
        assert tso("refine", f"{dtype}.ply", "mask.png", "--steps", "3", "--symmetry", "none") == 0
        assert ("stored as float" in capsys.readouterr().err) == coarse


@pytest.mark.parametrize("overlay", [(), ("--overlay", "picture.png")])
def test_a_full_disk_leaves_no_partial_file_and_no_picture_without_its_cloud(overlay, folder, capsys, monkeypatch):
    def full(self, data):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    before = set(folder.iterdir())
    assert tso(*POINTS, "--steps", "0", *overlay) == 2
    assert "initial.refined.ply: cannot be written (No space left on device" in capsys.readouterr().err
    assert set(folder.iterdir()) == before


def test_several_masks_of_their_own_sizes_and_cameras_refine_one_cloud(views, capsys):
    arguments = ("refine", "initial.ply", *views, "--camera", "views.json", "-o", "out.ply", "--overlay", "out.png")
    document = document_of(capsys, *arguments, "--steps", "24", "--symmetry", "none")
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
    fast = ("--camera", "views.json", "--steps", "24", "--symmetry", "none")
    distances = []
    for count in (1, 3):
        assert tso("refine", "initial.ply", *views[:count], *fast, "-o", f"{count}.ply") == 0
        distances.append(chamfer(refined(f"{count}.ply"), refined("target.ply")).chamfer)
    assert distances[1] < 0.97 * distances[0]


def test_named_masks_may_come_in_any_order_or_be_left_out(views, capsys):
    common = ("refine", "initial.ply", "--camera", "views.json", "--steps", "6", "--symmetry", "none")
    named = document_of(capsys, *common, "-o", "named.ply")["views"]
    reversed_views = document_of(capsys, *common, *views[::-1], "-o", "reversed.ply")["views"][::-1]
    for view, same in zip(named, reversed_views, strict=True):
        assert (view["mask"], view["camera"]) == (same["mask"], same["camera"])
        assert view["iou_after"] == pytest.approx(same["iou_after"], abs=0.01)


def test_each_mask_may_bring_a_camera_file_of_its_own(views, capsys):
    document = json.loads(Path("views.json").read_text())
    for view, mask in zip(document["views"], views, strict=True):
        del view["mask"]
        mask.with_suffix(".camera.json").write_text(json.dumps(view))
    document = document_of(capsys, "refine", "initial.ply", *views, "--steps", "0")
    assert [view["camera"]["width"] for view in document["views"]] == [64, 96, 128]


def test_masks_beside_a_file_of_all_views_need_no_camera_option(views, capsys):
    Path("views.json").rename("cameras.json")
    Path("camera.json").unlink()
    document = document_of(capsys, "refine", "initial.ply", *views[1:], "--steps", "0")
    assert [view["camera"]["source"] for view in document["views"]] == ["cameras.json"] * 2
    assert [view["camera"]["width"] for view in document["views"]] == [96, 128]


def test_each_mask_has_an_ignore_map_of_its_own(views, capsys):
    maps = []
    for mask in views:
        with Image.open(mask) as image:
            Image.new("L", image.size).save(f"ignore-{mask}")
        maps += ["--ignore", f"ignore-{mask}"]
    common = ("refine", "initial.ply", *views, "--camera", "views.json", "--steps", "2", "--symmetry", "none")
    assert tso(*common, "-o", "none.ply") == 0
    assert tso(*common, *maps, "-o", "empty.ply") == 0
    np.testing.assert_allclose(refined("empty.ply"), refined("none.ply"), atol=1e-6)
    with Image.open(views[2]) as image:
        half = np.zeros(image.size[::-1], np.uint8)
    half[:60] = 255
    Image.fromarray(half).save(f"ignore-{views[2]}")
    assert tso(*common, *maps, "-o", "half.ply") == 0
    assert np.abs(refined("half.ply") - refined("none.ply")).max() > 1e-5


def test_check_prints_a_block_for_each_view(views, capsys):
    assert tso("refine", "initial.ply", *views, "--camera", "views.json", "--check") == 0
    out = capsys.readouterr().out
    assert re.findall(r"^view +(.*)$", out, re.M) == ["1 of 3, front.png", "2 of 3, side.png", "3 of 3, back.png"]
    assert re.findall(r"perspective, (\d+x\d+), from views.json", out) == ["64x64", "96x80", "128x128"]
    assert out.count("they meet") == 3
    document = document_of(capsys, "refine", "initial.ply", *views, "--camera", "views.json", "--check")
    assert document["meets"] is True
    assert [view["placement"]["points"] for view in document["views"]] == [1024] * 3


def test_a_view_that_the_others_contradict_is_discounted_and_named(views, capsys):
    other = np.zeros((80, 96), np.uint8)
    other[30:75, 5:90] = 255
    Image.fromarray(other).save("side.png")
    assert tso("refine", "initial.ply", *views, "--camera", "views.json", "-v", "--symmetry", "none", "--steps", "48") == 0
    captured = capsys.readouterr()
    assert "; little of side.png (contradicted by the others); " in captured.out
    assert re.findall(r"warning: (\S+): the other views contradict it", captured.err) == ["side.png"]
    weights = [float(weight) for weight in re.findall(r"loss weight ([\d.]+), ", captured.out)]
    assert weights[1] < 0.2 < 0.8 < min(weights[0], weights[2])


@pytest.mark.parametrize("mode", ["encoder", "encoder-decoder", "latent"])
def test_the_network_modes_refine_the_networks_cloud(mode, folder, checkpoint, capsys):
    arguments = ("refine", "--mode", mode, "image.png", "mask.png", "--checkpoint", checkpoint, "--steps", "2")
    document = document_of(capsys, *arguments)
    assert (document["frame"], document["points"]) == ("view", 128)
    assert document["loss_after"] <= document["loss_before"]
    assert refined("image.refined.ply").shape == (128, 3)


@pytest.fixture
def shipped(tmp_path, checkpoint, monkeypatch):
    """An installation whose shipped network is the small one."""
    from tso_cli.io import shipped

    weights = tmp_path / "installed" / "weights"
    weights.mkdir(parents=True)
    shutil.copy(checkpoint, weights / "default.safetensors")
    monkeypatch.setattr(shipped, "WEIGHTS", weights)
    return weights / "default.safetensors"


def test_without_a_checkpoint_the_shipped_one_refines_and_is_named(folder, checkpoint, shipped, capsys):
    assert document_of(capsys, *ENCODER, "-o", "a.ply")["checkpoint"] == str(shipped)
    assert tso(*ENCODER, "-o", "b.ply", "--checkpoint", checkpoint) == 0
    assert f"used   network {checkpoint}; camera camera.json (only its K); " in capsys.readouterr().out
    assert tso(*ENCODER, "-o", "c.ply", "--checkpoint", "default") == 0
    assert "used   shipped network; " in capsys.readouterr().out
    assert Path("a.ply").read_bytes() == Path("b.ply").read_bytes() == Path("c.ply").read_bytes()


def test_a_file_called_default_is_meant_by_a_path_to_it(folder, checkpoint, shipped, capsys):
    shutil.copy(checkpoint, "default")
    for name, path in ((folder / "default", folder / "default"), ("default", shipped)):
        assert tso(*ENCODER, "--check", "--checkpoint", name) == 0
        assert f"checkpoint: {path}\n" in capsys.readouterr().err


def test_an_installation_without_its_network_is_said_so(folder, shipped, capsys):
    shipped.unlink()
    for arguments in (ENCODER, (*ENCODER, "--checkpoint", "default"), ("lab", "examples", "--checkpoint", "default")):
        assert tso(*arguments) == 2
        captured = capsys.readouterr()
        assert captured.err.count("\n") == 1
        assert str(shipped) in captured.err
        assert "--checkpoint" in captured.err
        assert captured.out == ""
    assert not Path("image.refined.ply").exists()
    assert tso(*POINTS, "--steps", "1") == 0


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
    document = document_of(capsys, "refine", "--mode", "latent", "image.png", "mask.png", "--steps", "10")
    assert document["points"] == 1024
    assert document["iou_after"] > document["iou_before"] > 0.3


def test_a_view_aligned_cloud_can_be_had_in_world_coordinates(folder, checkpoint, capsys):
    arguments = (*ENCODER, "--checkpoint", checkpoint, "-o", "world.ply", "--frame", "world")
    assert document_of(capsys, *arguments)["frame"] == "world"
    # In the world of the camera file, the cloud falls on the mask as it is.
    assert document_of(capsys, "refine", "world.ply", "mask.png", "--check")["placement"]["box_iou"] > 0.5


def test_a_view_aligned_cloud_can_be_placed_where_the_camera_file_has_the_object(folder, checkpoint, capsys):
    common = ("refine", "--mode", "latent", "image.png", "mask.png", "--checkpoint", checkpoint, "--steps", "1")
    distances = {
        placing: document_of(capsys, *common, "-o", f"{placing}.ply", "--place", placing)["camera"]["t"][2]
        for placing in ("silhouette", "box", "camera")
    }
    assert distances["camera"] == json.loads(Path("camera.json").read_text())["t"][2]
    assert len(set(distances.values())) == 3


def test_a_network_without_a_camera_file_sees_the_crop_through_the_canonical_camera(folder, checkpoint, capsys):
    Path("camera.json").unlink()
    arguments = (*ENCODER, "--checkpoint", checkpoint)
    assert document_of(capsys, *arguments)["camera"]["K"][0][0] == 120.0
    for option in (("--frame", "world"), ("--place", "camera")):
        assert tso(*arguments, *option, "-o", "w.ply") == 2
        assert f"{' '.join(option)} needs" in capsys.readouterr().err


def test_a_canonical_frame_network_needs_a_camera_file(folder, capsys):
    arguments = (*ENCODER, "--checkpoint", save_untrained(Path("canonical.safetensors"), "canonical"), "--overwrite")
    assert document_of(capsys, *arguments)["frame"] == "canonical"
    for option in (("--place", "box"), ("--frame", "world")):
        assert tso(*arguments, *option) == 2
        assert f"{' '.join(option)}, which is for view-aligned networks" in capsys.readouterr().err
    Path("camera.json").unlink()
    assert tso(*arguments) == 2
    assert "R and t" in capsys.readouterr().err


def test_an_interrupt_writes_the_best_so_far(folder, capsys, monkeypatch):
    from tso_cli.refinement.objective import MaskChamferObjective

    calls = iter(range(100))
    true_call = MaskChamferObjective.__call__

    def interrupted(self, points):
        if next(calls) == 8:  # one for the prior weight, one for the start
            raise KeyboardInterrupt
        return true_call(self, points)

    monkeypatch.setattr(MaskChamferObjective, "__call__", interrupted)
    assert tso(*POINTS, "--symmetry", "none") == 130
    assert "interrupted at step 6 of 48" in capsys.readouterr().err
    assert Path("initial.refined.ply").exists()
    # while the mirror plane is put to the test nothing has moved yet
    calls = iter(range(100))
    assert tso(*POINTS, "-o", "start.ply") == 130
    captured = capsys.readouterr()
    assert "warning: nothing moved: interrupted at step 0, " in captured.err
    assert "moved  nothing: interrupted at step 0, " in captured.out
    np.testing.assert_array_equal(refined("start.ply"), refined("initial.ply"))


# Damage to a file of the folder, arguments, and words of the error; tests/io has those of the readers.
BAD = {
    "missing cloud": ("", "nowhere.ply mask.png", "nowhere.ply exist"),
    "missing mask": ("", "initial.ply nowhere.png", "nowhere.png"),
    "mask all background": ("mask:bad.png:0", "initial.ply bad.png", "bad.png foreground"),
    "camera of another size": ("set:camera.json:width:64", "initial.ply mask.png", "camera.json 64x256 256x256"),
    "checkpoint for points mode": ("", "initial.ply mask.png --checkpoint base.safetensors", "points base.safetensors"),
    "checkpoint as the cloud": ("text:base.safetensors:x", "base.safetensors mask.png", "base.safetensors checkpoint"),
    "image of another size": ("resize:image.png", "image.png mask.png ENCODER CHECKPOINT", "image.png 128x128 256x256"),
    "frame in points mode": ("", "initial.ply mask.png --frame world", "--frame"),
    "place in points mode": ("", "initial.ply mask.png --place camera", "--place camera"),
    "missing output folder": ("", "initial.ply mask.png -o nowhere/out.ply", "nowhere exist"),
    "existing output": ("text:out.ply:precious", "initial.ply mask.png -o out.ply", "out.ply exists --overwrite"),
    "output of another format": ("", "initial.ply mask.png -o out.obj", "out.obj .ply"),
    "negative steps": ("", "initial.ply mask.png --steps -3", "steps -3"),
    "gamma no number": ("", "initial.ply mask.png --gamma nan", "gamma"),
    "sigma huge": ("", "initial.ply mask.png --sigma-sq 1e5", "sigma_sq 256"),
    "overlay over the mask": ("", "initial.ply mask.png --overlay mask.png --overwrite", "mask.png input"),
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


def _change_json(path, change):
    path.write_text(json.dumps(change(json.loads(path.read_text()))))


# What a line of BAD does to a file.
DAMAGE = {
    "unlink": lambda path: path.unlink(),
    "text": lambda path, text: path.write_text(text),
    "mask": lambda path, value: Image.fromarray(np.full((256, 256), int(value), np.uint8)).save(path),
    "set": lambda path, key, value: _change_json(path, lambda document: document | {key: json.loads(value)}),
    "resize": lambda path: Image.open(path).resize((128, 128)).save(path),
    "move": lambda path: write_cloud(path, refined(path) + [30.0, 0.0, 0.0], overwrite=True),
}


@pytest.mark.parametrize("case", BAD)
def test_what_cannot_work_gets_one_line_and_exit_code_two_and_writes_nothing(case, folder, checkpoint, capsys):
    action, arguments, words = BAD[case]
    if action:
        verb, name, *values = action.split(":")
        DAMAGE[verb](Path(name), *values)
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
    assert tso(*POINTS, "--device", "cuda") == 2
    assert "--device cuda: not available" in capsys.readouterr().err
    assert not Path("initial.refined.ply").exists()


def test_a_missing_file_is_told_without_torch_and_without_a_traceback(folder):
    code = (
        "import sys; from tso_cli.cli import main\n"
        "try: main(['refine', 'no.ply', 'no.png'])\nfinally: assert 'torch' not in sys.modules"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=folder)
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
