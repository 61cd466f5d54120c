"""`tso bench budget`: scenes from a brick to a lattice, and what each decision of auto saves and costs there."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from tso_cli.evaluation.metrics import chamfer
from tso_cli.lab.bench import budget


def test_a_start_is_the_truth_stretched_and_bent_and_its_mask_is_of_the_truth():
    start, target, (view, _) = budget.scene("car", 64, 256, masks=2, seed=0)
    assert (len(start), len(target), view.mask.shape) == (256, 16_384, (64, 64))
    assert np.ptp(target, axis=0).max() == pytest.approx(1.0, abs=0.01)
    assert np.ptp(start, axis=0)[0] > np.ptp(target, axis=0)[0]
    of_target, of_start = (
        view.camera.project(points)[0].round().astype(int) for points in (target, start)
    )
    assert (
        view.mask[of_target[:, 1], of_target[:, 0]].mean()
        > view.mask[of_start[:, 1], of_start[:, 0]].mean() + 0.01
    )
    assert 1e-4 < chamfer(start, target).chamfer < 1e-1


def test_a_lattice_is_of_struts_along_every_edge():
    lattice = budget.lattice(cells=2, width=0.02)
    assert len(lattice.faces) == 3 * 9 * 12
    assert np.ptp(lattice.vertices, axis=0) == pytest.approx([1.02] * 3)


def case(points, **ways):
    place = {"shape": "brick", "size": 64, "points": points, "masks": 2}
    return {
        **place,
        "ways": {
            name: {"ratio": ratio, "seconds": seconds} for name, (ratio, seconds) in ways.items()
        },
    }


def test_ways_are_compared_with_auto_in_the_scenes_that_both_refine():
    found = budget.conclude(
        [case(256, auto=(0.5, 0.1), full=(0.4, 0.4)), case(1024, auto=(0.7, 0.2))]
    )
    assert found["summary"]["auto"]["mean_ratio"] == pytest.approx(0.6)
    full = {
        "scenes": 1,
        "mean_ratio": 0.4,
        "median_seconds": 0.4,
        "cost": 1.25,
        "error": 0.0,
        "saving": 0.75,
    }
    assert found["summary"]["full"] == full
    assert [claim["holds"] for claim in found["claims"]] == [False, True, True]


def test_a_quicker_way_that_comes_nearer_is_told_by_scene():
    ways = {"auto": (0.6, 0.2), "full": (0.4, 0.4)}
    cases = [
        case(256, **ways),
        case(1024, **ways, **{"24 steps": (0.5, 0.1), "96 steps": (0.1, 0.3)}),
    ]
    near = budget.conclude(cases)["claims"][2]
    assert not near["holds"]
    assert (
        near["found"]
        == "1 of 2 scenes; at most 1.20 times, 24 steps: brick, 64 px, 1,024 points, 2 masks"
    )


def test_every_mask_of_a_scene_is_seen_in_every_way(monkeypatch):
    seen = []

    def see(start, views, config):
        seen.append(len(views))
        return SimpleNamespace(points=start)

    for name, stub in (
        ("refine", see),
        ("uninterrupted", lambda result: result),
        ("compile_loops", lambda: None),
    ):
        monkeypatch.setattr(budget, name, stub)
    jobs = budget.plan(None, shapes=("brick",), scenes=3, seed=0).jobs
    (place, job) = jobs[-1]
    assert place["masks"] == 2
    assert job()[0]["ways"]["24 steps"]["ratio"] == pytest.approx(1.0)
    assert seen == [2] * len(budget.WAYS)


def test_the_command_writes_a_record_its_chart_and_its_page(tso, tmp_path):
    output = tmp_path / "budget.json"
    assert (
        "auto's ratio / this"
        in tso("bench", "budget", "--shape", "brick", "--scenes", 1, "-o", output).out
    )
    record = json.loads(output.read_text())
    assert len(record["cases"]) == budget.DRAWS
    assert set(record["cases"][0]["ways"]) == set(budget.WAYS)
    assert "brick, 64 px, 256 points" in output.with_suffix(".md").read_text()
    assert output.with_suffix(".png").stat().st_size > 3000
    output.write_text(json.dumps({**record, "complete": False, "cases": record["cases"][:-1]}))
    assert (
        tso("bench", "budget", "--shape", "brick", "--scenes", 1, "-o", output, "--resume").code
        == 0
    )
    assert json.loads(output.read_text())["cases"][:-1] == record["cases"][:-1]
