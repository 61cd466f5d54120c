"""Verification: what short optimisations say of hypotheses."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from ..errors import InputError
from ..geometry.view import View
from ..optimisation.optimise import optimise_points
from ..optimisation.problem import Problem
from ..optimisation.settings import Settings
from ..optimisation.symmetry import SymmetryDecision
from ..optimisation.view_weights import ViewWeights
from .assumptions import Assumption, as_meant
from .examine import Diagnosis
from .findings import Finding

# A weak hypothesis is confirmed if at most this share of the final loss remains under it.
LOSS_LEFT = 0.62
# The short optimisations hold the points loosely: a firm hold would hide how they differ.
PRIOR_WEIGHT, STEPS = 30.0, 20


def verify_hypotheses(
    diagnosis: Diagnosis,
    problem: Problem,
    read: Sequence[View],
    given: Sequence[Assumption],
    settings: Settings,
) -> Diagnosis:
    """The diagnosis, whose weak hypotheses are found or dropped as the optimisation says.

    Silhouettes may agree somewhat better under a hypothesis by chance, and so may those of masks in
    another order. Short optimisations are compared, as given and under each hypothesis, all without
    a mirror plane. An object of another shape fits them about as well; the same object, seen
    rightly, fits far better.

    Nothing is compared with another preset than "best", or with depth maps or photos. Weak
    hypotheses are not confirmed then, and another order of the masks stays a finding. ``read`` are
    the views as they were read, which are meant as the assumptions ``given`` say. Raises
    KeyboardInterrupt where Ctrl-C ended an optimisation.
    """
    if not (diagnosis.unverified and settings.smooth and settings.steps and problem.masks_alone):
        return diagnosis
    start = problem.cloud.start
    weights = ViewWeights.of([windowed.resampled for windowed in problem.given], start).loss
    if diagnosis.otherwise:
        # Views that are paired wrongly contradict the others, and may have hardly a weight.
        about = {mask for one in diagnosis.unverified for mask, _ in closed(one.pairs)}
        weights = [float(number in about) for number in range(len(read))]
    # A bounding box shows nothing of the shape.
    boxes = {view for one in diagnosis.of_views if one.name == "box" for view in one.views}
    weights = [0.0 if number in boxes else weight for number, weight in enumerate(weights)]
    problems, compared = [problem.without_flipped()], []
    for one in diagnosis.unverified:
        # The mask may show nothing where the hypothesis has its object.
        with suppress(InputError):
            views = _views_under(one, read, given)
            problems.append(
                Problem.of(problem.cloud, views, SymmetryDecision("not_asked"), problem.sigma_sq)
            )
            compared.append(one)
    found: list[Finding] = []
    if compared:
        losses = [_final_loss(problem, weights) for problem in problems]
        order = sorted(zip(losses[1:], compared, strict=True), key=lambda pair: pair[0])
        found = [one for loss, one in order if loss < LOSS_LEFT * losses[0]]
    if diagnosis.otherwise and found:
        return diagnosis
    if diagnosis.otherwise:
        otherwise = replace(diagnosis.otherwise, notes=diagnosis.notes)
        return verify_hypotheses(otherwise, problem, read, given, settings)
    if not found:
        return replace(diagnosis, weak=())
    return replace(diagnosis, of_input=tuple(found), weak=(), outvoted=False)


def _final_loss(problem: Problem, weights: Sequence[float]) -> float:
    """The loss that a short optimisation ends with, by the weights of the given views."""
    optimised = optimise_points(problem, weights, STEPS, prior_weight=PRIOR_WEIGHT)
    if optimised.interrupted:
        raise KeyboardInterrupt
    # `best_loss` has no position prior, which says how far the cloud had to move.
    return float(np.nanmin(optimised.losses))


def _views_under(
    hypothesis: Finding, read: Sequence[View], given: Sequence[Assumption]
) -> list[View]:
    """The views as they are meant if a hypothesis is right."""
    assumed = [one for one in given if one != hypothesis.without]
    if not hypothesis.without:
        assumed += map(Assumption, hypothesis.hypotheses)
    views = [as_meant(view, assumed) for view in read]
    paired = dict(closed(hypothesis.pairs))
    return [
        replace(view, camera=views[paired.get(number, number)].camera)
        for number, view in enumerate(views)
    ]


def closed(pairs: Sequence[tuple[int, int]]) -> list[tuple[int, int]]:
    """The (mask, camera) ``pairs``, and a camera for each mask whose own camera another one has.

    An exchange names only the views that gain by it.
    """
    paired = dict(pairs)
    for first in set(paired) - set(paired.values()):
        # Camera ``first`` has lost its mask.
        last = first
        while last in paired:
            last = paired[last]
        paired[last] = first
    return sorted(paired.items())
