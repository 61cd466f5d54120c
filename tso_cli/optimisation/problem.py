"""One cloud with its views, prepared for the optimisation."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import numpy as np

from ..cloud.cloud import Cloud
from ..diagnosis.agreement import Agreement
from ..diagnosis.placement import behind_warnings, place, require_overlap
from ..errors import InputError
from ..geometry.view import View
from ..geometry.window import Array, Box, window_of
from ..refinement.config import Settings
from .resampled_view import CELLS, FINE_GRIDS, ResampledView, fine_cells, resample_view
from .symmetry import SymmetryDecision, decide_symmetry

# Evidence that a flipped view counts for, beside the view's own: that the object is symmetric is a guess.
FLIPPED_EVIDENCE = 0.25
# A window is resampled anew where its side changed by more than this (logarithm).
WINDOW_CHANGE = 0.1


@dataclass(frozen=True, eq=False)
class Problem:
    """A cloud and its views.

    Attributes
    ----------
    views : as given. all_views : the same, followed by the flipped ones where a mirror plane is used.
    resampled : of each of ``all_views``. fine_grids : cells a side of each in stages with a fine grid.
    agreement : of points mode, with what may be wrong with the input.
    """

    cloud: Cloud
    views: tuple[View, ...]
    all_views: tuple[View, ...]
    resampled: tuple[ResampledView, ...]
    fine_grids: tuple[int, ...]
    symmetry: SymmetryDecision
    agreement: Agreement | None = None

    @classmethod
    def of(cls, cloud: Cloud, views: tuple[View, ...], settings: Settings) -> Problem:
        """Raises InputError where the cloud's projection misses a mask, or the mode cannot use depth maps or images."""
        _require_supported(cloud, views, settings)
        cloud = cloud.with_parts_on(views).with_moving(settings.points)
        agreement = Agreement.of(cloud.initial, views) if settings.mode == "points" else None
        for view in views:
            placement = place(cloud.initial, view)
            require_overlap(placement, view, agreement.suspicion if agreement else None)
            for text in behind_warnings(placement, view):
                warnings.warn(text, stacklevel=2)
        symmetry = decide_symmetry(cloud, settings.symmetry)
        if symmetry.outcome == "given":
            _require_plane_through(cloud, views, symmetry, settings.symmetry)
        return cls(cloud, (), (), (), (), symmetry, agreement).with_views(views, settings)

    def with_views(self, views: tuple[View, ...], settings: Settings) -> Problem:
        """The same cloud with other views."""
        plane, cloud = self.symmetry.plane, self.cloud
        all_views = views if plane is None else (*views, *(plane.view(view) for view in views))
        resampled = tuple(
            resample_view(
                view, settings.sigma_sq, cloud.centre, cloud.scale, window_of(view, cloud.initial)
            )
            for view in all_views
        )
        fine_grids = tuple(fine_cells(_side(view.box), len(cloud.initial)) for view in resampled)
        return replace(
            self, views=views, all_views=all_views, resampled=resampled, fine_grids=fine_grids
        )

    def with_windows_around(self, points: Array, fine_grid: bool) -> Problem:
        """The same with windows around ``points`` [N, 3] (units of the file), resampled where they change much; else itself.

        A cloud that starts far from its mask needs a large window at first, which would resolve little detail later.
        """
        cloud, grids = self.cloud, self.fine_grids if fine_grid else (CELLS,) * len(self.all_views)
        resampled = []
        for view, current, cells in zip(self.all_views, self.resampled, grids, strict=True):
            box = window_of(view, points)
            same = (
                current.camera.width == cells
                and abs(np.log(_side(box) / _side(current.box))) <= WINDOW_CHANGE
            )
            resampled.append(
                current
                if same
                else resample_view(view, current.sigma_sq, cloud.centre, cloud.scale, box, cells)
            )
        if all(new is old for new, old in zip(resampled, self.resampled, strict=True)):
            return self
        return replace(self, resampled=tuple(resampled))

    @property
    def suspicion(self) -> str | None:
        """What may be wrong with the input, in words; None where all looks right."""
        return self.agreement.suspicion if self.agreement else None

    @property
    def several_large(self) -> bool:
        """Whether there are several masks, and all take the finest grid in the last stage."""
        return len(self.views) > 1 and min(self.fine_grids) == FINE_GRIDS[0][1]

    @property
    def masks_alone(self) -> bool:
        """Whether no view has a depth map or a photo."""
        return all(view.depth is None and view.image is None for view in self.views)

    def evidence(self, weights: list[float]) -> float:
        """Weighted number of masks and depth maps; a flipped mask counts a quarter."""
        flipped = 0.0 if self.symmetry.plane is None else FLIPPED_EVIDENCE
        return sum(
            weight * (1.0 + flipped + (view.depth is not None))
            for weight, view in zip(weights, self.views, strict=True)
        )


def _side(box: Box) -> float:
    return box[2] - box[0]


def _require_supported(cloud: Cloud, views: tuple[View, ...], settings: Settings) -> None:
    for name, used in (
        ("a depth map", any(view.depth is not None for view in views)),
        ("an image", any(view.image is not None for view in views)),
    ):
        if used and not settings.staged:
            raise InputError(
                f"a view has {name}, expected mode points with preset best, found {settings.mode} with {settings.preset}"
            )
    if any(view.image is not None for view in views) and cloud.colours is None:
        raise InputError("a view has an image, expected a cloud with colours, found none")


def _require_plane_through(
    cloud: Cloud, views: tuple[View, ...], decision: SymmetryDecision, symmetry: str
) -> None:
    """Refuse a given plane whose flipped views the cloud does not meet."""
    assert decision.plane is not None
    for view in views:
        flipped = decision.plane.view(view)
        try:
            require_overlap(place(cloud.initial, flipped), flipped)
        except InputError as error:
            raise InputError(
                f"symmetry is {symmetry!r}, expected a plane ax + by + cz = d through the cloud; as it is, {error}"
            ) from None
