"""A cloud that moved as one: what its file holds moves along, and the shape stays."""

import json
import re
import struct
import warnings
from pathlib import Path

import numpy as np
import pytest
import trimesh

from tests.corruption import assert_refused
from tests.io.test_clouds import CODES, ORDERS
from tests.io.test_mesh_files import CHAIR, SCENE, a_glb, a_place, parts_of, unit
from tso_cli.io.clouds import read_cloud, write_cloud

BOX = Path(__file__).with_name("files") / "bop/models/obj_000001.ply"
POINTS = np.array([[0.5, -2.5, 3.0], [0.25, 4.25, 0.0], [7.0, 0.5, -9.875], [0.5, 0.5, 0.5]])
NORMALS = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0]])


def motion(size=1.7, degrees=130.0, shift=(0.5, -2.0, 3.0)):
    """A matrix [4, 4] that turns about a slanted axis, and its rotation."""
    matrix = trimesh.transformations.rotation_matrix(np.radians(degrees), [1, 2, -3])
    turn = matrix[:3, :3].copy()
    matrix[:3, :3] *= size
    matrix[:3, 3] = shift
    return matrix, turn


def moved(matrix, points):
    return points @ matrix[:3, :3].T + matrix[:3, 3]


def bent(points):
    """The points, each moved by up to a hundredth of the size."""
    size = np.ptp(points, axis=0).max()
    return points + 0.01 * size * np.sin(9.0 * points[:, [1, 2, 0]] / size)


def write_moved(path, cloud, matrix, points=None):
    """Write the moved cloud, and return what was said."""
    points = moved(matrix, cloud.points) if points is None else points
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        write_cloud(path, points, like=cloud, overwrite=True, matrix=matrix)
    return [str(one.message) for one in caught]


def a_ply(form, columns, faces=()):
    """A PLY file with vertices of these columns, name -> (type, values), and faces with normals.

    Binary, or text with few digits.
    """
    count = len(columns["x"][1])
    head = ["ply", f"format {form} 1.0", f"element vertex {count}"]
    head += [f"property {kind} {name}" for name, (kind, _) in columns.items()]
    head += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    head += [f"property float n{axis}" for axis in "xyz"]
    rows = []
    for i in range(count):
        own = [(CODES[kind], values[i]) for kind, values in columns.values()]
        rows.append([(c, float(v) if c in "fd" else int(v)) for c, v in own])
    for corners, normal in faces:
        rows.append(
            [("B", len(corners)), *(("i", c) for c in corners), *(("f", x) for x in normal)]
        )
    if ORDERS[form]:
        body = b"".join(
            struct.pack(ORDERS[form] + "".join(c for c, _ in row), *(v for _, v in row))
            for row in rows
        )
    else:
        body = "".join(" ".join(f"{v:g}" for _, v in row) + "\n" for row in rows).encode()
    return "\n".join([*head, "end_header", ""]).encode() + body


def columns_of(names, kind, values):
    return {name: (kind, column) for name, column in zip(names, values.T, strict=True)}


every_form = pytest.mark.parametrize("form", ORDERS)
QUARTER = np.array(
    [[0.0, -2.0, 0.0, 0.5], [2.0, 0.0, 0.0, 4.0], [0.0, 0.0, 2.0, -1.0], [0, 0, 0, 1]]
)


@every_form
@pytest.mark.parametrize("kind", ["float", "double", "int"])
@pytest.mark.parametrize("names", [("nx", "ny", "nz"), ("normal_x", "normal_y", "normal_z")])
@pytest.mark.filterwarnings("error")
def test_normals_of_a_ply_turn_along_and_all_else_stays(save, tmp_path, form, kind, names):
    """The expected file is a new file with the moved values; integers become double."""

    def file(points, normals, of_face, kind=kind):
        columns = {
            names[2]: (kind, normals[:, 2]), "y": ("float", points[:, 1]),
            "quality": ("float", np.arange(4) / 4), "x": ("double", points[:, 0]),
            names[0]: (kind, normals[:, 0]), "z": ("float", points[:, 2]),
            "red": ("uchar", np.arange(4)), names[1]: (kind, normals[:, 1]),
        }  # fmt: skip
        return a_ply(form, columns, [([0, 1, 2], of_face), ([0, 1, 2, 3], [0.0, 0.0, -1.0])])

    cloud = read_cloud(save("a.ply", file(POINTS, NORMALS, [1.0, 0.0, 0.0])))
    write_cloud(tmp_path / "b.ply", moved(QUARTER, POINTS), like=cloud, matrix=QUARTER)
    turned = NORMALS @ QUARTER[:3, :3].T / 2.0 + 0.0
    expected = file(
        moved(QUARTER, POINTS), turned, [0.0, 1.0, 0.0], "double" if kind == "int" else kind
    )
    assert alike((tmp_path / "b.ply").read_bytes(), form) == alike(expected, form)


