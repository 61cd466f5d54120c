"""Which records are due, and how they are made again: each by its own process, some at a time."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tso_cli.commands import options
from tso_cli.errors import InputError
from tso_cli.io.shipped import PACKAGE, examples_folder

from ..study import undamaged
from .records import read_record

PHOTOS = "--photos"
FOLDER = "DIR"
"""What stands in a command for a folder that the user names."""
PROCESS = (sys.executable, "-m", "tso_cli", "lab")


@dataclass(frozen=True)
class Kept:
    """A record, and the ``command`` that makes it, without -o.

    alone : it measures seconds of this machine, so nothing may run beside it.
    """

    name: str
    command: str
    alone: bool = False


KEPT = (
    Kept("photos", f"temple_ring.py {PHOTOS} DIR"),
    Kept("network", "tso lab network --meshes DIR"),
    Kept("sigma", "tso lab sigma --meshes DIR"),
    Kept("confidence", "tso lab confidence --meshes DIR --unseen DIR"),
    Kept("pose", "tso lab pose --meshes DIR --part test"),
    Kept("determined", "tso lab determined --meshes DIR --limit 10"),
    Kept(
        "accuracy-ablation",
        "tso lab accuracy --meshes DIR --views 1 --unseen DIR --ablation",
    ),
    Kept("evidence", "tso lab evidence --meshes DIR --views 1"),
    Kept("harm", "tso lab harm --meshes DIR --unseen DIR --per 9 --variants"),
    Kept("moves", "tso lab moves --meshes DIR --limit 6"),
    Kept("affinity", "tso lab affinity --meshes DIR"),
    Kept("lambda", "tso lab lambda --meshes DIR"),
    Kept("tso", "tso lab tso --meshes DIR"),
    Kept(
        "accuracy",
        "tso lab accuracy --meshes DIR --views 1 --unseen DIR --pictures accuracy.pictures.png",
    ),
    Kept("prior", "tso lab prior --meshes DIR --unseen DIR"),
    *(
        Kept(
            name,
            f"tso lab {name} --meshes DIR{more} --steps 5000 --batch-size 16 --limit 1000 "
            "--device cuda",
        )
        for name, more in (
            ("supervision", ""),
            ("views", " --category airplane --category car --category chair"),
            ("failures", ""),
        )
    ),
    Kept("scale", "tso lab scale --items 600 --kills 10", alone=True),
    Kept("speed", "tso lab speed", alone=True),
    Kept("pareto", "tso lab pareto --meshes DIR --limit 6", alone=True),
)
"""All records, the cheap ones first; then those that are measured alone."""


@dataclass(frozen=True)
class Due:
    """A record that is to be made, and why; ``resumed``: it goes on from its cases."""

    kept: Kept
    why: str
    resumed: bool = False


def all_due(folder: Path, names: Sequence[str] = ()) -> list[Due]:
    """The records that are due in ``folder``, of ``names`` or of all.

    Raises InputError where a name is of no record, or a file is damaged.
    """
    known = [kept.name for kept in KEPT]
    for name in names:
        if name not in known:
            raise InputError(f"{name!r} is no record, expected some of {', '.join(known)}")
    asked = (kept for kept in KEPT if not names or kept.name in names)
    return [due for kept in asked if (due := _due(kept, folder)) is not None]


def _due(kept: Kept, folder: Path) -> Due | None:
    from ..studies.fingerprint import differences

    path = folder / f"{kept.name}.json"
    if not path.exists():
        return Due(kept, "it is missing")
    record = read_record(path)
    # The record of the photos keeps no command.
    if record.get("command", kept.command) != kept.command:
        return Due(kept, "it was made with other settings")
    with undamaged(f"{path}: the record"):
        changes = differences(record)
    if changes:
        return Due(kept, f"the method has changed: {changes[0]}")
    if not record.get("complete", True):
        return Due(kept, "it is not complete", resumed=True)
    return None


def needs(due: Sequence[Due], given: Mapping[str, Path | None]) -> None:
    """Raise InputError where commands need folders that are not ``given`` (option -> folder)."""
    for option, value in given.items():
        asking = [one.kept.name for one in due if option in one.kept.command.split()]
        if asking and value is None:
            expected = "expected a folder (or the names of other records)"
            raise InputError(f"{option} is missing, for {', '.join(asking)}: {expected}")


def make(
    due: Sequence[Due], folder: Path, given: Mapping[str, Path | None], processes: int
) -> list[str]:
    """Make the records, ``processes`` at a time; returns the names of those that failed.

    One process takes the dearest that is left, the others the cheapest: so the first records are
    there soon, and the longest does not end alone.
    """
    waiting = deque(one for one in due if not one.kept.alone)
    running, failed = set[subprocess.Popen[str]](), list[str]()

    def made(one: Due) -> None:
        begun, name = time.monotonic(), one.kept.name
        options.log(f"tso: {name}: {'goes on' if one.resumed else 'begins'}, {one.why}")
        with tempfile.TemporaryDirectory() as scratch:
            for words in commands(one, folder, given, Path(scratch)):
                pipes: Any = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE}
                environment = _environment(one.kept.alone)
                process = subprocess.Popen(words, env=environment, text=True, **pipes)
                running.add(process)
                said = process.communicate()[1]
                running.discard(process)
                if process.returncode:
                    failed.append(name)
                    last = (said.strip().splitlines() or ["nothing"])[-1]
                    options.log(f"tso: {name}: ended with {process.returncode}, saying {last!r}")
                    return
        options.log(f"tso: {name}: made in {(time.monotonic() - begun) / 60.0:.1f} min")

    def work(dearest: bool) -> None:
        # Another thread may take the last one at any moment.
        with suppress(IndexError):
            while True:
                one = waiting.pop() if dearest else waiting.popleft()
                made(one)

    with ThreadPoolExecutor(processes) as pool:
        try:
            list(pool.map(work, (number == 1 for number in range(processes))))
            for one in due:
                if one.kept.alone:
                    made(one)
        except BaseException:
            waiting.clear()
            for process in list(running):
                process.terminate()
            raise
    return failed


def commands(
    one: Due, folder: Path, given: Mapping[str, Path | None], scratch: Path
) -> list[list[str]]:
    """What to run, one after the other; ``scratch`` is an empty folder."""
    kept, record = one.kept, folder / f"{one.kept.name}.json"
    if PHOTOS in kept.command:
        script = [sys.executable, str(examples_folder() / "temple_ring.py")]
        return [
            [*script, "prepare", str(given[PHOTOS]), str(scratch)],
            [*script, "compare", str(scratch), "-o", str(record)],
        ]
    words, option = list[str](), ""
    for word in shlex.split(kept.command.removeprefix("tso lab ")):
        if word == FOLDER:
            words.append(str(given[option]))
        else:
            words.append(str(folder / word) if word.endswith(".png") else word)
        option = word
    how = "--resume" if one.resumed else "--overwrite"
    return [[*PROCESS, *words, "-o", str(record), how]]


def _environment(alone: bool) -> dict[str, str]:
    """One core for a process that others run beside, else all."""
    environment = os.environ | {"PYTHONPATH": str(PACKAGE.parent)}
    environment.pop("OMP_NUM_THREADS", None)
    return environment if alone else environment | {"OMP_NUM_THREADS": "1"}
