"""The run over a batch: every item at least once, with an effect once."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from ..errors import InputError, TsoError
from ..io.output import reason
from ..signals import at_interrupt, press_ctrl_c
from ..workers import Ended, each, is_death
from .journal import RETURNED, STARTED, Journal, Past

# Results of earlier runs are checked in tasks of about so long.
CHECKING_SECONDS = 1.0
# After Ctrl-C or SIGTERM the items at work have this many seconds. SLURM waits for 30.
PATIENCE = 20.0

Given = Mapping[str, Any]


@dataclass(frozen=True)
class Task:
    """An item for a process.

    item : its name, which is that of its output in the batch's folder.
    given : its options of `tso refine`, with paths as text. key : of the result that is there.
    written : whether its last end wrote a result. refusal : why it is not even begun.
    """

    item: str
    given: Given
    key: str | None = None
    written: bool = True
    refusal: str = ""


@dataclass(frozen=True)
class Outcome:
    """How an item ended (`journal.ENDS`)."""

    event: str
    key: str | None = None
    seconds: float = 0.0
    reason: str = ""
    values: dict[str, Any] = field(default_factory=dict)


@dataclass
class Summary:
    """What became of the items, in this run or before it.

    skipped : how many ended in earlier runs. seconds : of the items of this run. ended : the items
    that are doubtful or worse.
    """

    total: int
    counts: Counter[str] = field(default_factory=Counter)
    skipped: int = 0
    seconds: float = 0.0
    reasons: Counter[str] = field(default_factory=Counter)
    ended: list[tuple[str, Outcome]] = field(default_factory=list)
    quarantined: list[str] = field(default_factory=list)
    interrupted: bool = False

    def add(self, item: str, outcome: Outcome) -> None:
        self.counts[outcome.event] += 1
        self.seconds += outcome.seconds
        if outcome.event != "done":
            self.reasons[outcome.reason] += 1
            self.ended.append((item, outcome))

    @property
    def done(self) -> int:
        return sum(self.counts.values())


OnEnd = Callable[[str, Outcome, Summary], None]


def tasks_of(
    items: Sequence[tuple[str, Given]],
    past: dict[str, Past],
    refusal: Callable[[str, Given], str],
    strict: bool = False,
) -> list[Task]:
    """The tasks of items (name, options).

    ``refusal`` says why an item that no run has begun must not begin, or "". ``strict`` : whether
    doubtful results are to be left unwritten.
    """
    tasks = []
    for item, given in items:
        one = past.get(item, Past())
        written = bool(one.end.get("output"))
        changed = one.end.get("event") == "doubtful" and written == strict
        # A process that died may have written its result before.
        why = "" if one.begun else refusal(item, given)
        tasks.append(Task(item, given, None if changed else one.key, written, why))
    return tasks


def run(
    tasks: Sequence[Task],
    past: dict[str, Past],
    work: Callable[[Task], Outcome],
    unchanged: Callable[[Task], bool],
    executor: Executor,
    window: int,
    journal: Journal,
    on_end: OnEnd,
    interrupted: threading.Event,
    task_seconds: float = 0.0,
) -> Summary:
    """Do all tasks, and write down what becomes of each.

    ``unchanged`` says of a task with a key whether its result and its inputs are as they were; it
    is then left out. Items that earlier runs began twice and never ended are done last and alone.
    Once ``interrupted`` is set (`waiting_for_items`), the items at work end and no other begins.
    """
    summary = Summary(len(tasks))
    suspicious = {task.item for task in tasks if past.get(task.item, Past()).suspicious}
    summary.quarantined = sorted(suspicious)
    stopping = interrupted.is_set
    ended_before = [task for task in tasks if task.key]
    settings: dict[str, Any] = dict(stopping=stopping, task_seconds=CHECKING_SECONDS)
    left_out = set()
    for checked in each(executor, unchanged, ended_before, window, **settings):
        if _is_unchanged(checked, unchanged):
            item = checked.job.item
            left_out.add(item)
            outcome = _earlier(past[item].end)
            summary.skipped += 1
            summary.add(item, outcome)
            on_end(item, outcome, summary)
    left = [task for task in tasks if task.item not in left_out]
    for task in left:
        if task.refusal:
            _end(task.item, Outcome("refused", reason=task.refusal), journal, summary, on_end)
    left = [task for task in left if not task.refusal]
    first = (task for task in left if task.item not in suspicious)
    last = [task for task in left if task.item in suspicious]
    ended = each(
        executor,
        work,
        first,
        window,
        last=last,
        on_start=lambda task, deaths: journal.add(task.item, STARTED),
        on_return=lambda task: journal.add(task.item, RETURNED),
        stopping=stopping,
        task_seconds=task_seconds,
    )
    for one in ended:
        _end(one.job.item, _outcome_of(one), journal, summary, on_end)
    summary.interrupted = stopping() and summary.done < len(tasks)
    return summary


@contextmanager
def waiting_for_items() -> Iterator[threading.Event]:
    """Inside, Ctrl-C sets the event, so that items at work may end.

    A second Ctrl-C is a KeyboardInterrupt, and so is the end of `PATIENCE` seconds. The first one
    raises nothing: an engine that starts would swallow it.
    """
    interrupted = threading.Event()
    again = threading.Timer(PATIENCE, press_ctrl_c)
    again.daemon = True

    def act() -> None:
        interrupted.set()
        again.start()

    try:
        with at_interrupt(act, once=True):
            yield interrupted
    finally:
        again.cancel()


def _is_unchanged(checked: Ended[Task], unchanged: Callable[[Task], bool]) -> bool:
    """What a check found.

    One whose process was killed says nothing of its item, and is made here.
    """
    if not is_death(checked.error):
        return bool(checked.result)
    try:
        return unchanged(checked.job)
    except Exception:  # the item itself will say what is wrong
        return False


def _end(item: str, outcome: Outcome, journal: Journal, summary: Summary, on_end: OnEnd) -> None:
    line = {"key": outcome.key, "seconds": round(outcome.seconds, 3), **outcome.values}
    if outcome.reason:
        line["reason"] = outcome.reason
    journal.add(item, outcome.event, **line)
    summary.add(item, outcome)
    on_end(item, outcome, summary)


def _earlier(end: dict[str, Any]) -> Outcome:
    """How an item ended in an earlier run, as its line in the journal says."""
    known = ("item", "event", "time", "key", "seconds", "reason")
    values = {name: value for name, value in end.items() if name not in known}
    return Outcome(end["event"], end["key"], 0.0, str(end.get("reason", "")), values)


def _outcome_of(ended: Ended[Task]) -> Outcome:
    error = ended.error
    if error is None:
        outcome = ended.result
        assert isinstance(outcome, Outcome)
        return outcome
    foreign = not isinstance(error, TsoError) and not ended.deaths
    words = reason(error) if foreign else ended.failure
    event = "refused" if isinstance(error, InputError) else "failed"
    return Outcome(event, reason=words, values={"deaths": ended.deaths})
