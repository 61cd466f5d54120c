"""The paper's table of test-stage optimisation: a network's prediction before and after each of the three variants."""

from __future__ import annotations

import hashlib
import time
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...errors import InputError
from ...evaluation.footprint import IOU_MEANS
from ...evaluation.metrics import nearest_squared
from ...geometry.camera import CANONICAL_ROTATION
from ...geometry.points import Array, normalise_longest_side
from ...geometry.view import View
from ...io.checkpoints import load_network
from ...network.model import BaseNetwork, NetworkConfig
from ...refinement import RefineConfig, refine
from ...render import RenderSettings
from ...scene.network import network_scene
from ...version import __version__
from .parts import SPLIT, SeenShape, Shape, see, shapes_of_part
from .protocol import Report
from .resumed import Cases, Keep, cases_of, complete
from .variants_summary import PAPER, VARIANTS, claims, summarise
from .visibility import visible_points

CONVENTION = {
    "chamfer": "squared distances, mean over points, forward (target -> prediction) + backward (prediction -> target)",
    "capnet": "the paper's protocol: in the camera's axes each cloud is centred and scaled to longest side 1 by its own box",
    "plain": "the network's own coordinates against the target turned to the axes of the camera, longest side 1",
    "visible, occluded": "forward distance of the target's points that the input view sees, and of the others",
    "iou": f"{IOU_MEANS}; on the 64x64 crop that the network sees",
    "seconds": "one refinement, with reading the masks and judging the silhouette, median over the cases",
}


@dataclass(frozen=True)
class VariantsConfig:
    """What is studied; everything the figures depend on beside meshes and network.

    Parameters
    ----------
    part : of the split. categories : only these, empty for all. limit : at most so many shapes of each category.
    views : random views of each shape; size : of their pictures, pixels each way.
    steps : of each refinement; all other settings are the paper's.
    """

    part: str = "test"
    categories: tuple[str, ...] = ()
    limit: int | None = None
    views: int = 4
    size: int = 128
    steps: int = 50
    seed: int = 0
    device: str = "cpu"


def study_variants(
    folder: Path,
    checkpoint: Path,
    config: VariantsConfig | None = None,
    split_file: Path = SPLIT,
    earlier: dict[str, Any] | None = None,
    keep: Keep | None = None,
    report: Report | None = None,
) -> dict[str, Any]:
    """Let the network predict unseen shapes, refine every prediction with each variant and judge it against the truth.

    Parameters
    ----------
    folder : meshes, as `shapes_of_part` expects them.
    checkpoint : a view-aligned network.
    earlier : a record of the same settings, complete or not; what is in it is not done again.
    keep : called after every shape with the record so far, whose ``complete`` is False until the last.
    report : called with (what, done, total).

    Returns
    -------
    A JSON-able record: {"study", "complete", "settings", "convention", "paper", "summary": {category or "all": ...},
    "claims": [...], "cases": [...]}. Distances are raw.

    Raises
    ------
    InputError
        A shape is missing, the network is not view-aligned, or ``earlier`` is of other settings.
    """
    config = config or VariantsConfig()
    shapes = shapes_of_part(folder, split_file, config.part, config.categories, config.limit)
    network, about = load_network(checkpoint)
    if about.frame != "view":
        raise InputError(f"{checkpoint}: predicts in the {about.frame} frame, expected a view-aligned network")
    settings = {
        **asdict(config),
        "categories": sorted({shape.category for shape in shapes}),
        "shapes": len(shapes),
        "points": about.points,
        "sigma_sq": about.sigma_sq,
        "network": weights_hash(network),
    }
    cases = cases_of("tso", earlier, settings)
    done = {case["shape"] for case in cases}
    render = RenderSettings(views=config.views, size=(config.size, config.size))

    def judged(shape: Shape) -> Cases:
        seen = see(shape, render, config.seed)
        return [judge_view(shape, seen, number, network, about, config) for number in range(len(seen.views))]

    groups = [None if shape.name in done else partial(judged, shape) for shape in shapes]
    return complete(cases, groups, partial(_record, settings), "refining", keep, report)


def weights_hash(network: BaseNetwork) -> str:
    """Changes when a weight does; what else is in a checkpoint says nothing of its predictions."""
    digest = hashlib.sha256()
    for name, tensor in sorted(network.state_dict().items()):
        digest.update(name.encode() + tensor.float().contiguous().numpy().tobytes())
    return digest.hexdigest()[:16]


def judge_view(
    shape: Shape, seen: SeenShape, number: int, network: BaseNetwork, about: NetworkConfig, config: VariantsConfig
) -> dict[str, Any]:
    """Predict from one picture, refine with every variant, and measure all four clouds under both protocols."""
    picture = seen.views[number]
    view = View(picture.mask.astype(np.float32) / 255.0, picture.camera, name=f"{shape.name}, view {number}")
    scene = network_scene(picture.image, view, network, about, placing="box")
    clouds = {"before": scene.points}
    ious: dict[str, float] = {}
    seconds: dict[str, float] = {}
    steps: dict[str, int] = {}
    for variant in VARIANTS:
        settings = RefineConfig(variant, config.steps, sigma_sq=about.sigma_sq, device=config.device, preset="paper")
        start = time.perf_counter()
        result = refine(
            scene.points if variant == "points" else None,
            scene.view,
            config=settings,
            network=network,
            image=scene.image,
        )
        seconds[variant] = time.perf_counter() - start
        if result.stop_reason == "interrupted":  # the loop has swallowed Ctrl-C and kept its best
            raise KeyboardInterrupt
        clouds[variant], steps[variant] = result.points, result.best_step
        ious.setdefault("before", result.iou_before)
        ious[variant] = result.iou_after
    target = seen.target @ (CANONICAL_ROTATION @ picture.camera.R).T
    sees = visible_points(seen.scene, seen.target, picture.camera)
    own = normalise_longest_side
    return {
        "category": shape.category,
        "shape": shape.name,
        "view": number,
        "visible_share": float(sees.mean()),
        "capnet": {name: distances(own(cloud), own(target), sees) for name, cloud in clouds.items()},
        "plain": {name: distances(cloud, target, sees) for name, cloud in clouds.items()},
        "iou": ious,
        "best_step": steps,
        "seconds": seconds,
    }


def distances(prediction: Array, target: Array, sees: NDArray[np.bool_]) -> dict[str, float | None]:
    """Both directions of the Chamfer distance, and the forward one over the visible [N] bool and the other target points.

    A group without points has None.
    """
    forward, backward = nearest_squared(target, prediction), nearest_squared(prediction, target)
    return {
        "forward": float(forward.mean()),
        "backward": float(backward.mean()),
        "visible": float(forward[sees].mean()) if sees.any() else None,
        "occluded": float(forward[~sees].mean()) if not sees.all() else None,
    }


def _record(settings: dict[str, Any], cases: list[dict[str, Any]], complete: bool) -> dict[str, Any]:
    summary = summarise(cases)
    return {
        "study": "tso",
        "version": __version__,
        "complete": complete,
        "settings": settings,
        "convention": CONVENTION,
        "paper": PAPER,
        "summary": summary,
        "claims": claims(summary) if complete else [],
        "cases": cases,
    }
