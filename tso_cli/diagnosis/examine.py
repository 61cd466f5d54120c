"""The examination of the input before any optimisation: `examine` and what it finds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..cloud.cloud import ControlledCloud
from ..errors import InputError
from ..geometry.arrays import Array, Bits, Box
from ..geometry.points import scattered
from ..geometry.view import View
from ..optimisation.view_weights import FEWEST_VIEWS_TO_OUTVOTE
from ..pose.move import Body, Move
from . import symptoms
from .assumptions import Assumption
from .causes import depth_that_contradicts, findings_of_causes, findings_of_parts
from .cells import Outline
from .explain import OUTVOTED_SHARE, Explanation, explain
from .findings import Finding
from .foreign_parts import parts_that_explain
from .hypotheses import focal_in_pixels
from .placement import Placement, part_met, place, why_apart

# Points that are projected to compare silhouettes.
COMPARED_POINTS = 1024
# What is said where nothing explains why cloud and mask do not meet.
AXES_ADVICE = (
    "check the camera's axes (OpenCV: x right, y down, z forward; X_camera = R X_world + t) and "
    "units"
)


@dataclass(frozen=True)
class Diagnosis:
    """What may be wrong with the input, as data.

    of_input : alternatives that explain the whole input, likeliest first.
    of_views : what may be wrong with single views.
    weak : alternatives that only the contours can confirm.
    notes : what is worth reading before a result is used.
    hidden : by number of the view, the pixels [H, W] around parts that mask or cloud lack.
    explanation : None in the network modes, which place their cloud themselves.
    outvoted : whether the suspicious views are few, so that the others outvote them.
    fits : whether the cloud fits the contours of the masks, and of what they show of the object.
    otherwise : where masks and cameras seem to be mispaired, the diagnosis if they are not.
    """

    placements: tuple[Placement, ...]
    of_input: tuple[Finding, ...] = ()
    of_views: tuple[Finding, ...] = ()
    weak: tuple[Finding, ...] = ()
    notes: tuple[Finding, ...] = ()
    hidden: Mapping[int, Bits] = field(default_factory=dict)
    explanation: Explanation | None = None
    outvoted: bool = False
    fits: bool = False
    otherwise: Diagnosis | None = None

    @property
    def unverified(self) -> tuple[Finding, ...]:
        """What the contours verify: weak alternatives, or what explains the whole input."""
        pairs = tuple(finding for finding in self.suspicious if finding.pairs)
        # Silhouettes may take a stretched object for a turned one.
        turned = all(any(one.turns for one in finding.hypotheses) for finding in self.of_input)
        return self.weak or pairs or (self.of_input if turned else ())

    @property
    def suspicious(self) -> tuple[Finding, ...]:
        """What makes a result doubtful: of the whole input, else of single views."""
        return self.of_input or self.of_views

    @property
    def findings(self) -> tuple[Finding, ...]:
        """All findings, suspicious ones first."""
        return (*self.suspicious, *self.notes)


class NoOverlapError(InputError):
    """A cloud and a mask that do not meet.

    Attributes
    ----------
    problem : what was found, without advice. diagnosis, cloud : of the input.
    part : the box of a connected part of the mask that the cloud meets well, or None.
    advice : what to look at if nothing else is found.
    """

    problem: str
    diagnosis: Diagnosis
    cloud: ControlledCloud
    part: Box | None = None
    advice: str = AXES_ADVICE


def examine(
    cloud: ControlledCloud,
    read: Sequence[View],
    views: Sequence[View],
    assumptions: Sequence[Assumption] = (),
    known: Sequence[Finding] = (),
    hypotheses: bool = True,
) -> Diagnosis:
    """Look at a cloud and its views: as they were ``read``, and ``views``, as they are meant.

    ``known`` are findings of those who read the input. Without ``hypotheses`` only symptoms are
    looked for. Raises NoOverlapError where cloud and mask do not meet in a view.
    """
    points = cloud.control_points
    placements = tuple(place(points, view) for view in views)
    found = _notes(cloud, views, placements, input_as_given=hypotheses)
    named = [(finding.name, finding.views) for finding in known]
    found = [finding for finding in found if (finding.name, finding.views) not in named]
    diagnosis = Diagnosis(placements, notes=(*known, *found))
    if hypotheses:
        diagnosis = _explained(diagnosis, points, read, views, assumptions)
    for placement, view in zip(placements, views, strict=True):
        if problem := why_apart(placement, view):
            error = _no_overlap(f"{view.name}: {problem}", diagnosis, placement, view)
            error.cloud = cloud
            raise error
    return diagnosis


def explained(diagnosis: Diagnosis, body: Body, views: Sequence[View], move: Move) -> Diagnosis:
    """The diagnosis with what explains that a cloud does not fit its masks, after the ``move``.

    A finding that is suspicious already is likelier than a cause with unknowns.
    """
    if diagnosis.suspicious:
        return diagnosis
    if move.causes:
        return replace(diagnosis, of_input=findings_of_causes(move.causes, views))
    fits = move.fits and all(view.image is None for view in views)
    if fits:
        contradicted = depth_that_contradicts(body, views)
        return replace(diagnosis, fits=True, of_input=contradicted)
    if np.isnan(move.missed):
        return diagnosis
    parts = parts_that_explain(body, views, move)
    if not parts:
        return diagnosis
    notes = (*findings_of_parts(parts), *diagnosis.notes)
    hidden = {number: part.ignored for number, part in parts.items()}
    return replace(diagnosis, fits=True, notes=notes, hidden=hidden)


def _explained(
    diagnosis: Diagnosis,
    points: Array,
    read: Sequence[View],
    views: Sequence[View],
    assumptions: Sequence[Assumption],
) -> Diagnosis:
    points = scattered(points, COMPARED_POINTS)
    outlines = [Outline(view, assumptions) for view in read]
    boxes = [
        symptoms.bounding_box(outline, view, number, points)
        for number, (outline, view) in enumerate(zip(outlines, views, strict=True))
    ]
    of_scene = points, outlines, assumptions, np.array([box is not None for box in boxes])
    diagnosis = _with_explanation(diagnosis, explain(*of_scene), boxes)
    if any(finding.pairs for finding in diagnosis.suspicious):
        paired = explain(*of_scene, mispaired=False)
        return replace(diagnosis, otherwise=_with_explanation(diagnosis, paired, boxes))
    return diagnosis


def _with_explanation(
    diagnosis: Diagnosis, found: Explanation, boxes: Sequence[Finding | None]
) -> Diagnosis:
    """With what explains cloud and masks, and the masks that are bounding ``boxes``."""
    of_views: tuple[Finding, ...] = ()
    if not found.of_input:
        of_views = tuple(finding for finding in (*boxes, *found.of_views) if finding)
    # Pairs are one finding about several views.
    suspicious = sum(len(one.pairs) or 1 for one in of_views)
    return replace(
        diagnosis,
        of_input=found.of_input,
        of_views=of_views,
        weak=found.weak,
        explanation=found,
        outvoted=bool(of_views)
        and len(boxes) >= FEWEST_VIEWS_TO_OUTVOTE
        and suspicious < OUTVOTED_SHARE * len(boxes),
    )


def _notes(
    cloud: ControlledCloud,
    views: Sequence[View],
    placements: Sequence[Placement],
    input_as_given: bool,
) -> list[Finding]:
    """``input_as_given`` : not a network's prediction and the crop that the network saw."""
    points, source = cloud.control_points, cloud.source
    found: list[Finding | None] = []
    if source.not_a_mesh:
        found.append(Finding("not-a-mesh", values={"why": source.not_a_mesh}))
    left_out = int(cloud.left_out.sum())
    if left_out:
        share = 100.0 * left_out / len(source.points)
        found.append(Finding("left-out", values={"count": left_out, "share": share}))
    if count := int(cloud.outliers.sum()) - left_out:
        found.append(Finding("outliers", values={"count": count}))
    if count := int(source.faint.sum()):
        found.append(Finding("faint", values={"count": count}))
    for number, (view, placement) in enumerate(zip(views, placements, strict=True)):
        if input_as_given:
            found += [
                symptoms.photo(view, number),
                symptoms.scale(points, view, number),
            ]
        found += [
            symptoms.coarse(view, number, len(points)),
            symptoms.specks(view, number),
            symptoms.behind(placement, number),
        ]
    return [finding for finding in found if finding]


IN_PIXELS = "is K in pixels?"


def _no_overlap(
    problem: str, diagnosis: Diagnosis, placement: Placement, view: View
) -> NoOverlapError:
    part, general = None, AXES_ADVICE
    if not focal_in_pixels(view.camera):
        general = f"the focal length is {view.camera.K[0, 0]:.3g} px, {IN_PIXELS}"
    if diagnosis.suspicious:
        advice = f"it looks as if {' or '.join(one.says for one in diagnosis.suspicious)}"
    elif part := part_met(placement, view):
        advice = "it meets a part of the mask: is the rest something else?"
    else:
        advice = general
    error = NoOverlapError(f"{problem}; {advice}")
    error.problem, error.diagnosis, error.part, error.advice = problem, diagnosis, part, general
    return error
