"""What a refinement results in."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from typing import Any, Literal

from ..diagnosis.findings import Finding
from ..diagnosis.trust import Trust
from ..evaluation.footprint import Solid
from ..geometry.arrays import Array, Bits, Box
from ..geometry.camera import Camera
from ..optimisation.config import Settings
from ..optimisation.symmetry import SymmetryDecision
from ..pose.move import Move

StopReason = Literal[
    "max_steps",
    "interrupted",
    "non_finite",
    "not_improved",
    "fits",
    "doubtful",
]
Outcome = Literal["moved", "left"]


@dataclass(frozen=True)
class Fit:
    """How the optimisation of the shape went, and how far the cloud agrees with its views.

    A move as one (`RefineResult.move`) is no part of it, but the IoU before is that of the cloud
    and the cameras that were given.

    outcome : "moved"; or "left": the shape is as it was (``stop_reason``).
    steps : steps that were done. best_step : the step that the result is from. 0 is where the
        optimisation began: a moved cloud with 0 is as the learned prior moved it.
    stop_reason : "max_steps". After "interrupted" (Ctrl-C) and "non_finite" (the loss became NaN or
        infinite) the best so far is kept. Where the result is the start: "fits" (it fits the
        contours), "not_improved" (no moved cloud was better) or "doubtful" (what moved may be
        worse).
    losses : the objective where the optimisation begins, and after every step.
    loss_before, loss_after : of the start and of the result; with the default preset in points
        mode without the position prior.
    iou_before, iou_after : of the mask (> 0.5) and the cloud's silhouette, whose footprints follow
        the cloud's spacing (evaluation/footprint.py), in the square around both; mean over views.
    moved_by_prior : mean length of the displacements of the control points by the learned prior, in
        longest sides of the start. The optimisation goes on from there.
    moved_mean, moved_max : length of the displacements of the control points, in longest sides of
        the start.
    chamfer_to_initial : squared distances of control points, mean over points, both directions
        summed, for a cloud of longest side 1.
    """

    outcome: Outcome
    steps: int
    best_step: int
    stop_reason: StopReason
    losses: list[float]
    loss_before: float
    loss_after: float
    iou_before: float
    iou_after: float
    moved_by_prior: float
    moved_mean: float
    moved_max: float
    chamfer_to_initial: float


@dataclass(frozen=True, eq=False)
class ViewFit:
    """One view in a result.

    name : of the view. camera : as it is meant, or where it moved to.
    iou_before, iou_after : as in `Fit`.
    inlier_weight : of its loss in the objective: under 1 where the other views contradict the view.
    window : left, top, right, bottom edges, px, of the window that the cloud was compared with at
        last. cells : along its side.
    """

    name: str
    camera: Camera
    iou_before: float
    iou_after: float
    inlier_weight: float
    window: Box
    cells: int


@dataclass(frozen=True)
class Cost:
    """seconds : wall time of each phase."""

    seconds: dict[str, float]


@dataclass(frozen=True, eq=False)
class RefineResult:
    """The refined cloud, and how it was reached.

    Attributes
    ----------
    points, initial : [N, 3] float64, in the frame and units of the input (network modes: of the
        network's output); of a mesh its vertices.
    measured : the points that measures are of, before and after [M, 3]: all points but outliers,
        or samples of a mesh's surface.
    solids : what silhouettes are drawn of, before and after: these points, or triangles.
    outliers : [N] bool, points that are not the object, far from the rest or left out by most
        masks: only a move as one moves them, and no measure counts them.
    control_points : how many points moved by themselves; all others follow.
    of_mesh : whether the surface of a mesh was refined.
    settings : every setting with its value. fit, views, symmetry, trust, cost : see there.
    move : what moved as one before the shape was refined.
    findings : what may be wrong with the input, suspicious ones first; read them before the result
        is used.
    determined : in [0, 1], the share of the points' motions that masks and depth maps fix
        (`diagnosis/determined.py`). None for the preset "paper" and the network modes.
    point_confidence : [N] in [0, 1], the same for each of the ``points``; 0 for outliers.
        None unless `RefineConfig` asks for it.
    """

    points: Array
    initial: Array
    measured: tuple[Array, Array]
    solids: tuple[Solid, Solid]
    outliers: Bits
    control_points: int
    of_mesh: bool
    settings: Settings
    fit: Fit
    move: Move
    views: tuple[ViewFit, ...]
    symmetry: SymmetryDecision
    trust: Trust
    cost: Cost
    findings: tuple[Finding, ...] = ()
    determined: float | None = None
    point_confidence: Array | None = None

    @property
    def moved(self) -> bool:
        """Whether anything moved: the shape, the cloud as one, or cameras."""
        return self.fit.outcome == "moved" or self.move.kind != "nothing"

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """The camera of each view, where it moved to if cameras moved."""
        return tuple(view.camera for view in self.views)


def as_given(result: RefineResult, points: Any) -> RefineResult:
    """``result`` with tensors for its points, if the ``points`` that were given are a tensor."""
    torch: Any = sys.modules.get("torch")
    if torch is None or not isinstance(points, torch.Tensor):
        return result
    dtype = points.dtype if points.is_floating_point() else torch.get_default_dtype()
    before, after = (torch.as_tensor(a, dtype=dtype, device=points.device)
                     for a in (result.initial, result.points))  # fmt: skip
    return replace(result, initial=before, points=after)
