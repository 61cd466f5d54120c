"""`tso demo`: the shipped chair in an empty folder."""

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


def test_a_second_demo_replaces_the_first(tso, tmp_path):
    for _ in range(2):
        assert tso("demo", "-o", tmp_path / "in/here").code == 0
    assert (tmp_path / "in/here/chair.html").exists()
