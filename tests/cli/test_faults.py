"""Whatever goes wrong, a command says so in one line; no file is lost, half written or left."""

import errno
import fcntl
import json
import os
import re
import shutil
import signal
import subprocess
import sys
from contextlib import suppress
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.corruption import assert_refused
from tests.lab.test_study import run_toys
from tests.training import make_known
from tso_cli.commands.refine import run as refine_run
from tso_cli.errors import InputError
from tso_cli.io import output, reading
from tso_cli.io.clouds import read_cloud, write_cloud
from tso_cli.io.depth_maps import read_depth
from tso_cli.io.masks import read_mask
from tso_cli.io.output import atomic_output, sole_writer
from tso_cli.io.ply_body import BinaryBody
from tso_cli.io.reading import TextTable
from tso_cli.io.shipped import examples_folder
from tso_cli.optimisation.objective import SilhouetteObjective
from tso_lab.study import Progress

ROOT = Path(__file__).parents[2]
NAMES = ("out.ply", "out.png", "out.json")
OUTPUTS = (
    "initial.ply", "mask.png", "-o", "out.ply", "--overlay", "out.png",
    "--write-camera", "out.json",
)  # fmt: skip


def started(*words, program="from tso_cli.cli import main; main()", **options):
    """`tso WORDS` as a process of its own."""
    environment = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "OMP_NUM_THREADS": "1",
        **options.pop("environment", {}),
    }
    words = [sys.executable, "-c", program, *map(str, words)]
    return subprocess.Popen(
        words,
        env=environment,
        text=True,
        **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **options},
    )


def written(folder, known=("initial.ply", "mask.png", "image.png", "camera.json", "target.ply")):
    return sorted(path.name for path in folder.iterdir() if path.name not in known)


def at_end_of_refinement(monkeypatch, action):
    """Call ``action`` once a refinement is done, before its files are written."""
    refine = refine_run.refine

    def refine_then_act(*arguments, **options):
        result = refine(*arguments, **options)
        action()
        return result

    monkeypatch.setattr(refine_run, "refine", refine_then_act)


@pytest.mark.parametrize("name", NAMES)
def test_a_file_that_appears_during_the_work_is_kept_and_nothing_is_written(
    refine, folder, monkeypatch, name
):
    at_end_of_refinement(monkeypatch, lambda: Path(name).write_text("mine"))
    assert f"{name}: exists already" in refine(*OUTPUTS).refusal
    assert written(folder) == [name]
    assert Path(name).read_text() == "mine"


@pytest.mark.parametrize("links", [True, False], ids=["links", "no links"])
def test_of_two_writers_of_one_name_one_succeeds(tmp_path, monkeypatch, links):
    if not links:
        monkeypatch.setattr(
            os, "link", lambda *_: (_ for _ in ()).throw(OSError(errno.EPERM, "no links here"))
        )
    path = tmp_path / "out.txt"
    with (
        pytest.raises(InputError, match="exists already.*`overwrite`"),
        atomic_output(path, overwrite=False) as slow,
    ):
        slow.write_text("slow")
        with atomic_output(path, overwrite=False) as fast:
            fast.write_text("fast")
    assert path.read_text() == "fast"
    assert list(tmp_path.iterdir()) == [path]


def test_the_next_run_takes_what_a_killed_one_left_and_not_what_a_living_one_writes(tmp_path):
    output = tmp_path / "out.ply"
    with atomic_output(output) as left:
        pass
    left.write_text("left by a killed run")
    with atomic_output(output) as temporary:
        assert temporary == left
        assert temporary.read_bytes() == b""
        temporary.write_text("new")
    assert list(tmp_path.iterdir()) == [output]
    left.touch()
    with left.open() as held:
        fcntl.flock(held, fcntl.LOCK_EX | fcntl.LOCK_NB)
        with atomic_output(output) as temporary:
            assert temporary != left
    assert left.exists()


def test_a_link_in_place_of_a_temporary_is_not_followed(tmp_path):
    output, other = tmp_path / "out.ply", tmp_path / "other"
    with atomic_output(output) as left:
        pass
    other.write_text("somebody's")
    left.symlink_to(other)
    with atomic_output(output) as temporary:
        temporary.write_text("new")
    assert other.read_text() == "somebody's"
    assert output.read_text() == "new"
    left.unlink()
    os.link(other, left)
    with atomic_output(output) as temporary:
        temporary.write_text("newer")
    assert other.read_text() == "somebody's"


