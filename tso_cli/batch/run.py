"""The run over a batch: every item at least once, with an effect once."""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from typing import Any

from ..errors import InputError, TsoError
from ..io.output import reason
from ..signals import at_interrupt
from ..workers import Ended, each
from .journal import RETURNED, STARTED, TRIED_AGAIN, Journal, Past

# Results of earlier runs are checked in tasks of about so long.
CHECKING_SECONDS = 1.0


@dataclass(frozen=True)
class Task:
    """An item for a process.

    item : its name, which is that of its output in the batch's folder.
    arguments : of `tso refine`. key : of the result that is there already.
    written : whether its last end wrote a result. refusal : why it is not even begun.
    """

    item: str
    arguments: tuple[str, ...]
    key: str | None = None
    written: bool = True
    refusal: str = ""


@dataclass(frozen=True)
class Outcome:
    """What became of an item: "skipped", or how it ended (`journal.ENDS`)."""

    event: str
    key: str | None = None
    seconds: float = 0.0
    reason: str = ""
    values: dict[str, Any] = field(default_factory=dict)


@dataclass
class Summary:
    """What a run did."""

    total: int
    counts: Counter[str] = field(default_factory=Counter)
    seconds: float = 0.0  # of the items
    reasons: Counter[str] = field(default_factory=Counter)
    ended: list[tuple[str, Outcome]] = field(default_factory=list)  # doubtful and worse
    quarantined: list[str] = field(default_factory=list)
    interrupted: bool = False

    def add(self, item: str, outcome: Outcome) -> None:
        self.counts[outcome.event] += 1
        self.seconds += outcome.seconds
        if outcome.event not in ("done", "skipped"):
            self.reasons[outcome.reason] += 1
            self.ended.append((item, outcome))

    @property
    def done(self) -> int:
        return sum(self.counts.values())


OnEnd = Callable[[str, Outcome, Summary], None]


def tasks_of(
    items: Sequence[tuple[str, tuple[str, ...]]],
    past: dict[str, Past],
    refusal: Callable[[str, bool], str],
) -> list[Task]:
    """The tasks of items (name, arguments).

    ``refusal`` says why an item must not begin, or ""; it is given whether an earlier run began it.
    """
    tasks = []
    for item, arguments in items:
        one = past.get(item, Past())
        written = bool(one.end.get("output"))
        # A process that died may have written its result before.
        known = written or one.starts > 0 or one.end.get("event") in TRIED_AGAIN
        tasks.append(Task(item, arguments, one.key, written, refusal(item, known)))
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
    task_seconds: float = 0.0,
) -> Summary:
    """Do all tasks, and write down what becomes of each.

    ``unchanged`` says of a task with a key whether its result and its inputs are as they were; it
    is then left out. Items that earlier runs began twice and never ended are done last and alone.
    Ctrl-C lets the items at work end; a second Ctrl-C is a KeyboardInterrupt.
    """
    summary = Summary(len(tasks))
    suspicious = {task.item for task in tasks if past.get(task.item, Past()).suspicious}
    summary.quarantined = sorted(suspicious)
    came = threading.Event()
    stopping = came.is_set
    with at_interrupt(came.set, once=True):
        ended_before = [task for task in tasks if task.key]
        settings: dict[str, Any] = dict(stopping=stopping, task_seconds=CHECKING_SECONDS)
        left_out = set()
        for checked in each(executor, unchanged, ended_before, window, **settings):
            if checked.result:
                left_out.add(checked.job.item)
                summary.counts["skipped"] += 1
                on_end(checked.job.item, Outcome("skipped"), summary)
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


def _end(item: str, outcome: Outcome, journal: Journal, summary: Summary, on_end: OnEnd) -> None:
    line = {"key": outcome.key, "seconds": round(outcome.seconds, 3), **outcome.values}
    if outcome.reason:
        line["reason"] = outcome.reason
    journal.add(item, outcome.event, **line)
    summary.add(item, outcome)
    on_end(item, outcome, summary)


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
