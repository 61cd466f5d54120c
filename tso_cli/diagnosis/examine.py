"""The examination of the input before any optimisation: `examine` and what it finds."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np

from ..cloud.cloud import ControlledCloud
from ..errors import InputError
from ..geometry.arrays import Bits
from ..geometry.points import scattered
from ..geometry.view import View
from ..optimisation.view_weights import FEWEST_VIEWS_TO_OUTVOTE
from ..pose.move import Move
from ..prior import LearnedPrior
from . import symptoms
from .assumptions import Assumption
from .causes import depth_that_contradicts, findings_of_causes, findings_of_parts
from .cells import Outline
from .explain import explain
from .findings import Finding
from .foreign_parts import parts_seen, parts_that_explain
from .placement import Placement, place, why_apart
from .verification import confirmed

# Points that are projected to compare silhouettes.
COMPARED_POINTS = 1024
# What is wrong with less than this share of the views is outvoted by the others.
OUTVOTED_SHARE = 0.5
# What is said where nothing explains why cloud and mask do not meet.
AXES_ADVICE = (
    "check the camera's axes (OpenCV: x right, y down, z forward; X_camera = R X_world + t) and "
    "units (K in pixels), and that the mask shows most of the object"
)


@dataclass(frozen=True)
class Diagnosis:
    """What may be wrong with the input, as data.

    of_input : alternatives that explain the whole input, likeliest first.
    of_views : what may be wrong with single views.
    notes : what is worth reading before a result is used.
    hidden : by number of the view, the pixels [H, W] around parts that mask or cloud lack.
    outvoted : whether the suspicious views are few, so that the others outvote them.
    fits : whether the cloud fits the contours of the masks, and of what they show of the object.
    apart : the view in which cloud and mask do not meet, and why, in words; "" where they meet.
    """

    placements: tuple[Placement, ...]
    of_input: tuple[Finding, ...] = ()
    of_views: tuple[Finding, ...] = ()
    notes: tuple[Finding, ...] = ()
    hidden: Mapping[int, Bits] = field(default_factory=dict)
    outvoted: bool = False
    fits: bool = False
    apart: str = ""

    @property
    def suspicious(self) -> tuple[Finding, ...]:
        """What makes a result doubtful: of the whole input, else of single views."""
        return self.of_input or self.of_views

    def after(self, known: Sequence[Finding]) -> Diagnosis:
        """The diagnosis with notes that are ``known`` already; nothing is noted twice."""
        named = [(note.name, note.views) for note in known]
        new = [note for note in self.notes if (note.name, note.views) not in named]
        return replace(self, notes=(*known, *new))

    @property
    def findings(self) -> tuple[Finding, ...]:
        """All findings, suspicious ones first."""
        return (*self.suspicious, *self.notes)


class NoOverlapError(InputError):
    """A ``cloud`` and a mask that do not meet, as the ``diagnosis`` says."""

    def __init__(self, diagnosis: Diagnosis, cloud: ControlledCloud) -> None:
        advice = AXES_ADVICE
        if diagnosis.suspicious:
            advice = (
                f"it looks as if {' or '.join(finding.says for finding in diagnosis.suspicious)}"
            )
        super().__init__(f"{diagnosis.apart}; {advice}")
        self.diagnosis, self.cloud = diagnosis, cloud

    def __reduce__(self) -> tuple[type, tuple[Diagnosis, ControlledCloud]]:
        return type(self), (self.diagnosis, self.cloud)


def examine(
    cloud: ControlledCloud,
    read: Sequence[View],
    views: Sequence[View],
    assumptions: Sequence[Assumption] = (),
    hypotheses: bool = True,
) -> Diagnosis:
    """Look at a cloud and its views: as they were ``read``, and ``views``, as they are meant.

    Without ``hypotheses`` only symptoms are looked for.
    """
    placements = tuple(place(cloud.control_points, view) for view in views)
    notes = _notes(cloud, views, placements, input_as_given=hypotheses)
    diagnosis = Diagnosis(placements, notes=tuple(notes))
    for placement, view in zip(placements, views, strict=True):
        if (problem := why_apart(placement, view)) and not diagnosis.apart:
            diagnosis = replace(diagnosis, apart=f"{view.name}: {problem}")
    return _explained(diagnosis, cloud, read, views, assumptions) if hypotheses else diagnosis


def explained(
    diagnosis: Diagnosis,
    cloud: ControlledCloud,
    views: Sequence[View],
    move: Move,
    prior: LearnedPrior | None,
) -> Diagnosis:
    """The diagnosis with what explains that a cloud does not fit its masks, after the ``move``.

    A finding that is suspicious already is likelier than a cause with unknowns. Where the shape is
    wrong too, the ``prior`` judges what in the masks is not the object's.
    """
    body = cloud.body
    if diagnosis.suspicious:
        return diagnosis
    if move.causes:
        return replace(diagnosis, of_input=findings_of_causes(move.causes, views))
    if contradicted := depth_that_contradicts(body, views, move.fits):
        return replace(diagnosis, of_input=contradicted)
    if move.fits or np.isnan(move.missed):
        return replace(diagnosis, fits=move.fits)
    parts = parts_that_explain(body, views, move)
    fits = bool(parts)
    if prior is not None and not fits:
        parts = parts_seen(cloud, views, prior)
    notes = (*findings_of_parts(parts), *diagnosis.notes)
    hidden = {number: part.ignored for number, part in parts.items()}
    return replace(diagnosis, fits=fits, notes=notes, hidden=hidden)


def _explained(
    diagnosis: Diagnosis,
    cloud: ControlledCloud,
    read: Sequence[View],
    views: Sequence[View],
    assumptions: Sequence[Assumption],
) -> Diagnosis:
    """With what explains cloud and masks, as the contours confirm, and masks that are boxes."""
    points = scattered(cloud.control_points, COMPARED_POINTS)
    outlines = [Outline(view, assumptions) for view in read]
    boxes = [
        symptoms.bounding_box(outline, view, number, points)
        for number, (outline, view) in enumerate(zip(outlines, views, strict=True))
    ]
    boxed = np.array([box is not None for box in boxes])
    candidates = explain(points, outlines, assumptions, boxed)
    confirm = partial(confirmed, body=cloud.body, read=read, given=assumptions)
    of_input: tuple[Finding, ...] = ()
    if pairs := confirm(candidates.pairs):
        of_input = pairs if len(pairs[0].views) >= OUTVOTED_SHARE * len(views) else ()
    else:
        # What explains the views whose masks show the shape is about the others too.
        every = tuple(range(len(views)))
        of_input = tuple(replace(one, views=every) for one in confirm(candidates.of_input))
    if of_input:
        return replace(diagnosis, of_input=of_input)
    likeliest = {one.views: one for one in reversed(pairs or confirm(candidates.of_views))}
    of_views = (*(box for box in boxes if box), *(likeliest[views] for views in sorted(likeliest)))
    wrong = {view for one in of_views for view in one.views}
    outvoted = len(views) >= FEWEST_VIEWS_TO_OUTVOTE and len(wrong) < OUTVOTED_SHARE * len(views)
    return replace(diagnosis, of_views=of_views, outvoted=bool(wrong) and outvoted)


def _notes(
    cloud: ControlledCloud,
    views: Sequence[View],
    placements: Sequence[Placement],
    input_as_given: bool,
) -> list[Finding]:
    """``input_as_given`` : not a network's prediction and the crop that the network saw."""
    points, source = cloud.control_points, cloud.source
    findings: list[Finding | None] = []
    if source.not_a_mesh:
        findings.append(Finding("not-a-mesh", values={"why": source.not_a_mesh}))
    left_out = int(cloud.left_out.sum())
    if left_out:
        share = 100.0 * left_out / len(source.points)
        findings.append(Finding("left-out", values={"count": left_out, "share": share}))
    if count := int(cloud.outliers.sum()) - left_out:
        findings.append(Finding("outliers", values={"count": count}))
    if count := int(source.faint.sum()):
        findings.append(Finding("faint", values={"count": count}))
    for number, (view, placement) in enumerate(zip(views, placements, strict=True)):
        if input_as_given:
            findings.append(symptoms.photo(view, number))
        findings += [
            symptoms.coarse(view, number, len(points)),
            symptoms.specks(view, number),
            symptoms.behind(placement, number),
        ]
    return [finding for finding in findings if finding]
