"""`tso refine`: what it writes and prints, and one line of error for whatever cannot work."""

import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image
from safetensors.torch import load_file

from tests.scenes import block
from tso_cli import __version__
from tso_cli.evaluation.metrics import chamfer
from tso_cli.io import shipped as shipped_files
from tso_cli.io.checkpoints import read_metadata
from tso_cli.io.clouds import read_cloud, write_cloud
from tso_cli.optimisation.objective import ViewTargets

from .conftest import save_untrained

POINTS = ("initial.ply", "mask.png")
PLAIN = ("--symmetry", "none")
ENCODER = ("--mode", "encoder", "image.png", "mask.png", "--steps", "1")


def refined(name):
    return read_cloud(name).points


def test_four_lines_say_what_was_written_how_well_it_agrees_how_far_it_moved_and_what_was_used(
    folder, refine
):
    run = refine(*POINTS, "--steps", "12")
    lines = run.out.splitlines()
    assert run.code == 0
    assert run.err == ""
    assert len(lines) == 4
    assert lines[0] == "initial.refined.ply: 1,024 points"
    assert re.fullmatch(
        r"  IoU    0\.\d{3} -> 0\.\d{3} with the mask \(fits better, confidence 0\.\d\d\)", lines[1]
    )
    assert re.fullmatch(
        r"  moved  \d\.\d % of the object's size on average, \d+\.\d % at most", lines[2]
    )
    assert re.fullmatch(
        r"  used   camera camera.json; learned prior \(moved \d+\.\d %\); "
        r"assumed mirror-symmetric, as the cloud is; \d+\.\d s",
        lines[3],
    )
    assert 0.0 < np.abs(refined("initial.refined.ply") - refined("initial.ply")).max() < 0.35


def test_json_is_one_document_with_all_promised_entries(folder, refine):
    document = refine(
        *POINTS, "--steps", "12", "-o", "out.ply", "--overlay", "out.png", "--json"
    ).document
    promised = (
        "mode preset output overlay camera views assume steps best_step stop_reason losses "
        "iou_before iou_after loss_before loss_after moved_by_prior moved_mean moved_max "
        "chamfer_to_initial prior "
        "moving points outliers symmetry symmetry_outcome symmetry_reason learning_rate gamma "
        "sigma_sq device checkpoint frame confidence verdict reason warnings suspects moved "
        "convention seconds version"
    )
    assert set(promised.split()) <= set(document)
    assert document["mode"] == "points"
    assert document["frame"] == "input"
    assert document["points"] == 1024
    assert document["iou_after"] > document["iou_before"]
    assert document["loss_after"] < document["loss_before"]
    assert document["stop_reason"] == "max_steps"
    assert document["warnings"] == []
    assert document["symmetry_outcome"] == "used"
    moved = np.linalg.norm(refined("out.ply") - refined("initial.ply"), axis=1)
    assert document["moved_mean"] == pytest.approx(moved.mean(), rel=1e-4)
    assert document["moved_max"] == pytest.approx(moved.max(), rel=1e-4)
    assert document["version"] == __version__
    assert {"read", "optimise", "write", "total"} <= set(document["seconds"])
    with Image.open("out.png") as picture:
        assert picture.size[0] > 600


def test_the_camera_named_after_the_mask_wins_over_the_folders_and_the_canonical_one_stands_in(
    folder, refine
):
    shutil.copy("camera.json", "mask.camera.json")
    Path("camera.json").write_text("not used")
    assert "used   camera mask.camera.json; " in refine(*POINTS, "--steps", "0").out
    assert Path("initial.refined.ply").read_bytes() == Path("initial.ply").read_bytes()
    Path("camera.json").unlink()
    Path("mask.camera.json").unlink()
    canonical = "used   canonical camera (no camera file was given or found next to the mask); "
    assert canonical in refine(*POINTS, "--steps", "0", "--overwrite").out


