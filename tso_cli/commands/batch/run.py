"""What `tso batch` does: checks all items, runs them, and says what became of them."""

from __future__ import annotations

import time
from collections import Counter
from functools import partial
from os.path import lexists
from pathlib import Path
from typing import Any

import click

from ...batch.engines import engine
from ...batch.journal import ENDS, Journal, Past, journals_of, open_journal, read_journals
from ...batch.manifest import folder_of, read_manifest
from ...batch.remote import exists, is_remote
from ...batch.run import ItemOptions, Outcome, Summary, run, tasks_of, waiting_for_items
from ...errors import Interrupted
from ...io.output import check_output, make_folder, sole_writer
from ...io.reading import plain
from ...workers import cores
from .. import options
from ..refine.run import INTERRUPTED
from .item import refine_item, unchanged, written_by
from .items import options_of_items
from .options import BatchOptions
from .page import INDEX, write_index

NOT_ALL_DONE = 3
"""The exit code if an item failed, was refused or is doubtful."""
MOST_LISTED = 5


class BatchRun:
    """One run of a batch."""

    def __init__(self, chosen: BatchOptions) -> None:
        self.options, self.output = chosen, chosen.output
        self._carried: dict[str, dict[str, Any]] = {}  # by item, the columns that are not tso's

    def run(self) -> int:
        """Run the batch and print what became of it; the exit code."""
        chosen, begun = self.options, time.perf_counter()
        items = options_of_items(
            read_manifest(chosen.manifest),
            folder_of(chosen.manifest),
            self.output,
            chosen.strict,
            chosen.shard or (1, 1),
            chosen.manifest,
            self._carried,
        )
        if self._carried and not chosen.quiet:
            names = dict.fromkeys(name for columns in self._carried.values() for name in columns)
            options.log(
                f"no options of tso refine, kept in the journal: {', '.join(map(plain, names))}"
            )
        make_folder(self.output)
        journal_file, other_journals = journals_of(self.output, chosen.shard)
        if chosen.report and not (journal_file.exists() or other_journals):
            # No batch has written this page.
            check_output(self.output / INDEX, chosen.overwrite)
        try:
            with open_journal(journal_file) as journal:
                for other in other_journals:
                    # Fails if a run with other parts is at work: it may have the same items.
                    with sole_writer(other):
                        pass
                past = read_journals([journal_file, *other_journals])
                summary = self._run(items, journal, past)
        except KeyboardInterrupt:
            raise Interrupted("interrupted; the same command goes on") from None
        if chosen.report:
            write_index(self.output)
        seconds = time.perf_counter() - begun
        if chosen.as_json:
            options.echo_json(_document(summary, seconds))
        elif not chosen.quiet:
            _print(summary, journal_file, seconds)
            if chosen.report:
                click.echo(f"{self.output / INDEX}: a page of all items")
        if summary.interrupted:
            return INTERRUPTED
        return 0 if summary.total == summary.counts["done"] else NOT_ALL_DONE

    def _run(
        self, items: list[tuple[str, ItemOptions]], journal: Journal, past: dict[str, Past]
    ) -> Summary:
        chosen = self.options
        tasks = tasks_of(items, past, self._refusal, chosen.strict)
        bar = options.ProgressBar("tso: refining", delay=0.0)
        processes = min(chosen.jobs or cores(), max(1, len(tasks)))
        work = partial(refine_item, pictures=self.output if chosen.report else None)
        with (
            waiting_for_items() as interrupted,
            engine(chosen.engine, processes, chosen.scheduler, chosen.item_seconds) as workers,
        ):
            begun = time.perf_counter()

            def on_end(item: str, outcome: Outcome, summary: Summary) -> None:
                pace = (summary.done - summary.skipped) / max(time.perf_counter() - begun, 1e-9)
                note = f"items, {pace:.1f}/s, {len(summary.not_done)} doubtful or worse"
                if not chosen.quiet:
                    bar(summary.done, summary.total, note)

            try:
                return run(
                    tasks, past, work, unchanged, workers, journal, on_end, interrupted,
                    self._carried,
                )  # fmt: skip
            finally:
                bar.close()

    def _refusal(self, item: str, item_options: ItemOptions) -> str:
        """Why an item that no run has begun must not begin."""
        for file in () if self.options.overwrite else written_by(item_options):
            if exists(file) if is_remote(file) else lexists(file):
                return f"{file}: exists already, expected a new name or --overwrite"
        return ""


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

    def badness(ended: tuple[str, Outcome]) -> tuple[int, float, str]:
        item, outcome = ended
        confidence = outcome.values.get("confidence")
        return -ENDS.index(outcome.event), 1.0 if confidence is None else confidence, item

    return sorted(summary.not_done, key=badness)


def _print(summary: Summary, journal: Path, seconds: float) -> None:
    counts = [f"{number:,} {event}" for event, number in summary.counts.most_common()]
    new = summary.done - summary.skipped
    click.echo(f"{summary.done:,} of {summary.total:,} items: {', '.join(counts) or 'nothing'}")
    before = f"; {summary.skipped:,} ended in earlier runs" if summary.skipped else ""
    click.echo(f"  {new:,} in {seconds:.1f} s, {new / seconds:.1f} items/s{before}")
    if names := summary.quarantined:
        more = f" and {len(names) - MOST_LISTED:,} more" if len(names) > MOST_LISTED else ""
        listed = f"{', '.join(names[:MOST_LISTED])}{more}"
        click.echo(f"  at work when a batch ended twice, so done last and alone: {listed}")
    from ..refine.sentences import two_places

    worst = _worst_first(summary)
    for item, outcome in worst[:MOST_LISTED]:
        confidence = outcome.values.get("confidence")
        sure = f"confidence {two_places(confidence)}; " if confidence is not None else ""
        click.echo(f"  {outcome.event:<9}{item}: {sure}{outcome.reason}")
    if len(worst) > MOST_LISTED:
        click.echo(f"  and {len(worst) - MOST_LISTED:,} more that are not done")
    reasons = Counter(outcome.reason for _, outcome in summary.not_done)
    for reason, number in reasons.most_common(MOST_LISTED):
        if number > 1:
            click.echo(f"  {number:,} times: {reason}")
    if summary.interrupted:
        click.echo("  interrupted; the same command goes on")
    click.echo(f"journal: {journal}")
