"""One item of a batch, as a process does it: a run of `tso refine` that prints nothing."""

from __future__ import annotations

import errno
import re
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from ...batch.remote import cameras_of, exists, is_remote, local, state_of, texts_of
from ...batch.run import ItemOptions, Outcome, Task
from ...errors import InputError, TsoError
from ...io.output import atomic_output
from ...io.reading import digest_of
from ...option import declared
from .. import options
from ..refine.inputs import RefineInputs
from ..refine.options import RefineOptions
from ..refine.outputs import NAMED, record_of
from ..refine.record import key_of
from ..refine.report import RefineReport
from ..refine.run import RefineRun
from .page import picture_of

# Errors of a disk or network that may be over after a moment, and the seconds to wait before each
# attempt.
TRANSIENT = (
    errno.EIO, errno.ESTALE, errno.ETIMEDOUT, errno.EAGAIN, errno.EBUSY, errno.ECONNRESET,
    errno.ENETUNREACH, errno.EHOSTUNREACH, errno.EREMOTEIO, errno.ENFILE,
)  # fmt: skip
PAUSES = (0.0, 0.5, 2.0)
# Errors for which the item is not to blame.
OF_THE_MACHINE = (*TRANSIENT, errno.ENOSPC, errno.EDQUOT, errno.EROFS)


def options_of(item_options: ItemOptions) -> RefineOptions:
    """The options of an item, whose paths are text; InputError if they do not go together."""
    table = declared(RefineOptions)

    def typed(name: str, value: Any) -> Any:
        if table[name].plain is not Path or value is None:
            return value
        return tuple(map(Path, value)) if isinstance(value, tuple) else Path(value)

    return RefineOptions(**{name: typed(name, value) for name, value in item_options.items()})


def _key(task: Task) -> tuple[str, dict[str, str]]:
    """The key of an item, and the camera files next to its remote masks (`cameras_of`).

    The key is of its settings, the contents of its files, and the state of remote files.
    """
    refine_options, item_options = options_of(task.options), task.options
    cameras = {} if item_options.get("camera") else cameras_of(item_options.get("masks", ()))
    remote = [text for text in texts_of(item_options) if is_remote(text) and text != task.item]
    states = [state_of(address) for address in (*remote, *cameras.values())]
    files = RefineInputs(refine_options).files
    # `Path` leaves an address a single slash.
    digests = [digest_of(file) for file in files if not re.match("[a-z][a-z0-9+.-]+:/", str(file))]
    settings = {name: getattr(refine_options, name) for name in item_options}
    return key_of(settings, [*states, *digests]), cameras


def written_by(options: ItemOptions) -> list[str]:
    """The files that an item with these options writes: its result, its record, then others.

    Result and record are paths or addresses, the others are paths.
    """
    result = options["output"]
    return [result, record_of(result), *(options[name] for name in NAMED if options.get(name))]


def unchanged(task: Task) -> bool:
    """Whether the inputs and settings of an item have the key of its last end."""
    # Of a result at an address the record is not looked for.
    is_at_address, files = is_remote(task.item), written_by(task.options)
    is_there = all(Path(file).is_file() for file in (files[2:] if is_at_address else files))
    is_there = is_there and (not is_at_address or exists(task.item))
    return (is_there or not task.has_result) and _key(task)[0] == task.key


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
            refused = isinstance(error, InputError) and not _caused_by(error, OF_THE_MACHINE)
            outcome = Outcome("refused" if refused else "failed", reason=str(error))
            if not _caused_by(error, TRANSIENT):
                break
    return replace(outcome, seconds=time.perf_counter() - begun)


def _refined(task: Task, pictures: Path | None) -> Outcome:
    key, cameras = _key(task)
    with local(task.options, task.item if is_remote(task.item) else "", cameras) as files:
        # `tso batch` has refused to replace files of others. A file of its own may be damaged.
        of_batch = {"overwrite": True, "record": True, "quiet": True}
        refine_options = options_of({**files.options, **of_batch})
        explicit = {name: getattr(refine_options, name) for name in files.options}
        for name in ("output", *NAMED):
            if (file := getattr(refine_options, name)) is not None:
                file.parent.mkdir(parents=True, exist_ok=True)
        with options.Warnings(quiet=True) as warnings:
            line = options.command_line("refine", RefineOptions, explicit)
            report = RefineRun(refine_options, explicit, warnings.texts, line).work()
            if pictures is not None:
                _draw(picture_of(pictures, task.item), report)
        for name in ("record", "report", "write_camera") if files.folders else ():
            if name in report.files:
                files.name_in(report.files[name])
        document = report.document()
        reason = files.named(document["reason"])
    names = ("verdict", "confidence", "moved", "iou_before", "iou_after", "output")
    values = {name: options.json_values(document[name]) for name in names}
    if is_remote(task.item) and report.files:
        values["output"] = task.item
    if report.files and document["verdict"] != "doubtful":
        return Outcome("done", key, values=values)
    return Outcome("doubtful", key, reason=reason, values=values)


def _draw(picture: Path, report: RefineReport) -> None:
    """Draw the picture of an item for the index page."""
    from ...plots.overlay import write_thumbnail

    picture.parent.mkdir(parents=True, exist_ok=True)
    with atomic_output(picture, overwrite=True) as temporary:
        write_thumbnail(temporary, report.result, report.scene.views)


def _caused_by(error: BaseException | None, numbers: Sequence[int]) -> bool:
    """Whether an error of the system with one of the ``numbers`` caused ``error``."""
    while error is not None:
        if isinstance(error, OSError) and error.errno in numbers:
            return True
        error = error.__cause__ or error.__context__
    return False
