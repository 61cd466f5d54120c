"""Scenes in trouble, refined: what becomes of the cloud, and what tso says of it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace

from tso_cli.errors import InputError, TsoError
from tso_cli.evaluation.metrics import chamfer
from tso_cli.geometry.arrays import Array
from tso_cli.geometry.points import longest_side, root_mean_square
from tso_cli.refinement import RefineConfig, RefineResult, refine

from ..studies.summary import rounded
from ..study import Cases, Record, uninterrupted
from .scenes import Gallery, Scene
from .troubles import TROUBLES, Trouble

VIEWS, STRENGTHS = (1, 4), 3
STRIDE = 17
"""How many shapes further on each trouble begins."""
WORSE, BETTER = 1.05, 0.95
"""A ratio over or under this is worse or better than the start."""
SILENT, SAID, GAINED, WITHHELD, KEPT = "silent", "said", "gained", "withheld", "kept"
VARIANTS = {
    "default": RefineConfig(),
    "shape": RefineConfig(move="shape"),
    "paper": RefineConfig(preset="paper"),
}
DEFAULT = next(iter(VARIANTS))


def altered(
    gallery: Gallery, trouble: Trouble, start: str, number: int, views: int
) -> tuple[Record, Scene | InputError]:
    """Scene ``number`` of a trouble and start, and what a record calls it.

    An error where the scene cannot even be given to tso.
    """
    place = TROUBLES.index(trouble) * STRIDE + number
    shape, strength = gallery.shape(place), number % STRENGTHS
    views = max(views, trouble.views)
    names: Record = {"trouble": trouble.name, "start": start, "number": number}
    names |= {"strength": strength, "views": views}
    names |= {"shape": shape.name, "category": shape.category}
    names["listed"] = shape.name in gallery.listed
    rng = gallery.rng(trouble.name, start, shape.name, str(number))
    try:
        return names, trouble.apply(gallery.scene(place, start, views), strength, rng)
    except InputError as error:
        return names, error


def scenes_of(
    gallery: Gallery, trouble: Trouble, start: str, count: int
) -> Iterator[tuple[Record, Scene | InputError]]:
    """``count`` scenes, with one and four views in turn; none of a start it is not about."""
    for number in range(count if start in trouble.starts else 0):
        yield altered(gallery, trouble, start, number, VIEWS[number % len(VIEWS)])


def run_row(scene: Scene | InputError, config: RefineConfig) -> Record:
    """The figures of one run."""
    if isinstance(scene, InputError):
        return _refused(scene)
    began = time.perf_counter()
    try:
        result = uninterrupted(refine(scene.initial, scene.views, config=config))
    except TsoError as error:
        return _refused(uninterrupted(error))
    milliseconds = 1000.0 * (time.perf_counter() - began)
    before = distance(scene.initial, scene)
    names = [finding.name.partition("=")[0] for finding in result.findings]
    moved = (result.points - scene.initial)[: scene.own]
    row: Record = {
        "ratio": distance(result.points, scene) / before,
        "before": before,
        "moved": root_mean_square(moved) / own_size(scene),
        "verdict": result.trust.verdict,
        "confidence": result.trust.confidence,
        "outcome": result.fit.outcome,
        "move": result.move.kind,
        "findings": names,
        "suspicious": any(finding.suspicious for finding in result.findings),
        "iou_before": result.fit.iou_before,
        "iou_after": result.fit.iou_after,
        "milliseconds": milliseconds,
    }
    if result.fit.stop_reason == "doubtful":
        row["withheld_ratio"] = distance(_accepted(scene, config).points, scene) / before
    return rounded({**row, "became": became(row)})


def _accepted(scene: Scene, config: RefineConfig) -> RefineResult:
    config = replace(config, accept_doubtful=True)
    return uninterrupted(refine(scene.initial, scene.views, config=config))


def _refused(error: TsoError) -> Record:
    return {"ratio": None, "outcome": "error", "message": str(error)[:120], "became": SAID}


def own_size(scene: Scene) -> float:
    """Longest side of the start's own points."""
    return longest_side(scene.initial[: scene.own])


def distance(points: Array, scene: Scene) -> float:
    """Chamfer distance of the object's own ``points`` to the true surface."""
    return chamfer(points[: scene.own], scene.dense).chamfer


def became(row: Record) -> str:
    """What became of a run that came to an end."""
    if row["ratio"] > WORSE:
        return SAID if row["verdict"] == "doubtful" or row["suspicious"] else SILENT
    if row["ratio"] < BETTER:
        return GAINED
    return WITHHELD if row.get("withheld_ratio", 1.0) < BETTER else KEPT


def rows_of(
    gallery: Gallery, trouble: Trouble, starts: tuple[str, ...], count: int, variant: str
) -> Cases:
    """The rows of a trouble and variant for all ``starts``."""
    return [
        {**names, "variant": variant, **run_row(scene, VARIANTS[variant])}
        for start in starts
        for names, scene in scenes_of(gallery, trouble, start, count)
    ]
