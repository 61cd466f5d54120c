"""Findings and results as sentences. Only this room knows which option mends what."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

from ...diagnosis.assumptions import INVERTED
from ...diagnosis.examine import AXES_ADVICE, NoOverlapError
from ...diagnosis.findings import ASSUMED_CAMERA, OF_DEPTH_MAPS, Finding
from ...diagnosis.trust import FINDING
from ...errors import InputError
from ...refinement import RefineResult
from ...refinement.result import Fit
from .sentences_of_moves import reading_of, start_of

# A largest displacement under this share of the object's size is worth a warning.
SMALL_DISPLACEMENT = 1e-3
# Pairs of masks and cameras that are named.
MOST_PAIRS = 3
LOOK = (
    "look at the numbers with --check, or let the masks place the cloud with --move pose or "
    "similarity"
)
# What mends a symptom, for each way to read it.
OPTIONS = {
    "box": "a mask of its outline",
    "focal-length": "{focal} if the camera was guessed, or --move similarity if the size of the "
    "cloud was",
    "aspect": "the K of this picture, whose fx and fy may differ",
    "principal-point": "the K of this picture, or --move pose if the cloud is out of place instead",
    "outline": "--mask-error {pixels:.1f} if the mask is wrong, or --accept-doubtful if the cloud "
    "is",
    "depth-apart": "--depth-scale {scale:.3g} if the maps are wrong, or --move pose if the cloud "
    "is",
    "depth-contradicts": "it without --depth if the maps are wrong, or with --accept-doubtful if "
    "the cloud is",
    "pose": "--move pose if the camera is right",
    "shift": "--move pose if the camera is right",
}
EDIT_FOCAL = "another focal length in the camera file"
# What a verdict means; "" where there is none.
VERDICTS = {
    "fits better": "The cloud moved and agrees better with the masks. Probably that does not harm: "
    "its Chamfer distance to the true shape grows by at most 5 %. It need not be nearer.",
    "left": "The cloud fits its masks, or nothing that was tried agrees better with them, so the "
    "cloud is as it was.",
    "doubtful": "The input looks wrong, or the displacement may harm: the Chamfer distance to the "
    "true shape may grow by more than 5 %.",
    "": "There is no confidence in this run. A rising IoU proves nothing.",
}
# Options that mend what a note says.
OPTIONS_OF_NOTES = {
    "missing-part": " (--ignore FILE says what is hidden)",
    "depth-inverse": ": try --depth-kind inverse",
    "depth-affine": ": try --depth-kind affine",
    "depth-ray": ": try --depth-kind ray",
    "depth-unrelated": " (--depth-kind z uses it all the same)",
    "left-out": " (--crop writes the cloud without them; --ignore FILE says what is hidden)",
    "unsure-camera": " (give --fov or --focal, or a cloud of the right shape, and look at "
    "--overlay)",
    ASSUMED_CAMERA: " (--camera FILE, or --camera fit)",
    "assumed-picture": " (--camera FILE)",
    "unsure-place": " (`alternatives` in --json has the other places)",
}
# A factor of units is taken for a power of ten if it differs by less than this factor.
NEAR_TEN = 1.25
# Masks may turn a cloud themselves, whatever its axes are.
ASK_FOR_A_TURN = "--move pose"
ADVICE_OF_CAMERA = " (--move camera, or --move pose if the cloud is turned)"


@dataclass(frozen=True)
class Words:
    """Makes sentences about views with these ``names``; ``inverted`` by --invert-mask.

    depths : the files of their depth maps, if there are some. depth_scale : as it was given.
    may_turn : whether the cloud may still be asked to turn as one. accepting : --accept-doubtful.
    """

    names: Sequence[str]
    inverted: bool = False
    depths: Sequence[str] = ()
    depth_scale: float = 1.0
    may_turn: bool = True
    accepting: bool = False

    def suspicion(self, findings: Sequence[Finding]) -> str:
        """What may be wrong with the input, and what to try; "" without findings."""
        if not findings:
            return ""
        parts = list(map(self._what_and_option, findings))
        if not findings[0].hypotheses or len(findings[0].views) < len(self.names):
            return "; ".join(f"it looks as if {what}: try {option}" for what, option in parts)
        # Each of the findings would explain the misfit alone.
        options = [option for _, option in parts]
        if self.may_turn and any(map(_is_turned_cloud, findings)):
            options.append(ASK_FOR_A_TURN)
        return f"it looks as if {parts[0][0]}: try {', or '.join(options)}"

    def suspects(self, findings: Sequence[Finding]) -> list[dict[str, Any]]:
        """For JSON: what may be wrong in words, what mends it, and the IoU then (0: unknown)."""
        suspects = []
        for finding in filter(attrgetter("suspicious"), findings):
            what, option = self._what_and_option(finding)
            suspects.append({"what": what, "option": option, "score": finding.score})
        return suspects

    def _what_and_option(self, finding: Finding) -> tuple[str, str]:
        names = [self.names[view] for view in finding.views]
        of_some_views, listed = len(names) < len(self.names), ", ".join(names)
        if finding.name in OPTIONS:
            where = f" in {listed}" if of_some_views else ""
            return finding.says + where, self._option_for(finding)
        if finding.name == "mispaired":
            return self._pairs(finding)
        if finding.without:
            by_option = self.inverted and finding.without == INVERTED
            wrong = "--invert-mask" if by_option else f"--assume {finding.without.text}"
            what, option = f"{wrong} is wrong", f"without {wrong}"
            if of_some_views and not finding.without.view:
                option += f" for {listed}"
        else:
            places = [f"@{name}" for name in names] if of_some_views else [""]
            options = (
                f"--assume {hypothesis.name}{place}"
                for place in places
                for hypothesis in finding.hypotheses
            )
            what, option = finding.says, " ".join(options)
        return f"for {listed} alone {what}" if of_some_views else what, option

    def _option_for(self, symptom: Finding) -> str:
        values = dict(symptom.values)
        if "times" in values:
            values["scale"] = self.depth_scale / float(values["times"])
        # `--camera fit` refuses several masks.
        focal = "--camera fit" if len(self.names) == 1 else EDIT_FOCAL
        option = OPTIONS[symptom.name].format(focal=focal, **values)
        # What was given already mends nothing more.
        accepted = self.accepting and "--accept-doubtful" in option
        return option.partition(", or ")[0] if accepted else option

    def _pairs(self, finding: Finding) -> tuple[str, str]:
        names, pairs = self.names, finding.pairs
        if len(set(names)) < len(names):
            names = [f"view {number}" for number in range(1, len(names) + 1)]
        options = [
            f"{names[mask]} with the camera that {names[camera]} has now"
            for mask, camera in pairs[:MOST_PAIRS]
        ]
        if len(pairs) > MOST_PAIRS:
            options.append(f"and so on, {len(pairs)} in all")
        what = "masks and cameras are paired wrongly"
        if len(pairs) == len(names):
            # All views of a cloud that is turned show what other views show of a right one.
            what += ", or the cloud is turned"
        return what, ", ".join(options)

    def note(self, finding: Finding) -> str:
        """A finding that is worth reading."""
        about_depth = self.depths and finding.name in OF_DEPTH_MAPS
        names = self.depths if about_depth else self.names
        files = ", ".join(names[view] for view in finding.views)
        option = OPTIONS_OF_NOTES.get(finding.name, "")
        if finding.name == "depth-unit":
            option = self._scale(float(finding.values["times"]))
        return f"{f'{files}: ' if files else ''}{finding.says}{option}"

    def _scale(self, times: float) -> str:
        """What mends a depth map whose values are ``times`` the depths."""
        scale = self.depth_scale / times
        power = 10.0 ** round(math.log10(scale))
        if 1.0 / NEAR_TEN < scale / power < NEAR_TEN:
            return f": try --depth-scale {power:g}"
        return f": try --depth-scale {scale:.2g}, or --depth-kind affine"

    def notes(self, findings: Sequence[Finding]) -> list[str]:
        """A sentence for each finding that is no suspicion."""
        return [self.note(finding) for finding in findings if not finding.suspicious]

    def no_overlap(self, error: NoOverlapError) -> InputError:
        """The error with advice by options."""
        diagnosis = error.diagnosis
        advice = self.suspicion(diagnosis.suspicious) or f"{AXES_ADVICE}; {LOOK}"
        return InputError(f"{diagnosis.apart}; {advice}")

    def reason(self, result: RefineResult) -> str:
        """Why a result is doubtful or has no confidence; "" if there is no reason."""
        trust = result.trust
        if trust.reason == FINDING:
            return self.suspicion(list(filter(attrgetter("suspicious"), result.findings)))
        return trust.says + (ADVICE_OF_CAMERA if trust.reason == "camera" else "")

    def warnings(self, result: RefineResult, refused: bool = False) -> list[str]:
        """One sentence each, to read before the result is used.

        Of a result that is ``refused``, an error says why.
        """
        fit, trust = result.fit, result.trust
        reading = reading_of(result.move, result.settings.move, start_of(result))
        messages = [text for text in (reading, _about_the_optimisation(result)) if text]
        if trust.verdict == "doubtful" and not refused:
            sure = (
                f" (confidence {two_places(trust.confidence)})"
                if trust.confidence is not None
                else ""
            )
            effect = ", so the cloud is left as it was" if _withheld(fit) else ""
            if fit.outcome == "moved":
                effect = ", and the points moved"
            messages.append(f"the result is doubtful{sure}{effect}: {self.reason(result)}")
        # A note that is the reason of the doubt is said once.
        notes = [finding for finding in result.findings if finding.name != trust.reason]
        return messages + self.notes(notes)


def _is_turned_cloud(finding: Finding) -> bool:
    hypotheses = finding.hypotheses
    return not finding.without and len(hypotheses) == 1 and hypotheses[0].turns


def two_places(confidence: float) -> str:
    """With two places, rounded down: what is printed as the least confidence is not doubtful."""
    return f"{math.floor(100.0 * confidence + 1e-9) / 100.0:.2f}"


def _withheld(fit: Fit) -> bool:
    """Whether a displacement was too doubtful to be taken."""
    return fit.outcome == "left" and fit.stop_reason == "doubtful"


def why_unmoved(result: RefineResult) -> str | None:
    """Why no point moved, in words; None where points did."""
    fit = result.fit
    if fit.outcome == "moved":
        return None
    masks = "the mask shows" if len(result.views) == 1 else "the masks show"
    if _withheld(fit) and result.trust.reason == FINDING:
        return "the input looks wrong (--accept-doubtful refines the cloud all the same)"
    if _withheld(fit):
        return "the displacement is doubtful (--accept-doubtful takes it all the same)"
    return {
        "max_steps": "no steps of the shape were asked for",
        "interrupted": f"interrupted at step {fit.steps}, before one lowered the loss",
        "non_finite": f"the loss was not a number after step {fit.steps}, and no loss before was "
        "lower than the loss of the start",
        "fits": f"the cloud fits the contours that {masks}",
        "not_improved": f"nothing that was tried agrees better with what {masks}",
    }[fit.stop_reason]


def _about_the_optimisation(result: RefineResult) -> str | None:
    """A sentence if the optimisation stopped early or moved nothing."""
    fit, steps = result.fit, result.settings.steps
    reason = why_unmoved(result)
    if reason and result.move.kind != "nothing":
        if result.move.explains or result.trust.reason == "unsure-place":
            return None
        return f"it moved as one, which does not explain the misfit: {reason}"
    if fit.stop_reason == "fits":
        return None
    if reason and not _withheld(fit):
        return f"nothing moved: {reason}; the cloud is as it was"
    if fit.stop_reason == "interrupted":
        best = "start" if reason else "best so far"
        return f"interrupted at step {fit.steps} of {steps}: the result is the {best}"
    if fit.stop_reason == "non_finite":
        return (
            f"the loss was not a number after step {fit.steps}: the result is the best before that"
        )
    if not reason and fit.moved_max < SMALL_DISPLACEMENT:
        share = f"{100.0 * SMALL_DISPLACEMENT:g} %"
        return f"hardly anything moved: no point by more than {share} of the object's size"
    return None
