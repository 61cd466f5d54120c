"""Which problems share a batch."""

from __future__ import annotations

from typing import Any

from ..errors import InputError
from .problem import Problem

# Most points of a batch; and no cloud of a batch has less than half the points of its largest.
BATCH_POINTS = 1 << 20
# Most cells of a batch's resampled views: bounds memory at 1 GiB in plain torch.
BATCH_CELLS = 1 << 24
# Most clouds of a staged batch: the inverse matrices of a cloud's smooth fields take 12 MiB, so these 0.8 GiB.
BATCH_FIELDS = 64


def points_and_views(scene: Any, number: int) -> tuple[Any, Any]:
    """The two parts of a scene; InputError if it is no pair."""
    try:
        points, views = scene
    except (TypeError, ValueError):
        shown = f"{type(scene).__name__} of {len(scene)}" if hasattr(scene, "__len__") else repr(scene)
        raise InputError(f"scene {number} is {shown}, expected (points, views)") from None
    return points, views


def batches_of(problems: dict[int, Problem], staged: bool = False) -> list[list[int]]:
    """Keys of the problems of each batch: views of one kind, cloud sizes within a factor of two, bounded memory.

    ``staged`` : the clouds move by smooth fields, as the preset "best" does in points mode.
    """
    groups: dict[Any, list[int]] = {}
    for number, problem in problems.items():
        kind = (len(problem.views), problem.fine_grids, *(view.kind for view in problem.resampled))
        groups.setdefault(kind, []).append(number)
    batches: list[list[int]] = []
    for group in groups.values():
        most = BATCH_CELLS // problems[group[0]].cells
        if staged:
            most = min(most, BATCH_FIELDS)
        largest = 0
        for number in sorted(group, key=lambda number: -len(problems[number].cloud.initial)):
            size = len(problems[number].cloud.initial)
            full = largest and (len(batches[-1]) >= most or (len(batches[-1]) + 1) * largest > BATCH_POINTS)
            if not largest or 2 * size < largest or full:
                batches.append([])
                largest = size
            batches[-1].append(number)
    return batches
