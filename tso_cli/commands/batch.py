"""`tso batch`: many clouds, each refined once, whatever happens meanwhile."""

from __future__ import annotations

import time
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import click

from ..batch.engines import ENGINES, engine
from ..batch.journal import NAME, Journal, open_journal, read_journal
from ..batch.manifest import CLOUD, MASK, OUTPUT, SEPARATOR, Item, read_manifest, shard_of
from ..batch.run import Outcome, Summary, run, tasks_of
from ..errors import InputError
from ..io.clouds import output_suffix
from ..io.reading import plain, shown
from ..workers import cores
from . import options
from .batch_item import context_of, refine_command, refine_item, unchanged
from .options import PATH, choice, flag, option
from .refine_record import in_folder, parameter_of

NOT_ALL_DONE = 3
"""The exit code if an item failed, was refused or is doubtful."""
INTERRUPTED = 130
MOST_LISTED = 5
# Options that a batch sets itself for each item.
SET_BY_BATCH = ("record", "check", "quiet", "verbose", "as_json", "overwrite", "strict", "config")


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
    folder = manifest if manifest.is_dir() else manifest.parent
    more = ["--strict"] if strict else []
    more += ["--overwrite"] if overwrite else []
    named = _named(items, Path() if manifest.is_dir() else folder, output, more)
    if shard is not None:
        named = shard_of(named, shard)
    try:
        output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{output}: is no folder ({error.strerror}), expected one") from None
    part = "" if shard is None else f"{shard[0]}-of-{shard[1]}."
    begun = time.perf_counter()
    with open_journal(output / f"{part}{NAME}") as journal:
        summary = _run(named, output, journal, jobs, engine, scheduler, overwrite, quiet)
    if report:
        from .batch_page import write_index

        write_index(output)
    seconds = time.perf_counter() - begun
    if as_json:
        options.echo_json(_document(summary, seconds))
    elif not quiet:
        _print(summary, journal.path, seconds)
    not_done = summary.total - summary.counts["done"] - summary.counts["skipped"]
    ctx.exit(INTERRUPTED if summary.interrupted else NOT_ALL_DONE if not_done else 0)


def _named(
    items: Sequence[Item], folder: Path, output: Path, more: list[str]
) -> list[tuple[str, tuple[str, ...]]]:
    """The name of each item's result in the folder ``output``, and its arguments, checked."""
    named: list[tuple[str, tuple[str, ...]]] = []
    places: dict[str, str] = {}
    for item in items:
        name, arguments = _arguments(item, folder, output)
        _check(item, arguments)
        if name in places:
            raise InputError(
                f"{item.place} has the output {plain(name)}, as {places[name]} has; expected "
                f"another: name it in the column {OUTPUT}"
            )
        places[name] = item.place
        named.append((name, (*arguments, *more)))
    return named


def _arguments(item: Item, folder: Path, output: Path) -> tuple[str, list[str]]:
    """The name of an item's result, and the arguments of `tso refine`."""
    parameters = {parameter.name: parameter for parameter in refine_command.params}
    positional: list[str] = []
    words: list[str] = []
    for column, value in item.values.items():
        name = parameter_of(column)
        parameter = parameters.get(name)
        if parameter is None or name in SET_BY_BATCH:
            raise InputError(
                f"{item.place}: the column {shown(column)} is no option of tso refine for an item, "
                f"expected {CLOUD}, {MASK}, camera, {OUTPUT}, steps and so on"
            )
        if name == "output":
            continue
        values = _values(item, column, value, parameter)
        if isinstance(parameter, click.Option) and parameter.is_flag:
            words += [max(parameter.opts, key=len)] if _is_true(item, column, values) else []
            continue
        writes = name in ("overlay", "report", "write_camera")
        placed = [str(in_folder(one, parameter, output if writes else folder)) for one in values]
        if isinstance(parameter, click.Argument):
            # The cloud comes before its masks, whatever the order of the columns.
            positional = [*placed, *positional] if name == "source" else [*positional, *placed]
        else:
            words += [word for one in placed for word in (max(parameter.opts, key=len), one)]
    cloud = Path(str(item.values[CLOUD]))
    mode = str(item.values.get("mode", "points"))
    suffix = output_suffix(cloud) if mode == "points" else ".ply"
    name = str(item.values.get(OUTPUT, f"{cloud.stem}.refined{suffix}"))
    if Path(name).is_absolute() or ".." in Path(name).parts:
        raise InputError(
            f"{item.place}: {OUTPUT} is {plain(name)}, expected a name below the folder of -o"
        )
    name = Path(name).as_posix()
    return name, [*words, "-o", str(output / name), "--", *positional]


def _values(item: Item, column: str, value: Any, parameter: click.Parameter) -> list[Any]:
    several = parameter.nargs == -1 or getattr(parameter, "multiple", False)
    values = value if isinstance(value, list) else [value]
    if several and isinstance(value, str):
        values = [one.strip() for one in value.split(SEPARATOR)]
    if not several and len(values) != 1:
        raise InputError(f"{item.place}: {column} has {len(values)} values, expected one")
    for one in values:
        if isinstance(one, (dict, list)) or one == "":
            raise InputError(f"{item.place}: {column} is {shown(value)}, expected a value")
        if one == "list":
            raise InputError(f"{item.place}: {column} is list, expected a name from that list")
    return values


def _is_true(item: Item, column: str, values: list[Any]) -> bool:
    known = {"true": True, "1": True, "yes": True, "false": False, "0": False, "no": False}
    found = known.get(str(values[0]).casefold())
    if found is None:
        raise InputError(f"{item.place}: {column} is {shown(values[0])}, expected true or false")
    return found


def _check(item: Item, arguments: list[str]) -> None:
    """Raise InputError with row and column for a value that `tso refine` does not take."""
    try:
        context_of(arguments)
    except click.UsageError as error:
        parameter = getattr(error, "param", None)
        column = f": {parameter.name.replace('_', '-')}" if parameter is not None else ""
        raise InputError(f"{item.place}{column}: {error.format_message()}") from None


def _run(
    named: list[tuple[str, tuple[str, ...]]],
    output: Path,
    journal: Journal,
    jobs: int | None,
    name: str,
    scheduler: str | None,
    overwrite: bool,
    quiet: bool,
) -> Summary:
    past = read_journal(journal.path)

    def refusal(item: str, known: bool) -> str:
        if overwrite or known or not (output / item).exists():
            return ""
        return f"{output / item}: exists already, expected a new name or --overwrite"

    tasks = tasks_of(named, past, refusal)
    compiled = _compiled(quiet)
    bar = options.ProgressBar("tso: refining", delay=0.0)
    begun = time.perf_counter()

    def on_end(item: str, outcome: Outcome, summary: Summary) -> None:
        worse = summary.done - summary.counts["done"] - summary.counts["skipped"]
        pace = summary.done / max(time.perf_counter() - begun, 1e-9)
        if not quiet:
            bar(summary.done, summary.total, f"items, {pace:.1f}/s, {worse} not done")

    work = partial(refine_item, compiled=compiled)
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
