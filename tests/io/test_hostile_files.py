"""Files that broke a reader when it was fuzzed, and files that no other test damages."""

import json

import numpy as np
import pytest
from PIL import Image

from tests.corruption import assert_reads_or_refuses, assert_refused
from tests.fuzz import READERS, reader
from tso_cli.io.logs import read_log

from .test_clouds import a_ply

SETTINGS, STEP = {"supervision": "masks"}, {"step": 1, "loss": 0.5}
GREY = np.arange(64, dtype=np.uint8).reshape(8, 8) * 4
GOOD = {
    "faces": a_ply("binary_little_endian"),
    "state": b"\x08" + b"\0" * 7 + b'{"a":{}}',
    "log": "\n".join(map(json.dumps, (SETTINGS, STEP, {**STEP, "step": 2}))),
    "split": {
        "train": ["chair/a", "chair/b"],
        "validation": ["car/a"],
        "test": ["chair/c", "car/b"],
    },
    "record": {
        "summary": {"mean_ratio": 0.25, "worst_ratio": 1.5},
        "claims": [{"claim": "it is exact", "holds": True}],
    },
    "depth.npy": np.eye(3),
    "depth": GREY,
    "mask.webp": GREY,
}


@pytest.mark.parametrize("name", GOOD)
def test_damaged_files_of_other_kinds_are_read_or_refused(tmp_path, save, name):
    read, suffix = reader(name)
    path, good = tmp_path / f"good{suffix}", GOOD[name]
    if good is GREY:
        Image.fromarray(good).save(path)
    else:
        save(path.name, good)
    assert_reads_or_refuses(read, path, 40)


def test_every_reader_that_can_be_fuzzed_is_there():
    assert all(callable(reader(name)[0]) for name in READERS)


@pytest.mark.parametrize("name", ["los\x7fs", "x" * 1000, "a b", ""])
def test_a_log_with_odd_names_is_refused_in_one_line(tmp_path, name):
    (tmp_path / "log.jsonl").write_text("\n".join(map(json.dumps, (SETTINGS, {**STEP, name: "x"}))))
    assert_refused("log.jsonl: line 2 has", read_log, tmp_path / "log.jsonl")
