"""Reading and writing meshes."""

import pickle
import struct

import numpy as np
import pytest
from trimesh import Scene, Trimesh, triangles

from tests.corruption import assert_reads_or_refuses, assert_refused
from tso_cli.io.meshes import SUFFIXES, Mesh, find_meshes, new_mesh, read_mesh, write_mesh

VERTICES = np.array([[0, 0, 0], [2, 0, 0], [0, 3, 0], [0, 0, 5]], dtype=np.float64)
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.int64)


def ply(vertices="0 0 0\n2 0 0\n0 3 0\n0 0 5\n", faces="3 0 2 1\n3 0 1 3\n", counts="4 2"):
    points, triangles = counts.split()
    return (
        f"ply\nformat ascii 1.0\nelement vertex {points}\n"
        "property float x\nproperty float y\nproperty float z\n"
        f"element face {triangles}\nproperty list uchar int vertex_indices\nend_header\n"
        f"{vertices}{faces}"
    )


def tetrahedron(path):
    """The tetrahedron in the format of the suffix, written by hand where the format is text."""
    corners = "".join("{:g} {:g} {:g}\n".format(*v) for v in VERTICES)
    if path.suffix == ".obj":
        text = "".join(f"v {line}\n" for line in corners.splitlines())
        path.write_text(text + "".join("f {} {} {}\n".format(*(f + 1)) for f in FACES))
    elif path.suffix == ".off":
        path.write_text(
            f"OFF\n4 4 0\n{corners}" + "".join("3 {} {} {}\n".format(*f) for f in FACES)
        )
    elif path.suffix == ".stl":
        triangles = b"".join(struct.pack("<12fH", 0, 0, 0, *VERTICES[f].ravel(), 0) for f in FACES)
        path.write_bytes(bytes(80) + struct.pack("<I", len(FACES)) + triangles)
    elif path.suffix == ".glb":
        Trimesh(VERTICES, FACES, process=False).export(path)
    elif path.suffix == ".gltf":
        files = Scene(Trimesh(VERTICES, FACES, process=False)).export(file_type="gltf")
        for name, data in files.items():
            (path if name == "model.gltf" else path.parent / name).write_bytes(data)
    else:
        write_mesh(path, Mesh(VERTICES, FACES))
    return path


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_every_format_gives_the_same_triangles(tmp_path, suffix):
    mesh = read_mesh(tetrahedron(tmp_path / f"a{suffix}"))
    assert mesh.vertices.dtype == np.float64
    assert mesh.faces.dtype == np.int64
    np.testing.assert_allclose(mesh.vertices[mesh.faces], VERTICES[FACES])
    assert mesh.paint is None


def test_a_quadrilateral_becomes_two_triangles(tmp_path):
    (tmp_path / "a.obj").write_text("v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n")
    mesh = read_mesh(tmp_path / "a.obj")
    assert len(mesh.faces) == 2
    assert triangles.area(mesh.vertices[mesh.faces]).sum() == pytest.approx(1.0)


def test_materials_colour_their_own_faces_and_parts_stay_in_place(tmp_path):
    (tmp_path / "a.mtl").write_text("newmtl red\nKd 1 0 0\nnewmtl green\nKd 0 1 0\n")
    path = tmp_path / "a.obj"
    path.write_text(
        "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 9 9 9\n"
        "usemtl red\nf 1 2 3\nusemtl green\nf 2 3 4\n"
    )
    mesh = read_mesh(path)
    for corners, colours in zip(mesh.vertices[mesh.faces], mesh.paint.corners, strict=True):
        assert (colours == ((0, 1, 0) if corners.max() == 9 else (1, 0, 0))).all()


def test_colours_of_vertices_are_interpolated_on_a_face(tmp_path):
    path = tmp_path / "a.ply"
    colours = "".join(f"property uchar {c}\n" for c in ("red", "green", "blue"))
    text = ply("0 0 0 90 0 0\n1 0 0 0 90 0\n0 1 0 0 0 90\n", "3 0 1 2\n", "3 1")
    path.write_text(text.replace("element face", f"{colours}element face"))
    middle = read_mesh(path).paint.at(np.array([0]), np.full((1, 3), 1 / 3))
    np.testing.assert_allclose(middle, 30 / 255, atol=1e-6)


