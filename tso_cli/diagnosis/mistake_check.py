"""The mistake check: do the views agree far better with the cloud if a common mistake is undone?"""

from __future__ import annotations

import math
from dataclasses import replace

from ..cloud.smooth_field import SmoothField
from ..errors import InputError
from ..optimisation.probe import final_losses, probe
from ..optimisation.problem import Problem
from ..optimisation.symmetry import SymmetryDecision
from ..optimisation.view_weights import ViewWeights
from ..refinement.config import Settings

# Loss that may remain once the mistake is undone, relative to that of the input as given.
MOST_LOSS = 0.62


def checked_hint(
    problem: Problem, settings: Settings, until: float = math.inf
) -> tuple[Problem, bool]:
    """The problem, whose hint is confirmed where a descent says so too; and whether Ctrl-C came, which ends the check.

    Silhouettes that agree somewhat better under an assumption (`Agreement.hint`) may do so by chance. Two short descents are
    compared, as given and under the assumption, both without a mirror plane: an object of another shape fits both about as
    well, the same one seen rightly fits far better. Nothing is confirmed of another preset than "best", with depth maps or
    photos, or without time for it ``until`` then (`final_losses`).
    """
    agreement = problem.agreement
    if not (
        agreement and agreement.hint and settings.staged and settings.steps and problem.masks_alone
    ):
        return problem, False
    given = replace(problem, resampled=problem.resampled[: len(problem.views)])
    without_plane = replace(problem, symmetry=SymmetryDecision("not_asked"))
    points = problem.cloud.normalised()
    field, weights = SmoothField(points), ViewWeights.of(given.resampled, points).loss
    try:
        mended = without_plane.with_views(
            tuple(map(agreement.hint.assumption.read, problem.views)), settings
        )
        losses = final_losses([probe(views, weights, field) for views in (given, mended)], until)
    except InputError:
        # A mask that shows nothing where the assumption has its object.
        return problem, False
    except KeyboardInterrupt:
        return problem, True
    confirmed = losses is not None and losses[1] < MOST_LOSS * losses[0]
    return replace(problem, agreement=replace(agreement, confirmed=confirmed)), False
