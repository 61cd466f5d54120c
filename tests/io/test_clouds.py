"""Point clouds survive reading and writing; what is not a cloud is refused in one line."""

import os
import re
import struct

import numpy as np
import pytest
import trimesh

from tests.corruption import assert_reads_or_refuses, assert_refused
from tso_cli.errors import InputError, TsoError
from tso_cli.io.clouds import read_cloud, write_cloud
from tso_cli.io.shapes import read_shape

POINTS = np.array([[0.1, -2.5, 3.0], [1e-7, 4.25, -0.0], [7.0, 1 / 3, -9.875], [0.5, 0.5, 0.5]])
FACES = [[0, 1, 2], [0, 1, 2, 3], [1, 2, 3]]
CODES = {
    "float": "f",
    "double": "d",
    "uchar": "B",
    "int": "i",
    "short": "h",
    "char": "b",
    "uint": "I",
    "ushort": "H",
}


def a_ply(form, kind="float", eol="\n", faces=FACES, extra_first=False, lists=None, points=POINTS):
    """A PLY file with comments, colours, an attribute between coordinates, perhaps other rows."""
    order = ORDERS[form]
    lines = ["ply", f"format {form} 1.0", "comment element vertex 99", "obj_info by hand"]
    body = []

    def row(*columns):  # pairs (kind, value), value a list for a list with a uchar count
        parts = [
            (f"B{len(v)}{CODES[k]}", [len(v), *v]) if isinstance(v, list) else (CODES[k], [v])
            for k, v in columns
        ]
        if order is None:
            body.append(
                ("  ".join(str(word) for _, words in parts for word in words) + " " + eol).encode()
            )
        else:
            body.extend(struct.pack(order + codes, *values) for codes, values in parts)

    if extra_first:
        lines += ["element camera 2", "property list uchar short ids", "property double focal"]
        row(("short", [5, 6]), ("double", 1.5))
        row(("short", [-7]), ("double", 2.5))
    lines += [
        f"element vertex {len(points)}",
        f"property {kind} x",
        "property uchar red",
        f"property {kind} y",
    ]
    if lists:
        lines += ["property list uchar int neighbours"]
    lines += [f"property  {kind} z", "property float32 quality"]
    for i, (x, y, z) in enumerate(points.tolist()):
        x, y, z = (v if kind in ("float", "double") else int(v) for v in (x, y, z))
        middle = [("int", lists[i])] if lists else []
        row((kind, x), ("uchar", 200 + i), (kind, y), *middle, (kind, z), ("float", 0.25 * i))
    lines += [
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "property uchar flag",
    ]
    for i, face in enumerate(faces):
        row(("int", face), ("uchar", i))
    return (eol.join([*lines, "end_header"]) + eol).encode() + b"".join(body)


# What precedes the numbers of a binary row in the terms of `struct`.
ORDERS = {"ascii": None, "binary_little_endian": "<", "binary_big_endian": ">"}
SHAPES = [
    {},
    {"eol": "\r\n"},
    {"eol": "\r"},
    {"extra_first": True},
    {"faces": []},
    {"lists": [[1], [], [0, 3], [2]]},
]
every_shape = pytest.mark.parametrize("shape", SHAPES, ids=str)
every_form = pytest.mark.parametrize("form", ORDERS)


@every_form
@pytest.mark.parametrize("kind", ["float", "double", "int"])
@every_shape
def test_vertices_are_read_wherever_they_stand_and_unmoved_give_the_same_bytes(
    save, tmp_path, form, kind, shape
):
    source = save("a.ply", a_ply(form, kind, **shape))
    cloud = read_cloud(source)
    exact = POINTS if kind == "double" or form == "ascii" else POINTS.astype(np.float32)
    assert np.array_equal(cloud.points, np.trunc(POINTS) if kind == "int" else exact)
    assert cloud.points.dtype == np.float64
    write_cloud(tmp_path / "b.ply", cloud.points.copy(), like=cloud)
    assert (tmp_path / "b.ply").read_bytes() == source.read_bytes()


