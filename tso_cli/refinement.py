"""Test-stage optimisation (Eq. 7 of the paper): one loop, whose variants differ only in which parameters move."""

from __future__ import annotations

import copy
import math
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from . import device as devices
from .adam import Adam
from .camera import Camera
from .errors import InputError, TsoError
from .geometry import as_points, bounding_box_normalisation
from .losses import ChamferToInitial
from .metrics import iou
from .objective import MaskObjective
from .placement import place, require_overlap
from .projection import default_sigma_sq, silhouette_of
from .scene import View

if TYPE_CHECKING:
    from .network import BaseNetwork

MODES = ("points", "encoder", "encoder-decoder")
# The paper's learning rates, and gamma: the encoder variant uses the silhouette alone.
PAPER_LEARNING_RATE = {"points": 5e-4, "encoder": 1e-6, "encoder-decoder": 5e-6}
PAPER_GAMMA = {"points": 1e6, "encoder": 0.0, "encoder-decoder": 1e6}

# Clouds up to this size are moved by one CPU thread.
SMALL_CLOUD = 8192

Array = NDArray[np.float64]
Progress = Callable[[int, int, float], None]


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

    def __post_init__(self) -> None:
        if self.mode not in MODES:
            raise InputError(f"mode is {self.mode!r}, expected one of {', '.join(MODES)}")
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


def refine(
    points: Any,
    masks: Any,
    cameras: Camera | Sequence[Camera] | None = None,
    config: RefineConfig | None = None,
    *,
    network: BaseNetwork | None = None,
    image: Any = None,
    progress: Progress | None = None,
) -> RefineResult:
    """Move a cloud, or the network that predicts it, until its projection agrees with the masks.

    Parameters
    ----------
    points : [N, 3] array or tensor; None in the network modes, where the network's prediction is the start.
    masks : one [H, W] array in [0, 1], a sequence of them, or :class:`tso_cli.scene.View` objects, which bring their own camera
        and ignore map.
    cameras : one for each mask; None for the canonical camera.
    config : settings, by default the paper's.
    network : for the modes "encoder" and "encoder-decoder"; it is copied, never changed.
    image : [3, 64, 64] network input in [0, 1], array or tensor.
    progress : called after every step with (step, steps, loss).

    Returns
    -------
    RefineResult; its points are the best iterate of BCE + gamma * Chamfer, the start being a candidate.

    Raises
    ------
    InputError
        Points, masks or cameras that cannot be used or do not meet, or a mode that lacks its network.
    TsoError
        The loss of the start, or after the first step, is not a finite number.
    """
    config = config or RefineConfig()
    seconds: dict[str, float] = {}
    views = as_views(masks, cameras)
    device = devices.resolve(config.device)
    with _timed(seconds, "prepare"):
        start: _PointsStart | _NetworkStart
        if config.mode == "points":
            start = _PointsStart(points, device)
        else:
            start = _NetworkStart(network, image, config.mode, device)
        for view in views:
            require_overlap(place(start.initial, view), view)
        first = start.produce().detach().clone()
        mask_term = MaskObjective(views, start.centre, start.scale, config.sigma_sq, first)
        chamfer = ChamferToInitial(first)
    gamma = PAPER_GAMMA[config.mode] if config.gamma is None else config.gamma
    learning_rate = config.learning_rate or PAPER_LEARNING_RATE[config.mode]

    def objective(moved: Tensor) -> Tensor:
        loss = mask_term(moved)
        return loss + gamma * chamfer(moved) if gamma else loss

    small = len(first) <= SMALL_CLOUD
    with _timed(seconds, "optimise"), devices.one_thread(small and network is None):
        best, best_step, losses, stop_reason = _descend(
            start.produce, start.parameters, objective, config.steps, learning_rate, progress
        )
    # What did not move keeps every bit of the input.
    refined = start.initial + start.scale * (best.double() - first.double()).cpu().numpy()
    first_camera = views[0].camera
    with _timed(seconds, "judge"), devices.one_thread(small):
        before, after = (float(np.mean([_view_iou(p, v, config.sigma_sq) for v in views])) for p in (start.initial, refined))
        moved_by = float(chamfer(best))
    return RefineResult(
        points=refined,
        initial=start.initial,
        mode=config.mode,
        steps=len(losses) - 1,
        best_step=best_step,
        stop_reason=stop_reason,
        losses=losses,
        loss_before=losses[0],
        loss_after=losses[best_step],
        iou_before=before,
        iou_after=after,
        chamfer_to_initial=moved_by,
        learning_rate=learning_rate,
        gamma=gamma,
        sigma_sq=config.sigma_sq or default_sigma_sq(first_camera.width, first_camera.height),
        device=str(device),
        seed=config.seed,
        seconds=seconds,
    )


