"""How well a camera is found from mask and cloud alone, for true clouds and for wrong ones."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...geometry.camera import CANONICAL_FOCAL_AT_64
from ...geometry.points import Array
from ...geometry.rotations import angle_between
from ...pose.fit import FittedCamera, fit_camera
from ...refinement.symmetry import find_mirror_plane
from ...version import __version__
from .accuracy_cases import AccuracyCase, CaseBuilder, kinds_of
from .parts import SPLIT, Shape, shapes_of_part
from .protocol import Report
from .resumed import Cases, Keep, cases_of, complete

CATEGORIES = ("chair", "airplane", "car")
TRUE, WRONG_PRIOR = "the true one", "the true one, focal length taken to be 0.64 of it"
CLOUDS = {"other": "another shape at the paper's error level", "near": "another shape near it"}
PRIOR = 0.64
"""Of the true focal length: 1.2 times the image's side in place of 1.875."""
RIGHT = 15.0
"""Degrees up to which a rotation counts as found."""
CONVENTION = {
    "degrees": "angle between the fitted rotation and the true one",
    "mirrored": "the smaller of that and the angle to the pose that a distant camera cannot tell from it: depth turned round, "
    "and the object replaced by its mirror image",
    "answers": "smallest angle of the fitted pose and its alternatives",
    "focal": "of the longest focal length that fits as well, and of the shortest, over the true one",
}


@dataclass(frozen=True)
class PoseConfig:
    """What is studied: ``part`` of the split, at most ``limit`` shapes of each category, so many random ``views`` of each."""

    part: str = "validation"
    limit: int | None = None
    views: int = 2
    seed: int = 0


def study_pose(
    folder: Path,
    config: PoseConfig | None = None,
    split_file: Path = SPLIT,
    earlier: dict[str, Any] | None = None,
    keep: Keep | None = None,
    report: Report | None = None,
) -> dict[str, Any]:
    """Fit a camera to one 64x64 mask of each case and compare it with the true one.

    Parameters and errors are those of `study_accuracy`.

    Returns
    -------
    A JSON-able record: {"study", "complete", "settings", "convention", "summary": {cloud: {...}}, "cases": [...]}.
    """
    config = config or PoseConfig()
    shapes = shapes_of_part(folder, split_file, config.part, CATEGORIES, config.limit)
    builder = CaseBuilder(folder, split_file, config.views, 64, 1024, config.seed)
    settings = {**asdict(config), "shapes": [shape.name for shape in shapes]}
    cases = cases_of("pose", earlier, settings)
    done = {case["shape"] for case in cases}
    groups = [None if shape.name in done else partial(_judge_shape, builder, shape) for shape in shapes]
    return complete(cases, groups, partial(_record, settings), "fitting", keep, report)


def _judge_shape(builder: CaseBuilder, shape: Shape) -> Cases:
    kinds = kinds_of(shape.category, tuple(CLOUDS))
    return [found for kind in kinds for case in builder.cases(shape, kind) for found in judge(case)]


def judge(case: AccuracyCase) -> list[dict[str, Any]]:
    """What is found for the clouds of one case; the true one goes with kind "other"."""
    size = case.views[0].camera.width
    clouds: dict[str, tuple[Array, float | None]] = {CLOUDS[case.kind]: (case.initial, None)}
    if case.kind == "other":
        clouds |= {TRUE: (case.target, None), WRONG_PRIOR: (case.target, PRIOR * CANONICAL_FOCAL_AT_64 / 64.0 * size)}
    found = []
    for name, (cloud, focal) in clouds.items():
        start = time.perf_counter()
        fitted = fit_camera(cloud, case.views[0].mask, focal=focal)
        seconds = time.perf_counter() - start
        own = {**_compared(case, fitted), "seconds": seconds}
        names = {"cloud": name, "category": case.category, "shape": case.shape, "view": case.view}
        found.append({**names, "sure": fitted.sure, **{key: float(f"{value:.5g}") for key, value in own.items()}})
    return found


def _compared(case: AccuracyCase, fitted: FittedCamera) -> dict[str, float]:
    true = case.views[0].camera
    normal = find_mirror_plane(case.target).normal
    mirrored = np.diag([1.0, 1.0, -1.0]) @ true.R @ (np.eye(3) - 2.0 * np.outer(normal, normal))
    answers = [fitted.camera, *(other.camera for other in fitted.alternatives)]
    degrees = [float(angle_between(answer.R, true.R)) for answer in answers]
    return {
        "degrees": degrees[0],
        "mirrored": min(degrees[0], float(angle_between(fitted.camera.R, mirrored))),
        "answers": min(degrees),
        "shortest": fitted.focal_range[0] / true.K[0, 0],
        "longest": fitted.focal_range[1] / true.K[0, 0],
    }


def summarise(cases: list[dict[str, Any]]) -> dict[str, Any]:
    """{cloud: {"cases", "median_degrees", "right", "mirrored", "answers", "sure", "sure_right", "shortest", "longest",
    "median_seconds"}}, counts of cases within 15 degrees."""
    found = {}
    for name in dict.fromkeys((TRUE, WRONG_PRIOR, *CLOUDS.values())):
        own = [case for case in cases if case["cloud"] == name]
        if own:
            sure = [case for case in own if case["sure"]]
            medians = {
                key: float(np.median([case[key] for case in own])) for key in ("degrees", "shortest", "longest", "seconds")
            }
            counts = {key: sum(case[key] <= RIGHT for case in own) for key in ("degrees", "mirrored", "answers")}
            found[name] = {
                "cases": len(own),
                "median_degrees": medians["degrees"],
                "right": counts["degrees"],
                "mirrored": counts["mirrored"],
                "answers": counts["answers"],
                "sure": len(sure),
                "sure_right": sum(case["degrees"] <= RIGHT for case in sure),
                "shortest": medians["shortest"],
                "longest": medians["longest"],
                "median_seconds": medians["seconds"],
            }
    return found


def _record(settings: dict[str, Any], cases: list[dict[str, Any]], complete: bool) -> dict[str, Any]:
    return {
        "study": "pose",
        "version": __version__,
        "complete": complete,
        "settings": settings,
        "convention": CONVENTION,
        "summary": summarise(cases),
        "cases": cases,
    }
