"""Training that is shared by two processes gives what one process gives."""

import json
import os
import socket
import subprocess
import sys

import pytest
from safetensors.torch import load_file

# The command with few channels, as in this process.
SCRIPT = """
import sys
from tso_cli.cli import main
from tso_cli.network import model

model.CONVOLUTIONS = tuple((4, size, stride) for _, size, stride in model.CONVOLUTIONS)
main(["train", *sys.argv[1:]])
"""
OPTIONS = ("--points", "32", "--learning-rate", "1e-4", "--averaging", "0.9", "--augment")


@pytest.mark.slow
def test_two_processes_take_the_steps_of_one(tso_train, folder, tmp_path):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = str(free.getsockname()[1])
    two, log = tmp_path / "two.safetensors", tmp_path / "log.jsonl"
    options = ("--steps", 3, "--batch-size", 4, "--json")
    # As torchrun starts them.
    shared = {
        "WORLD_SIZE": "2",
        "MASTER_ADDR": "127.0.0.1",
        "MASTER_PORT": port,
        "OMP_NUM_THREADS": "1",
    }
    command = [
        sys.executable,
        "-c",
        SCRIPT,
        folder,
        "-o",
        two,
        *OPTIONS,
        *options,
        "--log-file",
        log,
    ]
    words, piped = (
        list(map(str, command)),
        dict(stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True),
    )
    environments = [os.environ | shared | {"RANK": rank, "LOCAL_RANK": rank} for rank in ("0", "1")]
    processes = [subprocess.Popen(words, env=environment, **piped) for environment in environments]
    alone = tso_train(folder, *OPTIONS, *options)
    (first, first_errors), (second, second_errors) = (
        process.communicate(timeout=120) for process in processes
    )
    assert [process.returncode for process in processes] == [0, 0], first_errors + second_errors
    assert json.loads(first)["loss"] == pytest.approx(alone.document["loss"], rel=1e-4)
    assert second == ""
    assert len(log.read_text().splitlines()) == 4
    after = load_file(two)
    for name, tensor in load_file(tmp_path / "base.safetensors").items():
        # Adam's first steps follow the sign of the gradient, which rounding decides near 0.
        assert ((tensor - after[name]).abs() < 2e-5).float().mean() > 0.99, name
