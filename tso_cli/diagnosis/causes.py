"""The causes of a misfit as findings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..geometry.depth_kind import FITTED
from ..geometry.view import View
from ..pose.causes import Cause
from ..pose.move import Body
from ..pose.placement import ASPECT, FOCAL, GROWTH, PRINCIPAL, SHIFT, TURN
from ..pose.placing import missed_of_depth
from .findings import Finding
from .foreign_parts import Parts

# A cloud fits a depth map if it misses less than this share of it, by the width of a cell. Exact
# validation clouds miss up to 0.30 of right maps.
DEPTH_FITS = 0.35


def findings_of_causes(causes: Sequence[Cause], views: Sequence[View]) -> tuple[Finding, ...]:
    """What looks wrong with cameras, masks or the place of the cloud, likeliest first."""
    every = tuple(range(len(views)))
    return tuple(Finding(cause.name, every, values=_values(cause, views)) for cause in causes)


def depth_that_contradicts(body: Body, views: Sequence[View]) -> tuple[Finding, ...]:
    """The finding that depth maps do not fit a cloud that fits its masks, or nothing."""
    with_depth = [
        number
        for number, view in enumerate(views)
        if view.depth is not None and view.depth_kind not in FITTED
    ]
    if not with_depth:
        return ()
    missed = missed_of_depth(body, [views[number] for number in with_depth])
    if missed < DEPTH_FITS:
        return ()
    return (Finding("depth-contradicts", tuple(with_depth), values={"missed": 100.0 * missed}),)


def findings_of_parts(parts: Mapping[int, Parts]) -> tuple[Finding, ...]:
    """What masks and cloud do not share."""
    findings = []
    for number, part in parts.items():
        if part.in_mask > part.in_cloud:
            share = 100.0 * part.in_mask / (1.0 - part.in_cloud + part.in_mask)
            findings.append(Finding("foreign-part", (number,), values={"share": share}))
        else:
            share = 100.0 * part.in_cloud
            findings.append(Finding("missing-part", (number,), values={"share": share}))
    return tuple(findings)


def _values(cause: Cause, views: Sequence[View]) -> dict[str, float | str]:
    change = cause.change
    if cause.name == "focal-length":
        # The factor mends the focal length: it is over 1 where K is too short.
        percent = 100.0 * float(np.expm1(-change[FOCAL]))
        how, otherwise = ("long", "smaller") if percent > 0.0 else ("short", "larger")
        return {"percent": abs(percent), "how": how, "otherwise": otherwise}
    if cause.name == "aspect":
        percent = 100.0 * float(np.expm1(-change[ASPECT]))
        return {"percent": abs(percent), "how": "large" if percent > 0.0 else "small"}
    if cause.name == "principal-point":
        x, y = (-change[PRINCIPAL] * max(views[0].mask.shape)).tolist()
        return {"x": x, "y": y}
    if cause.name == "outline":
        grown = float(change[GROWTH])
        return {"pixels": abs(grown), "how": "large" if grown > 0.0 else "small"}
    degrees = float(np.degrees(np.linalg.norm(change[TURN])))
    return {"degrees": degrees, "share": 100.0 * float(np.linalg.norm(change[SHIFT]))}
