"""`tso export`: half the size, the same network."""

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from tests.corruption import assert_refused
from tso_cli.io.checkpoints import load_network, read_metadata, save_network, save_tensors
from tso_cli.network.model import NetworkConfig, build_network

pytestmark = pytest.mark.usefixtures("tiny_network")
CONFIG = NetworkConfig(points=16, training_set="two chairs", settings={"views": 4})


@pytest.fixture
def base(tmp_path, tiny_network, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save_network(Path("base.safetensors"), build_network(16, seed=1), CONFIG)
    return Path("base.safetensors")


def test_the_copy_is_half_the_size_and_predicts_the_same(base, tso):
    assert "MB" in tso("export", base, "-o", "small.safetensors").out
    assert {tensor.dtype for tensor in load_file("small.safetensors").values()} == {torch.float16}
    weights = sum(tensor.nbytes for tensor in load_file(base).values())
    assert base.stat().st_size - Path("small.safetensors").stat().st_size > 0.45 * weights
    (first, about), (second, kept) = load_network(base), load_network(Path("small.safetensors"))
    assert kept == about
    image = torch.rand(1, 3, 64, 64)
    torch.testing.assert_close(second(image), first(image), atol=2e-3, rtol=0.0)
    assert not torch.equal(second(image), first(image))


def test_the_largest_change_is_that_of_the_examples_points(base, tso):
    from tso_cli.io.shipped import CATEGORIES, examples_folder
    from tso_cli.scene.network import load_network_scene

    document = tso("export", base, "-o", "small.safetensors", "--json").document
    changes = []
    for folder in (examples_folder() / name for name in CATEGORIES):
        first, second = (
            load_network_scene(folder / "image.png", folder / "mask.png", Path(path)).points
            for path in ("base.safetensors", "small.safetensors")
        )
        changes += np.linalg.norm(first - second, axis=1).tolist()
    assert document["largest_change"] == pytest.approx(max(changes))
    assert 0.0 < document["largest_change"] < 5e-3
    assert document["bytes_after"] == Path("small.safetensors").stat().st_size


def test_the_state_of_a_training_is_left_behind(base, tso):
    network, _ = load_network(base)
    tensors = {**network.state_dict(), "training.moment": torch.ones(3)}
    save_tensors(Path("unfinished.safetensors"), tensors, CONFIG, {"step": 7})
    assert tso("export", "unfinished.safetensors", "-o", "small.safetensors").code == 0
    assert set(load_file("small.safetensors")) == set(network.state_dict())
    assert read_metadata(Path("small.safetensors"))[1] == {}


def test_a_weight_too_large_for_half_precision_is_named_and_nothing_is_written(base):
    network, _ = load_network(base)
    with torch.no_grad():
        network.decoder.layers[0].weight[0, 0] = 1e6
    assert_refused(
        "decoder.layers.0.weight",
        save_network,
        "small.safetensors",
        network,
        CONFIG,
        dtype=torch.float16,
    )
    assert not Path("small.safetensors").exists()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ("base.safetensors -o taken.safetensors", "taken.safetensors exists"),
        ("base.safetensors -o base.safetensors --overwrite", "base.safetensors input"),
        ("base.safetensors -o small.pt", "small.pt .safetensors"),
        ("nowhere.safetensors -o small.safetensors", "nowhere.safetensors exist"),
    ],
)
def test_what_cannot_be_exported_gets_one_line_and_changes_no_file(arguments, words, base, tso):
    shutil.copy(base, "taken.safetensors")
    before = {path: path.read_bytes() for path in Path().iterdir()}
    message = tso("export", *arguments.split()).refusal
    assert all(word in message for word in words.split())
    assert {path: path.read_bytes() for path in Path().iterdir()} == before
