"""`tso bench speed`: contestants, records, tables, chart and command. No time is asserted."""

from __future__ import annotations

import dataclasses
import json
import sys
import types

import pytest
import torch
from PIL import Image

from tso_cli.errors import InputError, TsoError
from tso_cli.kernels.splat import splat
from tso_cli.lab.bench import chamfer, machine, memory, peers, refinement, silhouette, speed, start_up, timing, training
from tso_cli.lab.bench.claims import claims
from tso_cli.lab.bench.material import SIGMA_SQ, projection, trajectory
from tso_cli.lab.bench.study import STUDY
from tso_cli.lab.bench.timing import Setting, Timing
from tso_cli.lab.charts.speed_chart import draw_speed
from tso_cli.lab.charts.speed_table import left_out, tables
from tso_cli.lab.commands.bench import PARTS
from tso_cli.lab.study import answer
from tso_cli.silhouette.chamfer import ChamferToInitial

from ..training import make_known
from .studying import tso

CPU = torch.device("cpu")
QUICK = Setting(budget=1e-4)
FIELDS = {"what", "name", "points", "side", "batch", "device", "threads", "seconds", "runs", "peak_memory_bytes"}
CHAMFER_PEERS = ("chamferdist", "pykeops", "point_cloud_utils", "pytorch3d")


