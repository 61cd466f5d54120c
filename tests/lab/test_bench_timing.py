"""How times, rates and memory are measured, and what the limit is. No time is asserted."""

from __future__ import annotations

import types

import pytest
import torch

from tests.lab.benching import QUICK, RATES
from tso_cli.lab.bench import machine, memory, silhouette, timing
from tso_cli.lab.bench.timing import Setting, Timing, race, slope


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
