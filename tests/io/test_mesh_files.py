"""GLB, glTF and OBJ: read as they are placed, and written again with moved vertices."""

import base64
import json
import struct
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from tests.corruption import assert_reads_or_refuses, assert_refused
from tests.readme import ROOT
from tso_cli.errors import InputError
from tso_cli.io.clouds import read_cloud, write_cloud
from tso_cli.io.gltf import GltfFile
from tso_cli.io.masks import read_mask
from tso_cli.io.meshes import new_mesh, read_mesh
from tso_cli.io.obj import ObjFile
from tso_cli.io.shapes import read_shape

CHAIR = next((ROOT / "examples/meshes/chair").glob("*.ply"))
SCENE = Path(__file__).with_name("files") / "blender/scene.glb"


def parts_of(data):
    """The JSON and the binary part of a GLB."""
    (length,) = struct.unpack_from("<I", data, 12)
    return json.loads(data[20 : 20 + length]), data[28 + length :]


def a_glb(tmp_path, matrix=None, twice=False, textured=False):
    """A box in a scene that trimesh writes, with normals; the file and the mesh."""
    mesh = trimesh.creation.icosphere(2, 0.5)
    if textured:
        uv = mesh.vertices[:, :2] + 0.5
        picture = Image.fromarray(np.arange(192, dtype=np.uint8).reshape(8, 8, 3))
        mesh = trimesh.Trimesh(
            mesh.vertices, mesh.faces, process=False,
            visual=trimesh.visual.TextureVisuals(uv, image=picture),
        )  # fmt: skip
    scene = trimesh.Scene()
    scene.add_geometry(mesh, node_name="a", geom_name="g", transform=matrix)
    if twice:
        scene.graph.update(frame_to="b", matrix=np.diag([2.0, 2.0, 2.0, 1.0]), geometry="g")
    path = tmp_path / "scene.glb"
    path.write_bytes(scene.export(file_type="glb", include_normals=True))
    return path, mesh


def a_place():
    matrix = trimesh.transformations.rotation_matrix(0.7, [1, 2, 3])
    matrix[:3, :3] *= 2.0
    matrix[:3, 3] = [1.0, 2.0, 3.0]
    return matrix


def test_the_vertices_of_a_glb_are_read_at_the_places_of_their_nodes(tmp_path):
    path, mesh = a_glb(tmp_path, a_place())
    cloud = read_cloud(path)
    expected = trimesh.transform_points(mesh.vertices, a_place())
    np.testing.assert_allclose(cloud.points, expected, atol=1e-6)
    assert (cloud.faces() == mesh.faces).all()
    assert np.abs(read_mesh(path).vertices - expected).max() < 1e-6


def test_a_file_of_blender_has_its_mesh_where_blender_exports_it():
    points = read_cloud(SCENE).points
    exported = read_cloud(SCENE.with_name("scene_glb.ply")).points
    # The same surface: every vertex of one is a vertex of the other.
    gaps = np.abs(points[:, None] - exported[None]).max(2).min(1)
    assert gaps.max() < 1e-6