def alike(data, form):
    """The bytes of a file; if it is text, with each number as short as it can be."""
    shortest = re.compile(rb"-?[0-9.]+")
    return shortest.sub(lambda w: b"%g" % float(w[0]), data) if form == "ascii" else data


@every_form
def test_whole_numbers_stay_whole_if_nothing_turns(save, tmp_path, form):
    columns = columns_of("xyz", "float", POINTS) | columns_of(("nx", "ny", "nz"), "char", NORMALS)
    path = save("a.ply", a_ply(form, columns))
    matrix, _ = motion(2.0, degrees=0.0, shift=(0.5, 0.25, 0.0))
    assert write_moved(tmp_path / "b.ply", read_cloud(path), matrix) == []
    columns |= columns_of("xyz", "float", moved(matrix, POINTS))
    written = (tmp_path / "b.ply").read_bytes()
    assert alike(written, form) == alike(a_ply(form, columns), form)


def files(tmp_path):
    """A file of each kind, with normals."""
    mesh = trimesh.creation.icosphere(2, 0.5)
    (tmp_path / "a.obj").write_text(trimesh.exchange.obj.export_obj(mesh, include_normals=True))
    vertices, normals = np.asarray(mesh.vertices), np.asarray(mesh.vertex_normals)
    columns = columns_of("xyz", "float", vertices) | columns_of(
        ("nx", "ny", "nz"), "float", normals
    )
    (tmp_path / "a.ply").write_bytes(a_ply("binary_little_endian", columns))
    glb, _ = a_glb(tmp_path, a_place())
    return [tmp_path / "a.obj", tmp_path / "a.ply", glb, SCENE]


@pytest.mark.parametrize("number", range(4))
def test_without_a_motion_every_byte_is_as_without_a_matrix(tmp_path, number):
    path = files(tmp_path)[number]
    cloud, out = read_cloud(path), tmp_path / f"out{path.suffix}"
    for points in (cloud.points, cloud.points + 0.25, bent(cloud.points)):
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            write_cloud(out, points, like=cloud, overwrite=True)
        without = out.read_bytes()
        assert write_moved(out, cloud, np.eye(4), points) == [str(one.message) for one in said]
        assert out.read_bytes() == without
    write_moved(out, cloud, np.eye(4), cloud.points)
    assert out.read_bytes() == path.read_bytes()


@pytest.mark.parametrize("number", range(4))
def test_normals_of_a_file_of_each_kind_turn_with_it_and_nothing_is_stale(tmp_path, number):
    path = files(tmp_path)[number]
    cloud, out = read_cloud(path), tmp_path / f"out{path.suffix}"
    matrix, turn = motion()
    assert write_moved(out, cloud, matrix) == []
    normals = read_cloud(out).source.read_normals()
    np.testing.assert_allclose(normals, cloud.source.read_normals() @ turn.T, atol=2e-7)


@pytest.mark.parametrize("number", range(4))
def test_what_only_shifts_and_grows_keeps_its_normals_bit_for_bit(tmp_path, number):
    path = files(tmp_path)[number]
    cloud, out = read_cloud(path), tmp_path / f"out{path.suffix}"
    for size in (1.0, 3.0):
        matrix, _ = motion(size, degrees=0.0)
        assert write_moved(out, cloud, matrix) == []
        normals = read_cloud(out).source.read_normals()
        assert np.array_equal(normals, cloud.source.read_normals())


