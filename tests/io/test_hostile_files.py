"""Files that broke a reader when it was fuzzed, and files that no other test damages."""

import json
import time

import numpy as np
import pytest
from PIL import Image

from tests.corruption import assert_reads_or_refuses, assert_refused
from tests.fuzz import READERS, cameras, reader
from tso_cli.io.logs import read_log

from .test_clouds import a_ply

SETTINGS, STEP = {"supervision": "masks"}, {"step": 1, "loss": 0.5}
GREY = np.arange(64, dtype=np.uint8).reshape(8, 8) * 4
_K, _R, _T = [[480.0, 0, 127.5], [0, 480, 127.5], [0, 0, 1]], np.eye(3), np.array([0, 0, 2.0])
_XML = """<?xml version="1.0"?>
<opencv_storage><image_width>256</image_width><image_height>256</image_height>
<camera_matrix type_id="opencv-matrix"><rows>3</rows><cols>3</cols><dt>d</dt>
<data>480. 0. 127.5 0. 480. 127.5 0. 0. 1.</data></camera_matrix>
<rvec>0.1 0.2 0.3</rvec><tvec>0 0 2</tvec></opencv_storage>
"""
_INFO = """height: 256
width: 256
distortion_model: plumb_bob
d: [0.1, -0.2, 0.0, 0.0, 0.0]
k: [480.0, 0.0, 127.5, 0.0, 480.0, 127.5, 0.0, 0.0, 1.0]
---
"""
# Cameras that no file of tests/io/files holds.
CAMERAS = {
    "stereo.yaml": json.dumps({"M1": _K, "M2": _K, "D1": [0.1], "R": _K, "T": [0, 0, 1]}, indent=0)
    .replace('"', "").strip("{}").replace("],\n", "]\n"),
    "info.yaml": _INFO * 2,
    "opencv.xml": _XML,
    "r2n2.txt": "40 25 0 0.8 25\n130 30 0 0.7 25\n",
    "kaolin.json": {"width": 64, "height": 64, "intrinsics": {"focal_x": 80.0},
                    "extrinsics": np.eye(4).tolist()},
    "3dgs.json": [{"rotation": _R.tolist(), "position": [0, 0, -2], "fx": 80, "fy": 80,
                   "width": 64, "height": 64, "img_name": "a"}],
    "scene.gltf": {"asset": {"version": "2.0"}, "cameras": [{"perspective": {"yfov": 0.6}}],
                   "nodes": [{"children": [1]}, {"camera": 0, "rotation": [0, 0, 0, 1]}]},
    "calibration.npz": {"mtx": np.array(_K), "dist": np.ones((1, 5)) / 10,
                        "rvecs": np.ones((3, 3, 1)), "tvecs": np.ones((3, 3, 1))},
    "idr.npz": {"world_mat_0": np.array(_K) @ np.c_[_R, _T], "scale_mat_0": np.eye(4)},
    "opencv.npz": {"K": np.array(_K), "R": _R, "T": _T},
}  # fmt: skip
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


@pytest.mark.parametrize("name", CAMERAS)
def test_damaged_cameras_of_other_programs_are_read_or_refused(tmp_path, save, name):
    path, good = tmp_path / name, CAMERAS[name]
    if path.suffix == ".npz":
        np.savez(path, **good)
    else:
        save(name, good)
    assert_reads_or_refuses(cameras, path, 60)


BOMBS = {
    "aliases.yaml": "a: &a [x, x]\n"
    + "".join(f"b{i}: &b{i} [{', '.join([f'*b{i - 1}' if i else '*a'] * 9)}]\n" for i in range(20))
    + "K: *b19\n",
    "deep.yaml": "K: " + "[" * 100_000,
    "dashes.yaml": "K:\n" + "- " * 100_000,
    "questions.yaml": "K: 1\n" + "? " * 100_000,
    "long.yaml": "K: [" + "1, " * 300_000 + "1]",
    "words.yaml": "K: " + "a" * 1_000_000,
    "entities.xml": '<?xml version="1.0"?><!DOCTYPE b [<!ENTITY a "aaaaaaaaaa">'
    + "".join(f'<!ENTITY a{i} "{f"&a{i - 1};" * 10 if i else "&a;" * 10}">' for i in range(10))
    + "]><opencv_storage><K>&a9;</K></opencv_storage>",
    "deep.xml": "<opencv_storage>" + "<a>" * 200_000 + "</a>" * 200_000 + "</opencv_storage>",
    "encoding.xml": '<?xml version="1.0" encoding="utf-16"?><opencv_storage/>',
    "unknown.xml": '<?xml version="1.0" encoding="nothing"?><opencv_storage/>',
    "deep.json": '{"K": ' * 100_000,
    "scene.gltf": json.dumps(
        {"asset": {}, "cameras": [{}], "nodes": [{"children": [i + 1]} for i in range(90_000)]}
    ),
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_small_file_that_would_take_long_or_much_memory_is_refused_at_once(tmp_path, name):
    (tmp_path / name).write_text(BOMBS[name])
    before = time.monotonic()
    assert_refused(name, cameras, tmp_path / name)
    assert time.monotonic() - before < 5.0


def test_every_reader_that_can_be_fuzzed_is_there():
    assert all(callable(reader(name)[0]) for name in READERS)


@pytest.mark.parametrize("name", ["los\x7fs", "x" * 1000, "a b", ""])
def test_a_log_with_odd_names_is_refused_in_one_line(tmp_path, name):
    (tmp_path / "log.jsonl").write_text("\n".join(map(json.dumps, (SETTINGS, {**STEP, name: "x"}))))
    assert_refused("log.jsonl: line 2 has", read_log, tmp_path / "log.jsonl")
