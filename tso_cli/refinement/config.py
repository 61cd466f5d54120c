"""Settings of a refinement, and what it results in."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.camera import Camera
from ..geometry.window import Box

if TYPE_CHECKING:
    from .coarse_to_fine import CoarseToFineConfig

MODES = ("points", "encoder", "encoder-decoder", "latent")
# The paper's steps, learning rates, and gamma: the encoder variant uses the silhouette alone. It has no latent variant: ours.
PAPER_STEPS = 50
PAPER_LEARNING_RATE = {"points": 5e-4, "encoder": 1e-6, "encoder-decoder": 5e-6, "latent": 1e-3}
PAPER_SIGMA_SQ = 0.4
PAPER_GAMMA = {"points": 1e6, "encoder": 0.0, "encoder-decoder": 1e6, "latent": 1e6}

Array = NDArray[np.float64]


# The same of the preset "best", chosen on validation shapes (docs/accuracy.md).
BEST_STEPS = {"points": 48, "encoder": 12, "encoder-decoder": 12, "latent": 30}
BEST_LEARNING_RATE = {"points": 4e-2, "encoder": 3e-5, "encoder-decoder": 6e-5, "latent": 1e-3}
BEST_GAMMA = 0.0
# Views that want different things take longer to agree: points mode takes its steps for each of up to so many.
MOST_COUNTED = 4
PRESETS = ("best", "paper")

StopReason = Literal["max_steps", "interrupted", "non_finite", "nothing_to_do", "not_improved"]
SymmetryOutcome = Literal["used", "given", "not_asked", "none_found", "contradicted"]


@dataclass(frozen=True)
class RefineConfig:
    """Settings of one refinement. What is None is as the preset has it.

    Parameters
    ----------
    mode : "points" moves the points, "encoder" the encoder's weights, "encoder-decoder" all weights of the network, "latent"
        the 128 numbers between encoder and decoder.
    steps : of the optimiser; 0 returns the start. Paper 50; best 48 in points mode for each view, up to four, 12 of
        weights, 30 of the latent code.
    learning_rate : in points mode stated for a cloud of longest side 1. Best: how far the point that is pulled hardest moves in
        one of the first steps, 0.04; of the encoder's weights 3e-5, of all weights 6e-5, of the latent code 1e-3. Paper:
        Adam's, 5e-4, 1e-6, 5e-6.
    gamma : weight of the Chamfer distance to the start (longest side 1). Best 0; paper 1e6, in encoder mode 0.
    sigma_sq : variance of the projection's Gaussian in squared cells of the window, which has 64 along its side; 0.4, the
        paper's. It is for "paper" and "--refine-camera": the pull of "best" has no Gaussian.
    device : "cpu", "cuda", "auto" or any name torch knows.
    seed : recorded in the result; no variant draws random numbers.
    preset : "best", or "paper": Eq. 7 with the paper's settings, exactly.
    symmetry : "auto" (best, points mode) finds a mirror plane of the start and uses it if there is one; "none" (paper); "x",
        "y", "z", the axis of the input normal to a plane through the middle of its bounding box; or "a,b,c,d", the plane
        ax + by + cz = d.
    refine_camera : correct the camera of each view first, held near the given one; points mode.
    coarse_to_fine : what the preset "best" of points mode is made of, for studies; None for `BEST`.

    Raises
    ------
    InputError
        A value is out of range.
    """

    mode: str = "points"
    steps: int | None = None
    learning_rate: float | None = None
    gamma: float | None = None
    sigma_sq: float | None = None
    device: str = "cpu"
    seed: int = 0
    preset: str = "best"
    symmetry: str | None = None
    refine_camera: bool = False
    coarse_to_fine: CoarseToFineConfig | None = None

    def __post_init__(self) -> None:
        for name, known in (("mode", MODES), ("preset", PRESETS)):
            if getattr(self, name) not in known:
                raise InputError(f"{name} is {getattr(self, name)!r}, expected one of {', '.join(known)}")
        if self.refine_camera and self.mode != "points":
            raise InputError(f"mode is {self.mode!r}, expected points to refine the camera")
        for name in ("steps", "seed"):
            value = getattr(self, name)
            if value is not None and (isinstance(value, bool) or not isinstance(value, int) or value < 0):
                raise InputError(f"{name} is {value!r}, expected a whole number, 0 or more")
        for name, low, high in (("learning_rate", 0.0, 1e6), ("gamma", -1.0, 1e15), ("sigma_sq", 0.0, 1e9)):
            value = getattr(self, name)
            if value is not None and not (isinstance(value, (int, float)) and low < value <= high and value >= 0.0):
                raise InputError(f"{name} is {value!r}, expected a number {'>= 0' if low else '> 0'}, at most {high:g}")
        if self.symmetry is not None:
            parse_symmetry(self.symmetry)
        if self.coarse_to_fine is not None and (self.preset, self.mode) != ("best", "points"):
            raise InputError(f"a recipe is for mode points with preset best, found {self.mode} with {self.preset}")

    def settings(self, views: int = 1) -> Settings:
        """The same with the preset's values in place of None, for clouds that so many views ask."""
        best = self.preset == "best"
        points = best and self.mode == "points"
        steps = BEST_STEPS[self.mode] * (min(views, MOST_COUNTED) if points else 1) if best else PAPER_STEPS
        rates = BEST_LEARNING_RATE if best else PAPER_LEARNING_RATE
        gamma = BEST_GAMMA if best else PAPER_GAMMA[self.mode]
        return Settings(
            mode=self.mode,
            preset=self.preset,
            steps=steps if self.steps is None else self.steps,
            learning_rate=rates[self.mode] if self.learning_rate is None else self.learning_rate,
            gamma=gamma if self.gamma is None else self.gamma,
            symmetry=("auto" if points else "none") if self.symmetry is None else self.symmetry,
            sigma_sq=PAPER_SIGMA_SQ if self.sigma_sq is None else self.sigma_sq,
            device=self.device,
            seed=self.seed,
            refine_camera=self.refine_camera,
            coarse_to_fine=self.coarse_to_fine,
        )