def test_a_moved_glb_differs_in_coordinates_normals_and_bounds_alone(tmp_path):
    path, _ = a_glb(tmp_path, a_place(), textured=True)
    cloud = read_cloud(path)
    moved = cloud.points.copy()
    moved[: len(moved) // 2] += [0.0, 0.3, 0.1]
    write_cloud(tmp_path / "moved.glb", moved, like=cloud)
    again = read_cloud(tmp_path / "moved.glb")
    np.testing.assert_allclose(again.points, moved, atol=1e-6)
    before, after = path.read_bytes(), (tmp_path / "moved.glb").read_bytes()
    (old, old_binary), (new, new_binary) = parts_of(before), parts_of(after)
    attributes = old["meshes"][0]["primitives"][0]["attributes"]
    position = attributes["POSITION"]
    for name in ("min", "max"):
        old["accessors"][position].pop(name)
        new["accessors"][position].pop(name)
    assert old == new
    changed = np.flatnonzero(
        np.frombuffer(old_binary, np.uint8) != np.frombuffer(new_binary, np.uint8)
    )
    allowed = np.zeros(len(old_binary), bool)
    for name in ("POSITION", "NORMAL"):
        accessor = old["accessors"][attributes[name]]
        view = old["bufferViews"][accessor["bufferView"]]
        start = view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
        allowed[start : start + 12 * accessor["count"]] = True
    assert allowed[changed].all()
    assert len(changed) > 100


def test_the_stated_bounds_are_those_of_the_moved_vertices(tmp_path):
    path, _ = a_glb(tmp_path)
    cloud = read_cloud(path)
    write_cloud(tmp_path / "moved.glb", cloud.points * 3.0, like=cloud)
    document, _ = parts_of((tmp_path / "moved.glb").read_bytes())
    accessor = document["accessors"][
        document["meshes"][0]["primitives"][0]["attributes"]["POSITION"]
    ]
    np.testing.assert_allclose(accessor["max"], read_cloud(tmp_path / "moved.glb").points.max(0))


def test_an_unmoved_glb_is_the_same_file(tmp_path):
    path, _ = a_glb(tmp_path, a_place())
    cloud = read_cloud(path)
    write_cloud(tmp_path / "same.glb", cloud.points, like=cloud)
    assert (tmp_path / "same.glb").read_bytes() == path.read_bytes()


def test_normals_turn_with_the_surface(tmp_path):
    path, mesh = a_glb(tmp_path)
    cloud = read_cloud(path)
    turn = trimesh.transformations.rotation_matrix(0.5, [0, 1, 1])[:3, :3]
    write_cloud(tmp_path / "turned.glb", cloud.points @ turn.T, like=cloud)
    again = trimesh.load(tmp_path / "turned.glb", process=False, force="mesh")
    np.testing.assert_allclose(again.vertex_normals, mesh.vertex_normals @ turn.T, atol=1e-3)
    document, binary = parts_of((tmp_path / "turned.glb").read_bytes())
    accessor = document["accessors"][document["meshes"][0]["primitives"][0]["attributes"]["NORMAL"]]
    offset = document["bufferViews"][accessor["bufferView"]].get("byteOffset", 0)
    stored = np.frombuffer(binary, "<f4", 3 * accessor["count"], offset).reshape(-1, 3)
    np.testing.assert_allclose(stored, mesh.vertex_normals @ turn.T, atol=1e-6)


def stored_normals(path):
    document, binary = parts_of(path.read_bytes())
    accessor = document["accessors"][document["meshes"][0]["primitives"][0]["attributes"]["NORMAL"]]
    offset = document["bufferViews"][accessor["bufferView"]].get("byteOffset", 0)
    return np.frombuffer(binary, "<f4", 3 * accessor["count"], offset).reshape(-1, 3)


def test_normals_under_a_shear_are_those_of_the_surface_in_the_world(tmp_path):
    shear = a_place()
    shear[:3, :3] = shear[:3, :3] @ [[1, 0.6, 0], [0, 0.5, 0.2], [0, 0, 1.5]]
    path, _ = a_glb(tmp_path, shear)
    cloud = read_cloud(path)
    to_world = np.linalg.inv(shear[:3, :3])  # of rows, the inverse transpose
    before = stored_normals(path) @ to_world
    turn = trimesh.transformations.rotation_matrix(0.9, [3, 1, -1])[:3, :3]
    write_cloud(tmp_path / "turned.glb", 1.5 * cloud.points @ turn.T + 7.0, like=cloud)
    after = stored_normals(tmp_path / "turned.glb") @ to_world
    np.testing.assert_allclose(unit(after), unit(before) @ turn.T, atol=1e-6)
    # A bend: the normals follow the faces of the moved mesh.
    bent = cloud.points + np.c_[0.3 * np.sin(cloud.points[:, 1:2]), cloud.points[:, :2] * 0.0]
    write_cloud(tmp_path / "bent.glb", bent, like=cloud)
    found = unit(stored_normals(tmp_path / "bent.glb") @ to_world)
    expected = trimesh.Trimesh(bent, cloud.faces(), process=False).vertex_normals
    assert np.degrees(np.arccos(np.clip((found * expected).sum(1), -1, 1))).max() < 6.0


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def test_a_shift_leaves_every_normal_as_it_was(tmp_path):
    path, _ = a_glb(tmp_path, a_place())
    cloud = read_cloud(path)
    write_cloud(tmp_path / "shifted.glb", cloud.points + [1.0, 0.5, -3.0], like=cloud)
    assert np.array_equal(stored_normals(tmp_path / "shifted.glb"), stored_normals(path))


def test_the_normals_of_an_obj_turn_exactly_with_all_of_it(tmp_path):
    mesh = trimesh.creation.icosphere(2, 0.5)
    (tmp_path / "a.obj").write_text(trimesh.exchange.obj.export_obj(mesh, include_normals=True))
    cloud = read_cloud(tmp_path / "a.obj")
    turn = trimesh.transformations.rotation_matrix(0.5, [0, 1, 1])[:3, :3]
    write_cloud(tmp_path / "b.obj", cloud.points @ turn.T, like=cloud)
    normals = {
        name: np.loadtxt(
            [x[3:] for x in (tmp_path / name).read_text().splitlines() if x[:2] == "vn"]
        )
        for name in ("a.obj", "b.obj")
    }
    np.testing.assert_allclose(normals["b.obj"], normals["a.obj"] @ turn.T, atol=1e-6)


def test_further_parts_of_a_glb_stay(tmp_path):
    path, _ = a_glb(tmp_path)
    data = path.read_bytes()
    extra = struct.pack("<I4s", 8, b"TSO\0") + b"whatever"
    path.write_bytes(data[:8] + struct.pack("<I", len(data) + len(extra)) + data[12:] + extra)
    cloud = read_cloud(path)
    write_cloud(tmp_path / "moved.glb", cloud.points * 1.5, like=cloud)
    written = (tmp_path / "moved.glb").read_bytes()
    assert written.endswith(extra)
    assert struct.unpack_from("<I", written, 8) == (len(written),)
    np.testing.assert_allclose(read_cloud(tmp_path / "moved.glb").points, cloud.points * 1.5)


def test_two_nodes_that_share_a_mesh_are_read_and_not_moved(tmp_path):
    path, mesh = a_glb(tmp_path, a_place(), twice=True)
    cloud = read_cloud(path)
    assert len(cloud.points) == 2 * len(mesh.vertices)
    assert_refused(r"scene\.glb: the nodes a and b share one mesh", cloud.source.require_movable)


def test_parts_of_one_place_that_share_their_vertices_move_together(tmp_path):
    data = new_mesh(".glb", np.random.default_rng(0).normal(size=(8, 3)), np.eye(8, 3, dtype=int))
    document, binary = parts_of(data)
    mesh = document["meshes"][0]
    document |= {"meshes": [mesh, mesh], "nodes": [{"mesh": 0}, {"mesh": 1}]}
    document |= {"scenes": [{"nodes": [0, 1]}], "scene": 0}
    inline = base64.b64encode(binary).decode()
    document["buffers"][0]["uri"] = f"data:application/octet-stream;base64,{inline}"
    (tmp_path / "a.gltf").write_text(json.dumps(document))
    cloud = read_cloud(tmp_path / "a.gltf")
    assert (len(cloud.points), len(cloud.faces())) == (8, 16)
    write_cloud(tmp_path / "b.gltf", cloud.points + 1.0, like=cloud)
    np.testing.assert_allclose(
        read_cloud(tmp_path / "b.gltf").points, cloud.points + 1.0, atol=1e-6
    )


def test_sparse_values_are_read_and_written_whole(tmp_path):
    base = np.arange(24, dtype="<f4").reshape(8, 3)
    new, places = np.float32([[7, 7, 7], [9, 8, 7]]), np.uint16([2, 5])
    parts = [base.tobytes(), new.tobytes(), places.tobytes()]
    begins = np.cumsum([0, *map(len, parts)]).tolist()
    inline = base64.b64encode(b"".join(parts)).decode()
    document = {
        "asset": {"version": "2.0"},
        "buffers": [{"uri": f"data:;base64,{inline}", "byteLength": begins[-1]}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": begin, "byteLength": len(part)}
            for begin, part in zip(begins[:-1], parts, strict=True)
        ],
        "accessors": [{
            "bufferView": 0, "componentType": 5126, "count": 8, "type": "VEC3",
            "sparse": {
                "count": 2, "values": {"bufferView": 1},
                "indices": {"bufferView": 2, "componentType": 5123},
            },
        }],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "mode": 0}]}],
        "nodes": [{"mesh": 0}],
    }  # fmt: skip
    for name, has_base in (("a.gltf", True), ("zeros.gltf", False)):
        if not has_base:
            del document["accessors"][0]["bufferView"]
        (tmp_path / name).write_text(json.dumps(document))
        cloud = read_cloud(tmp_path / name)
        expected = base * has_base
        expected[places] = new
        np.testing.assert_array_equal(cloud.points, expected)
        write_cloud(tmp_path / f"moved.{name}", cloud.points * 2.0, like=cloud)
        np.testing.assert_array_equal(read_cloud(tmp_path / f"moved.{name}").points, expected * 2)


