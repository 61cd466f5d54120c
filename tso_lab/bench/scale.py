"""`tso lab scale`: the pace of batches, and what is left of a batch that is killed many times."""

from __future__ import annotations

import os
import platform
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from threading import Event
from typing import Any

import numpy as np

from tso_cli.batch.engines import Engine
from tso_cli.batch.journal import ENDS, NAME, entries, open_journal
from tso_cli.batch.run import Outcome, Task, run, tasks_of
from tso_cli.geometry.points import longest_side
from tso_cli.io.clouds import read_cloud, write_cloud
from tso_cli.io.shipped import CATEGORIES, examples_folder
from tso_cli.refinement import refine_batch
from tso_cli.scene.load import load_points_scene
from tso_cli.version import __version__
from tso_cli.workers import WorkerPool

from .. import options
from ..charts import Rows, bars
from ..options import option
from ..study import Cases, Plan, Progress, Record, Study, Table, claim
from .timing import machine

CLOUDS = 300  # different bent clouds; items beyond use them again
BEND = 0.06  # of a cloud's longest side
BROKEN_EVERY = 500
BETWEEN_KILLS = (0.3, 10.0)  # seconds
POISON = "poison.ply"
PART = 10  # pace and memory are of tenths of the items
NOTHING = "items that take no time"
ROWS = 100_000  # of a manifest that is only read
READ = """
import sys, time
from pathlib import Path
from tso_cli.batch.manifest import folder_of, read_manifest
from tso_cli.commands.batch.items import options_of_items
memory = lambda: int(open("/proc/self/statm").read().split()[1])
manifest, before, begun = Path(sys.argv[1]), memory(), time.perf_counter()
items = options_of_items(read_manifest(manifest), folder_of(manifest), Path("out"), False)
print(time.perf_counter() - begun, memory() - before)
"""
PLUGIN = {
    "poison-1.dist-info/METADATA": "Metadata-Version: 2.1\nName: poison\nVersion: 1\n",
    "poison-1.dist-info/entry_points.txt": "[tso.clouds]\npoison = poison:read\n",
    "poison.py": "import os\ndef read(data, path):\n    os.kill(os.getpid(), 9)\n",
}


def plan(
    progress: Progress, *, items: int, kills: int, engines: tuple[str, ...], seed: int
) -> Plan:
    """Compare the pace of ways; run a long batch of each engine, and kill it."""
    versions = {"tso": __version__, "python": platform.python_version()}
    settings = {"items": items, "kills": kills, "engines": list(engines), "seed": seed}
    jobs: list[Any] = [({"what": "pace"}, partial(_paces, seed))]
    jobs += [({"what": "manifest"}, partial(_manifest, seed))]
    for engine in engines:
        make = partial(long_batch, items, kills, engine, seed, progress)
        jobs.append(({"what": "long", "engine": engine}, make))
    return Plan({**settings, "machine": machine(), "versions": versions}, jobs, "measuring")


@contextmanager
def _folder(items: int, seed: int, poison: bool = False) -> Iterator[Path]:
    """A folder with a manifest of bent clouds; with ``poison`` broken ones and a poison too."""
    rng = np.random.default_rng(seed)
    with tempfile.TemporaryDirectory(prefix="tso-scale-") as name:
        folder = Path(name)
        for number in range(min(CLOUDS, items)):
            category = CATEGORIES[number % len(CATEGORIES)]
            cloud = read_cloud(examples_folder() / category / "initial.ply")
            points = cloud.points
            waves = rng.normal(size=(3, 3)) * np.pi / longest_side(points)
            bent = points + BEND * longest_side(points) * rng.uniform() * np.sin(points @ waves)
            write_cloud(folder / f"{category}-{number}.ply", bent, like=cloud)
        clouds = sorted(folder.glob("*.ply"))
        rows = ["cloud,mask,camera,output"]
        for number in range(items):
            cloud_file = clouds[number % len(clouds)]
            example = examples_folder() / cloud_file.name.partition("-")[0]
            broken = poison and number % BROKEN_EVERY == BROKEN_EVERY // 2
            source = "broken.ply" if broken else cloud_file.name
            rows.append(f"{source},{example / 'mask.png'},{example / 'camera.json'},{number}.ply")
        if poison:
            (folder / "broken.ply").write_bytes(clouds[0].read_bytes()[:-40])
            (folder / "it.poison").write_text("x")
            poisoned = f"it.poison,{rows[1].split(',', 1)[1]}".replace("0.ply", POISON)
            rows.insert(1 + items // 3, poisoned)
            write_poison(folder / "plugin")
        (folder / "items.csv").write_text("\n".join(rows) + "\n")
        yield folder


def write_poison(folder: Path) -> None:
    """Write a package for Python's path, whose reader of .poison kills the process that reads."""
    for place, text in PLUGIN.items():
        (folder / place).parent.mkdir(parents=True, exist_ok=True)
        (folder / place).write_text(text)


def _python(folder: Path) -> dict[str, Any]:
    """How a process of Python is started in the folder, with its plugin."""
    package = Path(__file__).resolve().parents[2]
    path = os.pathsep.join([str(folder / "plugin"), str(package)])
    return {"cwd": folder, "env": os.environ | {"PYTHONPATH": path}, "stderr": subprocess.DEVNULL}


def _tso(folder: Path, *words: str) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "tso_cli", *words, "-q"]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, **_python(folder))


