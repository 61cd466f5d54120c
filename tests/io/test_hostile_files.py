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
import trimesh
from PIL import Image, ImageFile
from trimesh.visual.material import PBRMaterial, SimpleMaterial

from tests.corruption import assert_reads_or_refuses, assert_refused
from tests.fuzz import READERS, cameras, reader
from tso_cli.errors import InputError
from tso_cli.io import paint, reading
from tso_cli.io.clouds import read_cloud
from tso_cli.io.logs import read_log
from tso_cli.io.masks import read_mask
from tso_cli.io.meshes import new_mesh, read_mesh

from .test_clouds import a_ply
from .test_mesh_files import OBJ, parts_of, tables

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


def a_scene(tmp_path, **changes):
    """A small .glb whose document has these ``changes``."""
    document, binary = parts_of(new_mesh(".glb", POINTS, FACES))
    accessors = [dict(one) for one in document["accessors"]]
    (primitive,) = document["meshes"][0]["primitives"]
    if "count" in changes:
        accessors[primitive["attributes"]["POSITION"]] |= {"count": changes["count"]}
        del accessors[primitive["attributes"]["POSITION"]]["bufferView"]
        document["accessors"] = accessors
    if "instances" in changes:
        document["nodes"] = [{"mesh": 0}] * changes["instances"]
        document["scenes"] = [{"nodes": list(range(changes["instances"]))}]
        document["scene"] = 0
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I", len(text)) + b"JSON" + text
    chunks += struct.pack("<I", len(binary)) + b"BIN\0" + binary
    path = tmp_path / "scene.glb"
    path.write_bytes(b"glTF" + struct.pack("<II", 2, 12 + len(chunks)) + chunks)
    return path


@pytest.mark.parametrize("read", [read_mesh, read_cloud])
def test_a_small_scene_of_many_gigabytes_is_refused_before_they_are_taken(
    tmp_path, monkeypatch, read
):
    read(a_scene(tmp_path, instances=3))
    assert_refused("stand for about 10.4 GiB", read, a_scene(tmp_path, count=100_000_000))
    monkeypatch.setattr(reading, "free_memory", lambda: 1e6)
    assert_refused(r"needs about 0\.0\d+ GiB of memory", read, a_scene(tmp_path, instances=5000))


def two_boxes(path, side):
    """A mesh of two boxes, each with a black picture of its own that has one white pixel."""
    parts = [trimesh.creation.box() for _ in range(2)]
    for number, part in enumerate(parts):
        image = Image.new("1", (side, side))
        image.putpixel((number, 0), 1)
        texture = SimpleMaterial(image=image, name=f"material {number}")
        texture = texture.to_pbr() if path.suffix == ".glb" else texture
        part.visual = trimesh.visual.TextureVisuals(np.zeros((8, 2)), material=texture)
    trimesh.Scene(parts).export(path)
    return path


@pytest.fixture
def nothing_decoded(monkeypatch):
    """Fails the test if the picture in a file is decoded."""
    decoded = []
    monkeypatch.setattr(ImageFile.ImageFile, "load", decoded.append)
    yield
    assert decoded == []


@pytest.mark.usefixtures("nothing_decoded")
@pytest.mark.parametrize("name", ["textures.glb", "textures.obj"])
def test_a_texture_that_does_not_fit_into_memory_is_a_warning_and_not_decoded(
    tmp_path, monkeypatch, name
):
    path = two_boxes(tmp_path / name, 9700)  # Pillow warns of its size
    monkeypatch.setattr(reading, "free_memory", lambda: 1.0e9)
    with pytest.warns(UserWarning, match=rf"{name}: the texture .* cannot be decoded") as caught:
        assert read_mesh(path).paint.textures == ()
    assert len(caught) == 1


@pytest.mark.usefixtures("nothing_decoded")
@pytest.mark.parametrize("name", ["textures.glb", "textures.obj"])
def test_textures_over_the_limit_of_pixels_are_a_warning_and_not_decoded(
    tmp_path, monkeypatch, tso, name
):
    path = two_boxes(tmp_path / name, 8)
    monkeypatch.setattr(paint, "MOST_PIXELS", 63)
    result = tso("render", path, "-o", tmp_path / "out", "--views", 1)
    assert "is one too many: expected at most 63 pixels in all" in result.err
    assert ("(2 in all)" in result.err, result.code) == (True, 0)


