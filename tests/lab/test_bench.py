"""`tso bench speed`: contestants, records, claims, tables, chart and command. No time is asserted."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import types

import numpy as np
import pytest
import torch
from PIL import Image

from tests.training import make_known
from tso_cli.errors import TsoError
from tso_cli.lab.bench import PARTS, kernels, large, refining, speed, timing
from tso_cli.lab.bench.timing import Contestant, Setting, record, timed
from tso_cli.losses.chamfer import ChamferToStart
from tso_cli.losses.silhouette import silhouette_sums

ONE_OBJECT = {"preset": "best", "points": 1024, "views": 1}
ON_THREADS = ONE_OBJECT | {"form": "", "over_import_torch": 1.0}
ONE_THREAD = ON_THREADS | {"threads": 1, "busy": False}
BATCH = {
    "preset": "best",
    "points": 1024,
    "views": 1,
    "processes": 2,
    "busy": False,
    "over_import_torch": 1.0,
}
QUICK = Setting(budget=1e-9)


def took(seconds):
    return {"median": seconds, "low": seconds, "high": seconds}


@pytest.fixture(scope="module")
def measured():
    """Every part at sizes that take little time; no process is started."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(timing, "LEAST_RUNS", 1)
        for name, value in (
            ("MORE_VIEWS", (2,)),
            ("CLOUDS", 1),
            ("CORES", 2),
            ("NEIGHBOURED", 2),
            ("SPIN", ""),
        ):
            patch.setattr(refining, name, value)
        patch.setattr(refining, "IMPORT_TORCH", Contestant("import torch", lambda: 1.0))
        for module in (refining, large):
            patch.setattr(module, "process", lambda name, arguments, environment=None: lambda: 1.0)
        patch.setattr(large, "IMPORT_TORCH", refining.IMPORT_TORCH)
        patch.setattr(large, "_peak", lambda file, name, arguments: 1)
        return [
            *refining.measure_command(QUICK),
            *refining.measure_object(QUICK, (64,), 128, steps=1),
            *refining.measure_batch(
                QUICK, {("paper", 64, 1): (2, 3), ("best", 64, 2): (3,)}, steps=1
            ),
            *refining.measure_phases(QUICK, (64,), ()),
            *large.measure_large(QUICK, 64, 64, 64),
            *kernels.measure_silhouette(QUICK, [(64, 16), (128, 32)]),
            *kernels.measure_chamfer(QUICK, [64]),
        ]


# Records


def test_every_part_has_records_of_one_form_with_a_ratio_to_its_first_contestant(measured):
    assert {row["what"] for row in measured} == set(PARTS)
    for row in json.loads(json.dumps(measured)):
        assert set(row) >= {"what", "name", "points", "side", "seconds", "runs"}
        if row["seconds"] is None:
            assert row["left_out"]
            assert row["runs"] == 0
        else:
            assert row["seconds"]["median"] > 0.0
            assert {"over_import_torch", "over_tso", "phases"} & set(row)


def test_batches_run_in_one_process_and_on_all_cores_and_one_size_beside_a_busy_neighbour(measured):
    rows = [row for row in measured if row["what"] == "batch" and "preset" in row]
    alone = {row["views"]: row["seconds"]["median"] for row in rows if row["name"] == "refine"}
    batches = [row for row in rows if row["name"] != "refine"]
    ways = {
        (row["preset"], row["views"], row["batch"], row["processes"], row["busy"])
        for row in batches
    }
    assert ways == {
        *(("paper", 1, 2, count, busy) for count in (1, 2) for busy in (False, True)),
        *(
            (preset, views, 3, count, False)
            for preset, views in (("paper", 1), ("best", 2))
            for count in (1, 2)
        ),
    }
    for row in batches:
        assert row["over_refine"] == pytest.approx(row["seconds"]["median"] / alone[row["views"]])


def test_one_object_runs_in_both_forms_and_in_its_own_on_one_thread_and_on_all_cores(measured):
    rows = [row for row in measured if row["what"] == "object" and "preset" in row]
    forms = {
        (row["preset"], row["points"], row["views"])
        for row in rows
        if row["form"] == "compiled" and row["threads"] == 1
    }
    assert forms == {("best", 64, 1), ("paper", 64, 1), ("best", 128, 1), ("best", 64, 2)}
    chosen = [(row["points"], row["threads"], row["busy"]) for row in rows if row["form"] == ""]
    assert chosen == [
        (points, threads, busy)
        for points in (64, 128)
        for threads in (1, 2)
        for busy in (False, True)
    ]


def test_the_default_is_taken_apart_in_phases_and_what_they_spend_their_time_on(measured):
    rows = [row for row in measured if row["what"] == "phases"]
    assert [row["form"] for row in rows] == ["", "compiled"]
    for row in rows:
        assert (
            {"prepare", "check symmetry", "optimise", "judge"}
            >= set(row["phases"])
            >= {"prepare", "optimise", "judge"}
        )
        assert set(row["of_these"]) == {*refining.PIECES, "rest"}
        assert min(row["first"], *row["phases"].values(), *row["of_these"].values()) > 0.0
        assert row["peak_MiB"] is None or row["peak_MiB"] > 10


