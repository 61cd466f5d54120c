"""Which records are due, and how they are made again: each by its own process, some at a time."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
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
Folders = Mapping[str, Path | None]
"""An option such as --meshes -> the folder that stands for DIR in a command."""


@dataclass(frozen=True)
class Kept:
    """A record, and the ``command`` that makes it, without -o.

    alone : it measures seconds of this machine, so nothing may run beside it.
    """

    name: str
    command: str
    alone: bool = False


ACCURACY = "tso lab accuracy --meshes DIR --views 1 --unseen DIR"
TRAINED = "--steps 5000 --batch-size 16 --limit 1000 --device cuda"
KEPT = (
    Kept("photos", f"temple_ring.py {PHOTOS} DIR"),
    Kept("network", "tso lab network --meshes DIR"),
    Kept("sigma", "tso lab sigma --meshes DIR"),
    Kept("confidence", "tso lab confidence --meshes DIR --unseen DIR"),
    Kept("pose", "tso lab pose --meshes DIR --part test"),
    Kept("determined", "tso lab determined --meshes DIR --limit 10"),
    Kept("accuracy-ablation", f"{ACCURACY} --ablation"),
    Kept("evidence", "tso lab evidence --meshes DIR --views 1"),
    Kept("harm", "tso lab harm --meshes DIR --unseen DIR --per 9 --variants"),
    Kept("moves", "tso lab moves --meshes DIR --limit 6"),
    Kept("affinity", "tso lab affinity --meshes DIR"),
    Kept("lambda", "tso lab lambda --meshes DIR"),
    Kept("tso", "tso lab tso --meshes DIR"),
    Kept("accuracy", f"{ACCURACY} --pictures accuracy.pictures.png"),
    Kept("prior", "tso lab prior --meshes DIR --unseen DIR"),
    Kept("supervision", f"tso lab supervision --meshes DIR {TRAINED}"),
    Kept(
        "views",
        "tso lab views --meshes DIR --category airplane --category car --category chair " + TRAINED,
    ),
    Kept("failures", f"tso lab failures --meshes DIR {TRAINED}"),
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
    of_name = {kept.name: kept for kept in KEPT}
    for name in names:
        if name not in of_name:
            raise InputError(f"{name!r} is no record, expected some of {', '.join(of_name)}")
    reasons = (_due(kept, folder) for kept in KEPT if not names or kept.name in names)
    return [due for due in reasons if due is not None]


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


def needs(due: Sequence[Due], folders: Folders) -> None:
    """Raise InputError where commands need folders that are not there."""
    for option, folder in folders.items():
        names = [record.kept.name for record in due if option in record.kept.command.split()]
        if names and folder is None:
            expected = "expected a folder (or the names of other records)"
            raise InputError(f"{option} is missing, for {', '.join(names)}: {expected}")


def make(due: Sequence[Due], folder: Path, folders: Folders, processes: int) -> list[str]:
    """Make the records, ``processes`` at a time; returns the names of those that failed.

    One process takes the dearest that is left, the others the cheapest: so the first records are
    there soon, and the longest does not end alone.
    """
    waiting = deque(record for record in due if not record.kept.alone)
    running, failed = set[subprocess.Popen[str]](), list[str]()

    def make_one(record: Due) -> None:
        begun, name = time.monotonic(), record.kept.name
        options.log(f"tso: {name}: {'goes on' if record.resumed else 'begins'}, {record.why}")
        environment = os.environ | {"PYTHONPATH": str(PACKAGE.parent), "OMP_NUM_THREADS": "1"}
        if record.kept.alone:
            environment.pop("OMP_NUM_THREADS")
        pipes: Any = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
        with tempfile.TemporaryDirectory() as scratch:
            for words in commands(record, folder, folders, Path(scratch)):
                process = subprocess.Popen(words, env=environment, **pipes)
                running.add(process)
                said = process.communicate()[1]
                running.discard(process)
                if process.returncode:
                    failed.append(name)
                    last = (said.strip().splitlines() or ["nothing"])[-1]
                    options.log(f"tso: {name}: ended with {process.returncode}, saying {last!r}")
                    return
        options.log(f"tso: {name}: made in {(time.monotonic() - begun) / 60.0:.1f} min")

    def work(take: Callable[[], Due]) -> None:
        # Another thread may take the last one at any moment.
        with suppress(IndexError):
            while True:
                make_one(take())

    with ThreadPoolExecutor(processes) as pool:
        try:
            list(pool.map(work, [waiting.pop, *[waiting.popleft] * (processes - 1)]))
            for record in due:
                if record.kept.alone:
                    make_one(record)
        except BaseException:
            waiting.clear()
            for process in list(running):
                process.terminate()
            raise
    return failed


def commands(record: Due, folder: Path, folders: Folders, scratch: Path) -> list[list[str]]:
    """What to run, one after the other; ``scratch`` is an empty folder."""
    command, output = record.kept.command, str(folder / f"{record.kept.name}.json")
    if PHOTOS in command:
        script = [sys.executable, str(examples_folder() / "temple_ring.py")]
        prepare = [*script, "prepare", str(folders[PHOTOS]), str(scratch)]
        return [prepare, [*script, "compare", str(scratch), "-o", output]]
    words, option = [sys.executable, "-m", "tso_cli", "lab"], ""
    for word in shlex.split(command.removeprefix("tso lab ")):
        if word == "DIR":
            words.append(str(folders[option]))
        else:
            words.append(str(folder / word) if word.endswith(".png") else word)
        option = word
    return [[*words, "-o", output, "--resume" if record.resumed else "--overwrite"]]
