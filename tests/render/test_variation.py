"""Data augmentation: warped and painted copies of meshes."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.corruption import assert_refused
from tso_cli.datasets.items import Dataset, ObjectItem, copied, original
from tso_cli.io.meshes import Mesh, read_mesh
from tso_cli.io.shipped import example_meshes
from tso_cli.render.normalise import normalise
from tso_cli.render.variation import connected_parts, paint, warp

CHAIR = next(path for path in example_meshes() if path.stem == "kfurn_chair")


@given(st.integers(0, 2**32))
@settings(max_examples=30, deadline=None)
def test_a_warped_mesh_has_another_shape_the_same_faces_and_similar_size(seed):
    mesh = normalise(read_mesh(CHAIR))
    warped = warp(mesh, np.random.default_rng(seed))
    assert np.isfinite(warped.vertices).all()
    np.testing.assert_array_equal(warped.faces, mesh.faces)
    before = np.ptp(mesh.vertices, axis=0)
    size = np.ptp(warped.vertices, axis=0) / before
    # One axis is stretched and another shrunk, sine and taper are 0.15 each; sweep and lean shift
    # by less than 0.2 each.
    assert size.min() > np.exp(-0.6) * 0.85**2
    assert (size < np.exp(0.6) * 1.15**2 + 0.4 / before).all()
    assert np.abs(warped.vertices - mesh.vertices).max() > 0.01


def test_a_symmetric_shape_keeps_a_mirror_plane_when_warped():
    """Shear and sweep go along the same axis: one of the two upright mirror planes remains."""
    rng = np.random.default_rng(0)
    half = rng.uniform(-0.5, 0.5, (200, 3))
    cloud = np.concatenate([half * [sx, 1, sz] for sx in (1, -1) for sz in (1, -1)])

    def sorted_points(points):
        return points[np.lexsort(points.round(9).T)]

    for seed in range(20):
        warped = warp(
            Mesh(cloud, np.zeros((1, 3), dtype=np.int64)), np.random.default_rng(seed)
        ).vertices
        mirrored = [sorted_points(warped * mirror) for mirror in ([-1, 1, 1], [1, 1, -1])]
        assert (
            sum(np.allclose(sorted_points(warped), points, atol=1e-8) for points in mirrored) == 1
        )


def test_faces_that_share_a_vertex_are_connected():
    faces = np.array([[0, 1, 2], [2, 3, 4], [5, 6, 7], [7, 8, 9], [10, 11, 12]])
    assert connected_parts(faces, 13).tolist() == [0, 0, 1, 1, 2]


def test_paint_gives_each_part_one_colour_and_leaves_the_shape():
    mesh = read_mesh(CHAIR)
    parts = connected_parts(mesh.faces, len(mesh.vertices))
    several = [paint(mesh, np.random.default_rng(seed)) for seed in range(5)]
    for painted in several:
        np.testing.assert_array_equal(painted.vertices, mesh.vertices)
        for part in np.unique(parts):
            assert len(np.unique(painted.paint.corners[parts == part].reshape(-1, 3), axis=0)) == 1
    assert len({tuple(painted.paint.corners[0, 0]) for painted in several}) == 5


def test_copies_are_rendered_beside_the_meshes_of_a_split(tso_render, tmp_path):
    split, out = tmp_path / "split.json", tmp_path / "out"
    words = "--views", 1, "--samples", 256, "--points", 64, "--split", split
    split.write_text(
        json.dumps({"train": ["kfurn_chair"], "validation": ["q17_Chair"], "test": []})
    )
    assert tso_render(CHAIR.parent, out, *words, "--copies", 2, "--paint").code == 0
    assert sorted(path.name for path in out.iterdir()) == [
        "kfurn_chair",
        "kfurn_chair~0001",
        "kfurn_chair~0002",
    ]
    assert (
        len(
            {
                (out / name / "target.ply").read_bytes()
                for name in ("kfurn_chair", "kfurn_chair~0001")
            }
        )
        == 2
    )
    # More copies may follow.
    assert (
        "3 rendered before" in tso_render(CHAIR.parent, out, *words, "--copies", 3, "--paint").err
    )


@pytest.mark.parametrize(
    ("names", "part", "message"),
    [
        (["kfurn_chair", "no_chair"], "train", "has no mesh no_chair"),
        (["kfurn_chair"], "practice", "'practice' is not one of 'train', 'validation', 'test'"),
        (["kfurn_chair"], "test", "split.json: has no list 'test' (lists: 'train'), expected one"),
    ],
)
def test_a_split_that_cannot_be_rendered_is_refused(tso_render, tmp_path, names, part, message):
    (tmp_path / "split.json").write_text(json.dumps({"train": names}))
    assert (
        message
        in tso_render(
            CHAIR.parent, tmp_path / "out", "--split", tmp_path / "split.json", "--part", part
        ).refusal
    )


def test_a_split_includes_the_copies_of_its_objects_and_names_no_missing_ones():
    def item(name):
        return ObjectItem(name, "chair", [], None)

    data = Dataset(
        [item("chair/a"), item(copied("chair/a", 3)), item("chair/b")],
        "chairs",
        {"chair/c": "no image"},
    )
    assert original(copied("chair/a", 3)) == "chair/a"
    assert [
        chosen.name for chosen in data.select(["chair/a", "chair/c"], "split.json").objects
    ] == ["chair/a", "chair/a~0003"]
    assert_refused(
        r"split.json: names chair/d, expected objects of chairs",
        data.select,
        ["chair/a", "chair/d"],
        "split.json",
    )
    assert_refused("names no object that can be used", data.select, ["chair/c"], "split.json")
