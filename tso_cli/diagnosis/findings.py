"""What the diagnosis reports: findings, as data."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

from .assumptions import Assumption
from .hypotheses import Hypothesis, hypothesis_called

# What makes a result doubtful, apart from hypotheses.
SUSPICIOUS_SYMPTOMS = {
    "box": "the mask is the bounding box of the object",
    "mispaired": "masks and cameras are paired wrongly",
    "focal-length": "the focal length is {percent:.0f} % too {how}, or the object is as much "
    "{otherwise} than the cloud",
    "aspect": "fy is {percent:.0f} % too {how} for fx, as K of a picture that was squashed",
    "principal-point": "the principal point is {x:+.0f}, {y:+.0f} px off, as K of a picture that "
    "was cropped",
    "outline": "the mask is {pixels:.1f} px too {how} on all sides",
    "depth-apart": "the depth maps are {share:.0f} % of the object's size too {how}, or the cloud "
    "is as much too {other}",
    "depth-contradicts": "the depth maps are wrong, or the cloud is wrong in depth: it fits the "
    "masks, and is {off:.0f} % of its size off the maps",
    "pose": "the cloud is turned by {degrees:.0f} degrees and shifted by {share:.0f} % of its size",
    "shift": "the cloud is shifted by {share:.0f} % of its size",
}
# What a depth map holds.
OF_DEPTH_MAPS = {
    "depth-inverse": "the map looks like inverse depth (rank correlation with the cloud's depth "
    "{rank:.2f}) and is ignored",
    "depth-affine": "the map looks like depth up to scale and shift (rank correlation with the "
    "cloud's depth {rank:.2f}, relief {relief:.2g} times the cloud's in one unit) and is ignored",
    "depth-ray": "the map looks like distance along the ray ({of_ray:.1%} of the cloud's size off, "
    "as depth along z {off:.1%}) and is ignored",
    "depth-unit": "the map's values are {times:.3g} times the cloud's depths, so it is ignored",
    "depth-unrelated": "the map does not fit the cloud or is of another picture (rank correlation "
    "with the cloud's depth {rank:.2f}, known on {covered:.0%} of the mask) and is ignored",
    "depth-fitted": "the map of kind {kind} is fitted to the cloud: {what} = {scale:.4g} x value "
    "{shift:+.4g} (rank correlation with the cloud's depth {rank:.2f})",
    "depth-unfitted": "the map of kind {kind} cannot be fitted to the cloud (rank correlation with "
    "the cloud's depth {rank:.2f} in {places} places) and is ignored",
}
ASSUMED_CAMERA = "assumed-camera"
# What is worth reading before a result is used.
NOTES = {
    **OF_DEPTH_MAPS,
    "depth-noisy": "neighbouring depths differ by noise of {deviation:.3g}, so each is averaged "
    "with those of the same surface around it",
    "foreign-part": "something that is not the object seems to take {share:.0f} % of the mask, so "
    "the mask counts nothing there",
    "outline-corrected": "the mask seems {pixels:.1f} px too {how} on all sides, and is corrected",
    "missing-part": "{share:.0f} % of the cloud lie outside the mask, where the rest of it fits: "
    "something hides the object, or the cloud holds something else; they stay",
    "unsure-camera": "the fitted camera is unsure: {why}",
    "unsure-place": "the place of the cloud is unsure: {why}",
    "photo": "looks like a photo, grey in many places; expected a mask, light on the object and "
    "dark around it",
    "coarse": "shows the object with few pixels ({pixels}): details smaller than 1/{side} of its "
    "size cannot be seen",
    "specks": "foreground far from the object is left out ({pixels} px)",
    "behind": "{behind} of {points} points lie behind the camera and take no part",
    "contradicted": "the other views contradict it, so it counts for little (inlier weight "
    "{weight:.2f} of 1); is its mask or camera wrong?",
    ASSUMED_CAMERA: "no camera was given, so the canonical camera is assumed; is it right?",
    "assumed-picture": "the network infers sizes from the whole picture, which without a camera "
    "file is taken for a picture of the canonical camera",
    "outliers": "points far from the rest stay where they are, and no measure counts them "
    "(found {count:,})",
    "left-out": "{count:,} points ({share:.0f} %) lie outside the masks, which the others fit: "
    "they are not the object, or something hides them; they stay, and no measure counts them",
    "faint": "{count:,} splats have an opacity under 5 %: they move along, and nothing depends on "
    "them",
    "not-a-mesh": "{why}, so the vertices are taken for a cloud",
}
SYMPTOMS = SUSPICIOUS_SYMPTOMS | NOTES
"""Name of a finding that is not a hypothesis -> words."""


@dataclass(frozen=True)
class Finding:
    """Something that may be wrong with the input, or that limits what it shows.

    Attributes
    ----------
    name : of a hypothesis, of two that are joined by "+", or of a symptom (`SYMPTOMS`).
    views : numbers of the views that it is about; all views where it is about the whole input.
    score : IoU of cloud and masks in coarse cells if the hypothesis is right; 0 if unknown.
    gain : how much higher the score is than the IoU as the input is given.
    without : the assumption that was given and is probably wrong; None if the hypothesis is
        probably right.
    pairs : of "mispaired" (mask, camera): numbers of the view whose mask belongs to the camera of
        the other view.
    values : the numbers in the words of a symptom.
    """

    name: str
    views: tuple[int, ...] = ()
    score: float = 0.0
    gain: float = 0.0
    without: Assumption | None = None
    pairs: tuple[tuple[int, int], ...] = ()
    values: Mapping[str, float | str] = field(default_factory=dict)

    @property
    def suspicious(self) -> bool:
        """Whether the input may be wrong, so that the result is doubtful.

        An unsure camera makes a result doubtful too, but nothing is known to be wrong with it.
        """
        return self.name not in NOTES

    @property
    def hypotheses(self) -> tuple[Hypothesis, ...]:
        """What is right if the finding is; () of a symptom."""
        return tuple(filter(None, map(hypothesis_called, self.name.split("+"))))

    def assumed(self, given: Iterable[Assumption]) -> list[Assumption]:
        """What is assumed if the finding is right, where the ``given`` assumptions were."""
        if self.without:
            return [assumption for assumption in given if assumption != self.without]
        return [*given, *map(Assumption, self.hypotheses)]

    @property
    def says(self) -> str:
        """In words, without the names of views."""
        if self.without:
            return f"the assumption {self.without.text} is wrong"
        if self.hypotheses:
            return " and ".join(hypothesis.says for hypothesis in self.hypotheses)
        return SYMPTOMS[self.name].format(**self.values)

    def __str__(self) -> str:
        views = ", ".join(map(str, self.views))
        where = f" (view{'s' * (len(self.views) != 1)} {views})" if views else ""
        score = f": IoU {self.score:.2f}, {self.gain:+.2f}" if self.score else ""
        return f"{self.says}{where}{score}"
