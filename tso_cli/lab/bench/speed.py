"""`tso bench speed`: all measurements, and the targets that they meet."""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from importlib import import_module
from importlib.metadata import PackageNotFoundError, distribution, version
from itertools import product
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from ...refinement.api import compile_loops
from ...version import __version__
from ..study import SEED, Cases, Option, Plan, Progress, Record, Study, claim
from . import PARTS
from .shown import draw, tables
from .timing import Setting

CONVENTION = {
    "seconds": "wall clock; median and quartiles (low, high) of the runs, contestants of a part by turns in one process; one "
    "thread where nothing else is said",
    "command": "whole processes; a first run finds no byte code of tso and no compiled loops",
    "large": "whole processes, steady; a scan of points with a mask of 4000x3000, Gaussian splats, a mesh of so many faces",
    "object": "`refine` in process, one chair, masks of 256x256; after the first call; threads: in the form that tso chooses",
    "phases": "of the default, in a process of its own: the median of later calls, the first call, and the peak of its memory; "
    "compiled as in a batch",
    "of these": "in one more call: comparing silhouettes under assumptions, the search of the mirror plane, building fields, "
    "their factors, solving with these, mask losses with their projection",
    "batch": "seconds of a call over the objects in it",
    "busy neighbour": "for each core a process that spins",
    "silhouette": "from projected points to the gradient by them of sums and cross-entropy, one picture, sigma^2 0.4 px^2; tso "
    "in numpy float64, else float32; the scatter lacks the term for mask pixels that no window reaches",
    "chamfer": "one step, value and gradient, mean of those after 10, 30 and 50 steps of the preset paper",
}
PROCESSORS = Path("/proc/cpuinfo")
LARGE = {
    "scan": "a scan of {:,} points and a mask of 4000x3000",
    "splats": "{:,} splats",
    "mesh": "a mesh of {:,} faces",
}
# Rows that differ in no other way than cores and neighbour are of the same work.
WORK = ("preset", "points", "views", "form", "batch")


def plan(progress: Progress, *, parts: tuple[str, ...], seed: int) -> Plan:
    """Measure the parts, on one thread where nothing else is said.

    Every case holds "what", "name", "points", "side", "runs", and "seconds" ("median", "low", "high"; None where it was left
    out, which "left_out" explains), with a ratio to the first contestant: "over_import_torch" or "over_tso".
    """
    compile_loops()
    setting = Setting(seed=seed, report=progress.report)

    @threadpool_limits.wrap(limits=1)
    def measure(name: str) -> Cases:
        measure_part = getattr(import_module(f".{PARTS[name]}", __package__), f"measure_{name}")
        return measure_part(setting)

    packages = {package: _version(package) for package in ("torch", "numpy", "numba", "scipy")}
    settings = {
        "parts": list(parts),
        "machine": machine(),
        "installed_MB": {
            "in all": installed("tso-cli"),
            "without torch": installed("tso-cli", leave_out="torch"),
        },
        "versions": {"tso": __version__, "python": platform.python_version(), **packages},
        "seed": seed,
    }
    return Plan(settings, [({"what": name}, partial(measure, name)) for name in parts], "measuring")


def machine() -> dict[str, Any]:
    """Where times are taken."""
    return {"cpu": _processor(), "cores": os.cpu_count(), "platform": platform.platform(terse=True)}


def installed(package: str, leave_out: str = "") -> int:
    """Megabytes of a package and all that it requires, without extras, and without what only ``leave_out`` requires."""
    names, size, waiting = {leave_out}, 0, [package]
    while waiting:
        if (name := waiting.pop().lower().replace("_", "-")) in names:
            continue
        names.add(name)
        with suppress(PackageNotFoundError):
            of_package = distribution(name)
            size += sum(
                path.stat().st_size
                for file in of_package.files or []
                if (path := Path(str(file.locate()))).exists()
            )
            required = [text for text in of_package.requires or [] if "extra ==" not in text]
            waiting += [re.split(r"[^\w.-]", text, maxsplit=1)[0] for text in required]
    return round(size / 1e6)


def _processor() -> str:
    lines = PROCESSORS.read_text().splitlines() if PROCESSORS.exists() else []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(names, platform.processor() or platform.machine())


def _version(package: str) -> str | None:
    with suppress(PackageNotFoundError):
        return version(package)
    return None


def conclude(cases: Cases) -> Record:
    """A claim for every target that the cases allow to judge."""
    measured = [row | {"median": row["seconds"]["median"]} for row in cases if row["seconds"]]

    def chosen(what: str, **fields: Any) -> list[Record]:
        return [row for row in measured if row["what"] == what and fields.items() <= row.items()]

    return {"claims": [claim(*judged) for judged in _judged(chosen)]}