@dataclass(frozen=True)
class Settings:
    """A `RefineConfig` whose every value is known, but for ``coarse_to_fine``."""

    mode: str
    preset: str
    steps: int
    learning_rate: float
    gamma: float
    symmetry: str
    sigma_sq: float
    device: str
    seed: int
    refine_camera: bool
    coarse_to_fine: CoarseToFineConfig | None

    @property
    def staged(self) -> bool:
        """Whether points are pulled in stages (refinement/best.py) and not moved down the paper's objective."""
        return self.preset == "best" and self.mode == "points"


def parse_symmetry(text: str) -> str | tuple[float, float, float, float]:
    """One of auto, none, x, y, z, or the four numbers of a,b,c,d; InputError for anything else."""
    if text in ("auto", "none", "x", "y", "z"):
        return text
    expected = "expected auto, none, x, y, z or four numbers a,b,c,d of the plane ax + by + cz = d"
    try:
        a, b, c, d = (float(part) for part in text.split(","))
    except (ValueError, AttributeError):
        raise InputError(f"symmetry is {text!r}, {expected}") from None
    if not math.isfinite(a + b + c + d) or a * a + b * b + c * c == 0.0:
        raise InputError(f"symmetry is {text!r}, whose normal has no direction; {expected}")
    return a, b, c, d


@dataclass(frozen=True, eq=False)
class RefineResult:
    """What came of it, and how it was reached.

    Attributes
    ----------
    points, initial : [N, 3] float64, in the frame and units of the input (network modes: of the network's output); of a mesh
        its vertices.
    mode : which parameters moved.
    steps : steps done; best_step : the step that the result is from (0: the start was best); with the preset "best" of points
        mode, whose result is a mean over the stages, that of the last stage's best.
    stop_reason : "max_steps"; "interrupted" (Ctrl-C: the best so far is kept); "non_finite" (the loss was no number); or, where
        the result is the start, "nothing_to_do" (its loss is 0) or "not_improved" (no step had a lower loss).
    warnings : what to know before the result is used, in words, a sentence each: that nothing moved and why, masks of few
        pixels, views that the others contradict.
    losses : the objective at the start and after every step. loss_before, loss_after : of the start and of the result. With the
        preset "best" the objective changes twice on the way: these two are both by the last.
    iou_before, iou_after : of the mask (> 0.5) and the cloud's silhouette, the gaps between its points closed as far as their
        spacing asks, in the square around both (`tso_cli.evaluation.footprint`); mean over views.
    view_ious : the two of each view. view_trust : 1, or less where the other views contradict it. view_weights : of its loss in
        the objective, its trust divided among those that show the same side.
    moved_mean, moved_max : how far the points moved, in shares of the object's size, the longest side of the start's box.
    chamfer_to_initial : squared distances, mean over points, both directions summed, for a cloud of longest side 1.
    surface : of a mesh the points [S, 3] drawn from its surface before and after, which IoU is of; None of a cloud.
    surface_samples : how many of these moved, which the way of the points and chamfer_to_initial are of; None of a cloud.
    symmetry : a, b, c, d of the mirror plane ax + by + cz = d that was used, in the frame of the input, or None.
    symmetry_outcome : "used" (a plane that was found), "given", or none: "not_asked", "none_found" (the cloud has none) or
        "contradicted" (the cloud has one, the pictures speak against it). symmetry_reason : by what measure, in words.
    learning_rate, gamma, sigma_sq, device, seed : what was used; sigma_sq in squared cells.
    view_windows : left, top, right, bottom edges of the square of each mask, px, that the cloud was compared with at last, and
        cells along its side.
    cameras : of each view; with ``refine_camera`` as they were corrected.
    seconds : wall time of each phase.
    """

    points: Array
    initial: Array
    mode: str
    steps: int
    best_step: int
    stop_reason: StopReason
    losses: list[float]
    loss_before: float
    loss_after: float
    iou_before: float
    iou_after: float
    view_ious: list[tuple[float, float]]
    view_trust: list[float]
    view_weights: list[float]
    view_windows: list[tuple[Box, int]]
    moved_mean: float
    moved_max: float
    chamfer_to_initial: float
    symmetry: tuple[float, float, float, float] | None
    symmetry_outcome: SymmetryOutcome
    symmetry_reason: str
    preset: str
    learning_rate: float
    gamma: float
    sigma_sq: float
    device: str
    seed: int
    cameras: tuple[Camera, ...]
    seconds: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    surface: tuple[Array, Array] | None = None
    surface_samples: int | None = None

    @property
    def shown(self) -> tuple[Array, Array]:
        """What is judged, before and after: the points of a cloud, or those [S, 3] drawn from a surface."""
        return self.surface or (self.initial, self.points)

    @property
    def averaged(self) -> bool:
        """Whether the points are a mean over stages, not one iterate."""
        return self.preset == "best" and self.mode == "points"

    @property
    def objective(self) -> str:
        """What the losses are of, in words."""
        held = f"{self.gamma:g} x Chamfer to the start"
        if self.preset == "paper":
            return f"BCE + {held}"
        return "pull of the mask + what it costs to leave the start" + (f" + {held}" if self.gamma else "")
