"""The confidence of points in PLY files: everything else stays, and other programs read it."""

import numpy as np
import pytest
import trimesh

from tests.corruption import assert_refused
from tests.io.test_clouds import POINTS, a_ply, every_form, every_shape
from tests.io.test_splats import splats
from tso_cli.io.clouds import read_cloud, write_cloud
from tso_cli.io.ply import PlyFile

CONFIDENCE = np.array([0.0, 0.25, 1.0, 1.0 / 3.0])
MOVED = POINTS + 0.125


def written(path, like=None, points=MOVED, confidence=CONFIDENCE, name="out.ply") -> bytes:
    out = path / name
    write_cloud(out, points, like, overwrite=True, confidence=confidence)
    return out.read_bytes()


def confidence_in(path) -> np.ndarray:
    (values,) = PlyFile(path.read_bytes(), path)._floats(("confidence",)).T
    return values


@every_form
@every_shape
def test_a_file_gets_a_confidence_and_keeps_the_rest_byte_for_byte(tmp_path, form, shape):
    source = tmp_path / "in.ply"
    source.write_bytes(a_ply(form, **shape))
    like = read_cloud(source)
    plain, rated = written(tmp_path, like, confidence=None), written(tmp_path, like)
    assert len(rated) > len(plain)
    read = read_cloud(tmp_path / "out.ply")
    np.testing.assert_allclose(read.points, MOVED, atol=1e-6)
    np.testing.assert_array_equal(read.faces(), like.faces())
    np.testing.assert_array_equal(read.colours(), like.colours())
    np.testing.assert_allclose(confidence_in(tmp_path / "out.ply"), CONFIDENCE, atol=1e-7)
    assert without_confidence(rated, form) == plain
    # A second run replaces the numbers, and no other byte.
    again = written(tmp_path, read, confidence=CONFIDENCE[::-1])
    assert len(again) == len(rated) or form == "ascii"
    assert without_confidence(again, form) == plain
    np.testing.assert_allclose(confidence_in(tmp_path / "out.ply"), CONFIDENCE[::-1], atol=1e-7)


def without_confidence(data: bytes, form: str) -> bytes:
    """The file without what a confidence adds: a line of the header, and four bytes or a word."""
    file = PlyFile(data, "out.ply")
    places = file._places_of(file.vertex, ("confidence",))[:, 0].tolist()
    body = file._body
    spans = (
        [(place, place + 4) for place in places]
        if form != "ascii"
        else [(body._table.starts[place] - 1, body._table.ends[place]) for place in places]
    )
    for first, last in sorted(spans, reverse=True):
        data = data[:first] + data[last:]
    eol = data[3 : 3 + len(data) - len(data[3:].lstrip(b"\r\n")) - 3]
    return data.replace(b"property float confidence" + eol, b"", 1)


def test_integers_of_an_earlier_confidence_become_numbers(tmp_path):
    source = tmp_path / "in.ply"
    text = a_ply("ascii").replace(b"uchar red", b"uchar confidence")
    source.write_bytes(text)
    written(tmp_path, read_cloud(source))
    file = PlyFile((tmp_path / "out.ply").read_bytes(), tmp_path / "out.ply")
    assert file.vertex.properties["confidence"].kind == "f8"
    np.testing.assert_allclose(confidence_in(tmp_path / "out.ply"), CONFIDENCE)


def test_splats_and_meshes_with_a_confidence_are_read_by_other_programs(tmp_path):
    rng = np.random.default_rng(0)
    points, colours = rng.uniform(-1.0, 1.0, (50, 3)), rng.uniform(0.0, 1.0, (50, 3))
    (tmp_path / "splats.ply").write_bytes(splats(points, rng.uniform(0.0, 3.0, 50), colours))
    trimesh.creation.icosphere(subdivisions=1).export(tmp_path / "mesh.ply")
    for name in ("splats.ply", "mesh.ply"):
        like = read_cloud(tmp_path / name)
        values = rng.uniform(0.0, 1.0, len(like.points))
        written(tmp_path, like, like.points + 0.01, values)
        loaded = trimesh.load(tmp_path / "out.ply", process=False)
        np.testing.assert_allclose(loaded.vertices, like.points + 0.01, atol=1e-6)
        raw = loaded.metadata["_ply_raw"]["vertex"]["data"]
        np.testing.assert_allclose(np.ravel(raw["confidence"]), values, atol=1e-7)
        if name == "mesh.ply":
            np.testing.assert_array_equal(loaded.faces, like.faces())
        o3d = pytest.importorskip("open3d")
        cloud = o3d.t.io.read_point_cloud(str(tmp_path / "out.ply"))
        read = cloud.point["confidence"].numpy()[:, 0]
        np.testing.assert_allclose(read, values, atol=1e-7)


def test_a_new_file_can_have_one_too_and_other_formats_cannot(tmp_path):
    written(tmp_path)
    np.testing.assert_allclose(confidence_in(tmp_path / "out.ply"), CONFIDENCE, atol=1e-7)
    assert_refused(
        "out.npy: cannot hold the confidence of points, expected a .ply file",
        lambda: written(tmp_path, name="out.npy"),
    )
    assert not (tmp_path / "out.npy").exists()
