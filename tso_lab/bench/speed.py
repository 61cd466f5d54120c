"""`tso lab speed`: whole commands, large files, objects, batches, losses; other ways beside them.

A function for each part yields the contestants of a race.
"""

from __future__ import annotations

import json
import os
import platform
import re
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import replace
from functools import partial
from importlib.metadata import PackageNotFoundError, distribution, version
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import numpy as np
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from tso_cli.errors import TsoError
from tso_cli.geometry.points import Array, normalise_longest_side, sample_surface, spread_subset
from tso_cli.geometry.resampling import area_resize
from tso_cli.geometry.rotations import from_vectors
from tso_cli.geometry.view import View
from tso_cli.io.cameras import CameraRecord, write_cameras
from tso_cli.io.images import write_image
from tso_cli.io.meshes import read_mesh
from tso_cli.io.shipped import examples_folder
from tso_cli.kernels.window import window_radius
from tso_cli.losses.chamfer import ChamferToStart
from tso_cli.losses.projection import project_differentiably
from tso_cli.losses.silhouette import silhouette_bce, silhouette_of
from tso_cli.optimisation.loop import Term
from tso_cli.optimisation.presets import SIGMA_SQ, Preset
from tso_cli.refinement import PRESETS, RefineConfig, refine, refine_batch
from tso_cli.scene.load import load_points_scene
from tso_cli.version import __version__

from .. import options
from ..charts import Rows, bars, digits
from ..options import option
from ..study import Cases, Plan, Progress, Record, Study, Table, claim, crossed, uninterrupted
from .timing import Contestant, Sample, Setting, as_installed, machine, never_run, process, timed

if TYPE_CHECKING:
    from torch import Tensor

Races = Iterator[list[Contestant]]
CHAIR = examples_folder() / "chair"
# The example starts from points of this shape.
START = examples_folder() / "meshes" / "chair" / "q17_ChairHandle.ply"
# Clouds of up to SPREAD points are spread evenly, as in data sets: they then have a mirror plane.
SPREAD, SAMPLES = 1024, 8192
SIZES, LARGE = (1024, 16384), 262_144
"""Points of clouds; the largest is refined by the default alone."""
MORE_VIEWS, DEGREES_BETWEEN_VIEWS = (2, 4), 50.0
"""Numbers of views of the default preset, at the smallest size."""
CORES = os.cpu_count() or 1
# (preset, points, views) -> numbers of clouds in a batch.
BATCHES: dict[tuple[Preset, int, int], tuple[int, ...]] = {
    ("best", 1024, 1): (16, 64),
    ("paper", 1024, 1): (16, 64),
}
WITH_NEIGHBOUR, DIFFERENT = 64, 16
"""The batch that is also timed with a busy neighbour; the clouds of a batch that differ."""
# Ends with its parent, whatever becomes of the parent.
SPIN = "import os\nparent = os.getppid()\nwhile os.getppid() == parent: pass"
TSO = ("-m", "tso_cli")
REFINE = (*TSO, "refine", "--mode", "points")
# Large files: pixels of the photo, in which the object fills a part; points, splats, faces.
WIDTH, HEIGHT = 4000, 3000
SCAN, SPLATS, FACES = 2_000_000, 100_000, 500_000
# Of a splat in the reference implementation of Gaussian splatting, without higher colours.
PROPERTIES = "x y z nx ny nz f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2"
PROPERTIES += " rot_3"
# The command, then the peak of its process's memory.
WATCHED = """from tso_cli.__main__ import main
try:
    main()
finally:
    import json
    from tso_lab.bench.timing import peak_memory
    open({!r}, "w").write(json.dumps(peak_memory()))
"""
# (points, pixels each way) of the silhouette, and points of the Chamfer distance.
PICTURES, CLOUDS = ((1024, 64), (16384, 256)), (1024, 16384)
STEPS = (10, 30, 50)
"""Chamfer is measured after these of the paper's steps: hardly moved points need no search."""
CLAMP = 1e-6
"""Of silhouettes in torch's cross-entropy."""
IMPORT_TORCH = Contestant("import torch", process("import torch", ("-c", "import torch")))
"""What times are compared with: the first thing that a program with torch does."""


def cloud(count: int, seed: int = 0) -> Array:
    """Initial points [count, 3], longest side 1."""
    mesh, rng = read_mesh(START), np.random.default_rng([seed, count])
    samples = sample_surface(mesh.vertices, mesh.faces, max(count, SAMPLES), rng)
    points = samples[spread_subset(samples, count)] if count <= SPREAD else samples[:count]
    return normalise_longest_side(points)