def test_a_gltf_keeps_its_textures_and_gets_its_moved_buffer_inside(tmp_path):
    path, _ = a_glb(tmp_path)
    document, binary = parts_of(path.read_bytes())
    document["buffers"][0]["uri"] = "scene.bin"
    (tmp_path / "scene.bin").write_bytes(binary)
    (tmp_path / "scene.gltf").write_text(json.dumps(document, indent=2))
    cloud = read_cloud(tmp_path / "scene.gltf")
    write_cloud(tmp_path / "moved.gltf", cloud.points + 0.25, like=cloud)
    assert np.abs(read_cloud(tmp_path / "moved.gltf").points - cloud.points - 0.25).max() < 1e-6
    moved = json.loads((tmp_path / "moved.gltf").read_text())
    assert moved["buffers"][0]["uri"].startswith("data:application/octet-stream;base64,")
    assert read_shape(tmp_path / "moved.gltf", samples=100).shape == (100, 3)
    (tmp_path / "scene.bin").rename(tmp_path / "elsewhere.bin")
    assert_refused(
        r"scene\.bin: does not exist, expected the buffer that scene\.gltf names",
        read_cloud, tmp_path / "scene.gltf",
    )  # fmt: skip
    (tmp_path / "scene.bin").symlink_to(tmp_path / "elsewhere.bin")
    assert len(read_cloud(tmp_path / "scene.gltf").points) == len(cloud.points)
    for name in ("../scene.bin", "/etc/passwd", "http://a/b.bin", "..%2Fscene.bin"):
        document["buffers"][0]["uri"] = name
        (tmp_path / "bad.gltf").write_text(json.dumps(document))
        assert_refused("expected a file in the same folder", read_cloud, tmp_path / "bad.gltf")


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (
            {"extensionsUsed": ["KHR_draco_mesh_compression"]},
            "its meshes use Draco, which tso does not read; export it without",
        ),
        ({"meshes": []}, "where an index belongs, under 0"),
        (
            {"nodes": [{"children": [1]}, {"children": [0]}], "scenes": []},
            "node 0 is its own ancestor, expected a tree of nodes",
        ),
        (
            {"extensionsRequired": ["KHR_materials_unlit", "ACME_folded_space"]},
            "requires the extension ACME_folded_space, which tso does not know",
        ),
        ({"extensionsRequired": ["KHR_draco_mesh_compression"]}, "its meshes use Draco"),
        (
            {"accessors": [{"type": "VEC2", "componentType": 5126, "bufferView": 0}] * 3},
            r"accessors\[\d\]\.type is VEC2, expected VEC3 or VEC4",
        ),
        (
            {"bufferViews": [{"buffer": 0, "byteLength": 10**9}] * 3},
            r"accessors\[\d\]\.bufferView is bytes 0 to 1000000000 of buffer 0, expected a part",
        ),
        ({"buffers": [{"uri": "a" * 5000}]}, r"uri is 'aaa.*\.\.\., expected a file in the same"),
        (
            {"accessors": [{"type": "VEC3", "componentType": 5126, "count": 10**400}] * 9},
            r"where a whole number belongs, 0 or more, under 2\^48",
        ),
        ({"bufferViews": []}, "where an index belongs, under"),
    ],
)
def test_a_glb_that_cannot_be_read_says_why(tmp_path, change, says):
    path, _ = a_glb(tmp_path)
    document, binary = parts_of(path.read_bytes())
    inline = base64.b64encode(binary).decode()
    document["buffers"][0]["uri"] = f"data:application/octet-stream;base64,{inline}"
    (tmp_path / "a.gltf").write_text(json.dumps(document | change))
    assert_refused(says, read_cloud, tmp_path / "a.gltf")