@pytest.mark.parametrize("path", [CHAIR, BOX, SCENE, "a.obj", "placed.glb"], ids=str)
def test_every_length_grows_by_the_one_factor(tmp_path, path):
    """The distances of all pairs of vertices, edges among them, to the rounding of float."""
    if path == "a.obj":
        path = files(tmp_path)[0]
    elif path == "placed.glb":
        path, _ = a_glb(tmp_path, a_place())
    cloud, out = read_cloud(path), tmp_path / f"out{path.suffix}"
    matrix, _ = motion(size=0.37)
    write_moved(out, cloud, matrix)
    before, after = cloud.points[:400], read_cloud(out).points[:400]
    lengths = [np.linalg.norm(p[:, None] - p[None], axis=2) for p in (before, after)]
    # Each of two ends is rounded in three coordinates, in the units of the node.
    rounding = np.finfo(np.float32).eps * np.abs(cloud.points).max() * 0.37 + 4e-7
    assert np.abs(lengths[1] - 0.37 * lengths[0]).max() <= 4.0 * rounding
    np.testing.assert_array_equal(read_cloud(out).faces(), cloud.faces())


@pytest.mark.parametrize("number", range(3))
def test_what_bends_after_a_motion_has_the_normals_of_the_bent_surface(tmp_path, number):
    path = files(tmp_path)[number]
    cloud, out = read_cloud(path), tmp_path / f"out{path.suffix}"
    matrix, turn = motion()
    said = write_moved(out, cloud, matrix, bent(moved(matrix, cloud.points)))
    normals = unit(read_cloud(out).source.read_normals())
    expected = unit(cloud.source.read_normals()) @ turn.T
    angles = np.degrees(np.arccos(np.clip((normals * expected).sum(1), -1.0, 1.0)))
    if path.suffix == ".ply":
        assert said == [
            f"{out}: the normals are those of {path}, moved with the whole cloud, "
            "before the points moved further"
        ]
        assert angles.max() < 1e-2
    else:
        assert said == []
        assert 1.0 < angles.max() < 12.0
        surface = trimesh.Trimesh(read_cloud(out).points, cloud.faces(), process=False)
        cosines = (normals * surface.vertex_normals).sum(1)
        assert np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0))).max() < 3.0


def test_normals_that_lean_turn_with_the_motion_before_they_turn_with_the_bend(tmp_path):
    """From two surfaces alone nobody could tell how a leaning normal turned about the true one."""
    grid = np.stack(np.meshgrid(np.arange(5.0), np.arange(5.0)), -1).reshape(-1, 2)
    corners = [(k, k + 1, k + 6, k + 5) for k in range(20) if k % 5 < 4]
    text = "".join(f"v {x} {y} 0\n" for x, y in grid) + "vn 0.8 0 0.6\nvn 0 1 0\n"
    text += "".join("f " + " ".join(f"{c + 1}//1" for c in face) + "\n" for face in corners)
    (tmp_path / "a.obj").write_text(text)
    cloud = read_cloud(tmp_path / "a.obj")
    matrix = trimesh.transformations.rotation_matrix(1.2, [0, 0, 1])
    further = moved(matrix, cloud.points) + 1e-3 * np.sin(cloud.points[:, [2, 2, 0]] * [0, 0, 1])
    write_moved(tmp_path / "b.obj", cloud, matrix, further)
    lines = (tmp_path / "b.obj").read_text().splitlines()
    found = np.array([line.split()[1:] for line in lines if line[:2] == "vn"], dtype=float)
    expected = np.array([[0.8, 0.0, 0.6], [0.0, 1.0, 0.0]]) @ matrix[:3, :3].T
    np.testing.assert_allclose(found, expected, atol=2e-3)


