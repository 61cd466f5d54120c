"""Settings of a refinement, and what it results in."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ..camera import Camera
from ..errors import InputError

MODES = ("points", "encoder", "encoder-decoder")
# The paper's learning rates, and gamma: the encoder variant uses the silhouette alone.
PAPER_LEARNING_RATE = {"points": 5e-4, "encoder": 1e-6, "encoder-decoder": 5e-6}
PAPER_GAMMA = {"points": 1e6, "encoder": 0.0, "encoder-decoder": 1e6}

Array = NDArray[np.float64]


@dataclass(frozen=True)
class RefineConfig:
    """Settings of one refinement; the defaults are the paper's.

    Parameters
    ----------
    mode : "points" moves the points, "encoder" the encoder's weights, "encoder-decoder" all weights of the network.
    steps : Adam steps; 0 returns the start.
    learning_rate : None for the paper's 5e-4, 1e-6, 5e-6. In points mode it is stated for a cloud of longest side 1.
    gamma : weight of the Chamfer distance to the start (longest side 1); None for the paper's 1e6, in encoder mode 0.
    sigma_sq : variance of the projection's Gaussian, px^2 of the mask; None for 0.4 (max(W, H) / 64)^2.
    refine_camera : move the camera of each view too, held near the given one; points mode.
    device : "cpu", "cuda", "auto" or any name torch knows.
    seed : recorded in the result; none of the three variants draws random numbers.

    Raises
    ------
    InputError
        A value is out of range.
    """

    mode: str = "points"
    steps: int = 50
    learning_rate: float | None = None
    gamma: float | None = None
    sigma_sq: float | None = None
    device: str = "cpu"
    seed: int = 0
    refine_camera: bool = False

    def __post_init__(self) -> None:
        if self.mode not in MODES:
            raise InputError(f"mode is {self.mode!r}, expected one of {', '.join(MODES)}")
        if self.refine_camera and self.mode != "points":
            raise InputError(f"mode is {self.mode!r}, expected points to refine the camera")
        for name in ("steps", "seed"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, int) or value < 0:
                raise InputError(f"{name} is {value!r}, expected a whole number, 0 or more")
        for name, low, high in (("learning_rate", 0.0, 1e6), ("gamma", -1.0, 1e15), ("sigma_sq", 0.0, 1e9)):
            value = getattr(self, name)
            if value is not None and not (isinstance(value, (int, float)) and low < value <= high and value >= 0.0):
                raise InputError(f"{name} is {value!r}, expected a number {'>= 0' if low else '> 0'}, at most {high:g}")


@dataclass(frozen=True, eq=False)
class RefineResult:
    """The best iterate and how it was reached.

    Attributes
    ----------
    points, initial : [N, 3] float64, in the frame and units of the input (network modes: of the network's output).
    mode : which parameters moved.
    steps : steps done; best_step : the step that the result is from (0: the start was best).
    stop_reason : "max_steps", "interrupted" (Ctrl-C: the best so far is kept) or "non_finite" (the loss was no number).
    losses : the objective at the start and after every step; loss_before, loss_after : of the start and of the result.
    iou_before, iou_after : silhouette > 0.5 against mask > 0.5 at the mask's own resolution, mean over views.
    chamfer_to_initial : squared distances, mean over points, both directions summed, for a cloud of longest side 1.
    learning_rate, gamma, sigma_sq, device, seed : what was used; sigma_sq in px^2 of the first mask.
    seconds : wall time of each phase.
    cameras : of each view; with ``refine_camera`` as they were moved.
    """

    points: Array
    initial: Array
    mode: str
    steps: int
    best_step: int
    stop_reason: str
    losses: list[float]
    loss_before: float
    loss_after: float
    iou_before: float
    iou_after: float
    chamfer_to_initial: float
    learning_rate: float
    gamma: float
    sigma_sq: float
    device: str
    seed: int
    seconds: dict[str, float] = field(default_factory=dict)
    cameras: tuple[Camera, ...] = ()