def test_colours_that_a_scene_does_not_hold_are_no_traceback(tmp_path):
    path, _ = a_glb(tmp_path)
    document, binary = parts_of(path.read_bytes())
    inline = base64.b64encode(binary).decode()
    document["buffers"][0]["uri"] = f"data:application/octet-stream;base64,{inline}"
    for mesh in document["meshes"]:
        mesh["primitives"][0]["attributes"]["COLOR_0"] = 99
    data = json.dumps(document).encode()
    scene = GltfFile(data, tmp_path / "a.gltf")
    assert_refused(r"accessors\[99\] cannot be read", scene.read_colours)


OBJ = b"""mtllib C:\\work\\my model.mtl\r
o first\r
v 0 0 0\r
v 1.50000 0 0\r
v 1 1 0 # a corner\r
v 0 1 0\r
vt 0 0\r
vn 0 0 1\r
usemtl a\r
f -4/1/1 -3/1/1 -2/1/1 -1/1/1\r
o second\r
v 0 0 1\r
v 1 0 1\r
v 1 1 \\\r
1\r
f -3//-1 -2//-1 -1//-1"""


def test_relative_indices_quads_and_several_objects_of_an_obj(tmp_path):
    (tmp_path / "two.obj").write_bytes(OBJ)
    cloud = read_cloud(tmp_path / "two.obj")
    assert len(cloud.points) == 7
    assert cloud.faces().tolist() == [[0, 1, 2], [0, 2, 3], [4, 5, 6]]
    mesh = read_mesh(tmp_path / "two.obj", textures=False)
    area = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).area
    assert area == pytest.approx(1.25 + 0.5)


def test_a_moved_obj_differs_in_the_numbers_that_change_alone(tmp_path):
    (tmp_path / "two.obj").write_bytes(OBJ)
    cloud = read_cloud(tmp_path / "two.obj")
    moved = cloud.points.copy()
    moved[1, 0], moved[6, 2] = 1.75, 1.5
    write_cloud(tmp_path / "moved.obj", moved, like=cloud)
    text = (tmp_path / "moved.obj").read_bytes()
    expected = OBJ.replace(b"v 1.50000 0 0", b"v 1.75 0 0").replace(
        b"1 1 \\\r\n1\r", b"1 1 \\\r\n1.5\r"
    )
    lines, wanted = text.split(b"\r\n"), expected.split(b"\r\n")
    assert [
        a for a, b in zip(lines, wanted, strict=True) if a != b and not a.startswith(b"vn")
    ] == []
    assert np.abs(read_cloud(tmp_path / "moved.obj").points - moved).max() < 1e-6


def test_the_colours_of_an_obj_stand_after_its_coordinates(tmp_path):
    (tmp_path / "c.obj").write_text("v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 0.5\nf 1 2 3\n")
    assert read_cloud(tmp_path / "c.obj").colours()[2].tolist() == [0.0, 0.0, 0.5]


def test_a_weight_stands_between_the_coordinates_and_the_colour(tmp_path):
    text = "v 0 0 0 1.0 1 0 0\nv 1 0 0 1.0 0 1 0\nv 0 1 0 1.0 0 0 0.5 # red\nf 1 2 3\n"
    (tmp_path / "w.obj").write_text(text)
    cloud = read_cloud(tmp_path / "w.obj")
    assert cloud.points.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    assert cloud.colours()[2].tolist() == [0.0, 0.0, 0.5]
    write_cloud(tmp_path / "moved.obj", cloud.points + [0, 0, 0.5], like=cloud)
    moved = text.replace(" 0 1.0 ", " 0.5 1.0 ")
    assert (tmp_path / "moved.obj").read_text() == moved
    (tmp_path / "h.obj").write_text("v 0 0 0 1\nv 1 0 0 2\nv 0 1 0 1\nf 1 2 3\n")
    with pytest.warns(UserWarning, match="have a weight w that is not 1; weights are for curves"):
        assert read_cloud(tmp_path / "h.obj").points[1].tolist() == [1, 0, 0]


@pytest.mark.parametrize("end", [b"\r", b"\r\n", b"\n"])
def test_the_ends_of_lines_of_an_obj_stay(tmp_path, end):
    text = OBJ.replace(b"\r\n", end)
    (tmp_path / "a.obj").write_bytes(text)
    cloud = read_cloud(tmp_path / "a.obj")
    assert len(cloud.points) == 7
    moved = cloud.points.copy()
    moved[1, 0] = 1.75
    write_cloud(tmp_path / "b.obj", moved, like=cloud)
    written = (tmp_path / "b.obj").read_bytes()
    lines = [line for line in written.split(end) if not line.startswith(b"vn ")]
    expected = text.replace(b"1.50000 0 0", b"1.75 0 0").split(end)
    assert lines == [line for line in expected if not line.startswith(b"vn ")]
    assert len(read_mesh(tmp_path / "a.obj", textures=False).faces) == 3
    (tmp_path / "bad.obj").write_bytes(text + end + b"v 0 0")
    with pytest.raises(InputError, match=f"line {len(text.split(end)) + 1} has 2 numbers"):
        read_cloud(tmp_path / "bad.obj")


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("v 0 0\n", "line 1 has 2 numbers, expected x, y and z"),
        ("v 0 0 x\n", "line 1 has x, expected a number"),
        ("v 0 0 0\nv 1 0 0\nf 1 2 4\n", "a face names 4, expected vertices 1 to 2"),
        ("v 0 0 0\nv 1 0 0\nf 1 2 -3\n", "a face names -3, expected vertices 1 to 2"),
        ("# empty\n", "holds no vertex"),
    ],
)
def test_a_wrong_obj_is_refused_with_its_line(tmp_path, text, says):
    (tmp_path / "a.obj").write_text(text)
    assert_refused(rf"a\.obj: .*{says}", read_cloud, tmp_path / "a.obj")


