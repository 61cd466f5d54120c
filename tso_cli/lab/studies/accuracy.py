"""How much nearer to the truth a refinement comes, and how often further away: every preset and variant on unseen shapes."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...evaluation.footprint import IOU_MEANS
from ...evaluation.metrics import chamfer, emd, f_score
from ...geometry.points import Array
from ...io.checkpoints import load_network
from ...network.model import BaseNetwork, NetworkConfig
from ...version import __version__
from .accuracy_cases import KINDS, AccuracyCase, CaseBuilder, check_points, kinds_of
from .accuracy_summary import claims, summarise
from .accuracy_variants import alone, refined, variants_of
from .parts import SPLIT, Shape, shapes_of_part, weights_hash
from .protocol import Report
from .resumed import Cases, Keep, cases_of, complete

CATEGORIES = ("chair", "airplane", "car", "sofa", "table")
ABLATED = ("other", "near", "cut", "network")
"""Kinds of an ablation."""
GROUP = 32
"""Cases that are refined together: their dense matrices fill 0.4 GiB."""
TIMED = 6
"""Cases of each kind, category and variant that are refined once more, alone, with a clock beside them."""
F_THRESHOLD = 0.02
ASSIGNED = 2048
"""Points up to which one-to-one assignments are solved."""
CONVENTION = {
    "chamfer": "squared distances, mean over points, forward + backward, longest side 1; to as many target points",
    "dense": "the same to 16,384 target points",
    "f_score": f"share of points with a counterpart nearer than {F_THRESHOLD}, harmonic mean of both directions, 16,384 target "
    "points",
    "emd": "mean distance of an optimal one-to-one assignment; none over 2,048 points",
    "iou": IOU_MEANS,
    "floor": "Chamfer distance of another sampling of the true surface",
    "in_plane": "each point keeps its depth and takes the place in the image plane of the target point that an optimal "
    "assignment gives it, or none moves where that is nearer",
    "seconds": "one call of refine alone, median over up to 6 cases; batch_seconds: a case of a batch",
}


@dataclass(frozen=True)
class AccuracyConfig:
    """What is studied; everything the figures depend on beside meshes and network.

    Parameters
    ----------
    part : of the split; training shapes start from those of other types, and are none for the network, which knows them.
    categories : of the study. limit : at most so many shapes of each.
    kinds : where the starts are from, of `KINDS`; none stands for all that there are.
    views : random views of each shape. size : of a mask, pixels each way. points : of a cloud.
    ablation : the default preset with one ingredient changed at a time, in place of the presets and variants.
    """

    part: str = "test"
    categories: tuple[str, ...] = CATEGORIES
    limit: int | None = None
    kinds: tuple[str, ...] = ()
    views: int = 2
    size: int = 64
    points: int = 1024
    ablation: bool = False
    seed: int = 0
    device: str = "cpu"

    def __post_init__(self) -> None:
        if self.part == "train" and "network" in self.kinds:
            raise InputError("kind is 'network' of training shapes, expected shapes that the network was not trained on")
        if not self.kinds:
            every = ABLATED if self.ablation else KINDS
            object.__setattr__(self, "kinds", tuple(kind for kind in every if kind != "network" or self.part != "train"))
        for kind in self.kinds:
            if kind not in (ABLATED if self.ablation else KINDS):
                expected = ", ".join(ABLATED if self.ablation else KINDS)
                raise InputError(f"kind is {kind!r}, expected one of {expected}{' with ablation' if self.ablation else ''}")


def study_accuracy(
    folder: Path,
    config: AccuracyConfig | None = None,
    split_file: Path = SPLIT,
    checkpoint: Path | None = None,
    earlier: dict[str, Any] | None = None,
    keep: Keep | None = None,
    report: Report | None = None,
) -> dict[str, Any]:
    """Refine every case of every kind with every variant, and judge it against the truth.

    Parameters
    ----------
    folder : meshes, as `shapes_of_part` expects them.
    checkpoint : a view-aligned network, for kind "network".
    earlier : a record of the same settings, complete or not; what is in it is not done again.
    keep : called after every group of shapes with the record so far, whose ``complete`` is False until the last.
    report : called with (what, done, total).

    Returns
    -------
    A JSON-able record: {"study", "complete", "settings", "convention", "summary": {kind: {category: ...}}, "claims": [...],
    "cases": [...]}. Distances are raw.

    Raises
    ------
    InputError
        A shape is missing, the network is missing or not view-aligned, or ``earlier`` is of other settings.
    TsoError
        A case cannot be refined.
    """
    config = config or AccuracyConfig()
    shapes = shapes_of_part(folder, split_file, config.part, config.categories, config.limit)
    builder, network, digest = builder_of(folder, config, split_file, checkpoint)
    settings = {**asdict(config), "shapes": [shape.name for shape in shapes], "network": digest}
    settings["variants"] = {kind: list(variants_of(kind, config.ablation)) for kind in config.kinds}
    settings |= {"categories": list(config.categories), "kinds": list(config.kinds)}
    cases = cases_of("accuracy", earlier, settings)
    wanted = _groups(shapes, config)
    if not wanted:
        raise InputError(f"kinds are {', '.join(config.kinds)}, expected some that {', '.join(config.categories)} have")
    done = {(case["kind"], case["shape"]) for case in cases}
    # A group of which a shape is missing is judged anew as a whole.
    kept = {(kind, shape.name) for kind, group in wanted if all((kind, s.name) in done for s in group) for shape in group}
    cases = [case for case in cases if (case["kind"], case["shape"]) in kept]
    timed = {(case["kind"], case["category"]) for case in cases}

    def judged(kind: str, group: list[Shape]) -> Cases:
        built = [case for shape in group for case in builder.cases(shape, kind)]
        first = (kind, group[0].category) not in timed
        timed.add((kind, group[0].category))
        return judge_group(built, config, network, TIMED if first else 0)

    groups = [None if (kind, group[0].name) in kept else partial(judged, kind, group) for kind, group in wanted]
    return complete(cases, groups, partial(_record, settings), "refining", keep, report)


def builder_of(
    folder: Path, config: AccuracyConfig, split_file: Path, checkpoint: Path | None
) -> tuple[CaseBuilder, BaseNetwork | None, str | None]:
    """What makes the cases, the network that some of them are from, and a digest of its weights."""
    network: BaseNetwork | None = None
    about: NetworkConfig | None = None
    if "network" in config.kinds:
        if checkpoint is None:
            raise InputError("kind network needs a checkpoint, found none")
        network, about = load_network(checkpoint)
        if about.frame != "view":
            raise InputError(f"{checkpoint}: predicts in the {about.frame} frame, expected a view-aligned network")
    check_points(config.points, config.kinds, about)
    builder = CaseBuilder(folder, split_file, config.views, config.size, config.points, config.seed, network, about)
    return builder, network, weights_hash(network) if network else None


def judge_group(
    cases: list[AccuracyCase], config: AccuracyConfig, network: BaseNetwork | None, timed: int
) -> list[dict[str, Any]]:
    """Refine cases of one kind and category with every variant; the first ``timed`` once more, alone, for the time."""
    records = [_before(case) for case in cases]
    for name, variant in variants_of(cases[0].kind, config.ablation).items():
        results, batch_seconds = refined(cases, variant, config.device, network)
        for number, (case, record, result) in enumerate(zip(cases, records, results, strict=True)):
            found = _judged(result.points, case)
            found |= {"iou_before": result.iou_before, "iou": result.iou_after, "mirrored": result.symmetry is not None}
            if batch_seconds is not None:
                found["batch_seconds"] = batch_seconds
            if number < timed:
                found["seconds"] = alone(case, variant, config.device, network)[1]
            record["variants"][name] = _rounded(found)
    return records


def _before(case: AccuracyCase) -> dict[str, Any]:
    before = {**_judged(case.initial, case), "floor": case.floor, "floor_dense": case.floor_dense, "in_plane": in_plane(case)}
    names = {"kind": case.kind, "category": case.category, "shape": case.shape, "view": case.view, "start": case.start}
    return {**names, "before": _rounded(before), "variants": {}}


def _judged(points: Array, case: AccuracyCase) -> dict[str, Any]:
    return {
        "chamfer": chamfer(points, case.target).chamfer,
        "dense": chamfer(points, case.dense).chamfer,
        "f_score": f_score(points, case.dense, F_THRESHOLD).f_score,
        "emd": emd(points, case.target) if len(points) <= ASSIGNED else None,
    }


def in_plane(case: AccuracyCase) -> float | None:
    """Chamfer distance of the start once nothing is wrong with it but depth, as the case's own camera sees it.

    Each point moves parallel to the image plane, to the place of the target point that an optimal one-to-one assignment
    (squared distances) gives it, or none moves where that is nearer. None over 2,048 points, and for a network's prediction,
    whose points lie so unevenly that an assignment does more harm than good.
    """
    from scipy.optimize import linear_sum_assignment
    from scipy.spatial.distance import cdist

    if len(case.initial) > ASSIGNED or case.kind == "network":
        return None
    rotation = case.views[0].camera.R
    moved, truth = case.initial @ rotation.T, case.target @ rotation.T
    _, paired = linear_sum_assignment(cdist(moved, truth, "sqeuclidean"))
    moved[:, :2] = truth[paired, :2]
    # An assignment leads a few clouds astray, seen along a flat part: who knows the truth leaves these as they are.
    return min(chamfer(moved, truth).chamfer, chamfer(case.initial, case.target).chamfer)


def _rounded(values: dict[str, Any]) -> dict[str, Any]:
    """Numbers with five digits: what is in the sixth differs between machines."""
    return {name: float(f"{value:.5g}") if isinstance(value, (float, np.floating)) else value for name, value in values.items()}


def _groups(shapes: list[Shape], config: AccuracyConfig) -> list[tuple[str, list[Shape]]]:
    """(kind, shapes of one category) that are worked on together."""
    size = max(1, GROUP // config.views)
    found = []
    for category in config.categories:
        own = [shape for shape in shapes if shape.category == category]
        for kind in kinds_of(category, config.kinds):
            found += [(kind, own[i : i + size]) for i in range(0, len(own), size)]
    return found


def _record(settings: dict[str, Any], cases: list[dict[str, Any]], complete: bool) -> dict[str, Any]:
    summary = summarise(cases)
    return {
        "study": "accuracy",
        "version": __version__,
        "complete": complete,
        "settings": settings,
        "convention": CONVENTION,
        "summary": summary,
        "claims": claims(cases, summary) if complete and not settings["ablation"] else [],
        "cases": cases,
    }
