"""`tso lab speed`: what is measured, and the targets that the figures meet."""

from __future__ import annotations

import os
import platform
import re
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from importlib.metadata import PackageNotFoundError, distribution, version
from pathlib import Path
from typing import Any

from threadpoolctl import threadpool_limits

from tso_cli.version import __version__

from .. import options
from ..charts import Rows, bars, digits
from ..options import option
from ..study import Cases, Plan, Progress, Record, Study, Table, claim, crossed
from . import contestants
from .timing import Setting

OVER_TORCH, OVER_TSO = "over_import_torch", "over_tso"
# What is measured -> its contestants, and what their times are divided by: those of the first.
PARTS: dict[str, tuple[Callable[[int], contestants.Races], str]] = {
    "command": (contestants.commands, OVER_TORCH),
    "object": (contestants.objects, OVER_TORCH),
    "batch": (contestants.batches, OVER_TORCH),
    "large": (contestants.large_files, OVER_TORCH),
    "silhouette": (contestants.silhouettes, OVER_TSO),
    "chamfer": (contestants.chamfers, OVER_TSO),
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
PANELS = {
    "object": "one object, in process",
    "silhouette": "silhouette and cross-entropy, value and gradient",
    "chamfer": "Chamfer to the start, a step, value and gradient",
}
LARGE = {
    "scan": ("a scan of {:,} points and a mask of 4000x3000", 20.0),
    "splats": ("{:,} splats", 4.0),
    "mesh": ("a mesh of {:,} faces", 4.0),
}
"""Name of a large file -> what it is, and its target in seconds."""
NETWORK = ("torch",)  # what the extra of this name installs
MOST_MIB = 1536
"""Target for the memory of large files."""
ALONE = {"preset": "best", "views": 1, "threads": 1, "busy": False}
BATCH = {"preset": "best", "points": 1024, "batch": 64, "busy": False}
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
    versions: Record = {"tso": __version__, "python": platform.python_version()}
    for name in ("torch", "numpy", "scipy"):
        versions[name] = None
        with suppress(PackageNotFoundError):
            versions[name] = version(name)
    sizes = {"without extras": installed("tso-cli")}
    sizes |= {"with the extra network": installed("tso-cli", *NETWORK)}
    settings: Record = {"parts": list(parts), "machine": machine(), "installed_MB": sizes}
    settings |= {"versions": versions, "seed": seed}
    jobs = [({"what": name}, partial(measure, name, setting)) for name in parts]
    return Plan(settings, jobs, "measuring")


@threadpool_limits.wrap(limits=1)
def measure(name: str, setting: Setting) -> Cases:
    races, ratio = PARTS[name]
    return [row for race in races(setting.seed) for row in setting.race(name, race, ratio)]


def machine() -> dict[str, Any]:
    """Where times are taken."""
    processors = Path("/proc/cpuinfo")
    lines = processors.read_text().splitlines() if processors.exists() else []
    names = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    cpu = next(names, platform.processor() or platform.machine())
    return {"cpu": cpu, "cores": os.cpu_count(), "platform": platform.platform(terse=True)}


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


def conclude(cases: Cases) -> Record:
    """A claim for every target that the cases can decide."""
    measured = [row | {"median": row["seconds"]["median"]} for row in cases if row["seconds"]]

    def of(what: str, **fields: Any) -> Cases:
        return [row for row in measured if row["what"] == what and fields.items() <= row.items()]

    return {"claims": [claim(*found) for found in _claims(of)]}


def _claims(of: Callable[..., Cases]) -> Iterator[tuple[str, bool, str]]:
    """Target, whether it is met, what was measured."""

    def under_torch(text: str, most: float, rows: Cases, decimals: int = 2) -> Iterator[Any]:
        for row in rows:
            ratio = row[OVER_TORCH]
            target = f"{text}: at most {most} of `import torch`"
            yield target, ratio <= most, f"{ratio:.{decimals}f}"

    seconds = {row["name"]: row["median"] for row in of("command")}
    for name in ("tso --version", "tso --help"):
        if name in seconds:
            more = seconds[name] - seconds["python"]
            yield f"{name}: at most 0.15 s more than bare Python", more <= 0.15, f"{more:.2f} s"
    yield from under_torch(
        "tso refine of 1,024 points", 0.35, of("command", call="steady", points=1024)
    )
    for first in of("command", call="first"):
        (steady,) = of("command", call="steady", points=first["points"])
        text, ratio = (
            f"tso refine of {first['points']:,} points",
            first["median"] / steady["median"],
        )
        yield f"{text}: the first run under twice any other", ratio < 2.0, f"{ratio:.2f}x"
    for name, (file, most) in LARGE.items():
        for row in of("large", name=name):
            title = file.format(row["points"])
            yield f"{title}: under {most:g} s", row["median"] < most, f"{row['median']:.1f} s"
            if peak := row["peak_MiB"]:
                yield f"{title}: under {MOST_MIB:,} MiB", peak < MOST_MIB, f"{peak:,} MiB"
    for points, most in ((1024, 0.15), (16384, 0.25)):
        rows = of("object", points=points, **ALONE)
        yield from under_torch(f"one object of {points:,} points", most, rows)
    cores = max((row.get("processes", 1) for row in of("batch")), default=1)
    rows = of("batch", processes=cores, **BATCH)
    yield from under_torch("an object in a batch of 64", 0.04, rows, 3)
    for (what, busy), (target, most) in ON_CORES.items():
        count = {"object": "threads", "batch": "processes"}[what]
        on_one, on_all = dict[tuple, float](), dict[tuple, float]()
        for row in of(what, busy=busy):
            # Rows that differ only in cores and neighbour are of the same work.
            work = tuple(map(row.get, ("preset", "points", "views", "batch")))
            (on_one if row[count] == 1 else on_all)[work] = row["median"]
        if on_all:
            worst = max(median / on_one[work] for work, median in on_all.items())
            yield target, worst <= most, f"{worst:.2f}x at worst"
    for what, points, peer, factor in KERNELS:
        ours, theirs = (
            [r["median"] for r in of(what, points=points) if r["name"].startswith(name)]
            for name in ("tso", peer)
        )
        if ours and theirs:
            ratio = min(theirs) / min(ours)
            text = f"{what} of {points:,} points: at least {factor:g}x faster than {peer}"
            yield text, ratio >= factor, f"{ratio:.1f}x"


def machine_line(record: Record) -> str:
    """Where and with what the record was made."""
    settings, machine = record["settings"], record["settings"]["machine"]
    packages = settings["versions"].items()
    versions = ", ".join(f"{name} {version}" for name, version in packages if version)
    sizes = ", ".join(f"{size:,} MB {what}" for what, size in settings["installed_MB"].items())
    measured = f"seed {settings['seed']}, {record['seconds']:.0f} s"
    return f"{machine['cpu']}, {machine['cores']} cores; {versions}; installed: {sizes}; {measured}"


def tables(record: Record) -> list[Table]:
    """A table of each part that was measured; the last says where the record was made."""

    def of(what: str, key: str = "what") -> Cases:
        return [r for r in record["cases"] if r["what"] == what and r["seconds"] and r.get(key)]

    def pivot(title: str, rows: Cases, ratio: str) -> Table:
        """Milliseconds and ratio of a name, by size."""
        cells: dict[str, dict[str, str]] = {}
        for r in rows:
            cells.setdefault(r["name"], {})[_size(r)] = f"{_ms(r)} ({digits(r[ratio])}x)"
        return crossed(cells, title=title)

    commands = [
        [r["name"], *(f"{r['seconds'][key]:.2f}" for key in ("median", "low", "high"))]
        + [f"{r[OVER_TORCH]:.2f}"]
        for r in of("command")
    ]
    large = [
        [r["name"], r["points"], f"{r['seconds']['median']:.2f}", f"{r[OVER_TORCH]:.1f}"]
        + [r["peak_MiB"]]
        for r in of("large", "points")
    ]
    large_header = ["", "points or faces", "s", "x `import torch`", "peak, MiB"]
    batches: dict[str, dict[str, str]] = {}
    for r in of("batch", "preset"):
        row = batches.setdefault(f"{r['preset']}, {_size(r)}: {r['name']}", {})
        row[f"processes: {r['processes']}"] = f"{_ms(r)} ({r[OVER_TORCH]:.3f}x)"
    losses = "{}, value and gradient: ms (x tso's)"
    measured = [
        Table(["", "median", "low", "high", "x `import torch`"], commands, "whole processes: s"),
        Table(large_header, large, "large files, whole processes"),
        pivot("one object: ms (x `import torch`)", of("object", "preset"), OVER_TORCH),
        crossed(batches, title="many objects: ms each (x `import torch`)"),
        pivot(losses.format("silhouette"), of("silhouette"), OVER_TSO),
        pivot(losses.format("Chamfer to the start"), of("chamfer"), OVER_TSO),
        Table(["measured on"], [[machine_line(record)]]),
    ]
    return [table for table in measured if table.rows]


def _size(row: Record) -> str:
    side, views = row["side"], row.get("views", 1)
    return f"{row['points']:,}{f'@{side}' if side else ''}{f', {views} views' * (views > 1)}"


def _ms(row: Record) -> str:
    return digits(1e3 * row["seconds"]["median"])


def panels(record: Record) -> Rows:
    """A panel for each part with growing sizes: median milliseconds."""
    found: dict[str, dict[str, dict[str, float]]] = {}
    for what, title in PANELS.items():
        for row in record["cases"]:
            if row["what"] == what and row["seconds"] and row["points"]:
                of_size = found.setdefault(f"{title}, ms", {}).setdefault(_size(row), {})
                of_size[row["name"]] = 1e3 * row["seconds"]["median"]
    return found


STUDY = Study(
    name="speed",
    about="command: whole processes; large: of large files; object: `refine` with one to four "
    "views, and on all cores; batch: many objects in one call, on one core and on all; silhouette, "
    "chamfer: the losses. Contestants for the same work take turns on the CPU; all of it takes "
    "about ten minutes.",
    parts=("points, paper", "points, best"),
    tables=tables,
    draw=bars(panels, log=True),
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
