"""The training of a prior: steps, resuming, files."""

import json
import signal
from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors.torch import load_file, save_file

from tso_cli.errors import InputError, TsoError
from tso_cli.prior.file import read_prior
from tso_cli.prior.network import initial
from tso_cli.train.prior.config import PriorConfig
from tso_cli.train.prior.loop import train
from tso_cli.train.prior.loss import PARTS
from tso_cli.train.prior.state import load_training, new_state, save_training, write_history
from tso_cli.train.trainer import state_path

CPU = torch.device("cpu")
CONFIG = PriorConfig(steps=4, batch_size=2, scenes=60)


def objective(weights, batch, generator):
    """Takes a millisecond, and depends on all that the true loss depends on."""
    noise = torch.randn((), generator=generator)
    squares = sum(weight.square().mean() for weight in weights.values())
    loss = squares * (1.0 + batch.start.abs().mean() + 0.1 * noise.abs())
    return torch.stack([loss, 0.1 * loss, 0.2 * loss, 0.3 * loss])


def begin():
    return new_state(initial(0), "shapes", CPU)


def save(path, state, config=CONFIG):
    save_training(path, state, config, "two chairs")


def load(path, config=CONFIG, fingerprint="shapes"):
    return load_training(path, config, initial(0), fingerprint, CPU)


def run(bank, state, config=CONFIG, **options):
    return train(bank, config, state, objective=objective, **options)


def same_state(first, second):
    assert first.history == second.history
    for name in first.weights:
        assert torch.equal(first.weights[name], second.weights[name])
        assert torch.equal(first.average[name], second.average[name])


@pytest.fixture
def finished(bank, tmp_path):
    """The path of a prior whose training is done, and the state of the training."""
    state = begin()
    run(bank, state, save=lambda state: save(tmp_path / "prior.safetensors", state))
    return tmp_path / "prior.safetensors", state


def test_the_weights_change_and_the_given_ones_stay(bank):
    given = initial(0)
    state = new_state(given, "shapes", CPU)
    assert run(bank, state) == "max_steps"
    assert state.step == 4
    assert not np.array_equal(state.weights["view1"].detach(), given["view1"])
    np.testing.assert_array_equal(given["view1"], initial(0)["view1"])


def test_the_rate_rises_then_falls_to_zero():
    config = PriorConfig(steps=4000)
    rates = np.array([config.rate(step) for step in range(4001)])
    assert rates[0] == pytest.approx(0.01)
    assert (rates[99:500] == 1.0).all()
    assert rates[1999] == pytest.approx(0.5)
    assert (np.diff(rates[499:]) < 0.0).all()
    assert rates[4000] == 0.0


def test_a_longer_training_begins_as_a_shorter():
    short, long = PriorConfig(steps=2000), PriorConfig(steps=6000)
    assert [short.rate(step) for step in range(1501)] == [long.rate(step) for step in range(1501)]


def test_a_training_that_was_cooled_may_go_on():
    short, long = PriorConfig(steps=200), PriorConfig(steps=600, cooled_at=200)
    assert [short.rate(step) for step in range(200)] == [long.rate(step) for step in range(200)]
    assert long.rate(199) < 0.1 < long.rate(200)
    assert long.rate(600) == 0.0
    with pytest.raises(InputError, match="`cooled_at` is 6, expected less than `steps`, 6"):
        PriorConfig(steps=6, cooled_at=6)


def test_a_short_training_rises_for_a_tenth_of_it():
    assert PriorConfig(steps=16).rate(1) > 0.9


