"""Running the command line inside the test process."""

from __future__ import annotations

from pathlib import Path

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
