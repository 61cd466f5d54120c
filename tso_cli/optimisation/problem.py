"""One cloud with its views, prepared for the optimisation: plain data."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

from ..cloud.cloud import ControlledCloud
from ..errors import InputError
from ..geometry.arrays import Array
from ..geometry.view import View
from ..geometry.window import window_of
from .config import Settings
from .objective import ViewTargets
from .resampled_view import CELLS, FINE_CELLS, ResampledView, resample_view
from .symmetry import SymmetryDecision, decide_symmetry


@dataclass(frozen=True, eq=False)
class WindowedView:
    """A view, resampled to its window."""

    view: View
    resampled: ResampledView


@dataclass(frozen=True, eq=False)
class Problem:
    """A cloud and the views that it is to agree with.

    Attributes
    ----------
    given : the views that were given, in the axes of the cloud.
    flipped : what a mirror plane makes of each of them; empty without a plane.
    """

    cloud: ControlledCloud
    given: tuple[WindowedView, ...]
    flipped: tuple[WindowedView, ...]
    symmetry: SymmetryDecision
    sigma_sq: float

    @classmethod
    def of(
        cls,
        cloud: ControlledCloud,
        views: Iterable[View],
        symmetry: SymmetryDecision,
        sigma_sq: float,
    ) -> Problem:
        """With the views resampled to windows around mask and cloud."""
        views, plane = tuple(views), symmetry.plane
        flipped = () if plane is None else tuple(map(plane.flipped, views))
        windowed_views, mirrored = (
            windowed(group, cloud, sigma_sq, cloud.control_points) for group in (views, flipped)
        )
        return cls(cloud, windowed_views, mirrored, symmetry, sigma_sq)

    @property
    def views(self) -> tuple[View, ...]:
        """The views that were given."""
        return tuple(windowed.view for windowed in self.given)

    @property
    def windowed(self) -> tuple[WindowedView, ...]:
        """The views that were given, then the flipped ones."""
        return (*self.given, *self.flipped)

    @property
    def resampled(self) -> list[ResampledView]:
        """Those of `windowed`."""
        return [windowed.resampled for windowed in self.windowed]

    def finely_around(self, points: Array) -> Problem:
        """The same with windows of finer cells around normalised ``points`` [N, 3].

        A cloud that starts far from its mask has a large window, which would resolve little after
        the learned prior has moved the cloud.
        """
        around = self.cloud.denormalise(points)
        fine, fine_flipped = (
            windowed([w.view for w in group], self.cloud, self.sigma_sq, around, FINE_CELLS)
            for group in (self.given, self.flipped)
        )
        return replace(self, given=fine, flipped=fine_flipped)

    def targets(self, weights: Sequence[float]) -> ViewTargets:
        """Of all views; ``weights`` are of the given views, and count for the flipped ones too."""
        return ViewTargets.of(self.resampled, self.all_weights(weights))

    def all_weights(self, weights: Sequence[float]) -> list[float]:
        """The ``weights`` of the given views, for all views."""
        return [*weights, *weights] if self.flipped else [*weights]

    @property
    def masks_alone(self) -> bool:
        """Whether no view has a depth map."""
        return all(view.depth is None for view in self.views)


def prepare(cloud: ControlledCloud, views: Sequence[View], settings: Settings) -> Problem:
    """The problem of a cloud and ``views`` in its axes, with a mirror plane if the cloud has one.

    Raises InputError where the mode cannot use depth maps, or a mask has no foreground in its
    window.
    """
    _require_supported(views, settings)
    symmetry = decide_symmetry(cloud, settings.symmetry)
    return Problem.of(cloud, views, symmetry, settings.sigma_sq)


def windowed(
    views: Sequence[View],
    cloud: ControlledCloud,
    sigma_sq: float,
    points: Array,
    cells: int = CELLS,
) -> tuple[WindowedView, ...]:
    """Each view in its window around its mask and ``points`` [N, 3], in the unit of the source."""
    frame = sigma_sq, cloud.centre, cloud.scale
    return tuple(
        WindowedView(view, resample_view(view, *frame, window_of(view, points), cells))
        for view in views
    )


def _require_supported(views: Sequence[View], settings: Settings) -> None:
    if any(view.depth is not None for view in views) and not settings.smooth:
        raise InputError(
            "a view has a depth map, expected mode points with preset best, "
            f"found {settings.mode} with {settings.preset}"
        )