def test_an_inverted_mask_is_the_same_with_the_flag_and_ignored_pixels_matter(folder, refine):
    Image.fromarray(255 - np.asarray(Image.open("mask.png").convert("L"))).save("dark.png")
    Image.fromarray((255 * block(np.s_[:, 128:], (256, 256))).astype(np.uint8)).save("ignore.png")
    fast = ("--steps", "3", *PLAIN, "-o")
    refine(*POINTS, *fast, "a.ply")
    refine("initial.ply", "dark.png", "--invert-mask", *fast, "b.ply")
    refine(*POINTS, *fast, "c.ply", "--ignore", "ignore.png")
    assert Path("a.ply").read_bytes() == Path("b.ply").read_bytes() != Path("c.ply").read_bytes()


def test_check_says_where_the_points_fall_or_why_they_do_not_meet_the_mask_and_writes_nothing(
    folder, refine
):
    out = refine(*POINTS, "--check").out
    assert all(
        word in out for word in ("perspective", "inside the image", "on the mask", "IoU", "depth")
    )
    assert not list(folder.glob("*refined*"))
    write_cloud("far.ply", refined("initial.ply") + [30.0, 0.0, 0.0])
    run = refine("far.ply", "mask.png", "--check")
    assert run.code == 2
    assert "do not meet" in run.out
    assert "behind the camera" in run.err


def test_a_camera_that_names_another_mask_is_warned_of(folder, refine):
    _change_json(Path("camera.json"), lambda camera: {"views": [camera | {"mask": "else.png"}]})
    run = refine(*POINTS, "--steps", "0")
    assert run.code == 0
    assert "else.png" in run.err


# Several masks


def test_several_masks_of_their_own_sizes_and_cameras_refine_one_cloud_and_bring_it_nearer_than_one(
    views, refine
):
    outputs = ("-o", "out.ply", "--overlay", "out.png")
    files = ("initial.ply", *views, "--camera", "views.json", *outputs)
    document = refine(*files, "--steps", "24", *PLAIN, "--json").document
    assert [view["mask"] for view in document["views"]] == ["front.png", "side.png", "back.png"]
    assert [view["camera"]["width"] for view in document["views"]] == [64, 96, 128]
    assert document["camera"] == document["views"][0]["camera"]
    for key in ("iou_before", "iou_after"):
        assert document[key] == pytest.approx(np.mean([view[key] for view in document["views"]]))
    assert all(view["iou_after"] > view["iou_before"] for view in document["views"])
    weights = [view["inlier_weight"] for view in document["views"]]
    assert weights == pytest.approx([1.0, 1.0, 1.0], abs=0.2)
    with Image.open("out.png") as picture:
        assert picture.size[1] > 3 * 340
    refine(
        "initial.ply", views[0], "--camera", "views.json", "--steps", "24", *PLAIN, "-o", "one.ply"
    )
    three, one = (
        chamfer(refined(name), refined("target.ply")).chamfer for name in ("out.ply", "one.ply")
    )
    assert three < 0.97 * one


def test_named_masks_may_come_in_any_order_or_be_left_out(views, refine):
    common = ("initial.ply", "--camera", "views.json", "--steps", "6", *PLAIN, "--json", "-o")
    named = refine(*common, "named.ply").document["views"]
    reversed_views = refine(*common, "reversed.ply", *views[::-1]).document["views"][::-1]
    for view, same in zip(named, reversed_views, strict=True):
        assert view["mask"] == same["mask"]
        assert view["camera"] == same["camera"]
        assert view["iou_after"] == pytest.approx(same["iou_after"], abs=0.01)


