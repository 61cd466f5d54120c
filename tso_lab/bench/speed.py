"""`tso lab speed`: what is measured, and the targets that the figures meet."""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from importlib import import_module
from importlib.metadata import PackageNotFoundError, distribution, version
from pathlib import Path
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

from tso_cli.version import __version__

from .. import options
from ..charts import digits, draw_bars
from ..options import option
from ..study import Cases, Plan, Progress, Record, Study, Table, claim, crossed
from .timing import Setting

# What is measured -> the module here whose function `measure_NAME` does it.
PARTS = {
    **dict.fromkeys(("command", "object", "batch", "large"), "refining"),
    **dict.fromkeys(("silhouette", "chamfer"), "kernels"),
}
CONVENTION = {
    "seconds": "wall clock; median and quartiles (low, high) of the runs, contestants of a part by "
    "turns in one process; one thread unless stated",
    "command": "whole processes; a first run finds no byte code of tso",
    "large": "whole processes, steady; a scan of points with a mask of 4000x3000, Gaussian splats, "
    "a mesh with many faces",
    "object": "`refine` in process, one chair, masks of 256x256; after the first call",
    "batch": "seconds of a call over the objects in it",
    "busy neighbour": "for each core a process that spins",
    "silhouette": "from projected points to the gradient by them of sums and cross-entropy, one "
    "picture, sigma^2 0.4 px^2; tso in float64, otherwise float32; the scatter lacks the "
    "term for mask pixels that no window reaches",
    "chamfer": "one step, value and gradient, mean over points after 10, 30 and 50 steps of the "
    "preset paper",
}
Label = Callable[[Record], str]
Value = TypeVar("Value", str, float)
PANELS = {
    "object": "one object, in process",
    "silhouette": "silhouette and cross-entropy, value and gradient",
    "chamfer": "Chamfer to the start, a step, value and gradient",
}
PROCESSORS = Path("/proc/cpuinfo")
LARGE = {
    "scan": ("a scan of {:,} points and a mask of 4000x3000", 20.0),
    "splats": ("{:,} splats", 4.0),
    "mesh": ("a mesh of {:,} faces", 4.0),
}
"""Name of a large file -> what it is, and its target in seconds."""
NETWORK = ("torch",)  # what the extra of this name installs
MOST_MIB = 1536
"""Target for the memory of large files."""
# Targets for one object: points -> time over that of `import torch`.
OBJECTS = {1024: 0.15, 16384: 0.25}
# Rows that differ only in cores and neighbour are of the same work.
WORK = ("preset", "points", "views", "batch")
CORES = {"object": "threads", "batch": "processes"}
# What, and whether with a busy neighbour -> target in words, and its time over that on one core.
ON_CORES = {
    ("object", False): ("one object on all cores takes at most 1.1x one core", 1.1),
    ("object", True): ("one object on all cores, busy neighbour: at most 1.5x one thread", 1.5),
    ("batch", False): ("a batch is never slower on all cores than on one", 1.0),
    ("batch", True): ("a batch on all cores, busy neighbour: at most 1.5x one process", 1.5),
}
KERNELS = (
    ("silhouette", 1024, "scatter 9x9", 4.0),
    ("silhouette", 16384, "scatter 9x9", 4.0),
    ("chamfer", 16384, "two k-d trees a step", 5.0),
)
"""What, points, the other way, and the target for its time over tso's."""


def plan(progress: Progress, *, parts: tuple[str, ...], seed: int) -> Plan:
    """Measure the parts, on one thread unless stated.

    Every case holds "what", "name", "points", "side", "runs" and "seconds" ("median", "low",
    "high"), with a ratio to the first contestant: "over_import_torch" or "over_tso".
    """
    setting = Setting(seed=seed, report=progress.report)
    packages = {name: _version(name) for name in ("torch", "numpy", "scipy")}
    sizes = {
        "without extras": installed("tso-cli"),
        "with the extra network": installed("tso-cli", *NETWORK),
    }
    settings = {
        "parts": list(parts),
        "machine": machine(),
        "installed_MB": sizes,
        "versions": {"tso": __version__, "python": platform.python_version(), **packages},
        "seed": seed,
    }
    jobs = [({"what": name}, partial(measure, name, setting)) for name in parts]
    return Plan(settings, jobs, "measuring")


@threadpool_limits.wrap(limits=1)
def measure(name: str, setting: Setting) -> Cases:
    module = import_module(f".{PARTS[name]}", __package__)
    cases: Cases = getattr(module, f"measure_{name}")(setting)
    return cases