def _paces(seed: int) -> Cases:
    """Items a second of each way; each way is measured twice, by turns, and the faster counts."""
    # Processes take a second to start, so that batches have more items.
    ways = {
        "shell loop": (60, _shell_loop),
        "refine_batch": (300, _in_python),
        "tso batch": (300, lambda folder: _tso(folder, "batch", "items.csv", "-o", "out").wait()),
        NOTHING: (5000, _nothing_to_do),
    }
    best = dict.fromkeys(ways, 0.0)
    for _ in range(2):
        for name, (items, way) in ways.items():
            with _folder(items, seed) as folder:
                begun = time.perf_counter()
                way(folder)
                best[name] = max(best[name], items / (time.perf_counter() - begun))
    return [
        {"what": "pace", "way": name, "items": ways[name][0], "items_per_second": pace}
        for name, pace in best.items()
    ]


def _rows(folder: Path) -> list[list[str]]:
    return [row.split(",") for row in (folder / "items.csv").read_text().split()[1:]]


def _shell_loop(folder: Path) -> None:
    for cloud, mask, camera, output in _rows(folder):
        words = ("refine", cloud, mask, "--camera", camera, "-o", output, "--overwrite")
        if code := _tso(folder, *words).wait():
            raise subprocess.CalledProcessError(code, words)


def _in_python(folder: Path) -> None:
    """`refine_batch` with all that the command does for an item: read, refine, write."""
    scenes = []
    for cloud, mask, _, _ in _rows(folder):
        scene = load_points_scene(folder / cloud, Path(mask))
        scenes.append((scene.points, list(scene.views)))
    for row, result in zip(_rows(folder), refine_batch(scenes), strict=True):
        write_cloud(folder / f"new-{row[3]}", getattr(result, "points", np.zeros((2, 3))))


def _nothing_to_do(folder: Path) -> None:
    """What the parent process itself needs: the items take no time."""
    columns = ("source", "masks", "camera", "output")
    items = [(row[3], dict(zip(columns, row, strict=True))) for row in _rows(folder)]
    with open_journal(folder / NAME) as journal, WorkerPool(os.cpu_count() or 1) as pool:
        tasks = tasks_of(items, {}, lambda item, known: "")
        engine = Engine(pool, window=8)
        run(tasks, {}, _no_work, bool, engine, journal, lambda *ended: None, Event())


def _no_work(task: Task) -> Outcome:
    values = {"verdict": "fits better", "confidence": 0.9, "iou_before": 0.6, "iou_after": 0.8}
    return Outcome("done", "0" * 64, 0.0, values=values | {"output": task.item})


def _manifest(seed: int) -> Cases:
    """What a process needs to read and check a manifest, before any item begins."""
    with _folder(ROWS, seed) as folder:
        command = [sys.executable, "-c", READ, "items.csv"]
        printed = subprocess.check_output(command, **_python(folder))
    seconds, pages = map(float, printed.split())
    mebibytes = pages * os.sysconf("SC_PAGE_SIZE") / 2**20
    return [{"what": "manifest", "rows": ROWS, "seconds": seconds, "MiB": mebibytes}]


def processes_of(parent: int) -> list[int]:
    """A process and all below it."""
    below: dict[int, list[int]] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            fields = stat.read_text().rpartition(")")[2].split()
            below.setdefault(int(fields[1]), []).append(int(stat.parent.name))
    processes = [parent]
    for process in processes:
        processes += below.get(process, [])
    return processes