def _descend(
    produce: Callable[[], Tensor],
    parameters: list[Tensor],
    objective: Callable[[Tensor], Tensor],
    steps: int,
    learning_rate: float,
    progress: Progress | None,
) -> tuple[Tensor, int, list[float], str]:
    """Adam on ``parameters``; returns the best cloud [N, 3], its step, all losses and why it stopped."""
    optimiser = Adam(parameters, learning_rate)
    best = produce().detach().clone()
    best_step, losses = 0, []
    stop_reason = "max_steps"
    try:
        for step in range(steps + 1):
            moved = produce()
            loss = objective(moved)
            value = loss.item()
            if not math.isfinite(value):
                if step == 0:
                    raise TsoError(f"the loss of the start is {value}, expected a finite number")
                if step == 1:
                    raise TsoError(f"the loss is {value} after the first step, expected a number (a smaller learning rate?)")
                stop_reason = "non_finite"
                break
            losses.append(value)
            if value < losses[best_step]:
                best, best_step = moved.detach().clone(), step
            if progress and step:
                progress(step, steps, value)
            if step < steps:
                optimiser.step(loss)
    except KeyboardInterrupt:
        if not losses:
            raise
        stop_reason = "interrupted"
    return best, best_step, losses, stop_reason


class _PointsStart:
    """The points themselves move, normalised to longest side 1."""

    def __init__(self, points: Any, device: torch.device) -> None:
        if points is None:
            raise InputError("mode points needs points, found none")
        if isinstance(points, Tensor):
            points = points.detach().cpu().numpy()
        self.initial = as_points(points, "points")
        self.centre, self.scale = bounding_box_normalisation(self.initial, "points")
        normalised = (self.initial - self.centre) / self.scale
        self._moved = torch.tensor(normalised, dtype=torch.float32, device=device, requires_grad=True)
        self.parameters: list[Tensor] = [self._moved]

    def produce(self) -> Tensor:
        return self._moved


class _NetworkStart:
    """A copy of the network moves, and with it the cloud it predicts from the image."""

    def __init__(self, network: BaseNetwork | None, image: Any, mode: str, device: torch.device) -> None:
        if network is None or image is None:
            raise InputError(f"mode {mode} needs a network and an image")
        self._network = copy.deepcopy(network).float().to(device).eval()
        self._image = torch.as_tensor(image, dtype=torch.float32, device=device).unsqueeze(0)
        moving = self._network.encoder if mode == "encoder" else self._network
        self._network.requires_grad_(False)
        moving.requires_grad_(True)
        self.parameters: list[Tensor] = list(moving.parameters())
        with torch.no_grad():
            predicted = self._network(self._image)[0]
        self.initial = as_points(predicted.cpu().numpy(), "the network's prediction")
        self.centre, self.scale = bounding_box_normalisation(self.initial, "the network's prediction")
        self._centre = torch.as_tensor(self.centre, dtype=torch.float32, device=device)

    def produce(self) -> Tensor:
        return (self._network(self._image)[0] - self._centre) / self.scale


def as_views(masks: Any, cameras: Camera | Sequence[Camera] | None = None) -> tuple[View, ...]:
    """One :class:`View` for each mask; raises InputError if masks and cameras do not pair up."""
    if isinstance(masks, View):
        masks = [masks]
    if isinstance(masks, Sequence) and masks and all(isinstance(mask, View) for mask in masks):
        if cameras is not None:
            raise InputError("views bring their own cameras, expected none beside them")
        return tuple(masks)
    if isinstance(masks, (Tensor, np.ndarray)) and masks.ndim == 2:
        masks = [masks]
    try:
        arrays = [_as_array(mask) for mask in masks]
    except (TypeError, ValueError):
        raise InputError("masks are no arrays of numbers, expected one [H, W] or a sequence of them") from None
    if any(mask.ndim != 2 for mask in arrays):
        raise InputError(f"a mask has shape {[list(m.shape) for m in arrays if m.ndim != 2][0]}, expected [H, W]")
    if cameras is None:
        cameras = [Camera.canonical(mask.shape[-1], mask.shape[0]) for mask in arrays]
    elif isinstance(cameras, Camera):
        cameras = [cameras]
    if len(arrays) == 0 or len(arrays) != len(cameras):
        raise InputError(f"found {len(arrays)} masks and {len(cameras)} cameras, expected one camera for each mask")
    return tuple(View(mask, camera, name=f"mask {i}") for i, (mask, camera) in enumerate(zip(arrays, cameras, strict=True)))


def _as_array(mask: Any) -> NDArray[np.float32]:
    if isinstance(mask, Tensor):
        mask = mask.detach().cpu().numpy()
    return np.asarray(mask, dtype=np.float32)


def _view_iou(points: Array, view: View, sigma_sq: float | None) -> float:
    return iou(silhouette_of(points, view.camera, sigma_sq), view.mask, view.known)


@contextmanager
def _timed(seconds: dict[str, float], phase: str) -> Iterator[None]:
    start = time.perf_counter()
    yield
    seconds[phase] = time.perf_counter() - start
