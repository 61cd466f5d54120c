"""What a command does not use it does not import, and how long commands take is measured as whole processes."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from tso_cli.errors import TsoError
from tso_cli.io.shipped import examples_folder
from tso_cli.lab.bench import start_up as measured
from tso_cli.lab.bench.start_up import start_up

# Each takes a tenth of a second or more to import (with what it brings along), in a command that takes little over one.
HEAVY = (
    "numba",
    "scipy",
    "matplotlib",
    "skimage",
    "trimesh",
    "open3d",
    "sympy",
    "numpy.f2py",
    "torch._dynamo",
    "torch._inductor",
)
CHAIR = examples_folder() / "chair"


def _imported(folder, *arguments: str) -> set[str]:
    """Names of all modules that `tso ARGUMENTS` has imported when it ends."""
    code = (
        "import sys\nfrom tso_cli.cli import main\n"
        f"try:\n    main({list(arguments)!r})\n"
        "except SystemExit as end:\n    print('', *sys.modules, sep='\\n')\n    raise"
    )
    environment = os.environ | {"PYTHONPATH": str(measured.PACKAGE.parent)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=folder, env=environment)
    assert done.returncode == 0, done.stderr
    return set(done.stdout.split())


@pytest.mark.parametrize("picture", [(), ("--overlay", "chair.png")])
def test_refining_points_imports_nothing_heavy_but_torch(tmp_path, picture):
    found = _imported(tmp_path, "refine", "--mode", "points", str(CHAIR / "initial.ply"), str(CHAIR / "mask.png"), *picture)
    assert {"torch", "tso_cli.refinement.api", "PIL.Image"} <= found
    assert not found & set(HEAVY)


@pytest.mark.parametrize("argument", ["--version", "--help"])
def test_version_and_help_import_no_numbers(tmp_path, argument):
    found = _imported(tmp_path, argument)
    assert "tso_cli.cli" in found
    assert not found & {"torch", "numpy", "PIL", *HEAVY}


@pytest.mark.parametrize("command", ["refine", "eval", "train", "curves", "export", "render", "compile", "bench", "lab"])
def test_the_help_of_a_command_imports_no_torch(tmp_path, command):
    assert not _imported(tmp_path, command, "--help") & {"torch", *HEAVY}


def test_start_up_measures_bare_python_torch_and_commands_warm_and_first(tmp_path):
    names = {"python", "import torch", "tso --version", "tso --help", "tso refine --mode points"}
    assert names | {"tso refine --mode points, first", "tso refine --mode points, bare"} <= set(measured._commands(tmp_path))


def test_each_command_line_gives_one_record(monkeypatch, tmp_path):
    commands = measured._commands(tmp_path)
    chosen = {name: commands[name] for name in ("python", "tso --version", "tso refine --mode points, first")}
    monkeypatch.setattr(measured, "_commands", lambda folder: chosen)
    records = start_up(repeats=1)
    assert [record["name"] for record in records] == list(chosen)
    for record in records:
        assert set(record) == {"what", "name", "seconds", "runs"}
        assert (record["what"], record["runs"]) == ("start-up", 1)
        seconds = record["seconds"]
        assert 0.0 < seconds["low"] <= seconds["median"] <= seconds["high"]


def test_a_first_run_finds_no_byte_code(tmp_path):
    environment = measured._first(tmp_path)
    copied = list((tmp_path / "fresh").rglob("*"))
    assert environment["PYTHONPATH"] == str(tmp_path / "fresh")
    assert tmp_path / "fresh" / "tso_cli" / "cli.py" in copied
    assert not [path for path in copied if path.suffix == ".pyc"]


def test_a_command_that_fails_is_not_timed():
    with pytest.raises(TsoError, match=r"wrong: ended with exit code 2, saying .*No such command"):
        measured._run("wrong", (*measured.TSO, "nothing"), measured._first)
