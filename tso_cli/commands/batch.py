"""`tso batch`: many clouds, each refined once, whatever happens meanwhile."""

from __future__ import annotations

import time
from functools import partial
from pathlib import Path
from typing import Any

import click

from ..batch.engines import ENGINES, engine
from ..batch.journal import NAME, Journal, open_journal, read_journal
from ..batch.manifest import read_manifest, shard_of
from ..batch.remote import exists, is_remote
from ..batch.run import Outcome, Summary, run, tasks_of
from ..errors import InputError
from ..workers import cores
from . import options
from .batch_arguments import arguments_of
from .batch_item import refine_item, unchanged
from .batch_page import INDEX, write_index
from .options import PATH, choice, flag, option

NOT_ALL_DONE = 3
"""The exit code if an item failed, was refused or is doubtful."""
INTERRUPTED = 130
MOST_LISTED = 5


class Shard(click.ParamType):
    """i/n, the i-th of n parts."""

    name = "I/N"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[int, int]:
        index, slash, count = str(value).partition("/")
        if not slash or not index.isdecimal() or not count.isdecimal():
            self.fail(f"{value!r}, expected I/N such as 1/8.", param, ctx)
        if not 1 <= int(index) <= int(count):
            self.fail(f"{value!r}, expected I from 1 to N.", param, ctx)
        return int(index), int(count)


@click.command("batch", cls=options.Command, headings={"output": "Output", "jobs": "Running"})
@click.argument("manifest", type=PATH)
@options.output("Folder for the results and the journal; it is made if need be.", required=True)
@flag("--strict", "Write no doubtful results.")
@options.overwrite
@flag("--report", "Also write OUT/index.html, a table of all items with pictures.")
@option("--jobs", "Processes.  [default: one for each core]", "-j", type=options.Whole(1))
@option(
    "--shard", "Do only the I-th of N parts of the items, as one of N machines.", type=Shard(),
    metavar="I/N",
)  # fmt: skip
@choice("--engine", "Processes of this machine, or a cluster of dask.", *ENGINES)
@option("--scheduler", "Address of dask's scheduler, such as tcp://10.0.0.1:8786.")
@flag("-q", "Print nothing but errors.", "--quiet")
@options.as_json
@click.pass_context
def command(
    ctx: click.Context,
    manifest: Path,
    output: Path,
    strict: bool,
    overwrite: bool,
    report: bool,
    jobs: int | None,
    shard: tuple[int, int] | None,
    engine: str,
    scheduler: str | None,
    quiet: bool,
    as_json: bool,
) -> None:
    """Refine many clouds, each by its own masks: the items of MANIFEST.

    \b
    tso batch items.csv -o results
    tso batch FOLDER -o results

    A manifest is CSV or JSON Lines with the columns `cloud`, `mask` (several: a.png;b.png),
    `camera`, `output`, and any option of `tso refine` by its name. Its paths are relative to its
    folder, and `-` is stdin. In a folder, files belong together by their names: chair.ply,
    chair.png, chair.camera.json.

    OUT/journal.jsonl says of each item what became of it. If the batch ends early, however it
    ends, the same command goes on: what is done stays, and only items whose files or settings have
    changed are done again. The exit code is 3 if an item failed, was refused or is doubtful.
    """
    if scheduler is not None and engine != "dask":
        raise InputError(f"--scheduler {scheduler} is for --engine dask, found --engine {engine}")
    items = read_manifest(manifest)
    more = ["--strict"] if strict else []
    named = arguments_of(items, Path() if manifest.is_dir() else manifest.parent, output, more)
    if shard is not None:
        named = shard_of(named, shard)
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{output}: is no folder ({error.strerror}), expected one") from None
    part = "" if shard is None else f"{shard[0]}-of-{shard[1]}."
    begun = time.perf_counter()
    with open_journal(output / f"{part}{NAME}") as journal:
        pictures = output if report else None
        summary = _run(named, output, journal, jobs, engine, scheduler, overwrite, quiet, pictures)
    if report:
        write_index(output)
    seconds = time.perf_counter() - begun
    if as_json:
        options.echo_json(_document(summary, seconds))
    elif not quiet:
        _print(summary, journal.path, seconds)
        if report:
            click.echo(f"{output / INDEX}: a page of all items")
    not_done = summary.total - summary.counts["done"] - summary.counts["skipped"]
    ctx.exit(INTERRUPTED if summary.interrupted else NOT_ALL_DONE if not_done else 0)


def _run(
    named: list[tuple[str, tuple[str, ...]]],
    output: Path,
    journal: Journal,
    jobs: int | None,
    name: str,
    scheduler: str | None,
    overwrite: bool,
    quiet: bool,
    pictures: Path | None,
) -> Summary:
    past = read_journal(journal.path)

    def refusal(item: str, known: bool) -> str:
        place = item if is_remote(item) else output / item
        there = exists(item) if is_remote(item) else (output / item).exists()
        if overwrite or known or not there:
            return ""
        return f"{place}: exists already, expected a new name or --overwrite"

    tasks = tasks_of(named, past, refusal)
    compiled = _compiled(quiet)
    bar = options.ProgressBar("tso: refining", delay=0.0)
    begun = time.perf_counter()

    def on_end(item: str, outcome: Outcome, summary: Summary) -> None:
        worse = summary.done - summary.counts["done"] - summary.counts["skipped"]
        pace = summary.done / max(time.perf_counter() - begun, 1e-9)
        if not quiet:
            bar(summary.done, summary.total, f"items, {pace:.1f}/s, {worse} not done")

    work = partial(refine_item, compiled=compiled, pictures=pictures)
    with engine(name, min(jobs or cores(), max(1, len(tasks))), scheduler) as used:
        try:
            return run(
                tasks, past, work, unchanged, used.executor, used.window, journal, on_end,
                used.task_seconds,
            )  # fmt: skip
        finally:
            bar.close()


def _compiled(quiet: bool) -> bool:
    """Whether loops are compiled, which is done here if they are not."""
    from ..kernels.dispatch import importable, on_disk
    from ..refinement.api import compile_loops

    if not importable("numba"):
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