@pytest.mark.parametrize("kind", ["glb", "gltf", "obj"])
def test_damaged_files_are_read_and_moved_or_refused(tmp_path, kind):
    path, _ = a_glb(tmp_path, textured=True)
    if kind == "gltf":
        document, binary = parts_of(path.read_bytes())
        inline = base64.b64encode(binary).decode()
        document["buffers"][0]["uri"] = f"data:application/octet-stream;base64,{inline}"
        path = tmp_path / "scene.gltf"
        path.write_text(json.dumps(document))
    elif kind == "obj":
        path = tmp_path / "scene.obj"
        path.write_bytes(OBJ)
    form = ObjFile if kind == "obj" else GltfFile

    def read(file):
        found = form(file.read_bytes(), file)
        points = found.read()
        found.read_faces()
        found.require_movable()
        if np.isfinite(points).all() and np.abs(points).max() < 1e6:
            form(found.with_points(points + 0.5), file)

    _, refused = assert_reads_or_refuses(read, path, 120)
    assert refused > 10


def tables():
    points = np.array([[0.5, 1.0, 2.0], [1.5, 1.0, 0.25], [0.0, 3.0, 1.0]])
    rows = points.tolist()
    pcd = "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z rgb\nSIZE 4 4 4 4\nTYPE F F F U\nCOUNT 1 1 1 1\n"
    pcd += "WIDTH 3\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS 3\nDATA "
    binary = np.array(
        [(*row, 7) for row in rows],
        [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("c", "<u4")],
    )
    return points, {
        "a.csv": "id,x,y,z\n" + "".join(f"{i},{x},{y},{z}\n" for i, (x, y, z) in enumerate(rows)),
        "b.csv": "".join(f"{x};{y};{z}\n" for x, y, z in rows),
        "c.pts": "3\n" + "".join(f"{x} {y} {z} 12 255 0 0\n" for x, y, z in rows),
        "d.pcd": pcd + "ascii\n" + "".join(f"{x} {y} {z} 7\n" for x, y, z in rows),
        "e.pcd": (pcd + "binary\n").encode() + binary.tobytes(),
        "f.off": "OFF\n3 1 0\n" + "".join(f"{x} {y} {z}\n" for x, y, z in rows) + "3 0 1 2\n",
    }


@pytest.mark.parametrize("name", tables()[1])
def test_tables_of_other_programs_are_read(save, name):
    points, files = tables()
    found = read_cloud(save(name, files[name])).points
    np.testing.assert_allclose(found, points)


@pytest.mark.parametrize("name", tables()[1])
def test_damaged_tables_are_read_or_refused(save, tmp_path, name):
    assert_reads_or_refuses(read_cloud, save(name, tables()[1][name]), 60)


POINT = [[1.5, 2.0, 3.25], [4.0, 5.0, -6.0]]


@pytest.mark.parametrize(
    "text",
    [
        "x,y,z\n1.5,2,3.25\n4,5,-6\n",
        "1.5, 2, 3.25\r\n4, 5, -6\r\n",
        "X;Y;Z;name\n1,5;2,0;3,25;a, b\n4;5;-6;c\n",
        "x\ty\tz\n1,5\t2\t3,25\n4\t5\t-6\n",
        "x y  z\n1.5 2  3.25\n 4 5 -6 \n",
        "x\ty\tz\r1.5\t2\t3.25\r4\t5\t-6\r",
        "\ufeffid,X,Y,Z\na,1.5,2,3.25\nb,4,5,-6\n",
        '"label","x","y","z"\n"a, b",1.5,"2",3.25\n"c ""d""",4,5,-6\n',
        '"Points:0","Points:1","Points:2","v"\n1.5,2,3.25,\n4,5,-6,\n',
        "time,point_x,point_y,point_z\n2024-01-01 10:00:00,1.5,2,3.25\n2024-01-01 10:00:01,4,5,-6",
        "stamp;pos_z;pos_y;pos_x\n2024-01-01 10:00:00;3,25;2;1,5\n2024-01-01 10:00:01;-6;5;4\n",
        "//X,Y,Z,R,G,B\n1.5,2,3.25,255,0,0\n4,5,-6,0,0,9\n",
        "//X Y Z\n1.5 2 3.25\n4 5 -6\n",
        "# a scan; of a chair, here\n#x,y,z\n1.5,2,3.25\n# more\n4,5,-6\n,,\n",
        "1.5,2,3.25,chair_1\n4,5,-6,Stühle\n",
        ",x,y,z\n0,1.5,2,3.25\n1,4,5,-6\n",
    ],
)  # fmt: skip
def test_tables_with_other_separators_names_and_columns_are_read(save, text):
    assert read_cloud(save("a.csv", text.encode())).points.tolist() == POINT


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("x,y,z\n1,2,3\n4,,6\n", "line 3 has an empty cell as y, expected a number"),
        ("x,y,z\n1,2,3\n4,5,6_0\n", "line 3 has '6_0' as z, expected a number"),
        ("x,y,z\n1,2,3\n4,5\n", "line 3 has 2 columns, expected at least 3"),
        ("a,b,c\n1,2,3\n", "its columns are a, b, c, expected x, y and z"),
        ('x,y,z\n1,2,3\n4,5,6,"a\n', "line 3 is no row of a .csv file"),
        ("x;y;z\n1.000,5;2;3\n", "line 2 has '1.000.5' as x .commas are decimal"),
    ],
)
def test_a_wrong_row_of_a_csv_is_refused_with_its_line(save, text, says):
    assert_refused(rf"a\.csv: .*{says}", read_cloud, save("a.csv", text))


