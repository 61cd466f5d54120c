"""Rendering into folders: layout, resuming, refusals, and the command `tso render`."""

import errno
import itertools
import json
import os
import signal
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest

from tests.corruption import assert_refused
from tso_cli.datasets import rendered
from tso_cli.datasets.rendered import open_rendered, writing
from tso_cli.errors import TsoError
from tso_cli.render.folder import render_folder
from tso_cli.render.settings import RenderSettings

FAST = RenderSettings(views=3, size=(24, 24), samples=200, points=50)
WORDS = "--views", 3, "--size", 24, "--samples", 200, "--points", 50


def contents(folder):
    return {
        p.relative_to(folder).as_posix(): p.read_bytes()
        for p in sorted(folder.rglob("*"))
        if p.is_file()
    }


def hidden(folder):
    return [path.name for path in folder.rglob(".*")]


def at_tenth_picture(monkeypatch, action):
    """Do ``action`` before the tenth picture is written: in the middle of the second object."""
    write, numbers = rendered.write_image, itertools.count(1)

    def acting(*arguments, **options):
        if next(numbers) == 10:
            action()
        write(*arguments, **options)

    monkeypatch.setattr(rendered, "write_image", acting)


def test_a_folder_is_rendered_into_the_documented_layout(meshes, tmp_path):
    reported = []
    summary = render_folder(
        meshes, tmp_path / "out", FAST, progress=lambda *report: reported.append(report)
    )
    assert summary.written == ["c", "chair/a", "chair/b"]
    assert summary.skipped == []
    assert summary.failed == {}
    assert reported == [(1, 3, "c"), (2, 3, "chair/a"), (3, 3, "chair/b")]
    pictures = [(f"{i:03d}.png", f"{i:03d}.mask.png") for i in range(3)]
    names = {path.name for path in (tmp_path / "out/chair/a").iterdir()}
    assert names == {
        *sum(pictures, ()),
        "cameras.json",
        "render.json",
        "target.ply",
        "target_200.ply",
    }
    document = json.loads((tmp_path / "out/c/cameras.json").read_text())
    assert [(view["image"], view["mask"]) for view in document["views"]] == pictures


def test_an_object_depends_on_the_seed_and_not_on_the_others(meshes, tmp_path):
    render_folder(meshes, tmp_path / "all", FAST, seed=1)
    (meshes / "c.ply").unlink()
    render_folder(meshes, tmp_path / "two", FAST, seed=1)
    render_folder(meshes, tmp_path / "other", FAST, seed=2)
    assert contents(tmp_path / "all/chair") == contents(tmp_path / "two/chair")
    assert (
        contents(tmp_path / "all/chair")["a/target.ply"]
        != contents(tmp_path / "other/chair")["a/target.ply"]
    )


def test_an_interrupted_run_leaves_only_whole_objects_and_resumes(meshes, tmp_path, monkeypatch):
    render_folder(meshes, tmp_path / "whole", FAST)
    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        at_tenth_picture(patch, lambda: signal.default_int_handler(signal.SIGINT, None))
        render_folder(meshes, tmp_path / "out", FAST)
    assert {name.split("/")[0] for name in contents(tmp_path / "out")} == {"c"}
    summary = render_folder(meshes, tmp_path / "out", FAST)
    assert summary.skipped == ["c"]
    assert summary.written == ["chair/a", "chair/b"]
    assert contents(tmp_path / "out") == contents(tmp_path / "whole")


def test_a_terminated_command_cleans_up_as_after_ctrl_c(tso_render, meshes, tmp_path, monkeypatch):
    at_tenth_picture(monkeypatch, lambda: signal.raise_signal(signal.SIGTERM))
    stopped = tso_render(meshes, tmp_path / "out", *WORDS)
    assert stopped.code == 130
    assert stopped.err.splitlines()[-1] == "tso: error: interrupted"
    assert hidden(tmp_path / "out") == []


