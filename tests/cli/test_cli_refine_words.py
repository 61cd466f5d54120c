"""What `tso refine` prints: all measures with -v, only errors with -q; warnings and progress."""

import io
import os
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tso_cli.commands import options
from tso_cli.io.cameras import CameraRecord, read_camera, write_cameras
from tso_cli.io.clouds import read_cloud


@pytest.fixture
def refine(tso):
    return lambda *arguments: tso("refine", *arguments, "--overwrite")


def test_verbose_prints_every_measure_and_setting(folder, refine):
    run = refine("initial.ply", "mask.png", "-v", "--steps", "6")
    assert run.code == 0
    assert run.err == "tso: camera: camera.json\n"
    for words in (
        "loss ",
        "Chamfer to the start",
        "mirror plane",
        "sigma_sq ",
        "inlier weight 1.00, mask.png",
    ):
        assert words in run.out


def test_quiet_prints_nothing_but_errors_and_the_json_document(folder, refine):
    for option in (("--steps", "0", "--overlay", "picture.png"), ("--check",)):
        assert refine("initial.ply", "mask.png", "-q", *option) == (0, "", "")
    assert Path("picture.png").exists()
    run = refine("initial.ply", "mask.png", "-q", "--steps", "0", "--json")
    assert run.err == ""
    assert run.document["stop_reason"] == "max_steps"
    assert run.document["steps"] == 0
    assert run.document["warnings"] == [
        "nothing moved: no steps of the shape were asked for; the cloud is as it was"
    ]
    assert refine("initial.ply", "nowhere.png", "-q").refusal.startswith("tso: error: nowhere.png")


def test_a_run_that_moves_nothing_says_so_and_why(folder, refine):
    why = "nothing that was tried agrees better with what the mask shows"
    warning = f"nothing moved: {why}; the cloud is as it was"
    settings = ("--preset", "paper", "--learning-rate", "0.5", "--steps", "3")
    arguments = ("initial.ply", "mask.png", *settings)
    run = refine(*arguments)
    assert run.err == f"tso: warning: {warning}\n"
    assert f"  moved  nothing: {why}\n" in run.out
    document = refine(*arguments, "--json").document
    assert document["stop_reason"] == "not_improved"
    assert document["steps"] == 3
    assert document["moved_max"] == 0.0
    assert document["warnings"] == [warning]


def test_warnings_of_reading_the_files_are_in_the_json(folder, refine):
    with Image.open("mask.png") as mask:
        Image.fromarray((np.asarray(mask.convert("L")) > 127).astype(np.uint8)).save("labels.png")
    run = refine("initial.ply", "labels.png", "--json", "--steps", "6")
    (warning,) = run.document["warnings"]
    assert "read as labels" in warning
    assert run.err == f"tso: warning: {warning}\n"


@pytest.mark.parametrize(
    ("options", "printed"),
    [
        ((), "assumed mirror-symmetric, as the cloud is"),
        (("--symmetry", "x"), "assumed mirror-symmetric, about the given plane"),
        (("--symmetry", "none"), "no mirror symmetry assumed, as asked"),
        (("--preset", "paper"), None),
    ],
)
def test_the_assumed_symmetry_is_printed(folder, refine, options, printed):
    run = refine("initial.ply", "mask.png", "--steps", "6", *options)
    used = r"^  used   camera camera.json; (?:learned prior \(.*?\); )?(?:(.*); )?[\d.]+ s$"
    (used,) = re.findall(used, run.out, re.M)
    assert used == (printed or "")


