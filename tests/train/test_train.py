"""Training: what is learned, how it stops and resumes; it depends on seed and data alone."""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from tests.corruption import assert_refused, full_disk
from tso_cli.errors import TsoError
from tso_cli.io.checkpoints import load_network
from tso_cli.network.model import build_network
from tso_cli.train.config import TrainConfig
from tso_cli.train.data import TrainingData
from tso_cli.train.loop import evaluate, network_config, start, train
from tso_cli.train.processes import Processes
from tso_cli.train.state import load_training, save_training, state_path

from ..training import config, make_objects

# Six bit-identical steps under every form of state that a resume must restore.
SETTINGS = [
    {"learning_rate": 1e-3},
    {"learning_rate": 1e-3, "supervision": "masks"},
    {"averaging": 0.9, "augment": True, "balance": True},
]


def weights(network):
    return {name: tensor.clone() for name, tensor in network.state_dict().items()}


def assert_equal(one, other):
    assert one.keys() == other.keys()
    for name in one:
        assert torch.equal(one[name], other[name]), name


def resume(path, data, settings):
    return load_training(
        path, network_config(data, settings, 0), data.fingerprint(), torch.device("cpu")
    )


def train_into(path, data, settings, state=None, **options):
    return train(
        data,
        settings,
        state,
        save=lambda current, saved: save_training(path, current, saved),
        **options,
    )


# What is learned


MASKS = {
    "supervision": "masks",
    "frame": "canonical",
    "points": 128,
    "sigma_sq": 2.0,
    "saturation_steps": 500,
}


@pytest.mark.parametrize("supervision", [{}, MASKS], ids=["points", "masks"])
def test_supervision_lowers_the_loss_and_masks_alone_the_distance_to_the_true_shape(
    thin, data, supervision
):
    settings = config(steps=40, learning_rate=2e-3, **supervision)
    before = sum(evaluate(start(data, settings).network, data, settings.frame)[:2])
    result = train(data, settings)
    assert result.history[-10:, 0].mean() < 0.7 * result.history[:5, 0].mean()
    assert result.steps == 40
    assert result.stop_reason == "max_steps"
    assert not supervision or sum(evaluate(result.network, data, settings.frame)[:2]) < 0.6 * before


def test_joint_training_lowers_both_the_distance_to_points_and_the_cross_entropy_of_masks(
    thin, data
):
    masked = TrainingData(make_objects(2), "two boxes with one mask each")
    settings = config(
        supervision="joint",
        steps=30,
        learning_rate=2e-3,
        batch_size=4,
        saturation_steps=500,
        sigma_sq=1.0,
    )
    result = train(data, settings, masked=masked)
    first, last = result.history[:5].mean(0), result.history[-5:].mean(0)
    assert last[1] < 0.8 * first[1]
    assert last[2] < 0.8 * first[2]
    assert result.config.settings["joint_weight"] == 1e6


def test_mixed_precision_takes_nearly_the_same_steps(thin, data):
    exact, mixed = (
        train(data, config(steps=4, precision=name)) for name in ("float32", "bfloat16")
    )
    np.testing.assert_allclose(mixed.history[:, 0], exact.history[:, 0], rtol=0.02)
    assert not np.array_equal(mixed.history, exact.history)
    assert all(parameter.dtype == torch.float32 for parameter in mixed.network.parameters())


def test_the_seed_decides_the_network(thin, data):
    one, same, other = (
        train(data, config(steps=3, seed=seed)).network.state_dict() for seed in (1, 1, 2)
    )
    assert_equal(one, same)
    assert not torch.equal(one["encoder.latent.weight"], other["encoder.latent.weight"])


def test_training_starts_from_given_weights(thin, data):
    first = train(data, config()).network
    assert_equal(weights(start(data, config(seed=5), first).network), weights(first))
    assert_refused("predicts 64 points, expected 32", start, data, config(points=32), first)