def chair_views(count: int = 1) -> list[View]:
    """The mask of the shipped chair, and silhouettes of its cloud turned about the vertical."""
    scene = load_points_scene(CHAIR / "target.ply", CHAIR / "mask.png")
    angles = np.radians(DEGREES_BETWEEN_VIEWS * np.arange(1, count))
    return views_around(scene.view, scene.points, angles)


def views_around(view: View, truth: Array, radians: Array) -> list[View]:
    """The view, and silhouettes of its ``truth`` [N, 3] turned about the vertical axis."""
    turns = from_vectors(np.outer(radians, [0.0, 1.0, 0.0]))
    cameras = [replace(view.camera, R=view.camera.R @ turn) for turn in turns]
    return [view, *(View(silhouette_of(truth, camera), camera) for camera in cameras)]


def commands(seed: int) -> Races:
    """Processes of bare Python, of `import torch` and of `tso`; a first run finds no byte code."""
    plain: dict[str, tuple[str, ...]] = {"python": ("-c", "pass")}
    plain |= {f"tso {flag}": (*TSO, flag) for flag in ("--version", "--help")}
    contestants = [IMPORT_TORCH]
    contestants += [Contestant(name, process(name, words)) for name, words in plain.items()]
    calls = {"steady": (as_installed, ""), "first": (never_run, ", first run")}
    with tempfile.TemporaryDirectory() as folder:
        for points in SIZES:
            path = f"{folder}/{points}.npy"
            np.save(path, cloud(points, seed))
            words = (*REFINE, path, str(CHAIR / "mask.png"))
            for call, (environment, note) in calls.items():
                name = f"tso refine --mode points, {points:,} points{note}"
                fields = {"points": points, "call": call}
                contestants.append(Contestant(name, process(name, words, environment), fields))
        yield contestants


def large_files(seed: int, scan: int = SCAN, splats: int = SPLATS, faces: int = FACES) -> Races:
    """Whole processes of `tso refine`, and the memory that they take."""
    import trimesh

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _write_photo(folder)
        np.save(folder / "scan.npy", cloud(scan, seed).astype(np.float32))
        _write_splats(folder / "splats.ply", splats, seed)
        start = read_mesh(START)
        mesh = trimesh.Trimesh(start.vertices, start.faces, process=False)
        while len(mesh.faces) < faces:
            mesh = mesh.subdivide()
        mesh.export(folder / "mesh.ply")
        scenes = {
            "scan": ("scan.npy", folder / "mask.png", scan),
            "splats": ("splats.ply", CHAIR / "mask.png", splats),
            "mesh": ("mesh.ply", CHAIR / "mask.png", len(mesh.faces)),
        }
        contestants = [IMPORT_TORCH]
        for scene, (start_file, mask, points) in scenes.items():
            files = (str(folder / start_file), str(mask))
            watched = WATCHED.format(str(folder / "peak"))
            process(scene, ("-c", watched, *REFINE[2:], *files))()
            fields = {"points": points, "peak_MiB": json.loads((folder / "peak").read_text())}
            contestants.append(Contestant(scene, process(scene, (*REFINE, *files)), fields))
        yield contestants


def _write_photo(folder: Path) -> None:
    """The view of the shipped chair in a photo of this size."""
    (view,) = chair_views()
    side = view.camera.height
    more = (side * WIDTH / HEIGHT - side) / 2.0
    box = (-0.5 - more, -0.5, side - 0.5 + more, side - 0.5)
    mask, _ = area_resize(view.mask, box, WIDTH, HEIGHT)
    write_image(folder / "mask.png", np.uint8(255.0 * (mask > 0.5)))
    camera = CameraRecord(view.camera.cropped(box, WIDTH, HEIGHT))
    write_cameras(folder / "mask.camera.json", [camera])


def _write_splats(path: Path, count: int, seed: int) -> None:
    names = PROPERTIES.split()
    values = np.random.default_rng(seed).normal(size=(count, len(names))).astype("<f4")
    values[:, :3] = cloud(count, seed)
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    lines += [f"property float {name}" for name in names]
    path.write_bytes("\n".join([*lines, "end_header", ""]).encode() + values.tobytes())


