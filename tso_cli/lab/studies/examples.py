"""The shipped examples, one by one: IoU, Chamfer and time of every mode."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

from ...evaluation.footprint import IOU_MEANS
from ...evaluation.metrics import chamfer
from ...geometry.points import normalise_longest_side
from ...io.clouds import read_cloud
from ...io.shipped import CATEGORIES, examples_folder
from ...refinement import RefineConfig, RefineResult, refine
from ...scene.load import Scene, load_points_scene
from ...scene.network import load_network_scene
from ...version import __version__
from .protocol import Report

RUNS = 5


def study_examples(checkpoint: Path | None = None, report: Report | None = None) -> dict[str, Any]:
    """Refine each shipped example with the paper's settings and judge it by Chamfer to its target.

    Parameters
    ----------
    checkpoint : a view-aligned network; with it the two network modes are run too. Their clouds are judged in the world
        of the camera file, as `--frame world` writes them.
    report : called with (what, done, total).

    Returns
    -------
    A JSON-able record with one entry for each example and mode. Distances are raw.
    """
    modes = ["points", "encoder", "encoder-decoder"] if checkpoint else ["points"]
    records = []
    for i, name in enumerate(CATEGORIES):
        for j, mode in enumerate(modes):
            records.append(_run(examples_folder() / name, name, mode, checkpoint))
            if report:
                report("examples", i * len(modes) + j + 1, len(CATEGORIES) * len(modes))
    return {
        "study": "examples",
        "version": __version__,
        "convention": {
            "chamfer": "squared distances, mean over points, forward (target -> cloud) + backward; target's longest side 1",
            "chamfer_capnet": "the same after each cloud was centred and scaled to longest side 1 by its own box",
            "iou": IOU_MEANS,
            "seconds": f"median of {RUNS} runs of the optimisation alone, after one that is not counted",
        },
        "examples": records,
    }


def _run(folder: Path, name: str, mode: str, checkpoint: Path | None) -> dict[str, Any]:
    target = read_cloud(folder / "target.ply").points
    scene = example_scene(folder, mode, checkpoint)
    config = RefineConfig(mode, sigma_sq=scene.sigma_sq, preset="paper")
    results: list[RefineResult] = []
    seconds = []
    for _ in range(RUNS + 1):
        start = time.perf_counter()
        results.append(refine_scene(scene, config))
        seconds.append(time.perf_counter() - start)
    result = results[0]
    before, after = (scene.to_output(points) for points in (result.initial, result.points))
    own = normalise_longest_side
    plain = [chamfer(points, target).chamfer for points in (before, after)]
    capnet = [chamfer(own(points), own(target)).chamfer for points in (before, after)]
    return {
        "example": name,
        "mode": mode,
        "points": len(result.points),
        "steps": result.steps,
        "learning_rate": result.learning_rate,
        "gamma": result.gamma,
        "sigma_sq": result.sigma_sq,
        "iou_before": result.iou_before,
        "iou_after": result.iou_after,
        "chamfer_before": plain[0],
        "chamfer_after": plain[1],
        "ratio": plain[1] / plain[0],
        "chamfer_capnet_before": capnet[0],
        "chamfer_capnet_after": capnet[1],
        "seconds": sorted(seconds[1:])[RUNS // 2],
    }


def example_scene(folder: Path, mode: str, checkpoint: Path | None) -> Scene:
    """The example in ``folder``; the clouds of a network are judged in the world of the camera file."""
    if mode == "points" or checkpoint is None:
        return load_points_scene(folder / "initial.ply", folder / "mask.png")
    return load_network_scene(folder / "image.png", folder / "mask.png", checkpoint, world=True)


def refine_scene(scene: Scene, config: RefineConfig) -> RefineResult:
    """Refine what was loaded, a cloud or a network."""
    return refine(None if scene.network else scene.points, scene.view, config=config, network=scene.network, image=scene.image)
