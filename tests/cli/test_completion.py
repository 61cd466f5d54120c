"""What TAB offers in a shell, and that it waits for no numbers."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import tso_cli
from tso_cli.cli import SECTIONS

PROGRAM = """
import atexit, sys
atexit.register(lambda: print("", *sys.modules, sep="\\n", file=sys.stderr))
from tso_cli.__main__ import main
main()
"""
# `tso batch` imports what its items need.
COMMANDS = [name for names in SECTIONS.values() for name in names if name != "batch"]


def completed(words, folder):
    """What is offered for the last of ``words``, and the modules that were imported for it."""
    asked = {
        "_TSO_COMPLETE": "bash_complete",
        "COMP_WORDS": " ".join(words),
        "COMP_CWORD": str(len(words) - 1),
        "PYTHONPATH": str(Path(tso_cli.__file__).parents[1]),
    }
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM],
        capture_output=True,
        text=True,
        cwd=folder,
        env=os.environ | asked,
    )
    return [line.partition(",")[2] for line in done.stdout.splitlines()], done.stderr.splitlines()


def test_the_beginning_of_an_option_is_completed(tmp_path):
    offered, modules = completed(["tso", "refine", "--pre"], tmp_path)
    assert offered == ["--preset"]
    assert "tso_cli.commands.refine.command" in modules
    assert not {"numpy", "torch"} & set(modules)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["tso", "refine", "--preset", ""], ["best", "paper"]),
        (["tso", "refine", "--mode", "enc"], ["encoder", "encoder-decoder"]),
        (["tso", "convert", "--to", "c"], ["colmap"]),
        (["tso", "re"], ["refine", "render"]),
        (["tso", "lab", "spe"], ["speed"]),
    ],
    ids=" ".join,
)
def test_values_and_commands_are_completed(tmp_path, words, expected):
    offered, modules = completed(words, tmp_path)
    assert offered == expected
    assert not {"numpy", "torch"} & set(modules)


@pytest.mark.parametrize("name", COMMANDS)
def test_the_options_of_a_command_are_offered_without_numpy(tmp_path, name):
    offered, modules = completed(["tso", name, "--"], tmp_path)
    assert "--help" in offered
    assert not {"numpy", "torch"} & set(modules)


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_script_of_each_shell_is_printed(tmp_path, shell):
    done = subprocess.run(
        [sys.executable, "-m", "tso_cli"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env=os.environ
        | {
            "_TSO_COMPLETE": f"{shell}_source",
            "PYTHONPATH": str(Path(tso_cli.__file__).parents[1]),
        },
    )
    if "Bash is not supported" in done.stderr or "Couldn't detect Bash" in done.stderr:
        pytest.skip("no bash here")
    assert f"_TSO_COMPLETE={shell}_complete" in done.stdout
