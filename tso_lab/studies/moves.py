"""What moving as one brings to clouds of the right and of a wrong shape in a wrong place."""

from __future__ import annotations

import time
import zlib
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tso_cli.evaluation.metrics import chamfer
from tso_cli.geometry.camera import Camera
from tso_cli.geometry.points import Array, bounding_box_normalisation
from tso_cli.geometry.rotations import from_vectors
from tso_cli.pose import Asked
from tso_cli.refinement import RefineConfig, refine

from .. import options
from ..charts import Rows, bars
from ..options import option
from ..study import Cases, Plan, Progress, Record, Study, Table, uninterrupted
from .cases import Case, CaseBuilder, kinds_of
from .shapes import Shape, shapes_of_part
from .summary import grouped, nested_rows, rounded

CATEGORIES = ("chair", "airplane", "car")
KINDS = ("right", "near", "other")
# Degrees that a cloud is turned by -> how far it is shifted, and the share of its change of size.
ERRORS = {0.0: 0.0, 1.0: 0.01, 3.0: 0.03, 6.0: 0.06, 12.0: 0.1}
ERRORS_OF_WRONG = (0.0, 6.0)
WAYS: tuple[Asked, ...] = ("shape", "auto", "pose", "similarity")
NEAR_FLOOR = 1.3
"""Times the floor: a cloud of the right shape counts as brought back."""
WORSE = 1.05
"""Times the start: a result counts as worse."""
MOST_SCALING = 0.15
"""Of the logarithm: how far a cloud is scaled about its camera before it is compared."""


def plan(
    progress: Progress,
    *,
    meshes: Path,
    split: Path | None,
    categories: tuple[str, ...] = CATEGORIES,
    sizes: Sequence[int],
    **settings: Any,
) -> Plan:
    """Refine clouds that are wrongly placed by one mask, in each way.

    By masks of all but the first of the ``sizes``, clouds of the right shape are moved alone.
    """
    shapes = shapes_of_part(meshes, split, settings["part"], categories, settings["limit"])
    views, seed = settings["views"], settings["seed"]
    builders = {size: CaseBuilder(meshes, split, views, size, 1024, seed) for size in sizes}
    settings |= {"sizes": list(sizes), "shapes": [shape.name for shape in shapes]}

    def of_shape(shape: Shape, size: int) -> Cases:
        first = size == sizes[0]
        kinds = kinds_of(shape.category, KINDS) if first else ("right",)
        cases = [case for kind in kinds for case in builders[size].cases(shape, kind)]
        return [row for case in cases for row in moved_case(case, WAYS if first else ("pose",))]

    jobs = [
        ({"shape": shape.name, "size": size}, partial(of_shape, shape, size))
        for shape in shapes
        for size in sizes
    ]
    return Plan(settings, jobs, "moving")


def moved_case(case: Case, ways: Sequence[Asked]) -> Cases:
    """The results of one case, wrongly placed by each error, in each of the ``ways``."""
    view, row = case.views[0], Record()
    floor = up_to_scaling(case.initial, case.target, view.camera)
    rows = []
    for degrees in ERRORS if case.kind == "right" else ERRORS_OF_WRONG:
        start = misplaced(case, degrees)
        before = up_to_scaling(start, case.target, view.camera)
        for way in ways:
            begun = time.perf_counter()
            result = uninterrupted(refine(start, view, config=RefineConfig(move=way)))
            seconds = time.perf_counter() - begun
            after = up_to_scaling(result.points, case.target, view.camera)
            row = {**case.names, "size": view.camera.width, "degrees": degrees, "way": way}
            row |= {"moved_as": result.move.kind, "before": 1e3 * before, "after": 1e3 * after}
            row |= {"floor": 1e3 * floor, "bent": result.fit.moved_mean}
            row |= {"confidence": result.trust.confidence, "seconds": seconds}
            rows.append(rounded(row))
    return rows