def objects(
    seed: int, sizes: Sequence[int] = SIZES, large: int = LARGE, steps: int | None = None
) -> Races:
    """`refine` on one core: both presets, more views, a large cloud; the default on all cores."""
    ways: list[tuple[Preset, int, int, int, bool]]
    ways = [(preset, points, 1, 1, False) for points in sizes for preset in PRESETS]
    ways += [("best", large, 1, 1, False)]
    ways += [("best", sizes[0], views, 1, False) for views in MORE_VIEWS]
    on_threads = product((*sizes, large), sorted({1, CORES}), (False, True))
    ways += [("best", points, 1, threads, busy) for points, threads, busy in on_threads]
    contestants = [IMPORT_TORCH]
    for preset, points, views, threads, busy in dict.fromkeys(ways):
        scene = cloud(points, seed), chair_views(views)
        work = partial(_refine_all, [scene], RefineConfig(preset=preset, steps=steps), alone=True)
        fields = {"points": points, "preset": preset, "views": views}
        fields |= {"threads": threads, "busy": busy}
        plural, neighbour = "s" * (threads > 1), ", busy neighbour" * busy
        name = f"{preset}, {threads} thread{plural}{neighbour}"
        contestants.append(Contestant(name, on_cores(timed(work), threads, busy), fields))
    yield contestants


def batches(
    seed: int,
    batches: Mapping[tuple[Preset, int, int], Sequence[int]] = BATCHES,
    steps: int | None = None,
) -> Races:
    """Seconds an object of `refine_batch` in one process and on all cores."""
    contestants = [IMPORT_TORCH]
    for (preset, points, views), sizes in batches.items():
        config, masks = RefineConfig(preset=preset, steps=steps), chair_views(views)
        scenes = [(cloud(points, seed + number), masks) for number in range(DIFFERENT)]
        scene = {"preset": preset, "points": points, "views": views}
        for size, count, busy in product(sizes, sorted({1, CORES}), (False, True)):
            if not busy or size == WITH_NEIGHBOUR:
                batch = [scenes[number % DIFFERENT] for number in range(size)]
                sample = on_cores(timed(partial(_refine_all, batch, config)), count, busy)
                fields = scene | {"batch": size, "processes": count, "busy": busy}
                name = f"refine_batch of {size}" + ", busy neighbour" * busy
                contestants.append(Contestant(name, sample, fields, size, size <= WITH_NEIGHBOUR))
    yield contestants


def _refine_all(scenes: list[Any], config: RefineConfig, alone: bool = False) -> None:
    ((points, views), *_) = scenes
    results = [refine(points, views, config=config)] if alone else refine_batch(scenes, config)
    for result in results:
        uninterrupted(result)
        if isinstance(result, TsoError):
            raise result


def on_cores(work: Sample, count: int, busy: bool = False) -> Sample:
    """The work in ``count`` processes or threads; with ``busy`` all cores have other work too."""

    def sample() -> float:
        threads = patch.dict(os.environ, OMP_NUM_THREADS=str(count))
        with threads, threadpool_limits(count), busy_neighbour() if busy else nullcontext():
            return work()

    return sample


@contextmanager
def busy_neighbour() -> Iterator[list[subprocess.Popen[bytes]]]:
    """A process that spins on every core inside the block."""
    spinners = [subprocess.Popen([sys.executable, "-c", SPIN]) for _ in range(CORES)]
    try:
        yield spinners
    finally:
        for spinner in spinners:
            spinner.kill()
            spinner.wait()


# The two losses of the paper's preset and other ways to compute them, value and gradient.


def silhouettes(seed: int, sizes: Sequence[tuple[int, int]] = PICTURES) -> Races:
    """The loss of points and a mask at every size, on one thread."""
    import torch

    for count, side in sizes:
        points_px, mask = picture(count, side, seed)
        valid, target = np.ones(count, bool), torch.as_tensor(mask, dtype=torch.float32)
        ways = {
            "tso": partial(silhouette_bce, points_px, valid, mask, 1.0 - mask, SIGMA_SQ),
            "scatter 9x9, torch": partial(scattered_loss, points_px, target),
        }
        fields = {"points": count, "side": side}
        yield [Contestant(name, timed(way), fields) for name, way in ways.items()]


def picture(count: int, side: int, seed: int = 0) -> tuple[Array, Array]:
    """Initial points [count, 2] in the picture of the chair, ``side`` x ``side``, and its mask."""
    (view,) = chair_views()
    box = (-0.5, -0.5, view.camera.width - 0.5, view.camera.height - 0.5)
    mask = area_resize(view.mask, box, side, side)[0].clip(0.0, 1.0)
    projected = project_differentiably(cloud(count, seed), view.camera.resized(side, side))
    return projected.points_px, mask