def test_sixteen_pictures_of_8192_x_8192_are_not_too_many():
    assert 16 * 8192**2 <= paint.MOST_PIXELS < 24 * 10_000**2


@pytest.mark.usefixtures("nothing_decoded")
def test_a_picture_that_is_not_for_colours_counts_for_nothing_and_is_not_decoded(
    tmp_path, monkeypatch
):
    material = PBRMaterial(normalTexture=Image.new("RGB", (64, 64)))
    box = trimesh.creation.box()
    box.visual = trimesh.visual.TextureVisuals(np.zeros((8, 2)), material=material)
    box.export(tmp_path / "a.glb")
    monkeypatch.setattr(paint, "MOST_PIXELS", 100)
    assert read_mesh(tmp_path / "a.glb").paint is None


@pytest.mark.parametrize("name", BOMBS)
def test_a_small_file_that_would_take_long_or_much_memory_is_refused_at_once(tmp_path, name):
    (tmp_path / name).write_text(BOMBS[name])
    before = time.process_time()
    assert_refused(name, cameras, tmp_path / name)
    assert time.process_time() - before < 20.0  # a bomb that goes off takes minutes


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


def copies(of, count):
    """A scene of a box with ``count`` copies of something small."""
    document, _ = parts_of(new_mesh(".glb", POINTS, FACES))
    (primitive,) = document["meshes"][0]["primitives"]
    chain = [{"children": [i + 1]} for i in range(count)]
    parts = {
        "nodes": {"nodes": [*chain, {"mesh": 0}], "scenes": [{"nodes": [0]}], "scene": 0},
        "primitives": {"meshes": [{"primitives": [primitive] * count}]},
        "buffers": {"buffers": [json.loads(a_gltf())["buffers"][0], *[{"byteLength": 0}] * count]},
        "files": {"buffers": [json.loads(a_gltf())["buffers"][0], *[{"uri": "a.bin"}] * count]},
    }
    return a_gltf(**parts[of])


def shared_lists(depth):
    nested = [0.5] * 10
    for _ in range(depth):
        nested = [nested] * 10
    return nested


IN_ITSELF = []
IN_ITSELF.append(IN_ITSELF)
ROUND = np.c_[np.cos(np.arange(4000) / 637), np.sin(np.arange(4000) / 637)] * 1400 + [2000, 1500]
SIZE = {"height": 3000, "width": 4000}
SMALL = {
    "chain.gltf": (copies("nodes", 40_000), ""),
    "parts.gltf": (copies("primitives", 10_000), ""),
    "buffers.gltf": (copies("buffers", 20_000), ""),
    "files.gltf": (copies("files", 2), "uri is a.bin, expected a file or data of its own"),
    "lists.pt": (a_pt({"points": shared_lists(9)}), r"stand for 1e\+10 numbers, expected at most"),
    "loop.pt": (a_pt({"points": IN_ITSELF}), "stand for inf numbers"),
    "expanded.pt": (a_pt({"points": [torch.ones(1).expand(10**9, 3)]}), "stand for 3e"),
    "round.json": ({"segmentation": [ROUND.ravel().tolist()], **SIZE}, ""),
    "zigzag.json": (
        {"segmentation": [[9, 0, 9, 3000] * 2000 for _ in range(2)], **SIZE},
        "outlines that cross 12,000,000 rows of 2 pixels",
    ),
}


@pytest.mark.parametrize("name", SMALL)
def test_the_work_for_a_small_file_is_small_or_the_file_is_refused(save, name):
    content, says = SMALL[name]
    save("a.bin", b"1234")
    path = save(name, content)
    read = read_mask if name.endswith(".json") else read_cloud
    start = time.process_time()
    tracemalloc.start()
    try:
        if says:
            assert_refused(says, read, path)
        else:
            result = read(path)
            if name.endswith(".gltf"):
                result.source.with_points(result.points + 1.0)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 2**30
    assert time.process_time() - start < 30.0


def test_parts_that_show_the_same_corners_too_often_are_refused(save):
    corners = np.tile(FACES, (10_000, 1))
    document, binary = parts_of(new_mesh(".glb", POINTS, corners))
    uri = f"data:application/octet-stream;base64,{base64.b64encode(binary).decode()}"
    document["buffers"][0]["uri"] = uri
    document["meshes"][0]["primitives"] *= 500
    path = save("a.gltf", json.dumps(document).encode())
    assert_refused("stand for about .* GiB, expected at most 1 for its size", read_cloud, path)


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