WRITE = (
    "import sys\nfrom pathlib import Path\nfrom tso_cli.io.output import write_file\n"
    "path, data = Path(sys.argv[1]), sys.argv[2].encode() * 5000\n"
    "for _ in range(400):\n"
    "    write_file(path, data, overwrite=True)\n"
    "    assert len(set(path.read_bytes())) == 1\n"
)


@pytest.mark.parametrize("name", ["same.bin", "a_long_name_that_several_outputs_begin_with_{}.bin"])
def test_of_four_processes_that_write_at_once_no_write_fails(tmp_path, name):
    writers = [started(tmp_path / name.format(k), k, program=WRITE) for k in range(4)]
    assert [writer.communicate() for writer in writers] == [("", "")] * 4
    assert sorted(tmp_path.iterdir()) == sorted({tmp_path / name.format(k) for k in range(4)})


@pytest.mark.parametrize("name", ["SIGTERM", "SIGHUP"])
def test_a_signal_while_files_are_written_leaves_none(folder, name):
    program = (
        "import os, signal\nfrom tso_cli.cli import main\nfrom tso_cli.plots import overlay\n"
        f"overlay.draw_overlay = lambda *_: os.kill(os.getpid(), signal.{name})\n"
        f"signal.signal(signal.{name}, signal.SIG_DFL)\nmain()"  # nohup ignores SIGHUP
    )
    run = started("refine", *OUTPUTS, program=program)
    assert run.communicate()[1].splitlines()[-1] == "tso: error: interrupted"
    assert run.returncode == 130
    assert written(folder) == []


def test_nohup_stays_nohup(folder):
    program = (
        "import os, signal\nsignal.signal(signal.SIGHUP, signal.SIG_IGN)\n"
        "from tso_cli.cli import main\n"
        "from tso_cli.plots import overlay\ndraw = overlay.draw_overlay\n"
        "overlay.draw_overlay = lambda *a: (os.kill(os.getpid(), signal.SIGHUP), draw(*a))\nmain()"
    )
    run = started("refine", *OUTPUTS, program=program)
    run.communicate()
    assert run.returncode == 0
    assert written(folder) == sorted(NAMES)


@pytest.mark.parametrize("number", [0, 1, 2])
def test_a_closed_stream_does_not_end_the_work(folder, number):
    run = started(
        "refine",
        *OUTPUTS,
        program=f"import os; os.close({number}); import sys; from tso_cli.cli import main; main()",
    )
    run.communicate()
    assert run.returncode == 0
    assert written(folder) == sorted(NAMES)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_full_stderr_does_not_end_the_work_or_change_the_exit_code(folder):
    Image.fromarray(np.eye(9, dtype=np.uint8) * 255).save("coarse.png")
    with open("/dev/full", "w") as full:
        warned, failed = (
            started("refine", "initial.ply", "coarse.png", "--camera", "fit", stderr=full),
            started("refine", "x.ply", stderr=full),
        )
    assert warned.wait() == 0
    assert failed.wait() == 2
    assert "initial.refined.ply" in written(folder)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full here")
def test_a_full_stdout_is_one_line_and_a_failure():
    with open("/dev/full", "w") as full:
        process = started("refine", "--help-all", stdout=full)
        assert process.communicate()[1].splitlines() == [
            "tso: error: stdout, or a file: No space left on device"
        ]
    assert process.returncode == 1


@pytest.mark.parametrize(
    "cases",
    [
        [1],
        [{}],
        [{"size": "x"}, {"size": 2}],
        [{"size": 1}, {"size": None}],
        [{"size": 1}, {"size": 2}, {}],
        [[]],
        [None],
    ],
    ids=str,
)
def test_a_damaged_record_is_not_gone_on_from(cases):
    record = {**run_toys(Progress()), "cases": cases}
    try:
        assert all(case["size"] for case in run_toys(Progress(earlier=record))["cases"])
    except InputError as error:
        assert re.match(r"the record to go on from is damaged \(.*\), expected", str(error))


