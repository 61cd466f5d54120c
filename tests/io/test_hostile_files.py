"""Files that broke a reader when it was fuzzed, and files that no other test damages."""

import base64
import io
import json
import os
import pickle
import struct
import time
import tracemalloc

import numpy as np
import pytest
import torch
from PIL import Image

from tests.corruption import assert_reads_or_refuses, assert_refused
from tests.fuzz import READERS, reader
from tso_cli.errors import InputError
from tso_cli.io.clouds import read_cloud
from tso_cli.io.logs import read_log
from tso_cli.io.masks import read_mask
from tso_cli.io.meshes import new_mesh

from .test_clouds import a_ply
from .test_mesh_files import OBJ, parts_of, tables

SETTINGS, STEP = {"supervision": "masks"}, {"step": 1, "loss": 0.5}
GREY = np.arange(64, dtype=np.uint8).reshape(8, 8) * 4
POINTS = np.random.default_rng(0).normal(size=(8, 3)).astype("f4").astype(float)
FACES = np.array([[0, 1, 2], [2, 3, 4], [4, 5, 6], [6, 7, 0]])
INSIDE = np.zeros((12, 16), bool)
INSIDE[3:8, 4:11] = True
LABELS = INSIDE + 2 * INSIDE[::-1, ::-1].astype(np.uint8)
RUNS = {"size": [4, 4], "counts": [5, 3, 8]}


def an_npz(**arrays):
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def a_pt(content):
    stream = io.BytesIO()
    torch.save(content, stream)
    return stream.getvalue()


def a_gltf(**changes):
    document, binary = parts_of(new_mesh(".glb", POINTS, FACES))
    uri = f"data:application/octet-stream;base64,{base64.b64encode(binary).decode()}"
    document["buffers"][0]["uri"] = uri
    return json.dumps(document | changes).encode()