@pytest.mark.parametrize(
    ("row", "fields", "met"),
    [
        (("command", "tso --help", 0.16), {}, (True, "0.14 s")),
        (("command", "tso --version", 0.2), {}, (False, "0.18 s")),
        (
            ("command", "steady", 1.0),
            {"points": 1024, "call": "steady", "over_import_torch": 0.36},
            (False, "0.36"),
        ),
        (("command", "first", 1.9), {"points": 16384, "call": "first"}, (True, "1.90x")),
        (("large", "scan", 19.0), {"points": 100, "peak_MiB": 2000}, (False, "2,000 MiB")),
        (("large", "mesh", 3.9), {"points": 100, "peak_MiB": None}, (True, "3.9 s")),
        (
            ("object", "compiled", 1.0),
            {**ONE_THREAD, "form": "compiled", "over_import_torch": 0.14},
            (True, "0.14"),
        ),
        (
            ("object", "1 thread", 1.0),
            {**ONE_THREAD, "points": 16384, "over_import_torch": 0.26},
            (False, "0.26"),
        ),
        (
            ("object", "2 threads", 1.2),
            {**ON_THREADS, "threads": 2, "busy": False},
            (False, "1.20x at worst"),
        ),
        (
            ("object", "2 threads", 1.4),
            {**ON_THREADS, "threads": 2, "busy": True},
            (True, "1.40x at worst"),
        ),
        (("batch", "64", 1.0), {**BATCH, "batch": 64, "over_import_torch": 0.039}, (True, "0.039")),
        (("batch", "16", 1.1), {**BATCH, "batch": 16}, (False, "1.10x at worst")),
        (("batch", "16", 1.4), {**BATCH, "batch": 16, "busy": True}, (True, "1.40x at worst")),
        (("silhouette", "scatter 9x9, torch", 5.0), {"points": 1024}, (True, "5.0x")),
        (("chamfer", "two k-d trees a step, 1 worker", 4.0), {"points": 16384}, (False, "4.0x")),
    ],
)
def test_claims_tell_met_targets_from_missed_ones(row, fields, met):
    """Beside rows that take a second, python that takes 0.02."""
    steady = {"points": 16384, "call": "steady", "over_import_torch": 0.0}
    rows = [
        record("command", "python", seconds=took(0.02)),
        record("command", "tso refine", seconds=took(1.0), **steady),
    ]
    alone = [
        BATCH | {"batch": size, "processes": 1, "busy": busy}
        for size in (16, 64)
        for busy in (False, True)
    ]
    rows += [record("batch", "one process", seconds=took(1.0), **fields) for fields in alone]
    alone = [ON_THREADS | {"threads": 1, "busy": busy} for busy in (False, True)]
    rows += [record("object", "1 thread", seconds=took(1.0), **fields) for fields in alone]
    rows += [
        record(what, "tso, numpy", points=n, seconds=took(1.0))
        for what, n in (("silhouette", 1024), ("chamfer", 16384))
    ]
    what, name, seconds = row
    judged = speed.conclude([*rows, record(what, name, seconds=took(seconds)) | fields])["claims"]
    assert met in [(claim["holds"], claim["found"]) for claim in judged]


# Contestants


def test_the_large_files_are_refined_and_their_memory_is_that_of_the_process():
    rows = large.measure_large(Setting(budget=1e-9), 2000, 2000, 2000)
    assert [row["name"] for row in rows] == ["import torch", "scan", "splats", "mesh"]
    assert rows[3]["points"] >= 2000
    if sys.platform == "linux":
        # A mask of 12 megapixels is there once at least.
        assert rows[1]["peak_MiB"] > rows[2]["peak_MiB"] > 50


def test_the_scatter_computes_the_same_loss_where_points_cover_the_mask():
    points_px, _ = kernels.scene(2048, 24)
    sums = silhouette_sums(points_px, np.ones(2048, bool), 24, 24, 0.4)
    # The clamp hides silhouettes nearer to 0 or 1 than 1e-6.
    drawn, mask = np.tanh(sums).clip(1e-6, 1.0 - 1e-6), (sums > 0.5) & (sums < 2.0)
    expected = -np.log(np.where(mask, drawn, 1.0 - drawn)).sum()
    scattered = kernels.scattered_loss(kernels.tensor(points_px), kernels.tensor(mask))
    assert float(scattered) == pytest.approx(expected, rel=2e-3)


def test_every_contestant_computes_the_same_chamfer_distance_and_gradient():
    initial = refining.cloud(200)
    # Far enough that many nearest neighbours change.
    moved = initial + np.random.default_rng(0).normal(scale=0.05, size=initial.shape)
    expected, by_points = ChamferToStart(initial)(moved)
    for name, term in kernels.terms(initial).items():
        value, gradient = term(moved)
        assert value == pytest.approx(expected, rel=1e-3), name
        np.testing.assert_allclose(gradient, by_points, rtol=1e-3, atol=1e-6, err_msg=name)