def test_normals_of_an_obj_turn_even_if_no_face_has_them(tmp_path):
    text = "o a # one\nv 0 0 0\nv 1.50 0 0\nv 0 1 0\nvn 0 0 1.000\nvn 1 0 0\nf 1 2 3\n"
    (tmp_path / "a.obj").write_text(text)
    cloud = read_cloud(tmp_path / "a.obj")
    assert write_moved(tmp_path / "b.obj", cloud, QUARTER) == []
    assert (tmp_path / "b.obj").read_text() == (
        "o a # one\nv 0.5 4.0 -1.0\nv 0.5 7.0 -1.0\nv -1.5 4.0 -1.0\n"
        "vn 0 0 1.000\nvn 0.0 1.0 0\nf 1 2 3\n"
    )
    write_moved(tmp_path / "b.obj", cloud, QUARTER, bent(moved(QUARTER, cloud.points)))
    assert "\nvn 0 0 1.000\nvn 0.0 1.0 0\n" in (tmp_path / "b.obj").read_text()


@pytest.mark.filterwarnings("error")
def test_normals_that_are_not_finite_stay_so_without_a_word(tmp_path):
    text = "v 0 0 0\nv 1.5 0 0\nv 0 1 0\nvn inf 0 1\nvn 1 0 0\nf 1//1 2//2 3//2\n"
    (tmp_path / "a.obj").write_text(text)
    cloud = read_cloud(tmp_path / "a.obj")
    points = moved(QUARTER, cloud.points)
    for matrix in (QUARTER, None):
        write_cloud(tmp_path / "b.obj", points, like=cloud, overwrite=True, matrix=matrix)
        lines = (tmp_path / "b.obj").read_text().splitlines()[3:5]
        first, second = np.array([line.split()[1:] for line in lines], dtype=float)
        assert not np.isfinite(first).all()
        np.testing.assert_allclose(second, [0.0, 1.0, 0.0], atol=1e-6)


def on_a_line(tmp_path, points, normals):
    """A file of each kind whose vertices lie on a line, with faces and with normals."""
    columns = columns_of("xyz", "float", points) | columns_of(("nx", "ny", "nz"), "float", normals)
    (tmp_path / "l.ply").write_bytes(a_ply("binary_little_endian", columns))
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in points.tolist()]
    lines += [f"vn {x!r} {y!r} {z!r}" for x, y, z in normals.tolist()]
    lines += [f"f {k + 1}//{k + 1} {k + 2}//{k + 2} {k + 3}//{k + 3}" for k in range(0, 6, 3)]
    (tmp_path / "l.obj").write_text("\n".join(lines))
    primitive = {"attributes": {"POSITION": 0, "NORMAL": 1}}
    a_scene(tmp_path / "l.glb", [np.eye(4)], [primitive], [points, normals])
    return [tmp_path / f"l{suffix}" for suffix in (".obj", ".ply", ".glb")]


@pytest.mark.parametrize("number", range(3))
def test_normals_turn_about_an_axis_on_which_all_points_stay(tmp_path, number):
    path = on_a_line(tmp_path, (LINE * [0, 0, 1]).astype("f4"), directions(1))[number]
    cloud, out = read_cloud(path), tmp_path / f"out{path.suffix}"
    turn = QUARTER * [[0.5, 0.5, 0.5, 0.0]] + np.diag([0.0, 0.0, 0.0, 1.0])
    assert np.array_equal(moved(turn, cloud.points), cloud.points)
    assert write_moved(out, cloud, turn) == []
    normals = read_cloud(out).source.read_normals()
    expected = cloud.source.read_normals() @ turn[:3, :3].T
    np.testing.assert_allclose(normals, expected, atol=2e-7)


@pytest.mark.parametrize("number", range(3))
def test_points_may_be_rounded_on_their_way(tmp_path, number):
    """Here so that faces without area would turn normals anywhere, if they were asked."""
    path = on_a_line(tmp_path, LINE / np.float32(7.0), directions(1))[number]
    cloud, out = read_cloud(path), tmp_path / f"out{path.suffix}"
    # The text of an .obj file has as many digits as it needs.
    for shift in (0.5,) if path.suffix == ".obj" else (0.5, 2000.0):
        matrix, turn = motion(shift=(shift, 0.0, 0.0))
        rounded = moved(matrix, cloud.points).astype(np.float32).astype(float)
        assert not np.array_equal(rounded, moved(matrix, cloud.points))
        assert write_moved(out, cloud, matrix, rounded) == []
        normals = read_cloud(out).source.read_normals()
        expected = cloud.source.read_normals() @ turn.T
        np.testing.assert_allclose(normals, expected, atol=2e-7)


