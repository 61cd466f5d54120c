"""The questions of the study of evidence."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from ...geometry.rotations import angle_between
from ...refinement import RefineConfig, RefineResult
from ...refinement.config import PAPER_GAMMA
from ...refinement.presets import BEST
from ...refinement.symmetry import find_mirror_plane
from .accuracy_cases import AccuracyCase
from .accuracy_variants import NETWORK_MODES, Variant
from .evidence_cases import (
    FACES,
    SAMPLED,
    VERTICES,
    Alter,
    anothers_mask,
    as_it_is,
    bunched,
    cameras_off,
    from_mesh,
    in_photo,
    placed_by,
    turned_away,
    with_depth,
    without,
)
from .evidence_colours import painted

Measure = Callable[[AccuracyCase, AccuracyCase, RefineResult], float | None]
"""A further figure: of the case as it was, the altered case, and its result; None where there is none."""


@dataclass(frozen=True)
class Row:
    """How a case is altered, and how it is then refined; a function where that depends on the case."""

    alter: Alter
    variant: Variant | Callable[[AccuracyCase], Variant]


@dataclass(frozen=True)
class Question:
    """Rows that are compared on cases of some kinds.

    Parameters
    ----------
    title : of its table.
    kinds : of `KINDS`. categories : None for all.
    rows : by label. measures : further figures of each result, by name.
    """

    title: str
    kinds: tuple[str, ...]
    rows: dict[str, Row]
    categories: tuple[str, ...] | None = None
    measures: dict[str, Measure] = field(default_factory=dict)


def _variant(masks: int = 1, **settings: object) -> Variant:
    return Variant(RefineConfig(**settings), masks)  # type: ignore[arg-type]


def _plane_of(case: AccuracyCase) -> Variant:
    """The plane that the start itself suggests, whatever the picture says; none where it has none."""
    plane = find_mirror_plane(case.initial)
    given = ",".join(repr(float(value)) for value in (*plane.normal, plane.offset)) if plane.symmetric else "none"
    return _variant(symmetry=given)


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


def _iou(case: AccuracyCase, altered: AccuracyCase, result: RefineResult) -> float:
    return result.iou_after


def _framing_rows() -> dict[str, Row]:
    photos: dict[str, Alter] = {"the picture itself": as_it_is}
    photos |= {f"in a photo {times} times as wide": partial(in_photo, widths=(times,)) for times in (2, 4, 8, 16)}
    photos["in the corner of a photo 8 times as wide"] = partial(in_photo, widths=(8,), across=1.0, down=1.0)
    rows = {what: Row(alter, _variant()) for what, alter in photos.items()}
    for masks, words in ((2, "two"), (4, "four")):
        rows[f"{words} masks"] = Row(as_it_is, _variant(masks))
        rows[f"{words} masks, in photos of other widths each"] = Row(partial(in_photo, widths=(1, 4, 2, 8)), _variant(masks))
    return rows


def _depth_rows() -> dict[str, Row]:
    rows = {}
    for planes in ("none", "auto"):
        words = "no symmetry" if planes == "none" else "symmetry auto"
        rows[f"mask, {words}"] = Row(as_it_is, _variant(symmetry=planes))
        rows[f"mask and depth, {words}"] = Row(with_depth, _variant(symmetry=planes))
    for noise in (0.01, 0.03):
        rows[f"mask and depth with noise of {noise}, no symmetry"] = Row(
            partial(with_depth, noise=noise), _variant(symmetry="none")
        )
    rows["two masks, no symmetry"] = Row(as_it_is, _variant(2, symmetry="none"))
    rows["two masks and their depths, no symmetry"] = Row(with_depth, _variant(2, symmetry="none"))
    return rows


def _missing_rows() -> dict[str, Row]:
    objects: dict[str, Alter] = {"whole": as_it_is}
    objects |= {
        f"{part} missing": partial(without, part=key)
        for part, key in (("a side", "side"), ("what is high", "high"), ("what is low", "low"))
    }
    planes: dict[str, Variant | Callable[[AccuracyCase], Variant]] = {
        "no plane": _variant(symmetry="none"),
        "the start's plane": _plane_of,
        "the start's, if the picture bears it out": _variant(),
    }
    return {f"{what}; {plane}": Row(alter, variant) for what, alter in objects.items() for plane, variant in planes.items()}


def _wrong_rows() -> dict[str, Row]:
    views: dict[str, Alter] = {
        "four right views": as_it_is,
        "three views close together, one from the side": bunched,
        "the fourth mask is another shape's": anothers_mask,
        "the fourth camera is 30 degrees off": turned_away,
    }
    rows: dict[str, Row] = {}
    for preset in ("paper", "best"):
        rows |= {f"{what}; {preset}": Row(alter, _variant(4, preset=preset)) for what, alter in views.items()}
        if preset == "best":
            full = _variant(4, coarse_to_fine=replace(BEST, weigh_views=False))
            rows |= {f"{what}; best, all in full": Row(alter, full) for what, alter in views.items()}
        rows[f"the first three alone; {preset}"] = Row(as_it_is, _variant(3, preset=preset))
        rows[f"the three close together alone; {preset}"] = Row(bunched, _variant(3, preset=preset))
    return rows


def _camera_rows() -> dict[str, Row]:
    return {
        f"{masks} mask{'s' * (masks > 1)}, {degrees} degrees off; {words}": Row(
            partial(cameras_off, degrees=degrees), _variant(masks, refine_camera=refined)
        )
        for masks in (1, 2)
        for degrees in (0, 2, 5)
        for refined, words in ((False, "as given"), (True, "refined"))
    }


def _placing_rows() -> dict[str, Row]:
    placings: dict[str, Alter] = {
        "box": partial(placed_by, placing="box"),
        "silhouette": partial(placed_by, placing="silhouette"),
        "camera": as_it_is,
    }
    refined = {"points, paper": _variant(preset="paper"), "points": _variant(), "latent": _variant(mode="latent")}
    return {f"{place}; {what}": Row(alter, variant) for place, alter in placings.items() for what, variant in refined.items()}


def _colour_rows() -> dict[str, Row]:
    starts = {"bent 2": "bent until 2 off", "bent 6": "bent until 6 off", "other": "another shape's, in another paint"}
    rows = {}
    for start, words in starts.items():
        rows[f"{words}; mask"] = Row(partial(painted, start=start, exposure=None), _variant(symmetry="none"))
        for exposure in (0.7, 1.4):
            rows[f"{words}; mask and photo, exposed {exposure} times"] = Row(
                partial(painted, start=start, exposure=exposure), _variant(symmetry="none")
            )
    return rows


def _mesh_rows() -> dict[str, Row]:
    meshes = {"as it is": None, "cut down to 400 faces": 400}
    forms = VERTICES, SAMPLED, FACES
    return {
        f"{what}; {form}": Row(partial(from_mesh, form=form, faces=faces), _variant())
        for what, faces in meshes.items()
        for form in forms
    }


# A third and three times the preset's rate, and the paper's.
RATES = {"encoder": (1e-6, 1e-5, 3e-5, 1e-4), "encoder-decoder": (5e-6, 2e-5, 6e-5, 2e-4), "latent": (3e-4, 1e-3, 3e-3)}


def _rate_rows() -> dict[str, Row]:
    rows: dict[str, Row] = {}
    for mode in NETWORK_MODES:
        config = RefineConfig(mode)
        rows |= {f"{mode}, {rate:g}": Row(as_it_is, Variant(replace(config, learning_rate=rate))) for rate in RATES[mode]}
        chosen = config.settings()
        paper = RefineConfig(mode, chosen.steps, chosen.learning_rate, PAPER_GAMMA["points"], preset="paper")
        rows[f"{mode}, {chosen.learning_rate:g}, BCE and Chamfer"] = Row(as_it_is, Variant(paper))
        rows[f"{mode}, {chosen.learning_rate:g}, then points"] = Row(as_it_is, Variant(config, then=RefineConfig()))
    return rows


COMMON = ("chair", "airplane", "car")
QUESTIONS = {
    "framing": Question("The object in a larger photo", ("other", "near"), _framing_rows(), measures={"IoU": _iou}),
    "depth": Question("Depth maps", ("other", "near"), _depth_rows(), COMMON),
    "colours": Question("Photos of painted objects", ("other",), _colour_rows(), COMMON),
    "missing": Question(
        "Objects of which a part is missing", ("other",), _missing_rows(), (*COMMON, "sofa"), {"without a plane": _no_plane}
    ),
    "wrong": Question("Wrong views among four", ("other",), _wrong_rows(), measures={"trust in the fourth": _trust_in_fourth}),
    "cameras": Question(
        "Cameras that are off",
        ("other", "near"),
        _camera_rows(),
        COMMON,
        {"corrected": _corrected, "degrees left": _degrees_left},
    ),
    "placing": Question("Where a prediction stands", ("network",), _placing_rows()),
    "rates": Question("Learning rates of the network's variants", ("network",), _rate_rows()),
    "meshes": Question("Starts that are meshes", ("other",), _mesh_rows()),
}
