"""What `tso batch` does: checks all items, runs them, and says what became of them."""

from __future__ import annotations

import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import click

from ..batch.engines import engine
from ..batch.journal import NAME, Journal, open_journal, read_journal
from ..batch.manifest import folder_of, read_manifest
from ..batch.remote import exists, is_remote
from ..batch.run import Outcome, Summary, run, tasks_of
from ..errors import InputError
from ..workers import cores
from . import options
from .batch_arguments import arguments_of
from .batch_item import refine_item, unchanged
from .batch_page import INDEX, write_index

NOT_ALL_DONE = 3
"""The exit code if an item failed, was refused or is doubtful."""
INTERRUPTED = 130
MOST_LISTED = 5


@dataclass(frozen=True)
class BatchRun:
    """The options of `tso batch`; InputError if they do not go together."""

    manifest: Path | str  # an address
    output: Path
    strict: bool
    overwrite: bool
    report: bool
    jobs: int | None
    shard: tuple[int, int] | None
    engine: str
    scheduler: str | None
    quiet: bool
    as_json: bool

    def __post_init__(self) -> None:
        if self.scheduler is not None and self.engine != "dask":
            raise InputError(
                f"--scheduler {self.scheduler} is for --engine dask, found --engine {self.engine}"
            )

    def run(self) -> int:
        """Run the batch and print what became of it; the exit code."""
        items, begun = self._items(), time.perf_counter()
        try:
            self.output.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            found = f"is no folder ({error.strerror}), expected one"
            raise InputError(f"{self.output}: {found}") from None
        part = f"{self.shard[0]}-of-{self.shard[1]}." if self.shard else ""
        with open_journal(self.output / f"{part}{NAME}") as journal:
            summary = self._run(items, journal)
        if self.report:
            write_index(self.output)
        seconds = time.perf_counter() - begun
        if self.as_json:
            options.echo_json(_document(summary, seconds))
        elif not self.quiet:
            _print(summary, journal.path, seconds)
            if self.report:
                click.echo(f"{self.output / INDEX}: a page of all items")
        if summary.interrupted:
            return INTERRUPTED
        all_done = summary.total == summary.counts["done"] + summary.counts["skipped"]
        return 0 if all_done else NOT_ALL_DONE

    def _items(self) -> list[tuple[str, tuple[str, ...]]]:
        """The name and the arguments of each item."""
        more = ["--strict"] if self.strict else []
        items, folder = read_manifest(self.manifest), folder_of(self.manifest)
        return arguments_of(items, folder, self.output, more, self.shard or (1, 1))

    def _run(self, items: list[tuple[str, tuple[str, ...]]], journal: Journal) -> Summary:
        past = read_journal(journal.path)

        def refusal(item: str, known: bool) -> str:
            place = item if is_remote(item) else self.output / item
            there = exists(item) if is_remote(item) else (self.output / item).exists()
            if self.overwrite or known or not there:
                return ""
            return f"{place}: exists already, expected a new name or --overwrite"

        tasks = tasks_of(items, past, refusal)
        compiled = _compiled(self.quiet)
        bar = options.ProgressBar("tso: refining", delay=0.0)
        begun = time.perf_counter()

        def on_end(item: str, outcome: Outcome, summary: Summary) -> None:
            worse = summary.done - summary.counts["done"] - summary.counts["skipped"]
            pace = summary.done / max(time.perf_counter() - begun, 1e-9)
            if not self.quiet:
                bar(summary.done, summary.total, f"items, {pace:.1f}/s, {worse} not done")

        work = partial(
            refine_item, compiled=compiled, pictures=self.output if self.report else None
        )
        with engine(
            self.engine, min(self.jobs or cores(), max(1, len(tasks))), self.scheduler
        ) as used:
            try:
                return run(
                    tasks, past, work, unchanged, used.executor, used.window, journal, on_end,
                    used.task_seconds,
                )  # fmt: skip
            finally:
                bar.close()


def _compiled(quiet: bool) -> bool:
    """Whether loops are compiled, which is done here if they are not."""
    from ..kernels.dispatch import on_disk, usable
    from ..refinement.api import compile_loops

    if not usable():
        return False
    if not on_disk():
        if not quiet:
            options.log("tso: compiling the loops once, which takes about half a minute")
        compile_loops()
    return on_disk()


def _document(summary: Summary, seconds: float) -> dict[str, Any]:
    return {
        "items": summary.total,
        **{event: summary.counts[event] for event in ("skipped", "done", "doubtful", "refused",
                                                      "failed")},
        "seconds": seconds,
        "quarantined": summary.quarantined,
        "not_done": [
            {"item": item, "event": outcome.event, "reason": outcome.reason}
            for item, outcome in summary.ended
        ],
    }  # fmt: skip


def _print(summary: Summary, journal: Path, seconds: float) -> None:
    counts = [f"{number:,} {event}" for event, number in summary.counts.most_common()]
    pace = (summary.done - summary.counts["skipped"]) / seconds
    click.echo(
        f"{summary.done:,} of {summary.total:,} items: {', '.join(counts) or 'nothing'}; "
        f"{seconds:.1f} s, {pace:.1f} items/s"
    )
    if summary.quarantined:
        click.echo(f"  ended the batch twice, so done last and alone: "
                   f"{_listed(summary.quarantined)}")  # fmt: skip
    doubtful = [one for one in summary.ended if one[1].values.get("confidence") is not None]
    doubtful.sort(key=lambda one: one[1].values["confidence"])
    for item, outcome in doubtful[:MOST_LISTED]:
        click.echo(f"  {outcome.event}  {item}: confidence {outcome.values['confidence']:.2f}")
    for reason, number in summary.reasons.most_common(MOST_LISTED):
        click.echo(f"  {number:,} x {reason}")
    if summary.interrupted:
        click.echo("  interrupted; the same command goes on")
    click.echo(f"journal: {journal}")


def _listed(names: list[str]) -> str:
    more = f" and {len(names) - MOST_LISTED:,} more" if len(names) > MOST_LISTED else ""
    return f"{', '.join(names[:MOST_LISTED])}{more}"
