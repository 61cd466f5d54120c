"""`tso lab confidence`: what the model is fitted to, and what its figures count."""

import numpy as np
import pytest

from tso_cli.errors import InputError
from tso_lab.harm.scenes import gallery
from tso_lab.harm.study import altered
from tso_lab.harm.troubles import TROUBLE
from tso_lab.studies import confidence
from tso_lab.study import Progress

from .studying import MESHES

NOTHING, YAW = TROUBLE["nothing wrong"], TROUBLE["yaw"]


@pytest.fixture(scope="module")
def shown():
    return gallery(meshes=None, split=None, part="validation", unseen=None, seed=0)


def of(trouble, start="other", **figures):
    """A case that moved, of that trouble and start."""
    right = dict(ratio=0.5, confidence=0.9, moved=True, finding=False, flagged=False, left=False)
    names = dict(trouble=trouble, start=start, group=TROUBLE[trouble].group)
    return names | right | dict(iou_gain=0.1) | figures


# What the model is fitted to


def test_right_scenes_have_other_starts_and_one_two_and_four_masks(shown, monkeypatch):
    seen = []
    monkeypatch.setattr(confidence, "row_of", lambda names, scene: seen.append(names))
    for trouble in (NOTHING, YAW):
        for start in trouble.starts:
            list(confidence.rows_of(shown, trouble, start, 3))
    right = [row for row in seen if confidence.is_right(row)]
    assert len(right) == 3 * confidence.RIGHT_TIMES
    assert {row["views"] for row in right} == {1, 2, 4}
    others = [(row["trouble"], row["start"]) for row in seen if row not in right]
    assert sorted(set(others)) == [(NOTHING.name, "exact"), ("yaw", "exact"), ("yaw", "other")]
    assert confidence.is_right(of("depth right"))
    assert not confidence.is_right(of("depth noise"))


def test_a_row_has_a_ratio_and_the_features_of_a_displacement(shown):
    names, scene = altered(shown, TROUBLE["yaw"], "other", 2, 1)
    row, features = confidence.row_of(names, scene)
    assert row["moved"]
    assert row["ratio"] > 0.0
    assert "input: findings" in features
    refused, nothing = confidence.row_of(names, InputError("no pixel"))
    assert refused == {**names, "refused": True}
    assert not nothing


def fitted_to(right, wrong, shared):
    """The model of right scenes and of wrong ones, so many each, with two features.

    Wrong scenes get worse where the points moved far; ``shared`` of right scenes do so anyhow.
    """
    rng, rows = np.random.default_rng(0), []
    for number in range(right + wrong):
        is_right = number < right
        far = float(rng.normal() + (0.0 if is_right else 2.0))
        worse = rng.random() < (shared if is_right else 1.0 / (1.0 + np.exp(-2.0 * far)))
        row = of("nothing wrong" if is_right else "yaw", ratio=2.0 if worse else 0.5)
        features = {"motion: across": far, "evidence: views": float(rng.normal())}
        rows.append((row | {"shape": f"{number % 50}"}, features))
    return confidence.fitted(rows), rows


def test_the_fit_finds_which_feature_shows_a_worse_result():
    model, _ = fitted_to(2000, 2000, 0.02)
    (_, _, far), (_, _, views) = model["features"].values()
    assert far > 1.0
    assert abs(views) < 0.1 * far


def test_the_fit_is_calibrated_for_as_many_right_scenes_as_wrong_ones():
    model, rows = fitted_to(500, 2000, 0.02)
    logits = np.full(len(rows), model["offset"])
    for name, (mean, deviation, slope) in model["features"].items():
        logits += slope * (np.array([found[name] for _, found in rows]) - mean) / deviation
    expected = 1.0 / (1.0 + np.exp(-logits))
    worse = np.array([row["ratio"] > 1.05 for row, _ in rows])
    weights = np.repeat([0.5 / 500, 0.5 / 2000], [500, 2000])
    assert np.average(expected, weights=weights) == pytest.approx(
        np.average(worse, weights=weights), abs=0.01
    )