def machine() -> dict[str, Any]:
    """Where times are taken."""
    return {"cpu": _processor(), "cores": os.cpu_count(), "platform": platform.platform(terse=True)}


def installed(*packages: str) -> int:
    """Megabytes of packages and all that they require, without extras."""
    names, size, waiting = set[str](), 0, list(packages)
    while waiting:
        if (name := waiting.pop().lower().replace("_", "-")) in names:
            continue
        names.add(name)
        with suppress(PackageNotFoundError):
            files = distribution(name).files or []
            paths = [Path(str(file.locate())) for file in files]
            size += sum(path.stat().st_size for path in paths if path.exists())
            required = [t for t in distribution(name).requires or [] if "extra ==" not in t]
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
    """A claim for every target that the cases can decide."""
    measured = [row | {"median": row["seconds"]["median"]} for row in cases if row["seconds"]]

    def chosen(what: str, **fields: Any) -> Cases:
        return [row for row in measured if row["what"] == what and fields.items() <= row.items()]

    checks = (_commands, _large_files, _objects, _cores, _kernels)
    return {"claims": [claim(*found) for check in checks for found in check(chosen)]}


Chosen = Callable[..., Cases]
Claims = Iterator[tuple[str, bool, str]]
"""(target, whether it is met, what was measured)."""


def _commands(chosen: Chosen) -> Claims:
    seconds = {row["name"]: row["median"] for row in chosen("command")}
    for name in ("tso --version", "tso --help"):
        if name in seconds:
            more = seconds[name] - seconds["python"]
            yield f"{name}: at most 0.15 s more than bare Python", more <= 0.15, f"{more:.2f} s"
    for row in chosen("command", call="steady", points=1024):
        text, ratio = "tso refine of 1,024 points: at most 0.35 of", row["over_import_torch"]
        yield f"{text} `import torch`", ratio <= 0.35, f"{ratio:.2f}"
    for first in chosen("command", call="first"):
        (steady,) = chosen("command", call="steady", points=first["points"])
        text, ratio = (
            f"tso refine of {first['points']:,} points",
            first["median"] / steady["median"],
        )
        yield f"{text}: the first run under twice any other", ratio < 2.0, f"{ratio:.2f}x"


def _large_files(chosen: Chosen) -> Claims:
    for name, (file, most) in LARGE.items():
        for row in chosen("large", name=name):
            title = file.format(row["points"])
            yield f"{title}: under {most:g} s", row["median"] < most, f"{row['median']:.1f} s"
            if peak := row["peak_MiB"]:
                yield f"{title}: under {MOST_MIB:,} MiB", peak < MOST_MIB, f"{peak:,} MiB"


def _objects(chosen: Chosen) -> Claims:
    alone = {"preset": "best", "views": 1, "threads": 1, "busy": False}
    for points, most in OBJECTS.items():
        for row in chosen("object", points=points, **alone):
            text, ratio = (
                f"one object of {points:,} points: at most {most}",
                row["over_import_torch"],
            )
            yield f"{text} of `import torch`", ratio <= most, f"{ratio:.2f}"
    cores = max((row.get("processes", 1) for row in chosen("batch")), default=1)
    batch = {"preset": "best", "points": 1024, "batch": 64, "processes": cores, "busy": False}
    for row in chosen("batch", **batch):
        ratio, text = row["over_import_torch"], "an object in a batch of 64: at most 0.04 of"
        yield f"{text} `import torch`", ratio <= 0.04, f"{ratio:.3f}"


def _cores(chosen: Chosen) -> Claims:
    for (what, busy), (target, most) in ON_CORES.items():
        rows, cores = chosen(what, busy=busy), CORES[what]
        on_one = {_work(row): row["median"] for row in rows if row[cores] == 1}
        ratios = [row["median"] / on_one[_work(row)] for row in rows if row[cores] > 1]
        if ratios:
            yield target, max(ratios) <= most, f"{max(ratios):.2f}x at worst"


def _work(row: Record) -> tuple[Any, ...]:
    return tuple(map(row.get, WORK))


def _kernels(chosen: Chosen) -> Claims:
    for what, points, peer, factor in KERNELS:
        ours, theirs = (
            [r["median"] for r in chosen(what, points=points) if r["name"].startswith(name)]
            for name in ("tso", peer)
        )
        if ours and theirs:
            ratio = min(theirs) / min(ours)
            text = f"{what} of {points:,} points: at least {factor:g}x faster than {peer}"
            yield text, ratio >= factor, f"{ratio:.1f}x"


