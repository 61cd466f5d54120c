"""What all studies share: their command, their page, and how one goes on from a record."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest
from PIL import Image

from tso_cli.errors import InputError
from tso_cli.refinement import RefineConfig
from tso_lab import options
from tso_lab.bench.pareto import DEFAULT, PAPER, WAYS
from tso_lab.bench.peers import PEERS
from tso_lab.commands import tools
from tso_lab.harm.troubles import TROUBLE
from tso_lab.options import option
from tso_lab.studies import WORDS, cases, evidence, fingerprint, pose
from tso_lab.study import Plan, Progress, Study, Table, claim, page

from ..readme import RECORDS
from ..training import make_known
from .studying import MESHES, SMALL, thin_checkpoint, timeless

SETTINGS = {"length": 1}


def plan(progress: Progress, *, meshes: Path, sizes: tuple[int, ...], deep: bool) -> Plan:
    jobs = [({"size": size}, lambda size=size: [{"size": size}]) for size in sizes]
    return Plan(SETTINGS, jobs, "measuring")


def tables(record: dict[str, Any]) -> list[Table]:
    rows = [[case["size"] / 3, "car"] for case in record["cases"]]
    return [Table(["size", "name"], rows, "Toys", "in cm")]


CLAIMS = [claim("sizes grow", True, "2 > 1"), claim("sizes shrink", False, "2 > 1")]
TOY = Study(
    name="pose",
    parts=("camera fit",),
    tables=tables,
    draw=lambda path, record, overwrite: path.write_bytes(b"chart"),
    options=(
        options.MESHES,
        option("--size", kind=int, default=(1, 2), least=1, multiple=True, name="sizes"),
        option("--deep", kind=bool),
    ),
    plan=plan,
    conclude=lambda cases: {"claims": CLAIMS},
)


def run_toys(progress: Progress, study: Study = TOY) -> dict[str, Any]:
    return study.run(progress, meshes=Path(), sizes=(1, 2), deep=False)


def sizes_of(record: dict[str, Any]) -> tuple[list[int], bool, bool]:
    return [case["size"] for case in record["cases"]], record["complete"], "claims" in record


def test_the_record_is_kept_after_every_job_and_concluded_after_the_last():
    kept, reported = [], []
    result = run_toys(Progress(lambda *what: reported.append(what), keep=kept.append))
    whole = ([1, 2], True, True)
    assert list(map(sizes_of, kept)) == [([], False, False), ([1], False, False), whole]
    assert result == kept[-1]
    assert reported == [("measuring", 1, 2), ("measuring", 2, 2)]
    kept.clear()
    assert timeless(run_toys(Progress(earlier=result, keep=kept.append))) == timeless(result)
    assert list(map(sizes_of, kept)) == [whole]


def test_an_interruption_leaves_the_record_so_far():
    def interrupted():
        raise KeyboardInterrupt

    kept: list[dict[str, Any]] = []
    jobs = [({"size": 1}, lambda: [{"size": 1}]), ({"size": 2}, interrupted)]
    study = replace(TOY, plan=lambda progress, **_: Plan(SETTINGS, jobs))
    with pytest.raises(KeyboardInterrupt):
        run_toys(Progress(keep=kept.append), study)
    assert sizes_of(kept[-1]) == ([1], False, False)
    assert sizes_of(run_toys(Progress(earlier=kept[-1]))) == ([1, 2], True, True)


@pytest.mark.parametrize(
    ("study", "settings", "message"),
    [
        ("tso", SETTINGS, "of the study 'tso', expected one of tso lab pose"),
        ("pose", None, "of the study 'pose'"),
        ("pose", {"length": 2}, "has length 2, now it is 1; expected the same"),
    ],
)
def test_a_record_of_another_study_or_of_other_settings_is_not_resumed(study, settings, message):
    with pytest.raises(InputError, match=message):
        run_toys(Progress(earlier={"study": study, "settings": settings, "cases": []}))


@pytest.fixture
def toy(tso, tmp_path, monkeypatch):
    """A function that runs the command of the toy study; and the path of its record."""
    make_known(monkeypatch)
    monkeypatch.setattr(tools, "load", lambda name: TOY)
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
        "](toys.png)",
        "### Toys",
        "| size | name |\n| --- | --- |\n| 0.333 | car |",
        "- holds: sizes grow (2 > 1)\n- target missed: sizes shrink (2 > 1)",
        "- degrees: angle between",
    ):
        assert part in text
    assert "exists already" in call("-o", output).refusal
    resumed = call("-o", output, "--resume", "--json", "--size", 1, "--size", 3, "--size", 5)
    assert [case["size"] for case in resumed.document["cases"]] == [1, 3, 5]
    assert "--size" in call("--size", 0).refusal


def test_outputs_that_cannot_be_are_refused_before_the_work(toy, tmp_path, monkeypatch):
    call, output = toy
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "matplotlib", None)
        assert "charts need matplotlib, which is not installed" in call("-o", output).refusal
    assert "--resume goes on from a record" in call("--resume").refusal
    assert "expected .json" in call("-o", tmp_path / "toys.txt").refusal
    kinds = {"precious": "is not JSON", "[1]": "no JSON object", '{"study": "sigma"}': "'sigma'"}
    for content, message in kinds.items():
        output.write_text(content)
        assert message in call("-o", output, "--resume").refusal
        assert output.read_text() == content


def test_pages_and_conclusions_are_made_again_from_the_cases(toy, tso):
    path = toy[1]
    record = {"study": "pose", "convention": {"size": "m"}, "cases": [{"size": 3}]}
    path.write_text(json.dumps({**record, "fingerprint": {"camera fit": {"number": 9.0}}}))
    assert tso("lab", "page", path).out == f"{path.with_suffix('.md')}\n"
    assert "| 1.000 | car |" in path.with_suffix(".md").read_text()
    renewed = json.loads(path.read_text())
    assert (renewed["claims"], renewed["convention"]) == (CLAIMS, TOY.convention)
    assert renewed["fingerprint"] == {"camera fit": {"number": 9.0}}
    for content, message in (
        ('{"study": "cooking"}', "of the study 'cooking', expected one of accuracy, "),
        ('{"study": "pose", "complete": false}', "is not complete, expected a finished record"),
    ):
        path.write_text(content)
        assert message in tso("lab", "page", path).refusal


@pytest.mark.parametrize("path", sorted(RECORDS.glob("*.json")), ids=lambda path: path.stem)
def test_the_cases_of_a_kept_record_give_its_conclusions_and_its_page(path):
    record = json.loads(path.read_text())
    if record["study"] == "photos":
        pytest.skip("its page is docs/photos.md")
    study = tools.load(record["study"])
    assert (study.name, record["complete"]) == (record["study"], True)
    assert list(record["fingerprint"]) == list(study.parts)
    assert set(study.parts) <= set(fingerprint.PARTS)
    assert len(WORDS[study.name]["reading"].split()) <= 120
    for table in study.tables(record):
        assert {len(row) for row in table.rows} == {len(table.header)}
    charts = sorted(chart.name for chart in RECORDS.glob(f"{path.stem}.*.png"))
    assert path.with_suffix(".md").read_text() == page(study, record, path.name, charts)
    assert json.loads(json.dumps(study.renewed(record))) == record


QUICK = {
    name: replace(variant, config=replace(variant.config, steps=3))
    for name, variant in cases.POINTS.items()
}
FOUR = cases.Variant(RefineConfig(steps=3), 4)
ROWS = {"whole": (evidence.unaltered, FOUR), "part": (partial(evidence.without, part="side"), FOUR)}
QUESTION = evidence.Question("Objects that lack a part", ("other",), ROWS, ("chair", "car"))
WAY_NAMES = (
    DEFAULT,
    PAPER,
    f"{DEFAULT}, 2 masks",
    f"{DEFAULT}, 256 points",
    "latent, best",
    *PEERS,
)
QUICK_WAYS = {
    name: replace(way, run=replace(way.run, config=replace(way.run.config, steps=2)))
    if isinstance(way.run, cases.Variant)
    else way
    for name, way in WAYS.items()
    if name in WAY_NAMES
}
CARS, PLANES, CHAIRS = (("--category", name) for name in ("car", "airplane", "chair"))
TINY = ("--steps", 1, "--batch-size", 2)
TINY_PAGE = ("1 steps of 2", "canonical frame, cpu")
PICTURES = ("--pictures", "record.pictures.png")


@dataclass(frozen=True)
class Command:
    """Arguments of a study's command, cases of its first job, and words of its page.

    ``given`` is passed to its plan, which makes it quick.
    """

    arguments: tuple[Any, ...]
    first: int
    words: tuple[str, ...]
    given: dict[str, Any] = field(default_factory=dict)


def training(*categories: Any) -> Command:
    return Command((*TINY, *categories), 1, TINY_PAGE, {"material": SMALL})


COMMANDS = {
    "accuracy": Command(
        (*CARS, "--views", 1, *PICTURES),
        1,
        ("got worse", "floor"),
        {"points": QUICK, "kinds": ("near",)},
    ),
    "evidence": Command(
        ("--views", 1), 1, ("whole", "lack a part"), {"questions": {"missing": QUESTION}}
    ),
    "tso": Command(
        (*CARS, *CHAIRS, "--views", 1, "--steps", 1), 1, ("4.64", "-5.82", "E and D", "occluded")
    ),
    "pose": Command(("--views", 1), 4, (pose.TRUE,), {"categories": ("car",)}),
    "moves": Command(
        ("--size", 64, "--limit", 1), 36, ("right, 6 degrees off",), {"categories": ("car",)}
    ),
    "network": Command((*CARS, *CHAIRS), 3, ("validation", "Chamfer x1000"), {"material": SMALL}),
    "sigma": Command(("--views", 1), 1, ("best sigma^2", "the paper's")),
    "supervision": training(*CARS, *CHAIRS),
    "views": training(*CARS),
    "lambda": training(*CHAIRS),
    "affinity": training(*CARS),
    "failures": training(*PLANES, *CARS),
    "confidence": Command(
        ("--part", "validation", "--per", 1),
        17,
        ("Reliability", "right scenes", "yaw, other"),
        {"jobs": [(TROUBLE["nothing wrong"], "other"), (TROUBLE["yaw"], "other")]},
    ),
    "pareto": Command(
        ("--limit", 1),
        2,
        ("prediction: 2 shapes",),
        {"ways": QUICK_WAYS, "categories": ("car", "airplane")},
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_each_command_writes_record_chart_and_page_and_resumes_to_the_same_cases(
    tso, name, split, thin, tmp_path, monkeypatch
):
    given = COMMANDS[name]
    arguments, first = given.arguments, given.first
    if name in ("tso", "network"):
        checkpoint = thin_checkpoint(tmp_path, monkeypatch, 1024 if name == "network" else 64)
        arguments = (*arguments, "--checkpoint", checkpoint)
    if name == "pareto":
        monkeypatch.undo()  # the shipped network is not thin
        make_known(monkeypatch)
    study = tools.load(name)
    study = replace(study, plan=partial(study.plan, **given.given))
    monkeypatch.setattr(tools, "load", lambda name: study)
    monkeypatch.chdir(tmp_path)
    meshes = ("--meshes", MESHES, "--split", split)
    command = ("lab", name, *meshes, *arguments, "-o", "record.json")
    printed, output = tso(*command).out, tmp_path / "record.json"
    for word in given.words:
        assert word in printed
        assert word in output.with_suffix(".md").read_text()
    for chart in tmp_path.glob("*.png"):
        with Image.open(chart) as picture:
            assert min(picture.size) > 100
    assert ("--pictures" in arguments) == (tmp_path / "record.pictures.png").exists()
    whole = json.loads(output.read_text())
    assert whole["complete"]
    assert whole["command"].startswith(f"tso lab {name} --")
    output.write_text(json.dumps({**whole, "complete": False, "cases": whole["cases"][:first]}))
    assert tso(*command, "--resume", "--json").code == 0
    resumed = json.loads(output.read_text())
    assert resumed["cases"][:first] == whole["cases"][:first]
    # The cases of pareto hold what a clock decides.
    assert name == "pareto" or timeless(resumed) == timeless(whole)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["views", "--resume", "-o", "other.json"], "expected one of tso lab views"),
        (["views", "--split", "absent.json"], "car/nothing"),
        (["failures", "--category", "chair"], "found chair, expected one of the two"),
    ],
)
def test_unusable_input_is_one_line(tso, arguments, message, split, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("other.json").write_text(json.dumps({"study": "points", "settings": {}, "cases": []}))
    lists = {"train": ["car/nothing"], "test": ["car/qreal_SUV"]}
    Path("absent.json").write_text(json.dumps(lists))
    run = tso("lab", arguments[0], "--meshes", MESHES, "--split", split, *arguments[1:])
    errors = [line for line in run.err.splitlines() if not line.startswith("tso: checkpoint")]
    assert run.code == 2
    assert len(errors) == 1
    assert message in errors[0]
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.parametrize("name", ["pose", "pareto", "harm"])
def test_a_study_asks_for_its_meshes(tso, name):
    assert "--meshes" in tso("lab", name).refusal


def test_a_study_that_is_none_is_refused(tso):
    assert "No such command 'posing'" in tso("lab", "posing").refusal
