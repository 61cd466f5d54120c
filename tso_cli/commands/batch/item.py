"""One item of a batch, as a process does it: a run of `tso refine` that prints nothing."""

from __future__ import annotations

import errno
import re
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ...batch.remote import cameras_of, exists, is_remote, local, state_of, texts_of
from ...batch.run import Given, Outcome, Task
from ...errors import InputError, TsoError
from ...io.output import atomic_output
from ...io.reading import digest_of
from ...option import declared
from .. import options
from ..refine.inputs import RefineInputs
from ..refine.options import RefineOptions
from ..refine.outputs import NAMED, record_of
from ..refine.record import key_of
from ..refine.run import RefineRun

# Errors of a disk or network that may be over after a moment, and the seconds to wait before each
# attempt; and those of a disk that needs somebody's hand.
PASSING = (
    errno.EIO, errno.ESTALE, errno.ETIMEDOUT, errno.EAGAIN, errno.EBUSY, errno.ECONNRESET,
    errno.ENETUNREACH, errno.EHOSTUNREACH, errno.EREMOTEIO, errno.ENFILE,
)  # fmt: skip
PAUSES = (0.0, 0.5, 2.0)
OF_THE_DISK = (*PASSING, errno.ENOSPC, errno.EDQUOT, errno.EROFS)


def options_of(given: Given) -> RefineOptions:
    """The options of an item, whose paths are text; InputError if they do not go together."""
    table = declared(RefineOptions)

    def typed(name: str, value: Any) -> Any:
        if table[name].plain is not Path or value is None:
            return value
        return tuple(map(Path, value)) if isinstance(value, tuple) else Path(value)

    return RefineOptions(**{name: typed(name, value) for name, value in given.items()})


def _cameras(given: Given) -> dict[str, str]:
    """Remote mask -> the camera file next to it, unless the item names its camera."""
    return {} if given.get("camera") else cameras_of(given.get("masks", ()))


def _key(task: Task, chosen: RefineOptions, cameras: Mapping[str, str]) -> str:
    """The key of an item: its settings, the contents of its files, the state of remote files.

    ``cameras`` are those next to its masks.
    """
    remote = [text for text in texts_of(task.given) if is_remote(text) and text != task.item]
    states = [state_of(address) for address in (*remote, *cameras.values())]
    digests = [digest_of(file) for file in RefineInputs(chosen).files if not _fetched(file)]
    return key_of({name: getattr(chosen, name) for name in task.given}, [*states, *digests])


def _fetched(path: Path) -> bool:
    """Whether a path was an address; `Path` has left it a single slash."""
    return re.match(r"[a-z][a-z0-9+.-]+:/", path.as_posix()) is not None


def unchanged(task: Task) -> bool:
    """Whether the inputs and settings of an item have the key of its last end."""
    chosen = options_of(task.given)
    if task.written:
        output = task.given["output"]
        there = exists(task.item) if is_remote(task.item) else Path(output).is_file()
        if not there or not (is_remote(task.item) or Path(record_of(output)).is_file()):
            return False
    return _key(task, chosen, _cameras(task.given)) == task.key


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
        except (TsoError, OSError) as error:
            refused = isinstance(error, InputError) and not _caused_by(error, OF_THE_DISK)
            outcome = Outcome("refused" if refused else "failed", reason=str(error))
            if not _caused_by(error, PASSING):
                break
    return replace(outcome, seconds=time.perf_counter() - begun)


def _refined(task: Task, pictures: Path | None) -> Outcome:
    cameras = _cameras(task.given)
    key = _key(task, options_of(task.given), cameras)
    with local(task.given, task.item if is_remote(task.item) else "", cameras) as files:
        # Files that are not of this batch were refused before; one of its own may be half of a
        # result.
        own = {"overwrite": True, "record": True, "quiet": True}
        chosen = options_of({**files.given, **own})
        outcome = _of_files(chosen, files.given, task.item, key, pictures)
        record = Path(record_of(str(chosen.output)))
        for text in (record, chosen.report, chosen.write_camera):
            if text is not None and text.is_file():
                files.name_in(text)
        return replace(outcome, reason=files.named(outcome.reason))


def _of_files(
    chosen: RefineOptions, given: Given, item: str, key: str, pictures: Path | None
) -> Outcome:
    given = {name: getattr(chosen, name) for name in given}
    for name in ("output", *NAMED):
        if (file := getattr(chosen, name)) is not None:
            file.parent.mkdir(parents=True, exist_ok=True)
    with options.Warnings(quiet=True) as warned:
        line = options.command_line("refine", RefineOptions, given)
        report, unwritten = RefineRun(chosen, given, warned.texts, line).work()
        document = report.document(warned.texts, written=not unwritten)
        if pictures is not None:
            from ...plots.thumbnail import write_thumbnail
            from .page import picture_of

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