def scattered_loss(points: Array, mask: Tensor) -> tuple[float, Array]:
    """Value and gradient of the loss in plain torch: all taps, `index_add`, tanh, cross-entropy.

    It has less to do than tso: it lacks the term for mask pixels that no window reaches.
    """
    import torch

    points_px = torch.as_tensor(points, dtype=torch.float32).requires_grad_()
    radius, side = window_radius(SIGMA_SQ), mask.shape[-1]
    centre = points_px.detach().round().long()
    column, row = (centre[:, axis, None] + torch.arange(-radius, radius + 1) for axis in (0, 1))
    weights_x, weights_y = (
        torch.exp((points_px[:, axis : axis + 1] - index).square() * (-0.5 / SIGMA_SQ))
        * ((index >= 0) & (index < side))
        for axis, index in ((0, column), (1, row))
    )
    taps = weights_y.unsqueeze(2) * weights_x.unsqueeze(1)  # [N, k, k]
    flat = row.clamp(0, side - 1).unsqueeze(2) * side + column.clamp(0, side - 1).unsqueeze(1)
    sums = taps.new_zeros(side * side).index_add(0, flat.flatten(), taps.flatten())
    silhouette = torch.tanh(sums).clamp(CLAMP, 1.0 - CLAMP).view_as(mask)
    loss = torch.nn.functional.binary_cross_entropy(silhouette, mask, reduction="sum")
    return loss.item(), torch.autograd.grad(loss, points_px)[0].numpy()


def chamfers(seed: int, sizes: Sequence[int] = CLOUDS) -> Races:
    """A step of the Chamfer distance to the start; on one thread unless the name says otherwise."""
    for count in sizes:
        initial, iterates = cloud(count, seed), []
        for steps in STEPS:
            config = RefineConfig(preset="paper", steps=steps)
            iterates.append(uninterrupted(refine(initial, chair_views(), config=config)).points)

        def along(term: Term, iterates: Sequence[Array] = iterates) -> None:
            for points in iterates:
                term(points)

        yield [
            Contestant(name, timed(partial(along, term)), {"points": count}, len(iterates))
            for name, term in terms(initial).items()
        ]


def terms(initial: Array) -> dict[str, Term]:
    """Contestant -> its Chamfer distance to ``initial`` [N, 3]; tso's is first."""

    def k_d_trees(workers: int, moved: Array) -> tuple[float, Array]:
        """Value and gradient by nearest neighbours of all points, both ways."""
        ahead = moved - initial[cKDTree(initial).query(moved, workers=workers)[1]]
        nearest = cKDTree(moved).query(initial, workers=workers)[1]
        back = moved[nearest] - initial
        gradient = ahead.copy()
        np.add.at(gradient, nearest, back)
        value = float(np.square(ahead).sum() + np.square(back).sum()) / len(moved)
        return value, (2.0 / len(moved)) * gradient

    return {
        "tso": ChamferToStart(initial),
        "two k-d trees a step, 1 worker": partial(k_d_trees, 1),
        "two k-d trees a step, all workers": partial(k_d_trees, -1),
    }


# The study.

OVER_TORCH, OVER_TSO = "over_import_torch", "over_tso"
# What is measured -> its contestants, and what their times are divided by: those of the first.
PARTS: dict[str, tuple[Callable[[int], Races], str]] = {
    "command": (commands, OVER_TORCH),
    "object": (objects, OVER_TORCH),
    "batch": (batches, OVER_TORCH),
    "large": (large_files, OVER_TORCH),
    "silhouette": (silhouettes, OVER_TSO),
    "chamfer": (chamfers, OVER_TSO),
}
PANELS = {
    "object": "one object, in process",
    "silhouette": "silhouette and cross-entropy, value and gradient",
    "chamfer": "Chamfer to the start, a step, value and gradient",
}
LARGE_FILES = {
    "scan": ("a scan of {:,} points and a mask of 4000x3000", 20.0),
    "splats": ("{:,} splats", 4.0),
    "mesh": ("a mesh of {:,} faces", 4.0),
}
"""Name of a large file -> what it is, and its target in seconds."""
NETWORK = ("torch",)  # what the extra of this name installs
MOST_MIB = 1536
"""Target for the memory of large files."""
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

    return {"claims": [claim(*target) for target in _claims(of)]}