@pytest.mark.parametrize(
    ("mode", "rows", "columns"), [("points", 3, 2), ("encoder", 1, 1), ("latent", 5, 3)]
)
def test_an_object_of_a_few_pixels_in_a_photo_is_warned_of_in_every_mode(
    mode, rows, columns, folder, checkpoint, refine
):
    mask = np.zeros((480, 640), np.uint8)
    mask[200 : 200 + rows, 300 : 300 + columns] = 255
    Image.fromarray(mask).save("few.png")
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (480, 640, 3), np.uint8)).save(
        "photo.png"
    )
    camera = read_camera("camera.json", 256, 256)
    focal = 0.75 * rows * camera.t[2]
    K = np.array(
        [
            [focal, 0.0, 300.0 + (columns - 1) / 2],
            [0.0, focal, 200.0 + (rows - 1) / 2],
            [0.0, 0.0, 1.0],
        ]
    )
    write_cameras(
        Path("few.camera.json"), [CameraRecord(replace(camera, K=K, width=640, height=480))]
    )
    expected = (
        f"few pixels ({rows * columns}): details smaller than 1/{rows} of its size cannot be seen"
    )
    source = ("initial.ply",) if mode == "points" else ("photo.png", "--checkpoint", checkpoint)
    for preset in ("best", "paper"):
        run = refine(
            *source,
            "few.png",
            "--mode",
            mode,
            "--steps",
            "2",
            "-o",
            "out.ply",
            "--json",
            "--preset",
            preset,
        )
        (warning,) = [
            text
            for text in run.document["warnings"]
            if text.startswith("few.png: shows the object with ")
        ]
        assert warning == f"few.png: shows the object with {expected}"
        assert np.isfinite(read_cloud("out.ply").points).all()


class _Terminal(io.StringIO):
    def isatty(self):
        return True

    def fileno(self):
        return 2


@pytest.mark.parametrize("columns", [80, 40, 24])
def test_the_bar_stays_on_one_line_and_shows_the_time_left(columns, monkeypatch):
    terminal, clock = _Terminal(), iter(range(100))
    monkeypatch.setattr("sys.stderr", terminal)
    monkeypatch.setattr(os, "get_terminal_size", lambda *_: os.terminal_size((columns, 24)))
    monkeypatch.setattr(options.time, "monotonic", lambda: 10.0 * next(clock))
    bar = options.ProgressBar("tso: refining")
    for step in range(1, 9):
        bar(step, 8, "steps")
    shown = [
        line.removesuffix("\x1b[K")
        for line in terminal.getvalue().removesuffix("\n").split("\r")[1:]
    ]
    assert "\n" not in terminal.getvalue().removesuffix("\n")
    left = [re.findall(r"(?:, (.*) left)?$", line)[0] for line in shown]
    assert left == ["", "1:00", "0:50", "0:40", "0:30", "0:20", "0:10", ""]
    assert max(map(len, shown)) < columns or columns < 35


def test_a_bar_that_ends_early_ends_its_line(monkeypatch):
    terminal = _Terminal()
    monkeypatch.setattr("sys.stderr", terminal)
    bar = options.ProgressBar("tso: refining", delay=0.0)
    bar(1, 8)
    bar.close()
    bar.close()
    assert terminal.getvalue().count("\n") == 1
    assert terminal.getvalue().endswith("\n")


def test_a_log_gets_no_progress(folder, refine, monkeypatch):
    monkeypatch.setattr(
        options.ProgressBar,
        "__call__",
        lambda *_: pytest.fail("progress where there is no terminal"),
    )
    assert refine("initial.ply", "mask.png", "--steps", "2").code == 0


def test_the_help_is_one_screen_and_names_a_longer_one(refine, tso):
    brief, whole = (tso("refine", option).out for option in ("--help", "--help-all"))
    assert len(brief.splitlines()) <= 48
    assert "--help-all" in brief
    assert "--preset" in brief
    assert "--learning-rate" not in brief
    assert "--learning-rate" in whole
    assert "Camera:" in whole


def test_points_are_a_number_or_auto(folder, refine):
    run = refine("initial.ply", "mask.png", "--points", "auto", "--steps", "2", "--json")
    assert run.document["moving"] == 1024
    assert "--points" in refine("initial.ply", "mask.png", "--points", "none").err