def test_averaging_saves_other_weights_than_the_last_and_keeps_constant_ones(thin, data):
    last, mean = (train(data, config(averaging=averaging)).network for averaging in (0.0, 0.9))
    assert not torch.equal(last.encoder.latent.weight, mean.encoder.latent.weight)
    state = start(data, config())
    for _ in range(5):
        state.history.append((0.0, 0.0, 0.0, 0.0))
        state.update_average(dict(state.network.named_parameters()), 0.9)
    for average, parameter in zip(state.average.values(), state.network.parameters(), strict=True):
        torch.testing.assert_close(average, parameter.detach())


@pytest.mark.parametrize(
    ("changes", "masked", "processes", "message"),
    [
        (
            {"supervision": "joint", "batch_size": 3},
            True,
            1,
            "batch size is 3, expected a multiple of 2",
        ),
        ({"batch_size": 3}, False, 2, "batch size is 3, expected a multiple of 2"),
        (
            {"supervision": "masks", "views": 5},
            False,
            1,
            "box0: has 4 views, expected at least the 5",
        ),
    ],
)
def test_data_that_lack_what_the_supervision_needs_are_refused(
    data, changes, masked, processes, message
):
    assert_refused(
        message,
        train,
        data,
        config(**changes),
        masked=data if masked else None,
        processes=Processes(0, processes),
    )


@pytest.mark.parametrize(
    "change",
    [{"steps": 0}, {"views": 0}, {"batch_size": -1}, {"workers": 0}, {"sigma_sq": -0.4},
     {"learning_rate": 0.0}, {"learning_rate": float("nan")}, {"affinity_weight": -1.0},
     {"averaging": 1.0}, {"category_sigma_sq": {"car": 0.0}}, {"joint_weight": 0.0}],
)  # fmt: skip
def test_impossible_settings_are_refused(change):
    assert_refused("expected", config, **change)


def test_the_saturation_window_is_a_sixth_of_the_steps_within_bounds():
    assert [TrainConfig(steps=steps).window for steps in (6, 600, 20_000)] == [
        10,
        100,
        500,
    ]
    assert TrainConfig(steps=600, saturation_steps=7).window == 7


# How it stops and resumes


@pytest.mark.parametrize("settings", SETTINGS)
def test_a_resumed_training_is_bit_for_bit_the_uninterrupted_one(thin, data, tmp_path, settings):
    path, other = tmp_path / "base.safetensors", tmp_path / "straight.safetensors"
    straight = train_into(other, data, config(**settings))
    state = start(data, config(**settings))
    train_into(path, data, config(steps=3, **settings), state)
    resumed_state = resume(path, data, config(**settings))
    assert resumed_state.schedule == state.schedule
    assert (state.schedule.count == 1) == (settings.get("supervision") == "masks")  # amid a window
    resumed = train_into(path, data, config(**settings), resumed_state)
    assert_equal(weights(straight.network), weights(resumed.network))
    np.testing.assert_array_equal(straight.history, resumed.history)
    assert_equal(load_file(state_path(other)), load_file(state_path(path)))


def test_a_resume_of_the_full_network_is_bit_for_bit_too(data, tmp_path):
    path, straight = tmp_path / "base.safetensors", train(data, config(steps=2))
    train_into(path, data, config(steps=1))
    assert_equal(
        weights(straight.network),
        weights(train(data, config(steps=2), resume(path, data, config())).network),
    )


def test_checkpoints_are_saved_every_few_steps_and_can_be_read(thin, data, tmp_path):
    path, steps = tmp_path / "base.safetensors", []

    def save(state, saved):
        save_training(path, state, saved)
        network, read = load_network(path)
        assert_equal(weights(network), weights(state.network))
        steps.append(read.steps)
        assert read.frame == "view"
        assert read.supervision == "points"
        assert read.points == 64
        assert read.training_set == "three boxes"

    train(data, config(steps=5), save=save, save_every=2)
    assert steps == [2, 4, 5]


def test_a_full_disk_leaves_the_previous_checkpoint(thin, data, tmp_path, monkeypatch):
    path = tmp_path / "base.safetensors"
    train_into(path, data, config(steps=2))
    before = {file.name: file.read_bytes() for file in tmp_path.iterdir()}
    with monkeypatch.context() as patch, pytest.raises(TsoError, match="No space left on device"):
        patch.setattr(type(path), "write_bytes", full_disk)
        train_into(path, data, config(steps=4), resume(path, data, config()))
    assert {file.name: file.read_bytes() for file in tmp_path.iterdir()} == before


