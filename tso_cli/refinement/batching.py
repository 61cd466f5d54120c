"""What is refined, and which of many are worked on together."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from ..errors import InputError
from ..objective import WorkingView, working_view
from ..placement import place, require_overlap
from ..scene import View
from .config import RefineConfig
from .starts import Cloud

# Clouds of one batch hold no more points than this together, and none less than half as many as the largest.
BATCH_POINTS = 1 << 20
# Their views hold no more pixels than this together, as the loop sees them: bounds memory at 1 GiB in plain torch.
BATCH_PIXELS = 1 << 24


@dataclass(frozen=True, eq=False)
class Item:
    """A cloud and what asks it."""

    cloud: Cloud
    views: tuple[View, ...]
    working: tuple[WorkingView, ...]

    @classmethod
    def of(cls, cloud: Cloud, views: tuple[View, ...], config: RefineConfig) -> Item:
        """Raises InputError where cloud and views do not meet."""
        for view in views:
            require_overlap(place(cloud.initial, view), view)
        working = tuple(working_view(view, config.sigma_sq, cloud.centre, cloud.scale) for view in views)
        return cls(cloud, views, working)

    @property
    def pixels(self) -> int:
        """Of all views as the loop sees them."""
        return sum(view.mask.size for view in self.working)


def parts_of(scene: Any, number: int) -> tuple[Any, Any]:
    """Points and views of the scene of that number; InputError if it is no pair."""
    try:
        points, views = scene
    except (TypeError, ValueError):
        found = f"{type(scene).__name__} of {len(scene)}" if hasattr(scene, "__len__") else repr(scene)
        raise InputError(f"scene {number} is {found}, expected (points, views)") from None
    return points, views


def batches_of(items: dict[int, Item]) -> list[list[int]]:
    """Numbers of the items that are worked on together: views of one kind, sizes within a factor of two, bounded memory."""
    groups: dict[Any, list[int]] = {}
    for number, item in items.items():
        groups.setdefault(tuple(view.kind for view in item.working), []).append(number)
    batches: list[list[int]] = []
    for group in groups.values():
        most = BATCH_PIXELS // items[group[0]].pixels
        largest = 0
        for number in sorted(group, key=lambda number: -len(items[number].cloud.initial)):
            size = len(items[number].cloud.initial)
            full = largest and (len(batches[-1]) >= most or (len(batches[-1]) + 1) * largest > BATCH_POINTS)
            if not largest or 2 * size < largest or full:
                batches.append([])
                largest = size
            batches[-1].append(number)
    return batches