def _judged(chosen: Callable[..., Cases]) -> Iterator[tuple[str, bool, str]]:
    """(target, whether it is met, what was measured)."""
    seconds = {row["name"]: row["median"] for row in chosen("command")}
    for name in ("tso --version", "tso --help"):
        if name in seconds:
            more = seconds[name] - seconds["python"]
            yield f"{name}: at most 0.15 s more than bare Python", more <= 0.15, f"{more:.2f} s"
    for row in chosen("command", call="steady", points=1024):
        ratio = row["over_import_torch"]
        yield (
            "tso refine of 1,024 points: at most 0.35 of `import torch`",
            ratio <= 0.35,
            f"{ratio:.2f}",
        )
    for first in chosen("command", call="first"):
        (steady,) = chosen("command", call="steady", points=first["points"])
        ratio = first["median"] / steady["median"]
        yield (
            f"tso refine of {first['points']:,} points: the first run under twice any other",
            ratio < 2.0,
            f"{ratio:.2f}x",
        )

    for name, file in LARGE.items():
        for row in chosen("large", name=name):
            title, most = file.format(row["points"]), 20.0 if name == "scan" else 4.0
            yield f"{title}: under {most:g} s", row["median"] < most, f"{row['median']:.1f} s"
            if row["peak_MiB"]:
                yield (
                    f"{title}: under 1,536 MiB",
                    row["peak_MiB"] < 1536,
                    f"{row['peak_MiB']:,} MiB",
                )

    for (points, most), form in product(((1024, 0.15), (16384, 0.25)), ("", "compiled")):
        for row in chosen(
            "object", points=points, preset="best", views=1, form=form, threads=1, busy=False
        ):
            way, ratio = f", {form}" if form else "", row["over_import_torch"]
            yield (
                f"one object of {points:,} points{way}: at most {most} of `import torch`",
                ratio <= most,
                f"{ratio:.2f}",
            )

    most_processes = max((row.get("processes", 1) for row in chosen("batch")), default=1)
    for row in chosen(
        "batch", preset="best", points=1024, batch=64, processes=most_processes, busy=False
    ):
        ratio = row["over_import_torch"]
        yield (
            "an object in a batch of 64: at most 0.04 of `import torch`",
            ratio <= 0.04,
            f"{ratio:.3f}",
        )
    for what, cores, busy, most, target in (
        ("object", "threads", False, 1.1, "one object on all cores takes at most 1.1x one core"),
        (
            "object",
            "threads",
            True,
            1.5,
            "beside a busy neighbour one object on all cores takes at most 1.5x one thread",
        ),
        ("batch", "processes", False, 1.0, "a batch is never slower on all cores than on one"),
        (
            "batch",
            "processes",
            True,
            1.5,
            "beside a busy neighbour a batch on all cores takes at most 1.5x one process",
        ),
    ):
        taken = [
            (tuple(map(row.get, WORK)), row[cores], row["median"])
            for row in chosen(what, busy=busy)
        ]
        on_one = {work: median for work, count, median in taken if count == 1}
        if ratios := [median / on_one[work] for work, count, median in taken if count > 1]:
            yield target, max(ratios) <= most, f"{max(ratios):.2f}x at worst"

    for what, points, peer, factor in (
        ("silhouette", 1024, "scatter 9x9", 4.0),
        ("silhouette", 16384, "scatter 9x9", 4.0),
        ("chamfer", 16384, "two k-d trees a step", 5.0),
    ):
        rows = chosen(what, points=points)
        ours, theirs = (
            [row["median"] for row in rows if row["name"].startswith(name)]
            for name in ("tso", peer)
        )
        if ours and theirs:
            ratio = min(theirs) / min(ours)
            yield (
                f"{what} of {points:,} points: at least {factor:g}x faster than {peer}",
                ratio >= factor,
                f"{ratio:.1f}x",
            )


STUDY = Study(
    name="speed",
    about="command: whole processes; large: of large files; object: `refine` with one to four views, and on all cores; phases: "
    "what it consists of; batch: many objects in one call, on one core and on all; silhouette, chamfer: the kernels at growing "
    "sizes. Contestants for the same work take turns on the CPU; all of it takes some ten minutes.",
    parts=("points, paper", "points, best"),
    tables=tables,
    draw=draw,
    reading="Contestants for the same work take turns in one process. Trust ratios before times: two runs on a shared machine "
    "differ by up to half.",
    convention=CONVENTION,
    options=(
        Option(
            "--only",
            "May be repeated.",
            str,
            tuple(PARTS),
            tuple(PARTS),
            multiple=True,
            name="parts",
        ),
        SEED,
    ),
    plan=plan,
    conclude=conclude,
)
