"""The command `tso train`: what it trains on, what it says, what it refuses."""

import json
import signal
from dataclasses import replace

import pytest
import torch
from safetensors.torch import load_file

from tests.dataset_trees import CHAIR, write_clouds, write_r2n2
from tso_cli.commands import options
from tso_cli.io.checkpoints import load_network
from tso_cli.train.data import TrainingData

from ..training import make_objects
from .conftest import write

MASKS = ("--supervision", "masks", "--views", 2)


def test_trains_on_a_folder_and_reports_it(tso_train, folder, tmp_path):
    document = tso_train(
        folder, *MASKS, "--steps", 4, "--log-file", tmp_path / "log.jsonl", "--json"
    ).document
    assert document["steps"] == 4
    assert document["stop_reason"] == "max_steps"
    assert document["supervision"] == "masks"
    assert document["chamfer_training"]["chamfer"] > 0
    assert load_network(tmp_path / "base.safetensors")[1].settings["lambda"] == 1.0
    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert lines[0]["settings"]["views"] == 2
    assert len(lines) == 5
    assert list(lines[4]) == ["step", "loss", "bce", "affinity", "lambda"]
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["base.safetensors", "base.training.safetensors", "boxes", "log.jsonl"]


def test_joint_training_takes_each_data_set_by_its_own_split(tso_train, folder, tmp_path):
    for number in (0, 1):
        (tmp_path / f"{number}.json").write_text(
            json.dumps({"train": [f"box{number}"], "validation": [], "test": []})
        )
    splits = (
        "--split",
        tmp_path / "0.json",
        "--mask-data",
        folder,
        "--mask-split",
        tmp_path / "1.json",
    )
    joint = ("--supervision", "joint", *splits)
    document = tso_train(folder, *joint, "--json").document
    assert document["training_set"] == "boxes: 1 objects"
    assert document["supervision"] == "joint"
    assert load_network(tmp_path / "base.safetensors")[1].settings["views"] == 1


def test_objects_without_a_3d_file_train_masks_only_and_are_not_evaluated(tso_train, tmp_path):
    write_r2n2(tmp_path / "ShapeNetRendering", ("abc", "def"))
    write_clouds(tmp_path, "abc")
    document = tso_train(tmp_path, *MASKS, "--json").document
    assert document["objects"] == 2
    assert document["chamfer_training"]["shapes"] == 1
    assert document["left_out"] == {}
    assert document["not_judged"][f"{CHAIR}/def"].endswith(
        "does not exist, expected the shape of this object"
    )
    points = tso_train(tmp_path, "--overwrite", "--json")
    document = points.document
    assert document["objects"] == 1
    assert document["not_judged"] == {}
    assert list(document["left_out"]) == [f"{CHAIR}/def"]
    for said in (points.err, tso_train(tmp_path, "--overwrite", "--strict").refusal):
        assert "pcl_1024_fps_trimesh.npy: does not exist" in said


def test_a_damaged_3d_file_does_not_stop_training_by_masks(tso_train, tmp_path):
    write_r2n2(tmp_path / "ShapeNetRendering", ("abc", "def", "ghi"))
    write_clouds(tmp_path, "abc", "def", "ghi")
    damaged = tmp_path / "ShapeNet_pcl" / CHAIR / "def" / "pcl_1024_fps_trimesh.npy"
    damaged.write_bytes(b"no array")
    done = tso_train(tmp_path, *MASKS, "--strict", "--json")
    # No other object is evaluated in its place.
    assert done.document["chamfer_training"]["shapes"] == 2
    assert done.document["left_out"] == {}
    assert str(damaged) in done.document["not_judged"][f"{CHAIR}/def"]
    assert "left out" not in done.err


def test_data_without_any_points_are_trained_on_by_masks_alone(tso_train, tmp_path, monkeypatch):
    bare = TrainingData(
        [replace(item, target=None) for item in make_objects(2)], "boxes without points"
    )
    monkeypatch.setattr("tso_cli.commands.train.data.load", lambda wanted, quiet: bare)
    assert "box0: has no points to learn from" in tso_train(tmp_path).refusal
    assert not (tmp_path / "base.safetensors").exists()
    assert "2 steps" in tso_train(tmp_path, *MASKS).out


def test_a_split_may_name_absent_objects_of_categories_that_are_not_trained_on(tso_train, tmp_path):
    for item in (*make_objects(2, category="box"), *make_objects(1, category="crate")):
        write(tmp_path / "data" / item.category, item)
    (tmp_path / "data/box/box1/target.ply").unlink()
    split = tmp_path / "split.json"
    split.write_text(json.dumps({"train": ["box/box0", "crate/absent"], "test": ["box/box1"]}))
    common = tmp_path / "data", "--split", split, "--batch-size", 1
    document = tso_train(*common, "--category", "box", "--json").document
    assert document["training_set"] == "data: 1 objects"
    assert list(document["left_out"]) == ["box/box1"]
    for category, message in (
        ("crate", "split.json: names crate/absent, expected"),
        ("tin", "has no category 'tin'"),
    ):
        assert message in tso_train(*common, "--category", category, "--overwrite").refusal
    split.write_text(json.dumps({"test": ["box/box0"]}))
    assert (
        "split.json: has no list 'train' (lists: 'test'), expected one"
        in tso_train(*common, "--overwrite").err
    )


