"""One item of a batch, as a process does it: a run of `tso refine` that prints nothing."""

from __future__ import annotations

import errno
import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import click

from ..batch.remote import cameras_of, exists, is_remote, local, state_of
from ..batch.run import Outcome, Task
from ..errors import InputError, TsoError
from ..io.output import atomic_output
from . import options
from .refine import command as refine_command
from .refine_files import RefineInputs
from .refine_outputs import NAMED
from .refine_record import digest_of, key_of, record_of
from .refine_run import RefineRun

# Errors of a disk or network that may be over after a moment, and the seconds to wait before each
# attempt; and those of a disk that needs somebody's hand.
PASSING = (
    errno.EIO, errno.ESTALE, errno.ETIMEDOUT, errno.EAGAIN, errno.EBUSY, errno.ECONNRESET,
    errno.ENETUNREACH, errno.EHOSTUNREACH, errno.EREMOTEIO, errno.ENFILE,
)  # fmt: skip
PAUSES = (0.0, 0.5, 2.0)
OF_THE_DISK = (*PASSING, errno.ENOSPC, errno.EDQUOT, errno.EROFS)


def context_of(arguments: Sequence[str]) -> click.Context:
    """What `tso refine` makes of its arguments; raises click's errors."""
    # click keeps the help option of the first context for all later ones.
    return refine_command.make_context("refine", list(arguments), **options.CONTEXT)


def _cameras(task: Task, ctx: click.Context) -> dict[str, str]:
    """Remote mask -> the camera file next to it, unless the item names its camera."""
    masks = task.arguments[task.arguments.index("--") + 2 :]
    return {} if ctx.params["camera"] else cameras_of(masks)


def _key(task: Task, ctx: click.Context, cameras: Mapping[str, str]) -> str:
    """The key of an item: its settings, the contents of its files, the state of remote files.

    ``cameras`` are those next to its masks.
    """
    files = options.pick(RefineInputs, ctx.params).files
    remote = [word for word in task.arguments if is_remote(word) and word != task.item]
    states = [state_of(address) for address in (*remote, *cameras.values())]
    return key_of(
        options.given(ctx), [*states, *(digest_of(file) for file in files if not _fetched(file))]
    )


def _fetched(path: Path) -> bool:
    """Whether a path was an address; `Path` has left it a single slash."""
    return re.match(r"[a-z][a-z0-9+.-]+:/", path.as_posix()) is not None


def unchanged(task: Task) -> bool:
    """Whether the inputs and settings of an item have the key of its last end."""
    ctx = context_of(task.arguments)
    if task.written:
        output = ctx.params["output"]
        there = exists(task.item) if is_remote(task.item) else output.is_file()
        if not there or not (is_remote(task.item) or Path(record_of(str(output))).is_file()):
            return False
    return _key(task, ctx, _cameras(task, ctx)) == task.key


def refine_item(task: Task, pictures: Path | None) -> Outcome:
    """Refine an item, write its files, and say what became of it.

    ``pictures`` is the folder of the batch if an index page will show a picture of each item.
    """
    begun = time.perf_counter()
    for pause in PAUSES:
        time.sleep(pause)
        try:
            outcome = _refined(task, pictures)
            break
        except (TsoError, OSError, click.ClickException) as error:
            text = error.format_message() if isinstance(error, click.ClickException) else str(error)
            unusable = isinstance(error, (InputError, click.ClickException))
            refused = unusable and not _caused_by(error, OF_THE_DISK)
            outcome = Outcome("refused" if refused else "failed", reason=text)
            if not _caused_by(error, PASSING):
                break
    return replace(outcome, seconds=time.perf_counter() - begun)


def _refined(task: Task, pictures: Path | None) -> Outcome:
    ctx = context_of(task.arguments)
    cameras = _cameras(task, ctx)
    key = _key(task, ctx, cameras)
    with local(task.arguments, task.item if is_remote(task.item) else "", cameras) as files:
        ctx = context_of(files.words) if files.folders else ctx
        outcome = _of_files(ctx, task.item, key, pictures)
        record = Path(record_of(str(ctx.params["output"])))
        for text in (record, ctx.params["report"], ctx.params["write_camera"]):
            if text is not None and text.is_file():
                files.name_in(text)
        return replace(outcome, reason=files.named(outcome.reason))


def _of_files(
    ctx: click.Context,
    item: str,
    key: str,
    pictures: Path | None,
) -> Outcome:
    chosen = dict(ctx.params)
    strict = chosen.pop("strict")
    for name in ("check", "quiet", "verbose", "as_json"):
        chosen.pop(name)
    # Files that are not of this batch were refused before; one of its own may be half of a result.
    chosen["overwrite"] = chosen["record"] = True
    for name in ("output", *NAMED):
        if chosen[name] is not None:
            chosen[name].parent.mkdir(parents=True, exist_ok=True)
    with ctx, options.Warnings(quiet=True) as warned:
        run = RefineRun(chosen, options.given(ctx), warned.texts, False, strict, True, False, False)
        report, unwritten = run.work()
        document = report.document(warned.texts, written=not unwritten)
        if pictures is not None:
            from ..plots.thumbnail import write_thumbnail
            from .batch_page import picture_of

            picture = picture_of(pictures, item)
            picture.parent.mkdir(parents=True, exist_ok=True)
            with atomic_output(picture, overwrite=True) as temporary:
                write_thumbnail(temporary, report.result, report.scene.views)
    doubtful = unwritten or document["verdict"] == "doubtful"
    values = {
        name: options.plain(document[name])
        for name in ("verdict", "confidence", "moved", "iou_before", "iou_after", "output")
    }
    if is_remote(item) and not unwritten:
        values["output"] = item
    why = document["reason"] if doubtful else ""
    return Outcome("doubtful" if doubtful else "done", key, 0.0, why, values)


def _caused_by(error: BaseException | None, numbers: Sequence[int]) -> bool:
    """Whether an error of the system with one of the ``numbers`` caused ``error``."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in numbers:
            return True
        error = error.__cause__ or error.__context__
    return False
