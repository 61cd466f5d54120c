"""What `tso lab speed` times: whole commands, large files, objects, batches, losses.

A function for each part yields the contestants of a race. Imports no torch, whose memory is no part
of a refinement's, before a loss needs it.
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
from typing import TYPE_CHECKING, Any
from unittest.mock import patch

import numpy as np
from scipy.spatial import cKDTree
from threadpoolctl import threadpool_limits

from tso_cli.errors import TsoError
from tso_cli.geometry.points import Array, normalise_longest_side, sample_surface, spread_subset
from tso_cli.geometry.resampling import area_resize
from tso_cli.geometry.view import View
from tso_cli.io.cameras import CameraRecord, write_cameras
from tso_cli.io.images import write_image
from tso_cli.io.meshes import read_mesh
from tso_cli.io.shipped import examples_folder
from tso_cli.kernels.window import window_radius
from tso_cli.losses.chamfer import ChamferToStart
from tso_cli.losses.projection import project_differentiably
from tso_cli.losses.silhouette import silhouette_bce
from tso_cli.optimisation.loop import Term
from tso_cli.optimisation.presets import SIGMA_SQ, Preset
from tso_cli.refinement import PRESETS, RefineConfig, refine, refine_batch
from tso_cli.scene.load import load_points_scene
from tso_cli.signals import waiting_signals

from ..study import uninterrupted
from ..views import views_around
from .timing import IMPORT_TORCH, Contestant, Sample, as_installed, never_run, process, timed

if TYPE_CHECKING:
    from torch import Tensor

Races = Iterator[list[Contestant]]
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


def commands(seed: int) -> Races:
    """Processes of bare Python, of `import torch` and of `tso` commands.

    A first run finds no byte code. Raises TsoError if a command fails,
    InputError if the shipped examples are missing.
    """
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
    """Whole processes of `tso refine`, and the memory that they take; TsoError if one fails."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _write_photo(folder)
        np.save(folder / "scan.npy", cloud(scan, seed).astype(np.float32))
        (folder / "splats.ply").write_bytes(splat_file(splats, seed))
        mesh = finer_mesh(faces)
        mesh.export(folder / "mesh.ply")
        scenes = {
            "scan": ("scan.npy", folder / "mask.png", scan),
            "splats": ("splats.ply", CHAIR / "mask.png", splats),
            "mesh": ("mesh.ply", CHAIR / "mask.png", len(mesh.faces)),
        }
        contestants = [IMPORT_TORCH]
        for scene, (start, mask, points) in scenes.items():
            files = (str(folder / start), str(mask))
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


def splat_file(count: int, seed: int) -> bytes:
    """A PLY file of Gaussian splats."""
    names = PROPERTIES.split()
    values = np.random.default_rng(seed).normal(size=(count, len(names))).astype("<f4")
    values[:, :3] = cloud(count, seed)
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {count}"]
    lines += [f"property float {name}" for name in names]
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
        config = RefineConfig(preset=preset, steps=steps)
        work = partial(_refine, cloud(points, seed), chair_views(views), config)
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
    steps = torch.arange(-radius, radius + 1)
    centre = points_px.detach().round().long()
    column, row = (centre[:, axis : axis + 1] + steps for axis in (0, 1))  # [N, k]
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
        initial, moved = cloud(count, seed), []
        for steps in STEPS:
            config = RefineConfig(preset="paper", steps=steps)
            moved.append(uninterrupted(refine(initial, chair_views(), config=config)).points)
        yield [
            Contestant(name, timed(partial(_along, term, moved)), {"points": count}, len(moved))
            for name, term in terms(initial).items()
        ]


def _along(term: Term, iterates: Sequence[Array]) -> None:
    for points in iterates:
        term(points)


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
