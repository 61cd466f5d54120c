"""`tso lab confidence`: whether the mistake that was made is among those that are named."""

from types import SimpleNamespace

import pytest

from tso_cli.diagnosis.hypotheses import Suspect
from tso_cli.lab.stability.knees import AXIS
from tso_cli.lab.studies import confidence

CASE = SimpleNamespace(category="chair", shape="chair/a", kind="other")


def row_of(monkeypatch, axis, level=1.0, options=None, refusal=""):
    """The row of a result with suspects of these ``options``, or of a refusal."""
    result = None
    if options is not None:
        suspects = tuple(Suspect("", option, 0.5) for option in options)
        numbers = {
            "confidence": 0.5,
            "verdict": "doubtful",
            "iou_before": 0.5,
            "iou_after": 0.6,
            "best_step": 3,
        }
        result = SimpleNamespace(suspects=suspects, signs={"motion: mean": 0.0}, **numbers)
    run = SimpleNamespace(axis=AXIS[axis], level=level, case=CASE)
    outcome = SimpleNamespace(run=run, result=result, refusal=refusal, ratio=lambda: 1.2)
    monkeypatch.setattr(confidence, "outcomes_of", lambda runs, way: [outcome])
    ((row, _),) = confidence.rows_of([run])
    return row


@pytest.mark.parametrize(
    ("options", "named"),
    [
        (["--assume cloud-z-up"], True),
        (["--assume opengl", "--assume cloud-z-up@1.png"], True),
        (["--assume cloud-y-up"], False),
        (["without --assume mask-inverted"], False),
        ([], False),
    ],
)
def test_a_mistake_is_named_if_its_name_is_among_the_options(monkeypatch, options, named):
    assert row_of(monkeypatch, "cloud with z up", options=options)["named"] is named


def test_a_longer_name_is_another(monkeypatch):
    assert not row_of(monkeypatch, "axes of OpenGL", options=["--assume opengl-camera-to-world"])[
        "named"
    ]


def test_the_level_tells_which_unit_is_wrong(monkeypatch):
    found = [
        row_of(monkeypatch, "cloud in smaller units", level, ["--assume cloud-inches"])["named"]
        for level in (39.37, 1000.0)
    ]
    assert found == [True, False]


def test_a_refusal_names_it_too(monkeypatch):
    said = "no point falls inside; it looks as if the cloud's z points up: try --assume cloud-y-up, or --assume cloud-z-up"
    row = row_of(monkeypatch, "cloud with z up", refusal=said)
    assert row["refused"]
    assert row["suspected"]
    assert row["named"]
    row = row_of(monkeypatch, "cloud with z up", refusal="no point falls inside; check the camera")
    assert not row["suspected"]
    assert not row["named"]


def test_an_error_that_is_no_gross_mistake_has_no_name(monkeypatch):
    assert "named" not in row_of(monkeypatch, "mask dilated", 5.0, ["--assume cloud-z-up"])


def test_every_case_of_the_fit_has_the_levels_that_chance_would_bring_too_seldom():
    case = SimpleNamespace(shape="chair/a", kind="other", view=0)
    judged, fit = (
        list(confidence.alterations(case, case, 5, 0, to_fit)) for to_fit in (False, True)
    )
    drawn = [(run.axis.name, run.level) for run in fit]
    assert drawn[:6] == [(run.axis.name, run.level) for run in judged]
    assert drawn[6:] == [
        (name, level) for name, levels in confidence.LEARNED.items() for level in levels
    ]
    assert drawn[6:]
    assert all(level in AXIS[name].levels for name, level in drawn[6:])