@pytest.mark.parametrize("number", [0, 2, 3])
def test_what_moves_on_as_a_whole_turns_its_normals_further(tmp_path, number):
    path = files(tmp_path)[number]
    cloud, out = read_cloud(path), tmp_path / f"out{path.suffix}"
    (first, turn), (then, further) = motion(), motion(0.9, 20.0)
    assert write_moved(out, cloud, first, moved(then, moved(first, cloud.points))) == []
    normals = read_cloud(out).source.read_normals()
    expected = cloud.source.read_normals() @ turn.T @ further.T
    np.testing.assert_allclose(normals, expected, atol=2e-6)


def test_normals_that_are_not_three_numbers_stay_with_a_warning(save, tmp_path):
    columns = columns_of("xyz", "float", POINTS) | columns_of(("nx", "ny"), "float", NORMALS[:, :2])
    cloud = read_cloud(save("a.ply", a_ply("ascii", columns)))
    matrix, _ = motion()
    says = [f"{tmp_path}/b.ply: the normals are those of {tmp_path}/a.ply, before the points moved"]
    for points in (moved(matrix, POINTS), bent(moved(matrix, POINTS))):
        assert write_moved(tmp_path / "b.ply", cloud, matrix, points) == says
    assert write_moved(tmp_path / "b.ply", cloud, motion(degrees=0.0)[0]) == []


def test_a_new_ply_gets_the_normals_of_a_cloud_that_moved_as_one(tmp_path):
    path = files(tmp_path)[0]
    cloud = read_cloud(path)
    matrix, turn = motion()
    assert write_moved(tmp_path / "b.ply", cloud, matrix) == []
    normals = read_cloud(tmp_path / "b.ply").source.read_normals()
    np.testing.assert_allclose(normals, cloud.source.read_normals() @ turn.T, atol=2e-7)
    said = write_moved(tmp_path / "b.ply", cloud, matrix, bent(moved(matrix, cloud.points)))
    assert said == [f"{path}: its normals do not go into .ply; write .obj to keep them"]


@pytest.mark.parametrize(
    ("matrix", "says"),
    [
        (np.eye(3), r"the matrix of a motion has shape \[3, 3\], expected \[4, 4\]"),
        (np.diag([-1.0, 1.0, 1.0, 1.0]), "does not keep shapes, expected a rotation with one"),
        (np.diag([1.0, 1.0, 1.001, 1.0]), "does not keep shapes"),
        (np.diag([0.0, 0.0, 0.0, 1.0]), "does not keep shapes"),
        (np.diag([1.0, 1.0, 1.0, 2.0]), "does not keep shapes"),
        (np.diag([1.0, 1.0, np.nan, 1.0]), "does not keep shapes"),
        (np.array([[1, 0, 0, np.inf], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]), "keep shapes"),
        ([["a"] * 4] * 4, "is not an array of real numbers"),
    ],
)
def test_a_matrix_that_does_not_keep_shapes_is_refused(tmp_path, matrix, says):
    cloud = read_cloud(BOX)
    assert_refused(says, write_cloud, tmp_path / "b.ply", cloud.points, cloud, matrix=matrix)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("far", [0.0, 4e6])
def test_coordinates_far_from_the_origin_move_as_one_or_bend_as_near_it(save, tmp_path, far):
    columns = columns_of("xyz", "double", POINTS + far)
    columns |= columns_of(("nx", "ny", "nz"), "float", NORMALS)
    cloud = read_cloud(save("a.ply", a_ply("binary_little_endian", columns)))
    matrix, _ = motion()
    assert write_moved(tmp_path / "b.ply", cloud, matrix) == []
    further = moved(matrix, cloud.points) + 1e-4 * POINTS[:, [1, 2, 0]]
    (said,) = write_moved(tmp_path / "b.ply", cloud, matrix, further)
    assert "the normals are those of" in said


# Scenes of which every part is known.


