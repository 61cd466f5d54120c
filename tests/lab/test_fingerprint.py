"""Fingerprints of records: they change with the method, and with nothing else."""

from __future__ import annotations

import json

import pytest

from tso_cli.errors import InputError
from tso_cli.evaluation import footprint
from tso_cli.kernels import nearest, splat
from tso_cli.lab.commands.records import earlier_record, write_record
from tso_cli.lab.studies import QUESTIONS as STUDIES
from tso_cli.lab.studies import evidence_questions
from tso_cli.lab.studies import fingerprint as prints
from tso_cli.lab.studies.fingerprint import BEST, JUDGED, PAPER, PARTS, differences, fingerprint, stamped
from tso_cli.refinement import camera_correction, presets, problem, resampled_view
from tso_cli.silhouette import affinity, bce, chamfer, mask_chamfer, projection
from tso_cli.train import losses

from ..readme import RECORDS
from ..training import make_known
from .studying import tso

RECORD = {"study": "evidence", "settings": {"questions": ["missing", "cameras"]}, "cases": [{"shape": "a"}, {"shape": "b"}]}


@pytest.fixture
def judged(monkeypatch):
    """A function that has the study of points judge one part alone, of which nothing is known unless it is said."""

    def judge(part: str, numbers: dict | None = None) -> None:
        monkeypatch.setitem(JUDGED, "points", lambda record: [part])
        monkeypatch.setattr(prints, "_known", {part: numbers} if numbers else {})

    return judge


def _whole_photo(view, points):
    return -0.5, -0.5, view.camera.width - 0.5, view.camera.height - 0.5


def _with_defaults(patch, **changes):
    for name, value in changes.items():
        patch.setitem(vars(presets.BEST), name, value)


CHANGES = {
    "points, best": lambda patch: _with_defaults(patch, prior_weight=0.8 * presets.BEST.prior_weight),
    "points, paper": lambda patch: patch.setattr(footprint, "EVEN", 1.5 * footprint.EVEN),
    "points, best, in a larger photo": lambda patch: patch.setattr(problem, "window_of", _whole_photo),
    "points, best, mask of 64 px": lambda patch: patch.setattr(resampled_view, "FINE_GRIDS", ((96.0, 128),)),
    "points, best, four masks": lambda patch: _with_defaults(patch, weigh_views=False, prior_weight=200.0),
    "points, best, camera refined": lambda patch: patch.setattr(camera_correction, "MISFIT_LEFT", 0.0),
    "latent, paper": lambda patch: patch.setitem(presets.PAPER_GAMMA, "latent", 1.1e6),
    "training on masks": lambda patch: patch.setattr(losses, "affinity", lambda *of: 1.1 * affinity.affinity(*of)),
}


@pytest.mark.slow
@pytest.mark.parametrize("part", CHANGES)
def test_another_method_has_another_fingerprint(part, judged, monkeypatch):
    judged(part)
    record = json.loads(json.dumps(stamped({"study": "points"})))
    assert differences(record) == []
    prints._known.clear()
    CHANGES[part](monkeypatch)
    found = differences(record)
    assert found
    assert all(line.startswith(f"{part}: ") and ", now " in line for line in found)


@pytest.mark.slow
@pytest.mark.parametrize("part", ["points, paper", "points, best, cut by the border", "training on masks"])
@pytest.mark.parametrize("compiled", [False, True])
def test_the_same_method_has_the_same_fingerprint_in_plain_and_in_compiled_loops(part, compiled, judged, monkeypatch):
    judged(part)
    record = stamped({"study": "points"})
    prints._known.clear()
    for module in (splat, nearest, projection, affinity, bce, chamfer, mask_chamfer):
        monkeypatch.setattr(module, "use_numba", lambda points: compiled)
    assert differences(record) == []


@pytest.mark.parametrize(("part", "what", "tolerance"), [(PAPER, "chair: Chamfer", 0.005), (PAPER, "chair: moved", 0.005),
                         (BEST, "chair: Chamfer", 0.02), (BEST, "chair: moved", 0.04), (BEST, "steps", 0.005)])  # fmt: skip
def test_numbers_are_the_same_up_to_rounding(part, what, tolerance, judged):
    judged(part, {what: 2.0})
    for share in (-1.1, -0.9, 0.9, 1.1):
        record = {"study": "points", "fingerprint": {part: {what: 2.0 * (1.0 + share * tolerance)}}}
        assert (differences(record) == []) == (abs(share) < 1.0)


