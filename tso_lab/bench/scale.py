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
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from threading import Event

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
from ..charts import draw_bars
from ..options import option
from ..study import Cases, Plan, Progress, Record, Study, Table, claim
from .speed import machine

CLOUDS = 300  # different bent clouds; items beyond use them again
BEND = 0.06  # of a cloud's longest side
BROKEN_EVERY = 500
BETWEEN_KILLS = (0.3, 10.0)  # seconds
POISON = "poison.ply"
PART = 10  # pace and memory are of tenths of the items
FEW = 60  # items of each way whose pace is compared
NOTHING = "items that take no time"
MANY = 5000  # of these
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
MORE = 300  # items of a batch whose pace is compared: processes take a second to start
PLUGIN = {
    "poison-1.dist-info/METADATA": "Metadata-Version: 2.1\nName: poison\nVersion: 1\n",
    "poison-1.dist-info/entry_points.txt": "[tso.clouds]\npoison = poison:read\n",
    "poison.py": "import os\ndef read(data, path):\n    os.kill(os.getpid(), 9)\n",
}
CONVENTION = {
    "items": "clouds of 1,024 points, the shipped starts bent at random, one mask of 256x256 each",
    "shell loop": "`tso refine` once for each item, one after the other",
    "kills": "SIGKILL, SIGTERM or SIGINT to the batch, SIGKILL to processes of it, or both, at "
    "random moments; then the same command again",
    "memory": "resident, of the batch and all its processes together, shared pages counted in each",
}
Way = Callable[[Path], None]


def plan(
    progress: Progress, *, items: int, kills: int, engines: tuple[str, ...], seed: int
) -> Plan:
    """Compare the pace of ways; run a long batch of each engine, and kill it."""
    settings = {
        "items": items,
        "kills": kills,
        "engines": list(engines),
        "seed": seed,
        "machine": machine(),
        "versions": {"tso": __version__, "python": platform.python_version()},
    }
    jobs = [
        ({"what": "pace"}, partial(_paces, seed)),
        ({"what": "manifest"}, partial(_manifest, seed)),
        *(
            (
                {"what": "long", "engine": one},
                partial(long_batch, items, kills, one, seed, progress),
            )
            for one in engines
        ),
    ]
    return Plan(settings, jobs, "measuring")


@contextmanager
def _folder(items: int, seed: int, poison: bool) -> Iterator[Path]:
    """A folder with a manifest of bent clouds; broken ones and a poison if that is asked."""
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
            shown = examples_folder() / cloud_file.name.partition("-")[0]
            broken = poison and number % BROKEN_EVERY == BROKEN_EVERY // 2
            source = "broken.ply" if broken else cloud_file.name
            rows.append(f"{source},{shown / 'mask.png'},{shown / 'camera.json'},{number}.ply")
        if poison:
            (folder / "broken.ply").write_bytes(clouds[0].read_bytes()[:-40])
            (folder / "it.poison").write_text("x")
            rows.insert(1 + items // 3, f"it.poison,{rows[1].split(',', 1)[1]}".replace(
                "0.ply", POISON))  # fmt: skip
            write_poison(folder / "plugin")
        (folder / "items.csv").write_text("\n".join(rows) + "\n")
        yield folder


def write_poison(folder: Path) -> None:
    """Write a package for Python's path, whose reader of .poison kills the process that reads."""
    for place, text in PLUGIN.items():
        (folder / place).parent.mkdir(parents=True, exist_ok=True)
        (folder / place).write_text(text)


def _environment(folder: Path) -> dict[str, str]:
    package = Path(__file__).resolve().parents[2]
    return os.environ | {"PYTHONPATH": os.pathsep.join([str(folder / "plugin"), str(package)])}


def _command(*words: str) -> list[str]:
    return [sys.executable, "-m", "tso_cli", *words]


def _paces(seed: int) -> Cases:
    """Items a second of each way; each way is measured twice, by turns, and the faster counts."""
    ways = {"shell loop": (FEW, _shell_loop), "refine_batch": (MORE, _in_python),
            "tso batch": (MORE, _batch), NOTHING: (MANY, _nothing_to_do)}  # fmt: skip
    best = dict.fromkeys(ways, 0.0)
    for _ in range(2):
        for name, (items, way) in ways.items():
            with _folder(items, seed, poison=False) as folder:
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
        words = ("refine", cloud, mask, "--camera", camera, "-o", output, "-q", "--overwrite")
        subprocess.run(_command(*words), cwd=folder, env=_environment(folder), check=True,
                       stderr=subprocess.DEVNULL)  # fmt: skip


