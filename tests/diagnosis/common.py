"""The example aeroplane from several sides, mistakes in its input, and what is found there."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tests.scenes import example, seen, turned
from tso_cli import View
from tso_cli.cloud.cloud import Cloud
from tso_cli.diagnosis.assumptions import Assumption, as_meant
from tso_cli.diagnosis.examine import Diagnosis, examine
from tso_cli.diagnosis.findings import Finding
from tso_cli.diagnosis.hypotheses import HYPOTHESES

PLANE = example("airplane")
EXAMPLES = "chair", "car", "airplane"


def assumed(name: str) -> tuple[Assumption, ...]:
    """One hypothesis of the table, about all views."""
    return (Assumption(HYPOTHESES[name]),)


def changed(view: View, name: str) -> View:
    """The view with the change that the hypothesis ``name`` makes."""
    return as_meant(view, assumed(name))


def around(count: int = 4) -> list[View]:
    """The aeroplane from ``count`` sides, 40 degrees apart."""
    return [
        replace(seen(PLANE.target, turned(PLANE.camera, 40.0 * i)), name=f"{i}.png")
        for i in range(count)
    ]


def paired(views: Sequence[View], order: Sequence[int]) -> list[View]:
    """Camera k with the mask of view ``order[k]``."""
    return [replace(views[i], camera=view.camera) for i, view in zip(order, views, strict=True)]


def examined(
    points: np.ndarray, views: Sequence[View], given: Sequence[Assumption] = ()
) -> Diagnosis:
    """The diagnosis of points and ``views`` as they were read."""
    meant = [as_meant(view, given) for view in views]
    return examine(Cloud(points, "cloud").controlled(views=meant), views, meant, given)


def named(findings: Sequence[Finding]) -> list[tuple[str, tuple[int, ...]]]:
    """(name, views) of each finding."""
    return [(finding.name, finding.views) for finding in findings]


def boxed(view: View) -> View:
    """The view whose mask is the bounding box of the object, as a detector gives it."""
    rows, columns = np.nonzero(view.mask > 0.5)
    mask = np.zeros_like(view.mask)
    mask[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1] = 1.0
    return replace(view, mask=mask)
