"""Refinements: whole commands, large files, single objects, batches.

Imports no torch, whose memory is no part of a refinement's.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from threadpoolctl import threadpool_limits

from tso_cli.errors import TsoError
from tso_cli.geometry.points import Array, normalise_longest_side, sample_surface, spread_subset
from tso_cli.geometry.resampling import area_resize
from tso_cli.geometry.view import View
from tso_cli.io.cameras import CameraRecord, write_cameras
from tso_cli.io.images import write_image
from tso_cli.io.meshes import read_mesh
from tso_cli.io.shipped import examples_folder
from tso_cli.optimisation.presets import Preset
from tso_cli.refinement import PRESETS, RefineConfig, refine, refine_batch
from tso_cli.scene.load import load_points_scene
from tso_cli.signals import waiting_signals

from ..interrupts import uninterrupted
from ..study import Cases
from ..views import views_around
from .timing import (
    IMPORT_TORCH,
    Contestant,
    Sample,
    Setting,
    as_installed,
    never_run,
    process,
    timed,
)

CHAIR = examples_folder() / "chair"
# The example starts from points of this shape.
START = examples_folder() / "meshes" / "chair" / "q17_ChairHandle.ply"
# Clouds of up to SPREAD points are spread evenly, as in data sets: they then have a mirror plane.
SPREAD, SAMPLES = 1024, 8192
DEGREES_BETWEEN_VIEWS = 50.0
SIZES = (1024, 16384)
MORE_VIEWS = (2, 4)
"""Numbers of views of the default preset, at the smallest size."""
LARGE, CORES = 262_144, os.cpu_count() or 1
"""Points of the largest cloud, which the default alone refines."""
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
PROPERTIES = [*"xyz", "nx", "ny", "nz", *(f"f_dc_{number}" for number in range(3)), "opacity"]
PROPERTIES += [*(f"scale_{axis}" for axis in range(3)), *(f"rot_{part}" for part in range(4))]
# The command, then the peak of its process's memory.
WATCHED = """from tso_cli.__main__ import main
try:
    main()
finally:
    import json
    from tso_lab.bench.timing import peak_memory
    open({!r}, "w").write(json.dumps(peak_memory()))
"""


def cloud(count: int, seed: int = 0) -> Array:
    """Initial points [count, 3], longest side 1."""
    mesh, rng = read_mesh(START), np.random.default_rng([seed, count])
    samples = sample_surface(mesh.vertices, mesh.faces, max(count, SAMPLES), rng)
    chosen = samples[spread_subset(samples, count)] if count <= SPREAD else samples[:count]
    return normalise_longest_side(chosen)


def chair_views(count: int = 1) -> list[View]:
    """The mask of the shipped chair, and silhouettes of its cloud turned about the vertical."""
    scene = load_points_scene(CHAIR / "target.ply", CHAIR / "mask.png")
    angles = np.radians(DEGREES_BETWEEN_VIEWS * np.arange(1, count))
    return views_around(scene.view, scene.points, angles)


def measure_command(setting: Setting) -> Cases:
    """Processes of bare Python, of `import torch` and of `tso` commands.

    A first run finds no byte code. Raises TsoError if a command fails,
    InputError if the shipped examples are missing.
    """
    plain = {
        "python": ("-c", "pass"),
        "tso --version": (*TSO, "--version"),
        "tso --help": (*TSO, "--help"),
    }
    contestants = [Contestant(name, process(name, words)) for name, words in plain.items()]
    calls = {"steady": (as_installed, ""), "first": (never_run, ", first run")}
    with tempfile.TemporaryDirectory() as folder:
        for points in SIZES:
            path = f"{folder}/{points}.npy"
            np.save(path, cloud(points, setting.seed))
            words = (*REFINE, path, str(CHAIR / "mask.png"))
            for call, (environment, note) in calls.items():
                name = f"tso refine --mode points, {points:,} points{note}"
                fields = {"points": points, "call": call}
                contestants.append(Contestant(name, process(name, words, environment), fields))
        return setting.race("command", [IMPORT_TORCH, *contestants], "over_import_torch")


def measure_large(
    setting: Setting, scan: int = SCAN, splats: int = SPLATS, faces: int = FACES
) -> Cases:
    """Whole processes of `tso refine`, and the memory that they take; TsoError if one fails."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _write_photo(folder)
        np.save(folder / "scan.npy", cloud(scan, setting.seed).astype(np.float32))
        (folder / "splats.ply").write_bytes(splat_file(splats, setting.seed))
        mesh = finer_mesh(faces)
        mesh.export(folder / "mesh.ply")
        scenes = {
            "scan": ("scan.npy", folder / "mask.png", scan),
            "splats": ("splats.ply", CHAIR / "mask.png", splats),
            "mesh": ("mesh.ply", CHAIR / "mask.png", len(mesh.faces)),
        }
        contestants = []
        for scene, (start, mask, points) in scenes.items():
            files = (str(folder / start), str(mask))
            watched = WATCHED.format(str(folder / "peak"))
            process(scene, ("-c", watched, *REFINE[2:], *files))()
            fields = {"points": points, "peak_MiB": json.loads((folder / "peak").read_text())}
            contestants.append(Contestant(scene, process(scene, (*REFINE, *files)), fields))
        return setting.race("large", [IMPORT_TORCH, *contestants], "over_import_torch")


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


