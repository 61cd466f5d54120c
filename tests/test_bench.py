"""The measurement of speed: what is recorded, and what is done with it. No time is asserted."""

from __future__ import annotations

import dataclasses
import json
import math
import sys
import types

import pytest
import torch
from PIL import Image

from tso_cli.bench import chamfer, loop, machine, memory, network_forms, peers, profile, silhouette, speed, timing, training
from tso_cli.bench.claims import claims
from tso_cli.bench.material import SIGMA_SQ, projection, trajectory
from tso_cli.bench.timing import Setting, Timing, race, slope
from tso_cli.cli import main
from tso_cli.commands.bench import PARTS
from tso_cli.errors import InputError
from tso_cli.kernels.splat import splat
from tso_cli.losses import ChamferToInitial
from tso_cli.report.speed_chart import draw_speed
from tso_cli.report.speed_table import left_out_lines, sections, speed_table

FIELDS = {"what", "name", "points", "side", "batch", "device", "threads", "seconds", "runs", "peak_memory_bytes"}
QUICK = Setting(budget=1e-4)
RATES = {"multiply-add": 1e9, "load, multiply-add, store": 5e8}


def _assert_schema(records):
    assert records
    for record in records:
        assert set(record) >= FIELDS
        json.dumps(record)
        if record["seconds"] is None:
            assert record["left_out"]
            assert record["runs"] == 0
        else:
            assert record["seconds"]["median"] > 0.0


@pytest.fixture(scope="module")
def measured():
    """Every part at sizes that take no time."""
    records = [
        {**QUICK.record("rate", name), "per_second": rate, "unit": "multiply-adds", "runs": 1} for name, rate in RATES.items()
    ]
    records = [{**record, "seconds": {"median": 1.0, "low": 1.0, "high": 1.0}} for record in records]
    records += silhouette.measure(QUICK, RATES, [(64, 16), (128, 32)])
    records += profile.measure(QUICK, [(64, 16)])
    records += silhouette.growth(QUICK, {"points": [(64, 16), (128, 16)], "pixels": [(64, 16), (64, 32)]})
    records += chamfer.measure(QUICK, [64, 128], steps=2)
    records += loop.terms(QUICK, [(64, 16)])
    records += loop.points_step(QUICK, [64])
    records += loop.network_steps(QUICK)
    records += network_forms.measure(QUICK)
    records += loop.batch(QUICK, [1, 2], count=64, steps=1)
    records += training.measure(QUICK, batch=1)
    records += [QUICK.record("start-up", "python", Timing(0.02, 0.01, 0.03, 3))]
    return records


@pytest.fixture
def record(measured):
    """A whole record made of them."""
    return {
        "bench": "speed",
        "machine": machine.machine(torch.device("cpu")),
        "versions": machine.versions(),
        "threads": 1,
        "device": "cpu",
        "seed": 0,
        "seconds": 1.0,
        "convention": speed.CONVENTION,
        "claims": claims(measured),
        "records": measured,
    }


@pytest.fixture
def clock(monkeypatch):
    """Work that takes exactly so long, and a list of what ran."""
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
    found = race({"a": make("a", 0.25), "b": make("b", 0.5)}, budget=1.0)
    assert ran[:4] == ["a", "a", "b", "b"]
    assert ran[4:] == ["a", "b", "a", "b", "a", "b", "a"]
    assert found == {"a": Timing(0.25, 0.25, 0.25, 4), "b": Timing(0.5, 0.5, 0.5, 3)}


def test_quick_work_is_repeated_within_a_sample_and_very_slow_work_is_sampled_once(clock):
    make, ran = clock
    found = race({"quick": make("quick", 1e-4), "slow": make("slow", 100.0)}, budget=0.01)
    assert found["quick"] == Timing(*[pytest.approx(1e-4)] * 3, 5)
    assert ran.count("quick") == 2 + 5 * 20
    assert found["slow"] == Timing(100.0, 100.0, 100.0, 1)
    assert ran.count("slow") == 2


def test_the_slope_is_the_exponent_of_a_power_law():
    sizes = [10, 100, 1000]
    assert slope(sizes, [3.0 * n**1.5 for n in sizes]) == pytest.approx(1.5)


def test_every_record_has_the_schema(measured):
    _assert_schema(measured)
    assert {r["name"] for r in measured if r["what"] == "silhouette"} >= {"compiled", "windowed", "exact", *silhouette.RADII}


