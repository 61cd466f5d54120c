"""`tso doctor`: what is here, what works, and what is missing."""

import json
import subprocess
import sys

import pytest

from tso_cli.errors import EXTRAS

BLOCKED = """
import sys
sys.modules[{module!r}] = None
from tso_cli.cli import main
main(["doctor", *sys.argv[1:]])
"""


def without(module, folder, *options):
    """`tso doctor` where ``module`` cannot be imported."""
    code = BLOCKED.format(module=module)
    return subprocess.run(
        [sys.executable, "-c", code, *options], capture_output=True, text=True, cwd=folder
    )


def test_points_mode_works_and_every_line_has_a_name(tso):
    found = tso("doctor")
    assert found.code == 0
    lines = found.out.splitlines()
    names = [line.split()[0] for line in lines]
    extras = [extra for _, extra in EXTRAS.values()]
    assert names == [
        "tso", "packages", "points", *dict.fromkeys(extras), "cores", "memory", "devices",
    ]  # fmt: skip
    assert "points   points mode works" in lines
    assert "devices  not looked for: tso doctor --imports" in lines


def test_the_json_document_has_the_same(tso):
    found = json.loads(tso("doctor", "--json").out)
    assert found["points_mode"] == {"works": True, "error": None}
    assert found["packages"]["numpy"]
    assert found["devices"] is None
    assert set(found["extras"]) == {extra for _, extra in EXTRAS.values()}


def test_a_missing_extra_is_named_with_its_command_and_points_mode_still_works(tmp_path):
    done = without("matplotlib", tmp_path)
    assert done.returncode == 0
    line = "plots    matplotlib is missing: pip install 'tso-cli[plots]'"
    assert line in done.stdout.splitlines()


def test_if_points_mode_fails_the_reason_is_said_and_the_exit_code_is_1(tmp_path):
    done = without("PIL", tmp_path)
    assert done.returncode == 1
    assert "missing  pillow: pip install pillow" in done.stdout.splitlines()
    assert "points   fails: " in done.stdout
    assert done.stderr == ""


def test_devices_are_looked_for_if_asked(tso):
    pytest.importorskip("torch")
    assert json.loads(tso("doctor", "--imports", "--json").out)["devices"][0] == "cpu"


def test_without_being_asked_neither_torch_nor_open3d_is_imported(tmp_path):
    code = "import sys\nfrom tso_cli.cli import main\ntry:\n    main(['doctor'])\nfinally:\n"
    code += "    print({'torch', 'open3d', 'matplotlib'} & {*sys.modules}, file=sys.stderr)"
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, cwd=tmp_path
    )
    assert done.stderr == "set()\n"
