"""Fingerprints of records: they change with the method, and with nothing else."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import pytest

from tso_cli.errors import InputError
from tso_cli.evaluation import footprint
from tso_cli.kernels import nearest, splat
from tso_cli.optimisation import learned_start, presets
from tso_cli.pose import search
from tso_cli.render import rays
from tso_cli.silhouette import affinity
from tso_cli.train import losses
from tso_cli.train.prior import loss as prior_loss
from tso_lab.commands.records import earlier_record, write_record
from tso_lab.studies import fingerprint
from tso_lab.studies.fingerprint import PARTS, differences, today


def of_today(*parts: str) -> dict:
    return json.loads(json.dumps({"fingerprint": {part: today(part) for part in parts}}))


@pytest.fixture
def fixed(monkeypatch):
    """A function that says what a part is today, in place of measuring it."""
    return lambda **numbers: monkeypatch.setattr(fingerprint, "today", lambda part: numbers)


def faster_latent(preset, patch):
    """Another learning rate of the latent vector."""
    defaults = presets.DEFAULTS[preset, "latent"]
    patch.setitem(presets.DEFAULTS, (preset, "latent"), replace(defaults, learning_rate=2e-3))


CHANGES = {
    "points, best": lambda patch: patch.setattr(learned_start, "PASSES", 1),
    "points, paper": lambda patch: patch.setattr(footprint, "EVEN", 1.5 * footprint.EVEN),
    "network modes, paper": partial(faster_latent, "paper"),
    "network modes, best": partial(faster_latent, "best"),
    "camera fit": lambda patch: patch.setattr(search, "SIDE", 20),
    "training": lambda patch: patch.setattr(
        losses, "affinity", lambda *of: 1.1 * affinity.affinity(*of)
    ),
    "pictures": lambda patch: patch.setattr(rays, "AMBIENT", 1.1 * rays.AMBIENT),
    "training of a prior": lambda patch: patch.setattr(prior_loss, "OF_CELLS", 2.0),
}


@pytest.mark.slow
@pytest.mark.parametrize("part", PARTS)
def test_another_method_has_another_fingerprint(part, monkeypatch):
    record = of_today(part)
    assert differences(record) == []
    CHANGES[part](monkeypatch)
    today.cache_clear()
    lines = differences(record)
    today.cache_clear()
    assert lines
    assert all(line.startswith(f"{part}: ") and ", now " in line for line in lines)


@pytest.mark.slow
@pytest.mark.parametrize("part", ["network modes, paper", "training"])
def test_the_same_method_has_the_same_fingerprint_by_all_points_and_pixels(part, monkeypatch):
    """As on a GPU without Triton."""
    record = of_today(part)
    exact = SimpleNamespace(apply=lambda *arguments: splat._exact(*arguments[:-1]))
    monkeypatch.setattr(splat, "_Windowed", exact)
    monkeypatch.setattr(nearest, "_by_trees", nearest._by_all_pairs)
    today.cache_clear()
    assert differences(record) == []
    today.cache_clear()


# The other parts keep nothing after Ctrl-C.
KEEPING = [part for part in PARTS if part not in ("pictures", "training of a prior")]


@pytest.mark.parametrize("part", KEEPING)
def test_a_part_that_ctrl_c_ends_has_no_fingerprint(part, monkeypatch):
    kept = SimpleNamespace(stop_reason="interrupted")
    monkeypatch.setattr(fingerprint, "refine", lambda *_, **__: SimpleNamespace(fit=kept))
    monkeypatch.setattr(fingerprint, "train", lambda *_: kept)
    today.cache_clear()
    with pytest.raises(KeyboardInterrupt):
        today(part)
    assert today.cache_info().currsize == 0


@pytest.mark.parametrize(
    ("part", "key", "tolerance"),
    [
        ("points, paper", "chair: Chamfer", 0.005),
        ("points, best", "chair: Chamfer", 0.02),
        ("points, best", "chair: IoU", 0.01),
    ],
)
def test_numbers_are_the_same_up_to_rounding(part, key, tolerance, fixed):
    fixed(**{key: 2.0})
    for share in (-1.1, -0.9, 0.9, 1.1):
        record = {"fingerprint": {part: {key: 2.0 * (1.0 + share * tolerance)}}}
        assert (differences(record) == []) == (abs(share) < 1.0)


def test_a_fingerprint_with_fewer_or_more_numbers_than_todays_differs(fixed):
    numbers = {"Chamfer": 2.0, "gamma": 0.0}
    fixed(**numbers)
    assert differences({"fingerprint": {"training": numbers}}) == []
    for others in ({"Chamfer": 2.0}, {**numbers, "gamma": 0.1}, {**numbers, "moved": 1.0}):
        assert len(differences({"fingerprint": {"training": others}})) == 1
    assert differences({"fingerprint": {"an older part": numbers}})
    assert differences({}) == differences({"fingerprint": {}}) == ["it has no fingerprint"]


def test_a_record_of_another_method_is_not_resumed(tmp_path, fixed):
    path = tmp_path / "record.json"
    record = {"study": "pose", "cases": [{"shape": "a"}, {"shape": "b"}]}
    fixed(number=1.0)
    kept = {**record, "fingerprint": {"camera fit": {"number": 1.0}}}
    write_record(kept, path)
    assert path.read_text().splitlines()[-3:] == ['{"shape":"a"},', '{"shape":"b"}', "]}"]
    assert earlier_record("pose", path, True) == kept
    fixed(number=2.0)
    with pytest.raises(
        InputError, match="record.json: was made by another method .camera fit: number 1.0, now 2.0"
    ):
        earlier_record("pose", path, True)
    # A record of another study is for the study to refuse.
    assert earlier_record("sigma", path, True)["study"] == "pose"


def test_the_command_tells_records_of_the_method_from_others(tso, tmp_path, fixed):
    path = tmp_path / "pose.json"
    path.write_text('{"study": "pose"}')
    run = tso("lab", "fingerprint", path)
    assert run.code == 3
    assert "of another method\n  it has no fingerprint" in run.out
    fixed(number=1.0)
    numbers = {"camera fit": {"number": 1.0}}
    write_record({"study": "pose", "cases": [], "fingerprint": numbers}, path)
    run = tso("lab", "fingerprint", path)
    assert run.code == 0
    assert "pose.json: of the method as it is" in run.out
    fixed(number=7.0)
    run = tso("lab", "fingerprint", path)
    assert run.code == 3
    assert "  camera fit: number 1.0, now 7.0\n" in run.out
    assert "1 of 1 records" in run.err


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "is not JSON"),
        ("[1]", "holds no JSON object"),
        ('{"cases": [{"category": Infinity}]}', "holds the number Infinity"),
        ('{"cases": [{"category": "\\ud800"}]}', "holds half a letter"),
    ],
)
def test_what_is_no_record_gets_one_line(tso, text, message, tmp_path):
    path = tmp_path / "record.json"
    path.write_text(text)
    refusal = tso("lab", "fingerprint", path).refusal
    assert str(path) in refusal
    assert message in refusal
