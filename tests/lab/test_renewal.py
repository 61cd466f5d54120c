"""`tso lab records`: what is due is made again, and nothing else."""

from __future__ import annotations

import json
import re
import shlex
import sys

import pytest

from tso_lab.commands import records, renewal, tools
from tso_lab.commands.renewal import KEPT, Due, Kept, make, needs

from ..readme import RECORDS

SMALL = Kept("small", "tso lab harm --quick --per 1 --trouble bite")


@pytest.mark.parametrize("kept", [one for one in KEPT if one.name != "photos"], ids=str)
def test_the_command_of_a_record_is_written_as_the_record_keeps_it(kept):
    name, *words = shlex.split(kept.command)[2:]
    study = tools.load(name)
    values = records.command_of(study).make_context("tso", words).params
    assert records._command_line(study, values) == kept.command


def test_every_record_can_be_made_again():
    assert {path.stem for path in RECORDS.glob("*.json")} <= {kept.name for kept in KEPT}
    assert [kept.alone for kept in KEPT] == sorted(kept.alone for kept in KEPT)


def test_a_folder_that_is_missing_is_asked_for_and_a_name_of_no_record_is_refused(tso, tmp_path):
    refusal = tso("lab", "records", "moves", "scale", "-o", tmp_path).refusal
    assert "--meshes is missing, for moves: expected a folder" in refusal
    assert (
        "'move' is no record, expected some of "
        in tso("lab", "records", "move", "-o", tmp_path).refusal
    )
    needs([Due(KEPT[0], "")], {"--meshes": None, "--photos": tmp_path})


WRITE = (
    "import sys, time; begun = time.time(); time.sleep(0.4);"
    "open(sys.argv[1], 'w').write(f'{begun} {time.time()}');"
    "sys.exit('bad' if sys.argv[2] == 'b' else 0)"
)


def test_two_run_at_once_but_those_alone_and_one_that_fails_stops_none(
    tmp_path, monkeypatch, capsys
):
    def command(record, folder, folders, scratch):
        return [[sys.executable, "-c", WRITE, str(folder / record.kept.name), record.kept.name]]

    monkeypatch.setattr(renewal, "commands", command)
    due = [Due(Kept(name, "", alone=name > "c"), "it is missing") for name in "abcde"]
    assert make(due, tmp_path, {}, 2) == ["b"]
    spans = {path.name: tuple(map(float, path.read_text().split())) for path in tmp_path.iterdir()}
    assert sorted(spans) == list("abcde")
    beside = {
        name: {
            other for other, (b, e) in spans.items() if b < spans[name][1] and e > spans[name][0]
        }
        for name in spans
    }
    # The cheapest and the dearest begin together.
    assert {"a", "c"} <= beside["a"]
    assert (beside["d"], beside["e"]) == ({"d"}, {"e"})
    said = capsys.readouterr().err
    assert "tso: b: ended with 1, saying 'bad'" in said
    assert re.search(r"tso: e: made in 0\.0 min", said)


@pytest.mark.slow
def test_fresh_records_stay_stale_ones_are_made_again_and_incomplete_ones_go_on(
    tso, tmp_path, monkeypatch
):
    monkeypatch.setattr(renewal, "KEPT", (SMALL,))
    path, command = tmp_path / "small.json", ("lab", "records", "-o", tmp_path)

    def marked(**changes):
        """The record with these changes, and a mark in its first case."""
        record = json.loads(path.read_text()) | changes
        record["cases"][0]["mark"] = True
        path.write_text(json.dumps(record))

    def is_marked():
        return "mark" in json.loads(path.read_text())["cases"][0]

    def why():
        run = tso(*command)
        assert run.out == f"{path}\n"
        assert json.loads(path.read_text())["complete"]
        return run.err

    assert "it is missing" in why()
    whole = json.loads(path.read_text())
    assert whole["command"] == SMALL.command
    assert path.with_suffix(".md").exists()
    marked()
    assert (tso(*command).out, is_marked()) == ("", True)
    marked(complete=False, cases=whole["cases"][:1])
    assert "goes on" in why()
    assert is_marked()
    assert len(json.loads(path.read_text())["cases"]) == len(whole["cases"])
    for changes, reason in (
        ({"fingerprint": {"pictures": {"mask": 9.0}}}, "the method has changed: pictures"),
        ({"command": "tso lab harm"}, "it was made with other settings"),
    ):
        marked(**changes)
        assert reason in why()
        assert not is_marked()