def a_scene(path, nodes, primitives, accessors, same_bytes=()):
    """A GLB: nodes with a mesh each, whose primitives are ``primitives``, and float accessors.

    ``same_bytes`` : pairs of accessors of which the second lies where the first does.
    """
    views, listed, binary = [], [], b""
    for number, values in enumerate(accessors):
        first = {b: a for a, b in same_bytes}.get(number, number)
        if first == number:
            data = values.tobytes()
            views.append({"buffer": 0, "byteOffset": len(binary), "byteLength": len(data)})
            binary += data + bytes(-len(data) % 4)
        else:
            views.append(views[first])
        form = {3: "VEC3", 4: "VEC4"}[values.shape[1]]
        component = 5126 if values.dtype == np.float32 else 5120
        listed.append(
            {"bufferView": number, "componentType": component, "count": len(values), "type": form}
        )
    document = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": list(range(len(nodes)))}],
        "nodes": [{"mesh": i, "name": f"n{i}", "matrix": node.T.ravel().tolist()}
                  for i, node in enumerate(nodes)],
        "meshes": [{"primitives": [one]} if isinstance(one, dict) else {"primitives": one}
                   for one in primitives],
        "accessors": listed, "bufferViews": views, "buffers": [{"byteLength": len(binary)}],
    }  # fmt: skip
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text
    chunks += struct.pack("<I4s", len(binary), b"BIN\0") + binary
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)
    return read_cloud(path)


def stored(path, number):
    """The values of a float accessor."""
    document, binary = parts_of(path.read_bytes())
    accessor = document["accessors"][number]
    width = {"VEC3": 3, "VEC4": 4}[accessor["type"]]
    start = document["bufferViews"][accessor["bufferView"]]["byteOffset"]
    values = np.frombuffer(binary, "<f4", width * accessor["count"], start)
    return values.reshape(-1, width).astype(float)


def directions(seed, width=3):
    values = unit(np.random.default_rng(seed).normal(size=(6, 3)))
    return np.c_[values, np.tile([1.0, -1.0], 3)][:, :width].astype(np.float32)


def vertices(seed):
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (6, 3)).astype(np.float32)


SHEAR = a_place() @ np.array([[1, 0.6, 0, 0], [0, 0.5, 0.2, 0], [0, 0, 1.5, 0], [0, 0, 0, 1.0]])
LINE = (np.arange(6.0)[:, None] * [1.0, 2.0, -1.0]).astype(np.float32)


@pytest.mark.parametrize("mode", [0, 1, 4], ids=["points", "lines", "triangles"])
@pytest.mark.parametrize("at", [np.eye(4), a_place(), SHEAR], ids=["origin", "place", "shear"])
@pytest.mark.parametrize("places", [vertices(0), LINE], ids=["solid", "on a line"])
def test_normals_and_tangents_of_a_scene_turn_exactly_in_the_world(tmp_path, mode, at, places):
    attributes = {"POSITION": 0, "NORMAL": 1, "TANGENT": 2}
    normals, tangents = directions(1), directions(2, 4)
    cloud = a_scene(
        tmp_path / "a.glb", [at], [{"attributes": attributes, "mode": mode}],
        [places, normals, tangents],
    )  # fmt: skip
    matrix, turn = motion()
    assert write_moved(tmp_path / "b.glb", cloud, matrix) == []
    np.testing.assert_allclose(
        read_cloud(tmp_path / "b.glb").points, moved(matrix, cloud.points), atol=1e-5
    )
    linear = at[:3, :3]
    for number, to_world in ((1, np.linalg.inv(linear).T), (2, linear)):
        before, after = (stored(tmp_path / name, number) for name in ("a.glb", "b.glb"))
        np.testing.assert_allclose(
            unit(after[:, :3] @ to_world.T), unit(before[:, :3] @ to_world.T) @ turn.T, atol=1e-6
        )
        np.testing.assert_allclose(np.linalg.norm(after[:, :3], axis=1), 1.0, atol=1e-6)
        assert np.array_equal(after[:, 3:], before[:, 3:])