def test_a_fingerprint_with_fewer_or_more_numbers_than_todays_differs(judged):
    judged(PAPER, {"Chamfer": 2.0, "gamma": 0.0})
    assert differences({"study": "points", "fingerprint": {PAPER: {"Chamfer": 2.0, "gamma": 0.0}, "more": {}}}) == []
    for other in ({}, {"Chamfer": 2.0}, {"Chamfer": 2.0, "gamma": 0.1}, {"Chamfer": "2", "gamma": 0.0},
                  {"Chamfer": 2.0, "gamma": 0.0, "moved": 1.0}, [2.0], None):  # fmt: skip
        assert differences({"study": "points", "fingerprint": {PAPER: other}})


def test_every_study_and_the_measurement_of_speed_say_what_they_judge(monkeypatch):
    make_known(monkeypatch)
    assert set(prints.QUESTIONS) >= set(evidence_questions.QUESTIONS)
    assert set(JUDGED) == set(STUDIES) | {"speed", "photos"}
    judged = set()
    for path in RECORDS.glob("*.json"):
        record = {"study": "photos"} | json.loads(path.read_text())
        judged |= set(fingerprint(record))
        assert fingerprint(record)
    assert judged == set(PARTS)


@pytest.mark.parametrize("name", ["accuracy", "pose", "supervision"])
def test_a_record_of_another_method_is_not_gone_on_from(name, tmp_path, monkeypatch):
    make_known(monkeypatch)
    path = tmp_path / "record.json"
    record = json.loads((RECORDS / f"{name}.json").read_text())
    write_record(record, path)
    assert earlier_record(name, path, True)["fingerprint"] == fingerprint(record)
    part = next(iter(fingerprint(record)))
    monkeypatch.setitem(prints._known, part, {"number": 1e3})
    with pytest.raises(InputError, match=f"record.json: was made by another method .{part}: number .*, now 1000"):
        earlier_record(name, path, True)
    path.write_text(json.dumps({key: value for key, value in record.items() if key != "fingerprint"}))
    with pytest.raises(InputError, match="was made by another method .it has no fingerprint"):
        earlier_record(name, path, True)
    # a record of another study is for the study to refuse
    assert earlier_record("points", path, True)["study"] == name


def test_the_command_tells_records_of_the_method_from_others(tmp_path, monkeypatch, capsys):
    make_known(monkeypatch)
    path = tmp_path / "evidence.json"
    path.write_text(json.dumps(RECORD, indent=1))
    for options in ((), ("--complete",)):
        assert tso("lab", "fingerprint", path, *options) == 3
        assert "of another method\n  it has no fingerprint" in capsys.readouterr().out
        assert json.loads(path.read_text()) == RECORD
    write_record(RECORD, path)
    assert json.loads(path.read_text()) == {**RECORD, "fingerprint": fingerprint(RECORD)}
    assert tso("lab", "fingerprint", path) == 0
    assert "evidence.json: of the method as it is" in capsys.readouterr().out
    monkeypatch.setitem(prints._known, "points, best", {"number": 7.0})
    assert tso("lab", "fingerprint", path) == 3
    printed = capsys.readouterr()
    assert "  points, best: number 0.0, now 7.0\n" in printed.out
    assert "1 of 1 records" in printed.err


def test_a_fingerprint_is_completed_only_where_the_rest_of_it_is_todays(tmp_path, monkeypatch, capsys):
    make_known(monkeypatch)
    path = tmp_path / "evidence.json"
    for kept, code in (({"points, best": {"number": 0.0}}, 0), ({"points, best": {"number": 1.0}}, 3)):
        path.write_text(json.dumps({**RECORD, "fingerprint": kept}))
        assert tso("lab", "fingerprint", path) == 3
        assert tso("lab", "fingerprint", path, "--complete") == code
        assert json.loads(path.read_text())["fingerprint"] == (kept if code else fingerprint(RECORD))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is not JSON"),
        ("[1]", "holds no JSON object"),
        ("{}", "is of the study None, expected one of points, "),
        ('{"study": "cooking"}', "is of the study 'cooking', expected one of points, "),
        ('{"study": "evidence"}', "lacks 'settings'"),
        ('{"study": "evidence", "settings": {"questions": ["why"]}}', "lacks 'why'"),
    ],
)
def test_what_is_no_record_gets_one_line(text, message, tmp_path, capsys):
    path = tmp_path / "record.json"
    path.write_text(text)
    for options in ([], ["--complete"]):
        assert tso("lab", "fingerprint", path, *options) == 2
        error = capsys.readouterr().err
        assert error.count("\n") == 1
        assert str(path) in error
        assert message in error
    assert path.read_text() == text
