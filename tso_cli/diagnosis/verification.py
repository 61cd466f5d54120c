"""Verification: what the contours say of hypotheses that silhouettes hardly show."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

from ..errors import InputError
from ..geometry.view import View
from ..pose.causes import missed_if_stretched
from ..pose.move import Body
from .assumptions import Assumption, as_meant
from .examine import Diagnosis
from .findings import Finding

# A hypothesis is confirmed if a cloud of other proportions misses less than this share of what it
# misses as given. In 30 thin objects and 43 clouds of other shapes, rightly given, hypotheses that
# silhouettes suggest leave over 0.9; three quarters of the true ones leave less.
LEFT = 0.88
# There are many other orders of the masks, so one must leave less: 93 % of exchanged masks do.
LEFT_OF_ORDER = 0.8


def verify_hypotheses(
    diagnosis: Diagnosis, body: Body, read: Sequence[View], given: Sequence[Assumption]
) -> Diagnosis:
    """The diagnosis, whose weak hypotheses are found or dropped as the contours say.

    Silhouettes may agree somewhat better under a hypothesis by chance, and so may those of masks in
    another order. The shape of the cloud may be wrong too, so that it may stretch, as given and
    under each hypothesis. ``read`` are the views as they were read, which are meant as the
    assumptions ``given`` say.
    """
    if not diagnosis.unverified:
        return diagnosis
    shown = set(range(len(read)))
    if diagnosis.otherwise:
        # Views that are paired rightly say nothing of the others.
        shown = {mask for one in diagnosis.unverified for mask, _ in closed(one.pairs)}
    # A bounding box shows nothing of the shape.
    shown -= {view for one in diagnosis.of_views if one.name == "box" for view in one.views}

    def missed(views: Sequence[View]) -> float:
        return missed_if_stretched(body, [views[number] for number in sorted(shown)])

    # What silhouettes show clearly need only not be contradicted.
    left = LEFT_OF_ORDER if diagnosis.otherwise else LEFT if diagnosis.weak else 1.0
    confirmed = []
    if shown:
        as_given = missed([as_meant(view, given) for view in read])
        for finding in diagnosis.unverified:
            # The mask may show nothing where the hypothesis has its object.
            with suppress(InputError):
                under = missed(_views_under(finding, read, given))
                if under < left * as_given:
                    confirmed.append((under, finding))
    likely = tuple(finding for _, finding in sorted(confirmed, key=lambda pair: pair[0]))
    if diagnosis.otherwise and likely:
        return diagnosis
    if diagnosis.otherwise:
        otherwise = replace(diagnosis.otherwise, notes=diagnosis.notes)
        return verify_hypotheses(otherwise, body, read, given)
    outvoted = diagnosis.outvoted and not likely
    return replace(diagnosis, of_input=likely, weak=(), outvoted=outvoted)


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