def _memory(processes: list[int]) -> float:
    """MiB that the processes hold."""
    total = 0
    for process in processes:
        with suppress(OSError, IndexError):
            total += int(Path(f"/proc/{process}/statm").read_text().split()[1])
    return total * os.sysconf("SC_PAGE_SIZE") / 2**20


def long_batch(
    items: int,
    kills: int,
    engine: str,
    seed: int,
    progress: Progress,
    between: tuple[float, float] = BETWEEN_KILLS,
) -> Cases:
    """Half of the items in peace, then kills, then a run to the end in peace."""
    dice = random.Random(seed)
    with _folder(items, seed, poison=True) as folder:
        journal, samples = folder / "out" / NAME, []
        orphans = killed = 0
        while True:
            process = _tso(folder, "batch", "items.csv", "-o", "out", "--engine", engine)
            before, peaceful = killed, killed == 0
            until = time.monotonic() + dice.uniform(*between)
            while process.poll() is None:
                time.sleep(2.0 if peaceful else 0.2)
                ended = _ended(journal) if peaceful else 0
                if peaceful:
                    samples.append((ended, time.time(), _memory(processes_of(process.pid))))
                    progress.report("items", min(ended, items), items)
                due = ended > items // 2 if peaceful else time.monotonic() > until
                if killed < kills and due:
                    killed += 1
                    orphans += _kill(process, dice)
                    until = time.monotonic() + dice.uniform(*between)
            if process.returncode in (0, 3) and killed == before:
                if killed >= kills:
                    break
                killed += 1  # nothing was left to be killed
        rows = [*_tenths(samples, items), _left(folder, items, killed, orphans)]
        return [{"what": "long", "engine": engine, **row} for row in rows]


def _ended(journal: Path) -> int:
    return sum(entry["event"] in ENDS for entry in entries(journal)) if journal.exists() else 0


def _kill(process: subprocess.Popen[bytes], dice: random.Random) -> int:
    """Kill the batch, or processes of it, or both; how many processes outlive the batch."""
    below = processes_of(process.pid)[1:]
    whom = dice.choice(["parent", "worker", "both"])
    if whom != "parent" and below:
        for victim in dice.sample(below, dice.randint(1, len(below))):
            with suppress(ProcessLookupError):  # it may have ended by itself
                os.kill(victim, signal.SIGKILL)
        time.sleep(dice.uniform(0.0, 0.5))
    if whom == "worker":
        return 0
    with suppress(ProcessLookupError):
        os.kill(process.pid, dice.choice([signal.SIGKILL, signal.SIGTERM, signal.SIGINT]))
    below = processes_of(process.pid)[1:] or below
    process.wait()
    until = time.monotonic() + 10.0
    alive = below
    while alive and time.monotonic() < until:
        time.sleep(0.05)
        alive = [number for number in below if Path(f"/proc/{number}").exists()]
    return len(alive)


