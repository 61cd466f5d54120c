"""The run over a batch: every item at least once, with an effect once."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from ..errors import InputError, TsoError
from ..io.output import reason
from ..signals import at_interrupt, press_ctrl_c
from ..workers import Ended, each, is_death
from .engines import Engine
from .journal import RETURNED, STARTED, Journal, Past

# Results of earlier runs are checked in tasks of about so long.
CHECKING_SECONDS = 1.0
# After Ctrl-C or SIGTERM the items at work have this many seconds. SLURM waits for 30.
PATIENCE = 20.0

ItemOptions = Mapping[str, Any]


@dataclass(frozen=True)
class Task:
    """An item for a process.

    item : its name, which is that of its output in the batch's folder.
    options : its options of `tso refine`, with paths as text. key : of the result that is there.
    has_result : whether its last end wrote one. refusal : why it is not even begun.
    """

    item: str
    options: ItemOptions
    key: str | None = None
    has_result: bool = True
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

    skipped : how many ended in earlier runs. not_done : the items that are doubtful or worse.
    """

    total: int
    counts: Counter[str] = field(default_factory=Counter)
    skipped: int = 0
    not_done: list[tuple[str, Outcome]] = field(default_factory=list)
    quarantined: list[str] = field(default_factory=list)
    interrupted: bool = False

    def add(self, item: str, outcome: Outcome) -> None:
        self.counts[outcome.event] += 1
        if outcome.event != "done":
            self.not_done.append((item, outcome))

    @property
    def done(self) -> int:
        return sum(self.counts.values())


OnEnd = Callable[[str, Outcome, Summary], None]


def tasks_of(
    items: Sequence[tuple[str, ItemOptions]],
    past: dict[str, Past],
    refusal: Callable[[str, ItemOptions], str],
    strict: bool = False,
) -> list[Task]:
    """The tasks of items (name, options).

    ``refusal`` says why an item that no run has begun must not begin, or "". ``strict`` : whether
    doubtful results are to be left unwritten.
    """
    tasks = []
    for item, options in items:
        earlier = past.get(item, Past())
        has_result = bool(earlier.end.get("output"))
        by_other_rule = earlier.end.get("event") == "doubtful" and has_result == strict
        key = None if by_other_rule else earlier.key
        # A process that died may have written its result before.
        why = "" if earlier.begun else refusal(item, options)
        tasks.append(Task(item, options, key, has_result, why))
    return tasks


def run(
    tasks: Sequence[Task],
    past: dict[str, Past],
    work: Callable[[Task], Outcome],
    unchanged: Callable[[Task], bool],
    engine: Engine,
    journal: Journal,
    on_end: OnEnd,
    interrupted: threading.Event,
    carried: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
) -> Summary:
    """Do all tasks, and write down what becomes of each.

    ``unchanged`` says of a task with a key whether its result and its inputs are as they were; it
    is then left out. Items that earlier runs began twice and never ended are done last and alone.
    Once ``interrupted`` is set (`waiting_for_items`), the items at work end and no other begins.
    ``carried`` : what the line of an item's end says besides, under "columns".
    """
    summary = Summary(len(tasks))
    stopping = interrupted.is_set

    def count(item: str, outcome: Outcome) -> None:
        summary.add(item, outcome)
        on_end(item, outcome, summary)

    def end(item: str, outcome: Outcome) -> None:
        line = {"key": outcome.key, "seconds": round(outcome.seconds, 3), **outcome.values}
        if outcome.reason:
            line["reason"] = outcome.reason
        if item in carried:
            line["columns"] = carried[item]
        journal.add(item, outcome.event, **line)
        count(item, outcome)

    unchanged_items = set()
    checks = each(
        engine.executor,
        unchanged,
        [task for task in tasks if task.key],
        engine.window,
        stopping=stopping,
        task_seconds=CHECKING_SECONDS,
    )
    for check in checks:
        if _is_unchanged(check, unchanged):
            item = check.job.item
            unchanged_items.add(item)
            summary.skipped += 1
            count(item, _earlier(past[item].end))
    remaining, done_last = [], []
    for task in tasks:
        if task.item in past and past[task.item].suspicious:
            summary.quarantined.append(task.item)
        if task.item in unchanged_items:
            continue
        if task.refusal:
            end(task.item, Outcome("refused", reason=task.refusal))
        elif task.item in summary.quarantined:
            done_last.append(task)
        else:
            remaining.append(task)
    ends = each(
        engine.executor,
        work,
        remaining,
        engine.window,
        last=done_last,
        on_start=lambda task, deaths: journal.add(task.item, STARTED),
        on_return=lambda task: journal.add(task.item, RETURNED),
        stopping=stopping,
        task_seconds=engine.task_seconds,
    )
    for ended in ends:
        end(ended.job.item, _outcome_of(ended))
    summary.quarantined.sort()
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


def _is_unchanged(check: Ended[Task], unchanged: Callable[[Task], bool]) -> bool:
    """What a check says; one whose process was killed says nothing, and is made here."""
    if not is_death(check.error):
        return bool(check.result)
    try:
        return unchanged(check.job)
    except Exception:  # the item itself will say what is wrong
        return False


def _earlier(end: dict[str, Any]) -> Outcome:
    """How an item ended in an earlier run, as its line in the journal says."""
    common = ("item", "event", "time", "key", "seconds", "reason")
    values = {name: value for name, value in end.items() if name not in common}
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