def test_a_loss_that_is_not_finite_stops_the_training(thin, data, monkeypatch):
    state = start(data, config())
    with torch.no_grad():
        list(state.network.parameters())[-1].fill_(float("nan"))
    monkeypatch.setattr(
        "tso_cli.train.step.point_loss", lambda points, batch: (points.sum(), 0.0, 0.0)
    )
    with pytest.raises(TsoError, match=r"became nan in step 1 .*nothing was written"):
        train(data, config(), state)


def test_a_resume_with_other_settings_or_other_data_or_without_a_state_is_refused(
    thin, data, tmp_path
):
    path = tmp_path / "base.safetensors"
    assert_refused(r"base.training.safetensors: does not exist", resume, path, data, config())
    train_into(path, data, config(steps=2, averaging=0.9))
    same = {"averaging": 0.9}
    for change, message in (
        ({"learning_rate": 1e-4}, "trained with learning_rate 5e-05, this run asks for 0.0001"),
        ({"averaging": 0.5}, "trained with averaging 0.9, this run asks for 0.5"),
        ({"points": 32}, "trained with points 64, this run asks for 32"),
        ({"frame": "canonical"}, "trained with frame 'view'"),
        ({"supervision": "masks"}, "trained with supervision"),
        ({"seed": 3}, "trained with seed 0"),
    ):
        assert_refused(message, resume, path, data, config(**{**same, **change}))
    assert_refused(
        "steps is .*, expected more: 2 steps are done already",
        train,
        data,
        config(steps=1, **same),
        resume(path, data, config(**same)),
    )
    assert_refused(
        "other data", resume, path, TrainingData(make_objects(2), "three boxes"), config(**same)
    )
    path.replace(state_path(path))
    assert_refused("step in the state is None", resume, path, data, config(**same))


def test_a_damaged_training_state_is_refused(thin, data, tmp_path):
    path = tmp_path / "base.safetensors"
    train_into(path, data, config(steps=1))
    file = state_path(path)
    tensors, raw = load_file(file), file.read_bytes()
    whole = json.loads(
        json.loads(raw[8 : 8 + int.from_bytes(raw[:8], "little")])["__metadata__"]["tso"]
    )
    state, weight, moment = (
        whole["training"],
        "encoder.convolutions.0.weight",
        "training.exp_avg.encoder.latent.weight",
    )

    def refused(message, stored, **change):
        save_file(stored, file, {"tso": json.dumps({**whole, "training": {**state, **change}})})
        assert_refused(message, resume, path, data, config())

    for change in (
        {"schedule": 3},
        {"schedule": {**state["schedule"], "window": "x"}},
        {"step": 7},
    ):
        refused(file.name, tensors, **change)
    wide = {**tensors, weight: torch.zeros(8, 3, 3, 3)}
    refused(rf"{weight} has shape \[8, 3, 3, 3\], expected \[4, 3, 3, 3\]", wide)
    del tensors[moment]
    refused("exp_avg.encoder.latent.weight is missing", tensors)


# How it is evaluated


def test_the_evaluation_of_a_perfect_prediction_is_zero(data):
    class Oracle(torch.nn.Linear):
        def forward(self, images):
            return torch.from_numpy(data.target(0)).expand(len(images), -1, -1)

    one = TrainingData(data.objects[:1], "one box")
    assert evaluate(Oracle(1, 1), one, "canonical")[:2] == pytest.approx((0.0, 0.0), abs=1e-12)


def test_of_many_objects_evenly_spread_ones_are_evaluated(thin, data):
    read = []

    def target(number):
        return lambda: (read.append(number), data.target(number % 3))[1]

    objects = [replace(data.objects[i % 3], name=f"box{i}", target=target(i)) for i in range(100)]
    assert (
        evaluate(build_network(64), TrainingData(objects, "boxes"), "canonical", views=1, most=5)[2]
        == 5
    )
    assert read == [0, 25, 50, 74, 99]
