"""`tso lab speed`: contestants, records, claims, tables, chart and command. No time is asserted."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from PIL import Image

from tso_cli.errors import TsoError
from tso_cli.losses.chamfer import ChamferToStart
from tso_cli.losses.silhouette import silhouette_sums
from tso_lab.bench import speed, timing
from tso_lab.bench.timing import Contestant, Setting, record, timed
from tso_lab.commands import tools
from tso_lab.study import Plan

from ..training import make_known

SETTING = Setting(budget=1e-9, least_runs=1)


@pytest.fixture(scope="module")
def measured():
    """Every part at sizes that take little time; whole processes are replaced by one second."""
    with pytest.MonkeyPatch.context() as patch:
        for name, value in (("MORE_VIEWS", (2,)), ("DIFFERENT", 1), ("CORES", 2), ("SPIN", "")):
            patch.setattr(speed, name, value)
        patch.setattr(speed, "WITH_NEIGHBOUR", 2)
        patch.setattr(speed, "IMPORT_TORCH", Contestant("import torch", lambda: 1.0))
        patch.setattr(speed, "process", lambda *of: lambda: 1.0)
        batches = {("paper", 64, 1): (2, 3), ("best", 64, 2): (3,)}
        return [
            row
            for what, races in {
                "command": speed.commands(0),
                "object": speed.objects(0, (64,), 128, steps=1),
                "batch": speed.batches(0, batches, steps=1),
                "silhouette": speed.silhouettes(0, [(64, 16), (128, 32)]),
                "chamfer": speed.chamfers(0, [64, 128]),
            }.items()
            for race in races
            for row in SETTING.race(what, race, speed.PARTS[what][1])
        ]


# Records


def test_every_part_has_records_of_one_form_with_a_ratio_to_its_first_contestant(measured):
    assert {row["what"] for row in measured} == set(speed.PARTS) - {"large"}
    for row in json.loads(json.dumps(measured)):
        assert set(row) >= {"what", "name", "points", "side", "seconds", "runs"}
        assert row["seconds"]["median"] > 0.0
        assert {"over_import_torch", "over_tso"} & set(row)


def of(measured, what):
    return [row for row in measured if row["what"] == what and row["points"]]


def test_batches_run_in_one_process_and_on_all_cores_and_one_size_with_a_busy_neighbour(measured):
    rows = of(measured, "batch")
    keys = ("preset", "views", "batch", "processes", "busy")
    expected = {("paper", 1, 2, count, busy) for count in (1, 2) for busy in (False, True)}
    expected |= {("paper", 1, 3, count, False) for count in (1, 2)}
    expected |= {("best", 2, 3, count, False) for count in (1, 2)}
    assert {tuple(row[key] for key in keys) for row in rows} == expected


def test_one_object_runs_on_one_thread_and_the_default_on_all_cores_too(measured):
    rows = of(measured, "object")
    places = [(threads, busy) for threads in (1, 2) for busy in (False, True)]
    expected = {("best", points, 1, *place) for points in (64, 128) for place in places}
    expected |= {("best", 64, 2, 1, False), ("paper", 64, 1, 1, False)}
    keys = ("preset", "points", "views", "threads", "busy")
    found = [tuple(row[key] for key in keys) for row in rows]
    assert set(found) == expected
    assert len(found) == len(expected)


OBJECT = {"preset": "best", "points": 1024, "views": 1, "over_import_torch": 1.0}
BATCH = {"preset": "best", "points": 1024, "views": 1, "over_import_torch": 1.0, "processes": 2}
ONE_THREAD = OBJECT | {"threads": 1, "busy": False}
TWO_THREADS = OBJECT | {"threads": 2, "busy": False}
QUICK = ONE_THREAD | {"over_import_torch": 0.14}
MANY_POINTS = ONE_THREAD | {"points": 16384, "over_import_torch": 0.26}
LARGE_BATCH = BATCH | {"batch": 64, "busy": False, "over_import_torch": 0.039}
STEADY = {"points": 1024, "call": "steady", "over_import_torch": 0.36}


@pytest.mark.parametrize(
    ("what", "name", "seconds", "fields", "met"),
    [
        ("command", "tso --help", 0.16, {}, (True, "0.14 s")),
        ("command", "tso --version", 0.2, {}, (False, "0.18 s")),
        ("command", "steady", 1.0, STEADY, (False, "0.36")),
        ("command", "first", 1.9, {"points": 16384, "call": "first"}, (True, "1.90x")),
        ("large", "scan", 19.0, {"points": 100, "peak_MiB": 2000}, (False, "2,000 MiB")),
        ("large", "mesh", 3.9, {"points": 100, "peak_MiB": None}, (True, "3.9 s")),
        ("object", "1 thread", 1.0, QUICK, (True, "0.14")),
        ("object", "1 thread", 1.0, MANY_POINTS, (False, "0.26")),
        ("object", "2 threads", 1.2, TWO_THREADS, (False, "1.20x at worst")),
        ("object", "2 threads", 1.4, TWO_THREADS | {"busy": True}, (True, "1.40x at worst")),
        ("batch", "64", 1.0, LARGE_BATCH, (True, "0.039")),
        ("batch", "16", 1.1, BATCH | {"batch": 16, "busy": False}, (False, "1.10x at worst")),
        ("batch", "16", 1.4, BATCH | {"batch": 16, "busy": True}, (True, "1.40x at worst")),
        ("silhouette", "scatter 9x9, torch", 5.0, {"points": 1024}, (True, "5.0x")),
        ("chamfer", "two k-d trees a step, 1 worker", 4.0, {"points": 16384}, (False, "4.0x")),
    ],
)
def test_claims_separate_met_targets_from_missed_ones(what, name, seconds, fields, met):
    """Among rows that take a second, and python that takes 0.02."""
    second = partial(record, taken=[1.0])
    steady = {"points": 16384, "call": "steady", "over_import_torch": 0.0}
    rows = [record("command", "python", [0.02]), second("command", "tso refine", **steady)]
    for busy in (False, True):
        rows.append(second("object", "1 thread", **ONE_THREAD | {"busy": busy}))
        for size in (16, 64):
            alone = BATCH | {"batch": size, "processes": 1, "busy": busy}
            rows.append(second("batch", "one process", **alone))
    rows += [second("silhouette", "tso", points=1024)]
    rows += [second("chamfer", "tso", points=16384)]
    claims = speed.conclude([*rows, record(what, name, [seconds], **fields)])["claims"]
    assert met in [(claim["holds"], claim["found"]) for claim in claims]


# Contestants


@pytest.mark.slow
def test_the_large_files_are_refined_and_their_memory_is_that_of_the_process():
    for race in speed.large_files(0, 2000, 2000, 2000):
        rows = SETTING.race("large", race, speed.OVER_TORCH)
    assert [row["name"] for row in rows] == ["import torch", "scan", "splats", "mesh"]
    assert rows[3]["points"] >= 2000
    if sys.platform == "linux":
        # A mask of 12 megapixels is there once at least.
        assert rows[1]["peak_MiB"] > rows[2]["peak_MiB"] > 50


def test_the_scatter_computes_the_same_loss_where_points_cover_the_mask():
    points_px, _ = speed.picture(2048, 24)
    sums = silhouette_sums(points_px, np.ones(2048, bool), 24, 24, 0.4)
    # The clamp hides silhouettes nearer to 0 or 1 than 1e-6.
    drawn, mask = np.tanh(sums).clip(1e-6, 1.0 - 1e-6), (sums > 0.5) & (sums < 2.0)
    expected = -np.log(np.where(mask, drawn, 1.0 - drawn)).sum()
    target = torch.as_tensor(mask, dtype=torch.float32)
    assert speed.scattered_loss(points_px, target)[0] == pytest.approx(expected, rel=2e-3)


def test_every_contestant_computes_the_same_chamfer_distance_and_gradient():
    initial = speed.cloud(200)
    # Far enough that many nearest neighbours change.
    moved = initial + np.random.default_rng(0).normal(scale=0.05, size=initial.shape)
    expected, by_points = ChamferToStart(initial)(moved)
    for name, term in speed.terms(initial).items():
        value, gradient = term(moved)
        assert value == pytest.approx(expected, rel=1e-3), name
        np.testing.assert_allclose(gradient, by_points, rtol=1e-3, atol=1e-6, err_msg=name)


# Times and processes


@pytest.fixture
def clock():
    """A maker of contestants that take exactly so long, and a list of what ran."""
    ran: list[str] = []
    elapsed = [0.0]

    def make(name: str, seconds: float, **options):
        def work() -> None:
            ran.append(name)
            elapsed[0] += seconds

        return Contestant(name, timed(work, clock=lambda: elapsed[0]), {"size": 1}, **options)

    return make, ran


def test_contestants_take_turns_after_a_warm_up(clock):
    make, ran = clock
    contestants = [make("a", 0.25), make("b", 0.5, calls=2)]
    first, second = Setting(budget=1.0).race("test", contestants, "over_a")
    assert "".join(ran) == "ab" + "abababa"
    took = {"median": 0.25, "low": 0.25, "high": 0.25}
    assert first["seconds"] == second["seconds"] == took
    assert (first["runs"], second["runs"], second["over_a"], second["size"]) == (4, 3, 1.0, 1)


def test_quick_work_is_repeated_within_a_block_and_very_slow_work_is_done_once(clock):
    make, ran = clock
    contestants = [make("quick", 1e-3), make("slow", 100.0, warm_up=False)]
    quick, slow = Setting(budget=0.01).race("test", contestants, "over")
    assert quick["seconds"]["median"] == pytest.approx(1e-3)
    assert (quick["runs"], slow["runs"]) == (5, 1)
    assert (ran.count("quick"), ran.count("slow")) == (1 + 5 * 2, 1)


@pytest.mark.parametrize("before", ["7", None])
def test_number_of_cores_is_as_before_after_the_work(monkeypatch, before):
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    if before:
        monkeypatch.setenv("OMP_NUM_THREADS", before)
    seen = []
    speed.on_cores(timed(lambda: seen.append(os.environ["OMP_NUM_THREADS"])), 2)()
    assert (seen, os.environ.get("OMP_NUM_THREADS")) == (["2"], before)


def test_a_busy_neighbour_is_gone_after_the_work():
    with speed.busy_neighbour() as spinners:
        assert all(spinner.poll() is None for spinner in spinners)
    assert all(spinner.poll() is not None for spinner in spinners)


def test_a_process_that_fails_is_not_timed():
    with pytest.raises(TsoError, match=r"wrong: ended with exit code 2, saying .*No such command"):
        timing.process("wrong", (*speed.TSO, "nothing"))()


def test_a_first_run_finds_no_byte_code(tmp_path):
    environment = timing.never_run(tmp_path)
    fresh = tmp_path / "fresh"
    assert environment["PYTHONPATH"] == str(fresh)
    assert (fresh / "tso_cli" / "cli.py").exists()
    assert not [path for path in fresh.rglob("*") if path.suffix == ".pyc"]
    assert timing.process("tso --version", (*speed.TSO, "--version"), timing.never_run)() > 0.0


def test_an_installation_is_smaller_without_the_packages_of_networks():
    without, whole = speed.installed("numpy"), speed.installed("numpy", *speed.NETWORK)
    assert whole > without + 100
    assert speed.installed("tso-cli") > without > 10
    assert speed.installed("no-such-package") == 0


def test_the_process_whose_memory_is_measured_imports_no_torch():
    program = "import sys, tso_lab.bench.timing; sys.exit('torch' in sys.modules)"
    subprocess.run([sys.executable, "-c", program], check=True)


# The command


def test_the_command_writes_record_page_and_chart(tso, measured, tmp_path, monkeypatch):
    make_known(monkeypatch)
    settings = {
        "machine": timing.machine(),
        "installed_MB": {"in all": 1},
        "versions": {},
        "seed": 0,
    }

    def plan(progress, *, parts, seed):
        rows = {what: [row for row in measured if row["what"] == what] for what in parts}
        return Plan(settings, [({"what": what}, partial(rows.get, what, [])) for what in parts])

    known = speed.STUDY
    monkeypatch.setattr(tools, "load", lambda name: replace(known, plan=plan))
    parts = [word for what in speed.PARTS if what != "large" for word in ("--only", what)]
    output = tmp_path / "speed.json"
    printed = tso("lab", "speed", *parts, "-o", output).out
    assert all(row["name"] in printed for row in measured)
    kept = json.loads(output.read_text())
    assert kept["cases"] == json.loads(json.dumps(measured))
    assert kept["command"].startswith("tso lab speed --only command")
    with Image.open(output.with_suffix(".png")) as chart:
        assert min(chart.size) > 500
    assert "nothing" in tso("lab", "speed", "--only", "nothing").refusal


def test_a_part_is_measured_on_one_thread(monkeypatch):
    threads = []
    races = lambda seed: [[Contestant("a", lambda: threads.append(torch.get_num_threads()) or 1.0)]]  # noqa: E731
    monkeypatch.setitem(speed.PARTS, "chamfer", (races, "over_tso"))
    speed.measure("chamfer", SETTING)
    assert set(threads) == {1}
