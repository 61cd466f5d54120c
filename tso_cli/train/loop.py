"""Training the base network: with points (the PSGN-FC baseline) or with masks (CAPNet, Eq. 6)."""

from __future__ import annotations

import copy
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from types import FrameType
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from .. import __version__
from .. import device as devices
from ..errors import InputError, TsoError
from ..losses import chamfer
from ..network import FRAMES, SUPERVISIONS, BaseNetwork, NetworkConfig, build_network
from .data import TrainingData
from .losses import AffinitySchedule, mask_loss, point_loss
from .state import TrainingState, new_state

Progress = Callable[[int, int, str], None]
Save = Callable[[TrainingState, NetworkConfig], None]
AFFINITIES = ("points", "paper")


@dataclass(frozen=True)
class TrainConfig:
    """Settings of one training.

    Parameters
    ----------
    supervision : "points" (Chamfer to the target, 3D) or "masks" (V views through the projector, 2D).
    frame : "view" or "canonical", the frame of the predicted points (see `network.NetworkConfig`).
    steps : Adam steps in all, those of a resumed run included.
    batch_size : objects a step.
    learning_rate : of Adam; the paper's is 5e-5.
    views : V, supervising masks of each object a step ("masks" only); the paper's is 4.
    affinity_weight : lambda of Eq. 6, dropped to 0.02 of it when the loss saturates ("masks" only). With the form "points",
        of 0, 0.01, 0.1 and 1 the last gave the lowest Chamfer distance on the shipped shapes (150 steps at 3e-4).
    affinity : form of Eq. 5, "points" or "paper" (see `losses.affinity`).
    saturation_steps : window of the running mean that decides on saturation: no improvement by 1 % over the window before.
    sigma_sq : variance of the projection kernel, px^2 of the 64x64 mask.
    points : N, size of the predicted cloud.
    seed : of the weights and of every draw. A run depends on it, on the data and on the device alone.
    device : "cpu", "cuda", "auto" or any name torch knows.

    Raises
    ------
    InputError
        A setting is outside what makes sense.
    """

    supervision: str = "points"
    frame: str = "view"
    steps: int = 1000
    batch_size: int = 16
    learning_rate: float = 5e-5
    views: int = 4
    affinity_weight: float = 1.0
    affinity: str = "points"
    saturation_steps: int = 500
    sigma_sq: float = 0.4
    points: int = 1024
    seed: int = 0
    device: str = "cpu"

    def __post_init__(self) -> None:
        for name, allowed in (("supervision", SUPERVISIONS), ("frame", FRAMES), ("affinity", AFFINITIES)):
            if getattr(self, name) not in allowed:
                raise InputError(f"{name} is {getattr(self, name)!r}, expected {' or '.join(allowed)}")
        for name in ("steps", "batch_size", "views", "saturation_steps", "points"):
            if getattr(self, name) < 1:
                raise InputError(f"{name} is {getattr(self, name)}, expected 1 or more")
        if not 0 <= self.seed < 2**63:
            raise InputError(f"seed is {self.seed}, expected 0 or more, below 2^63")
        for name in ("learning_rate", "sigma_sq"):
            if not 0.0 < getattr(self, name) < np.inf:
                raise InputError(f"{name} is {getattr(self, name):g}, expected a finite number above 0")
        if not 0.0 <= self.affinity_weight < np.inf:
            raise InputError(f"lambda is {self.affinity_weight:g}, expected a finite number, 0 or more")


@dataclass(frozen=True, eq=False)
class TrainResult:
    """A trained network and how it came about.

    Attributes
    ----------
    network, config : ready to be saved and to predict (evaluation mode, on the CPU).
    steps : steps done, those before a resume included.
    stop_reason : "max_steps" or "interrupted" (Ctrl-C).
    history : [steps, 4]: loss, forward and backward (or BCE and affinity), lambda.
    lambda_dropped_at : the step after which lambda dropped, or None.
    """

    network: BaseNetwork
    config: NetworkConfig
    steps: int
    stop_reason: str
    history: NDArray[np.float64]
    lambda_dropped_at: int | None


def network_config(data: TrainingData, config: TrainConfig, steps: int) -> NetworkConfig:
    """What a checkpoint after ``steps`` steps says of itself."""
    settings: dict[str, Any] = {"batch_size": config.batch_size, "learning_rate": config.learning_rate}
    if config.supervision == "masks":
        settings |= {"views": config.views, "lambda": config.affinity_weight, "affinity": config.affinity}
        settings |= {"saturation_steps": config.saturation_steps}
    return NetworkConfig(
        points=config.points,
        frame=config.frame,
        sigma_sq=config.sigma_sq,
        crop_share=data.crop_share,
        background=data.background,
        training_set=data.description,
        supervision=config.supervision,
        seed=config.seed,
        steps=steps,
        version=__version__,
        settings=settings,
    )


