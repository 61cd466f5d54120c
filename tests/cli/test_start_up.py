"""What a command does not use it does not import."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import tso_cli
from tso_cli.io.shipped import examples_folder

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
    environment = os.environ | {"PYTHONPATH": str(Path(tso_cli.__file__).parents[1])}
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
