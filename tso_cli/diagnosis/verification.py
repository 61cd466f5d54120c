"""Verification: what short optimisations say of hypotheses, and of a mirror plane."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

from ..cloud.smooth_field import SmoothField
from ..errors import InputError
from ..geometry.view import View
from ..optimisation.comparison import final_losses
from ..optimisation.problem import Problem
from ..optimisation.settings import Settings
from ..optimisation.symmetry import SymmetryCheck, SymmetryDecision, SymmetryOutcome
from ..optimisation.view_weights import ViewWeights
from .assumptions import Assumption, as_meant
from .examine import Diagnosis
from .findings import Finding

# A weak hypothesis is confirmed if at most this share of the final loss remains under it.
LOSS_LEFT = 0.62
# A mirror plane is kept if the final loss per view grows at most by this factor when the flipped
# views are added. Several masks need the plane less than one mask does.
LOSS_RATIO_OF_ONE, LOSS_RATIO_OF_SEVERAL = 1.15, 1.1


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
    without_plane = problem.with_symmetry(SymmetryDecision("not_asked"))
    problems, compared = [problem.without_flipped()], []
    for one in diagnosis.unverified:
        # The mask may show nothing where the hypothesis has its object.
        with suppress(InputError):
            problems.append(without_plane.with_views(_views_under(one, read, given)))
            compared.append(one)
    found: list[Finding] = []
    if compared:
        losses = final_losses(problems, weights, SmoothField(start))
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


def verify_plane(problem: Problem, weights: Sequence[float], field: SmoothField) -> Problem:
    """The problem, without a mirror plane that was found if the views contradict it.

    Two short optimisations are compared, with and without the flipped views. A symmetric object
    fits both views at once. If the object is not symmetric, a view and its flipped view contradict
    each other, and more loss remains.

    ``weights`` are of the given views; ``field`` is of the start. Raises KeyboardInterrupt where
    Ctrl-C ended an optimisation.
    """
    losses = final_losses((problem, problem.without_flipped()), weights, field)
    ratio = losses[0] / max(2.0 * losses[1], 1e-300)
    limit = LOSS_RATIO_OF_ONE if len(weights) == 1 else LOSS_RATIO_OF_SEVERAL
    passed = ratio <= limit or losses[0] == 0.0
    outcome: SymmetryOutcome = "used" if passed else "contradicted"
    check = SymmetryCheck(ratio, limit)
    return problem.with_symmetry(replace(problem.symmetry, outcome=outcome, check=check))
