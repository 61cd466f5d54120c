"""`tso demo`: the shipped chair in an empty folder."""

import pytest

from tso_cli.io.shipped import examples_folder


def test_the_chair_is_refined_judged_and_drawn_in_an_empty_folder(tso, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shown = tso("demo")
    assert shown.code == 0
    assert {path.name for path in (tmp_path / "demo").iterdir()} == {
        "chair.ply", "chair.png", "chair.html",
    }  # fmt: skip
    chamfer = [float(line.split()[-1]) for line in shown.out.splitlines() if " 1024 " in line]
    assert len(chamfer) == 2
    assert chamfer[1] < 0.6 * chamfer[0]
    chair = examples_folder() / "chair"
    assert (
        f"$ tso refine {chair / 'initial.ply'} {chair / 'mask.png'} -o demo/chair.ply" in shown.out
    )
    assert shown.out.splitlines()[-2:] == ["picture: demo/chair.png", "page: demo/chair.html"]
    assert "tso refine" in (tmp_path / "demo/chair.html").read_text()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("f", "f: is a file, expected the name of a folder to write to"),
        ("f/g", "f/g: cannot be made (Not a directory), expected the name of a folder to write to"),
    ],
)
def test_a_file_in_place_of_the_folder_is_refused(tso, tmp_path, monkeypatch, name, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "f").touch()
    assert tso("demo", "-o", name).refusal == f"tso: error: {message}"


def test_a_second_demo_replaces_the_first(tso, tmp_path):
    for _ in range(2):
        assert tso("demo", "-o", tmp_path / "in/here").code == 0
    assert (tmp_path / "in/here/chair.html").exists()