def test_masks_take_their_cameras_from_a_file_of_all_views_beside_them_or_from_one_of_their_own(
    views, refine
):
    def cameras(masks, *more):
        document = refine("initial.ply", *masks, "--steps", "0", "--json", *more).document
        return [(view["camera"]["source"], view["camera"]["width"]) for view in document["views"]]

    Path("views.json").rename("cameras.json")
    Path("camera.json").unlink()
    assert cameras(views[1:]) == [("cameras.json", 96), ("cameras.json", 128)]
    for view, mask in zip(
        json.loads(Path("cameras.json").read_text())["views"], views, strict=True
    ):
        del view["mask"]
        mask.with_suffix(".camera.json").write_text(json.dumps(view))
    own = [("front.camera.json", 64), ("side.camera.json", 96), ("back.camera.json", 128)]
    assert cameras(views, "--overwrite") == own


def test_each_mask_has_an_ignore_map_of_its_own(views, refine):
    common = ("initial.ply", *views, "--camera", "views.json", "--steps", "2", *PLAIN, "-o")
    refine(*common, "none.ply")
    for name, ignored in (("empty.ply", 0), ("half.ply", 60)):
        maps = []
        for mask, rows in zip(views, (0, 0, ignored), strict=True):
            with Image.open(mask) as image:
                Image.fromarray(
                    (255 * block(np.s_[:rows], image.size[::-1])).astype(np.uint8)
                ).save(f"ignore-{mask}")
            maps += ["--ignore", f"ignore-{mask}"]
        refine(*common, name, *maps)
    np.testing.assert_allclose(refined("empty.ply"), refined("none.ply"), atol=1e-6)
    assert np.abs(refined("half.ply") - refined("none.ply")).max() > 1e-5


def test_check_prints_a_block_for_each_view(views, refine):
    files = ("initial.ply", *views, "--camera", "views.json", "--check")
    out = refine(*files).out
    assert re.findall(r"^view +(.*)$", out, re.M) == [
        "1 of 3, front.png",
        "2 of 3, side.png",
        "3 of 3, back.png",
    ]
    assert re.findall(r"perspective, (\d+x\d+), from views.json", out) == [
        "64x64",
        "96x80",
        "128x128",
    ]
    assert out.count("they meet") == 3
    document = refine(*files, "--json").document
    assert document["meets"] is True
    assert [view["placement"]["points"] for view in document["views"]] == [1024] * 3


def test_a_view_that_the_others_contradict_is_discounted_and_named(views, refine):
    Image.fromarray((255 * block(np.s_[30:75, 5:90], (80, 96))).astype(np.uint8)).save("side.png")
    run = refine("initial.ply", *views, "--camera", "views.json", "-v", *PLAIN, "--steps", "48")
    assert "; little of side.png (contradicted by the others); " in run.out
    assert re.findall(r"warning: (\S+): the other views contradict it", run.err) == ["side.png"]
    weights = [float(weight) for weight in re.findall(r"inlier weight ([\d.]+), ", run.out)]
    assert weights[1] < 0.2 < 0.8 < min(weights[0], weights[2])


# Networks


@pytest.mark.parametrize("mode", ["encoder", "encoder-decoder", "latent"])
def test_the_network_modes_refine_the_networks_cloud(mode, folder, checkpoint, refine):
    files = ("image.png", "mask.png", "--checkpoint", checkpoint)
    document = refine("--mode", mode, *files, "--steps", "2", "--json").document
    assert document["frame"] == "view"
    assert document["points"] == 128
    assert document["loss_after"] <= document["loss_before"]
    assert refined("image.refined.ply").shape == (128, 3)


@pytest.fixture
def shipped(tmp_path, checkpoint, monkeypatch):
    """An installation whose shipped network is the small one."""
    weights = tmp_path / "installed" / "weights"
    weights.mkdir(parents=True)
    shutil.copy(checkpoint, weights / "default.safetensors")
    monkeypatch.setattr(shipped_files, "WEIGHTS", weights)
    return weights / "default.safetensors"


def test_without_a_checkpoint_the_shipped_one_refines_and_is_named(
    folder, checkpoint, shipped, refine
):
    assert refine(*ENCODER, "-o", "a.ply", "--json").document["checkpoint"] == str(shipped)
    used = f"used   network {checkpoint}; camera camera.json (only its K); "
    assert used in refine(*ENCODER, "-o", "b.ply", "--checkpoint", checkpoint).out
    named = refine(*ENCODER, "-o", "c.ply", "--checkpoint", "default")
    assert "used   shipped network; " in named.out
    assert Path("a.ply").read_bytes() == Path("b.ply").read_bytes() == Path("c.ply").read_bytes()


