"""Running the command line inside the test process."""

import json
from pathlib import Path
from typing import NamedTuple

import pytest

from tso_cli.cli import main

CHAIR = Path(__file__).parents[2] / "examples" / "chair"


def tso(*arguments):
    """The exit code of `tso ARGUMENTS`."""
    with pytest.raises(SystemExit) as stopped:
        main([str(argument) for argument in arguments])
    return stopped.value.code


def errors(capsys):
    """The lines of stderr that are no warnings."""
    return [line for line in capsys.readouterr().err.splitlines() if "warning" not in line]


class Run(NamedTuple):
    """The end of a command, and what it printed."""

    code: int
    out: str
    err: str

    @property
    def document(self):
        return json.loads(self.out)


def run(capsys, *arguments):
    return Run(tso(*arguments), *capsys.readouterr())