def test_a_resumed_training_gives_the_same_bits(bank, finished, tmp_path):
    straight_path, straight = finished
    path, state = tmp_path / "other.safetensors", begin()

    def stop(done, total, note):
        if done == 2:
            signal.raise_signal(signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    reason = run(bank, state, progress=stop, save=lambda state: save(path, state))
    assert (reason, state.step) == ("interrupted", 2)
    assert signal.getsignal(signal.SIGINT) is before
    assert read_prior(path)[1]["settings"]["steps"] == 2
    resumed = load(path)
    assert run(bank, resumed, save=lambda state: save(path, state)) == "max_steps"
    same_state(resumed, straight)
    assert path.read_bytes() == straight_path.read_bytes()
    assert state_path(path).read_bytes() == state_path(straight_path).read_bytes()


def test_a_training_is_made_longer_before_its_rate_is_cooled(bank, tmp_path):
    """Then it gives the bits of the longer training; after that only with `cooled_at`."""
    path, state = tmp_path / "other.safetensors", begin()
    shorter, longer = replace(CONFIG, steps=12), replace(CONFIG, steps=16)

    def stop(done, total, note):
        if done == 9:
            signal.raise_signal(signal.SIGINT)

    run(bank, state, shorter, progress=stop, save=lambda state: save(path, state, shorter))
    straight = begin()
    run(bank, straight, longer)
    resumed = load(path, longer)
    run(bank, resumed, longer)
    same_state(resumed, straight)
    run(bank, load(path, shorter), shorter, save=lambda state: save(path, state, shorter))
    with pytest.raises(InputError, match="was trained with `steps` 12, this run asks for 16"):
        load(path, longer)
    assert load(path, replace(longer, cooled_at=12)).step == 12


def test_the_number_of_workers_does_not_change_a_bit(bank, finished):
    both = begin()
    run(bank, both, workers=2)
    same_state(both, finished[1])


def test_a_second_ctrl_c_stops_at_once(bank):
    def stop(done, total, note):
        for _ in range(2):
            signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        run(bank, begin(), progress=stop)


def test_a_finished_training_writes_its_prior_again(bank, finished):
    path, _ = finished
    before = path.read_bytes()
    path.unlink()
    assert run(bank, load(path), save=lambda state: save(path, state)) == "max_steps"
    assert path.read_bytes() == before


def test_the_mean_of_the_weights_is_saved(finished):
    path, state = finished
    weights, about = read_prior(path)
    for name, mean in state.average.items():
        np.testing.assert_array_equal(weights[name], mean.half().double())
    assert not torch.equal(state.average["view1"], state.weights["view1"].detach())
    assert about["training_set"] == "two chairs"


def test_a_prior_has_the_learning_curve_of_its_training_and_the_digest_of_its_shapes(finished):
    path, state = finished
    about = read_prior(path)[1]
    assert about["shapes"] == state.fingerprint
    curve = about["curve"]
    assert [step for step, _ in curve] == list(range(1, state.step + 1))
    left = [parts[0] for parts in state.history]
    np.testing.assert_allclose([mean for _, mean in curve], left, atol=1e-4)
    state = replace(state, history=[[step, 0.0, 0.0, 0.0] for step in range(1, 101)])
    assert state.curve() == [[step, step - 2.0] for step in range(5, 101, 5)]


def test_the_state_is_saved_on_the_way(bank):
    steps = []
    run(bank, begin(), save=lambda state: steps.append(state.step), save_every=2)
    assert steps == [2, 4]


@pytest.mark.parametrize("name", ["batch_size", "scenes", "seed"])
def test_a_state_of_other_settings_is_refused(finished, name):
    other = PriorConfig(**{**CONFIG.settings(), name: 7})
    with pytest.raises(
        InputError, match=f"trained with `{name}` .*, this run asks for 7; expected"
    ):
        load(finished[0], other)


def test_a_state_of_other_shapes_is_refused(finished):
    with pytest.raises(InputError, match=r"trained on other shapes \('two chairs'\), expected"):
        load(finished[0], fingerprint="others")


def test_a_state_that_is_not_there_is_named(tmp_path):
    with pytest.raises(InputError, match=r"none\.training\.safetensors: does not exist"):
        load(tmp_path / "none.safetensors")


def test_a_damaged_state_is_refused(finished):
    path = state_path(finished[0])
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match="damaged"):
        load(finished[0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda tensors: tensors.pop("momentum.view1"), r"momentum\.view1 is missing"),
        (lambda tensors: tensors.update(history=torch.zeros(3)), "history has shape"),
        (lambda tensors: tensors["view2"].fill_(torch.nan), "not finite"),
    ],
)
def test_a_state_whose_tensors_were_changed_is_refused(finished, change, message):
    from safetensors import safe_open

    path = state_path(finished[0])
    with safe_open(path, framework="pt") as file:
        metadata = file.metadata()
    tensors = load_file(path)
    change(tensors)
    save_file(tensors, path, metadata)
    with pytest.raises(InputError, match=message):
        load(finished[0])


def test_a_network_is_no_state_of_a_prior(finished):
    path = state_path(finished[0])
    path.write_bytes(finished[0].read_bytes())
    with pytest.raises(InputError, match="format in the metadata is 'tso-prior-2'"):
        load(finished[0])


def test_a_weight_that_is_too_large_for_the_prior_leaves_the_files_as_they_are(finished):
    path, state = finished
    before = path.read_bytes(), state_path(path).read_bytes()
    state.average["view1"].fill_(1e6)
    with pytest.raises(InputError, match="too large"):
        save(path, state)
    assert (path.read_bytes(), state_path(path).read_bytes()) == before


def test_a_loss_that_is_not_finite_stops_the_training(bank):
    state = begin()
    with pytest.raises(TsoError, match="the loss became nan in step 1"):
        train(bank, CONFIG, state, objective=lambda *given: objective(*given) * torch.nan)
    assert state.step == 0


def test_the_log_has_settings_and_losses(finished, tmp_path):
    write_history(tmp_path / "log.jsonl", finished[1], CONFIG, "two chairs")
    lines = [json.loads(line) for line in (tmp_path / "log.jsonl").read_text().splitlines()]
    assert lines[0]["batch_size"] == 2
    assert lines[1:] == [
        {"step": step, "loss": sum(parts), **dict(zip(PARTS, parts, strict=True))}
        for step, parts in enumerate(finished[1].history, 1)
    ]


@pytest.mark.parametrize("name", ["steps", "batch_size", "scenes"])
def test_settings_are_at_least_1(name):
    with pytest.raises(InputError, match=f"`{name}` is 0, expected a whole number, 1 or more"):
        PriorConfig(**{name: 0})


# Of the last 50 of 200 steps, in the order of `PARTS`.
RECORDED = (0.890, 0.0560, 0.0473, 0.1005)


@pytest.mark.slow
def test_half_a_minute_of_training_lowers_the_loss_to_what_it_was(bank):
    """Instructions and threads change the last bits, and 200 steps some per cent."""
    state = begin()
    train(bank, PriorConfig(steps=200, batch_size=16, scenes=60), state)
    parts = np.array(state.history)
    assert (parts[-50:].mean(0) < 0.9 * parts[:50].mean(0)).all()
    np.testing.assert_allclose(parts[-50:].mean(0), RECORDED, rtol=0.1)