@every_form
@pytest.mark.parametrize(
    "faces", [FACES, FACES[:1], [[2, 1, 0], [1, 2, 3]], [], [[], [1], [0, 3]]], ids=str
)
def test_faces_are_read_as_triangles(save, form, faces):
    triangles = read_cloud(save("a.ply", a_ply(form, faces=faces, extra_first=True))).faces()
    # A quad of points that do not lie in one plane may be cut along either diagonal.
    cuts = [
        {frozenset([face[0], *face[k : k + 2]]) for face in faces for k in range(1, len(face) - 1)}
        for faces in (faces, [[*face[1:], *face[:1]] for face in faces])
    ]
    assert triangles is None if not faces else set(map(frozenset, triangles.tolist())) in cuts


@every_form
@pytest.mark.parametrize("wrong", [4, -1])
def test_a_face_of_a_point_that_is_not_there_is_refused(save, form, wrong):
    cloud = read_cloud(save("a.ply", a_ply(form, faces=[[0, 1, 2], [0, 1, 2, wrong]])))
    assert_refused(f"a.ply: a face names vertex {wrong}, expected 0 to 3", cloud.faces)


@every_form
@pytest.mark.parametrize("kind", ["float", "double", "int"])
@every_shape
def test_moved_points_change_their_coordinates_and_nothing_else(save, tmp_path, form, kind, shape):
    """The expected file is a new file with the moved points; integers become double."""
    cloud = read_cloud(save("a.ply", a_ply(form, kind, **shape)))
    moved = (POINTS * 1.5 + 0.1).astype(np.float32).astype(np.float64)
    write_cloud(tmp_path / "b.ply", moved, like=cloud)
    written = (tmp_path / "b.ply").read_bytes()
    expected = a_ply(form, "double" if kind == "int" else kind, points=moved, **shape)
    if form == "ascii":  # blanks, words and numbers
        assert np.array_equal(
            read_cloud(tmp_path / "b.ply").points.astype(np.float32), moved.astype(np.float32)
        )
        written, expected = (
            re.sub(rb"[0-9.][0-9.e-]*", b"0", data) for data in (written, expected)
        )
    assert written == expected


@every_form
@every_shape
def test_moving_one_point_rewrites_that_point_alone(save, tmp_path, form, shape):
    source = a_ply(form, **shape)
    cloud = read_cloud(save("a.ply", source))
    moved = cloud.points.copy()
    moved[2, 1] = 0.625
    write_cloud(tmp_path / "b.ply", moved, like=cloud)
    written = (tmp_path / "b.ply").read_bytes()
    old, new = b"0.3333333333333333", b"0.625"
    if form != "ascii":
        old, new = (struct.pack(ORDERS[form] + "f", value) for value in (1 / 3, 0.625))
    assert source.count(old) == 1
    assert written == source.replace(old, new)


def test_coordinates_may_stand_in_any_order(save, tmp_path):
    """x, y, z are known by name: here z comes first and y last."""
    axes = "".join(f"property {{0}} {axis}\n" for axis in "zxy")
    head = f"ply\nformat ascii 1.0\nelement vertex 2\n{axes}end_header\n"
    cloud = read_cloud(save("a.ply", head.format("int") + "1 2 3\n4 5 6\n"))
    assert cloud.points.tolist() == [[2, 3, 1], [5, 6, 4]]
    write_cloud(tmp_path / "b.ply", cloud.points + [0.5, 0.25, 0.0], like=cloud)
    assert (tmp_path / "b.ply").read_text() == head.format("double") + "1 2.5 3.25\n4 5.5 6.25\n"


def test_a_body_may_begin_with_the_byte_of_a_line_break(save):
    """If header lines end in a bare carriage return, a line feed after it is part of a number."""
    head = HEAD.format(2).replace("ascii", "binary_little_endian").replace("\n", "\r").encode()
    body = b"\n\0\x80\x3f" + np.array([1, 2, 3, 4, 5], dtype="<f4").tobytes()
    points = read_cloud(save("a.ply", head + body)).points
    assert np.array_equal(points.ravel(), np.frombuffer(body, "<f4"))


@pytest.mark.filterwarnings("error")
def test_numbers_that_signal_are_not_finite_like_any_other(save):
    head = HEAD.format(2).replace("ascii", "binary_big_endian").encode()
    path = save("a.ply", head + bytes(20) + b"\x7f\x80\0\x01")
    assert_refused("1 of 2 points have a coordinate that is not finite", read_cloud, path)


