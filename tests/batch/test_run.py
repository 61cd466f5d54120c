"""Every item ends once, whatever happens to processes; what is done is not done again."""

import os
import signal
import threading
import time
from functools import partial
from pathlib import Path

import pytest

from tso_cli.batch.engines import Engine
from tso_cli.batch.journal import ENDS, entries, open_journal, read_journals
from tso_cli.batch.run import Outcome, run, tasks_of, waiting_for_items
from tso_cli.errors import InputError
from tso_cli.signals import press_ctrl_c
from tso_cli.workers import WorkerPool

ITEMS = [(f"{number}", {"mode": str(number)}) for number in range(12)]


def work(task, folder, poison=()):
    """Write a file; the items of ``poison`` kill their process, item 5 is refused."""
    if task.item in poison:
        os.kill(os.getpid(), signal.SIGKILL)
    if task.item == "5":
        raise InputError("no 5")
    with (Path(folder) / task.item).open("a") as stream:
        stream.write("x")
    return Outcome("done", f"key {task.options['mode']}", 0.01, values={"output": task.item})


def unchanged(task):
    return task.key == f"key {task.options['mode']}"


@pytest.fixture
def batch(tmp_path):
    """Run the items; the summary."""

    def go(items=ITEMS, poison=(), on_end=lambda *told: None, checking=unchanged):
        path = tmp_path / "journal.jsonl"
        with (
            open_journal(path) as journal,
            waiting_for_items() as interrupted,
            WorkerPool(2) as pool,
        ):
            past = read_journals([path])
            tasks = tasks_of(items, past, lambda item, options: "")
            doing, used = partial(work, folder=tmp_path, poison=poison), Engine(pool, 4)
            return run(tasks, past, doing, checking, used, journal, on_end, interrupted)

    return go


def ends(tmp_path):
    found = {}
    for entry in entries(tmp_path / "journal.jsonl"):
        if entry["event"] in ENDS:
            found.setdefault(entry["item"], []).append(entry["event"])
    return found


def test_every_item_ends_once_and_a_second_run_leaves_out_what_is_done(batch, tmp_path):
    summary = batch()
    assert summary.counts == {"done": 11, "refused": 1}
    assert ends(tmp_path) == {name: ["refused" if name == "5" else "done"] for name, _ in ITEMS}
    again = batch()
    assert again.counts == {"done": 11, "refused": 1}
    assert again.skipped == 11
    assert (tmp_path / "3").read_text() == "x"


def killed_where_it_checks(task, parent):
    if os.getpid() != parent:
        os.kill(os.getpid(), signal.SIGKILL)
    return unchanged(task)


def test_an_item_is_not_done_again_because_its_check_was_killed(batch, tmp_path):
    batch()
    again = batch(checking=partial(killed_where_it_checks, parent=os.getpid()))
    assert again.skipped == 11
    assert {len(texts) for name, texts in ends(tmp_path).items() if name != "5"} == {1}


def test_an_item_whose_settings_changed_is_done_again(batch, tmp_path):
    batch()
    changed = [(name, {"mode": "other"} if name == "3" else options) for name, options in ITEMS]
    assert batch(changed).skipped == 10
    assert (tmp_path / "3").read_text() == "xx"


def test_an_item_that_kills_its_process_is_named_and_loses_no_other(batch, tmp_path):
    summary = batch(poison=("7",))
    assert summary.counts == {"done": 10, "refused": 1, "failed": 1}
    ((name, outcome),) = [one for one in summary.not_done if one[1].event == "failed"]
    assert name == "7"
    assert outcome.reason == (
        "its process was killed by SIGKILL, perhaps for lack of memory, 3 times"
    )
    # It is tried again by the next run: perhaps there is more memory then.
    rest = batch()
    assert rest.counts == {"done": 11, "refused": 1}
    assert rest.skipped == 10


def test_an_item_that_was_begun_twice_without_an_end_is_done_last_and_alone(batch, tmp_path):
    with open_journal(tmp_path / "journal.jsonl") as journal:
        for name in ("0", "0", "1"):
            journal.add(name, "started")
    order = []
    summary = batch(on_end=lambda item, *told: order.append(item))
    assert summary.quarantined == ["0"]
    assert order[-1] == "0"
    assert summary.counts["done"] == 11


def test_what_a_process_wrote_before_it_died_is_of_this_batch(tmp_path):
    with open_journal(tmp_path / "journal.jsonl") as journal:
        journal.add("0", "started")
        journal.add("0", "failed", deaths=3)
        journal.add("1", "refused", reason="exists already")
    past = read_journals([tmp_path / "journal.jsonl"])
    asked = []
    tasks_of(ITEMS[:3], past, lambda item, _: asked.append(item) or "")
    assert asked == ["1", "2"]


def test_after_ctrl_c_the_items_at_work_end_and_the_next_run_goes_on(batch, tmp_path):
    def interrupt(item, outcome, summary):
        if summary.done == 3:
            signal.raise_signal(signal.SIGINT)

    summary = batch(on_end=interrupt)
    assert summary.interrupted
    assert 3 <= summary.done <= 8
    assert not [
        past for past in read_journals([tmp_path / "journal.jsonl"]).values() if past.starts
    ]
    rest = batch()
    assert not rest.interrupted
    assert rest.done == 12
    assert {len(texts) for name, texts in ends(tmp_path).items() if name != "5"} == {1}


def test_a_second_ctrl_c_ends_at_once(batch):
    def interrupt(item, outcome, summary):
        signal.raise_signal(signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        batch(on_end=interrupt)


@pytest.mark.parametrize("ignored", [False, True])
def test_an_item_that_never_ends_is_given_up_some_time_after_one_ctrl_c(
    batch, monkeypatch, ignored
):
    """Also where Ctrl-C is ignored, as in the background of a shell."""
    if ignored:
        handler = signal.signal(signal.SIGINT, signal.SIG_IGN)
    monkeypatch.setattr("tso_cli.batch.run.PATIENCE", 0.3)
    monkeypatch.setattr("tso_cli.batch.run.each", lambda *_, **__: (time.sleep(60) for _ in "x"))
    threading.Timer(0.5, press_ctrl_c).start()
    begun = time.monotonic()
    try:
        with pytest.raises(KeyboardInterrupt):
            batch()
    finally:
        if ignored:
            signal.signal(signal.SIGINT, handler)
    assert time.monotonic() - begun < 30.0