def test_a_file_called_default_is_meant_by_a_path_to_it(folder, checkpoint, shipped, refine):
    shutil.copy(checkpoint, "default")
    for name, path in ((folder / "default", folder / "default"), ("default", shipped)):
        assert f"checkpoint: {path}\n" in refine(*ENCODER, "--check", "--checkpoint", name).err


def test_an_installation_without_its_network_is_reported(folder, shipped, refine):
    shipped.unlink()
    for arguments in (ENCODER, (*ENCODER, "--checkpoint", "default")):
        message = refine(*arguments).refusal
        assert str(shipped) in message
        assert "--checkpoint" in message
    assert not Path("image.refined.ply").exists()
    assert refine(*POINTS, "--steps", "1").code == 0


@pytest.mark.skipif(not shipped_files.WEIGHTS.exists(), reason="the network is not trained yet")
def test_the_shipped_network_is_small_view_aligned_and_refines_the_examples(folder, refine):
    path = shipped_files.default_checkpoint()
    assert path.stat().st_size <= 16_000_000
    assert {tensor.dtype for tensor in load_file(path).values()} == {torch.float16}
    config, _ = read_metadata(path)
    assert config.frame == "view"
    assert config.points == 1024
    document = refine(
        "--mode", "latent", "image.png", "mask.png", "--steps", "30", "--json"
    ).document
    assert document["points"] == 1024
    assert document["iou_after"] > document["iou_before"] > 0.3


def test_a_view_aligned_cloud_can_be_had_in_world_coordinates(folder, checkpoint, refine):
    world = refine(
        *ENCODER, "--checkpoint", checkpoint, "-o", "world.ply", "--frame", "world", "--json"
    ).document
    assert world["frame"] == "world"
    # In the world of the camera file, the cloud falls on the mask as it is.
    check = refine("world.ply", "mask.png", "--check", "--json").document
    assert check["placement"]["box_iou"] > 0.5


def test_a_view_aligned_cloud_can_be_placed_where_the_camera_file_has_the_object(
    folder, checkpoint, refine
):
    common = ("image.png", "mask.png", "--mode", "latent", "--steps", "1", "--json")
    distances = {}
    for placing in ("silhouette", "box", "camera"):
        options = ("--checkpoint", checkpoint, "-o", f"{placing}.ply", "--place", placing)
        distances[placing] = refine(*common, *options).document["camera"]["t"][2]
    assert distances["camera"] == json.loads(Path("camera.json").read_text())["t"][2]
    assert len(set(distances.values())) == 3


def test_a_network_without_a_camera_file_sees_the_crop_through_the_canonical_camera(
    folder, checkpoint, refine
):
    Path("camera.json").unlink()
    arguments = (*ENCODER, "--checkpoint", checkpoint)
    assert refine(*arguments, "--json").document["camera"]["K"][0][0] == 120.0
    for name, value in (("frame", "world"), ("place", "camera")):
        refusal = refine(*arguments, f"--{name}", value, "-o", "w.ply").refusal
        assert f"--{name} {value} needs the camera's " in refusal
        assert refusal.endswith("found no camera file, expected one (--camera FILE)")


def test_a_canonical_frame_network_needs_a_camera_file(folder, refine):
    network = save_untrained(Path("canonical.safetensors"), "canonical")
    arguments = (*ENCODER, "--checkpoint", network, "--overwrite")
    assert refine(*arguments, "--json").document["frame"] == "canonical"
    for name, value in (("place", "box"), ("frame", "world")):
        refusal = refine(*arguments, f"--{name}", value).refusal
        assert f"found --{name} {value}, which is for view-aligned networks" in refusal
    Path("camera.json").unlink()
    refusal = refine(*arguments).refusal
    assert "R and t" in refusal
    assert "(--camera FILE)" in refusal


