"""`tso bench pareto`: the front is what it says, lines are in the order of what is swept, and the command makes its record."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st
from PIL import Image

from tso_cli.lab.bench import pareto
from tso_cli.lab.bench.pareto import conclude, front
from tso_cli.lab.bench.pareto_chart import _lines
from tso_cli.lab.bench.ways import DEFAULT, PAPER, STARTS, WAYS, Way
from tso_cli.lab.stability.peers import PEERS
from tso_cli.lab.studies.refining import Variant
from tso_cli.refinement import RefineConfig

from ..training import make_known

# Few different numbers, so that some are equal.
NUMBERS = st.integers(0, 6).map(float)


def dominates(one, other):
    return one != other and one[0] <= other[0] and one[1] <= other[1]


@given(st.lists(st.tuples(NUMBERS, NUMBERS), max_size=12))
def test_none_of_the_front_is_dominated_and_every_other_point_is(places):
    chosen = front(places)
    assert [places[i][0] for i in chosen] == sorted(places[i][0] for i in chosen)
    for number, place in enumerate(places):
        assert (number not in chosen) == any(dominates(other, place) for other in places)


def case(shape, ratios, kind="other", view=0):
    ways = {
        name: {"ratio": ratio, "seconds": 0.1 * (i + 1)}
        for i, (name, ratio) in enumerate(ratios.items())
    }
    return {"kind": kind, "category": "car", "shape": shape, "view": view, "ways": ways}


SOME = {PAPER: 0.9, DEFAULT: 0.7, f"{DEFAULT}, 2 masks": 0.5, **dict.fromkeys(PEERS, 0.95)}


def test_views_of_a_shape_count_once_in_the_error_and_further_masks_not_in_the_front():
    two = [case("car/a", SOME), case("car/b", SOME | {DEFAULT: 0.5})]
    group = conclude(two)["summary"]["other"]
    assert (group["cases"], group["shapes"], group["front"]) == (2, 2, [PAPER, DEFAULT])
    assert group["ways"][DEFAULT]["mean_ratio"] == pytest.approx(0.6)
    assert group["ways"][DEFAULT]["standard_error"] == pytest.approx(0.1)
    assert group["ways"][DEFAULT]["median_seconds"] == pytest.approx(0.2)
    again = conclude([*two, *(row | {"view": 1} for row in two)])["summary"]["other"]
    assert (again["cases"], again["ways"][DEFAULT]) == (4, group["ways"][DEFAULT])


@pytest.mark.parametrize(
    ("default", "holds"),
    [(0.7, [True, True, True]), (0.95, [True, False, True]), (1.2, [False] * 3)],
)
def test_claims_are_of_the_figures(default, holds):
    ratios = (
        SOME
        | {PAPER: 0.96, DEFAULT: default}
        | dict.fromkeys(PEERS, 1.0 if default == 0.95 else 0.96)
    )
    cases = [
        case(f"car/{name}", ratios | {PAPER: 0.95 + 0.05 * i}, "network")
        for i, name in enumerate("ab")
    ]
    claims = conclude(cases)["claims"]
    assert [claim["holds"] for claim in claims] == [holds[0], holds[1], default <= 0.94]


def test_sweeps_of_the_input_go_through_the_default():
    lines = _lines({"ways": {name: {} for name, way in WAYS.items() if "other" in way.kinds}})
    assert lines["points"] == [
        f"{DEFAULT}, 256 points",
        DEFAULT,
        *(f"{DEFAULT}, {count} points" for count in ("4,096", "16,384")),
    ]
    assert lines["masks"] == [DEFAULT, f"{DEFAULT}, 2 masks", f"{DEFAULT}, 4 masks"]
    assert lines[DEFAULT][0] == f"{DEFAULT}, 6 steps"
    assert DEFAULT in lines[DEFAULT]
    assert lines["alpha points"] == ["alpha points"]


def test_without_meshes_only_the_quick_run_is_there(tso):
    assert "--meshes is missing" in tso("bench", "pareto").refusal


@pytest.mark.slow
def test_the_command_writes_record_chart_and_page_and_a_line_more_in_the_table_is_a_way_more(
    tso, tmp_path, monkeypatch
):
    make_known(monkeypatch)
    kept = (
        DEFAULT,
        PAPER,
        f"{DEFAULT}, 2 masks",
        f"{DEFAULT}, 256 points",
        f"{DEFAULT}, 32 px",
        "latent, best",
        "latent, paper",
    )
    for name, way in list(WAYS.items()):
        if name not in (*kept, *PEERS):
            monkeypatch.delitem(WAYS, name)
        elif isinstance(way.run, Variant):
            monkeypatch.setitem(
                WAYS,
                name,
                replace(way, run=replace(way.run, config=replace(way.run.config, steps=2))),
            )
    monkeypatch.setitem(WAYS, "budget auto", Way(Variant(RefineConfig(steps=1))))
    output = tmp_path / "pareto.json"
    arguments = ("bench", "pareto", "--quick", "-o", output)
    assert "start: the network's prediction: 3 cases of 3 shapes" in tso(*arguments).out
    record = json.loads(output.read_text())
    assert (record["complete"], record["command"]) == (True, "tso bench pareto --quick")
    assert {"cpu", "cores"} <= set(record["settings"]["machine"])
    assert set(record["summary"]["network"]["ways"]) == {
        name for name, way in WAYS.items() if "network" in way.kinds
    }
    for row in record["cases"]:
        assert row["kind"] in STARTS
        # One or two steps move a cloud, or come no nearer to its mask, and leave it.
        assert all(
            found["seconds"] > 0.0 and found["ratio"] > 0.0 for found in row["ways"].values()
        )
        assert sum(found["ratio"] != 1.0 for found in row["ways"].values()) > len(row["ways"]) / 2
    assert "| budget auto |" in output.with_suffix(".md").read_text()
    with Image.open(output.with_suffix(".png")) as picture:
        assert picture.width == 900
    monkeypatch.setattr(pareto, "_judged", None)
    assert tso(*arguments, "--resume").code == 0
    assert json.loads(output.read_text())["cases"] == record["cases"]
