"""Training that is shared by processes, or killed: the result is what one undisturbed process gets."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from tso_cli.datasets.rendered import write_object

from ..training import make_objects

ARGUMENTS = ["--batch-size", "4", "--points", "64", "--learning-rate", "1e-4", "--averaging", "0.9", "--augment"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Boxes as `tso render` would have written them."""
    root = tmp_path_factory.mktemp("data") / "boxes"
    root.mkdir()
    for item in make_objects(3):
        views = [(image, (mask * 255).astype(np.uint8), v.camera) for v in item.views for image, mask in [v.load()]]
        assert item.target is not None
        write_object(root / item.name, views, item.target(), item.target(), {"seed": 0})
    return root


def environment() -> dict[str, str]:
    return {**os.environ, "OMP_NUM_THREADS": "1", "MASTER_ADDR": "127.0.0.1"}


def tso_train(folder: Path, output: Path, *more: str, processes: int = 1) -> subprocess.CompletedProcess[str]:
    start = [sys.executable, "-m"]
    if processes > 1:
        start += ["torch.distributed.run", "--standalone", "--nproc-per-node", str(processes), "-m"]
    command = [*start, "tso_cli", "train", str(folder), "-o", str(output), *ARGUMENTS, *more]
    return subprocess.run(command, capture_output=True, text=True, env=environment(), timeout=300, check=False)


def test_two_processes_take_the_steps_of_one(folder: Path, tmp_path: Path) -> None:
    one, two = tmp_path / "one.safetensors", tmp_path / "two.safetensors"
    alone = tso_train(folder, one, "--steps", "3", "--json")
    assert alone.returncode == 0, alone.stderr
    shared = tso_train(folder, two, "--steps", "3", "--json", "--log-file", str(tmp_path / "log.jsonl"), processes=2)
    assert shared.returncode == 0, shared.stderr
    # One document and one log: the second process is silent.
    assert json.loads(shared.stdout)["loss"] == pytest.approx(json.loads(alone.stdout)["loss"], rel=1e-4)
    assert len((tmp_path / "log.jsonl").read_text().splitlines()) == 4
    before, after = load_file(one), load_file(two)
    for name, tensor in before.items():
        # Adam's first steps go by the sign of the gradient: where that is nearly zero, rounding decides.
        close = (tensor - after[name]).abs() < 2e-5
        assert close.float().mean() > 0.99, name


def test_a_killed_training_loses_nothing_but_the_steps_since_the_last_checkpoint(folder: Path, tmp_path: Path) -> None:
    straight, killed = tmp_path / "straight.safetensors", tmp_path / "killed.safetensors"
    assert tso_train(folder, straight, "--steps", "8").returncode == 0
    more = ["--steps", "8", "--checkpoint-every", "2"]
    command = [sys.executable, "-m", "tso_cli", "train", str(folder), "-o", str(killed), *ARGUMENTS, *more]
    # What the command prints is not wanted, and a pipe that nobody reads could block it.
    with subprocess.Popen(command, env=environment(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as process:
        deadline = time.monotonic() + 120
        while not killed.exists() and process.poll() is None and time.monotonic() < deadline:
            time.sleep(0.005)
        process.send_signal(signal.SIGKILL)
    assert process.returncode == -signal.SIGKILL
    resumed = tso_train(folder, killed, *more, "--resume")
    assert resumed.returncode == 0, resumed.stderr
    assert "resuming after" in resumed.stderr
    assert straight.read_bytes() == killed.read_bytes()


def test_a_batch_that_the_processes_cannot_share_is_refused(folder: Path, tmp_path: Path) -> None:
    done = tso_train(folder, tmp_path / "x.safetensors", "--steps", "1", "--batch-size", "3", processes=2)
    assert done.returncode != 0
    assert "batch size is 3, expected a multiple of 2" in done.stderr
    assert not list(tmp_path.iterdir())


def test_the_average_of_constant_weights_is_those_weights() -> None:
    from tso_cli.train import start
    from tso_cli.train.data import TrainingData

    from ..training import config

    state = start(TrainingData(make_objects(1), "box"), config())
    for _ in range(5):
        state.history.append((0.0, 0.0, 0.0, 0.0))
        state.update_average(0.9)
    for mean, parameter in zip(state.average, state.network.parameters(), strict=True):
        torch.testing.assert_close(mean, parameter.detach())