def test_a_million_rows_of_a_csv_take_seconds():
    import time

    from tso_cli.io.point_tables import read_points

    data = b"id,x,y,z\n" + b"a,0.123456,-1.25,3.5\n" * 1_000_000
    start = time.process_time()
    assert len(read_points(data, Path("a.csv"), 1)) == 1_000_000
    assert time.process_time() - start < 10.0


@pytest.mark.parametrize(
    ("name", "change", "says"),
    [
        ("d.pcd", lambda data: data + "9 9 9 9\n", "has 4 lines of points, POINTS states 3"),
        ("d.pcd", lambda data: data[: data[:-1].rindex("\n")],
         "ends early: it has 2 lines of points, POINTS states 3, expected the same"),
        ("e.pcd", lambda data: data[:-4], "ends early: it has 2 points of 16 bytes, POINTS st"),
        ("e.pcd", lambda data: data + b"12345", "5 bytes follow its 3 points of 16 bytes"),
        ("c.pts", lambda data: "4" + data[1:],
         "ends early: it has 3 lines of points, its first line states 4"),
        ("c.pts", lambda data: "2" + data[1:], "has 3 lines of points, its first line states 2"),
        ("f.off", lambda data: data[:-8],
         "ends early: it has 3 lines after its counts, which state 3 vertices and 1 face"),
    ],
)  # fmt: skip
def test_a_table_of_another_length_than_it_states_is_refused(save, name, change, says):
    assert_refused(says, read_cloud, save(name, change(tables()[1][name])))


def test_arrays_of_networks_are_read(tmp_path):
    import torch

    points = np.random.default_rng(0).normal(size=(20, 3))
    np.save(tmp_path / "one.npy", points[None].astype("f4"))
    np.savez(tmp_path / "named.npz", points=points.astype(np.float16), loc=np.zeros(3), scale=1.0)
    torch.save(torch.from_numpy(points[None]), tmp_path / "tensor.pt")
    torch.save({"verts": torch.from_numpy(points), "faces": torch.tensor([[0, 1, 2]])},
               tmp_path / "mesh.pt")  # fmt: skip
    for name in ("one.npy", "named.npz", "tensor.pt", "mesh.pt"):
        np.testing.assert_allclose(read_cloud(tmp_path / name).points, points, atol=1e-2)
    np.save(tmp_path / "six.npy", np.c_[points, points])
    with pytest.warns(UserWarning, match="only the first three of its columns are used"):
        assert read_cloud(tmp_path / "six.npy").points.shape == (20, 3)
    np.save(tmp_path / "batch.npy", np.repeat(points[None], 8, 0))
    assert_refused("holds 8 clouds of 20 points, expected one", read_cloud, tmp_path / "batch.npy")
    np.savez(tmp_path / "two.npz", a=points, b=points)
    assert_refused("expected an array called points", read_cloud, tmp_path / "two.npz")


def test_a_result_is_written_as_what_its_suffix_says(tmp_path):
    cloud = read_cloud(CHAIR)
    moved = cloud.points + 0.125
    for name in ("a.npy", "a.xyz"):
        write_cloud(tmp_path / name, moved, like=cloud)
        np.testing.assert_allclose(read_cloud(tmp_path / name).points, moved, atol=1e-6)
    path, mesh = a_glb(tmp_path, textured=True)
    lost = "its textures, materials and texture coordinates do not go into .ply; write"
    with pytest.warns(UserWarning, match=f"{lost} .glb to keep them"):
        write_cloud(tmp_path / "a.ply", read_cloud(path).points, like=read_cloud(path))
    normals = [read_cloud(file).source.read_normals() for file in (path, tmp_path / "a.ply")]
    np.testing.assert_allclose(normals[1], normals[0], atol=1e-6)
    lost = "texture coordinates and normals do not go"
    scene = read_cloud(path)
    with pytest.warns(UserWarning, match=lost):
        write_cloud(tmp_path / "a.ply", scene.points + 1.0, like=scene, overwrite=True)
    assert (read_cloud(tmp_path / "a.ply").faces() == mesh.faces).all()
    assert_refused(
        "expected .ply or .npy or .xyz", write_cloud, tmp_path / "a.glb", moved, like=cloud
    )


@pytest.mark.parametrize(
    ("text", "lost"),
    [
        ("", ""),
        ("vn 0 0 1\n", "normals"),
        ("vn 0 0 1\nf 3//1 2//1 1//1\n", ""),
        ("usemtl a\nvt 0 0\n", "materials and texture coordinates"),
    ],
)
def test_a_warning_names_what_a_ply_has_no_place_for_if_it_is_there(tmp_path, text, lost):
    (tmp_path / "a.obj").write_text(f"v 0 0 0\nv 1 0 0\nv 0 1 0\n{text}f 1 2 3\n")
    cloud = read_cloud(tmp_path / "a.obj")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        write_cloud(tmp_path / "a.ply", cloud.points, like=cloud)
    said = [str(one.message).partition("a.obj: ")[2] for one in caught]
    assert said == ([f"its {lost} do not go into .ply; write .obj to keep them"] if lost else [])


