"""Verification: what the contours say of hypotheses that coarse silhouettes suggest."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from ..errors import InputError
from ..geometry.view import View
from ..pose.causes import missed_if_stretched
from ..pose.move import Body
from .assumptions import Assumption, as_meant
from .findings import Finding

# A hypothesis is confirmed if the share of the misfit that it leaves, less what silhouettes gain by
# it, is under this, and if it leaves less than all. Of 290 right inputs, half of them stretched,
# and of 513 candidates that are right, it confirms 5 and 510.
LEFT = 0.79
# A mistake of the cloud shows more than one of a mask or a camera does: what the cloud no longer
# misses, and twice what silhouettes gain, are over this. Of 180 right inputs with clouds of another
# shape 4 are then called wrong, without it 8; of 672 with a mistake 533 are, and 536.
EXPLAINED_BY_CLOUD = 0.3
# There are many other orders of the masks, so one must leave less: then none of 64 right orders is
# called wrong, and 94 of 106 wrong ones are.
LEFT_OF_ORDER = 0.72


def confirmed(
    candidates: Sequence[Finding], body: Body, read: Sequence[View], given: Sequence[Assumption]
) -> tuple[Finding, ...]:
    """The candidates that the contours confirm, likeliest first.

    Silhouettes may agree somewhat better under a hypothesis by chance. The shape of the cloud may
    be wrong too, so that it may stretch, as given and under each hypothesis. ``read`` are the views
    as they were read, which are meant as the assumptions ``given`` say.
    """

    @cache
    def missed_as_given(numbers: tuple[int, ...]) -> float:
        return _missed(body, [as_meant(read[number], given) for number in numbers])

    likely = []
    for finding in candidates:
        # Views that are paired rightly say nothing of the others.
        numbers = tuple(mask for mask, _ in closed(finding.pairs)) or finding.views
        views = views_under(finding, read, given)
        missed, before = _missed(body, [views[n] for n in numbers]), missed_as_given(numbers)
        explained = before - missed + 2.0 * finding.gain
        of_cloud = any(hypothesis.of_cloud for hypothesis in finding.hypotheses)
        # An inverted mask has the same contours.
        inverted = any(hypothesis.inverted for hypothesis in finding.hypotheses)
        share = min((LEFT_OF_ORDER if finding.pairs else LEFT) + finding.gain, 1.0)
        if of_cloud and explained < EXPLAINED_BY_CLOUD:
            continue
        if inverted or missed < share * before:
            likely.append((missed - finding.gain, finding))
    return tuple(finding for _, finding in sorted(likely, key=lambda pair: pair[0]))


def _missed(body: Body, views: Sequence[View]) -> float:
    """The share of the contours that a stretched cloud misses; infinite if there are none."""
    try:
        return missed_if_stretched(body, views)
    except InputError:
        # The mask may show nothing where the hypothesis has its object.
        return np.inf


def views_under(
    hypothesis: Finding, read: Sequence[View], given: Sequence[Assumption]
) -> list[View]:
    """The views as they are meant if a hypothesis is right."""
    views = [as_meant(view, hypothesis.assumed(given)) for view in read]
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
