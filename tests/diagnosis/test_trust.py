"""What to think of a result: the table of rules, and refinements that it judges."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from tests.scenes import example
from tso_cli import RefineConfig, refine, refine_batch
from tso_cli.diagnosis.confidence import REASONS
from tso_cli.diagnosis.examine import Diagnosis
from tso_cli.diagnosis.findings import Finding
from tso_cli.diagnosis.trust import (
    FINDING,
    LEAST_CONFIDENCE,
    LEAST_IF_ASSUMED,
    LEAST_OVERLAP,
    MOST_OF_DOUBTFUL,
    RULES,
    Facts,
    Trust,
    trust_of,
    words_of,
)

from .common import EXAMPLES, changed, named

CHAIR = example("chair")
FLIPPED = changed(CHAIR.view, "mask-flipped")
NOTHING = Diagnosis(())
OPENGL = Finding("opengl", (0,))
BOX = Diagnosis((), of_views=(Finding("box", (0,)),))
UNSURE = Finding("unsure-camera", (0,), values={"why": "two poses fit"})
UNPLACED = Finding("unsure-place", (0,), values={"why": "two places fit"})
ASSUMED = Finding("assumed-camera", (0,))
# The shape moved far, to where it agrees better.
SURE = Facts(
    NOTHING,
    improved=True,
    placed=False,
    asked=False,
    explains=False,
    far=2.0 * MOST_OF_DOUBTFUL,
    missed=(0.5, 0.1),
    overlap=(0.6, 0.9),
    confidence=0.9,
    group="motion",
)
LOW = LEAST_CONFIDENCE - 0.01


def doubtful(reason: str, says: str, moves: bool = False, confidence: float | None = None) -> Trust:
    return Trust("doubtful", confidence, reason, says, moves)


# For each rule, in their order: what is then other than in `SURE`, and what it says.
ROWS = {
    "finding": (
        {"diagnosis": Diagnosis((), of_input=(OPENGL,))},
        doubtful(FINDING, f"it looks as if {OPENGL.says}"),
    ),
    "unsure": (
        {"diagnosis": Diagnosis((), notes=(UNSURE,))},
        doubtful("unsure-camera", "the fitted camera is unsure: two poses fit"),
    ),
    "overlap": (
        {"overlap": (0.05, 0.9)},
        doubtful("overlap", "cloud and mask hardly overlap (IoU 0.05)"),
    ),
    "assumed": (
        {"diagnosis": Diagnosis((), notes=(ASSUMED,)), "overlap": (0.3, 0.9)},
        doubtful("assumed-camera", ASSUMED.says),
    ),
    "fits": (
        {"diagnosis": Diagnosis((), fits=True), "improved": False},
        Trust("left", 1.0, moves=False),
    ),
    "unexplained": (
        {"improved": False},
        Trust(
            "left",
            None,
            "unexplained",
            "nothing that was tried agrees better with the masks, and the cloud misses 50% of "
            "their contours",
            moves=False,
        ),
    ),
    "unknown": (
        {"unknown": ("steps", "6 steps are too few")},
        Trust(None, None, "steps", "6 steps are too few"),
    ),
    "move": (
        {"placed": True, "asked": True},
        doubtful(
            "move", "the cloud missed 50% of the contours, and misses 10% in its new place", True
        ),
    ),
    "explained": (
        {"placed": True, "asked": True, "explains": True, "confidence": 0.5},
        Trust("fits better", None),
    ),
    "place": (
        {"placed": True},
        doubtful("place", "the cloud was out of place, or the camera is: masks cannot tell"),
    ),
    "model": (
        {"confidence": 0.5},
        doubtful("motion", REASONS["motion"], confidence=0.5),
    ),
    "rest": ({}, Trust("fits better", 0.9)),
}
# What stays has not moved as one, and what was asked for is not by default.
EXCLUSIVE = {
    *((stays, moved) for stays in ("fits", "unexplained") for moved in ("move", "place")),
    ("move", "place"),
    ("move", "explained"),
    ("explained", "place"),
    *((stays, "explained") for stays in ("fits", "unexplained")),
}


# The table


@pytest.mark.parametrize("name", ROWS)
def test_each_rule_says_what_to_think(name):
    changes, expected = ROWS[name]
    facts = replace(SURE, **changes)
    assert [rule.holds(facts) for rule in RULES].index(True) == list(ROWS).index(name)
    assert trust_of(facts) == expected
    assert trust_of(facts, {"motion: across": 1.0}).features == {"motion: across": 1.0}


def test_a_cloud_that_fits_a_part_of_its_mask_is_not_sure_to_be_right():
    diagnosis = Diagnosis((), fits=True, hidden={0: np.ones((4, 4), bool)})
    trust = trust_of(replace(SURE, diagnosis=diagnosis, improved=False))
    assert (trust.verdict, trust.confidence) == ("left", None)


def test_each_rule_has_a_row():
    assert len(ROWS) == len(RULES)


def _both(first: str, second: str) -> Facts:
    """What holds for two rules at once; where they differ, as for the first."""
    (of_first, _), (of_second, _) = ROWS[first], ROWS[second]
    diagnoses = [changes.get("diagnosis", NOTHING) for changes in (of_first, of_second)]
    diagnosis = Diagnosis(
        (),
        of_input=tuple(one for each in diagnoses for one in each.of_input),
        notes=tuple(one for each in diagnoses for one in each.notes),
        fits=any(each.fits for each in diagnoses),
    )
    return replace(SURE, **{**of_second, **of_first, "diagnosis": diagnosis})


@pytest.mark.parametrize(
    ("first", "second"), [pair for pair in combinations(ROWS, 2) if pair not in EXCLUSIVE]
)
def test_of_two_rules_that_hold_the_first_decides(first, second):
    facts = _both(first, second)
    holds = dict(zip(ROWS, (rule.holds(facts) for rule in RULES), strict=True))
    assert holds[first]
    assert holds[second]
    expected = ROWS[first][1]
    trust = trust_of(facts)
    assert (trust.verdict, trust.reason) == (expected.verdict, expected.reason)


@pytest.mark.parametrize(("first", "second"), sorted(EXCLUSIVE))
def test_the_other_rules_exclude_each_other(first, second):
    holds = [rule.holds(_both(first, second)) for rule in RULES]
    assert not all(holds[list(ROWS).index(name)] for name in (first, second))


@pytest.mark.parametrize(
    ("below", "at", "reason"),
    [
        ({"confidence": LOW}, {"confidence": LEAST_CONFIDENCE}, "motion"),
        ({"overlap": (0.6, LEAST_OVERLAP - 0.01)}, {"overlap": (0.6, LEAST_OVERLAP)}, "overlap"),
    ],
)
def test_a_limit_itself_is_not_doubtful(below, at, reason):
    assert trust_of(replace(SURE, **below)).reason == reason
    assert trust_of(replace(SURE, **at)).verdict == "fits better"


def test_a_camera_that_nobody_gave_is_doubtful_only_where_the_cloud_hardly_fits_it():
    assumed = replace(SURE, diagnosis=Diagnosis((), notes=(ASSUMED,)))
    assert trust_of(replace(assumed, overlap=(LEAST_IF_ASSUMED, 0.9))) == trust_of(SURE)
    assert trust_of(replace(assumed, overlap=(LEAST_IF_ASSUMED - 0.01, 0.9))).verdict == "doubtful"


@pytest.mark.parametrize("row", ["place", "model"])
def test_what_is_doubtful_moves_only_a_little(row):
    doubted = replace(SURE, **ROWS[row][0])
    assert trust_of(replace(doubted, far=MOST_OF_DOUBTFUL)).moves
    assert not trust_of(replace(doubted, far=MOST_OF_DOUBTFUL + 0.01)).moves


@pytest.mark.parametrize("row", ["finding", "unsure", "overlap", "assumed"])
def test_where_something_is_wrong_nothing_moves_however_little(row):
    assert not trust_of(replace(SURE, **ROWS[row][0], far=0.0)).moves


@pytest.mark.parametrize(
    ("outvoted", "confidence", "moves"),
    [(False, 1.0, False), (True, LOW, False), (True, LEAST_CONFIDENCE, True)],
)
def test_what_is_wrong_with_few_views_the_others_outvote_where_the_model_is_sure(
    outvoted, confidence, moves
):
    facts = replace(SURE, diagnosis=replace(BOX, outvoted=outvoted), confidence=confidence)
    assert trust_of(facts) == doubtful(FINDING, words_of(BOX), moves)


def test_what_an_explaining_move_gains_is_more_than_its_shape_could_lose():
    explained = replace(SURE, placed=True, asked=True, explains=True, far=2.0)
    for confidence in (0.9, 0.3):
        trust = trust_of(replace(explained, confidence=confidence))
        assert trust == Trust("fits better", None)


def test_an_unsure_place_is_doubtful_as_an_unsure_camera_is():
    trust = trust_of(replace(SURE, diagnosis=Diagnosis((), notes=(UNPLACED,))))
    says = "the place of the cloud is unsure: two places fit"
    assert trust == doubtful("unsure-place", says)


@pytest.mark.parametrize(
    ("about", "findings", "joined"),
    [
        ("of_input", [OPENGL], "{0}"),
        ("of_input", [OPENGL, Finding("pytorch3d", (0,))], "{0} or {1}"),
        ("of_views", [Finding("box", (0,)), Finding("mispaired", (1, 2))], "{0}; {1}"),
    ],
)
def test_alternatives_are_joined_by_or_and_findings_of_views_are_listed(about, findings, joined):
    diagnosis = Diagnosis((), **{about: tuple(findings)})
    says = joined.format(*(finding.says for finding in findings))
    assert words_of(diagnosis) == f"it looks as if {says}"


# Refinements


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_result_of_right_input_fits_better(name):
    scene = example(name)
    result = refine(scene.points, scene.view)
    assert result.trust.verdict == "fits better"
    assert result.trust.reason == ""
    assert result.trust.confidence >= LEAST_CONFIDENCE
    assert result.findings == ()


def test_a_doubtful_displacement_is_not_taken_unless_accepted():
    careful, accepted = (
        refine(CHAIR.points, FLIPPED, config=RefineConfig(accept_doubtful=accept))
        for accept in (False, True)
    )
    assert (careful.points == careful.initial).all()
    assert (careful.fit.outcome, careful.fit.stop_reason) == ("left", "doubtful")
    assert careful.fit.best_step == 0
    assert careful.fit.moved_max == 0.0
    assert careful.fit.iou_after == careful.fit.iou_before
    assert careful.fit.loss_after == careful.fit.loss_before
    assert not careful.trust.moves
    assert not careful.moved
    assert (accepted.trust.verdict, accepted.trust.says) == ("doubtful", careful.trust.says)
    assert accepted.fit.outcome == "moved"
    assert accepted.moved
    assert accepted.fit.moved_mean > 0.01


@pytest.mark.parametrize("config", [RefineConfig(), RefineConfig(preset="paper")])
@pytest.mark.parametrize("name", ["mask-inverted", "mask-flipped"])
def test_wrong_input_is_doubtful_and_stays(name, config):
    result = refine(CHAIR.points, changed(CHAIR.view, name), config=config)
    assert named(result.findings) == [(name, (0,))]
    assert (result.trust.verdict, result.trust.reason) == ("doubtful", FINDING)
    assert not result.trust.moves
    assert np.array_equal(result.points, CHAIR.points)


def test_suspicious_input_is_found_also_where_nothing_moves():
    result = refine(CHAIR.points, FLIPPED, config=RefineConfig(steps=0))
    assert (result.trust.verdict, result.trust.moves) == ("doubtful", False)
    assert ("mask-flipped", (0,)) in named(result.findings)


def test_a_result_of_few_points_has_no_confidence():
    trust = refine(CHAIR.target[::103], CHAIR.view, config=RefineConfig(symmetry="none")).trust
    expected = Trust(None, None, "points", "10 points are too few")
    assert replace(trust, features={}) == expected


def test_a_start_that_stays_is_sure_only_where_it_fits():
    fits, misfits = (
        refine(points, CHAIR.view, config=RefineConfig(steps=0))
        for points in (CHAIR.target, CHAIR.points)
    )
    assert (fits.trust.verdict, fits.trust.confidence) == ("left", 1.0)
    assert (misfits.trust.verdict, misfits.trust.confidence) == ("left", None)
    assert misfits.trust.reason == "unexplained"
    assert not fits.moved
    assert not misfits.moved


def test_a_batch_has_the_verdict_of_a_single_cloud():
    single = refine(CHAIR.points, CHAIR.view).trust
    (batched,) = refine_batch([(CHAIR.points, CHAIR.view)])
    assert batched.trust.verdict == single.verdict
    assert batched.trust.confidence == pytest.approx(single.confidence, abs=0.02)
