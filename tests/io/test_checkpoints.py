"""Checkpoints come back as they were written; anything else is refused in one line."""

import dataclasses
import json
import os
import pickle

import pytest
import torch
from safetensors.torch import load_file, save_file

from tests.corruption import assert_reads_or_refuses
from tso_cli.errors import InputError
from tso_cli.io.checkpoints import FORMAT, load_network, save_network, save_tensors
from tso_cli.network.model import NetworkConfig, build_network

pytestmark = pytest.mark.usefixtures("tiny_network")
CONFIG = NetworkConfig(
    points=4, training_set="two chairs", sigma_sq=0.1, frame="canonical", settings={"views": 4}
)


@pytest.fixture
def checkpoint(tmp_path, tiny_network):
    path = tmp_path / "base.safetensors"
    save_network(path, build_network(4, seed=1), CONFIG)
    return path


def rewrite(path, tensors=None, **changes):
    """The checkpoint again, with other tensors or configuration values (None leaves a key out)."""
    config = {**dataclasses.asdict(CONFIG), **changes}
    config = {name: value for name, value in config.items() if value is not None}
    save_file(
        tensors or load_file(path), path, {"tso": json.dumps({"format": FORMAT, "config": config})}
    )
    return path


def refusal(path):
    with pytest.raises(InputError) as caught:
        load_network(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    assert len(message) < 400 + len(str(path))
    return message


def test_network_and_configuration_come_back_as_they_were_saved_in_memory_as_torch_lays_it_out(
    checkpoint,
):
    network, config = load_network(checkpoint)
    assert config == CONFIG
    assert not network.training
    for name, tensor in build_network(4, seed=1).state_dict().items():
        assert torch.equal(tensor, network.state_dict()[name]), name
    for parameter in network.parameters():
        assert parameter.data_ptr() % 64 == 0
        assert parameter.requires_grad


@pytest.mark.parametrize("dtype", [torch.bfloat16, torch.float64])
def test_weights_become_float32_whatever_the_file_stores(checkpoint, dtype):
    stored = {name: tensor.to(dtype) for name, tensor in load_file(checkpoint).items()}
    network, _ = load_network(rewrite(checkpoint, stored))
    for name, tensor in network.state_dict().items():
        torch.testing.assert_close(tensor, stored[name].to(torch.float32), rtol=0.0, atol=0.0)


def test_training_state_beside_the_network_is_ignored_by_a_reader_of_networks(tmp_path):
    network = build_network(4, seed=1)
    tensors = {**network.state_dict(), "training.moment": torch.zeros(3)}
    save_tensors(tmp_path / "a.safetensors", tensors, CONFIG, {"step": 3})
    assert load_network(tmp_path / "a.safetensors")[1] == CONFIG


def test_the_same_network_gives_the_same_bytes(tmp_path):
    paths = [tmp_path / f"{number}.safetensors" for number in range(4)]
    for path in paths:
        save_tensors(path, build_network(4, seed=1).state_dict(), CONFIG, {"step": 3})
    assert len({path.read_bytes() for path in paths}) == 1


class Dangerous:
    def __reduce__(self):
        return os.mkdir, ("was_run",)


@pytest.mark.parametrize("kind", [2, 5, "zip", "legacy"])
def test_a_pickle_is_refused_without_being_run(tmp_path, kind, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "base.pth"
    if isinstance(kind, int):
        path.write_bytes(pickle.dumps(Dangerous(), protocol=kind))
    else:
        torch.save({"weight": Dangerous()}, path, _use_new_zipfile_serialization=kind == "zip")
    assert "is a pickled PyTorch file; loading it could run code; expected safetensors" in refusal(
        path
    )
    assert not (tmp_path / "was_run").exists()
    path.write_text("ply\nformat ascii 1.0\n")
    assert "not a safetensors file" in refusal(path)


def test_a_header_whose_length_begins_like_a_pickle_is_still_safetensors(checkpoint):
    raw = checkpoint.read_bytes()
    length = int.from_bytes(raw[:8], "little")
    wanted = next(
        size
        for size in range(length, length + 70_000, 8)
        if size & 0xFFFF in (0x0280, 0x0380, 0x0480, 0x0580)
    )
    header = raw[8 : 8 + length].ljust(wanted)
    checkpoint.write_bytes(wanted.to_bytes(8, "little") + header + raw[8 + length :])
    assert checkpoint.read_bytes()[0] == 0x80
    load_network(checkpoint)


def test_a_truncated_file_is_refused(checkpoint):
    for kept in (-1, 300, 9, 4):
        checkpoint.write_bytes(checkpoint.read_bytes()[:kept])
        refusal(checkpoint)


def test_a_configuration_of_another_or_a_huge_network_is_refused_and_takes_no_memory(checkpoint):
    message = "decoder.layers.4.weight has shape [12, 256], expected [{}, 256]"
    assert message.format(15) in refusal(rewrite(checkpoint, points=5))
    assert message.format(3_000_000) in refusal(rewrite(checkpoint, points=1_000_000))
    assert "points in the configuration is 1000000000" in refusal(rewrite(checkpoint, points=10**9))


def test_missing_and_unknown_tensors_are_refused(checkpoint):
    tensors, name = load_file(checkpoint), "encoder.latent.weight"
    more = {**tensors, "encoder.attention": torch.zeros(2)}
    assert "has the unknown tensor 'encoder.attention' of shape [2]" in refusal(
        rewrite(checkpoint, more)
    )
    del tensors[name]
    assert f"tensor {name} is missing, expected shape [4, 32]" in refusal(
        rewrite(checkpoint, tensors)
    )


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ([0.0, float("nan"), 0.0, 1.0], "holds 1 numbers that are not finite"),
        ([0, 0, 0, 1], "holds torch.int64, expected floating-point numbers"),
        ([0.0, 0.0], "has shape [2], expected [4]"),
    ],
)
def test_weights_that_do_not_fit_are_refused(checkpoint, values, message):
    tensors = {**load_file(checkpoint), "encoder.latent.bias": torch.tensor(values)}
    assert f"encoder.latent.bias {message}" in refusal(rewrite(checkpoint, tensors))


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("points", 0), ("points", "many"), ("points", True),
        ("image_size", 128), ("frame", ["view"]), ("seed", 0.5),
        ("sigma_sq", 0.0), ("sigma_sq", float("nan")), ("crop_share", 1.5),
        ("training_set", 3), ("settings", []),
    ],
)  # fmt: skip
def test_impossible_configuration_values_are_refused(checkpoint, name, value):
    assert f"{name} in the configuration is" in refusal(rewrite(checkpoint, **{name: value}))


def test_a_missing_or_unreadable_configuration_is_refused(checkpoint):
    assert "lacks 'frame'" in refusal(rewrite(checkpoint, frame=None))
    assert "unknown 'colour'" in refusal(rewrite(checkpoint, colour=1))
    tensors = load_file(checkpoint)
    broken = ["{", "3", "[" * 9999, "null", '{"format": 1}', json.dumps({"format": FORMAT})]
    broken.append(json.dumps({"format": FORMAT, "config": 3}))
    for metadata in (None, {"format": "pt"}, *({"tso": text} for text in broken)):
        save_file(tensors, checkpoint, metadata)
        refusal(checkpoint)


def test_any_damage_is_refused_in_one_line_or_leaves_a_usable_network(checkpoint):
    def read(path):
        network, config = load_network(path)
        assert config.points == 4
        assert all(torch.isfinite(parameter).all() for parameter in network.parameters())

    was_read, refused = assert_reads_or_refuses(read, checkpoint, count=30)
    assert was_read
    assert refused > 12
