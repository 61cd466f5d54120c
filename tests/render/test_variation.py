"""Warped and painted copies: other shapes and colours, of the same parts, for training."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tso_cli.cli import main
from tso_cli.datasets.items import Dataset, ObjectItem, copied, original
from tso_cli.errors import InputError
from tso_cli.io.meshes import Mesh, read_mesh
from tso_cli.io.shipped import example_meshes
from tso_cli.render import normalise
from tso_cli.render.variation import connected_parts, paint, warp

CHAIR = next(path for path in example_meshes() if path.stem == "kfurn_chair")


@given(st.integers(0, 2**32))
@settings(max_examples=30, deadline=None)
def test_a_warped_mesh_is_another_shape_with_the_same_faces_and_like_size(seed: int) -> None:
    mesh = normalise(read_mesh(CHAIR))
    warped = warp(mesh, np.random.default_rng(seed))
    assert np.isfinite(warped.vertices).all()
    np.testing.assert_array_equal(warped.faces, mesh.faces)
    before = np.ptp(mesh.vertices, axis=0)
    size = np.ptp(warped.vertices, axis=0) / before
    # One axis stretched and another one shrunk, sine and taper of 0.15 each; sweep and lean shift by less than 0.2 each.
    assert size.min() > np.exp(-0.6) * 0.85**2
    assert (size < np.exp(0.6) * 1.15**2 + 0.4 / before).all()
    assert np.abs(warped.vertices - mesh.vertices).max() > 0.01


def test_no_strength_changes_nothing() -> None:
    mesh = normalise(read_mesh(CHAIR))
    np.testing.assert_allclose(warp(mesh, np.random.default_rng(0), 0.0).vertices, mesh.vertices, atol=1e-12)


def test_a_symmetric_shape_keeps_a_mirror_plane_when_warped() -> None:
    """Lean and sweep go along one and the same axis, so that of a box's two upright mirror planes one remains."""
    rng = np.random.default_rng(0)
    half = rng.uniform(-0.5, 0.5, (200, 3))
    cloud = np.concatenate([half * [sx, 1, sz] for sx in (1, -1) for sz in (1, -1)])
    kept = 0
    for seed in range(20):
        warped = warp(Mesh(cloud, np.zeros((1, 3), dtype=np.int64)), np.random.default_rng(seed)).vertices
        for mirror in ([-1, 1, 1], [1, 1, -1]):
            reflected = warped * mirror
            order = np.lexsort(warped.round(9).T), np.lexsort(reflected.round(9).T)
            kept += bool(np.allclose(warped[order[0]], reflected[order[1]], atol=1e-8))
    assert kept == 20


def test_faces_that_share_a_vertex_are_of_one_part() -> None:
    faces = np.array([[0, 1, 2], [2, 3, 4], [5, 6, 7], [7, 8, 9], [10, 11, 12]])
    assert connected_parts(faces, 13).tolist() == [0, 0, 1, 1, 2]


def test_paint_gives_each_part_one_colour_and_leaves_the_shape() -> None:
    mesh = read_mesh(CHAIR)
    parts = connected_parts(mesh.faces, len(mesh.vertices))
    seen = set()
    for seed in range(5):
        painted = paint(mesh, np.random.default_rng(seed))
        np.testing.assert_array_equal(painted.vertices, mesh.vertices)
        assert painted.colours is not None
        for part in np.unique(parts):
            assert len(np.unique(painted.colours[parts == part], axis=0)) == 1
        seen.add(tuple(painted.colours[0]))
    assert len(seen) == 5


def run(*arguments: object) -> int:
    with pytest.raises(SystemExit) as stopped:
        main([str(argument) for argument in arguments])
    assert isinstance(stopped.value.code, int)
    return stopped.value.code


def test_copies_are_rendered_beside_the_mesh_and_belong_to_it_in_a_split(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("open3d")
    split = tmp_path / "split.json"
    split.write_text(json.dumps({"train": ["kfurn_chair"], "validation": ["q17_Chair"], "test": []}))
    common = ["--views", 1, "--samples", 256, "--points", 64, "--split", split]
    command = ["render", CHAIR.parent, "-o", tmp_path / "out", *common]
    assert run(*command, "--copies", 2, "--paint") == 0
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["kfurn_chair", "kfurn_chair~0001", "kfurn_chair~0002"]
    clouds = {(tmp_path / "out" / name / "target.ply").read_bytes() for name in ("kfurn_chair", "kfurn_chair~0001")}
    assert len(clouds) == 2
    # More copies of the same kind may follow.
    assert run(*command, "--copies", 3, "--paint") == 0
    assert "3 rendered before" in capsys.readouterr().err
    split.write_text(json.dumps({"train": ["kfurn_chair", "no_chair"], "validation": [], "test": []}))
    assert run(*command) == 2
    assert "has no mesh no_chair" in capsys.readouterr().err
    assert run(*command, "--part", "practice") == 2
    assert "'practice' is not one of 'train', 'validation', 'test'" in capsys.readouterr().err
    split.write_text(json.dumps({"train": ["kfurn_chair"]}))
    assert run(*command, "--part", "test") == 2
    assert "split.json: has no list 'test', expected one beside 'train'" in capsys.readouterr().err


def test_a_split_takes_the_copies_of_what_it_names_and_misses_nothing() -> None:
    def item(name: str) -> ObjectItem:
        return ObjectItem(name, "chair", [], None)

    data = Dataset([item("chair/a"), item(copied("chair/a", 3)), item("chair/b")], "chairs", {"chair/c": "no image"})
    assert original(copied("chair/a", 3)) == "chair/a"
    assert [chosen.name for chosen in data.select(["chair/a", "chair/c"], "split.json").objects] == ["chair/a", "chair/a~0003"]
    with pytest.raises(InputError, match=r"split.json: names chair/d, expected objects of chairs"):
        data.select(["chair/a", "chair/d"], "split.json")
    with pytest.raises(InputError, match="names no object that can be used"):
        data.select(["chair/c"], "split.json")