@pytest.mark.parametrize("same_bytes", [(), ((1, 3),)], ids=["one accessor", "two accessors"])
def test_normals_that_meshes_share_turn_once(tmp_path, same_bytes):
    """Of two primitives of a node, and of two nodes that stand alike."""
    normals, second = directions(1), 3 if same_bytes else 1
    one = {"attributes": {"POSITION": 0, "NORMAL": 1}}
    other = {"attributes": {"POSITION": 2, "NORMAL": second}}
    shifted = a_place()
    shifted[:3, 3] += 1.0
    shifted[:3, :3] *= 3.0
    matrix, turn = motion()
    for nodes, primitives in (([a_place()], [[one, other]]), ([a_place(), shifted], [one, other])):
        cloud = a_scene(
            tmp_path / "a.glb", nodes, primitives,
            [vertices(0), normals, vertices(3), normals], same_bytes,
        )  # fmt: skip
        assert write_moved(tmp_path / "b.glb", cloud, matrix) == []
        after = read_cloud(tmp_path / "b.glb").source.read_normals()
        np.testing.assert_allclose(after, cloud.source.read_normals() @ turn.T, atol=1e-6)


def test_directions_of_a_scene_that_cannot_turn_stay_with_a_warning(tmp_path):
    """Shared by nodes that stand differently, stored as whole numbers, or vertices as well."""
    one = {"attributes": {"POSITION": 0, "NORMAL": 1, "TANGENT": 3}}
    other = {"attributes": {"POSITION": 2, "NORMAL": 1}}
    arrays = [vertices(0), directions(1), vertices(3), directions(2, 4)]
    small = [*arrays[:3], np.zeros((6, 4), np.int8)]
    both = {"attributes": {"POSITION": 0, "NORMAL": 0}}
    matrix, turn = motion()
    out = tmp_path / "b.glb"
    for nodes, primitives, accessors, says, stay in (
        ([a_place(), np.eye(4)], [one, other], arrays, "normals", [1]),
        ([a_place()], [[one, other]], small, "tangents", []),
        ([a_place(), np.eye(4)], [one, other], small, "normals and tangents", [1]),
        ([a_place()], [both], arrays, "normals", []),
    ):
        cloud = a_scene(tmp_path / "a.glb", nodes, primitives, accessors)
        said = write_moved(out, cloud, matrix)
        assert said == [f"{out}: the {says} are those of {tmp_path}/a.glb, before the points moved"]
        for number in stay:
            assert np.array_equal(stored(out, number), stored(tmp_path / "a.glb", number))
        again = read_cloud(out)
        np.testing.assert_allclose(again.points, moved(matrix, cloud.points), atol=1e-5)
        if says == "tangents":
            expected = cloud.source.read_normals() @ turn.T
            np.testing.assert_allclose(again.source.read_normals(), expected, atol=1e-6)
        # What only shifts and grows turns nothing.
        assert write_moved(out, cloud, motion(degrees=0.0)[0]) == []


def test_vertices_that_are_normals_as_well_are_where_they_belong(tmp_path):
    """A tool that stores equal values once makes such a file of a ball of radius 1."""
    primitive = {"attributes": {"POSITION": 0, "NORMAL": 0}}
    cloud = a_scene(tmp_path / "a.glb", [np.eye(4)], [primitive], [directions(1)])
    matrix, _ = motion()
    for given in (None, matrix):
        write_moved(tmp_path / "b.glb", cloud, given, moved(matrix, cloud.points))
        after = read_cloud(tmp_path / "b.glb").points
        np.testing.assert_allclose(after, moved(matrix, cloud.points), atol=1e-6)


def test_a_part_of_a_scene_that_stays_rigid_turns_exactly_though_another_bends(tmp_path):
    nodes = [a_place(), SHEAR]
    primitives = [{"attributes": {"POSITION": k, "NORMAL": k + 1}, "mode": 0} for k in (0, 2)]
    cloud = a_scene(
        tmp_path / "a.glb", nodes, primitives, [LINE, directions(1), vertices(3), directions(4)]
    )
    matrix, turn = motion()
    points = moved(matrix, cloud.points)
    points[6:] = bent(points[6:])
    write_moved(tmp_path / "b.glb", cloud, matrix, points)
    after = read_cloud(tmp_path / "b.glb").source.read_normals()
    # Points without faces bend no normals: these turn with the motion alone.
    np.testing.assert_allclose(after, cloud.source.read_normals() @ turn.T, atol=1e-6)