WHOLE = json.loads((ROOT / "docs" / "records" / "pose.json").read_text())


@pytest.mark.parametrize(
    ("damage", "commands"),
    [
        ({"fingerprint": 3}, ("resume", "fingerprint")),
        ({"fingerprint": {"camera fit": [1]}}, ("resume", "fingerprint")),
        ({"fingerprint": {"camera fit": {"number": "x"}}}, ("resume", "fingerprint")),
        ({"convention": None}, ("page",)),
        ({"cases": "none"}, ("page",)),
        ({"cases": [{}]}, ("page",)),
        ({"cases": [{**WHOLE["cases"][0], "degrees": "seven"}]}, ("page",)),
        ({"claims": [None]}, ("page",)),
    ],
    ids=str,
)
def test_a_damaged_record_is_refused_by_its_name_and_nothing_is_written(
    tso, tmp_path, damage, commands, monkeypatch
):
    make_known(monkeypatch)
    path = tmp_path / "record.json"
    path.write_text(json.dumps({**WHOLE, **damage}))
    resume = ("pose", "--meshes", ROOT / "examples" / "meshes", "--resume", "-o")
    for name in commands:
        words = resume if name == "resume" else (name,)
        message = tso("lab", *words, path).refusal
        assert re.search(
            rf"{re.escape(str(path))}: the record is damaged \(.+\), expected it as it was kept",
            message,
        )
    assert list(tmp_path.iterdir()) == [path]


def test_a_record_that_cannot_be_gone_on_from_is_named(tso, tmp_path):
    path = tmp_path / "record.json"
    path.write_text(
        json.dumps(
            {"study": "harm", "settings": {"quick": False}, "cases": [], "fingerprint": {"x": {}}}
        )
    )
    words = ("lab", "harm", "--quick", "--resume", "-o", path)
    assert f"{path}: the record to go on from has " in tso(*words).refusal


HOLD = (
    "import os, sys\nfrom pathlib import Path\nfrom tso_cli.io.output import sole_writer\n"
    "with sole_writer(Path(sys.argv[1])):\n    os.fork() or sys.exit(sys.stdin.read())\n"
    "    print(flush=True)\n    os.wait()"
)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no forks, and no locks, here")
def test_a_record_that_another_process_writes_is_refused_until_that_ends_or_is_killed(
    tso, tmp_path
):
    path = tmp_path / "record.json"
    other = started(path, program=HOLD, stdin=subprocess.PIPE)
    other.stdout.readline()
    for words in (("speed",), ("speed", "--overwrite"), ("harm", "--quick", "--resume")):
        assert f"{path}: another process is writing it" in tso("lab", *words, "-o", path).refusal
    other.kill()
    other.wait()  # what it forked lives on
    with sole_writer(path):
        pass
    assert list(tmp_path.iterdir()) == []
    other.stdin.close()


