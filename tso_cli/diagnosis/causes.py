"""The causes of a misfit as findings."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ..geometry.depth_kind import FITTED
from ..geometry.view import View
from ..pose.causes import Cause
from ..pose.move import Body
from ..pose.placement import ASPECT, FOCAL, GROWTH, PRINCIPAL, SHIFT, TURN
from .depth_map import SeenSurface
from .findings import Finding
from .foreign_parts import Parts

# The surface that depth maps and a cloud both show is apart by more than this, in longest sides
# (the median), if one of them is wrong. Of exact clouds 95 of 100 are nearer to right maps. Of
# clouds of another shape the distance alone is compared: 96 of 100 are nearer to right maps than
# the second number, and all are farther from maps whose depths are wrong by a twentieth.
DEPTH_OFF, DEPTH_APART = 0.05, 0.1


def findings_of_causes(causes: Sequence[Cause], views: Sequence[View]) -> tuple[Finding, ...]:
    """What looks wrong with cameras, masks or the place of the cloud, likeliest first."""
    every = tuple(range(len(views)))
    return tuple(Finding(cause.name, every, values=_values(cause, views)) for cause in causes)


def depth_that_contradicts(body: Body, views: Sequence[View], fits: bool) -> tuple[Finding, ...]:
    """The finding that depth maps contradict a cloud, or nothing; ``fits`` : whether masks do not.

    The maps are along z, or known up to two numbers. Of a cloud that does not fit its masks the
    shape is wrong too, so that only its distance is compared.
    """
    with_depth = {
        number: SeenSurface.of(body.points, view)
        for number, view in enumerate(views)
        if view.depth is not None and view.depth_kind not in FITTED
    }
    numbers = tuple(with_depth)
    surfaces = [surface for surface in with_depth.values() if len(surface.depth)]
    if not surfaces:
        return ()
    apart = float(np.median([surface.apart for surface in surfaces]))
    if abs(apart) > DEPTH_APART:
        times = float(np.median([surface.times for surface in surfaces]))
        how, other = ("far", "near") if apart > 0.0 else ("near", "far")
        values: dict[str, float | str] = {"share": 100.0 * abs(apart), "times": times}
        values |= {"how": how, "other": other}
        return (Finding("depth-apart", numbers, values=values),)
    off = float(np.median([surface.off(surface.values)[0] for surface in surfaces]))
    if not fits or off < DEPTH_OFF:
        return ()
    return (Finding("depth-contradicts", numbers, values={"off": 100.0 * off}),)


def findings_of_parts(parts: Mapping[int, Parts]) -> tuple[Finding, ...]:
    """What masks and cloud do not share."""
    findings = []
    for number, part in parts.items():
        name, share = "missing-part", 100.0 * part.in_cloud
        if part.in_mask > part.in_cloud:
            name = "foreign-part"
            share = 100.0 * part.in_mask / (1.0 - part.in_cloud + part.in_mask)
        findings.append(Finding(name, (number,), values={"share": share}))
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
