"""`tso render --family`: shapes by rule beside meshes, or alone."""

import pytest

from tso_cli.render.families import FAMILIES

FAST = "--views", 1, "--size", 24, "--samples", 200, "--points", 50


def test_families_are_rendered_without_a_mesh(tso, tmp_path):
    pytest.importorskip("open3d")
    done = tso(
        "render", "--family", "chair=2", "--family", "bent tube=1", *FAST, "-o", tmp_path / "out"
    )
    assert done.code == 0, done.err
    names = sorted(
        path.parent.relative_to(tmp_path / "out").as_posix()
        for path in (tmp_path / "out").rglob("target.ply")
    )
    assert names == ["bent tube/rule-00001", "chair/rule-00001", "chair/rule-00002"]
    again = tso("render", "--family", "chair=3", *FAST, "-o", tmp_path / "out", "--json").document
    assert again["written"] == ["chair/rule-00003"]
    assert again["skipped"] == ["chair/rule-00001", "chair/rule-00002"]


def test_list_names_the_families(tso):
    assert tso("render", "--family", "list").out.splitlines() == list(FAMILIES)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (("--family", "unicorn=2"), "--family unicorn: is no family, expected one of chair"),
        (("--family", "chair"), "'chair' is no family and number, expected such as chair=100"),
        (("--family", "chair=0"), "'chair=0' is no family and number"),
        ((), "no MESH_OR_FOLDER, expected one (or --family)"),
    ],
)
def test_a_wrong_family_is_refused(tso, tmp_path, given, message):
    assert message in tso("render", *given, "-o", tmp_path / "out").err


def test_a_category_that_is_not_there_is_refused(tso, tmp_path):
    from tso_cli.io.shipped import examples_folder

    refused = tso(
        "render", examples_folder() / "meshes", "--category", "cat", "-o", tmp_path / "out"
    ).refusal
    assert "has no mesh of cat, expected some" in refused
    assert not list(tmp_path.iterdir())
