"""`tso bench speed`: what it writes, prints and refuses."""

from __future__ import annotations

import json
import math

import pytest
import torch
from PIL import Image

from tests.lab.benching import assert_schema
from tso_cli.cli import main
from tso_cli.errors import InputError
from tso_cli.lab.bench import speed
from tso_cli.lab.bench.timing import Setting
from tso_cli.lab.commands.bench import PARTS


def _run(arguments):
    with pytest.raises(SystemExit) as stopped:
        main(["bench", "speed", *arguments])
    return stopped.value.code


def test_the_command_names_the_parts_there_are():
    assert set(PARTS) == set(speed.PARTS)


def test_the_command_writes_record_and_chart_and_overwrites_nothing(tmp_path, capsys):
    output = tmp_path / "speed.json"
    arguments = ["--only", "limit", "--seconds", "0.001", "-o", str(output)]
    assert _run(arguments) == 0
    assert "multiply-add" in capsys.readouterr().out
    record = json.loads(output.read_text())
    assert set(record) >= {"bench", "machine", "versions", "threads", "device", "seed", "seconds", "records"}
    assert record["bench"] == "speed"
    assert math.isfinite(record["seconds"])
    assert_schema(record["records"])
    with Image.open(output.with_suffix(".png")) as chart:
        assert chart.size[0] > 600
    before = output.read_bytes()
    assert _run(arguments) == 2
    error = capsys.readouterr().err
    assert "exists" in error
    assert output.read_bytes() == before
    output.unlink()
    assert _run(arguments) == 2
    assert not output.exists()


def test_with_json_one_document_is_printed(capsys):
    assert _run(["--only", "limit", "--seconds", "0.001", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["bench"] == "speed"


@pytest.mark.parametrize(
    "arguments",
    [
        ["--only", "nothing"],
        ["--seconds", "0"],
        ["--threads", "0"],
        ["--threads", "1000000"],
        ["--seconds", "nan"],
        ["--seconds", "inf"],
        ["-o", "speed.txt"],
    ],
)
def test_what_cannot_be_measured_gets_one_line(arguments, capsys):
    assert _run(arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("tso: error:")
    assert error.count("\n") == 1
    assert arguments[-1] in error or arguments[0] in error


def test_a_device_that_is_not_measured_is_refused():
    with pytest.raises(InputError, match="cpu or cuda"):
        speed.speed(Setting(torch.device("mps"), budget=1e-3), ["limit"])