TABLES = tables()[1]
GOOD = {
    "cloud.npz": an_npz(points=POINTS, faces=FACES),
    "cloud.pt": a_pt({"verts": torch.from_numpy(POINTS), "faces": torch.from_numpy(FACES)}),
    "cloud.txt": TABLES["c.pts"][2:],
    "cloud.csv": TABLES["a.csv"],
    "cloud.pts": TABLES["c.pts"],
    "cloud.pcd": TABLES["d.pcd"],
    "cloud.binary.pcd": TABLES["e.pcd"],
    "cloud.glb": new_mesh(".glb", POINTS, FACES),
    "cloud.gltf": a_gltf(),
    "cloud.obj": OBJ,
    "cloud.off": new_mesh(".off", POINTS, FACES),
    "cloud.binary.stl": new_mesh(".stl", POINTS, FACES),
    "cloud.stl": b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\n"
    b"vertex 0 1 0\nendloop\nendfacet\nendsolid a\n",
    "mask.npy": INSIDE.astype("f4"),
    "mask.npz": an_npz(mask=INSIDE),
    "mask.sam.npz": an_npz(masks=INSIDE[None], scores=np.float32([0.5]), boxes=np.eye(4)),
    "mask.pt": a_pt(torch.from_numpy(INSIDE[None, None])),
    "mask.json": RUNS,
    "mask.coco.json": {
        "images": [{"id": 1, "height": 12, "width": 16}, {"id": 2, "height": 4, "width": 4}],
        "annotations": [
            {"image_id": 1, "segmentation": [[2, 2, 9, 2, 9, 8]], "area": 21},
            {"image_id": 2, "segmentation": RUNS},
        ],
    },
    "mask.label.png": LABELS,
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
    if good is GREY or good is LABELS:
        Image.fromarray(good).save(path)
    else:
        save(path.name, good)
    assert_reads_or_refuses(read, path, 40)


def test_every_reader_that_can_be_fuzzed_is_there():
    assert all(callable(reader(name)[0]) for name in READERS)


PCD = "FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nPOINTS {}\nDATA {}\n"
HUGE = 10**15
LIES = {
    "a.glb": struct.pack("<4sIII4s", b"glTF", 2, 2**32 - 1, 2**32 - 1, b"JSON") + b"{}",
    "b.gltf": a_gltf(bufferViews=[{"buffer": 0, "byteLength": HUGE}] * 2),
    "c.gltf": a_gltf(buffers=[{"byteLength": HUGE, "uri": "data:;base64,AAAA"}]),
    "d.gltf": a_gltf(
        accessors=[{"bufferView": 0, "componentType": 5126, "type": "VEC3", "count": HUGE}] * 2
    ),
    "e.off": f"OFF\n{HUGE} {HUGE} 0\n0 0 0\n",
    "f.stl": bytes(80) + struct.pack("<I", 2**32 - 1) + bytes(100),
    "g.pcd": PCD.format(HUGE, "ascii") + "1 2 3\n4 5 6\n",
    "h.pcd": PCD.format(HUGE, "binary") + "1" * 24,
    "i.pts": f"{HUGE}\n1 2 3\n4 5 6\n",
    "j.obj": f"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 {HUGE}\n",
    "k.csv": "x,y,z\n1,2," + "9" * 200_000,
    "l.npz": an_npz(points=np.zeros((3, 3))).replace(b"(3, 3)", b"(3" + b"0, 3)"),
    "m.json": {"size": [10**6, 10**6], "counts": [10**12]},
    "n.json": {"segmentation": [[0, 0, 9, 0, 9, 9]], "height": 10**9, "width": 10**9},
    "o.json": {"size": [4, 4], "counts": [HUGE, HUGE]},
}


@pytest.mark.parametrize("name", LIES)
def test_a_count_that_lies_costs_neither_time_nor_memory(save, name):
    path = save(name, LIES[name])
    read = read_mask if name.endswith(".json") else read_cloud
    with pytest.raises(InputError):
        read(save(name, LIES[name]))  # what is imported is not counted
    tracemalloc.start()
    start = time.process_time()
    assert_refused(name, read, path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 2**26
    assert time.process_time() - start < 3.0


@pytest.mark.parametrize("name", ["cloud.npz", "cloud.pt", "mask.npz"])
def test_an_archive_of_a_later_version_of_zip_is_refused(save, name):
    read, suffix = reader(name)
    data = bytearray(GOOD[name])
    data[data.index(b"PK\x01\x02") + 6] = 160
    assert_refused("is a damaged archive", read, save(f"a{suffix}", bytes(data)))


class Marker:
    """Unpickled, it makes a file."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (str(self.path),)


@pytest.mark.parametrize("name", ["a.npy", "a.npz", "a.pt", "old.pt", "bare.npy", "bare.pt"])
@pytest.mark.parametrize("read", [read_cloud, read_mask])
def test_no_code_in_a_file_runs(save, tmp_path, name, read):
    marker = Marker(tmp_path / "marker")
    objects = np.array([marker, marker, marker], dtype=object)
    if name == "a.npy":
        path = save(name, objects)
    elif name == "a.npz":
        path = save(name, an_npz(points=objects, mask=objects))
    elif name.startswith("bare"):
        path = save(name, pickle.dumps(marker))
    else:
        path = tmp_path / name
        torch.save(
            {"points": marker}, path, _use_new_zipfile_serialization=not name.startswith("old")
        )
    with pytest.raises(InputError):
        read(path)
    assert not marker.path.exists()


@pytest.mark.parametrize("name", ["los\x7fs", "x" * 1000, "a b", ""])
def test_a_log_with_odd_names_is_refused_in_one_line(tmp_path, name):
    (tmp_path / "log.jsonl").write_text("\n".join(map(json.dumps, (SETTINGS, {**STEP, name: "x"}))))
    assert_refused("log.jsonl: line 2 has", read_log, tmp_path / "log.jsonl")
