"""`tso lab pareto`: the front is what it says, lines are in the order of what is swept."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tso_cli.refinement import refine
from tso_lab.bench.pareto import DEFAULT, PAPER, WAYS, conclude, front, lines
from tso_lab.bench.peers import PEERS
from tso_lab.studies.cases import PAPER as PAPER_PRESET
from tso_lab.studies.cases import POINTS

from .studying import holding

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


def case(shape, ratios, kind="other"):
    found = enumerate(ratios.items())
    ways = {name: {"ratio": ratio, "seconds": 0.1 * (i + 1)} for i, (name, ratio) in found}
    return {"kind": kind, "category": "car", "shape": shape, "ways": ways}


SOME = {PAPER: 0.9, DEFAULT: 0.7, f"{DEFAULT}, 2 masks": 0.5, **dict.fromkeys(PEERS, 0.95)}


def test_the_error_is_over_shapes_and_further_masks_are_not_in_the_front():
    two = [case("car/a", SOME), case("car/b", SOME | {DEFAULT: 0.5})]
    group = conclude(two)["summary"]["other"]
    assert (group["cases"], group["front"]) == (2, [PAPER, DEFAULT])
    assert group["ways"][DEFAULT]["mean_ratio"] == pytest.approx(0.6)
    assert group["ways"][DEFAULT]["standard_error"] == pytest.approx(0.1)
    assert group["ways"][DEFAULT]["median_seconds"] == pytest.approx(0.2)


@pytest.mark.parametrize(
    ("default", "peer", "holds"),
    [(0.7, 0.96, [True, True, True]), (0.95, 1.0, [True, False, False]), (1.2, 0.96, [False] * 3)],
)
def test_claims_are_of_the_figures(default, peer, holds):
    ratios = SOME | {DEFAULT: default} | dict.fromkeys(PEERS, peer)
    cases = [case(f"car/{i}", ratios | {PAPER: 0.95 + 0.05 * i}, "network") for i in range(2)]
    assert holding(conclude(cases)) == holds


def test_sweeps_of_the_input_go_through_the_default():
    found = lines({"ways": {name: {} for name, way in WAYS.items() if "other" in way.kinds}})
    counts = [f"{DEFAULT}, {count} points" for count in ("256", "4,096", "16,384")]
    assert found["points"] == [counts[0], DEFAULT, *counts[1:]]
    assert found["masks"] == [DEFAULT, f"{DEFAULT}, 2 masks", f"{DEFAULT}, 4 masks"]
    assert found[DEFAULT][0] == f"{DEFAULT}, 5 steps"
    assert found["alpha points"] == ["alpha points"]


@pytest.mark.slow
def test_peers_do_what_the_paper_does_near_the_mask_and_stay_where_it_is_far_from_it(chair):
    initial, view = chair.points, chair.view
    papers = refine(initial, view, config=POINTS[PAPER_PRESET].config).points
    moved = {name: peer(initial, [view]) for name, peer in PEERS.items()}
    ratios = {
        name: chair.error(points) / chair.error(initial)
        for name, points in {"paper": papers, **moved}.items()
    }
    assert ratios["log(tanh + 1e-8)"] == pytest.approx(ratios["paper"], abs=0.01)
    assert all(0.9 < ratio < 1.0 for ratio in ratios.values())
    far = initial + [0.0, 10.0, 0.0]
    for peer in PEERS.values():
        np.testing.assert_allclose(peer(far, [view]), far, atol=2e-3)
