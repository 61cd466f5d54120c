"""The command `tso train-prior`: what it trains on, what it says, what it refuses."""

import json
import re
import shutil
import signal

import numpy as np
import pytest
import torch

from tso_cli.commands import options
from tso_cli.io.logs import read_log
from tso_cli.io.shipped import examples_folder
from tso_cli.prior.file import read_prior
from tso_cli.prior.network import initial
from tso_cli.train.prior.loss import loss
from tso_cli.train.prior.starts import draw

MESHES = examples_folder() / "meshes"


@pytest.fixture
def folder(tmp_path):
    """Three chairs and a car, small meshes all."""
    names = ("chair/q17_Chair", "chair/q19_Chair", "chair/kfurn_chair", "car/qreal_Cop")
    for name in names:
        (tmp_path / "shapes" / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(MESHES / f"{name}.ply", tmp_path / "shapes" / f"{name}.ply")
    return tmp_path / "shapes"


@pytest.fixture
def train(tso, tmp_path):
    """`tso train-prior` for two short steps; of an option given twice the last counts."""
    common = ("-o", tmp_path / "my.safetensors", "--steps", 2, "--batch-size", 2, "--scenes", 3)
    return lambda folder, *options: tso("train-prior", folder, *common, *options)


def test_trains_on_a_folder_and_reports_it(train, folder, tmp_path):
    done = train(folder, "--log-file", tmp_path / "log.jsonl", "--json")
    document = done.document
    assert document["steps"] == 2
    assert document["stop_reason"] == "max_steps"
    assert document["training_set"] == "shapes: 3 meshes of chair"
    assert document["categories"] == {"chair": 3}
    assert list(document["left_out"]) == ["car"]
    assert "has 1 usable objects of the category 'car'" in done.err
    settings = {"steps": 2, "batch_size": 2, "scenes": 3, "seed": 0}
    settings |= {"by_rule": 0, "marred": 0.4, "depth_maps": 0.4, "precision": "float32"}
    assert document["settings"] == settings | {"device": "cpu"}
    about = read_prior(tmp_path / "my.safetensors")[1]
    assert about["training_set"] == "shapes: 3 meshes of chair"
    assert about["settings"] == settings
    log = read_log(tmp_path / "log.jsonl")
    assert log.columns["loss"].mean() == pytest.approx(document["loss"])
    names = sorted(path.name for path in tmp_path.iterdir())
    assert names == ["log.jsonl", "my.safetensors", "my.training.safetensors", "shapes"]


def test_prints_a_summary(train, folder):
    done = train(folder)
    assert "my.safetensors: 2 steps in" in done.out
    assert "mean of the last 2 steps" in done.out


@pytest.mark.slow
def test_a_short_training_lowers_the_loss(train, bank, tmp_path):
    done = train(MESHES, "--steps", 16, "--batch-size", 12, "--scenes", 40)
    assert done.code == 0
    batch = draw(bank, np.random.default_rng(1), 48)
    losses = []
    for weights in (initial(0), read_prior(tmp_path / "my.safetensors")[0]):
        tensors = {name: torch.tensor(np.float32(array)) for name, array in weights.items()}
        losses.append(float(loss(tensors, batch, torch.Generator().manual_seed(0)).sum()))
    assert losses[1] < losses[0]


def test_ctrl_c_exits_with_130_and_the_training_is_resumed_bit_for_bit(
    train, folder, tmp_path, monkeypatch
):
    straight, output = tmp_path / "straight.safetensors", tmp_path / "my.safetensors"
    assert train(folder, "--steps", 3, "-o", straight).code == 0
    show = options.ProgressBar.__call__

    def press(bar, done, total, note=""):
        show(bar, done, total, note)
        if bar.label == "train" and done == 2:
            signal.raise_signal(signal.SIGINT)

    with monkeypatch.context() as patch:
        patch.setattr(options.ProgressBar, "__call__", press)
        interrupted = train(folder, "--steps", 3)
    assert interrupted.code == 130
    assert "interrupted after 2 of 3 steps" in interrupted.err
    resumed = train(folder, "--steps", 3, "--resume")
    assert resumed.code == 0
    assert "resuming after 2 steps" in resumed.err
    assert output.read_bytes() == straight.read_bytes()


def test_a_finished_training_that_is_resumed_writes_its_prior_again(train, folder, tmp_path):
    output = tmp_path / "my.safetensors"
    assert train(folder).code == 0
    before = output.read_bytes()
    output.unlink()
    assert train(folder, "--resume", "--json").document["steps_of_this_run"] == 0
    assert output.read_bytes() == before


def test_a_prior_says_from_which_prior_its_training_began_also_after_a_resumed_run(
    train, folder, tmp_path
):
    output = tmp_path / "my.safetensors"
    assert train(folder, "--steps", 1, "--init", "default").code == 0
    began = read_prior(output)[1]["settings"]["initial"]
    assert re.fullmatch(r"prior\.safetensors, [0-9a-f]{16}", began)
    assert train(folder, "--steps", 1, "--resume").code == 0
    assert read_prior(output)[1]["settings"]["initial"] == began


def test_other_settings_or_other_meshes_are_not_resumed(train, folder):
    assert train(folder).code == 0
    refused = train(folder, "--resume", "--batch-size", 5).refusal
    assert "was trained with --batch-size 2, this run asks for 5" in refused
    refused = train(folder, "--resume", "--scenes", 5).refusal
    assert "was trained with --scenes 3" in refused
    (folder / "chair" / "q17_Chair.ply").unlink()
    assert "was trained on other shapes" in train(folder, "--resume").refusal


def test_training_starts_from_a_prior(train, folder, tmp_path):
    assert train(folder).code == 0
    random = train(folder, "-o", tmp_path / "random.safetensors", "--json").document
    first = train(
        folder, "--init", tmp_path / "my.safetensors", "-o", tmp_path / "b.safetensors", "--json"
    ).document
    assert first["loss"] != random["loss"]


def test_the_shipped_prior_is_called_default(train, folder, tmp_path, monkeypatch):
    assert train(folder).code == 0
    monkeypatch.setattr("tso_cli.prior.file.DEFAULT_PRIOR", tmp_path / "my.safetensors")
    assert train(folder, "--init", "default", "-o", tmp_path / "b.safetensors").code == 0


def test_a_category_is_left_out(train, folder, tmp_path):
    shutil.copy(MESHES / "car" / "qreal_SUV.ply", folder / "car")
    document = train(folder, "--without", "chair", "--json").document
    assert document["categories"] == {"car": 2}


def test_a_broken_mesh_is_left_out_and_named(train, folder):
    (folder / "chair" / "broken.ply").write_bytes(b"ply\nnothing")
    done = train(folder, "--json")
    assert "broken.ply" in done.err
    assert "left out" in done.err
    assert len(done.document["left_out"]) == 2
    assert "broken.ply" in train(folder, "--strict", "--overwrite").refusal


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["none"], "none: not a folder"),
        (["shapes/car"], "expected 2 at least"),
        (["shapes", "--without", "sofa"], "has no category 'sofa' to leave out"),
        (["shapes", "--without", "chair"], "no category can be learned from"),
        (["shapes", "-o", "there.safetensors"], "exists"),
        (["shapes", "-o", "a.pth"], "the suffix is '.pth', expected .safetensors"),
        (["shapes", "--resume"], "prior.training.safetensors: does not exist"),
        (["shapes", "--steps", 0], "--steps is 0, expected a whole number, 1 or more"),
        (["shapes", "--batch-size", 0], "--batch-size is 0, expected a whole number, 1 or more"),
        (["shapes", "--scenes", 0], "--scenes is 0, expected a whole number, 1 or more"),
        (["shapes", "--device", "cuda:99"], "cuda:99"),
        (["shapes", "--init", "there.safetensors"], "there.safetensors"),
        (["shapes", "--resume", "--init", "a"], "--init with --resume"),
        (["shapes", "--predictions", 3], "--predictions counts what a network predicts"),
        (["--scenes", 3], "no MESHES were given, expected their folder, or --by-rule N"),
    ],
)
def test_refuses_in_one_line_and_writes_nothing(
    tso, folder, tmp_path, monkeypatch, arguments, message
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "there.safetensors").write_bytes(b"mine")
    before = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    assert message in tso("train-prior", *arguments).refusal
    assert {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()} == before


def test_several_processes_are_refused(train, folder, monkeypatch):
    monkeypatch.setenv("WORLD_SIZE", "2")
    assert "tso train-prior with 2 processes, expected one" in train(folder).refusal


def test_the_log_has_the_settings_on_its_first_line(train, folder, tmp_path):
    assert train(folder, "--log-file", tmp_path / "log.jsonl").code == 0
    first = json.loads((tmp_path / "log.jsonl").read_text().splitlines()[0])
    assert first["supervision"] == "prior"
    assert first["scenes"] == 3