def machine_line(record: Record) -> str:
    """Where and with what the record was made."""
    settings, machine = record["settings"], record["settings"]["machine"]
    found = settings["versions"].items()
    versions = ", ".join(f"{name} {version}" for name, version in found if version)
    sizes = ", ".join(f"{size:,} MB {what}" for what, size in settings["installed_MB"].items())
    measured = f"seed {settings['seed']}, {record['seconds']:.0f} s"
    return f"{machine['cpu']}, {machine['cores']} cores; {versions}; installed: {sizes}; {measured}"


def tables(record: Record) -> list[Table]:
    """A table of each part that was measured; the last says where the record was made."""

    def of(what: str, key: str = "what") -> Cases:
        return [r for r in record["cases"] if r["what"] == what and r["seconds"] and r.get(key)]

    commands = [
        [r["name"], *(f"{r['seconds'][key]:.2f}" for key in ("median", "low", "high"))]
        + [f"{r['over_import_torch']:.2f}"]
        for r in of("command")
    ]
    large = [
        [r["name"], r["points"], f"{r['seconds']['median']:.2f}", f"{r['over_import_torch']:.1f}"]
        + [r["peak_MiB"]]
        for r in of("large", "points")
    ]
    large_header = ["", "points or faces", "s", "x `import torch`", "peak, MiB"]
    objects = _pivot(of("object", "preset"), lambda r: _over(r, r["over_import_torch"]))
    batches = _pivot(
        of("batch", "preset"),
        lambda r: f"{_ms(r)} ({r['over_import_torch']:.3f}x)",
        lambda r: f"{r['preset']}, {_size(r)}: {r['name']}",
        lambda r: f"processes: {r['processes']}",
    )
    losses = {"silhouette": "silhouette", "chamfer": "Chamfer to the start"}
    measured = [
        Table(["", "median", "low", "high", "x `import torch`"], commands, "whole processes: s"),
        Table(large_header, large, "large files, whole processes"),
        crossed(objects, title="one object: ms (x `import torch`)"),
        crossed(batches, title="many objects: ms each (x `import torch`)"),
        *(
            crossed(
                _pivot(of(what), lambda r: _over(r, r["over_tso"])),
                title=f"{title}, value and gradient: ms (x tso's)",
            )
            for what, title in losses.items()
        ),
        Table(["measured on"], [[machine_line(record)]]),
    ]
    return [table for table in measured if table.rows]


def _size(record: Record) -> str:
    side, views = record["side"], record.get("views", 1)
    pixels = f"@{side}" if side else ""
    return f"{record['points']:,}{pixels}" + (f", {views} views" if views > 1 else "")


def _ms(record: Record) -> str:
    return digits(1e3 * record["seconds"]["median"])


def _over(record: Record, ratio: float) -> str:
    return f"{_ms(record)} ({digits(ratio)}x)"


def _pivot(
    records: Cases,
    cell: Callable[[Record], Value],
    row: Label = lambda r: str(r["name"]),
    column: Label = _size,
) -> dict[str, dict[str, Value]]:
    """Cells by the labels of row and column, by default a name and a size."""
    cells: dict[str, dict[str, Value]] = {}
    for record in records:
        cells.setdefault(row(record), {})[column(record)] = cell(record)
    return cells


def draw(path: Path, record: Record, overwrite: bool = False) -> None:
    """A panel for each part with growing sizes: median milliseconds."""
    measured = [r for r in record["cases"] if r["seconds"] and r["points"]]
    panels = {
        f"{title}, ms": _pivot(
            [r for r in measured if r["what"] == what],
            lambda r: 1e3 * r["seconds"]["median"],
            _size,
            lambda r: str(r["name"]),
        )
        for what, title in PANELS.items()
    }
    draw_bars(path, {title: rows for title, rows in panels.items() if rows}, overwrite, log=True)


STUDY = Study(
    name="speed",
    about="command: whole processes; large: of large files; object: `refine` with one to four "
    "views, and on all cores; batch: many objects in one call, on one core and on all; silhouette, "
    "chamfer: the losses. Contestants for the same work take turns on the CPU; all of it takes "
    "about ten minutes.",
    parts=("points, paper", "points, best"),
    tables=tables,
    draw=draw,
    reading="Contestants for the same work take turns in one process. Trust ratios before times: "
    "two runs on a shared machine differ by up to half.",
    convention=CONVENTION,
    options=(
        option(
            "--only",
            "May be repeated.",
            str,
            (*PARTS,),
            choices=(*PARTS,),
            multiple=True,
            name="parts",
        ),
        options.SEED,
    ),
    plan=plan,
    conclude=conclude,
)