def test_an_interrupt_writes_the_best_so_far(folder, refine, monkeypatch):
    calls, true_call = iter(range(100)), ViewTargets.loss

    def interrupted(self, points):
        if next(calls) == 12:  # three for the learned prior
            raise KeyboardInterrupt
        return true_call(self, points)

    monkeypatch.setattr(ViewTargets, "loss", interrupted)
    run = refine(*POINTS, *PLAIN, "--steps", 20)
    assert run.code == 130
    assert "interrupted at step 8 of 20: the result is the best so far" in run.err
    assert Path("initial.refined.ply").exists()


# Damage to a file of the folder, arguments, and words of the error. tests/io has more damage.
BAD = {
    "missing cloud": ("", "nowhere.ply mask.png", "nowhere.ply exist"),
    "missing mask": ("", "initial.ply nowhere.png", "nowhere.png"),
    "mask all background": ("mask:bad.png:256:0", "initial.ply bad.png", "bad.png foreground"),
    "mask all object": ("mask:bad.png:256:255", "initial.ply bad.png", "bad.png --invert-mask"),
    "camera of another size": ("set:camera.json:width:64", "POINTS", "camera.json 64x256 256x256"),
    "checkpoint for points mode": (
        "",
        "POINTS --checkpoint base.safetensors",
        "points base.safetensors",
    ),
    "checkpoint as the cloud": (
        "text:base.safetensors:x",
        "base.safetensors mask.png",
        "base.safetensors checkpoint",
    ),
    "image of another size": ("resize:image.png", "NETWORK", "image.png 128x128 256x256"),
    "frame in points mode": ("", "POINTS --frame world", "--frame"),
    "place in points mode": ("", "POINTS --place camera", "--place camera"),
    "missing output folder": ("", "POINTS -o nowhere/out.ply", "nowhere exist"),
    "existing output": ("text:out.ply:precious", "POINTS -o out.ply", "out.ply exists --overwrite"),
    "output of another format": ("", "POINTS -o out.obj", "out.obj .ply"),
    "negative steps": ("", "POINTS --steps -3", "steps -3"),
    "gamma no number": ("", "POINTS --gamma nan", "gamma"),
    "gamma of the paper": ("", "POINTS --gamma 1", "--gamma is for preset paper, found best"),
    "sigma of the paper": ("", "POINTS --sigma-sq 1", "--sigma-sq is for preset paper, found best"),
    "sigma huge": ("", "POINTS --preset paper --sigma-sq 1e5", "sigma_sq 256"),
    "overlay over the mask": ("", "POINTS --overlay mask.png --overwrite", "mask.png input"),
    "no mask given": ("", "initial.ply", "MASK"),
    "unknown device": ("", "POINTS --device warp", "warp"),
    "ignore map of another size": (
        "mask:ignore.png:128:255",
        "POINTS --ignore ignore.png",
        "ignore.png 128x128 256x256",
    ),
    "more masks than views": (
        "",
        "POINTS image.png --camera camera.json",
        "camera.json 1 view 2 masks",
    ),
    "masks without cameras": (
        "unlink:camera.json",
        "POINTS image.png",
        "camera file 2 masks --camera",
    ),
    "no mask and no camera": ("", "initial.ply --overlay out.png", "MASK --camera"),
    "views that name no mask": (
        "",
        "initial.ply --camera camera.json",
        r"camera.json views\[0\] names no mask",
    ),
    "ignore maps for some": (
        "",
        "POINTS --ignore mask.png --ignore mask.png",
        "2 ignore maps 1 mask --ignore",
    ),
    "two masks for a network": (
        "",
        "image.png mask.png mask.png ENCODER CHECKPOINT",
        "encoder MASK 2 once",
    ),
    "no mask for a network": ("", "image.png ENCODER CHECKPOINT", "encoder MASK 0 once"),
    "two ignore maps": ("", "NETWORK --ignore a.png --ignore b.png", "encoder --ignore 2 once"),
    "a GPU without a network": (
        "",
        "POINTS --device cuda",
        r"'cuda',\sexpected\scpu\sor\sauto points no",
    ),
    "cloud elsewhere": ("move:initial.ply", "POINTS", "mask.png --check"),
    "depth map of another size": (
        "wide:bad.png",
        "POINTS --depth bad.png",
        "bad.png 16x8 mask.png 256x256",
    ),
    "two depth maps": (
        "",
        "POINTS --depth mask.png --depth mask.png",
        "2 depth maps 1 masks --depth",
    ),
    "depth map in colours": ("", "POINTS --depth image.png", "image.png mode RGB one grey channel"),
    "missing depth map": ("", "POINTS --depth none.png", "none.png does not exist"),
    "scale without a depth map": (
        "",
        "POINTS --depth-scale 0.001",
        "--depth-scale 0.001 --depth FILE",
    ),
    "kind without a depth map": ("", "POINTS --depth-kind ray", "--depth-kind ray --depth FILE"),
    "depth, preset paper": (
        "",
        "POINTS --depth mask.png --preset paper",
        "--depth points best paper",
    ),
    "depth for a network": (
        "",
        "image.png mask.png --depth mask.png --mode latent",
        "--depth points best latent",
    ),
    "photo, preset paper": (
        "",
        "POINTS --image image.png --preset paper",
        "--image points best paper",
    ),
    "photo for a network": (
        "",
        "image.png mask.png --image image.png --mode latent",
        "--image points best latent",
    ),
    "quiet and verbose": ("", "POINTS -q -v", "--quiet --verbose one of the two"),
    "a line break and a control character in a name": (
        "",
        "no\n\x1b[31mwhere.ply mask.png",
        r"no \\x1b\[31mwhere.ply",
    ),
}