@pytest.mark.filterwarnings("error")
def test_text_is_written_in_the_digits_of_its_type_or_in_as_many_as_it_has(save, tmp_path):
    head = HEAD.format(2).replace("float z", "double z")
    cloud = read_cloud(save("a.ply", head + "0.5 1 2\n0.25 1.50 3"))
    write_cloud(tmp_path / "b.ply", cloud.points + [0.1, 0, 0.1], like=cloud)
    assert (tmp_path / "b.ply").read_text() == head + "0.6 1 2.1\n0.35 1.50 3.1"
    cloud = read_cloud(save("scan.ply", head + "4000000.123456 1 2\n4000001.123456 1 2\n"))
    moved = cloud.points + np.array([0.000001, 0, 0])
    with pytest.warns(
        UserWarning,
        match="its coordinates are stored as float, as in .*: rounding moves points by up to",
    ):
        write_cloud(tmp_path / "c.ply", moved, like=cloud)
    assert np.array_equal(read_cloud(tmp_path / "c.ply").points, moved)


@pytest.mark.filterwarnings("error")
def test_old_normals_stay_with_a_warning(save, tmp_path):
    head = HEAD.format(2).replace("end_header", XYZ.replace("float ", "float n") + "end_header")
    cloud = read_cloud(save("n.ply", head + "0 0 0 0 0 1\n1 1 1 0 1 0\n"))
    with pytest.warns(UserWarning, match=r"b\.ply: the normals are those of .*n\.ply"):
        write_cloud(tmp_path / "b.ply", cloud.points + 1.0, like=cloud)
    assert b" 0 0 1\n" in (tmp_path / "b.ply").read_bytes()
    write_cloud(tmp_path / "c.ply", cloud.points, like=cloud)


def test_of_gaussian_splats_only_the_places_move_and_a_warning_says_so(save, tmp_path):
    more = "".join(
        f"property float {name}\n"
        for name in ("opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1")
    )
    head = HEAD.format(2).replace("end_header", more + "end_header")
    cloud = read_cloud(save("splat.ply", head + "0 0 0 1 2 3 4 5 6\n1 1 1 6 5 4 3 2 1\n"))
    with pytest.warns(
        UserWarning, match=r"b\.ply: the rotations and scales are those of .*splat\.ply"
    ):
        write_cloud(tmp_path / "b.ply", cloud.points + 1.0, like=cloud)
    assert b" 1 2 3 4 5 6\n" in (tmp_path / "b.ply").read_bytes()


def test_a_new_cloud_is_written_in_the_precision_of_its_source_or_as_asked(save, tmp_path):
    write_cloud(tmp_path / "a.ply", POINTS, dtype="float32")
    write_cloud(
        tmp_path / "b.ply", POINTS, like=read_cloud(save("b.xyz", "0 0 0\n1 1 1\n2 2 2\n3 3 3"))
    )
    for name, dtype in (("a", "float32"), ("b", "float64")):
        cloud = read_cloud(tmp_path / f"{name}.ply")
        assert np.array_equal(cloud.points, POINTS.astype(dtype))
        assert cloud.precision == dtype
    far = 4e6 + np.random.default_rng(0).random((100, 3))
    write_cloud(tmp_path / "far.ply", far)
    assert np.array_equal(read_cloud(tmp_path / "far.ply").points, far)
    assert np.array_equal(
        trimesh.load(tmp_path / "a.ply", process=False).vertices, POINTS.astype(np.float32)
    )


def test_arrays_and_tables_are_clouds_too(save, tmp_path):
    arrays = {
        "a.npy": POINTS,
        "b.npy": POINTS.astype(np.float32),
        "c.npy": np.asfortranarray(POINTS),
        "d.npy": POINTS.astype(">f8"),
    }
    for name, array in arrays.items():
        np.save(tmp_path / name, array)
        assert np.array_equal(read_cloud(tmp_path / name).points, array), name
    assert read_cloud(tmp_path / "b.npy").precision == "float32"
    text = "# a comment\n\n" + "\n".join(" ".join(map(repr, row)) for row in POINTS.tolist())
    assert np.array_equal(read_cloud(save("a.xyz", text)).points, POINTS)
    assert np.array_equal(
        read_cloud(save("a.TXT", text.replace("\n", "\r\n").replace(" ", "\t"))).points, POINTS
    )
    with pytest.warns(UserWarning, match=r"six\.xyz: only the first three"):
        assert np.array_equal(
            read_cloud(save("six.xyz", "1 2 3 255 0 0\n4 5 6 255 0 0\n")).points,
            [[1, 2, 3], [4, 5, 6]],
        )