def _tenths(samples: list[tuple[int, float, float]], items: int) -> Cases:
    """Pace and memory of each tenth of the items that were done in peace."""
    cases = []
    for number in range(PART // 2):
        first, last = items * number // PART, items * (number + 1) // PART
        inside = [sample for sample in samples if first <= sample[0] <= last]
        if len(inside) > 1:
            (low, begun, _), (high, ended, _) = inside[0], inside[-1]
            pace, memory = (high - low) / (ended - begun), max(sample[2] for sample in inside)
            cases.append({"tenth": number + 1, "items_per_second": pace, "memory_MiB": memory})
    return cases


def _left(folder: Path, items: int, kills: int, orphans: int) -> Record:
    """What is in the journal and in the folder after the end."""
    ends: dict[str, Counter[str]] = {}
    for entry in entries(folder / "out" / NAME):
        if entry["event"] in ENDS:
            ends.setdefault(entry["item"], Counter())[entry["event"]] += 1
    broken = {f"{number}.ply" for number in range(BROKEN_EVERY // 2, items, BROKEN_EVERY)}
    good = {f"{number}.ply" for number in range(items)} - broken
    names = [path.name for path in (folder / "out").iterdir()]
    done = [ends.get(item, Counter()) for item in good]
    return {
        "kills": kills,
        "items": items,
        "good": len(good),
        "done_once": sum(events["done"] + events["doubtful"] == 1 for events in done),
        "on_disk": sum((folder / "out" / item).is_file() for item in good),
        "broken": len(broken),
        "broken_refused": sum(set(ends.get(item, ())) == {"refused"} for item in broken),
        "poison": dict(ends.get(POISON, Counter())),
        "other_files": len(names) - 2 * len(good) - 1,
        "temporaries": sum(name.startswith(".") for name in names),
        "orphans": orphans,
    }


def conclude(cases: Cases) -> Record:
    return {"claims": list(_claims(cases))}


def _claims(cases: Cases) -> Iterator[Record]:
    pace = {row["way"]: row["items_per_second"] for row in cases if "way" in row}
    if pace:
        loop, batch = (pace["tso batch"] / pace[name] for name in ("shell loop", "refine_batch"))
        text = "tso batch is at least 8 times as fast as a shell loop"
        yield claim(text, loop >= 8.0, f"{loop:.1f} times")
        text = "tso batch has at least 0.95 of the pace of refine_batch"
        yield claim(text, batch >= 0.95, f"{batch:.2f}")
    for engine in dict.fromkeys(row["engine"] for row in cases if "tenth" in row):
        first, *_, last = (row for row in cases if "tenth" in row and row["engine"] == engine)
        slower, more = (last[key] / first[key] for key in ("items_per_second", "memory_MiB"))
        text = f"{engine}: the last tenth has at least 0.9 of the first one's pace"
        yield claim(text, slower >= 0.9, f"{slower:.2f}")
        text = f"{engine}: memory grows by at most a tenth"
        yield claim(text, more <= 1.1, f"{more:.2f} times")
    for row in (row for row in cases if "kills" in row):
        engine, good = row["engine"], row["good"]
        whole = row["done_once"] == row["on_disk"] == good
        figures = f"{row['done_once']:,} and {row['on_disk']:,} of {good:,}"
        text = f"{engine}: after all kills every item is done once and on disk"
        yield claim(text, whole, figures)
        rest = [row[key] for key in ("temporaries", "orphans", "other_files")]
        text = f"{engine}: no temporary file, no orphan and nothing else is left"
        yield claim(text, not any(rest), ", ".join(map(str, rest)))
        named = row["broken_refused"] == row["broken"] and set(row["poison"]) == {"failed"}
        text = f"{engine}: broken items are refused, the item that kills its process named"
        yield claim(text, named, f"{row['broken_refused']} of {row['broken']}; {row['poison']}")


def tables(record: Record) -> list[Table]:
    cases, machine = record["cases"], record["settings"]["machine"]
    where = f"{machine['cpu']}, {machine['cores']} cores; {record['seconds']:.0f} s"

    def rows(*keys: str) -> list[list[Any]]:
        return [[row[key] for key in keys] for row in cases if set(keys) <= set(row)]

    paces = rows("way", "items", "items_per_second")
    reading = rows("rows", "seconds", "MiB")
    tenths = rows("engine", "tenth", "items_per_second", "memory_MiB")
    left = [
        [row["engine"], name.replace("_", " "), str(value)]
        for row in cases
        if "kills" in row
        for name, value in row.items()
        if name not in ("what", "engine")
    ]
    long = ["engine", "tenth of the items", "items/s", "MiB"]
    return [
        Table(["way", "items", "items/s"], paces, "Pace", where, 1),
        Table(["rows", "s", "MiB"], reading, "Reading a manifest", decimals=1),
        Table(long, tenths, "A long batch", decimals=1),
        Table(["engine", "", "number"], left, "After the kills"),
    ]


def panels(record: Record) -> Rows:
    ways, tenths, what = dict[str, Any](), dict[str, Any](), "items a second"
    for row in record["cases"]:
        if "way" in row and row["way"] != NOTHING:
            ways[row["way"]] = {what: row["items_per_second"]}
        if "tenth" in row:
            tenths[f"{row['engine']}, tenth {row['tenth']}"] = {what: row["items_per_second"]}
    return {what: ways, "a long batch, by tenths of its items": tenths}


STUDY = Study(
    name="scale",
    parts=("points, best",),
    tables=tables,
    draw=bars(panels),
    options=(
        option("--items", "Items of the long batch.", int, 20_000, least=50),
        option("--kills", "How often it is killed.", int, 100, least=0),
        option(
            "--engine",
            "May be repeated.  [default: both]",
            default=("processes", "dask"),
            choices=("processes", "dask"),
            multiple=True,
            name="engines",
        ),
        options.SEED,
    ),
    plan=plan,
    conclude=conclude,
)
