"""Where the optimisation begins: the start of a cloud, moved by the learned prior."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..geometry.arrays import Array
from ..geometry.points import root_mean_square
from ..losses.projection import project_differentiably
from ..prior import Frame, LearnedPrior, SeenCloud, Shown
from .objective import ViewTargets
from .problem import Problem, WindowedView

# How often the network looks at the cloud; each time it sees where the cloud has got to.
PASSES = 2
# A start is right if the first step moves it by less, as a root mean square in longest sides. Of
# validation shapes, other shapes and clouds in another place are asked to move further.
RIGHT = 0.002
# The share of a displacement that is taken is the mean loss of the start, px^2 per mask pixel, but
# at least this: a start that fits gains less, and loses as much where the prior is wrong.
LEAST_SHARE = 0.5


@dataclass(frozen=True, eq=False)
class Beginning:
    """Where an optimisation begins.

    points : [N, 3].
    right : whether the learned prior finds that the start is right already.
    asked, sureness : of its first answer, None without one: how far it would move the points, a
        root mean square in longest sides, and `Answer.sureness`.
    """

    points: Array
    right: bool = False
    asked: float | None = None
    sureness: float | None = None


def beginning(problem: Problem, weights: Sequence[float], prior: LearnedPrior) -> Beginning:
    """The start of the ``problem``, moved as the ``prior`` asks for where the masks agree.

    ``weights`` are of the given views.
    """
    start = problem.cloud.start
    targets, frame = problem.targets(weights), Frame.of(start)
    seen = seen_cloud(start, problem.windowed, problem.all_weights(weights), frame)
    answer = seen.ask(prior, start) if seen.views else None
    if answer is None:
        return Beginning(start)
    first, observed = answer, _observed(start, targets)
    asked = root_mean_square(observed * first.displacements) / frame.scale
    # A start that the masks find right may be wrong by a depth map.
    if asked < RIGHT and problem.masks_alone:
        return Beginning(start, True, asked, first.sureness)
    points, lowest = start, targets.loss(start)[0]
    taken = observed * np.clip(lowest / targets.pixels, LEAST_SHARE, 1.0)
    for number in range(PASSES):
        if number:
            answer = seen.ask(prior, points)
        if answer is None:
            break
        moved = points + taken * answer.displacements
        loss = targets.loss(moved)[0]
        if not loss < lowest:
            break
        points, lowest = moved, loss
    return Beginning(points, False, asked, first.sureness)


def seen_cloud(
    start: Array, views: Sequence[WindowedView], weights: Sequence[float], frame: Frame
) -> SeenCloud:
    """The normalised ``start`` [N, 3] and what the ``views`` show of it, for a prior."""
    shown = []
    for windowed, weight in zip(views, weights, strict=True):
        if weight > 0.0:
            view = windowed.resampled
            shown.append(
                Shown.of(
                    view.camera,
                    view.target,
                    start,
                    frame,
                    weight,
                    pixels_per_cell=view.pixels_per_cell,
                    depth=view.depth,
                    metric=view.depth is not None and not windowed.view.depth_fitted,
                )
            )
    return SeenCloud(start, frame, [view for view in shown if view is not None])


def _observed(start: Array, targets: ViewTargets) -> Array:
    """[N, 1], 1 where a picture shows the part around a point, else 0.

    Points beyond the borders of all pictures that truncate the object are not observed.
    """
    observed = np.zeros(len(start), bool)
    for view in targets.views:
        projected = project_differentiably(start, view.camera)
        observed |= view.mask.observed(projected.points_px, projected.valid)
    return observed[:, None].astype(float)