XYZ = "property float x\nproperty float y\nproperty float z\n"
HEAD = f"ply\nformat ascii 1.0\nelement vertex {{}}\n{XYZ}end_header\n"
BAD_PLY = {
    "empty": ("", "is empty"),
    "not a ply": ("solid cube\nfacet", "not a PLY file"),
    "no end of header": ("ply\nformat ascii 1.0\nelement vertex 2\n", "no end_header"),
    "no format": (f"ply\nelement vertex 2\n{XYZ}end_header\n0 0 0\n1 1 1\n", "no format"),
    "unknown format": (HEAD.format(2).replace("ascii", "morse") + "0 0 0\n1 1 1\n", "morse"),
    "other version": (HEAD.format(2).replace("1.0", "2.0") + "0 0 0\n1 1 1\n", "version 1.0"),
    "no vertices": (
        HEAD.format(2).replace("vertex", "vertices") + "0 0 0\n1 1 1\n", "no vertex element",
    ),
    "no z": (
        HEAD.format(2).replace("float z", "float depth") + "0 0 0\n1 1 1\n",
        r"no z \(properties: 'x, y, depth'\)",
    ),
    "list for x": (
        HEAD.format(2).replace("float x", "list uchar float x") + "1 0 0 0\n1 1 1 1\n",
        "x .* is a list",
    ),
    "x twice": (
        HEAD.format(2).replace("float y", "float x") + "0 0 0\n1 1 1\n", "no other property",
    ),
    "vertex twice": (
        HEAD.format(2).replace("end_header", "element vertex 2\nend_header") + "0 0 0\n1 1 1\n",
        "no other element",
    ),
    "unknown type": (
        HEAD.format(2).replace("float y", "quad y") + "0 0 0\n1 1 1\n", "types of PLY 1.0",
    ),
    "list with a float length": (
        HEAD.format(2).replace("end_header", "property list float int a\nend_header") + "0 0 0 0\n",
        "integers for lengths",
    ),
    "one point": (HEAD.format(1) + "0 0 0\n", "1 point, expected at least 2"),
    "cut line": (HEAD.format(2) + "0 0 0\n1 1", "line 9 has 2 values, expected 3"),
    "too many": (
        HEAD.format(2) + "0 0 0\n1 1 1\n2 2 2\n", "has 3 lines of data, the header describes 2",
    ),
    "impossible count": (HEAD.format(10**30) + "0 0 0\n1 1 1\n", "element .*and a count"),
    "words": (HEAD.format(2) + "0 0 0\n1 one 1\n", "line 9 has 'one', expected a number"),
    "not finite": (
        HEAD.format(4) + "0 0 0\n1 1 1\n1 nan 1\n2 inf 2\n",
        "2 of 4 points .*not finite.* point 2 ",
    ),
    "huge number": (HEAD.format(2) + "0 0 0\n1 1e200 1\n", "coordinate of 1e\\+200"),
    "all the same": (
        HEAD.format(3) + "1 2 3\n" * 3, r"all 3 points are the same \[1.0, 2.0, 3.0\]",
    ),
    "a wide word": (HEAD.format(2) + "0 0 0\n1 1 " + "1" * 2000, "expected a number"),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD_PLY)
def test_what_is_not_a_cloud_is_refused_in_one_line(save, case):
    content, message = BAD_PLY[case]
    assert_refused(rf"bad\.ply: .*{message}", read_cloud, save("bad.ply", content))


@pytest.mark.parametrize("form", [form for form, order in ORDERS.items() if order])
@every_shape
def test_a_binary_body_of_another_length_than_the_header_says_is_refused(save, form, shape):
    data = a_ply(form, **shape)
    start = data.index(b"end_header") + len("end_header" + shape.get("eol", "\n"))
    for end in range(start, len(data), 3):
        assert_refused(
            r"a\.ply: ends after \d of \d rows of element", read_cloud, save("a.ply", data[:end])
        )
    assert_refused(r"3 bytes follow the data", read_cloud, save("a.ply", data + b"abc"))
    assert len(read_cloud(save("a.ply", data + b"\n")).points) == 4


