"""Types of the public names, as a user's type checker sees them."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import tso_cli

ROOT = Path(tso_cli.__file__).parents[1]
USER = Path(__file__).with_name("user.py")


def checked(source, tmp_path):
    pytest.importorskip("mypy")
    options = ["--strict", "--follow-imports=silent", "--config-file=", "--no-error-summary"]
    return subprocess.run(
        [
            sys.executable,
            "-m",
            "mypy",
            *options,
            f"--cache-dir={ROOT / '.mypy_cache/user'}",
            source,
        ],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        # mypy finds an installed package by itself, and refuses its folder here.
        env=os.environ | ({} if ROOT.name == "site-packages" else {"MYPYPATH": str(ROOT)}),
    )


def test_the_package_says_that_it_has_types():
    assert (Path(tso_cli.__file__).parent / "py.typed").exists()


@pytest.mark.slow
def test_a_script_with_the_public_names_passes_the_strict_type_checker(tmp_path):
    done = checked(USER, tmp_path)
    assert done.stdout == ""
    assert done.returncode == 0


@pytest.mark.slow
def test_a_preset_that_does_not_exist_fails_in_the_type_checker(tmp_path):
    (tmp_path / "wrong.py").write_text(
        'from tso_cli import RefineConfig\nRefineConfig(preset="bset", mode="pionts")\n'
    )
    done = checked(tmp_path / "wrong.py", tmp_path)
    assert done.stdout.count("[arg-type]") == 2


def test_every_public_name_is_used_in_the_checked_script():
    text = USER.read_text()
    # Errors and results that the script meets without naming them.
    unnamed = {"Chamfer", "FScore", "FittedCamera", "GateError", "Interrupted", "PointCloud"}
    assert {name for name in tso_cli.__all__ if name not in text} <= unnamed