def test_a_full_disk_leaves_no_folder_that_was_not_there_before(meshes, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    (tmp_path / "mine").mkdir()
    before = sorted(tmp_path.rglob("*"))
    monkeypatch.setattr(rendered, "write_image", full)
    for name in ("out", "mine"):
        with pytest.raises(TsoError, match="No space left on device"):
            render_folder(meshes, tmp_path / name, FAST, only={"chair/a"})
    assert sorted(tmp_path.rglob("*")) == before


def test_what_a_killed_run_left_is_removed_and_what_it_was_replacing_is_put_back(meshes, tmp_path):
    out = tmp_path / "out"
    render_folder(meshes, out, FAST)
    before = contents(out)
    unfinished = out / rendered.UNFINISHED
    for number, name in enumerate(("c", "chair/a")):
        (unfinished / "old" / name).parent.mkdir(parents=True, exist_ok=True)
        (out / name).rename(unfinished / "old" / name)
        (unfinished / "new").mkdir(exist_ok=True)
        (unfinished / f"new/00{number}.png").write_bytes(b"half")
    assert len(render_folder(meshes, out, FAST).skipped) == 3
    assert contents(out) == before
    assert hidden(out) == []


def test_two_processes_do_not_write_one_folder(meshes, tmp_path):
    command = [
        sys.executable,
        "-m",
        "tso_cli",
        "render",
        str(meshes),
        "-o",
        str(tmp_path / "out"),
        *map(str, WORDS),
    ]
    with writing(tmp_path / "out"):
        second = subprocess.run(command, capture_output=True, text=True)
    assert second.returncode == 2
    assert "another process is writing it" in second.stderr
    assert list(tmp_path.glob("*out*")) == []


def test_a_folder_of_other_settings_is_only_changed_with_overwrite(meshes, tmp_path):
    out = tmp_path / "out"
    render_folder(meshes, out, FAST)
    before = contents(out)
    assert_refused(
        r"views 3, now it is 2.*`overwrite`", render_folder, meshes, out, replace(FAST, views=2)
    )
    assert contents(out) == before
    assert len(render_folder(meshes, out, replace(FAST, views=2), overwrite=True).written) == 3
    assert set(contents(out)) == {name for name in before if "/002." not in name}
    assert hidden(out) == []


def test_a_folder_of_something_else_is_never_replaced(meshes, tmp_path):
    (tmp_path / "out/c").mkdir(parents=True)
    (tmp_path / "out/c/thesis.tex").write_text("years of work")
    for overwrite in (False, True):
        assert_refused(
            "not an object", render_folder, meshes, tmp_path / "out", FAST, overwrite=overwrite
        )
    assert contents(tmp_path / "out") == {"c/thesis.tex": b"years of work"}


def test_a_bad_mesh_is_named_and_the_others_are_rendered(tso_render, meshes, tmp_path):
    (meshes / "chair/broken.ply").write_text("ply\n")
    summary = render_folder(meshes, tmp_path / "out", FAST)
    assert len(summary.written) == 3
    assert list(summary.failed) == ["chair/broken"]
    assert "broken.ply" in summary.failed["chair/broken"]
    assert not (tmp_path / "out/chair/broken").exists()
    again = tso_render(meshes, tmp_path / "out", *WORDS)
    assert again.code == 2
    assert all(
        words in again.err for words in ("1 mesh", "broken.ply", "3 rendered before, skipped")
    )


def test_a_bad_mesh_alone_or_a_bad_output_is_an_error_and_writes_nothing(meshes, tmp_path):
    (tmp_path / "broken.ply").write_text("ply\n")
    for source, output, message in (
        (tmp_path / "broken.ply", "out", r"broken\.ply"),
        (tmp_path / "missing.ply", "out", "does not exist"),
        (meshes, "broken.ply", "is a file"),
        (meshes, "no/such", "does not exist"),
    ):
        assert_refused(message, render_folder, source, tmp_path / output, FAST)
    assert not (tmp_path / "out").exists()


def test_names_that_would_collide_are_refused(meshes, tmp_path):
    for name, message in (("c.stl", "different names"), ("chair.stl", "rendered inside chair")):
        (meshes / name).write_bytes(b"x")
        assert_refused(message, render_folder, meshes, tmp_path / "out", FAST)
        (meshes / name).unlink()
    assert not (tmp_path / "out").exists()


def test_the_output_may_lie_inside_the_source(meshes):
    first, again = (render_folder(meshes, meshes / "out", FAST) for _ in range(2))
    assert again.skipped == first.written
    assert not again.written


def test_the_command_prints_one_json_document_writes_a_data_set_and_refuses_an_unreadable_size(
    tso_render, meshes, tmp_path
):
    assert "128x96" in tso_render(meshes, tmp_path / "out", "--size", "wide").refusal
    done = tso_render(meshes, tmp_path / "out", *WORDS, "--size", "32x24", "--seed", 5, "--json")
    assert "warning" not in done.err
    assert done.document["written"] == ["c", "chair/a", "chair/b"]
    assert done.document["settings"]["size"] == [32, 24]
    data = open_rendered(tmp_path / "out")
    assert [item.target().shape for item in data.objects if item.target] == [(50, 3)] * 3
    assert data.objects[0].views[0].load()[0].shape == (24, 32, 3)


def test_the_command_looks_from_the_directions_that_were_asked_for(tso_render, meshes, tmp_path):
    assert (
        tso_render(
            meshes, tmp_path / "out", *WORDS, "--azimuth", 80, 100, "--elevation", 10, 20
        ).code
        == 0
    )
    files = list((tmp_path / "out").rglob("cameras.json"))
    assert len(files) == 3
    for file in files:
        for view in json.loads(file.read_text())["views"]:
            R, t = np.array(view["R"]), np.array(view["t"])
            x, y, z = -R.T @ t / np.linalg.norm(t)
            assert 79.9 <= np.degrees(np.arctan2(x, z)) <= 100.1
            assert 9.9 <= np.degrees(np.arcsin(y)) <= 20.1
