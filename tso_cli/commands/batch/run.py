"""What `tso batch` does: checks all items, runs them, and says what became of them."""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path
from typing import Any

import click

from ...batch.engines import engine
from ...batch.journal import ENDS, Journal, Past, journals_of, open_journal, read_journals
from ...batch.manifest import folder_of, read_manifest
from ...batch.remote import exists, is_remote
from ...batch.run import Given, Outcome, Summary, run, tasks_of, waiting_for_items
from ...errors import Interrupted
from ...io.output import check_output, make_folder, sole_writer
from ...workers import cores
from .. import options
from .item import refine_item, unchanged
from .items import options_of_items, written_by
from .options import BatchOptions
from .page import INDEX, write_index

NOT_ALL_DONE = 3
"""The exit code if an item failed, was refused or is doubtful."""
INTERRUPTED = 130
MOST_LISTED = 5


class BatchRun:
    """One run of a batch."""

    def __init__(self, chosen: BatchOptions) -> None:
        self.options, self.output = chosen, chosen.output

    def run(self) -> int:
        """Run the batch and print what became of it; the exit code."""
        items, begun = self._items(), time.perf_counter()
        make_folder(self.output)
        own, others = journals_of(self.output, self.options.shard)
        self._check_index(own, others)
        try:
            with open_journal(own) as journal:
                for other in others:
                    with sole_writer(other):  # a run with other parts may have the same items
                        pass
                summary = self._run(items, journal, read_journals([own, *others]))
        except KeyboardInterrupt:
            raise Interrupted("interrupted; the same command goes on") from None
        if self.options.report:
            write_index(self.output)
        seconds = time.perf_counter() - begun
        if self.options.as_json:
            options.echo_json(_document(summary, seconds))
        elif not self.options.quiet:
            _print(summary, own, seconds)
            if self.options.report:
                click.echo(f"{self.output / INDEX}: a page of all items")
        if summary.interrupted:
            return INTERRUPTED
        return 0 if summary.total == summary.counts["done"] else NOT_ALL_DONE

    def _check_index(self, own: Path, others: list[Path]) -> None:
        """Refuse to replace a page that no batch has written."""
        of_batch = own.exists() or others
        if self.options.report and not of_batch:
            check_output(self.output / INDEX, self.options.overwrite)

    def _items(self) -> list[tuple[str, Given]]:
        """The name and the options of each item."""
        given, manifest = self.options, self.options.manifest
        items, folder = read_manifest(manifest), folder_of(manifest)
        return options_of_items(items, folder, self.output, given.strict, given.shard or (1, 1))

    def _run(
        self,
        items: list[tuple[str, Given]],
        journal: Journal,
        past: dict[str, Past],
    ) -> Summary:
        tasks = tasks_of(items, past, self._refusal, self.options.strict)
        bar = options.ProgressBar("tso: refining", delay=0.0)
        processes = min(self.options.jobs or cores(), max(1, len(tasks)))
        with (
            waiting_for_items() as interrupted,
            engine(self.options.engine, processes, self.options.scheduler) as used,
        ):
            begun = time.perf_counter()

            def on_end(item: str, outcome: Outcome, summary: Summary) -> None:
                new = summary.done - summary.skipped
                pace = new / max(time.perf_counter() - begun, 1e-9)
                note = f"items, {pace:.1f}/s, {len(summary.ended)} doubtful or worse"
                if not self.options.quiet:
                    bar(summary.done, summary.total, note)

            pictures = self.output if self.options.report else None
            work = partial(refine_item, pictures=pictures)
            try:
                return run(
                    tasks, past, work, unchanged, used.executor, used.window, journal, on_end,
                    interrupted, used.task_seconds,
                )  # fmt: skip
            finally:
                bar.close()

    def _refusal(self, item: str, given: Given) -> str:
        """Why an item that no run has begun must not begin."""
        if self.options.overwrite:
            return ""
        there = [
            file for file in written_by(given)
            if (exists(file) if is_remote(file) else Path(file).exists())
        ]  # fmt: skip
        return f"{there[0]}: exists already, expected a new name or --overwrite" if there else ""


def _document(summary: Summary, seconds: float) -> dict[str, Any]:
    return {
        "items": summary.total,
        **{event: summary.counts[event] for event in ENDS},
        "skipped": summary.skipped,
        "seconds": seconds,
        "quarantined": summary.quarantined,
        "not_done": [
            {"item": item, "event": outcome.event, "reason": outcome.reason}
            for item, outcome in _worst_first(summary)
        ],
    }


def _worst_first(summary: Summary) -> list[tuple[str, Outcome]]:
    """What failed, what was refused, then what is doubtful, the least confident first."""

    def badness(one: tuple[str, Outcome]) -> tuple[int, float, str]:
        confidence = one[1].values.get("confidence")
        return -ENDS.index(one[1].event), 1.0 if confidence is None else confidence, one[0]

    return sorted(summary.ended, key=badness)


def _print(summary: Summary, journal: Path, seconds: float) -> None:
    counts = [f"{number:,} {event}" for event, number in summary.counts.most_common()]
    new = summary.done - summary.skipped
    click.echo(f"{summary.done:,} of {summary.total:,} items: {', '.join(counts) or 'nothing'}")
    before = f"; {summary.skipped:,} ended in earlier runs" if summary.skipped else ""
    click.echo(f"  {new:,} in {seconds:.1f} s, {new / seconds:.1f} items/s{before}")
    if summary.quarantined:
        click.echo(f"  at work when a batch ended twice, so done last and alone: "
                   f"{_listed(summary.quarantined)}")  # fmt: skip
    worst = _worst_first(summary)
    for item, outcome in worst[:MOST_LISTED]:
        click.echo(f"  {outcome.event:<9}{item}: {_why(outcome)}")
    if len(worst) > MOST_LISTED:
        click.echo(f"  and {len(worst) - MOST_LISTED:,} more that are not done")
    for reason, number in summary.reasons.most_common(MOST_LISTED):
        if number > 1:
            click.echo(f"  {number:,} times: {reason}")
    if summary.interrupted:
        click.echo("  interrupted; the same command goes on")
    click.echo(f"journal: {journal}")


def _why(outcome: Outcome) -> str:
    confidence = outcome.values.get("confidence")
    shown = f"confidence {confidence:.2f}; " if confidence is not None else ""
    return f"{shown}{outcome.reason}"


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - MOST_LISTED:,} more" if len(names) > MOST_LISTED else ""
    return f"{', '.join(names[:MOST_LISTED])}{more}"
