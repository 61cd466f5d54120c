"""What is refined, and which of many are worked on together."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..device import one_thread
from ..errors import InputError
from ..geometry.view import View
from ..geometry.window import Array, Box, window_of
from .config import Settings, SymmetryOutcome, parse_symmetry
from .objective import CELLS, ResampledView, resample_view
from .parameters import Cloud
from .placement import place, require_overlap
from .symmetry import FAR_MISFIT, MEAN_MISFIT, MirrorPlane, find_mirror_plane

# Clouds of one batch hold no more points than this together, and none less than half as many as the largest.
BATCH_POINTS = 1 << 20
# Their views hold no more pixels than this together, as the loop sees them: bounds memory at 1 GiB in plain torch.
BATCH_PIXELS = 1 << 24
# What smooths the fields of one cloud are dense matrices of 12 MiB together: with this many, 0.8 GiB.
BATCH_FIELDS = 64
# What a flipped mask counts for. It tells as much as one where the object is its own mirror image; that it is so is a guess.
FLIPPED = 0.25
# From so many pixels along the window's side the last stage has so many cells there; a sparser cloud cannot follow them. More
# cells than these bring nothing, at 16,384 points neither.
FINER_FROM = (96.0, 128), (48.0, 96)
FEWEST_FOR_FINER = 512
# A window is laid anew where its side changes by more than this (logarithm).
FOLLOWED = 0.1


@dataclass(frozen=True, eq=False)
class Problem:
    """A cloud and what asks it.

    Attributes
    ----------
    views : what asks. shown : the same, followed by the mirrored ones where ``plane`` is one. working : these as the loop
        sees them. grids : cells along the side of the window of each of these in stages that take the finest grid.
    symmetry_outcome, symmetry_reason : as in `RefineResult`.
    """

    cloud: Cloud
    views: tuple[View, ...]
    shown: tuple[View, ...]
    working: tuple[ResampledView, ...]
    grids: tuple[int, ...]
    plane: MirrorPlane | None
    symmetry_outcome: SymmetryOutcome
    symmetry_reason: str

    @classmethod
    def of(cls, cloud: Cloud, views: tuple[View, ...], config: Settings) -> Problem:
        """Raises InputError where cloud and views do not meet."""
        if not config.staged and any(view.depth is not None for view in views):
            raise InputError(
                f"a view has a depth map, expected mode points with preset best, found {config.mode} with {config.preset}"
            )
        if any(view.image is not None for view in views):
            if not config.staged:
                raise InputError(
                    f"a view has an image, expected mode points with preset best, found {config.mode} with {config.preset}"
                )
            if cloud.colours is None:
                raise InputError("a view has an image, expected a cloud with colours, found none")
        for view in views:
            require_overlap(place(cloud.initial, view), view)
        plane, outcome, reason = mirror_plane(cloud, config.symmetry)
        if plane is not None and config.symmetry != "auto":
            _require_meeting(cloud, [plane.view(view) for view in views], config.symmetry)
        return cls(cloud, (), (), (), (), plane, outcome, reason).seen_by(views, config)

    def seen_by(self, views: tuple[View, ...], config: Settings) -> Problem:
        """The same cloud, asked by other views."""
        shown = views if self.plane is None else (*views, *(self.plane.view(view) for view in views))
        cloud = self.cloud
        working = tuple(
            resample_view(view, config.sigma_sq, cloud.centre, cloud.scale, window_of(view, cloud.initial)) for view in shown
        )
        grids = tuple(finest_grid(_side(seen.box), len(cloud.initial)) for seen in working)
        return replace(self, views=views, shown=shown, working=working, grids=grids)

    def followed(self, points: Array, finest: bool) -> Problem:
        """The same with the windows around the cloud ``points`` [N, 3] as it is now, where they are much smaller or larger, on
        the finest grids or on those of 64 cells.

        A cloud that starts far from its mask needs a large window at first, and would see little detail in it later.
        """
        cloud, grids = self.cloud, self.grids if finest else (CELLS,) * len(self.shown)
        working = []
        for view, seen, cells in zip(self.shown, self.working, grids, strict=True):
            box = window_of(view, points)
            same = seen.camera.width == cells and abs(np.log(_side(box) / _side(seen.box))) <= FOLLOWED
            working.append(seen if same else resample_view(view, seen.sigma_sq, cloud.centre, cloud.scale, box, cells))
        return replace(self, working=tuple(working))

    def pictures(self, weights: list[float]) -> float:
        """How many masks and depth maps there are, each by its weight; a flipped mask counts for a quarter of its mask."""
        flipped = 0.0 if self.plane is None else FLIPPED
        return sum(
            weight * (1.0 + flipped + (view.depth is not None)) for weight, view in zip(weights, self.views, strict=True)
        )

    @property
    def pixels(self) -> int:
        """Of all views as the loop sees them."""
        return sum(view.mask.size for view in self.working)


def finest_grid(side: float, points: int) -> int:
    """Cells along the side of a window of ``side`` pixels of the mask, for the last stage of a cloud of so many points."""
    if points < FEWEST_FOR_FINER:
        return CELLS
    return next((cells for pixels, cells in FINER_FROM if side >= pixels), CELLS)


def _side(box: Box) -> float:
    return box[2] - box[0]


def _require_meeting(cloud: Cloud, flipped: list[View], symmetry: str) -> None:
    """Refuse a plane that takes the cloud away from its flipped pictures."""
    for view in flipped:
        with warnings.catch_warnings():
            # Of points behind the camera the picture itself has warned.
            warnings.simplefilter("ignore")
            try:
                require_overlap(place(cloud.initial, view), view)
            except InputError as error:
                raise InputError(
                    f"symmetry is {symmetry!r}, expected a plane ax + by + cz = d through the cloud; as it is, {error}"
                ) from None


def mirror_plane(cloud: Cloud, symmetry: str) -> tuple[MirrorPlane | None, SymmetryOutcome, str]:
    """The plane that ``symmetry`` (as in `RefineConfig`) means for a cloud, what it is, and why."""
    wanted = parse_symmetry(symmetry)
    if wanted == "none":
        return None, "not_asked", "none asked for"
    if wanted == "auto":
        # In the units of the loop, and rounded far below what a sampling tells: neither unit nor origin of the input shows.
        with one_thread(True):
            found = find_mirror_plane(cloud.normalised())
        normal = found.normal.round(6) / np.linalg.norm(found.normal.round(6))
        offset = cloud.scale * round(found.offset, 6) + float(normal @ cloud.centre)
        plane = replace(found, normal=normal, offset=offset)
        limits = f"(at most {MEAN_MISFIT} and {FAR_MISFIT})"
        if not plane.symmetric:
            return None, "none_found", f"{_fit(plane)}, too far {limits}"
        return plane, "used", f"{_fit(plane)} {limits}"
    if isinstance(wanted, str):
        normal = np.eye(3)["xyz".index(wanted)]
        plane = MirrorPlane(normal, float(normal @ cloud.centre))
    else:
        length = float(np.linalg.norm(wanted[:3]))
        plane = MirrorPlane(np.array(wanted[:3]) / length, wanted[3] / length)
    plane = plane.judged(cloud.initial)
    return plane, "given", f"given; {_fit(plane)}"


def _fit(plane: MirrorPlane) -> str:
    return f"the mirrored cloud lies {plane.misfit:.2f} spacings from the cloud on average, {plane.far:.2f} at its worst"


def parts_of(scene: Any, number: int) -> tuple[Any, Any]:
    """Points and views of the scene of that number; InputError if it is no pair."""
    try:
        points, views = scene
    except (TypeError, ValueError):
        found = f"{type(scene).__name__} of {len(scene)}" if hasattr(scene, "__len__") else repr(scene)
        raise InputError(f"scene {number} is {found}, expected (points, views)") from None
    return points, views


def batches_of(items: dict[int, Problem], staged: bool = False) -> list[list[int]]:
    """Numbers of the items that are worked on together: views of one kind, sizes within a factor of two, bounded memory.

    ``staged`` : they are moved by smooth fields, as the preset "best" does.
    """
    groups: dict[Any, list[int]] = {}
    for number, item in items.items():
        groups.setdefault((len(item.views), item.grids, *(view.kind for view in item.working)), []).append(number)
    batches: list[list[int]] = []
    for group in groups.values():
        most = BATCH_PIXELS // items[group[0]].pixels
        if staged:
            most = min(most, BATCH_FIELDS)
        largest = 0
        for number in sorted(group, key=lambda number: -len(items[number].cloud.initial)):
            size = len(items[number].cloud.initial)
            full = largest and (len(batches[-1]) >= most or (len(batches[-1]) + 1) * largest > BATCH_POINTS)
            if not largest or 2 * size < largest or full:
                batches.append([])
                largest = size
            batches[-1].append(number)
    return batches