@every_form
def test_a_count_that_lies_allocates_nothing(save, form):
    for element, count in ((b"vertex", b"4"), (b"face", b"3")):
        data = a_ply(form).replace(element + b" " + count, element + b" 900000000000000000")
        assert_refused(
            f"of 900000000000000000 rows of element '{element.decode()}'",
            read_cloud,
            save("a.ply", data),
        )


def test_files_that_cannot_be_opened_are_refused(save, tmp_path):
    (tmp_path / "folder.ply").mkdir()
    os.mkfifo(tmp_path / "pipe.ply")
    save("file", b"x")
    save("cloud.xls", b"x")
    for name, message in {
        "none.ply": r"none\.ply: does not exist",
        "folder.ply": r"folder\.ply: is a folder",
        "": "is a folder",
        "file/a.ply": "does not exist",
        "cloud.xls": r"'\.xls' .*expected \.ply, \.glb, .* \.npy, .* \.pcd",
        "a" * 3000 + ".ply": "cannot be read",
        "nul\0.ply": "cannot be read",
        "pipe.ply": "not a regular file",
    }.items():
        with pytest.raises(InputError, match=message):
            read_cloud(tmp_path / name)


class Point:
    """An entry point, as importlib.metadata gives it."""

    def __init__(self, name, read):
        self.name, self.read = name, read

    def load(self):
        return self.read


def test_a_reader_of_clouds_of_another_package_is_asked_for_its_suffix(save, tmp_path, monkeypatch):
    """As in docs/files.md: a package may register a reader."""
    import importlib.metadata as metadata

    from tests.io.cloud_plugin_example import read

    def with_faces(data, path):
        return POINTS, np.array([[0, 1, 2]])

    def fails(data, path):
        raise ValueError("of no use")

    registered = {"f32": read, "las": with_faces, "bad": fails, "two": lambda data, path: [[1, 2]]}
    monkeypatch.setattr(
        metadata, "entry_points", lambda group: [Point(*item) for item in registered.items()]
    )
    cloud = read_cloud(save("a.F32", POINTS.astype("<f4").tobytes()))
    assert np.array_equal(cloud.points, POINTS.astype("f4"))
    assert cloud.precision == "float32"
    cloud = read_cloud(save("a.las", b"LASF"))  # a suffix that is known and not read by tso
    assert np.array_equal(cloud.points, POINTS)
    assert cloud.faces().tolist() == [[0, 1, 2]]
    assert np.array_equal(read_shape(tmp_path / "a.F32"), POINTS.astype("f4"))
    assert_refused(
        r"a\.bad: the reader of \.bad that another package registered failed \(ValueError: of no",
        read_cloud, save("a.bad", b"x"),
    )  # fmt: skip
    assert_refused(r"a\.two: holds int64 \[1, 2\], expected", read_cloud, save("a.two", b"x"))
    assert_refused(r"\.pcd, \.f32, \.las, \.bad", read_cloud, save("a.other", b"x"))


def npy(kind, shape, size):
    """A .npy file with a header of our own and ``size`` zero bytes."""
    header = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}}}\n".encode()
    return np.lib.format.magic(1, 0) + len(header).to_bytes(2, "little") + header + bytes(size)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (np.zeros((4, 2)), r"float64 \[4, 2\], expected numbers \[N, 3\]"),
        (np.zeros((2, 3), dtype=bool), "bool"),
        (np.array([[{}] * 3] * 2), "object"),
        (np.zeros((0, 3)), "0 points"),
        (np.full((5, 3), np.nan), "5 of 5 points .* first is point 0"),
        (npy("<f8", (2000000000000, 3), 48), "has 48 bytes of values, expected .2000000000000, 3"),
        (npy("<f8", (2, 3), 56), "has 56 bytes of values, expected .2, 3. of float64"),
        (npy("<\x1b[", (2, 3), 48), "is not a readable"),
        ("1 2 3\n4 5\n", "line 2 has 2 columns, expected at least 3"),
        ("1 2 3\n4 5 6_0\n", "line 2 has '6_0', expected a number"),
        ("# nothing\n", "0 points"),
        ("1 2 3\x00\n4 5 6", "line 1 has .*expected a number"),
    ],
)
def test_arrays_and_tables_that_are_no_clouds_are_refused(save, content, message):
    path = save("a.xyz" if isinstance(content, str) else "a.npy", content)
    assert_refused(rf"{path.name}: .*{message}", read_cloud, path)


