"""What moved as one, as sentences and for JSON."""

from __future__ import annotations

from typing import Any

import numpy as np

from ...geometry.arrays import Array
from ...pose.fit import FittedCamera
from ...pose.move import Move, PoseDeviation
from ...refinement import RefineResult


def move_document(move: Move, fitted: FittedCamera | None) -> dict[str, Any]:
    """For JSON."""
    return {
        "moved_as": move.kind,
        "transform": move.matrix.tolist(),
        "kept": move.keep,
        "missed": None if np.isnan(move.missed) else [move.missed_before, move.missed],
        "exact_to": deviation_document(exact_to_of(move, fitted)),
    }


def exact_to_of(move: Move, fitted: FittedCamera | None) -> PoseDeviation | None:
    """How exact the place is, or the pose of the fitted camera."""
    return fitted.exact_to if fitted is not None else move.exact_to


def deviation_document(exact_to: PoseDeviation | None) -> dict[str, Any] | None:
    """For JSON."""
    if exact_to is None:
        return None
    degrees, shift = exact_to.degrees.tolist(), exact_to.shift.tolist()
    return {"degrees": degrees, "shift": shift, "size": exact_to.size}


def alternatives_of(fitted: FittedCamera | None, move: Move) -> list[dict[str, Any]]:
    """For JSON: the other poses of a fitted camera, or of a cloud that was searched everywhere."""
    if fitted is not None:
        return [
            {
                "pose_index": number,
                "missed": pose.missed,
                "iou": pose.iou,
                "degrees": pose.degrees,
                "unlike_photo": pose.unlike_photo,
                **{name: getattr(pose.camera, name).tolist() for name in ("K", "R", "t")},
            }
            for number, pose in enumerate(fitted.alternatives, 1)
        ]
    return [
        {"missed": missed, "transform": matrix.tolist()} for missed, matrix in move.alternatives
    ]


def words_of_move(move: Move, start: Array) -> str:
    """How the cloud ``start`` [N, 3] moved as one; "" where it did not."""
    if move.kind in ("nothing", "camera"):
        return ""
    middle = (start.min(0) + start.max(0)) / 2.0
    side = np.ptp(start, axis=0).max()
    shift = np.linalg.norm(move.apply(middle[None])[0] - middle) / side
    parts = [f"shifted by {100.0 * shift:.1f} % of its size"]
    if move.kind != "shift":
        parts.insert(0, f"turned by {move.degrees:.1f} degrees")
    if move.kind == "similarity":
        parts.append(f"scaled by {move.size:.3f}")
    kept = f" (its {move.keep} is kept)" if move.keep else ""
    return f"as one: {', '.join(parts)}{kept}"


def words_of_deviation(exact_to: PoseDeviation | None) -> str:
    """How exactly a place is determined; "" where that is not known."""
    if exact_to is None:
        return ""
    degrees, shift = (np.linalg.norm(part) for part in (exact_to.degrees, exact_to.shift))
    size = f", {100.0 * exact_to.size:.2g} % of its size" if exact_to.size else ""
    return f"exact to {degrees:.2g} degrees, {shift:.2g} in its units{size} (standard deviations)"


def start_of(result: RefineResult) -> Array:
    """The initial cloud without outliers."""
    start: Array = result.initial[~result.outliers]
    return start


def words_of_search(move: Move) -> str:
    """Whether something moved as one, and what was found."""
    if move.kind == "nothing":
        return f"no: {move.why_unmoved}"
    missed = f"the cloud misses {move.missed_before:.0%} of the contours as given"
    after = f"{move.missed:.0%} after it moved as one"
    return f"yes: {missed}, {after}{'' if move.explains else ': it does not explain the misfit'}"


def reading_of(move: Move, option: str, start: Array) -> str | None:
    """What a move of the cloud ``start`` [N, 3] may mean, unless the ``option`` --move named it."""
    if option != "auto" or move.kind == "nothing":
        return None
    how = words_of_move(move, start).removeprefix("as one: ")
    return (
        f"the cloud was {how}, which explains why it did not fit: use --move pose if the camera is "
        "right, --move camera if the cloud is, and --move shape if both are"
    )
