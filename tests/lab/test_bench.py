"""The measurement of speed: what is recorded, and what is done with it. No time is asserted."""

from __future__ import annotations

import pytest
import torch
from PIL import Image

from tests.lab.benching import QUICK, RATES, assert_schema
from tso_cli.lab.bench import chamfer, loop, machine, many_threads, network_forms, profile, silhouette, speed, training
from tso_cli.lab.bench.claims import claims
from tso_cli.lab.bench.timing import Timing
from tso_cli.lab.charts.speed_chart import draw_speed
from tso_cli.lab.charts.speed_table import left_out_lines, sections, speed_table
from tso_cli.network.model import CONVOLUTIONS, LATENT, build_network


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
    records += many_threads.measure(QUICK, (64, 16), clouds=2, counts=[1, 2])
    records += training.measure(QUICK, batch=1, side=64)
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


def test_every_record_has_the_schema(measured):
    assert_schema(measured)
    assert {r["name"] for r in measured if r["what"] == "silhouette"} >= {"compiled", "windowed", "exact", *silhouette.RADII}


def test_more_threads_are_compared_with_one(measured):
    found = [record for record in measured if record["what"] == "threads"]
    assert [record["threads"] for record in found] == [1, 2] * 3
    for first, second in zip(found[::2], found[1::2], strict=True):
        assert (first["name"], first["over_first"]) == (second["name"], 1.0)
        assert second["over_first"] == pytest.approx(first["seconds"]["median"] / second["seconds"]["median"])


def test_the_roofline_of_training_counts_the_multiply_adds_of_every_layer(measured):
    # forward, then backward by weights and by input, which the first layer's image does not ask for
    forward, side, channels = [], 64, 3
    for out, size, stride in CONVOLUTIONS:
        side //= stride
        forward.append(side * side * size * size * channels * out)
        channels = out
    forward += [16 * channels * LATENT, LATENT * 256, 256 * 256, 256 * 3 * 1024]
    expected = 3 * sum(forward) - forward[0]
    assert training.multiply_adds(build_network()) == expected
    rates = {}
    for record in measured:
        if record["what"] == "training rate":
            rates[record["precision"]] = max(record["per_second"], rates.get(record["precision"], 0.0))
    found = [record for record in measured if record["what"].startswith("training, ")]
    assert found
    for record in found:
        assert record["roofline"] == pytest.approx(rates[record["precision"]] / expected)
        assert 0.0 <= record["waiting"] < 1.0


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
        "threads",
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