def misplaced(case: Case, degrees: float) -> Array:
    """The start of ``case``, turned about a random axis, shifted and scaled by `ERRORS`."""
    error = ERRORS[degrees]
    words = zlib.crc32(f"{case.shape} {case.kind} {case.view} {degrees:g}".encode())
    rng = np.random.default_rng(words)
    axis, shift = (vector / np.linalg.norm(vector) for vector in rng.normal(size=(2, 3)))
    size = (1.0 + error) ** rng.choice([-1.0, 1.0])
    centre, unit = bounding_box_normalisation(case.initial)
    turn = from_vectors(np.radians(degrees) * axis)
    return size * (case.initial - centre) @ turn.T + centre + unit * error * shift


def up_to_scaling(points: Array, truth: Array, camera: Camera) -> float:
    """The Chamfer distance after the scaling about ``camera`` that makes it smallest."""
    from scipy.optimize import minimize_scalar

    def error(logarithm: float) -> float:
        scaled = camera.position + np.exp(logarithm) * (points - camera.position)
        return chamfer(scaled, truth).chamfer

    bounds = (-MOST_SCALING, MOST_SCALING)
    best = minimize_scalar(error, bounds=bounds, method="bounded", options={"xatol": 1e-3})
    return float(min(best.fun, error(0.0)))


def conclude(cases: Cases) -> Record:
    """Ratios of errors, and shares of the cases: of each kind of start, error and way, and of each
    size of masks for clouds of the right shape that move.
    """
    first = [row for row in cases if row["size"] == cases[0]["size"]]
    of_moves = [row for row in cases if row["kind"] == "right" and row["way"] == "pose"]
    summary: Record = {}
    for kind, of_kind in grouped(first, "kind").items():
        for degrees, rows in grouped(of_kind, "degrees").items():
            name = f"{kind}, {degrees:g} degrees off"
            summary[name] = {way: _figures(group) for way, group in grouped(rows, "way").items()}
    by_size = {
        f"right, {degrees:g} degrees off": {
            f"{size} px": _figures(group) for size, group in sorted(grouped(rows, "size").items())
        }
        for degrees, rows in grouped(of_moves, "degrees").items()
    }
    return {"summary": summary, "by_size": by_size}


def _figures(rows: Cases) -> Record:
    before, after, floor, bent = (
        np.array([row[key] for row in rows]) for key in ("before", "after", "floor", "bent")
    )
    return {
        "cases": len(rows),
        "before": float(before.mean()),
        "after": float(after.mean()),
        "floor": float(floor.mean()),
        "mean_ratio": float((after / before).mean()),
        "near_floor": float((after <= NEAR_FLOOR * floor).mean()),
        "worse": float((after > WORSE * before).mean()),
        "moved": float(np.mean([row["moved_as"] != "nothing" for row in rows])),
        "bent": float(bent.mean()),
        "median_seconds": float(np.median([row["seconds"] for row in rows])),
    }


def tables(record: Record) -> list[Table]:
    """A row for each start and way."""
    header = ["cases", "before", "after", "floor", "after / before"]
    header += ["within 1.3 floors", "over 5 % worse", "moved as one", "bent", "s"]
    return [
        Table(["start", what, *header], nested_rows(record[part]))
        for part, what in (("summary", "--move"), ("by_size", "mask"))
    ]


def panels(record: Record) -> Rows:
    """For each start the error that is left in each way."""
    rows = {
        start: {f"--move {way}": figures["mean_ratio"] for way, figures in ways.items()}
        for start, ways in record["summary"].items()
    }
    return {"error after / before, mean": rows}


STUDY = Study(
    name="moves",
    parts=("pictures", "points, best", "camera fit"),
    tables=tables,
    draw=bars(panels),
    options=(
        *options.COMMON,
        options.part("test"),
        options.views(1),
        option(
            "--size",
            "Width and height of the masks, px. May be repeated: by further sizes, clouds of the "
            "right shape are moved alone.",
            int,
            (256, 64, 1024),
            least=16,
            multiple=True,
            name="sizes",
        ),
    ),
    plan=plan,
    conclude=conclude,
)
