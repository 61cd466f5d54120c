"""What several rooms share: the command line in this process, the chair example, a random cloud."""

import json
import shutil
import signal
from typing import NamedTuple

import numpy as np
import pytest

from tso_cli.cli import main

from .scenes import EXAMPLES, example

# A shell without job control lets what runs in its background ignore Ctrl-C, which tests need.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)


class Run(NamedTuple):
    """The exit code of a command, and what it printed."""

    code: int
    out: str
    err: str

    @property
    def document(self):
        """The JSON document of a command that did its work."""
        assert self.code == 0, self.err
        return json.loads(self.out)

    @property
    def refusal(self):
        """The one line of a command that refused its input."""
        (line,) = [line for line in self.err.splitlines() if not line.startswith("tso: warning: ")]
        assert (self.code, self.out) == (2, "")
        assert line.startswith("tso: error: ")
        return line


@pytest.fixture
def tso(capsys):
    """Run `tso ARGUMENTS`."""

    def run(*arguments):
        with pytest.raises(SystemExit) as stopped:
            main([str(argument) for argument in arguments])
        return Run(stopped.value.code, *capsys.readouterr())

    return run


@pytest.fixture
def refine(tso):
    return lambda *arguments: tso("refine", *arguments)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """The working directory: a copy of the chair example."""
    for name in ("initial.ply", "mask.png", "image.png", "camera.json", "target.ply"):
        shutil.copy(EXAMPLES / "chair" / name, tmp_path / name)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def tiny_network(monkeypatch):
    """The same layers with few channels: files of kilobytes instead of 25 MB."""
    from tso_cli.network import model

    monkeypatch.setattr(
        model, "CONVOLUTIONS", tuple((2, size, stride) for _, size, stride in model.CONVOLUTIONS)
    )
    monkeypatch.setattr(model, "LATENT", 4)


@pytest.fixture(scope="session")
def chair():
    return example("chair")


@pytest.fixture(scope="session")
def cloud():
    return np.random.default_rng(0).uniform(-0.25, 0.25, (500, 3))