@pytest.fixture(scope="module")
def measured():
    """Every part at sizes that take no time; the speed of training is a test of its own."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(refinement, "HALFWAY", 1)
        patch.setattr(refinement, "NETWORK_HALFWAY", 0)
        speed_of_training = {"bare": 2.0, "step": 1.0, "added": 1.0, "waiting": 0.0}
        patch.setattr(training, "images_per_second", lambda *_: speed_of_training)
        return [
            *silhouette.measure(QUICK, [(64, 16), (128, 32)]),
            *chamfer.measure(QUICK, [64, 128], steps=1),
            *refinement.terms(QUICK, 64, 16),
            *refinement.points_step(QUICK, 64),
            *refinement.network_step(QUICK, "encoder-decoder"),
            *refinement.batch(QUICK, [1, 2], count=64, steps=1),
            *refinement.more_threads(QUICK, (64, 16), clouds=2, most=2, steps=1),
            *training.measure(QUICK, batch=1),
            QUICK.record("start-up", "python", Timing(0.02, 0.01, 0.03, 3)),
        ]


@pytest.fixture
def record(measured):
    return {
        "bench": "speed",
        "machine": machine.machine(CPU),
        "versions": machine.versions(),
        "threads": 1,
        "device": "cpu",
        "seed": 0,
        "seconds": 1.0,
        "convention": {},
        "claims": claims(measured),
        "records": measured,
    }


def assert_schema(records):
    for record in records:
        assert set(record) >= FIELDS
        json.dumps(record)
        if record["seconds"] is None:
            assert record["left_out"]
            assert record["runs"] == 0
        else:
            assert record["seconds"]["median"] > 0.0


def test_every_record_has_the_schema(measured):
    assert_schema(measured)
    assert {r["name"] for r in measured if r["what"] == "silhouette"} >= {"compiled", "windowed", "exact", *silhouette.RADII}


def test_more_threads_are_compared_with_one(measured):
    rows = [record for record in measured if record["what"] == "threads"]
    assert [record["threads"] for record in rows] == [1, 2] * 3
    for first, second in zip(rows[::2], rows[1::2], strict=True):
        assert (first["name"], first["over_first"]) == (second["name"], 1.0)
        assert second["over_first"] == pytest.approx(first["seconds"]["median"] / second["seconds"]["median"])


def test_claims_tell_met_targets_from_missed_ones(measured):
    sizes = ("compiled", 1.0, 16384, 256), ("scatter 9x9", 5.0, 16384, 256), ("scatter 7x7", 3.0, 16384, 256)
    rows = [
        QUICK.record("silhouette", name, Timing(seconds, seconds, seconds, 3), points=points, side=side)
        for name, seconds, points, side in (*sizes, ("compiled", 64.0, 1_000_000, 1024))
    ]
    by_claim = {claim["claim"].rpartition(" ")[2]: claim for claim in claims(rows)}
    assert by_claim["9x9"]["holds"]
    assert not by_claim["7x7"]["holds"]
    assert by_claim["7x7"]["found"] == "3.0x"
    assert not by_claim["GiB"]["holds"]
    assert by_claim["together"]["found"] == "1.01"  # log 64 over log 61
    assert {claim["holds"] for claim in claims(measured)} <= {True, False}


def test_tables_and_chart_show_every_part(record, tmp_path):
    titles = [table.title for table in tables(record)]
    parts = "silhouette, Chamfer, projector, points mode, a step: ms, a cloud, threads, images, processes"
    for part in parts.split(", "):
        assert any(part in title for title in titles), part
    text = answer(STUDY, {**record, "claims": [{"claim": "fast", "found": "slow", "holds": False}]})
    assert "scatter 7x7" in text
    assert "target missed: fast (slow)" in text
    assert all(cell in text for line in left_out(record["records"]) for cell in line)
    draw_speed(tmp_path / "speed.png", record)
    with Image.open(tmp_path / "speed.png") as chart:
        assert min(chart.size) > 1000


def test_the_scatter_computes_the_same_loss_where_points_cover_the_mask():
    scene = projection(2048, 24, CPU)
    sums = splat(scene.points_px, scene.valid, 24, 24, SIGMA_SQ)
    covered = (sums > 0.5) & (sums < 2.0)
    scene = dataclasses.replace(scene, mask=covered.float())
    # The clamp hides silhouettes nearer to 0 or 1 than 1e-6.
    expected = torch.nn.functional.binary_cross_entropy(torch.tanh(sums).clamp(1e-6, 1 - 1e-6), scene.mask, reduction="sum")
    assert float(silhouette.scattered_loss(scene.points_px, scene.mask, 4)) == pytest.approx(float(expected), rel=1e-4)
    assert float(silhouette.scattered_loss(scene.points_px, scene.mask, 3)) == pytest.approx(float(expected), rel=1e-2)


def test_every_contestant_computes_the_same_chamfer_distance_and_gradient():
    initial = trajectory(200, CPU, steps=1)[0]
    # Far enough that many nearest neighbours change.
    moved = initial + 0.05 * torch.randn(initial.shape, generator=torch.Generator().manual_seed(0))
    expected = ChamferToInitial(initial.double())(moved.double())
    gradients = []
    for name, make in chamfer.makers(initial, QUICK).items():
        term = make()
        if isinstance(term, str):
            assert name in CHAMFER_PEERS
            continue
        leaf = moved.clone().requires_grad_()
        value = term(leaf)
        assert float(value.detach()) == pytest.approx(float(expected), rel=1e-3), name
        gradients.append(torch.autograd.grad(value.sum(), leaf)[0])
    assert len(gradients) >= 5
    for gradient in gradients[1:]:
        torch.testing.assert_close(gradient, gradients[0], rtol=1e-3, atol=1e-6)


def test_a_trajectory_starts_at_the_initial_points_and_keeps_every_step():
    iterates = trajectory(100, CPU, steps=4)
    moved = [float((iterate - iterates[0]).norm()) for iterate in iterates]
    assert len(moved) == 5
    assert moved[0] == 0.0
    assert moved == sorted(moved)


def test_a_missing_package_is_recorded_and_the_run_goes_on(monkeypatch):
    for package in (*CHAMFER_PEERS, "gsplat"):
        monkeypatch.setitem(sys.modules, package, None)
    records = chamfer.measure(QUICK, [32], steps=1) + silhouette.measure(QUICK, [(32, 16)])
    missing = {(r["what"], r["name"]) for r in records if r.get("left_out") == peers.NOT_INSTALLED}
    assert missing == {*(("chamfer", name) for name in CHAMFER_PEERS), ("silhouette", "pytorch3d"), ("silhouette", "gsplat")}
    assert ["chamfer, chamferdist", "not installed"] in left_out(records)


@pytest.mark.parametrize("fails", [True, False])
def test_an_installed_package_is_measured_or_recorded_with_its_error(fails, monkeypatch):
    class ChamferDistance:
        def __call__(self, moved, initial, **_):
            if fails:
                raise RuntimeError("needs\na GPU")
            return (moved - initial).square().sum()

    monkeypatch.setitem(sys.modules, "chamferdist", types.SimpleNamespace(ChamferDistance=ChamferDistance))
    (record,) = [r for r in chamfer.measure(QUICK, [32], steps=1) if r["name"] == "chamferdist"]
    if fails:
        assert record["left_out"] == "does not run here (needs a GPU)"
    else:
        assert record["seconds"]["median"] > 0.0


def test_sizes_that_take_too_long_are_left_out_with_the_reason():
    assert silhouette.too_much("exact", 16384, 256) is None
    assert "multiply-adds" in silhouette.too_much("exact", 1_000_000, 1024)
    assert "taps" in silhouette.too_much("scatter 9x9", 1_000_000, 1024)
    assert silhouette.too_much("compiled", 1_000_000, 1024) is None


@pytest.fixture
def clock(monkeypatch):
    """A maker of work that takes exactly so long, and a list of what ran."""
    ran: list[str] = []
    now = [0.0]

    def make(name: str, seconds: float):
        def work() -> None:
            ran.append(name)
            now[0] += seconds

        return work

    monkeypatch.setattr(timing, "time", types.SimpleNamespace(perf_counter=lambda: now[0]))
    return make, ran


def test_contestants_take_turns_after_a_warm_up(clock):
    make, ran = clock
    timings = Setting(budget=1.0).race({"a": make("a", 0.25), "b": make("b", 0.5)})
    assert ran[:4] == ["a", "a", "b", "b"]
    assert ran[4:] == ["a", "b", "a", "b", "a", "b", "a"]
    assert timings == {"a": Timing(0.25, 0.25, 0.25, 4), "b": Timing(0.5, 0.5, 0.5, 3)}


def test_quick_work_is_repeated_within_a_sample_and_very_slow_work_is_sampled_once(clock):
    make, ran = clock
    timings = Setting(budget=0.01).race({"quick": make("quick", 1e-4), "slow": make("slow", 100.0)})
    assert timings["quick"] == Timing(*[pytest.approx(1e-4)] * 3, 5)
    assert ran.count("quick") == 2 + 5 * 20
    assert timings["slow"] == Timing(100.0, 100.0, 100.0, 1)
    assert ran.count("slow") == 2


def test_peak_memory_is_what_one_call_adds_in_a_fresh_process(monkeypatch):
    exact = QUICK.record("silhouette", "exact", Timing(1.0, 1.0, 1.0, 1), points=4096, side=128)
    memory.add_peaks([exact, QUICK.record("silhouette", "gsplat", left_out="not installed")], QUICK)
    # At least the two factors of the product, 4,096 x 128 float32 each.
    assert exact["peak_memory_bytes"] is None or exact["peak_memory_bytes"] > 2 * 4096 * 128 * 4
    monkeypatch.setattr(sys, "executable", "false")
    assert memory.peak(exact, 0) is None


def test_each_command_line_gives_one_record(monkeypatch, tmp_path):
    commands = start_up._commands(tmp_path)
    assert {"python", "import torch", "tso --version", "tso --help", start_up.REFINE} <= set(commands)
    chosen = {"python": commands["python"], "version, first": (commands["tso --version"][0], start_up._first)}
    monkeypatch.setattr(start_up, "_commands", lambda folder: chosen)
    records = start_up.measure(QUICK, repeats=1)
    assert [record["name"] for record in records] == list(chosen)
    assert_schema(records)


def test_a_first_run_finds_no_byte_code(tmp_path):
    environment = start_up._first(tmp_path)
    copied = list((tmp_path / "fresh").rglob("*"))
    assert environment["PYTHONPATH"] == str(tmp_path / "fresh")
    assert tmp_path / "fresh" / "tso_cli" / "cli.py" in copied
    assert not [path for path in copied if path.suffix == ".pyc"]


def test_a_command_that_fails_is_not_timed():
    with pytest.raises(TsoError, match=r"wrong: ended with exit code 2, saying .*No such command"):
        start_up._run("wrong", (*start_up.TSO, "nothing"), start_up._warm)


def run(*arguments):
    return tso("bench", "speed", *arguments)


def test_the_command_writes_record_and_chart_and_overwrites_nothing(tmp_path, capsys, monkeypatch):
    make_known(monkeypatch)
    assert set(PARTS) == set(speed.PARTS)
    monkeypatch.setitem(speed.PARTS, "terms", lambda setting: refinement.terms(setting, 64, 16))
    output = tmp_path / "speed.json"
    arguments = ["--only", "terms", "--seconds", "0.001", "-o", str(output), "--json"]
    assert run(*arguments) == 0
    record = json.loads(output.read_text())
    assert json.loads(capsys.readouterr().out)["records"] == record["records"]
    assert set(record) >= {"bench", "machine", "versions", "threads", "device", "seed", "seconds", "convention", "claims"}
    assert (record["bench"], {r["what"] for r in record["records"]}) == ("speed", {"terms"})
    assert_schema(record["records"])
    before = output.read_bytes()
    assert run(*arguments) == 2
    assert "exists" in capsys.readouterr().err
    assert output.read_bytes() == before
    output.unlink()
    assert run(*arguments) == 2  # the chart is still there
    assert not output.exists()


@pytest.mark.parametrize(
    "arguments",
    ["--only nothing", "--seconds 0", "--threads 0", "--threads 1000000", "--seconds nan", "--seconds inf", "-o speed.txt"],
)
def test_bad_options_are_refused_in_one_line(arguments, capsys):
    assert run(*arguments.split()) == 2
    error = capsys.readouterr().err
    assert error.startswith("tso: error:") and error.count("\n") == 1
    assert any(word in error for word in arguments.split())


def test_a_device_that_is_not_measured_is_refused():
    with pytest.raises(InputError, match="cpu or cuda"):
        speed.speed(Setting(torch.device("mps"), budget=1e-3), ["terms"])