def test_a_contestant_that_would_hold_too_much_at_once_is_left_out(monkeypatch):
    monkeypatch.setattr(kernels, "CDIST_UP_TO", 16)
    assert kernels.terms(refining.cloud(32))["cdist, torch"] == "1.0e+03 pairs held at once"


# Times and processes


@pytest.fixture
def clock(monkeypatch):
    """A maker of contestants that take exactly so long, and a list of what ran."""
    ran: list[str] = []
    elapsed = [0.0]

    def make(name: str, seconds: float, calls: int = 1, warm_up: bool = True):
        def work() -> None:
            ran.append(name)
            elapsed[0] += seconds

        return Contestant(name, timed(work), {"size": 1}, calls, warm_up)

    monkeypatch.setattr(timing, "time", types.SimpleNamespace(perf_counter=lambda: elapsed[0]))
    return make, ran


def test_contestants_take_turns_after_a_warm_up(clock):
    make, ran = clock
    first, second = Setting(budget=1.0).race(
        "test", [make("a", 0.25), make("b", 0.5, calls=2)], "over_a"
    )
    assert "".join(ran) == "ab" + "abababa"
    assert (first["seconds"], first["runs"], first["over_a"], first["size"]) == (
        took(0.25),
        4,
        1.0,
        1,
    )
    assert (second["seconds"], second["runs"], second["over_a"]) == (took(0.25), 3, 1.0)


def test_quick_work_is_repeated_within_a_block_and_very_slow_work_is_done_once(clock):
    make, ran = clock
    contestants = [make("quick", 1e-3), make("slow", 100.0, warm_up=False)]
    quick, slow = Setting(budget=0.01).race("test", contestants, "over")
    assert quick["seconds"]["median"] == pytest.approx(1e-3)
    assert (quick["runs"], slow["runs"]) == (5, 1)
    assert (ran.count("quick"), ran.count("slow")) == (1 + 5 * 2, 1)


def test_number_of_cores_and_neighbour_are_gone_after_the_work(monkeypatch):
    for before in ("7", None):
        monkeypatch.setenv("OMP_NUM_THREADS", before) if before else monkeypatch.delenv(
            "OMP_NUM_THREADS"
        )
        seen = []
        refining.on_cores(timed(lambda seen=seen: seen.append(os.environ["OMP_NUM_THREADS"])), 2)()
        assert (seen, os.environ.get("OMP_NUM_THREADS")) == (["2"], before)
    with refining.busy_neighbour() as spinners:
        assert all(spinner.poll() is None for spinner in spinners)
    assert spinners
    assert all(spinner.poll() is not None for spinner in spinners)


def test_a_process_that_fails_is_not_timed():
    with pytest.raises(TsoError, match=r"wrong: ended with exit code 2, saying .*No such command"):
        timing.process("wrong", (*refining.TSO, "nothing"))()


def test_a_first_run_finds_no_byte_code_and_no_compiled_loops(tmp_path):
    environment = timing.never_run(tmp_path)
    copied = list((tmp_path / "fresh").rglob("*"))
    assert environment == {
        "PYTHONPATH": str(tmp_path / "fresh"),
        "NUMBA_CACHE_DIR": str(tmp_path / "compiled"),
    }
    assert tmp_path / "fresh" / "tso_cli" / "cli.py" in copied
    assert not [path for path in copied if path.suffix in (".pyc", ".nbi")]
    assert timing.process("tso --version", (*refining.TSO, "--version"), timing.never_run)() > 0.0


def test_an_installation_is_smaller_without_what_only_torch_requires():
    assert (
        speed.installed("tso-cli")
        > speed.installed("tso-cli", leave_out="torch")
        > speed.installed("numpy")
        > 10
    )
    assert speed.installed("no-such-package") == 0


# The command


def test_the_command_writes_record_page_and_chart(tso, measured, tmp_path, monkeypatch):
    make_known(monkeypatch)
    monkeypatch.setattr(speed, "compile_loops", lambda: None)
    for name in PARTS:
        rows = [row for row in measured if row["what"] == name]
        part = {"refining": refining, "kernels": kernels, "large": large}[PARTS[name]]
        monkeypatch.setattr(
            part,
            f"measure_{name}",
            lambda setting, rows=rows: rows if torch.get_num_threads() == 1 else [],
        )
    output = tmp_path / "speed.json"
    printed = tso("bench", "speed", "-o", output).out
    assert all(row["name"] in printed for row in measured)
    record = json.loads(output.read_text())
    assert record["cases"] == json.loads(json.dumps(measured))
    assert (record["study"], record["command"]) == ("speed", "tso bench speed")
    with Image.open(output.with_suffix(".png")) as chart:
        assert min(chart.size) > 500
    assert {
        row["what"]
        for row in tso("bench", "speed", "--only", "chamfer", "--json").document["cases"]
    } == {"chamfer"}
    assert "nothing" in tso("bench", "speed", "--only", "nothing").refusal


def test_the_process_whose_memory_is_measured_imports_no_torch():
    program = "import sys, tso_cli.lab.bench.refining; sys.exit('torch' in sys.modules)"
    subprocess.run([sys.executable, "-c", program], check=True)