def _claims(of: Callable[..., Cases]) -> Iterator[tuple[str, bool, str]]:
    """Target, whether it is met, what was measured."""

    def under_torch(text: str, most: float, rows: Cases, decimals: int = 2) -> Iterator[Any]:
        for row in rows:
            target, ratio = f"{text}: at most {most} of `import torch`", row[OVER_TORCH]
            yield target, ratio <= most, f"{ratio:.{decimals}f}"

    seconds = {row["name"]: row["median"] for row in of("command")}
    for name in ("tso --version", "tso --help"):
        if name in seconds:
            more = seconds[name] - seconds["python"]
            yield f"{name}: at most 0.15 s more than bare Python", more <= 0.15, f"{more:.2f} s"
    steady_rows = of("command", call="steady", points=1024)
    yield from under_torch("tso refine of 1,024 points", 0.35, steady_rows)
    for first in of("command", call="first"):
        (steady,) = of("command", call="steady", points=first["points"])
        ratio = first["median"] / steady["median"]
        text = f"tso refine of {first['points']:,} points: the first run under twice any other"
        yield text, ratio < 2.0, f"{ratio:.2f}x"
    for name, (file, most) in LARGE_FILES.items():
        for row in of("large", name=name):
            title = file.format(row["points"])
            yield f"{title}: under {most:g} s", row["median"] < most, f"{row['median']:.1f} s"
            if peak := row["peak_MiB"]:
                yield f"{title}: under {MOST_MIB:,} MiB", peak < MOST_MIB, f"{peak:,} MiB"
    for points, most in ((1024, 0.15), (16384, 0.25)):
        rows = of("object", points=points, preset="best", views=1, threads=1, busy=False)
        yield from under_torch(f"one object of {points:,} points", most, rows)
    cores = max((row.get("processes", 1) for row in of("batch")), default=1)
    rows = of("batch", processes=cores, preset="best", points=1024, batch=64, busy=False)
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
        ours, of_peer = (
            [r["median"] for r in of(what, points=points) if r["name"].startswith(name)]
            for name in ("tso", peer)
        )
        if ours and of_peer:
            ratio = min(of_peer) / min(ours)
            text = f"{what} of {points:,} points: at least {factor:g}x faster than {peer}"
            yield text, ratio >= factor, f"{ratio:.1f}x"


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
    settings, cpu = record["settings"], record["settings"]["machine"]
    versions = ", ".join(f"{name} {text}" for name, text in settings["versions"].items() if text)
    sizes = ", ".join(f"{size:,} MB {what}" for what, size in settings["installed_MB"].items())
    place = f"{cpu['cpu']}, {cpu['cores']} cores; {versions}; installed: {sizes}; seed "
    place += f"{settings['seed']}, {record['seconds']:.0f} s"
    measured = [
        Table(["", "median", "low", "high", "x `import torch`"], commands, "whole processes: s"),
        Table(large_header, large, "large files, whole processes"),
        pivot("one object: ms (x `import torch`)", of("object", "preset"), OVER_TORCH),
        crossed(batches, title="many objects: ms each (x `import torch`)"),
        pivot(losses.format("silhouette"), of("silhouette"), OVER_TSO),
        pivot(losses.format("Chamfer to the start"), of("chamfer"), OVER_TSO),
        Table(["measured on"], [[place]]),
    ]
    return [table for table in measured if table.rows]


def _size(row: Record) -> str:
    side, views = row["side"], row.get("views", 1)
    return f"{row['points']:,}{f'@{side}' if side else ''}{f', {views} views' * (views > 1)}"


def _ms(row: Record) -> str:
    return digits(1e3 * row["seconds"]["median"])


def panels(record: Record) -> Rows:
    """A panel for each part with growing sizes: median milliseconds."""
    times: dict[str, dict[str, dict[str, float]]] = {}
    for what, title in PANELS.items():
        for row in record["cases"]:
            if row["what"] == what and row["seconds"] and row["points"]:
                of_size = times.setdefault(f"{title}, ms", {}).setdefault(_size(row), {})
                of_size[row["name"]] = 1e3 * row["seconds"]["median"]
    return times


STUDY = Study(
    name="speed",
    parts=("points, paper", "points, best"),
    tables=tables,
    draw=bars(panels, log=True),
    options=(
        option(
            "--only",
            "May be repeated.",
            default=(*PARTS,),
            choices=(*PARTS,),
            multiple=True,
            name="parts",
        ),
        options.SEED,
    ),
    plan=plan,
    conclude=conclude,
)
