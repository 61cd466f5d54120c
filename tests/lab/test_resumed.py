"""Studies that go on from the record of an earlier start."""

from __future__ import annotations

import pytest

from tso_cli.lab.studies.resumed import complete


def record(cases, whole):
    return {"cases": list(cases), "complete": whole}


def group(*cases):
    return lambda: list(cases)


def test_the_record_is_kept_after_every_group_that_was_judged_and_is_complete_after_the_last():
    kept, told = [], []
    found = complete([], [group(1, 2), group(3)], record, "doing", kept.append, lambda *what: told.append(what))
    assert kept == [{"cases": [1, 2], "complete": False}, {"cases": [1, 2, 3], "complete": True}]
    assert found == kept[-1]
    assert told == [("doing", 1, 2), ("doing", 2, 2)]


def test_what_is_there_already_is_not_judged_again_and_the_record_is_complete_all_the_same():
    kept = []
    found = complete([1], [group(2), None], record, "doing", kept.append)
    assert kept == [{"cases": [1, 2], "complete": False}]
    assert found == {"cases": [1, 2], "complete": True}


def test_an_interruption_leaves_the_record_so_far_and_the_given_cases_as_they_were():
    kept, earlier = [], [1]

    def interrupted():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        complete(earlier, [group(2), interrupted, group(3)], record, "doing", kept.append)
    assert kept == [{"cases": [1, 2], "complete": False}]
    assert earlier == [1]