def test_distances_are_reported_with_their_scale(tso_train, folder, tmp_path):
    root = tmp_path / "r2n2"
    write_r2n2(root / "ShapeNetRendering")
    write_clouds(root, "abc")
    cases = (
        (folder, 0, "unit diagonal"),
        (root, 0.9, "longest side 1"),
        (root, 0, "units of the data set"),
    )
    for data, share, scale in cases:
        done = tso_train(data, "--crop-share", share, "--overwrite")
        assert f"mean over points, {scale}; N 32" in done.out
        assert load_network(tmp_path / "base.safetensors")[1].crop_share == share


def test_a_resumed_run_keeps_its_saturation_window(tso_train, folder, tmp_path):
    assert tso_train(folder, *MASKS, "--saturation-steps", 3).code == 0
    assert tso_train(folder, *MASKS, "--steps", 4, "--resume").code == 0
    assert load_network(tmp_path / "base.safetensors")[1].settings["saturation_steps"] == 3
    assert tso_train(folder, *MASKS, "--steps", 6, "--resume", "--saturation-steps", 3).code == 0
    assert tso_train(folder, *MASKS, "--steps", 8, "--resume", "--saturation-steps", 4).code == 2


@pytest.mark.parametrize(
    ("step", "presses", "message"),
    [(2, 1, "interrupted after 2 of 4 steps"), (3, 2, "error: interrupted")],
)
def test_ctrl_c_exits_with_130_and_the_last_checkpoint_is_resumed_bit_for_bit(
    tso_train, folder, tmp_path, monkeypatch, step, presses, message
):
    straight, output = tmp_path / "straight.safetensors", tmp_path / "base.safetensors"
    assert tso_train(folder, "--steps", 4, "-o", straight).code == 0
    show = options.ProgressBar.__call__

    def press(bar, done, total, note=""):
        show(bar, done, total, note)
        for _ in range(presses if bar.label == "train" and done == step else 0):
            signal.raise_signal(signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    with monkeypatch.context() as patch:
        patch.setattr(options.ProgressBar, "__call__", press)
        interrupted = tso_train(folder, "--steps", 4, "--checkpoint-every", 2)
    assert interrupted.code == 130
    assert message in interrupted.err
    assert load_network(output)[1].steps == 2
    assert signal.getsignal(signal.SIGINT) is before
    resumed = tso_train(folder, "--steps", 4, "--resume")
    assert resumed.code == 0
    assert "resuming after 2 steps" in resumed.err
    assert output.read_bytes() == straight.read_bytes()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["none"], "none"),
        (["boxes", "-o", "there.safetensors"], "exists"),
        (["boxes", "-o", "a.pth"], "the suffix is '.pth', expected .safetensors"),
        (["boxes", "--resume"], "base.training.safetensors: does not exist"),
        (["boxes", "--steps", 0], "steps is 0"),
        (["none", "--crop-share", "-1"], "--crop-share is -1, expected a number from 0 to 1"),
        (["boxes", "--device", "cuda:99"], "cuda:99"),
        (["boxes", "--frame", "world"], "world"),
        (["boxes", "--mask-data", "boxes"], "--mask-data boxes is for --supervision joint"),
        (["boxes", "--supervision", "joint"], "joint, expected --mask-data FOLDER with it"),
        (["boxes", "--views", 2], "--views 2 is for --supervision masks"),
        (["boxes", "--mask-split", "boxes"], "says nothing without --mask-data"),
        (["boxes", "--lambda", 2], "--lambda 2 is for --supervision masks or joint"),
        (
            ["boxes", *MASKS, "--category-sigma-sq", "crate=1"],
            "sigma^2 is given for 'crate', expected one of",
        ),
        (["boxes", "--log-file", "base.safetensors"], "expected a file of its own"),
    ],
)
def test_refuses_in_one_line_and_writes_nothing(
    tso_train, folder, tmp_path, monkeypatch, arguments, message
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.safetensors").write_bytes(b"mine")
    before = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    assert message in tso_train(*arguments).refusal
    assert {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == before


def test_threads_that_prepare_batches_ahead_change_no_weight(tso_train, folder, tmp_path):
    names = [tmp_path / "one.safetensors", tmp_path / "three.safetensors"]
    for name, workers in zip(names, (1, 3), strict=True):
        assert tso_train(folder, "--workers", workers, "-o", name).code == 0
    one, three = map(load_file, names)
    assert one.keys() == three.keys()
    assert all(torch.equal(one[key], three[key]) for key in one)


def test_the_end_of_a_complete_training_is_said_when_it_is_resumed(tso_train, folder, tmp_path):
    assert tso_train(folder, "--steps", 2).code == 0
    before = (tmp_path / "base.safetensors").read_bytes()
    again = tso_train(folder, "--steps", 2, "--resume")
    assert (again.code, "the training is complete, with 2 steps" in again.err) == (0, True)
    assert (tmp_path / "base.safetensors").read_bytes() == before
