"""The questions of the study of evidence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from ...geometry.rotations import angle_between
from ...refinement import RefineConfig, RefineResult
from ...refinement.presets import BEST
from .accuracy_cases import AccuracyCase
from .accuracy_variants import Variant
from .evidence_cases import Alter, anothers_mask, as_it_is, bunched, cameras_off, turned_away, with_depth, without
from .evidence_colours import painted

Rows = dict[str, tuple[Alter, Variant]]
"""By label: how a case is altered, and how it is then refined."""
Measure = Callable[[AccuracyCase, AccuracyCase, RefineResult], float | None]
"""A further figure: of the case as it was, the altered case, and its result; None where there is none."""


@dataclass(frozen=True)
class Question:
    """Rows that are compared on cases of some kinds, of `KINDS`, and categories; ``measures`` are further figures by name."""

    title: str
    kinds: tuple[str, ...]
    rows: Rows
    categories: tuple[str, ...]
    measures: dict[str, Measure] = field(default_factory=dict)


def _variant(masks: int = 1, **settings: object) -> Variant:
    return Variant(RefineConfig(**settings), masks)  # type: ignore[arg-type]


def _no_plane(case: AccuracyCase, altered: AccuracyCase, result: RefineResult) -> float:
    return float(result.symmetry is None)


def _trust_in_fourth(case: AccuracyCase, altered: AccuracyCase, result: RefineResult) -> float | None:
    return result.view_trust[3] if len(result.view_trust) > 3 else None


def _corrected(case: AccuracyCase, altered: AccuracyCase, result: RefineResult) -> float:
    given = [view.camera for view in altered.views]
    return float(np.mean([not np.array_equal(a.R, b.R) for a, b in zip(result.cameras, given, strict=False)]))


def _degrees_left(case: AccuracyCase, altered: AccuracyCase, result: RefineResult) -> float:
    true = [view.camera for view in case.views]
    return float(np.mean([angle_between(a.R, b.R) for a, b in zip(result.cameras, true, strict=False)]))


def _depth_rows() -> Rows:
    one, two = _variant(symmetry="none"), _variant(2, symmetry="none")
    return {
        "mask, no symmetry": (as_it_is, one),
        "mask and depth, no symmetry": (with_depth, one),
        "mask, symmetry auto": (as_it_is, _variant()),
        "mask and depth, symmetry auto": (with_depth, _variant()),
        "mask and depth with noise of 0.01, no symmetry": (partial(with_depth, noise=0.01), one),
        "mask and depth with noise of 0.03, no symmetry": (partial(with_depth, noise=0.03), one),
        "two masks, no symmetry": (as_it_is, two),
        "two masks and their depths, no symmetry": (with_depth, two),
    }


def _missing_rows() -> Rows:
    objects: dict[str, Alter] = {"whole": as_it_is}
    objects |= {
        f"{part} missing": partial(without, part=key)
        for part, key in (("a side", "side"), ("what is high", "high"), ("what is low", "low"))
    }
    planes = {"no plane": _variant(symmetry="none"), "the start's, if the picture bears it out": _variant()}
    return {f"{what}; {plane}": (alter, variant) for what, alter in objects.items() for plane, variant in planes.items()}


def _wrong_rows() -> Rows:
    views: dict[str, Alter] = {
        "four right views": as_it_is,
        "three views close together, one from the side": bunched,
        "the fourth mask is another shape's": anothers_mask,
        "the fourth camera is 30 degrees off": turned_away,
    }
    rows: Rows = {}
    for preset in ("paper", "best"):
        rows |= {f"{what}; {preset}": (alter, _variant(4, preset=preset)) for what, alter in views.items()}
        if preset == "best":
            full = _variant(4, coarse_to_fine=replace(BEST, weigh_views=False))
            rows |= {f"{what}; best, all in full": (alter, full) for what, alter in views.items()}
        rows[f"the first three alone; {preset}"] = as_it_is, _variant(3, preset=preset)
        rows[f"the three close together alone; {preset}"] = bunched, _variant(3, preset=preset)
    return rows


def _camera_rows() -> Rows:
    return {
        f"{masks} mask{'s' * (masks > 1)}, {degrees} degrees off; {words}": (
            partial(cameras_off, degrees=degrees),
            _variant(masks, refine_camera=refined),
        )
        for masks in (1, 2)
        for degrees in (0, 2, 5)
        for refined, words in ((False, "as given"), (True, "refined"))
    }


def _colour_rows() -> Rows:
    starts = {"bent 2": "bent until 2 off", "bent 6": "bent until 6 off", "other": "another shape's, in another paint"}
    rows: Rows = {}
    for start, words in starts.items():
        for exposure in (None, 0.7, 1.4):
            what = "mask" if exposure is None else f"mask and photo, exposed {exposure} times"
            rows[f"{words}; {what}"] = partial(painted, start=start, exposure=exposure), _variant(symmetry="none")
    return rows


COMMON = ("chair", "airplane", "car")
CATEGORIES = (*COMMON, "sofa", "table")
BOTH = ("other", "near")
QUESTIONS = {
    "depth": Question("Depth maps", BOTH, _depth_rows(), COMMON),
    "colours": Question("Photos of painted objects", ("other",), _colour_rows(), COMMON),
    "missing": Question(
        "Objects of which a part is missing", ("other",), _missing_rows(), CATEGORIES[:4], {"without a plane": _no_plane}
    ),
    "wrong": Question(
        "Wrong views among four", ("other",), _wrong_rows(), CATEGORIES, {"trust in the fourth": _trust_in_fourth}
    ),
    "cameras": Question(
        "Cameras that are off", BOTH, _camera_rows(), COMMON, {"corrected": _corrected, "degrees left": _degrees_left}
    ),
}
