"""What all studies share: their command, their page, and how one goes on from a record."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from tso_cli.errors import InputError
from tso_cli.lab.commands import tools as pages
from tso_cli.lab.studies import QUESTIONS, accuracy, evidence, fingerprint, pose, refining
from tso_cli.lab.study import MESHES, Option, Plan, Progress, Study, Table, claim, page
from tso_cli.refinement import RefineConfig

from ..readme import RECORDS
from ..training import make_known
from . import studying
from .studying import thin_checkpoint, timeless

SETTINGS = {"length": 1}


def plan(progress: Progress, *, meshes: Path, sizes: tuple[int, ...], deep: bool) -> Plan:
    return Plan(
        SETTINGS,
        [({"size": size}, lambda size=size: [{"size": size}]) for size in sizes],
        "measuring",
    )


TOY = Study(
    name="pose",
    about="Sizes of toys.",
    parts=("camera fit",),
    tables=lambda record: [
        Table(
            ["size", "name"],
            [[case["size"] / 3, "car"] for case in record["cases"]],
            "Toys",
            "in cm",
        )
    ],
    draw=lambda path, record, overwrite: path.write_bytes(b"chart"),
    reading="They are small.",
    convention={"size": "in cm"},
    options=(
        MESHES,
        Option("--size", kind=int, default=(1, 2), least=1, multiple=True, name="sizes"),
        Option("--deep", kind=bool),
    ),
    plan=plan,
    conclude=lambda cases: {
        "claims": [claim("sizes grow", True, "2 > 1"), claim("sizes shrink", False, "2 > 1")]
    },
)


def run_toys(
    progress: Progress, study: Study = TOY, sizes: tuple[int, ...] = (1, 2)
) -> dict[str, Any]:
    return study.run(progress, meshes=Path(), sizes=sizes, deep=False)


def sizes_of(record: dict[str, Any]) -> tuple[list[int], bool, bool]:
    return [case["size"] for case in record["cases"]], record["complete"], "claims" in record


def test_the_record_is_kept_after_every_job_and_concluded_after_the_last():
    kept, reported = [], []
    result = run_toys(Progress(lambda *what: reported.append(what), keep=kept.append))
    assert list(map(sizes_of, kept)) == [
        ([], False, False),
        ([1], False, False),
        ([1, 2], True, True),
    ]
    assert result == kept[-1]
    assert reported == [("measuring", 1, 2), ("measuring", 2, 2)]
    kept.clear()
    assert timeless(run_toys(Progress(earlier=result, keep=kept.append))) == timeless(result)
    assert list(map(sizes_of, kept)) == [([1, 2], True, True)]


def test_an_interruption_leaves_the_record_so_far():
    def interrupted():
        raise KeyboardInterrupt

    kept: list[dict[str, Any]] = []
    jobs = [({"size": 1}, lambda: [{"size": 1}]), ({"size": 2}, interrupted)]
    with pytest.raises(KeyboardInterrupt):
        run_toys(
            Progress(keep=kept.append),
            replace(TOY, plan=lambda progress, **_: Plan(SETTINGS, jobs)),
        )
    assert sizes_of(kept[-1]) == ([1], False, False)
    assert sizes_of(run_toys(Progress(earlier=kept[-1]))) == ([1, 2], True, True)


@pytest.mark.parametrize(
    ("earlier", "message"),
    [
        (
            {"study": "tso", "settings": SETTINGS, "cases": []},
            "of the study 'tso', expected one of tso lab pose",
        ),
        ({"study": "pose", "settings": SETTINGS}, "of the study 'pose'"),
        (
            {"study": "pose", "settings": {"length": 2}, "cases": []},
            "has length 2, now it is 1; expected the same",
        ),
    ],
)
def test_a_record_of_another_study_or_of_other_settings_is_not_resumed(earlier, message):
    with pytest.raises(InputError, match=message):
        run_toys(Progress(earlier=earlier))


@pytest.fixture
def toy(tso, tmp_path, monkeypatch):
    """A function that runs the command of the toy study; and the path of its record."""
    make_known(monkeypatch)
    monkeypatch.setattr(pages, "load", lambda name: TOY)
    return partial(tso, "lab", "pose", "--meshes", tmp_path), tmp_path / "toys.json"


def test_the_command_writes_record_chart_and_page_and_goes_on_from_the_record(toy):
    call, output = toy
    result = call("-o", output, "--deep", "--size", 1, "--size", 3, "--size", 1)
    assert "Toys\n size  name\n" in result.out
    assert "target missed: sizes shrink (2 > 1)" in result.out
    record = json.loads(output.read_text())
    assert [case["size"] for case in record["cases"]] == [1, 3]
    assert record["command"] == "tso lab pose --meshes DIR --size 1 --size 3 --size 1 --deep"
    assert record["fingerprint"] == {"camera fit": fingerprint.today("camera fit")}
    assert output.with_suffix(".png").read_bytes() == b"chart"
    text = output.with_suffix(".md").read_text()
    assert text == page(TOY, record, "toys.json")
    for part in (
        "# How well is a camera found",
        f"    {record['command']} -o toys.json\n",
        "![",
        "](toys.png)",
        "They are small.",
        "### Toys",
        "| size | name |\n| --- | --- |\n| 0.333 | car |",
        "- holds: sizes grow (2 > 1)\n- target missed: sizes shrink (2 > 1)",
        "- size: in cm",
    ):
        assert part in text
    assert "exists already" in call("-o", output).refusal
    resumed = call("-o", output, "--resume", "--json", "--size", 1, "--size", 3, "--size", 5)
    assert [case["size"] for case in resumed.document["cases"]] == [1, 3, 5]
    assert "--size" in call("--size", 0).refusal


def test_outputs_that_cannot_be_are_refused_before_the_work(toy, tmp_path):
    call, output = toy
    assert "--resume goes on from a record" in call("--resume").refusal
    assert "expected .json" in call("-o", tmp_path / "toys.txt").refusal
    for content, message in (
        ("precious", "is not JSON"),
        ("[1]", "no JSON object"),
        ('{"study": "sigma"}', "'sigma'"),
    ):
        output.write_text(content)
        assert message in call("-o", output, "--resume").refusal
        assert output.read_text() == content


def test_pages_are_written_anew_of_complete_records(tso, tmp_path, monkeypatch):
    monkeypatch.setattr(pages, "load", lambda name: TOY)
    path = tmp_path / "toys.json"
    path.write_text(
        json.dumps({"study": "pose", "convention": {"size": "in cm"}, "cases": [{"size": 3}]})
    )
    assert tso("lab", "page", path).out == f"{path.with_suffix('.md')}\n"
    assert "| 1.000 | car |" in path.with_suffix(".md").read_text()
    for content, message in (
        ('{"study": "cooking"}', "of the study 'cooking', expected one of accuracy, "),
        ('{"study": "pose", "complete": false}', "is not complete, expected a finished record"),
    ):
        path.write_text(content)
        assert message in tso("lab", "page", path).refusal


def test_a_study_asks_for_its_meshes(tso):
    assert "--meshes" in tso("lab", "pose").refusal
    assert "No such command 'posing'" in tso("lab", "posing").refusal


@pytest.mark.parametrize("path", sorted(RECORDS.glob("*.json")), ids=lambda path: path.stem)
def test_the_cases_of_a_kept_record_give_its_conclusions_and_its_page(path):
    record = json.loads(path.read_text())
    name = record["study"]
    if name == "photos":
        pytest.skip("its page is docs/photos.md")
    shown = pages.load(name)
    assert list(record["fingerprint"]) == list(shown.parts)
    assert set(shown.parts) <= set(fingerprint.PARTS)
    assert len(shown.reading.split()) <= 120
    assert all(
        len(row) == len(table.header) for table in shown.tables(record) for row in table.rows
    )
    charts = sorted(chart.name for chart in RECORDS.glob(f"{path.stem}.*.png"))
    assert path.with_suffix(".md").read_text() == page(shown, record, path.name, charts)
    assert (shown.name, record["complete"]) == (name, True)
    conclusions = json.loads(json.dumps(shown.conclude(record["cases"])))
    assert conclusions == {key: record[key] for key in conclusions}


QUICK = {
    name: replace(variant, config=replace(variant.config, steps=3))
    for name, variant in refining.POINTS.items()
}
CARS, PLANES, CHAIRS = (("--category", name) for name in ("car", "airplane", "chair"))
TINY = ("--steps", 1, "--batch-size", 2)
# Study -> its arguments, the number of cases of its first job, and words of its page.
COMMANDS: dict[str, tuple[tuple[Any, ...], int, tuple[str, ...]]] = {
    "accuracy": (
        (*CARS, "--kind", "other", "--kind", "right", "--views", 1),
        1,
        ("made worse", "floor"),
    ),
    "evidence": (("--views", 1), 1, ("whole", "Parts missing")),
    "tso": (
        (*CARS, *CHAIRS, "--views", 1, "--steps", 1),
        1,
        ("4.64", "-5.82", "E and D", "occluded", "chair", "hold"),
    ),
    "pose": (("--views", 1), 3, (pose.TRUE,)),
    "network": ((*CARS, *CHAIRS), 3, ("validation", "Chamfer x1000")),
    "sigma": (("--views", 1), 1, ("best sigma^2", "the paper's")),
    "supervision": ((*TINY, *CARS, *CHAIRS), 1, ("1 steps of 2", "canonical frame")),
    "views": ((*TINY, *CARS), 1, ("1 steps of 2", "seed 0")),
    "lambda": ((*TINY, *CHAIRS), 1, ("1 steps of 2", "seed 0")),
    "affinity": ((*TINY, *CARS), 1, ("1 steps of 2", "seed 0")),
    "failures": ((*TINY, *PLANES, *CARS), 1, ("1 steps of 2", "seed 0")),
    "confidence": (
        (*CARS, *CHAIRS, "--views", 1, "--alterations", 2),
        9,
        ("Reliability", "right scenes"),
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", QUESTIONS)
def test_each_command_writes_record_chart_and_page_and_resumes_to_the_same_cases(
    tso, name, split, small, tmp_path, monkeypatch
):
    arguments, first, words = COMMANDS[name]
    if name in ("tso", "network"):
        checkpoint = thin_checkpoint(tmp_path, monkeypatch, 1024 if name == "network" else 64)
        arguments = (*arguments, "--checkpoint", checkpoint)
    monkeypatch.setattr(accuracy, "variants_of", lambda kind, ablation: QUICK)
    monkeypatch.setattr(pose, "CATEGORIES", ("car",))
    monkeypatch.setattr(pose, "kinds_of", lambda category, kinds: ["other"])
    row = refining.Variant(RefineConfig(steps=3), 4)
    rows = {
        "whole": (evidence.unaltered, row),
        "part": (partial(evidence.without, part="side"), row),
    }
    monkeypatch.setattr(
        evidence,
        "QUESTIONS",
        {"missing": evidence.Question("Parts missing", ("other",), rows, ("chair", "car"))},
    )
    output = tmp_path / "record.json"
    arguments = (
        "lab",
        name,
        "--meshes",
        studying.MESHES,
        "--split",
        split,
        *arguments,
        "-o",
        output,
    )
    printed, text = tso(*arguments).out, output.with_suffix(".md").read_text()
    for word in words:
        assert word in printed
        assert word in text
    assert output.with_suffix(".png").stat().st_size > 3000
    whole = json.loads(output.read_text())
    assert whole["complete"]
    assert whole["command"].startswith(f"tso lab {name} --meshes DIR")
    assert len(output.read_text().splitlines()) > len(whole["cases"])
    output.write_text(json.dumps({**whole, "complete": False, "cases": whole["cases"][:first]}))
    assert tso(*arguments, "--resume", "--json").code == 0
    resumed = json.loads(output.read_text())
    assert resumed["cases"][:first] == whole["cases"][:first]
    assert timeless(resumed) == timeless(whole)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["views", "--resume", "-o", "other.json"], "expected one of tso lab views"),
        (["views", "--split", "absent.json"], "car/nothing"),
        (["failures", "--category", "chair"], "found chair, expected one of the two"),
        (
            ["accuracy", "--category", "car", "--points", 100],
            "points is 100, expected 1024 to 16384",
        ),
        (
            ["accuracy", "--kind", "near", "--category", "chair"],
            "kinds are near, expected some that chair have",
        ),
    ],
)
def test_unusable_input_is_one_line(tso, arguments, message, split, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("other.json").write_text(json.dumps({"study": "points", "settings": {}, "cases": []}))
    Path("absent.json").write_text(
        json.dumps({"train": ["car/nothing"], "test": ["car/qreal_SUV"]})
    )
    run = tso("lab", arguments[0], "--meshes", studying.MESHES, "--split", split, *arguments[1:])
    errors = [line for line in run.err.splitlines() if not line.startswith("tso: checkpoint")]
    assert run.code == 2
    assert len(errors) == 1
    assert message in errors[0]
    assert len(list(tmp_path.iterdir())) == 2