def _batch(folder: Path) -> None:
    subprocess.run(_command("batch", "items.csv", "-o", "out", "-q"), cwd=folder,
                   env=_environment(folder), check=False)  # fmt: skip


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
    items = [
        (row[3], dict(zip(("source", "masks", "camera", "output"), row, strict=True)))
        for row in _rows(folder)
    ]
    with open_journal(folder / NAME) as journal, WorkerPool(os.cpu_count() or 1) as pool:
        tasks = tasks_of(items, {}, lambda item, known: "")
        engine = Engine(pool, window=8)
        run(tasks, {}, _no_work, bool, engine, journal, lambda *ended: None, Event())


def _manifest(seed: int) -> Cases:
    """What a process needs to read and check a manifest, before any item begins."""
    with _folder(ROWS, seed, poison=False) as folder:
        found = subprocess.check_output(
            [sys.executable, "-c", READ, "items.csv"], cwd=folder, env=_environment(folder)
        )
    seconds, pages = map(float, found.split())
    mebibytes = pages * os.sysconf("SC_PAGE_SIZE") / 2**20
    return [{"what": "manifest", "rows": ROWS, "seconds": seconds, "MiB": mebibytes}]


def _no_work(task: Task) -> Outcome:
    values = {"verdict": "fits better", "confidence": 0.9, "iou_before": 0.6, "iou_after": 0.8}
    return Outcome("done", "0" * 64, 0.0, values=values | {"output": task.item})


def processes_of(parent: int) -> list[int]:
    """A process and all below it."""
    below: dict[int, list[int]] = {}
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = stat.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        below.setdefault(int(fields[1]), []).append(int(stat.parent.name))
    found = [parent]
    for process in found:
        found += below.get(process, [])
    return found


def _memory(processes: list[int]) -> float:
    """MiB that the processes hold."""
    total = 0
    for process in processes:
        try:
            total += int(Path(f"/proc/{process}/statm").read_text().split()[1])
        except (OSError, IndexError):
            continue
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
            process = subprocess.Popen(
                _command("batch", "items.csv", "-o", "out", "-q", "--engine", engine), cwd=folder,
                env=_environment(folder), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            )  # fmt: skip
            before, peaceful = killed, killed == 0
            until = time.monotonic() + dice.uniform(*between)
            while process.poll() is None:
                time.sleep(0.2 if not peaceful else 2.0)
                ended = _ended(journal) if peaceful else 0
                if peaceful:
                    samples.append((ended, time.time(), _memory(processes_of(process.pid))))
                    progress.report("items", min(ended, items), items)
                if killed < kills and (ended > items // 2 if peaceful
                                       else time.monotonic() > until):  # fmt: skip
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
    mine, *below = processes_of(process.pid)
    whom = dice.choice(["parent", "worker", "both"])
    if whom != "parent" and below:
        for victim in dice.sample(below, dice.randint(1, len(below))):
            with _gone():
                os.kill(victim, signal.SIGKILL)
        time.sleep(dice.uniform(0.0, 0.5))
    if whom == "worker":
        return 0
    with _gone():
        os.kill(mine, dice.choice([signal.SIGKILL, signal.SIGTERM, signal.SIGINT]))
    below = processes_of(process.pid)[1:] or below
    process.wait()
    until = time.monotonic() + 10.0
    while any(Path(f"/proc/{one}").exists() for one in below) and time.monotonic() < until:
        time.sleep(0.05)
    return sum(Path(f"/proc/{one}").exists() for one in below)


@contextmanager
def _gone() -> Iterator[None]:
    """The process may have ended by itself."""
    with suppress(ProcessLookupError):
        yield


