"""How well a camera is found from mask and cloud alone, for true clouds and for wrong ones."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from tso_cli.geometry.points import Array
from tso_cli.geometry.rotations import angle_between
from tso_cli.pose.fit import FittedCamera, fit_camera

from .. import options
from ..charts import Rows, bars
from ..study import Cases, Plan, Progress, Record, Study, Table, by_shape
from .cases import Case, CaseBuilder, kinds_of
from .shapes import Shape, shapes_of_part
from .summary import grouped, rounded

CATEGORIES = ("chair", "airplane", "car")
TRUE, KNOWN = "true cloud", "true cloud, K known"
CLOUDS = {
    "other": "another shape at the paper's error level",
    "near": "another shape near the truth",
}
RIGHT_DEGREES, EXACT_DEGREES = 15.0, 3.0
"""Up to these angles a rotation counts as found, and as found exactly."""


def plan(
    progress: Progress,
    *,
    meshes: Path,
    split: Path | None,
    categories: tuple[str, ...] = CATEGORIES,
    **settings: Any,
) -> Plan:
    """Fit a camera to one 64x64 mask of each case and compare it with the true camera."""
    shapes = shapes_of_part(meshes, split, settings["part"], categories, settings["limit"])
    builder = CaseBuilder(meshes, split, settings["views"], 64, 1024, settings["seed"])

    def fit_shape(shape: Shape) -> Cases:
        kinds = kinds_of(shape.category, tuple(CLOUDS))
        cases = [case for kind in kinds for case in builder.cases(shape, kind)]
        return [row for case in cases for row in fit_case(case)]

    return by_shape(settings, shapes, fit_shape, "fitting")


def fit_case(case: Case) -> Cases:
    """The fitted cameras of the clouds of one case; kind "other" includes the true cloud."""
    view = case.views[0]
    clouds: dict[str, tuple[Array, Array | None]] = {CLOUDS[case.kind]: (case.initial, None)}
    if case.kind == "other":
        clouds |= {TRUE: (case.target, None), KNOWN: (case.target, view.camera.K)}
    rows = []
    for name, (cloud, K) in clouds.items():
        start = time.perf_counter()
        fitted = fit_camera(cloud, view.mask, K=K)
        seconds = time.perf_counter() - start
        rows.append({"cloud": name, **case.names, **figures(case, fitted), "seconds": seconds})
    return [rounded(row) for row in rows]


def figures(case: Case, fitted: FittedCamera) -> Record:
    """How far the fitted camera and its alternatives are from the true one."""
    true = case.views[0].camera
    answers = [fitted.camera, *(alternative.camera for alternative in fitted.alternatives)]
    degrees = [float(angle_between(answer.R, true.R)) for answer in answers]
    shortest, longest = (focal / true.K[0, 0] for focal in fitted.focal_range)
    angles = {"sure": fitted.sure, "degrees": degrees[0], "answers": min(degrees)}
    return {**angles, "shortest": shortest, "longest": longest}


def conclude(cases: Cases) -> Record:
    """For each cloud medians, and counts of cases within 3 and 15 degrees."""

    def right(rows: Cases, key: str, degrees: float = RIGHT_DEGREES) -> int:
        return sum(row[key] <= degrees for row in rows)

    def median(rows: Cases, key: str) -> float:
        return float(np.median([row[key] for row in rows]))

    summary, by_cloud = {}, grouped(cases, "cloud")
    for name in (KNOWN, TRUE, *CLOUDS.values()):
        if rows := by_cloud.get(name):
            sure = [row for row in rows if row["sure"]]
            summary[name] = {
                "cases": len(rows),
                "median_degrees": median(rows, "degrees"),
                "exact": right(rows, "degrees", EXACT_DEGREES),
                "right": right(rows, "degrees"),
                "answers": right(rows, "answers"),
                "sure": len(sure),
                "sure_right": right(sure, "degrees"),
                "shortest": median(rows, "shortest"),
                "longest": median(rows, "longest"),
                "median_seconds": median(rows, "seconds"),
            }
    return {"summary": summary}


def tables(record: Record) -> list[Table]:
    """A row for each cloud."""
    header = ["cloud", "cases", "median degrees", "within 3", "within 15"]
    header += ["one of the answers within 15", "sure", "sure and within 15"]
    header += ["shortest focal length / true", "longest", "s"]
    return [Table(header, [[name, *row.values()] for name, row in record["summary"].items()])]


def panels(record: Record) -> Rows:
    """For each cloud how many cases are found, by the first answer and by any, and called sure."""
    labels = {
        "right": "the first answer within 15 degrees",
        "answers": "one of the answers",
        "sure": "sure",
        "sure_right": "sure and within 15",
    }
    rows = {
        cloud: {label: 100.0 * row[key] / row["cases"] for key, label in labels.items()}
        for cloud, row in record["summary"].items()
    }
    return {"% of the cases": rows}


STUDY = Study(
    name="pose",
    parts=("pictures", "camera fit"),
    tables=tables,
    draw=bars(panels),
    options=(*options.COMMON, options.part("validation"), options.views(2)),
    plan=plan,
    conclude=conclude,
)