def start(data: TrainingData, config: TrainConfig) -> TrainingState:
    """A training at step 0."""
    schedule = AffinitySchedule(config.affinity_weight, config.saturation_steps)
    network = build_network(config.points, config.seed)
    return new_state(network, network_config(data, config, 0), schedule, data.fingerprint(), devices.resolve(config.device))


def train(
    data: TrainingData,
    config: TrainConfig,
    state: TrainingState | None = None,
    *,
    progress: Progress | None = None,
    save: Save | None = None,
    save_every: int = 0,
) -> TrainResult:
    """Train until ``config.steps`` steps are done, or until Ctrl-C (the step at hand is finished first).

    Parameters
    ----------
    state : where to go on (`state.load_training`); None starts anew.
    progress : called after every step with (step, steps, note).
    save : called with the state every ``save_every`` steps (0: never) and at the end.

    Raises
    ------
    InputError
        The data lack what the supervision needs, or the steps asked for are done already.
    TsoError
        The loss stopped being a finite number.
    """
    views = config.views if config.supervision == "masks" else 0
    for item in data.objects:
        if len(item.views) < views:
            raise InputError(f"{item.name}: has {len(item.views)} views, expected at least the {views} that supervise a step")
    state = state or start(data, config)
    if state.step >= config.steps:
        raise InputError(f"{state.step} steps are done already, expected --steps above that")
    device = next(state.network.parameters()).device
    saved_at = -1
    with _interrupt_flag() as interrupted:
        while state.step < config.steps and not interrupted():
            step = state.step
            batch = data.batch(config.seed, step, config.batch_size, views, config.frame)
            images = torch.as_tensor(batch.images, device=device).contiguous(memory_format=torch.channels_last)
            points = state.network(images)
            weight = state.schedule.weight if views else 0.0
            if views:
                loss, first, second = mask_loss(points, batch, config.sigma_sq, weight, config.affinity)
            else:
                loss, first, second = point_loss(points, batch)
            value = float(loss.detach())
            if not np.isfinite(value):
                raise TsoError(
                    f"the loss became {value} in step {step + 1} (learning rate {config.learning_rate:g}); "
                    f"{f'the last checkpoint is from step {saved_at}' if saved_at >= 0 else 'nothing was written'}"
                )
            state.optimiser.zero_grad(set_to_none=True)
            loss.backward()
            state.optimiser.step()
            state.history.append((value, first, second, weight))
            if views:
                state.schedule.observe(value, state.step)
            if progress:
                progress(state.step, config.steps, f"loss {value:.4g}")
            if save and save_every and state.step % save_every == 0 and state.step < config.steps:
                save(state, network_config(data, config, state.step))
                saved_at = state.step
        finished = network_config(data, config, state.step)
        if save:
            save(state, finished)
    network = copy.deepcopy(state.network).cpu().to(memory_format=torch.contiguous_format).eval()  # type: ignore[call-overload]
    return TrainResult(
        network,
        finished,
        state.step,
        "max_steps" if state.step >= config.steps else "interrupted",
        np.array(state.history, dtype=np.float64).reshape(-1, 4),
        state.schedule.dropped_at,
    )


def evaluate(network: BaseNetwork, data: TrainingData, frame: str, views: int = 4) -> tuple[float, float]:
    """Chamfer distance (forward, backward; squared, mean over points, not multiplied) of predictions to the targets.

    The mean over all objects and the first ``views`` views of each; clouds are compared as they are, longest side 1.
    """
    totals = []
    device = next(network.parameters()).device
    with torch.no_grad():
        for index, item in enumerate(data.objects):
            batch = data.assemble([(index, view, []) for view in range(min(views, len(item.views)))], frame)
            points = network(torch.as_tensor(batch.images, device=device))
            forward, backward = chamfer(points, torch.as_tensor(np.stack(batch.targets), device=device))
            totals.append((float(forward.mean()), float(backward.mean())))
    forward_mean, backward_mean = np.mean(totals, axis=0)
    return float(forward_mean), float(backward_mean)


@contextmanager
def _interrupt_flag() -> Iterator[Callable[[], bool]]:
    """Hold Ctrl-C back until a step, or a file, is finished; a second one goes through at once."""
    asked = False

    def note(number: int, frame: FrameType | None) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True

    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return
    before = signal.signal(signal.SIGINT, note)
    try:
        yield lambda: asked
    finally:
        signal.signal(signal.SIGINT, before)
