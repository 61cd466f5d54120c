"""The journal is read back after any end of its writer, and has one writer at a time."""

import json
import os
import warnings

import pytest
from hypothesis import given
from hypothesis import strategies as some

from tests.corruption import assert_refused
from tso_cli.batch.journal import Past, open_journal, read_journals


def test_the_past_of_an_item_is_its_last_end_and_the_starts_since(tmp_path):
    path = tmp_path / "journal.jsonl"
    with open_journal(path) as journal:
        for event in ("started", "failed", "started", "done", "started", "started"):
            journal.add("a", event, key=event)
        journal.add("b", "doubtful", key="k")
        journal.add("c", "failed", key="k")
    past = read_journals([path])
    assert past["a"].starts == 2
    assert past["a"].suspicious
    assert past["a"].key == "done"
    assert past["b"].key == "k"
    assert not past["b"].suspicious
    assert past["c"].key is None  # it is tried again


def test_a_line_that_was_cut_off_says_nothing_and_harms_no_later_line(tmp_path):
    path = tmp_path / "journal.jsonl"
    with open_journal(path) as journal:
        journal.add("a", "started")
    path.write_bytes(path.read_bytes() + b'{"item": "a", "event": "do')
    with open_journal(path) as journal:
        journal.add("b", "done", key="k")
    past = read_journals([path])
    assert past["a"].starts == 1
    assert past["b"].key == "k"


def test_a_journal_has_one_writer(tmp_path):
    with open_journal(tmp_path / "j"):
        code = (
            "import sys; from pathlib import Path; from tso_cli.batch.journal import open_journal\n"
            "from tso_cli.errors import InputError\n"
            "try:\n    open_journal(Path(sys.argv[1])).__enter__()\n"
            "except InputError as error:\n    print(error)\n"
        )
        import subprocess
        import sys

        found = subprocess.run(
            [sys.executable, "-c", code, tmp_path / "j"], capture_output=True, text=True
        )
    assert "another process is writing it" in found.stdout


def test_a_folder_in_place_of_a_journal_is_refused(tmp_path):
    assert_refused("cannot be", lambda: open_journal(tmp_path).__enter__())


@given(some.binary(max_size=200))
def test_any_bytes_in_a_journal_are_no_more_than_lines_without_meaning(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("journal") / "j"
    line = json.dumps({"item": "a", "event": "started", "time": 1.0})
    path.write_bytes(data + b"\n" + line.encode() + b"\n")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        assert read_journals([path])["a"] == Past(starts=1, begun=True)


def test_damaged_lines_are_counted_and_lines_that_were_cut_off_are_not(tmp_path):
    path = tmp_path / "journal.jsonl"
    whole = '{"item": "a", "event": "started", "time": 1.0}'
    path.write_text(f"rubbish\n{whole[:20]}\n{whole}\n[1, 2]\n")
    with pytest.warns(UserWarning, match="2 lines are damaged"):
        assert read_journals([path])["a"].starts == 1


def test_the_later_of_two_journals_counts(tmp_path):
    paths = [tmp_path / "journal.jsonl", tmp_path / "1-of-2.journal.jsonl"]
    for path, event, when in zip(paths, ("failed", "done"), (1.0, 2.0), strict=True):
        path.write_text(json.dumps({"item": "a", "event": event, "time": when, "key": "k"}) + "\n")
    for some_order in (paths, paths[::-1]):
        assert read_journals(some_order)["a"].end["event"] == "done"


def test_in_one_journal_the_lower_line_is_later_even_if_the_clock_was_set_back(tmp_path):
    whole, other = tmp_path / "journal.jsonl", tmp_path / "1-of-2.journal.jsonl"
    lines = [
        {"item": "a", "event": "failed", "time": 9.0},
        {"item": "a", "event": "done", "time": 3.0},
    ]
    whole.write_text("".join(json.dumps(line) + "\n" for line in lines))
    other.write_text(json.dumps({"item": "a", "event": "refused", "time": 5.0}) + "\n")
    assert read_journals([whole, other])["a"].end["event"] == "done"


@pytest.mark.parametrize("more", ['"confidence": "high"', '"seconds": NaN', '"iou_after": 1e999'])
def test_a_line_whose_numbers_are_none_says_nothing(tmp_path, more):
    path = tmp_path / "journal.jsonl"
    path.write_text(f'{{"item": "a", "event": "done", "time": 1.0, {more}}}\n' + "[" * 60_000)
    with pytest.warns(UserWarning, match="2 lines are damaged"):
        assert read_journals([path]) == {}


def test_a_line_that_a_disk_takes_in_parts_is_written_whole(tmp_path, monkeypatch):
    write = os.write
    monkeypatch.setattr(os, "write", lambda file, data: write(file, data[:7]))
    with open_journal(tmp_path / "j") as journal:
        journal.add("a", "done", key="k")
    assert read_journals([tmp_path / "j"])["a"].key == "k"
