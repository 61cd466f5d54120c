"""Reads the log that `tso train --log-file` writes: a line of settings, then one line per step."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError
from ..geometry.arrays import Array
from .reading import read_bytes, shown

EXPECTED = "the log of a training (.jsonl, as tso train writes it with `log_file`)"


@dataclass(frozen=True, eq=False)
class TrainingLog:
    """The log of one training."""

    path: Path
    settings: dict[str, Any]  # as in its checkpoint
    columns: dict[str, Array]  # "step", "loss" and the terms of the loss, one value per step


def read_log(path: Path) -> TrainingLog:
    """Read one log.

    Raises InputError if it cannot be read, its lines differ in form, or there is no step.
    """
    try:
        # 20,000 steps take about 2 MB.
        lines = read_bytes(path, EXPECTED, limit=1 << 28).decode("utf-8").splitlines()
    except UnicodeDecodeError:
        raise InputError(f"{path}: is not text, expected {EXPECTED}") from None
    rows = []
    for number, line in enumerate(lines, 1):
        try:
            row = json.loads(line)
        except (ValueError, RecursionError):
            raise InputError(
                f"{path}: line {number} is {shown(line)}, expected {EXPECTED}"
            ) from None
        if not isinstance(row, dict):
            raise InputError(f"{path}: line {number} is {shown(row)}, expected a JSON object")
        rows.append(row)
    settings, steps = rows[0], rows[1:]
    if "supervision" not in settings:
        raise InputError(f"{path}: line 1 has no supervision, expected the settings of a training")
    if not steps:
        raise InputError(f"{path}: has settings but no step, expected at least one")
    names = list(steps[0])
    if (
        names[:2] != ["step", "loss"]
        or len(names) > 2 + 7  # a loss has fewer terms
        or not all(name.isidentifier() and len(name) < 20 for name in names)
    ):
        raise InputError(f"{path}: line 2 has {shown(names)}, expected step, loss and so on")
    for number, row in enumerate(steps, 2):
        if list(row) != names or not all(_is_number(value) for value in row.values()):
            raise InputError(
                f"{path}: line {number} is {shown(row)}, expected numbers for {', '.join(names)}"
            )
    columns = {name: np.array([row[name] for row in steps], dtype=np.float64) for name in names}
    return TrainingLog(path, settings, columns)


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value)
