"""The journal is read back after any end of its writer, and has one writer at a time."""

import json

from hypothesis import given
from hypothesis import strategies as some

from tests.corruption import assert_refused
from tso_cli.batch.journal import Past, open_journal, read_journal


def test_the_past_of_an_item_is_its_last_end_and_the_starts_since(tmp_path):
    path = tmp_path / "journal.jsonl"
    with open_journal(path) as journal:
        for event in ("started", "failed", "started", "done", "started", "started"):
            journal.add("a", event, key=event)
        journal.add("b", "refused", key="k")
        journal.add("c", "failed", key="k")
    past = read_journal(path)
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
    past = read_journal(path)
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
    path.write_bytes(data + b"\n" + json.dumps({"item": "a", "event": "started"}).encode() + b"\n")
    assert read_journal(path)["a"] == Past(starts=1)