def test_nothing_is_written_for_points_that_cannot_be(save, tmp_path):
    cloud = read_cloud(save("a.ply", a_ply("binary_little_endian")))
    for points, error, message in [
        (np.vstack([POINTS[:3], [np.nan, 0.5, 0.5]]), TsoError, r"b\.ply: point 3 is not finite"),
        (POINTS[:3], InputError, "3 points to write, expected 4 as in .*a.ply"),
        (POINTS * 1e60, TsoError, "does not fit into float, as in .*a.ply"),
    ]:
        with pytest.raises(error, match=message):
            write_cloud(tmp_path / "b.ply", points, like=cloud)
    assert_refused(r"expected \.ply", write_cloud, tmp_path / "b.las", POINTS)
    assert [p.name for p in tmp_path.iterdir()] == ["a.ply"]


DAMAGED = {
    "ascii.ply": a_ply("ascii", extra_first=True, lists=[[1], [], [0, 3], [2]]),
    "lists.ply": a_ply(
        "binary_little_endian", "double", extra_first=True, lists=[[1], [], [0, 3], [2]]
    ),
    "big.ply": a_ply("binary_big_endian", "double", eol="\r\n", faces=FACES[:1]),
    "integers.ply": a_ply("binary_big_endian", "short", eol="\r"),
    "table.xyz": b"# table\n" + b"0.5 -1e-3 7\n1 2 3\n" * 4,
    "array.npy": POINTS.astype(np.float32),
}


@pytest.mark.parametrize("name", DAMAGED)
def test_any_damage_is_read_or_refused_in_one_line(save, tmp_path, name):
    save(name, DAMAGED[name])

    def read_and_rewrite(path):
        cloud = read_cloud(path)
        assert len(cloud.points) >= 2
        assert np.isfinite(cloud.points).all()
        write_cloud(tmp_path / "rewritten.ply", cloud.points * 0.5, like=cloud, overwrite=True)
        again = read_cloud(tmp_path / "rewritten.ply").points
        assert np.allclose(again, cloud.points * 0.5, rtol=1e-6, atol=1e-40)

    was_read, refused = assert_reads_or_refuses(read_and_rewrite, tmp_path / name, count=120)
    assert was_read > 3
    assert refused > 20


@every_form
def test_colours_are_read_as_shares_of_what_their_type_can_hold(save, form):
    assert read_cloud(save("a.ply", a_ply(form))).colours() is None
    kinds = {
        "blue": "ushort",
        "x": "float",
        "red": "uchar",
        "y": "float",
        "z": "double",
        "green": "float",
    }
    rows = [(65535, 0.5, 200, 1.0, 2.0, 0.25), (13, 1.5, 0, 1.0, 2.0, 1.0)]
    header = "".join(f"property {kind} {name}\n" for name, kind in kinds.items())
    order, codes = ORDERS[form], "".join(CODES[kind] for kind in kinds.values())
    body = [
        struct.pack(order + codes, *row) if order else " ".join(map(str, row)).encode() + b"\n"
        for row in rows
    ]
    head = f"ply\nformat {form} 1.0\nelement vertex 2\n{header}end_header\n".encode()
    cloud = read_cloud(save("b.ply", head + b"".join(body)))
    assert np.array_equal(cloud.points, [[0.5, 1.0, 2.0], [1.5, 1.0, 2.0]])
    assert np.allclose(
        cloud.colours(), [[200 / 255, 0.25, 1.0], [0.0, 1.0, 13 / 65535]], rtol=0.0, atol=1e-12
    )
    if form == "ascii":
        too_bright = save("c.ply", head + body[0].replace(b"0.25", b"200") + body[1])
        assert_refused(
            "colours span 0 to 200, expected 0 to 1",
            read_cloud(too_bright).colours,
        )