def test_the_scatter_is_the_same_loss_where_every_mask_pixel_is_reached():
    scene = projection(2048, 24, torch.device("cpu"))
    sums = splat(scene.points_px, scene.valid, 24, 24, SIGMA_SQ)
    covered = (sums > 0.5) & (sums < 2.0)
    scene = dataclasses.replace(scene, mask=covered.float())
    # the clamp hides silhouettes nearer to 0 or 1 than 1e-6
    expected = torch.nn.functional.binary_cross_entropy(torch.tanh(sums).clamp(1e-6, 1 - 1e-6), scene.mask, reduction="sum")
    assert float(silhouette.scattered_loss(scene.points_px, scene.mask, 4)) == pytest.approx(float(expected), rel=1e-4)
    narrow = silhouette.scattered_loss(scene.points_px, scene.mask, 3)
    assert float(narrow) == pytest.approx(float(expected), rel=1e-2)


def test_every_contestant_computes_the_same_chamfer_distance_and_gradient():
    start = trajectory(200, torch.device("cpu"), steps=1)[0]
    # so far that many a neighbour is another than the point's own start
    moved = start + 0.05 * torch.randn(start.shape, generator=torch.Generator().manual_seed(0))
    expected = ChamferToInitial(start.double())(moved.double())
    gradients = []
    for name, make in chamfer.makers(start, QUICK).items():
        term = make()
        if isinstance(term, str):
            assert name in ("chamferdist", "pykeops", "point_cloud_utils", "pytorch3d")
            continue
        leaf = moved.clone().requires_grad_()
        value = term(leaf)
        assert float(value.detach()) == pytest.approx(float(expected), rel=1e-3), name
        gradients.append(torch.autograd.grad(value.sum(), leaf)[0])
    assert len(gradients) >= 5
    for gradient in gradients[1:]:
        torch.testing.assert_close(gradient, gradients[0], rtol=1e-3, atol=1e-6)


def test_a_trajectory_starts_where_nothing_moved_and_keeps_every_step():
    iterates = trajectory(100, torch.device("cpu"), steps=4)
    assert len(iterates) == 5
    moved = [float((iterate - iterates[0]).norm()) for iterate in iterates]
    assert moved[0] == 0.0
    assert moved == sorted(moved)


def test_a_peer_that_is_missing_is_recorded_and_stops_nothing(monkeypatch):
    for package in ("chamferdist", "pykeops", "point_cloud_utils", "pytorch3d", "gsplat"):
        monkeypatch.setitem(sys.modules, package, None)
    records = chamfer.measure(QUICK, [32], steps=1) + silhouette.measure(QUICK, RATES, [(32, 16)])
    missing = {(r["what"], r["name"]) for r in records if r.get("left_out") == peers.NOT_INSTALLED}
    assert missing == {
        *(("chamfer", name) for name in ("chamferdist", "pykeops", "point_cloud_utils", "pytorch3d")),
        ("silhouette", "pytorch3d"),
        ("silhouette", "gsplat"),
    }


def test_a_peer_that_fails_is_recorded_with_its_reason(monkeypatch):
    class ChamferDistance:
        def __call__(self, *_, **__):
            raise RuntimeError("needs\na GPU")

    monkeypatch.setitem(sys.modules, "chamferdist", types.SimpleNamespace(ChamferDistance=ChamferDistance))
    records = chamfer.measure(QUICK, [32], steps=1)
    (found,) = [record for record in records if record["name"] == "chamferdist"]
    assert found["left_out"] == "does not run here (needs a GPU)"


def test_a_peer_that_is_there_is_measured(monkeypatch):
    class ChamferDistance:
        def __call__(self, moved, initial, **_):
            return (moved - initial).square().sum()

    monkeypatch.setitem(sys.modules, "chamferdist", types.SimpleNamespace(ChamferDistance=ChamferDistance))
    records = chamfer.measure(QUICK, [32], steps=1)
    assert next(record for record in records if record["name"] == "chamferdist")["seconds"]["median"] > 0.0


def test_what_would_take_too_long_is_left_out_with_the_reason():
    assert silhouette.too_much("exact", 16384, 256) is None
    assert "multiply-adds" in silhouette.too_much("exact", 1_000_000, 1024)
    assert "taps" in silhouette.too_much("scatter 9x9", 1_000_000, 1024)
    assert silhouette.too_much("compiled", 1_000_000, 1024) is None


def test_the_limit_is_three_multiply_adds_a_tap_over_the_rate():
    found = silhouette.limit(1000, 64, 4, RATES)
    assert found["arithmetic"] == pytest.approx(3 * 81_000 / 1e9)
    assert found["scatter"] == pytest.approx(81_000 / 5e8 + 2 * 81_000 / 1e9)
    assert "memory" in silhouette.limit(1000, 64, 4, {"multiply-add": 1e9, "copy": 1e9})