def test_only_displacements_count_for_the_fit():
    model, rows = fitted_to(200, 200, 0.1)
    kept = of("yaw", moved=False, ratio=1.0, shape="0"), dict.fromkeys(rows[0][1], 99.0)
    placed = of("yaw", ratio=9.0, shape="0"), {}
    assert confidence.fitted([*rows, kept, placed, ({"refused": True}, {})]) == model


@pytest.mark.slow
def test_the_command_that_judges_writes_the_model_too(split, tmp_path):
    path = tmp_path / "model.json"
    options = dict(meshes=MESHES, split=split, part="validation", unseen=None, per=1, seed=0)
    jobs = [(NOTHING, "other"), (YAW, "exact")]
    confidence.plan(Progress(), **options, fit=path, fitted_scenes=1, jobs=jobs)
    assert '"offset"' in path.read_text()


# What the figures count


def test_in_the_mixture_what_is_left_or_refused_stays_as_it_was():
    wrong = dict(trouble="yaw", ratio=2.0, flagged=True)
    left, moved = of(**wrong, left=True), of(**wrong)
    silent = of("yaw", ratio=2.0)
    refused = dict(trouble="yaw", start="other", group="camera", refused=True)
    mixture = confidence._mixture([of("nothing wrong"), left, moved, silent, refused])
    log = np.log(2.0)
    assert mixture["always"] == pytest.approx(-0.5 * log + 0.5 * 0.75 * log)
    assert mixture["left"] == pytest.approx(-0.5 * log + 0.5 * 0.5 * log)
    assert mixture["worse"] == pytest.approx(0.375)
    assert mixture["unflagged"] == pytest.approx(0.125)


def test_a_limit_withholds_the_gains_below_it_and_silences_what_is_worse_above_it():
    right = [of("nothing wrong", confidence=value) for value in (0.55, 0.95)]
    trouble = [of("yaw", ratio=2.0, confidence=0.75), of("yaw", confidence=0.65)]
    table = {limit: row for limit, *row in confidence._limits([*right, *trouble])}
    assert table[0.5][:4] == [0.0, 0.0, 0.5, 0.0]
    assert table[0.7][:4] == [0.5, 0.5, 0.5, 0.5]
    assert table[0.8][:4] == [0.5, 0.5, 0.0, 0.5]
    found = of("yaw", ratio=2.0, finding=True, flagged=True, left=True)
    table = {limit: row for limit, *row in confidence._limits([*right, found])}
    assert table[0.5][2] == 0.0


def test_figures_are_shares_of_the_results_and_the_auc_is_of_those_that_moved():
    kept = of("yaw", "exact", ratio=1.0, confidence=1.0, moved=False)
    silent = of("yaw", ratio=2.0, confidence=0.85)
    said = of("yaw", ratio=2.0, confidence=0.6, flagged=True)
    withheld = of("yaw", confidence=0.3, flagged=True, left=True)
    figures = confidence._figures([kept, silent, said, withheld, {"refused": True}])
    assert (figures["results"], figures["refused"], figures["moved"]) == (4, 1, 0.75)
    assert (figures["worse"], figures["silent"], figures["withheld"]) == (0.5, 0.25, 0.25)
    assert figures["flagged_of_worse"] == 0.5
    assert figures["auc"] == 0.0


def test_conclusions_are_by_kind_of_scene_and_by_trouble():
    cases = [of("nothing wrong"), of("yaw", ratio=2.0, confidence=0.2), of("yaw", "exact")]
    found = confidence.conclude(cases)
    kinds = ["all", "right scenes", "in trouble", "in trouble, other", "in trouble, exact"]
    assert list(found["summary"]) == [*kinds, "camera"]
    assert list(found["troubles"]) == ["nothing wrong, other", "yaw, other", "yaw, exact"]
    assert [claim["holds"] for claim in found["claims"]] == [True, True]
    assert sum(count for count, *_ in found["reliability"]) == 3


def test_equal_confidences_count_half():
    worse = np.array([True, False, False])
    assert confidence.auc(np.array([0.5, 0.5, 0.9]), worse) == 0.75
    assert confidence.auc(np.array([0.5, 0.5, 0.9]), ~worse | worse) is None