def splat_file(count: int, seed: int) -> bytes:
    """A PLY file of Gaussian splats."""
    values = np.random.default_rng(seed).normal(size=(count, len(PROPERTIES))).astype("<f4")
    values[:, :3] = cloud(count, seed)
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    lines += [f"property float {name}" for name in PROPERTIES]
    return "\n".join([*lines, "end_header", ""]).encode() + values.tobytes()


def finer_mesh(faces: int) -> Any:
    """The shape that clouds are sampled from, its faces divided until there are enough."""
    start = read_mesh(START)
    with waiting_signals():
        import trimesh
    mesh = trimesh.Trimesh(start.vertices, start.faces, process=False)
    while len(mesh.faces) < faces:
        mesh = mesh.subdivide()
    return mesh


def measure_object(
    setting: Setting, sizes: Sequence[int] = SIZES, large: int = LARGE, steps: int | None = None
) -> Cases:
    """`refine` on one core: both presets, more views, a large cloud; the default on all cores."""
    places = [(preset, points, 1) for points in sizes for preset in PRESETS]
    places += [("best", large, 1), *(("best", sizes[0], views) for views in MORE_VIEWS)]
    ways = [(*place, 1, False) for place in places]
    on_threads = product((*sizes, large), sorted({1, CORES}), (False, True))
    ways += [("best", points, 1, threads, busy) for points, threads, busy in on_threads]
    contestants = [IMPORT_TORCH]
    for preset, points, views, threads, busy in dict.fromkeys(ways):
        config = RefineConfig(preset=preset, steps=steps)
        work = partial(_refine, cloud(points, setting.seed), chair_views(views), config)
        fields = {"points": points, "preset": preset, "views": views}
        fields |= {"threads": threads, "busy": busy}
        plural, neighbour = "s" if threads > 1 else "", ", busy neighbour" if busy else ""
        name = f"{preset}, {threads} thread{plural}{neighbour}"
        sample = on_cores(timed(work), threads, busy)
        contestants.append(Contestant(name, sample, fields))
    return setting.race("object", contestants, "over_import_torch")


def measure_batch(
    setting: Setting,
    batches: Mapping[tuple[Preset, int, int], Sequence[int]] = BATCHES,
    steps: int | None = None,
) -> Cases:
    """Seconds an object of `refine_batch` in one process and on all cores."""
    contestants = [IMPORT_TORCH]
    for (preset, points, views), sizes in batches.items():
        config, seen = RefineConfig(preset=preset, steps=steps), chair_views(views)
        scenes = [(cloud(points, setting.seed + number), seen) for number in range(DIFFERENT)]
        scene = {"preset": preset, "points": points, "views": views}
        for size, count, busy in product(sizes, sorted({1, CORES}), (False, True)):
            if not busy or size == WITH_NEIGHBOUR:
                several = [scenes[number % DIFFERENT] for number in range(size)]
                sample = on_cores(timed(partial(_refine_all, several, config)), count, busy)
                fields = scene | {"batch": size, "processes": count, "busy": busy}
                name = f"refine_batch of {size}" + (", busy neighbour" if busy else "")
                contestants.append(Contestant(name, sample, fields, size, size <= WITH_NEIGHBOUR))
    return setting.race("batch", contestants, "over_import_torch")


def _refine(points: Array, views: list[View], config: RefineConfig) -> None:
    uninterrupted(refine(points, views, config=config))


def _refine_all(scenes: list, config: RefineConfig) -> None:
    for result in refine_batch(scenes, config):
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
