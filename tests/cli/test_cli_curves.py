"""Loss curves from logs, and pictures of what a network makes of a data set."""

import json

import numpy as np
import pytest
from PIL import Image

from tests.corruption import assert_refused
from tso_cli.io.checkpoints import save_network
from tso_cli.io.logs import read_log
from tso_cli.network.model import NetworkConfig
from tso_cli.plots.curves import labels, lambda_drop, running_mean, sample_predictions
from tso_cli.train.data import TrainingData
from tso_cli.train.loop import train
from tso_cli.train.state import write_history

from ..train.conftest import write
from ..training import config, make_objects, make_thin


@pytest.fixture
def log(tmp_path):
    """Twelve steps with masks, lambda dropped after the eighth."""
    rows = [(20.0 - step, 10.0, 1.0, 1.0 if step <= 8 else 0.02) for step in range(1, 13)]
    path = tmp_path / "masks.jsonl"
    write_history(path, rows, NetworkConfig(supervision="masks"))
    return path


def test_a_log_is_one_line_of_settings_and_one_a_step_and_is_read_as_it_was_written(log):
    lines = [json.loads(line) for line in log.read_text().splitlines()]
    assert len(lines) == 13
    assert "supervision" in lines[0]
    read = read_log(log)
    assert read.settings["supervision"] == "masks"
    assert list(read.columns) == ["step", "loss", "bce", "affinity", "lambda"]
    np.testing.assert_array_equal(read.columns["loss"], 20.0 - np.arange(1, 13))


def test_the_drop_of_lambda_is_the_first_step_with_the_smaller_one(log):
    assert lambda_drop(read_log(log)) == 9
    path = log.with_name("points.jsonl")
    write_history(path, [(1.0, 0.5, 0.5, 0.0)] * 3, NetworkConfig())
    assert lambda_drop(read_log(path)) is None


@pytest.mark.parametrize(
    ("window", "means"),
    [(1, [4.0, 2.0, 6.0, 0.0]), (2, [4.0, 3.0, 4.0, 3.0]), (9, [4.0, 3.0, 4.0, 3.0])],
)
def test_the_running_mean_is_over_the_last_values_there_are(window, means):
    np.testing.assert_allclose(running_mean(np.array([4.0, 2.0, 6.0, 0.0]), window), means)


def test_logs_of_one_name_are_labelled_by_their_folders(log, tmp_path):
    (tmp_path / "b").mkdir()
    twin = tmp_path / "b" / log.name
    twin.write_bytes(log.read_bytes())
    assert labels([read_log(log), read_log(twin)]) == [f"{tmp_path.name}/masks", "b/masks"]
    assert labels([read_log(log)]) == ["masks"]


@pytest.mark.parametrize(
    ("kept", "line", "message"),
    [
        (2, "{not json", "line 3 is"),
        (2, "[1, 2]", "line 3 .*expected a JSON object"),
        (2, '{"step": 2, "loss": 1.0}', "line 3 .*expected numbers for step, loss, bce"),
        (
            2,
            '{"step": 2, "loss": NaN, "bce": 1, "affinity": 1, "lambda": 1}',
            "line 3 .*expected numbers",
        ),
        (1, "", "no step"),
        (0, '{"step": 2, "loss": 1.0}', "no supervision"),
    ],
)
def test_a_damaged_log_is_refused(log, kept, line, message):
    log.write_text("\n".join([*log.read_text().splitlines()[:kept], line]))
    assert_refused(f"masks.jsonl: .*{message}", read_log, log)


def test_the_command_draws_several_logs_of_different_losses_and_one_that_is_zero(
    log, tmp_path, tso
):
    points = tmp_path / "points.jsonl"
    write_history(points, [(1.0 / step, 0.5, 0.0, 0.0) for step in range(1, 20)], NetworkConfig())
    output = tmp_path / "curves.png"
    printed = tso("curves", log, points, "-o", output).out
    assert "masks: 12 steps, masks, loss 19 to 8, lambda dropped before step 9" in printed
    assert "points: 19 steps, points" in printed
    with Image.open(output) as picture:
        # a panel for each of loss, bce, affinity, forward, backward
        assert picture.size[0] > 2000
    before = output.read_bytes()
    assert "exists" in tso("curves", log, "-o", output).refusal
    assert output.read_bytes() == before


@pytest.mark.slow
def test_the_command_draws_samples_spread_over_the_data_next_to_the_curves(
    monkeypatch, tmp_path, tso
):
    make_thin(monkeypatch)
    objects = make_objects(3, 2)
    for item in objects:
        write(tmp_path / "data", item)
    result = train(TrainingData(objects, "three boxes"), config(steps=1))
    save_network(tmp_path / "net.safetensors", result.network, result.config)
    write_history(tmp_path / "log.jsonl", [tuple(row) for row in result.history], result.config)
    network = ("--checkpoint", tmp_path / "net.safetensors")
    asked = (
        tmp_path / "log.jsonl",
        "-o",
        tmp_path / "curves.png",
        *network,
        "--data",
        tmp_path / "data",
        "--samples",
        2,
    )
    assert "2 samples" in tso("curves", *asked).out
    samples = sample_predictions(result.network, TrainingData(objects, "three boxes"), "view", 2)
    assert [sample.name for sample in samples] == ["box0", "box2"]
    assert samples[0].points.shape == (64, 3)
    assert samples[0].chamfer > 0.0
    with Image.open(tmp_path / "curves.samples.png") as picture:
        assert picture.size[0] > 800
    alone = tso("curves", tmp_path / "log.jsonl", "-o", tmp_path / "other.png", *network)
    assert "says nothing without --data, expected --data FILE" in alone.refusal
    assert not (tmp_path / "other.png").exists()
