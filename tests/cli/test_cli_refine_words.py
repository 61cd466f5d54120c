"""What `tso refine` prints: four lines, every measure with -v, nothing but errors with -q; its warnings and progress."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tso_cli.commands import options
from tso_cli.io.cameras import CameraRecord, read_camera, write_cameras
from tso_cli.io.clouds import read_cloud

from . import run


def tso(*arguments):
    return run.tso("refine", *arguments, "--overwrite")


def test_verbose_prints_every_measure_and_setting(folder, capsys):
    assert tso("initial.ply", "mask.png", "-v", "--steps", "6") == 0
    captured = capsys.readouterr()
    assert captured.err == "tso: camera: camera.json\n"
    for words in ("loss ", "Chamfer to the start", "mirror plane", "sigma_sq ", "loss weight 1.00, mask.png", "seed 0"):
        assert words in captured.out


def test_quiet_prints_nothing_but_errors_and_the_json_document(folder, capsys):
    for option in (("--steps", "0", "--overlay", "picture.png"), ("--check",)):
        assert tso("initial.ply", "mask.png", "-q", *option) == 0
        assert capsys.readouterr() == ("", "")
    assert Path("picture.png").exists()
    assert tso("initial.ply", "mask.png", "-q", "--steps", "0", "--json") == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    assert json.loads(captured.out)["warnings"] == ["nothing moved: no steps were asked for; the cloud is as it was"]
    assert tso("initial.ply", "nowhere.png", "-q") == 2
    assert capsys.readouterr().err.startswith("tso: error: nowhere.png")
    assert tso("initial.ply", "mask.png", "-q", "-v") == 2
    assert "expected one of the two" in capsys.readouterr().err


def test_a_run_that_moves_nothing_says_so_and_why(folder, capsys):
    why = "nothing moved: none of 3 steps agrees better with what the mask shows than the start does; the cloud is as it was"
    arguments = ("initial.ply", "mask.png", "--preset", "paper", "--learning-rate", "0.5", "--steps", "3")
    assert tso(*arguments) == 0
    captured = capsys.readouterr()
    assert captured.err == f"tso: warning: {why}\n"
    assert "  moved  nothing: none of 3 steps agrees better with what the mask shows than the start does\n" in captured.out
    assert tso(*arguments, "--json") == 0
    document = json.loads(capsys.readouterr().out)
    assert (document["stop_reason"], document["warnings"], document["moved_max"]) == ("not_improved", [why], 0.0)


def test_warnings_of_reading_the_files_are_in_the_json(folder, capsys):
    with Image.open("mask.png") as mask:
        Image.fromarray((np.asarray(mask.convert("L")) > 127).astype(np.uint8)).save("labels.png")
    assert tso("initial.ply", "labels.png", "--json", "--steps", "6") == 0
    captured = capsys.readouterr()
    (told,) = json.loads(captured.out)["warnings"]
    assert "read as labels" in told
    assert captured.err == f"tso: warning: {told}\n"


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ((), "assumed mirror-symmetric, as the cloud is"),
        (("--symmetry", "x"), "assumed mirror-symmetric, about the given plane"),
        (("--symmetry", "none"), "no mirror symmetry assumed, as asked"),
        (("--preset", "paper"), None),
    ],
)
def test_the_assumed_symmetry_is_printed(folder, capsys, options, told):
    assert tso("initial.ply", "mask.png", "--steps", "6", *options) == 0
    (used,) = re.findall(r"^  used   camera camera.json; (?:(.*); )?[\d.]+ s$", capsys.readouterr().out, re.M)
    assert used == (told or "")


@pytest.mark.parametrize(("mode", "rows", "columns"), [("points", 3, 2), ("encoder", 1, 1), ("latent", 5, 3)])
def test_an_object_of_a_few_pixels_in_a_photo_is_warned_of_in_every_mode(mode, rows, columns, folder, checkpoint, capsys):
    mask = np.zeros((480, 640), np.uint8)
    mask[200 : 200 + rows, 300 : 300 + columns] = 255
    Image.fromarray(mask).save("few.png")
    Image.fromarray(np.random.default_rng(0).integers(0, 255, (480, 640, 3), np.uint8)).save("photo.png")
    camera = read_camera("camera.json", 256, 256)
    focal = 0.75 * rows * camera.t[2]
    K = np.array([[focal, 0.0, 300.0 + (columns - 1) / 2], [0.0, focal, 200.0 + (rows - 1) / 2], [0.0, 0.0, 1.0]])
    write_cameras("few.camera.json", [CameraRecord(type(camera)(K, camera.R, camera.t, 640, 480))])
    expected = "a single pixel" if rows == 1 else f"only {rows * columns} pixels: details smaller than 1/{rows} of its size"
    common = ("few.png", "--mode", mode, "--steps", "2", "-o", "out.ply", "--json")
    source = ("initial.ply",) if mode == "points" else ("photo.png", "--checkpoint", checkpoint)
    for preset in ("best", "paper"):
        assert tso(*source, *common, "--preset", preset) == 0
        document = json.loads(capsys.readouterr().out)
        (told,) = [text for text in document["warnings"] if text.startswith("few.png: shows the object with ")]
        assert expected in told
        assert np.isfinite(read_cloud("out.ply").points).all()


class _Terminal:
    """stderr as a terminal of so many columns."""

    def __init__(self, columns):
        self.columns, self.text = columns, ""

    def isatty(self):
        return True

    def write(self, text):
        self.text += text
        return len(text)

    def flush(self):
        pass

    def fileno(self):
        raise OSError


@pytest.mark.parametrize("columns", [80, 40, 24])
def test_the_bar_stays_on_one_line_and_tells_the_time_left(columns, monkeypatch):
    terminal, clock = _Terminal(columns), iter(range(100))
    monkeypatch.setattr("sys.stderr", terminal)
    monkeypatch.setattr(options, "_columns", lambda: columns)
    monkeypatch.setattr(options.time, "monotonic", lambda: 10.0 * next(clock))
    bar = options.ProgressBar("tso: refining")
    for step in range(1, 9):
        bar(step, 8, "steps")
    shown = [line.removesuffix("\x1b[K") for line in terminal.text.removesuffix("\n").split("\r")[1:]]
    assert "\n" not in terminal.text.removesuffix("\n")
    left = [re.findall(r"(?:, (.*) left)?$", line)[0] for line in shown]
    assert left == ["", "1:00", "0:50", "0:40", "0:30", "0:20", "0:10", ""]
    assert max(map(len, shown)) < columns or columns < 35


def test_a_bar_that_ends_early_ends_its_line(monkeypatch):
    terminal = _Terminal(80)
    monkeypatch.setattr("sys.stderr", terminal)
    bar = options.ProgressBar("tso: refining", delay=0.0)
    bar(1, 8)
    bar.close()
    bar.close()
    assert terminal.text.count("\n") == 1 and terminal.text.endswith("\n")


def test_a_log_gets_no_progress(folder, capsys, monkeypatch):
    monkeypatch.setattr(options.ProgressBar, "__call__", lambda *_: pytest.fail("progress where there is no terminal"))
    assert tso("initial.ply", "mask.png", "--steps", "2") == 0
