"""Files that fuzzing found to break a reader, and files of every kind with random damage: read, or refused in one line."""

import io
import json
import struct

import numpy as np
import pytest
import trimesh
from PIL import Image

from tests.corruption import assert_reads_or_refuses, assert_refused
from tests.fuzz import READERS, reader
from tso_cli.io.logs import read_log

from .test_clouds import a_ply

SETTINGS, STEP = {"supervision": "masks"}, {"step": 1, "loss": 0.5}
CORNERS = "".join(f"v {corner}\n" for corner in ("0 0 0", "1 0 0", "0 1 0"))
STL = b"\0" * 80 + struct.pack("<I12fH", 1, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0)
CAMERA = {"width": 8, "height": 8, "K": [[9, 0, 4], [0, 9, 4], [0, 0, 1]], "R": np.eye(3).tolist(), "t": [0, 0, 2]}


def array(values):
    stream = io.BytesIO()
    np.save(stream, values)
    return stream.getvalue()


def picture(form):
    stream = io.BytesIO()
    Image.fromarray(np.arange(64, dtype=np.uint8).reshape(8, 8) * 4).save(stream, form)
    return stream.getvalue()


GOOD = {
    ".ply": a_ply("binary_little_endian"),
    ".xyz": b"# a\n0 0 0 1\n1 2 3 4\n",
    ".obj": (CORNERS + "f 1 2 3\n").encode(),
    ".off": b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n",
    ".stl": STL,
    ".glb": trimesh.Trimesh(np.eye(3), [[0, 1, 2]], process=False).export(file_type="glb"),
    ".binvox": b"#binvox 1\ndim 4 4 4\ntranslate 0 0 0\nscale 1\ndata\n" + bytes([0, 20, 1, 10, 0, 34]),
    ".json": json.dumps(CAMERA).encode(),
    ".jsonl": "\n".join(map(json.dumps, (SETTINGS, STEP, {**STEP, "step": 2}))).encode(),
    **{suffix: picture(form) for suffix, form in ((".png", "PNG"), (".tif", "TIFF"), (".jpg", "JPEG"), (".gif", "GIF"))},
    **{suffix: picture(form) for suffix, form in ((".webp", "WEBP"), (".bmp", "BMP"))},
}


@pytest.mark.parametrize("name", sorted(READERS))
def test_every_reader_reads_or_refuses_damaged_files(tmp_path, name):
    read, suffix = reader(name)
    kinds = {".npy": array(np.eye(3)), ".safetensors": b"\x08" + b"\0" * 7 + b'{"a":{}}', **GOOD}
    path = tmp_path / f"good{suffix}"
    path.write_bytes(array(np.ones((3, 3, 3))) if name == "grid.npy" else kinds[suffix])
    assert_reads_or_refuses(read, path, 40)


@pytest.mark.parametrize("name", ["los\x7fs", "x" * 1000, "a b", ""])
def test_a_log_with_odd_names_is_refused_in_one_line(tmp_path, name):
    (tmp_path / "log.jsonl").write_text("\n".join(map(json.dumps, (SETTINGS, {**STEP, name: "x"}))))
    assert_refused("log.jsonl: line 2 has", read_log, tmp_path / "log.jsonl")