@pytest.mark.parametrize(
    "change",
    [
        {"extensionsUsed": 5},
        {"scenes": [{"nodes": 5}]},
        {"nodes": [{"mesh": 0, "children": 2}]},
        {"meshes": [{"primitives": [{"attributes": {"POSITION": [0]}}]}]},
        {"meshes": [{"primitives": [{"attributes": {"POSITION": 1, "NORMAL": [1]}}]}]},
        {"accessors": [{"componentType": [1], "type": "VEC3", "bufferView": 0, "count": 1}] * 3},
    ],
)
def test_values_of_another_type_in_a_gltf_are_refused(tmp_path, change):
    path, _ = a_glb(tmp_path)
    document, binary = parts_of(path.read_bytes())
    inline = base64.b64encode(binary).decode()
    document["buffers"][0]["uri"] = f"data:application/octet-stream;base64,{inline}"
    (tmp_path / "a.gltf").write_text(json.dumps(document | change))
    assert_refused(r"a\.gltf: ", read_cloud, tmp_path / "a.gltf")


def test_faces_of_an_array_must_name_its_points(tmp_path):
    points = np.random.default_rng(0).normal(size=(8, 3))
    np.savez(tmp_path / "bad.npz", points=points, faces=[[0, 1, 99]])
    assert_refused(r"bad\.npz", read_cloud, tmp_path / "bad.npz")
    np.savez(tmp_path / "quads.npz", points=points, faces=[[0, 1, 2, 3]])
    assert_refused(r"quads\.npz", read_cloud, tmp_path / "quads.npz")


@pytest.mark.parametrize(
    "text",
    [
        "X Y Z\n1.5 2 3.25\n4 5 -6\n",
        "//X Y Z R G B\n1.5 2 3.25 255 0 0\n4 5 -6 0 0 9\n",
        "id z y x\n1 3.25 2 1.5\n2 -6 5 4\n",
        "2\n1.5 2 3.25\n4 5 -6\n",
        "1.5,2,3.25\n4,5,-6\n",
        "1,5;2;3,25\n4;5;-6\n",
    ],
)
@pytest.mark.parametrize("name", ["a.txt", "a.xyz"])
def test_a_text_has_names_a_count_or_commas_as_programs_write_them(save, name, text):
    assert read_cloud(save(name, text)).points.tolist() == POINT


@pytest.mark.parametrize("blank", [" ", ","])
@pytest.mark.parametrize(
    ("first", "says", "columns"),
    [
        ([0, 1, 2, 3], "its first column counts its lines", "2,3,4"),
        ([[255, 0, 9]] * 4, "its first three columns are whole numbers up to 255", "4,5,6"),
    ],
)
def test_numbers_of_lines_and_colours_are_not_taken_for_coordinates(
    save, tso, tmp_path, first, says, columns, blank
):
    points = np.array([[0.5, 1.0, 2.0], [1.5, 1.0, 0.25], [0.0, 3.0, 1.0], [1.0, 1.0, 1.0]])
    rows = np.column_stack([first, points]).tolist()
    path = save("a.txt", "".join(blank.join(map("{:g}".format, row)) + "\n" for row in rows))
    assert_refused(rf"a\.txt: {says}.*tso convert .*`columns` {columns}", read_cloud, path)
    result = tso("convert", path, tmp_path / "a.npy", "--columns", columns)
    assert result.code == 0
    np.testing.assert_array_equal(np.load(tmp_path / "a.npy"), points)
    assert "of a table" in tso("convert", CHAIR, tmp_path / "b.npy", "--columns", "1,2,3").refusal


def test_voxels_with_colours_are_coordinates(save):
    text = "".join(f"{i} {i % 3} 5 255 0 9\n" for i in (3, 1, 2, 7, 9))
    with pytest.warns(UserWarning, match="only the first three"):
        assert read_cloud(save("a.xyz", text)).points[0].tolist() == [3.0, 0.0, 5.0]


def test_a_coordinate_that_no_float_holds_is_written_as_a_double(save, tmp_path):
    cloud = read_cloud(save("a.obj", "v 1e50 2e50 3e50\nv 1e20 2e20 3e20\nv 0 0 0\n"))
    moved = cloud.points * 1.5
    write_cloud(tmp_path / "b.obj", moved, like=cloud)
    np.testing.assert_array_equal(read_cloud(tmp_path / "b.obj").points, moved)


def test_decimal_commas_in_a_file_separated_by_commas_are_refused(save):
    path = save("a.csv", "x,y,z\n0,1,0,2,0,3\n")
    assert_refused("line 2 has 6 values, its header 3, expected as many", read_cloud, path)
    assert len(read_cloud(save("b.csv", "x,y,z\n0,1,2,,\n1,1,1\n")).points) == 2


def test_a_csv_without_a_header_says_that_it_uses_three_columns(save):
    with pytest.warns(UserWarning, match="only the first three of its columns are used"):
        cloud = read_cloud(save("a.csv", "1,2,3,4\n5,6,7,8\n"))
    assert cloud.points.tolist() == [[1.0, 2.0, 3.0], [5.0, 6.0, 7.0]]


@pytest.mark.parametrize("name", ["a.csv", "a.xyz", "points3D.txt"])
def test_a_line_of_megabytes_is_refused_before_it_is_parsed(save, name):
    path = save(name, "1 2 3 " * 500_000)
    assert_refused("a line has over 1,048,576 characters", read_cloud, path)


