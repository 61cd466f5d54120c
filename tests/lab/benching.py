"""What the tests of the measurement of speed share."""

from __future__ import annotations

import json

from tso_cli.lab.bench.timing import Setting

FIELDS = {"what", "name", "points", "side", "batch", "device", "threads", "seconds", "runs", "peak_memory_bytes"}
QUICK = Setting(budget=1e-4)
RATES = {"multiply-add": 1e9, "load, multiply-add, store": 5e8}


def assert_schema(records) -> None:
    """Every record is flat, whole and can be written; what was left out says why."""
    assert records
    for record in records:
        assert set(record) >= FIELDS
        json.dumps(record)
        if record["seconds"] is None:
            assert record["left_out"]
            assert record["runs"] == 0
        else:
            assert record["seconds"]["median"] > 0.0
