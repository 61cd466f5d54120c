"""What became of each item, one line of JSON for each event, appended whole."""

from __future__ import annotations

import heapq
import json
import math
import os
import time
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from operator import itemgetter
from pathlib import Path
from typing import Any

from ..errors import InputError, TsoError
from ..io.output import reason, sole_writer

NAME = "journal.jsonl"
STARTED = "started"
RETURNED = "returned"  # a start that came to nothing, because the batch was ending
# How an item ends. An item that ended as one of the second kind is tried again by every run: what
# was wrong may be mended, and nobody takes a refusal for a result.
ENDS = ("done", "doubtful", "refused", "failed")
TRIED_AGAIN = ("refused", "failed")
# What a line says in numbers, if it says it.
NUMBERS = ("confidence", "iou_before", "iou_after", "seconds")
# How every whole line begins.
BEGINNING = b'{"item": '
# An item that was started so often without an end may have ended the whole batch.
SUSPICIOUS_STARTS = 2


@dataclass
class Past:
    """What earlier runs did with an item."""

    starts: int = 0  # since its last end
    begun: bool = False  # ever
    end: dict[str, Any] = field(default_factory=dict)

    @property
    def key(self) -> str | None:
        """Of an end that stands, as long as the inputs and settings have this key."""
        return None if self.end.get("event") in TRIED_AGAIN else self.end.get("key")

    @property
    def suspicious(self) -> bool:
        return self.starts >= SUSPICIOUS_STARTS


def journals_of(output: Path, shard: tuple[int, int] | None) -> tuple[Path, list[Path]]:
    """The journal of a run in the folder ``output``, and those of runs with other parts.

    Runs with equally many parts share no item.
    """

    def parts_of(path: Path) -> str:
        return path.name.removesuffix(NAME).partition("-of-")[2]

    part = f"{shard[0]}-of-{shard[1]}." if shard else ""
    own = output / f"{part}{NAME}"
    journals = sorted(output.glob(f"*{NAME}"))
    return own, [journal for journal in journals if parts_of(journal) != parts_of(own)]


def read_journals(paths: Sequence[Path]) -> dict[str, Past]:
    """Item -> its past. A line that was cut off by the end of its writer says nothing.

    Within a journal the order of its lines counts, even if the clock was set back. Between journals
    the time counts.
    """
    past: dict[str, Past] = {}
    for _, entry in heapq.merge(*map(_timed, paths), key=itemgetter(0)):
        item = past.setdefault(entry["item"], Past())
        if entry["event"] == STARTED:
            item.starts, item.begun = item.starts + 1, True
        elif entry["event"] == RETURNED:
            item.starts -= 1
        else:
            item.starts, item.end = 0, entry
    return past


def _timed(path: Path) -> Iterator[tuple[float, dict[str, Any]]]:
    """The entries of a journal, each with a time that is not before that of the one above."""
    latest = -math.inf
    for entry in entries(path):
        latest = max(latest, entry["time"])
        yield latest, entry


def entries(path: Path) -> Iterator[dict[str, Any]]:
    """The whole lines of a journal; none if there is no such file. Warns of other lines."""
    damaged = 0
    try:
        lines = path.open("rb")
    except FileNotFoundError:
        return
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({reason(error)})") from None
    with lines:
        for line in lines:
            try:
                entry = _entry(line)
            except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
                # Others were cut off.
                damaged += line.rstrip().endswith(b"}") or not line.startswith(BEGINNING)
            else:
                yield entry
    if damaged:
        warnings.warn(f"{path}: {damaged:,} lines are damaged, and say nothing", stacklevel=2)


def _entry(line: bytes) -> dict[str, Any]:
    """What a line says; some error if it is no line of a journal."""
    entry: dict[str, Any] = json.loads(line)
    if entry["event"] not in (STARTED, RETURNED, *ENDS):
        raise ValueError
    entry["item"] = str(entry["item"])
    for name in ("time", *NUMBERS):
        if entry.get(name) is not None or name == "time":
            entry[name] = float(entry[name])
            if not math.isfinite(entry[name]):
                raise ValueError
    if not isinstance(entry.get("columns", {}), dict):
        raise TypeError
    return entry


class Journal:
    """A journal that this process alone appends to."""

    def __init__(self, path: Path, descriptor: int) -> None:
        self.path, self._descriptor = path, descriptor

    def add(self, item: str, event: str, **more: Any) -> None:
        """Append a line. It is written at once and whole, whatever becomes of this process."""
        entry = {"item": item, "event": event, "time": round(time.time(), 3), **more}
        line = json.dumps(entry).encode() + b"\n"
        try:
            while line:  # a disk that is nearly full takes a part
                line = line[os.write(self._descriptor, line) :]
        except OSError as error:
            raise TsoError(
                f"{self.path}: cannot be written ({reason(error)}), so the batch has ended; the "
                "same command goes on"
            ) from None


@contextmanager
def open_journal(path: Path) -> Iterator[Journal]:
    """The journal of one run; InputError if another process is writing it."""
    with sole_writer(path):
        try:
            descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o666)
        except OSError as error:
            raise InputError(f"{path}: cannot be written ({reason(error)})") from None
        try:
            size = os.fstat(descriptor).st_size
            if size and os.pread(descriptor, 1, size - 1) != b"\n":
                os.write(descriptor, b"\n")  # after a line that was cut off
            yield Journal(path, descriptor)
        finally:
            os.close(descriptor)