def test_zeros_are_not_unpacked_if_they_do_not_fit(tmp_path, monkeypatch):
    np.savez_compressed(tmp_path / "a.npz", points=np.zeros((1 << 20, 3)))
    np.savez_compressed(tmp_path / "m.npz", mask=np.zeros((15_000, 10_000), np.uint8))
    monkeypatch.setattr("tso_cli.io.reading.free_memory", lambda: 200.0 * 2**20)
    assert_refused("needs about 0.24 GiB of memory", read_cloud, tmp_path / "a.npz")
    monkeypatch.undo()
    assert_refused("is 15000x10000, 150,000,000 pixels", read_mask, tmp_path / "m.npz")


def test_the_counts_of_an_off_file_may_stand_in_its_first_line(tmp_path):
    rows = "3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
    (tmp_path / "a.off").write_text(f"OFF{rows}")
    cloud = read_cloud(tmp_path / "a.off")
    assert cloud.points.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    assert cloud.faces().tolist() == [[0, 1, 2]]
    (tmp_path / "b.off").write_text("OFF" + rows.replace("1 0 0", "1 a 0"))
    assert_refused("line 3 has '1 a 0', expected x, y and z", read_cloud, tmp_path / "b.off")


def test_a_file_of_torch_before_1_6_is_read(tmp_path):
    torch = pytest.importorskip("torch")
    points = torch.rand(20, 3)
    torch.save(points, tmp_path / "a.pt", _use_new_zipfile_serialization=False)
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.pt").points, points.double().numpy())


@pytest.mark.parametrize(
    ("name", "content", "says"),
    [
        ("a.glb", CHAIR.read_bytes(), "holds a .ply file, by its content, expected .glb"),
        ("a.glb", b"glTF", r"is a damaged GLB or glTF \(it ends early\)"),
        ("a.csv", "x,y,z\n".encode("utf-16"), "is UTF-16 text, expected UTF-8"),
        ("a.xyz", "1\n", "has 1 column, expected at least 3, separated by blanks$"),
    ],
)
def test_a_file_of_another_kind_than_its_suffix_says_so(save, name, content, says):
    assert_refused(says, read_cloud, save(name, content))


def test_names_and_options_in_a_material_file_are_read_as_programs_write_them(save, tmp_path):
    Image.new("RGB", (2, 2), (255, 0, 0)).save(tmp_path / "wood 1.png")
    save("a.mtl", "newmtl plain\nKd 0 1 0\n")
    save("b.mtl", "newmtl pine\nmap_Kd -s 2 2 1 -o 0.5 -clamp on wood 1.png\n")
    text = "\ufeffmtllib a.mtl b.mtl # two\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0.5\n"
    path = save("m.obj", f"{text}usemtl plain\nf 1 2 3\nusemtl pine # wood\nf 1/1 2/2 3/3\n")
    paint = read_mesh(path).paint
    assert paint.corners[0].tolist() == [[0.0, 1.0, 0.0]] * 3
    (texture,) = paint.textures
    assert texture.faces.tolist() == [1]
    assert texture.corners[0].tolist() == [[0.5, 0.0], [2.5, 0.0], [1.5, 0.0]]
    assert texture.wraps == ("clamp", "clamp")


@pytest.mark.parametrize(
    ("material", "fault"),
    [("Kd red", "has a Kd that is not three numbers"), ("map_Kd " + "n" * 300, "is not in this")],
)
def test_one_damaged_material_leaves_the_others(save, material, fault):
    save("a.mtl", f"newmtl good\nKd 0 1 0\nnewmtl bad\n{material}\n")
    text = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl good\nf 1 2 3\nusemtl bad\nf 1 2 3\n"
    path = save("m.obj", text)
    with pytest.warns(UserWarning, match=fault):
        assert read_mesh(path).paint.corners[:, 0].tolist() == [[0.0, 1.0, 0.0], [1.0, 1.0, 1.0]]


def test_a_node_that_mirrors_its_mesh_does_not_turn_it_inside_out(tmp_path):
    scene, mirror = trimesh.Scene(), np.diag([-1.0, 1.0, 1.0, 1.0])
    scene.add_geometry(trimesh.creation.box((1.0, 0.6, 0.3)), transform=mirror)
    scene.export(tmp_path / "mirrored.glb")
    mesh = read_mesh(tmp_path / "mirrored.glb")
    assert trimesh.Trimesh(mesh.vertices, mesh.faces, process=False).volume == pytest.approx(0.18)


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".off"])
def test_a_concave_face_of_a_file_is_the_surface_that_it_bounds(save, suffix):
    corners = [(0.5, -0.3), (-0.3, -0.3), (-0.3, 0.5), (-0.5, 0.5), (-0.5, -0.5), (0.5, -0.5)]
    rows = "\n".join(f"{x} {y} 0" for x, y in corners)
    texts = {
        ".obj": "v " + rows.replace("\n", "\nv ") + "\nf 1 2 3 4 5 6\n",
        ".off": f"OFF\n6 1 0\n{rows}\n6 0 1 2 3 4 5\n",
        ".ply": "ply\nformat ascii 1.0\nelement vertex 6\nproperty float x\nproperty float y\n"
        "property float z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        f"{rows}\n6 0 1 2 3 4 5\n",
    }
    mesh = read_mesh(save(f"L{suffix}", texts[suffix]))
    assert trimesh.Trimesh(mesh.vertices, mesh.faces).area == pytest.approx(0.36)