def test_the_rates_are_those_of_loops_that_do_what_they_say():
    found = {record["name"]: record["per_second"] for record in machine.rates(Setting(budget=0.01))}
    assert set(found) == set(RATES)
    values = torch.ones(1, machine.FLOATS).numpy()
    machine._in_cache(0, 1, values, 2.0)
    assert values[0, 0] == 1.0 + 2.0 * machine.SWEEPS
    values[:] = 1.0
    machine._in_registers(0, 1, values, 1.0, 1.0)
    assert (values == 1.0 + machine.SWEEPS).all()


def test_memory_is_what_one_call_adds_in_a_process_of_its_own():
    exact = QUICK.record("silhouette", "exact", points=4096, side=128)
    found = memory.peak(exact, 0)
    # at least the two factors of the product, 4,096 x 128 float32 each
    assert found is None or found > 2 * 4096 * 128 * 4
    assert memory.peak({**exact, "name": "no such kernel"}, 0) is None


def test_the_claims_say_what_was_found(measured):
    at = {"points": 16384, "side": 256}
    records = [
        QUICK.record("silhouette", "compiled", Timing(1.0, 1.0, 1.0, 3), **at),
        QUICK.record("silhouette", "scatter 9x9", Timing(5.0, 5.0, 5.0, 3), **at),
        QUICK.record("silhouette", "scatter 7x7", Timing(3.0, 3.0, 3.0, 3), **at),
    ]
    found = {claim["claim"].rpartition(" ")[2]: claim for claim in claims(records)}
    assert found["9x9"]["holds"]
    assert not found["7x7"]["holds"]
    assert found["7x7"]["found"] == "3.0x"
    assert {claim["holds"] for claim in claims(measured)} <= {True, False}


def test_the_tables_and_the_chart_show_every_part(record, tmp_path):
    names = {section.name for section in sections(record)}
    assert names >= {
        "rate",
        "silhouette",
        "profile",
        "growth",
        "chamfer",
        "terms",
        "step",
        "network",
        "batch",
        "training",
        "start-up",
    }
    text = speed_table(record)
    assert "scatter 7x7" in text
    assert all(line in text for line in left_out_lines(record["records"]))
    draw_speed(tmp_path / "speed.png", record)
    with Image.open(tmp_path / "speed.png") as chart:
        assert min(chart.size) > 1000


@pytest.mark.parametrize("part", sorted(speed.PARTS))
def test_a_chart_of_one_part_alone_can_be_drawn(part, record, tmp_path):
    own = {"limit": ("rate",), "silhouette": ("silhouette", "limit"), "step": ("step", "step, encoder")}.get(part, (part,))
    chosen = [r for r in record["records"] if r["what"].partition(",")[0] in own]
    draw_speed(tmp_path / "part.png", {**record, "records": chosen})
    assert (tmp_path / "part.png").exists()


def _run(arguments):
    with pytest.raises(SystemExit) as stopped:
        main(["bench", "speed", *arguments])
    return stopped.value.code


def test_the_command_names_the_parts_there_are():
    assert set(PARTS) == set(speed.PARTS)


def test_the_command_writes_record_and_chart_and_overwrites_nothing(tmp_path, capsys):
    output = tmp_path / "speed.json"
    arguments = ["--only", "limit", "--seconds", "0.001", "-o", str(output)]
    assert _run(arguments) == 0
    assert "multiply-add" in capsys.readouterr().out
    record = json.loads(output.read_text())
    assert set(record) >= {"bench", "machine", "versions", "threads", "device", "seed", "seconds", "records"}
    assert record["bench"] == "speed"
    assert math.isfinite(record["seconds"])
    _assert_schema(record["records"])
    with Image.open(output.with_suffix(".png")) as chart:
        assert chart.size[0] > 600
    before = output.read_bytes()
    assert _run(arguments) == 2
    error = capsys.readouterr().err
    assert "exists" in error
    assert output.read_bytes() == before
    output.unlink()
    assert _run(arguments) == 2
    assert not output.exists()


def test_with_json_one_document_is_printed(capsys):
    assert _run(["--only", "limit", "--seconds", "0.001", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["bench"] == "speed"


@pytest.mark.parametrize(
    "arguments",
    [
        ["--only", "nothing"],
        ["--seconds", "0"],
        ["--threads", "0"],
        ["--threads", "1000000"],
        ["--seconds", "nan"],
        ["--seconds", "inf"],
        ["-o", "speed.txt"],
    ],
)
def test_what_cannot_be_measured_gets_one_line(arguments, capsys):
    assert _run(arguments) == 2
    error = capsys.readouterr().err
    assert error.startswith("tso: error:")
    assert error.count("\n") == 1
    assert arguments[-1] in error or arguments[0] in error


def test_a_device_that_is_not_measured_is_refused():
    with pytest.raises(InputError, match="cpu or cuda"):
        speed.speed(Setting(torch.device("mps"), budget=1e-3), ["limit"])