def _change_json(path: Path, change) -> None:
    path.write_text(json.dumps(change(json.loads(path.read_text()))))


# What a line of BAD does to a file.
DAMAGE = {
    "unlink": lambda path: path.unlink(),
    "text": lambda path, text: path.write_text(text),
    "mask": lambda path, side, value: Image.fromarray(
        np.full((int(side), int(side)), int(value), np.uint8)
    ).save(path),
    "wide": lambda path: Image.new("L", (16, 8), 9).save(path),
    "set": lambda path, key, value: _change_json(
        path, lambda document: document | {key: json.loads(value)}
    ),
    "resize": lambda path: Image.open(path).resize((128, 128)).save(path),
    "move": lambda path: write_cloud(path, refined(path) + [30.0, 0.0, 0.0], overwrite=True),
}


@pytest.mark.parametrize("case", BAD)
def test_what_cannot_work_gets_one_line_and_exit_code_two_and_writes_nothing(
    case, folder, checkpoint, refine
):
    action, arguments, words = BAD[case]
    if action:
        verb, name, *values = action.split(":")
        DAMAGE[verb](Path(name), *values)
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    arguments = arguments.replace("POINTS", "initial.ply mask.png")
    arguments = arguments.replace("NETWORK", "image.png mask.png ENCODER CHECKPOINT")
    arguments = arguments.replace("ENCODER", "--mode encoder --checkpoint")
    arguments = arguments.replace("CHECKPOINT", str(checkpoint))
    message = refine(*arguments.split(" ")).refusal
    for word in words.split():
        assert re.search(word.replace(".", r"\."), message), f"{word!r} not in {message!r}"
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before


def test_the_page_of_a_refinement_names_the_file_of_its_options(tso, folder):
    Path("options.json").write_text('{"steps": 6}')
    shown = tso("refine", "initial.ply", "mask.png", "--config", "options.json",
                "--report", "page.html")  # fmt: skip
    assert shown.code == 0
    assert "--config options.json" in Path("page.html").read_text()
