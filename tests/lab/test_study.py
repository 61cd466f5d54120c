"""What all studies share: their command, their page, and how one goes on from a record."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from tso_cli.errors import InputError
from tso_cli.lab.commands import page as pages
from tso_cli.lab.commands.study import command_of
from tso_cli.lab.studies import QUESTIONS, fingerprint
from tso_cli.lab.study import MESHES, Option, Progress, Study, Table, claim, page, record_of

from ..readme import RECORDS
from ..training import make_known
from .studying import tso

SETTINGS = {"size": 1}


def run(progress: Progress, *, meshes: Path, sizes: tuple[int, ...], deep: bool) -> dict:
    cases = progress.earlier_cases("pose", SETTINGS)
    groups = [lambda size=size: [{"size": size}] for size in sizes[len(cases) :]]

    def record(cases, complete):
        claims = [claim("sizes grow", True, "2 > 1"), claim("sizes shrink", False, "2 > 1")]
        return record_of("pose", {"size": "in cm"}, settings=SETTINGS, complete=complete, claims=claims, cases=cases)

    return progress.complete("measuring", cases, groups, record)


TOY = Study(
    "pose",
    "Sizes of toys.",
    (MESHES, Option("--size", kind=int, default=(1, 2), least=1, multiple=True, name="sizes"), Option("--deep", kind=bool)),
    run,
    lambda record: [Table(["size", "name"], [[case["size"] / 3, "car"] for case in record["cases"]], "Toys", "in cm")],
    lambda path, record, overwrite: path.write_bytes(b"chart"),
    reading="They are small.",
    kept="after every toy",
)


def record(cases, whole):
    return {"cases": list(cases), "complete": whole}


def test_the_record_is_kept_after_every_group_that_was_judged_and_is_complete_after_the_last():
    kept, reported = [], []
    progress = Progress(lambda *what: reported.append(what), keep=kept.append)
    result = progress.complete("doing", [1], [lambda: [2], None, lambda: [3]], record)
    assert kept == [{"cases": [1, 2], "complete": False}, {"cases": [1, 2, 3], "complete": True}]
    assert result == kept[-1]
    assert reported == [("doing", 1, 3), ("doing", 2, 3), ("doing", 3, 3)]
    assert progress.complete("doing", [1], [None], record) == {"cases": [1], "complete": True}


def test_an_interruption_leaves_the_record_so_far_and_the_earlier_cases_as_they_were():
    kept, earlier = [], [1]

    def interrupted():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Progress(keep=kept.append).complete("doing", earlier, [lambda: [2], interrupted], record)
    assert (kept, earlier) == ([{"cases": [1, 2], "complete": False}], [1])


@pytest.mark.parametrize(
    ("earlier", "message"),
    [
        ({"study": "tso", "settings": SETTINGS, "cases": []}, "of the study 'tso', expected one of tso lab pose"),
        ({"study": "pose", "settings": SETTINGS}, "of the study 'pose'"),
        ({"study": "pose", "settings": {"size": 2}, "cases": []}, "has size 2, now it is 1; expected the same"),
    ],
)
def test_a_record_of_another_study_or_of_other_settings_is_not_gone_on_from(earlier, message):
    with pytest.raises(InputError, match=message):
        Progress(earlier=earlier).earlier_cases("pose", SETTINGS)


@pytest.fixture
def toy(tmp_path, monkeypatch):
    """A function that runs the command of the toy study; and the path of its record."""
    make_known(monkeypatch)
    output = tmp_path / "toys.json"

    def call(*arguments):
        return CliRunner().invoke(command_of(TOY), ["--meshes", str(tmp_path), *map(str, arguments)])

    return call, output


def test_the_command_writes_record_chart_and_page_and_goes_on_from_the_record(toy):
    call, output = toy
    result = call("-o", output, "--deep", "--size", 1, "--size", 3, "--size", 1)
    assert "Toys\n size  name\n" in result.stdout
    assert "target missed: sizes shrink (2 > 1)" in result.stdout
    record = json.loads(output.read_text())
    assert [case["size"] for case in record["cases"]] == [1, 3]
    assert record["command"] == "tso lab pose --meshes DIR --size 1 --size 3 --size 1 --deep"
    assert record["fingerprint"] == fingerprint.fingerprint(record)
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
    assert "exists already" in str(call("-o", output).exception)
    resumed = call("-o", output, "--resume", "--json", "--size", 1, "--size", 3, "--size", 5)
    assert [case["size"] for case in json.loads(resumed.stdout)["cases"]] == [1, 3, 5]
    assert call("--size", 0).exit_code == 2


def test_outputs_that_cannot_be_are_refused_before_the_work(toy, tmp_path):
    call, output = toy
    assert "--resume goes on from a record" in str(call("--resume").exception)
    assert "expected .json" in str(call("-o", tmp_path / "toys.txt").exception)
    for content, message in (("precious", "is not JSON"), ("[1]", "no JSON object"), ('{"study": "points"}', "'points'")):
        output.write_text(content)
        assert message in str(call("-o", output, "--resume").exception)
        assert output.read_text() == content


def test_pages_are_written_anew_of_records_alone(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(pages, "load", lambda name: TOY)
    path = tmp_path / "toys.json"
    path.write_text(json.dumps(record_of("pose", "in cm", cases=[{"size": 3}])))
    assert tso("lab", "page", path) == 0
    assert capsys.readouterr().out == f"{path.with_suffix('.md')}\n"
    assert "| 1.000 | car |" in path.with_suffix(".md").read_text()
    assert "- Chamfer: in cm" in path.with_suffix(".md").read_text()
    path.write_text('{"study": "cooking"}')
    assert tso("lab", "page", path) == 2
    assert "of the study 'cooking', expected one of accuracy, " in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["accuracy", "accuracy-ablation", "evidence", "tso", "points", "examples", "network", "pose", "sigma"]
)
def test_kept_records_have_pages(name):
    record = json.loads((RECORDS / f"{name}.json").read_text())
    study = pages.load(record["study"])
    assert study.name == record["study"] in QUESTIONS
    assert len(study.reading.split()) <= 120
    assert all(len(row) == len(table.header) for table in study.tables(record) for row in table.rows)
    assert page(study, record, f"{name}.json").startswith(f"# {study.question}\n")


def test_a_study_that_trains_or_refines_asks_for_its_meshes(capsys):
    assert tso("lab", "pose") == 2
    assert "--meshes" in capsys.readouterr().err