BAD = {
    "pickle.glb": (pickle.dumps({"a": 1}), "is a damaged GLB or glTF"),
    "noise.stl": (bytes(range(256)), "no STL file"),
    "words.obj": (b"hello\n", "holds no vertex"),
    "cloud.ply": (ply(faces="", counts="4 0").encode(), "no face"),
    "cloud.obj": (b"v 0 0 0\nv 1 1 1\n", "mesh"),
    "nan.ply": (ply("0 0 0\nnan 0 0\n0 3 0\n0 0 5\n").encode(), "1 of 4 vertices are NaN"),
    "index.ply": (ply(faces="3 0 2 4\n3 0 1 3\n").encode(), "vertex 4, expected 0 to 3"),
    "negative.ply": (ply(faces="3 0 2 -1\n3 0 1 3\n").encode(), "vertex -1, expected 0 to 3"),
    "flat.ply": (ply("1 1 1\n1 1 1\n1 1 1\n1 1 1\n").encode(), "area"),
    "huge.ply": (
        ply("0 0 0\n1e300 0 0\n0 1e300 0\n0 0 5\n").replace("float", "double").encode(),
        "area",
    ),
    "lies.ply": (
        ply(counts="4 999999999999").encode(),
        "ends after 2 of 999999999999 rows of element .face., expected a whole file",
    ),
    "cut.ply": (ply()[:-9].encode(), "ends after|has . values"),
    "lies.stl": (bytes(80) + struct.pack("<I", 2**31) + bytes(100), "ends early or is no STL file"),
    "short.stl": (
        bytes(80) + struct.pack("<I", 2) + bytes(70),
        "has 70 bytes after its header, expected 50 for each of the 2 triangles",
    ),
    "text.stl": (
        b"solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\n",
        "ends early: it has 1 lines with facet and 0 with endfacet",
    ),
    "word.stl": (
        b"solid a\nfacet normal 0 0 1\nvertex 0 o 0\n",
        "line 3 has '0 o 0', expected x, y",
    ),
    "two.stl": (
        b"solid a\nfacet\nvertex 0 0 0\nvertex 1 0 0\nendfacet\nendsolid\n",
        "has 2 vertices in 1 facets, expected 3 in each",
    ),
    "word.off": (b"OFF\n3 1 0\n0 0 0\n\n1 0\n", "line 5 has '1 0', expected x, y and z"),
    "face.off": (
        b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1\n",
        "line 6 has '3 0 1', expected the count of corners of a face",
    ),
    "comments.off": (b"OFF\n" + b"# " * 5000, "has no counts of vertices and faces after OFF"),
    "head.stl": (b"x" * 20, "has 0 bytes after its header, expected 50"),
    "counts.off": (b"OFF\nx y\n", "has no counts of vertices and faces after OFF"),
    "short.off": (
        b"OFF # a face\n3 1 0\n0 0 0\n1 0 0\n# none\n",
        "ends early: it has 2 lines after its counts, which state 3 vertices and 1 face",
    ),
    "name.txt": (b"1 2 3\n", "suffix"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_mesh_is_refused_in_one_line_that_names_it(tmp_path, name):
    content, words = BAD[name]
    (tmp_path / name).write_bytes(content)
    assert_refused(rf"{name}: .*{words}", read_mesh, tmp_path / name)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_any_damage_gives_a_sound_mesh_or_is_refused_in_one_line(tmp_path, suffix):
    def read(path):
        mesh = read_mesh(path)
        assert np.isfinite(mesh.vertices[mesh.faces]).all()

    _, refused = assert_reads_or_refuses(read, tetrahedron(tmp_path / f"a{suffix}"), count=120)
    assert refused


def test_text_meshes_are_written_with_all_digits():
    points = np.array([[4e6 + 1 / 3, 1e-9, 0.1], [4e6, 1.0, 2.0], [4e6, 2.0, -1.0]])
    for suffix, begin in ((".obj", "v "), (".off", "OFF\n3 1 0\n")):
        text = new_mesh(suffix, points, np.array([[0, 1, 2]])).decode()
        assert text.startswith(f"{begin}4000000.3333333335 1e-09 0.1\n")


def test_meshes_are_found_in_subfolders_sorted_and_hidden_ones_left_out(tmp_path):
    for name in ("b/z.ply", "b/a.OBJ", "a.stl", ".hidden/c.ply", "b/.d.ply", "notes.txt"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    assert [path.relative_to(tmp_path).as_posix() for path in find_meshes(tmp_path)] == [
        "a.stl",
        "b/a.OBJ",
        "b/z.ply",
    ]
    (tmp_path / "empty").mkdir()
    assert_refused("no mesh", find_meshes, tmp_path / "empty")
    assert_refused("not a folder", find_meshes, tmp_path / "missing")