@pytest.mark.parametrize("size", [2, 3, 4, 6, 8, 10])
@pytest.mark.parametrize("preset", ["best", "paper"])
def test_masks_of_a_few_pixels_can_be_used(refine, folder, size, preset):
    pixels = np.zeros((size, size), np.uint8)
    pixels[: size // 2, : size // 2 + size % 2] = 255
    Image.fromarray(pixels).save("tiny.png")
    assert (
        refine(
            "initial.ply", "tiny.png", "--camera", "fit", "--steps", "1", "--preset", preset
        ).code
        == 0
    )


@pytest.mark.parametrize(
    "plane", ["1e200,1e200,0,0", "1e-200,0,0,0", "1,0,0,1e300", "0,0,0,1", "nan,0,0,1", "1,0,0,inf"]
)
def test_a_plane_of_impossible_numbers_is_named_as_such(refine, folder, plane):
    assert refine("initial.ply", "mask.png", "--symmetry", plane).refusal.startswith(
        f"tso: error: symmetry is '{plane}'"
    )


@pytest.mark.parametrize("scale", [1e308, 1e200, float("inf"), float("nan")])
def test_depths_beyond_all_bounds_are_refused(tmp_path, scale):
    np.save(tmp_path / "depth.npy", np.full((4, 4), 2.0))
    assert_refused(
        r"depth\.npy: its largest depth, times .*, expected at most 1e\+15",
        read_depth,
        tmp_path / "depth.npy",
        scale,
    )


def test_a_depth_scale_that_leaves_no_depth_is_refused(tmp_path):
    np.save(tmp_path / "depth.npy", np.full((4, 4), 2.0))
    assert_refused(
        r"depth\.npy: .* is 2e-30, expected at least 1e-15",
        read_depth,
        tmp_path / "depth.npy",
        1e-30,
    )


def test_a_loss_that_is_not_finite_names_the_file(refine, folder, monkeypatch):
    monkeypatch.setattr(SilhouetteObjective, "__call__", lambda self, points: (np.nan, points))
    run = refine("initial.ply", "mask.png", "--preset", "paper")
    assert run.code == 1
    assert run.err == "tso: error: initial.ply: the loss of the start is not a finite number\n"


@pytest.mark.parametrize("normal", ["a b c", "0 0"])
def test_an_stl_with_odd_normals_is_read_in_silence(tso, tmp_path, normal, caplog):
    corners = "".join(f"vertex {corner}\n" for corner in ("0 0 0", "1 0 0", "0 1 0"))
    path = tmp_path / "odd.stl"
    path.write_text(
        f"solid x\nfacet normal {normal}\nouter loop\n{corners}endloop\nendfacet\nendsolid x\n"
    )
    run = tso("eval", "--chamfer", path, path)
    assert run.code == 0
    assert "Traceback" not in run.err
    assert caplog.records == []


@pytest.mark.parametrize("compression", ["tiff_lzw", "tiff_deflate", "group4", "jpeg"])
def test_what_libtiff_says_of_a_damaged_picture_is_the_reason_of_its_refusal(
    tmp_path, capfd, compression
):
    mask = np.random.default_rng(0).integers(0, 2, (64, 64), np.uint8) * 255
    Image.fromarray(mask).convert("1" if compression == "group4" else "L").save(
        tmp_path / "a.tif", compression=compression
    )
    data = bytearray((tmp_path / "a.tif").read_bytes())
    for place in range(20, 200, 7):
        data[place] ^= 0x5A
    read_mask(tmp_path / "a.tif")
    (tmp_path / "a.tif").write_bytes(data)
    assert_refused(
        r"a\.tif: is not readable as a mask image \(\w.*: ", read_mask, tmp_path / "a.tif"
    )
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM"])
@pytest.mark.parametrize("part", ["networkx", "trimesh.exchange.gltf", "trimesh.path"])
def test_a_signal_while_trimesh_is_imported_ends_the_command(tmp_path, name, part):
    program = (
        "import signal, sys\n"
        "class Signalled:\n"
        "    def find_spec(self, name, *_):\n"
        f"        if name == {part!r}:\n"
        f"            signal.raise_signal(signal.{name})\n"
        "sys.meta_path.insert(0, Signalled())\n"
        "from tso_cli.cli import main\nmain()"
    )
    mesh = tmp_path / "mesh.stl"
    corners = "vertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\n"
    facet = f"facet normal 0 0 1\nouter loop\n{corners}endloop\nendfacet\n"
    mesh.write_text(f"solid a\n{facet}endsolid a\n")
    run = started("eval", mesh, mesh, program=program)
    assert run.communicate()[1].splitlines()[-1] == "tso: error: interrupted"
    assert run.returncode == 130


def test_ctrl_c_while_open3d_is_imported_is_ctrl_c(tso, tmp_path, monkeypatch, folder):
    class Interrupted:
        def find_spec(self, name, *_):
            if name == "open3d":
                raise ImportError("initialization failed") from KeyboardInterrupt()

    monkeypatch.delitem(sys.modules, "open3d", raising=False)
    monkeypatch.setattr(sys, "meta_path", [Interrupted(), *sys.meta_path])
    mesh = next((ROOT / "examples" / "meshes").rglob("*.ply"))
    run = tso("render", mesh, "-o", tmp_path / "out")
    assert run.code == 130
    assert run.err.splitlines()[-1] == "tso: error: interrupted"


def test_ctrl_c_that_a_library_turned_into_another_error_is_ctrl_c(refine, folder, monkeypatch):
    def interrupted(self, points):
        raise SystemError("returned a result with an exception set") from KeyboardInterrupt()

    monkeypatch.setattr(SilhouetteObjective, "__call__", interrupted)
    run = refine("initial.ply", "mask.png", "--preset", "paper")
    assert run.code == 130
    assert run.err == "tso: error: interrupted\n"
    assert written(folder) == []


def test_what_does_not_fit_into_memory_is_refused_before_the_work(refine, folder, monkeypatch):
    monkeypatch.setattr(reading, "free_memory", lambda: 1.1e6)
    # Once for 1,024 points that all move by themselves, and once for points that may follow.
    refused = refine(*OUTPUTS, "--preset", "paper").refusal
    assert (
        "initial.ply: needs about 0.001 GiB of memory, expected at most the 0.001 that" in refused
    )
    monkeypatch.setattr(reading, "free_memory", lambda: 2e5)
    assert (
        "initial.ply: needs about 0.00024 GiB of memory, expected at most the 0.00019 that"
        in refine(*OUTPUTS).refusal
    )
    monkeypatch.setattr(reading, "free_memory", lambda: 1e5)
    assert_refused("mask.png: needs about", read_mask, Path("mask.png"))
    assert written(folder) == []
    monkeypatch.undo()
    assert reading.free_memory() > 1e8


@pytest.mark.parametrize("name", ["cloud.ply", "cloud.npy", "cloud.xyz"])
def test_a_cloud_too_large_for_the_memory_is_refused_before_it_is_parsed(
    tmp_path, monkeypatch, name
):
    points, path = np.random.default_rng(0).random((2000, 3)), tmp_path / name
    if name == "cloud.npy":
        np.save(path, points)
    elif name == "cloud.xyz":
        np.savetxt(path, points)
    else:
        write_cloud(path, points)
    monkeypatch.setattr(reading, "free_memory", lambda: 4e5)
    for parser in (TextTable, BinaryBody):
        monkeypatch.setattr(parser, "__init__", lambda *_: pytest.fail("was parsed"))
    assert_refused(re.escape(name) + r": needs about 0\.00\d+ GiB of memory", read_cloud, path)


def test_a_full_disk_leaves_the_old_files_and_no_other(refine, folder, monkeypatch):
    assert refine(*OUTPUTS).code == 0
    before = {name: Path(name).read_bytes() for name in NAMES}
    for number in (1, 2, 3):
        calls = iter(range(1, 10))
        full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

        def fsync(_, calls=calls, number=number, full=full):
            if next(calls) == number:
                raise full

        with monkeypatch.context() as patch:
            patch.setattr(output.os, "fsync", fsync)
            assert (
                "No space left on device" in refine(*OUTPUTS, "--overwrite", "--steps", "3").refusal
            )
        assert written(folder) == sorted(NAMES)
        assert number > 1 or before == {n: Path(n).read_bytes() for n in NAMES}


def test_a_process_that_is_killed_leaves_nothing_that_the_next_does_not_remove(folder):
    program = (
        "import os, signal\nfrom tso_cli.cli import main\nfrom tso_cli.plots import overlay\n"
        "overlay.draw_overlay = lambda *_: os.kill(os.getpid(), signal.SIGKILL)\nmain()"
    )
    killed = started("refine", *OUTPUTS, program=program)
    killed.communicate()
    assert killed.returncode == -signal.SIGKILL
    (left,) = written(folder)
    os.utime(left, (0.0, 0.0))  # a younger one may belong to a writer that is about to lock it
    again = started("refine", *OUTPUTS)
    again.communicate()
    assert again.returncode == 0
    assert written(folder) == sorted(NAMES)


def test_ctrl_c_while_the_command_line_is_imported_ends_it_without_a_traceback():
    program = "import sys; sys.argv[0] = 'tso'; from tso_cli.__main__ import main; main()"
    command = [sys.executable, "-X", "importtime", "-c", program, "refine", "--help"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    pipes = {
        "stdout": subprocess.PIPE,
        "stderr": subprocess.PIPE,
        "preexec_fn": partial(signal.signal, signal.SIGINT, signal.SIG_DFL),
    }
    with subprocess.Popen(command, env=environment, text=True, **pipes) as process:
        # A module of click is there, and others are to come.
        next(line for line in process.stderr if " click." in line)
        process.send_signal(signal.SIGINT)
        assert "Traceback" not in process.stderr.read()
        assert process.wait() in (-signal.SIGINT, 130)


NOT_UTF_8 = os.fsdecode(b"name\xff")
LOG = '{"supervision": "masks\\ud800"}\n{"step": 1, "loss": 2}\n{"step": 2, "loss": 1}\n'


@pytest.mark.skipif(sys.platform != "linux", reason="names are text here")
@pytest.mark.parametrize(
    "line",
    [
        "refine {}.ply {}.png --camera camera.json --overlay o.png --report {}.html -o {}.out.ply",
        "eval {}.ply initial.ply",
        "curves {}.jsonl",
        "mask {}.png",
        "render {} -o {}.rendered --views 1",
    ],
)
def test_a_name_that_is_not_utf_8_does_not_end_the_work(folder, line):
    for kind, suffix in (("initial", ".ply"), ("mask", ".png")):
        shutil.copy(kind + suffix, NOT_UTF_8 + suffix)
    Path(f"{NOT_UTF_8}.jsonl").write_text(LOG)
    Path(NOT_UTF_8).mkdir()
    mesh = examples_folder() / "meshes" / "chair" / "q17_Chair.ply"
    shutil.copy(mesh, Path(NOT_UTF_8) / f"{NOT_UTF_8}.ply")
    strict = {"PYTHONIOENCODING": "utf-8:strict"}
    run = started(*line.replace("{}", NOT_UTF_8).split(), environment=strict)
    out, err = run.communicate()
    assert run.returncode == 0, err
    assert "name\\udcff" in out + err


ESCAPES = "\x1b]0;t\x07\x1b[31m\x9b1m"


@pytest.mark.parametrize(
    "line",
    [
        "refine {}.ply {}.png --camera {}.json --steps 2 -v",
        "refine {}.ply {}.png --camera {}.json --check",
        "eval {}.ply initial.ply",
        "eval {}.ply initial.ply --json",
        "curves {}.jsonl",
        "mask {}.png",
    ],
)
def test_names_and_contents_of_files_do_not_control_a_terminal(folder, line):
    pty = pytest.importorskip("pty")
    for kind, suffix in (("initial", ".ply"), ("mask", ".png"), ("camera", ".json")):
        shutil.copy(kind + suffix, ESCAPES + suffix)
    Path(f"{ESCAPES}.jsonl").write_text(LOG.replace("\\ud800", json.dumps(ESCAPES)[1:-1]))
    terminal, end = pty.openpty()
    run = started(*(word.replace("{}", ESCAPES) for word in line.split()), stdout=end, stderr=end)
    os.close(end)
    printed = b""
    with suppress(OSError):  # the end of a terminal
        while part := os.read(terminal, 1 << 16):
            printed += part
    os.close(terminal)
    assert run.wait() == 0
    assert rb"\x1b]0;t\x07" in printed or rb"\u001b]0;t\u0007" in printed
    # A progress bar, which a busy machine shows, ends its line so.
    printed = printed.replace(b"\x1b[K", b"")
    assert re.findall(rb"[^\r\n\t -~]", printed) == []


def test_a_progress_bar_redraws_its_line():
    program = (
        "from tso_cli import cli\ncli._open_streams()\n"
        "print('\\r[##] \\x1b[31m\\x1b[K', end='')\nprint('\\u2713 \\u00e9')"
    )
    run = started(program=program, environment={"PYTHONIOENCODING": "utf-8"})
    # A pipe of text has \n for \r.
    assert run.communicate()[0] == "\n[##] \\x1b[31m\x1b[K\u2713 \u00e9\n"


CHAIR = examples_folder() / "chair"
WRONG = ("refine", CHAIR / "initial.ply", CHAIR / "mask.png", "--invert-mask", "--strict", "--json")


@pytest.mark.parametrize(("arguments", "code"), [(("refine", "--help-all"), 0), (WRONG, 3)])
def test_a_reader_that_leaves_early_changes_no_exit_code(arguments, code, tmp_path):
    with started(*arguments, cwd=tmp_path) as process:
        process.stdout.close()
        assert bool(process.stderr.read()) == bool(code)
        assert process.wait() == code