def _tenths(samples: list[tuple[int, float, float]], items: int) -> Cases:
    """Pace and memory of each tenth of the items that were done in peace."""
    cases = []
    for number in range(PART // 2):
        first, last = (items * one // PART for one in (number, number + 1))
        inside = [sample for sample in samples if first <= sample[0] <= last]
        if len(inside) < 2:
            continue
        (low, begun, _), (high, ended, _) = inside[0], inside[-1]
        cases.append(
            {
                "tenth": number + 1,
                "items_per_second": (high - low) / (ended - begun),
                "memory_MiB": max(memory for _, _, memory in inside),
            }
        )
    return cases


def _left(folder: Path, items: int, kills: int, orphans: int) -> Record:
    """What is in the journal and in the folder after the end."""
    ends: dict[str, Counter[str]] = {}
    for entry in entries(folder / "out" / NAME):
        if entry["event"] in ENDS:
            ends.setdefault(entry["item"], Counter())[entry["event"]] += 1
    broken = {f"{number}.ply" for number in range(BROKEN_EVERY // 2, items, BROKEN_EVERY)}
    good = {f"{number}.ply" for number in range(items)} - broken
    once = sum(sum(ends.get(item, Counter())[event] for event in ("done", "doubtful")) == 1
               for item in good)  # fmt: skip
    files = Counter(path.suffix for path in (folder / "out").iterdir())
    hidden = [path.name for path in (folder / "out").iterdir() if path.name.startswith(".")]
    return {
        "kills": kills,
        "items": items,
        "good": len(good),
        "done_once": once,
        "on_disk": sum((folder / "out" / item).is_file() for item in good),
        "broken": len(broken),
        "broken_refused": sum(set(ends.get(item, ())) == {"refused"} for item in broken),
        "poison": dict(ends.get(POISON, Counter())),
        "other_files": sum(files.values()) - 2 * len(good) - 1,
        "temporaries": len(hidden),
        "orphans": orphans,
    }


def conclude(cases: Cases) -> Record:
    pace = {row["way"]: row["items_per_second"] for row in cases if "way" in row}
    claims = []
    if pace:
        over = {name: pace["tso batch"] / pace[name] for name in ("shell loop", "refine_batch")}
        claims += [
            claim("tso batch is at least 8 times as fast as a shell loop",
                  over["shell loop"] >= 8.0, f"{over['shell loop']:.1f} times"),
            claim("tso batch has at least 0.95 of the pace of refine_batch",
                  over["refine_batch"] >= 0.95, f"{over['refine_batch']:.2f}"),
        ]  # fmt: skip
    for engine in dict.fromkeys(row["engine"] for row in cases if "tenth" in row):
        tenths = [row for row in cases if "tenth" in row and row["engine"] == engine]
        first, last = tenths[0], tenths[-1]
        slower = last["items_per_second"] / first["items_per_second"]
        more = last["memory_MiB"] / first["memory_MiB"]
        claims += [
            claim(f"{engine}: the last tenth has at least 0.9 of the first one's pace",
                  slower >= 0.9, f"{slower:.2f}"),
            claim(f"{engine}: memory grows by at most a tenth", more <= 1.1, f"{more:.2f} times"),
        ]  # fmt: skip
    for row in (row for row in cases if "kills" in row):
        whole = row["done_once"] == row["on_disk"] == row["good"]
        clean = row["temporaries"] == row["orphans"] == row["other_files"] == 0
        engine = row["engine"]
        named = row["broken_refused"] == row["broken"] and set(row["poison"]) == {"failed"}
        claims += [
            claim(f"{engine}: after all kills every item is done once and on disk", whole,
                  f"{row['done_once']:,} and {row['on_disk']:,} of {row['good']:,}"),
            claim(f"{engine}: no temporary file, no orphan and nothing else is left", clean,
                  f"{row['temporaries']}, {row['orphans']}, {row['other_files']}"),
            claim(f"{engine}: broken items are refused, the item that kills its process named",
                  named, f"{row['broken_refused']} of {row['broken']}; {row['poison']}"),
        ]  # fmt: skip
    return {"claims": claims}


def tables(record: Record) -> list[Table]:
    cases, machine = record["cases"], record["settings"]["machine"]
    where = f"{machine['cpu']}, {machine['cores']} cores; {record['seconds']:.0f} s"
    paces = [[r["way"], r["items"], r["items_per_second"]] for r in cases if "way" in r]
    reading = [[r["rows"], r["seconds"], r["MiB"]] for r in cases if "rows" in r]
    tenths = [
        [r["engine"], r["tenth"], r["items_per_second"], r["memory_MiB"]]
        for r in cases if "tenth" in r
    ]  # fmt: skip
    left = [
        [row["engine"], name.replace("_", " "), str(value)]
        for row in cases if "kills" in row
        for name, value in row.items() if name not in ("what", "engine")
    ]  # fmt: skip
    return [
        Table(["way", "items", "items/s"], paces, "Pace", where, 1),
        Table(["rows", "s", "MiB"], reading, "Reading a manifest", decimals=1),
        Table(
            ["engine", "tenth of the items", "items/s", "MiB"], tenths, "A long batch", decimals=1
        ),
        Table(["engine", "", "number"], left, "After the kills"),
    ]


def draw(path: Path, record: Record, overwrite: bool) -> None:
    cases = record["cases"]
    draw_bars(
        path,
        {
            "items a second": {
                row["way"]: {"items a second": row["items_per_second"]}
                for row in cases if "way" in row and row["way"] != NOTHING
            },
            "a long batch, by tenths of its items": {
                f"{row['engine']}, tenth {row['tenth']}": {
                    "items a second": row["items_per_second"]
                }
                for row in cases if "tenth" in row
            },
        },
        overwrite,
    )  # fmt: skip


STUDY = Study(
    name="scale",
    about="Takes over an hour for 20,000 items on two cores. Linux only: it reads /proc.",
    parts=("points, best",),
    tables=tables,
    draw=draw,
    reading="A batch is done in processes that stay; a shell loop starts tso for each item. The "
    "long batch is left in peace for half of its items, then killed at random moments.",
    convention=CONVENTION,
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
    ),  # fmt: skip
    plan=plan,
    conclude=conclude,
)
