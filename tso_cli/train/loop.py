"""Training of the base network with points (PSGN-FC), with masks (CAPNet, Eq. 6), or with both."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from .. import device as devices
from ..errors import InputError
from ..network.model import BaseNetwork, NetworkConfig, build_network
from ..silhouette.chamfer import chamfer
from ..version import __version__
from .batches import Batch, Draw, assemble
from .config import TrainConfig
from .data import TrainingData
from .losses import AffinitySchedule
from .processes import Processes
from .state import TrainingState, new_state
from .step import Objective, batch_loss, draw_step, predict
from .trainer import Progress, prefetched, require_finite, run

Save = Callable[[TrainingState, NetworkConfig], None]


@dataclass(frozen=True, eq=False)
class TrainResult:
    """A trained network (in evaluation mode, on the CPU), and the course of its training.

    steps : number of steps done, including the steps before a resume.
    stop_reason : "max_steps" or "interrupted" (Ctrl-C).
    history : [steps, 4] loss, its two terms (forward and backward, or BCE and affinity), lambda.
    lambda_dropped_at : the step after which lambda dropped, or None.
    """

    network: BaseNetwork
    config: NetworkConfig
    steps: int
    stop_reason: str
    history: NDArray[np.float64]
    lambda_dropped_at: int | None


def network_config(data: TrainingData, config: TrainConfig, steps: int) -> NetworkConfig:
    """The configuration in a checkpoint after ``steps`` steps."""
    names = ("batch_size", "learning_rate", "averaging", "balance", "augment", "precision")
    settings: dict[str, Any] = {name: getattr(config, name) for name in names}
    if config.recipe:
        settings["recipe"] = config.recipe
    if config.decay != "none":
        # The rate of a step depends on the number of all.
        settings |= {"decay": config.decay, "decay_steps": config.steps}
    if config.supervision != "points":
        settings |= {
            "views": config.views if config.supervision == "masks" else 1,
            "lambda": config.affinity_weight,
            "affinity": config.affinity,
            "saturation_steps": config.window,
            "category_sigma_sq": dict(config.category_sigma_sq),
        }
    if config.supervision == "joint":
        settings["joint_weight"] = config.joint_weight
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


def start(
    data: TrainingData, config: TrainConfig, initial: BaseNetwork | None = None
) -> TrainingState:
    """A training at step 0, from random weights or from the weights of ``initial``."""
    schedule = AffinitySchedule(config.affinity_weight, config.window)
    network = copy.deepcopy(initial) if initial else build_network(config.points, config.seed)
    if network.decoder.points != config.points:
        raise InputError(
            f"the initial network predicts {network.decoder.points} points, "
            f"expected {config.points}"
        )
    device = devices.for_training(config.device, config.precision)
    return new_state(network, config.learning_rate, schedule, data.fingerprint(), device)


def train(
    data: TrainingData,
    config: TrainConfig,
    state: TrainingState | None = None,
    *,
    masked: TrainingData | None = None,
    objective: Objective | None = None,
    processes: Processes | None = None,
    progress: Progress | None = None,
    save: Save | None = None,
    save_every: int = 0,
) -> TrainResult:
    """Train until ``config.steps`` steps are done, or until Ctrl-C; the current step is finished.

    Parameters
    ----------
    state : state to continue from (`state.load_training`); None starts anew.
    masked : images with one mask each ("joint" only).
    objective : replaces the loss of supervision with masks; its batches hold the targets too.
    processes : processes that train together; their number changes the result only by rounding.
    progress : called after every step with (step, steps, note), in the first process.
    save : called with the state every ``save_every`` steps (0: never) and at the end, in the first
        process.

    Raises InputError if the data lack what the supervision needs, or if the steps are done already.
    Raises TsoError if the loss is not finite.
    """
    processes = processes or Processes()
    _require_data(data, masked, config, processes)
    state = state or start(data, config)
    if state.step > config.steps:
        raise InputError(
            f"steps is {config.steps}, expected more: {state.step} steps are done already"
        )
    device = next(state.network.parameters()).device
    if not processes.first:
        save = progress = None

    def draw(step: int) -> list[Batch]:
        return draw_step(data, masked, config, processes, step, targets=objective is not None)

    def take(batches: list[Batch]) -> str:
        weight = state.schedule.weight if config.supervision != "points" else 0.0
        clouds = predict(state.network, batches, config.precision)
        if objective:
            loss, first, second = objective(clouds[0], batches[0], weight)
        else:
            loss, first, second = batch_loss(clouds, batches, config, weight)
        state.optimiser.zero_grad(set_to_none=True)
        loss.backward()
        row = torch.tensor(
            [float(loss.detach()), first, second], dtype=torch.float64, device=device
        )
        processes.average([row])
        value, first, second = row.tolist()
        rate = f"learning rate {config.learning_rate:g}"
        require_finite(value, state.step, rate, save_every if save else 0)
        processes.average(p.grad for p in state.network.parameters() if p.grad is not None)
        for group in state.optimiser.param_groups:
            group["lr"] = config.rate(state.step)
        state.optimiser.step()
        state.history.append((value, first, second, weight))
        weights = dict(state.network.named_parameters())
        state.update_average(weights, config.averaging)
        if config.supervision != "points":
            state.schedule.observe(value, state.step)
        return f"loss {value:.4g}"

    def save_now() -> None:
        if save:
            save(state, network_config(data, config, state.step))

    stop_reason = run(
        state,
        config.steps,
        prefetched(draw, state.step, config.steps, config.workers),
        take,
        progress=progress,
        save=save_now,
        save_every=save_every,
        stopping=lambda pressed: processes.any(pressed, device),
    )
    processes.wait()
    network = copy.deepcopy(state.averaged()).cpu().eval()
    network.to(memory_format=torch.contiguous_format)  # type: ignore[call-overload]
    finished = network_config(data, config, state.step)
    history = np.array(state.history, dtype=np.float64).reshape(-1, 4)
    return TrainResult(
        network, finished, state.step, stop_reason, history, state.schedule.dropped_at
    )


def _require_data(
    data: TrainingData, masked: TrainingData | None, config: TrainConfig, processes: Processes
) -> None:
    """InputError unless the data have what the supervision needs."""
    categories = {item.category for part in (data, masked) if part for item in part.objects}
    for name in config.category_sigma_sq:
        if name not in categories:
            raise InputError(
                f"sigma^2 is given for {name!r}, "
                f"expected one of the categories {', '.join(sorted(categories))}"
            )
    parts = processes.count * (2 if masked else 1)
    if config.batch_size % parts:
        raise InputError(f"batch size is {config.batch_size}, expected a multiple of {parts}")
    if config.supervision == "masks":
        for item in data.objects:
            if len(item.views) < config.views:
                raise InputError(
                    f"{item.name}: has {len(item.views)} views, "
                    f"expected at least the {config.views} that supervise a step"
                )
    elif lacking := next((item.name for item in data.objects if item.target is None), None):
        raise InputError(
            f"{lacking}: has no points to learn from, expected some (or `supervision` masks)"
        )


def evaluate(
    network: BaseNetwork, data: TrainingData, frame: str, views: int = 4, most: int = 256
) -> tuple[float, float, int]:
    """Mean forward and backward Chamfer distance of predictions to targets, and number of objects.

    Distances are squared, mean over points, in the scale of ``data``. The means are taken over the
    first ``views`` views of at most ``most`` objects (thousands would take minutes), spread evenly
    over the objects with a 3D file; they are NaN without any.
    """
    distances = []
    device = next(network.parameters()).device
    with torch.no_grad():
        for index in data.evaluable(most):
            count = min(views, len(data.objects[index].views))
            batch = assemble(data, [Draw(index, view) for view in range(count)], frame)
            points = network(torch.as_tensor(batch.images, device=device))
            targets = torch.as_tensor(np.stack(batch.targets), device=device)
            forward, backward = chamfer(points, targets)
            distances.append((float(forward.mean()), float(backward.mean())))
    forward_mean, backward_mean = np.mean(distances, axis=0) if distances else (np.nan, np.nan)
    return float(forward_mean), float(backward_mean), len(distances)
