"""`tso lab confidence`: whether the mistake that was made is among the findings."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tso_cli import RefineConfig, refine
from tso_cli.diagnosis.assumptions import Assumption
from tso_cli.diagnosis.examine import Diagnosis, NoOverlapError
from tso_cli.diagnosis.findings import Finding
from tso_cli.diagnosis.hypotheses import HYPOTHESES
from tso_cli.errors import InputError
from tso_cli.lab.stability.knees import AXIS
from tso_cli.lab.stability.runs import Outcome, Run, findings_of
from tso_cli.lab.studies import confidence

from .studying import MESHES

CASE = SimpleNamespace(category="chair", shape="chair/a", kind="other", view=0)


def row_of(axis, level, *findings):
    """The row of a refusal with these findings."""
    run = Run(AXIS[axis], level, CASE, CASE, np.random.default_rng(0))
    row, _ = confidence.row_of(Outcome(run, findings=findings))
    assert row["refused"]
    return row


@pytest.mark.parametrize(
    ("axis", "level", "findings", "named"),
    [
        ("cloud with z up", 1.0, ["cloud-z-up"], True),
        ("cloud with z up", 1.0, ["opengl", "cloud-z-up"], True),
        ("cloud with z up", 1.0, ["cloud-y-up"], False),
        ("cloud with z up", 1.0, [], False),
        ("axes of OpenGL", 1.0, ["opengl-camera-to-world"], False),
        ("cloud in smaller units", 39.37, ["cloud-inches"], True),
        ("cloud in smaller units", 1000.0, ["cloud-inches"], False),
        ("mask dilated", 5.0, ["cloud-z-up"], None),
    ],
)
def test_a_gross_mistake_is_named_if_it_is_among_the_findings(axis, level, findings, named):
    row = row_of(axis, level, *findings)
    assert row.get("named") is named
    assert row["suspected"] == bool(findings)


OPENGL = Finding("opengl", (0,))
TAKEN_BACK = Finding("mask-inverted", (0,), without=Assumption(HYPOTHESES["mask-inverted"]))


@pytest.mark.parametrize(
    ("findings", "names"),
    [
        ((OPENGL, Finding("cloud-z-up", (0,))), ("opengl", "cloud-z-up")),
        # An assumption that is taken back names no mistake.
        ((TAKEN_BACK,), ("",)),
        ((Finding("mispaired", (0, 1), pairs=((0, 1), (1, 0))),), ("mispaired",)),
        ((Finding("coarse", (0,)),), ()),
        ((), ()),
    ],
)
def test_findings_of_a_result_and_of_a_refusal(findings, names, chair):
    result = refine(*chair[:3], RefineConfig(steps=0))
    assert findings_of(replace(result, findings=findings)) == names
    refusal = NoOverlapError("mask: no point falls inside")
    refusal.diagnosis = Diagnosis((), of_input=tuple(one for one in findings if one.suspicious))
    assert findings_of(refusal) == names
    assert findings_of(InputError("no object")) == ()


def test_the_fit_sees_each_case_as_it_is_with_one_two_and_four_masks():
    runs, to_fit = (list(confidence.alterations(CASE, CASE, 5, 0, fit)) for fit in (False, True))
    altered = [(run.axis.name, run.level) for run in runs[1:]]
    assert runs[0].axis == confidence.UNALTERED
    assert [(run.axis.name, run.level) for run in to_fit[:5]] == altered
    as_it_is = [(run.axis, run.level, run.masks) for run in to_fit[5:]]
    (level,) = confidence.UNALTERED.levels
    assert as_it_is == [(confidence.UNALTERED, level, masks) for masks in (1, 2, 4)]


def fitted_to(count, shared):
    """The model of ``count`` right scenes and as many wrong ones, with two features.

    Wrong scenes get worse where the points moved far; ``shared`` of right scenes do so anyhow.
    """
    rng, rows = np.random.default_rng(0), []
    for number in range(2 * count):
        right = number < count
        far = float(rng.normal() + (0.0 if right else 2.0))
        worse = rng.random() < (shared if right else 1.0 / (1.0 + np.exp(-2.0 * far)))
        axis = confidence.UNALTERED.name if right else "mask dilated"
        row = {"axis": axis, "moved": True, "ratio": 2.0 if worse else 0.5, "shape": f"{number}"}
        rows.append((row, {"motion: across": far, "evidence: views": float(rng.normal())}))
    return confidence.fitted(rows), rows


def test_the_fit_finds_which_feature_shows_a_worse_result():
    model, _ = fitted_to(2000, 0.02)
    (_, _, far), (_, _, views) = model["features"].values()
    assert far > 1.0
    assert abs(views) < 0.1 * far


def test_the_fit_is_calibrated_for_four_right_scenes_in_five():
    model, rows = fitted_to(2000, 0.02)
    logits = np.full(len(rows), model["offset"])
    for name, (mean, deviation, slope) in model["features"].items():
        logits += slope * (np.array([found[name] for _, found in rows]) - mean) / deviation
    expected = 1.0 / (1.0 + np.exp(-logits))
    worse = np.array([row["ratio"] > 1.05 for row, _ in rows])
    weights = np.repeat([0.8, 0.2], 2000)
    assert np.average(expected, weights=weights) == pytest.approx(
        np.average(worse, weights=weights), abs=0.01
    )


def test_in_the_mixture_what_is_left_or_refused_stays_as_it_was():
    right = {"axis": confidence.UNALTERED.name, "ratio": 0.5, "flagged": False, "left": False}
    wrong = {"axis": "mask dilated", "ratio": 2.0}
    left, moved, silent = (
        wrong | {"flagged": flagged, "left": left}
        for flagged, left in ((True, True), (True, False), (False, False))
    )
    refused = {"axis": "mask dilated", "refused": True}
    cases = [right, left, moved, silent, refused]
    mixture = confidence._mixture(cases)
    log = np.log(2.0)
    assert mixture["always"] == pytest.approx(-0.8 * log + 0.2 * 0.75 * log)
    assert mixture["left"] == pytest.approx(-0.8 * log + 0.1 * log)
    assert mixture["worse"] == pytest.approx(0.15)
    assert mixture["unflagged"] == pytest.approx(0.05)
    assert confidence._mixture([right]) == confidence._mixture([refused]) == {}


class FakeBuilder:
    """Cases that are names alone."""

    def __init__(self, *settings):
        pass

    def cases(self, shape, kind):
        names = {"category": shape.category, "shape": shape.name, "kind": kind}
        return [SimpleNamespace(**names, view=view) for view in range(2)]


def test_the_other_object_of_a_job_does_not_depend_on_the_jobs_before(split, monkeypatch):
    monkeypatch.setattr(confidence, "CaseBuilder", FakeBuilder)
    monkeypatch.setattr(confidence, "rows_of", list)
    categories = ["airplane", "car", "chair"]
    settings = {"categories": categories, "limit": None, "views": 2, "alterations": 1, "seed": 0}

    def others(job):
        return [(run.case.shape, run.other.shape, run.other.kind, run.other.view) for run in job()]

    def jobs():
        return confidence._jobs(MESHES, split, "test", settings)

    in_order = {name: others(job) for name, job in jobs().items()}
    before = [*in_order][-1]
    for name, found in in_order.items():
        assert {*found} == {(name, before, "other", 0)}
        assert others(jobs()[name]) == found
        before = name
