"""Training that is shared by two processes, or killed, gives what one undisturbed process gives."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from safetensors.torch import load_file

from .conftest import Run

# The command with few channels, as in this process; with a first argument above 0 it kills itself after that step.
SCRIPT = """
import os, signal, sys
from tso_cli.cli import main
from tso_cli.commands.options import ProgressBar
from tso_cli.network import model

model.CONVOLUTIONS = tuple((4, size, stride) for _, size, stride in model.CONVOLUTIONS)
show, last = ProgressBar.__call__, int(sys.argv[1])

def kill(bar, done, total, note=""):
    show(bar, done, total, note)
    if bar.label == "train" and done == last:
        os.kill(os.getpid(), signal.SIGKILL)

ProgressBar.__call__ = kill
main(["train", *sys.argv[2:]])
"""
OPTIONS = ("--points", "32", "--learning-rate", "1e-4", "--averaging", "0.9", "--augment")


def begin(last: int, folder: Path, output: Path, *options: object, **variables: str) -> subprocess.Popen[str]:
    words = [str(word) for word in (last, folder, "-o", output, *OPTIONS, *options)]
    environment = {**os.environ, "OMP_NUM_THREADS": "1", **variables}
    return subprocess.Popen(
        [sys.executable, "-c", SCRIPT, *words], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=environment
    )


def test_two_processes_take_the_steps_of_one(tso_train: Callable[..., Run], folder: Path, tmp_path: Path) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    two, log = tmp_path / "two.safetensors", tmp_path / "log.jsonl"
    options = ("--steps", 3, "--batch-size", 4, "--json")
    # As torchrun starts them.
    shared = {"WORLD_SIZE": "2", "MASTER_ADDR": "127.0.0.1", "MASTER_PORT": port}
    processes = [
        begin(0, folder, two, *options, "--log-file", log, RANK=rank, LOCAL_RANK=rank, **shared) for rank in ("0", "1")
    ]
    alone = tso_train(folder, *OPTIONS, *options)
    (first, first_errors), (second, second_errors) = (process.communicate(timeout=120) for process in processes)
    assert [process.returncode for process in processes] == [0, 0], first_errors + second_errors
    assert Run(0, first, "").document["loss"] == pytest.approx(alone.document["loss"], rel=1e-4)
    assert second == "" and len(log.read_text().splitlines()) == 4
    after = load_file(two)
    for name, tensor in load_file(tmp_path / "base.safetensors").items():
        # Adam's first steps go by the sign of the gradient: where that is nearly zero, rounding decides.
        assert ((tensor - after[name]).abs() < 2e-5).float().mean() > 0.99, name


def test_a_killed_training_resumes_from_the_last_checkpoint(
    tso_train: Callable[..., Run], folder: Path, tmp_path: Path
) -> None:
    straight, killed = tmp_path / "straight.safetensors", tmp_path / "killed.safetensors"
    options = ("--steps", 8, "--batch-size", 2, "--checkpoint-every", 2)
    process = begin(5, folder, killed, *options)
    assert tso_train(folder, *OPTIONS, *options, "-o", straight).code == 0
    process.communicate(timeout=120)
    assert process.returncode == -signal.SIGKILL
    resumed = tso_train(folder, *OPTIONS, *options, "-o", killed, "--resume")
    assert resumed.code == 0 and "resuming after 4 steps" in resumed.err
    assert straight.read_bytes() == killed.read_bytes()
