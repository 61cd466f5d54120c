"""The state of an unfinished training, in memory and on disk (no pickle)."""

from __future__ import annotations

import copy
import dataclasses
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from ..errors import InputError
from ..io.checkpoints import (
    STATE_PREFIX,
    load_network,
    load_state,
    read_metadata,
    save_network,
    save_tensors,
)
from ..io.reading import shown
from ..network.model import BaseNetwork, NetworkConfig
from .losses import AffinitySchedule
from .trainer import Course, resumable, state_path, write_log

MOMENTS = ("exp_avg", "exp_avg_sq")


@dataclass(eq=False, kw_only=True)
class TrainingState(Course):
    """Everything that the next step depends on, except the data.

    history : for each step loss, its two terms (forward and backward, or BCE and affinity), lambda.
    """

    network: BaseNetwork
    optimiser: torch.optim.Adam
    schedule: AffinitySchedule

    def averaged(self) -> BaseNetwork:
        """The network to be saved: a copy with the mean weights, or the network without a mean."""
        if not self.average:
            return self.network
        network = copy.deepcopy(self.network)
        with torch.no_grad():
            for name, parameter in network.named_parameters():
                parameter.copy_(self.average[name])
        return network


def save_training(
    checkpoint: Path, state: TrainingState, config: NetworkConfig, overwrite: bool = True
) -> None:
    """Write the network to ``checkpoint``, and network and state to `state_path`.

    Each file is replaced whole.
    """
    tensors = dict(state.network.state_dict())
    for name, parameter in state.network.named_parameters():
        for moment in MOMENTS:
            value = state.optimiser.state[parameter].get(moment, torch.zeros_like(parameter))
            tensors[f"{STATE_PREFIX}{moment}.{name}"] = value
    tensors |= {f"{STATE_PREFIX}average.{name}": mean for name, mean in state.average.items()}
    history = torch.tensor(state.history, dtype=torch.float64)
    tensors[f"{STATE_PREFIX}history"] = history.reshape(-1, 4)
    values = {
        "step": state.step,
        "schedule": dataclasses.asdict(state.schedule),
        "fingerprint": state.fingerprint,
    }
    save_tensors(state_path(checkpoint), tensors, config, values, overwrite)
    save_network(checkpoint, state.averaged(), config, overwrite)


def load_training(
    checkpoint: Path, config: NetworkConfig, fingerprint: str, device: torch.device
) -> TrainingState:
    """Read the state of ``checkpoint``; training continues from it bit for bit.

    Raises InputError if there is no state, if it is damaged, or if it comes from a training with
    other settings or other data.
    """
    path, values, step = resumable(checkpoint, lambda file: read_metadata(file)[1])
    network, stored = load_network(path)
    _require_same(path, stored, config)
    if values.get("fingerprint") != fingerprint:
        raise InputError(
            f"{path}: was trained on other data ({stored.training_set}), "
            "expected the same data to resume"
        )
    schedule = AffinitySchedule.from_json(values.get("schedule"), str(path))
    shapes: dict[str, tuple[int, ...]] = {"history": (step, 4)}
    kinds = (*MOMENTS, "average") if step and config.settings.get("averaging") else MOMENTS
    for name, parameter in network.named_parameters():
        shapes |= {f"{kind}.{name}": tuple(parameter.shape) for kind in kinds}
    tensors = load_state(path, shapes)
    state = new_state(network, config.settings["learning_rate"], schedule, fingerprint, device)
    state.history.extend(tuple(row) for row in tensors.pop("history").double().tolist())
    if step:
        for name, parameter in state.network.named_parameters():
            # The memory layout must be the parameter's: the last bit of a convolution depends on
            # it.
            values = {
                kind: torch.empty_like(parameter.detach()).copy_(tensors[f"{kind}.{name}"])
                for kind in kinds
            }
            if "average" in kinds:
                state.average[name] = values.pop("average")
            state.optimiser.state[parameter] = {"step": torch.tensor(float(step)), **values}
    return state


def stored_window(checkpoint: Path) -> int | None:
    """``saturation_steps`` of the training of ``checkpoint``, which a resumed run keeps.

    None if there is no such training.
    """
    path = state_path(checkpoint)
    window = read_metadata(path)[0].settings.get("saturation_steps") if path.exists() else None
    return window if isinstance(window, int) else None


def new_state(
    network: BaseNetwork,
    learning_rate: float,
    schedule: AffinitySchedule,
    fingerprint: str,
    device: torch.device,
) -> TrainingState:
    """A training at step 0."""
    # The memory layout "channels last" makes convolutions a third faster on the CPU.
    network = network.to(device).to(memory_format=torch.channels_last).train()  # type: ignore[call-overload]
    optimiser = torch.optim.Adam(network.parameters(), lr=learning_rate, fused=True)
    return TrainingState(
        network=network, optimiser=optimiser, schedule=schedule, fingerprint=fingerprint
    )


def _require_same(path: Path, stored: NetworkConfig, current: NetworkConfig) -> None:
    """InputError if settings differ; only the number of steps, version and training set may."""

    def flat(config: NetworkConfig) -> dict[str, Any]:
        values = dataclasses.asdict(config)
        values |= values.pop("settings")
        for name in ("steps", "version", "training_set"):
            del values[name]
        return values

    before, after = flat(stored), flat(current)
    # Supervision comes first, because other settings depend on it.
    for name in sorted(before | after, key=lambda name: (name != "supervision", name)):
        if before.get(name) != after.get(name):
            raise InputError(
                f"{path}: was trained with {name} {shown(before.get(name))}, "
                f"this run asks for {shown(after.get(name))}; expected the same settings to resume"
            )


def write_history(
    path: Path, history: list[tuple[float, ...]], config: NetworkConfig, overwrite: bool = True
) -> None:
    """Write the settings, then the losses of every step, one JSON object on each line."""
    terms = {
        "points": ("forward", "backward"),
        "masks": ("bce", "affinity", "lambda"),
        "joint": ("chamfer", "bce", "lambda"),
    }
    names = ("loss", *terms[config.supervision])
    write_log(path, dataclasses.asdict(config), names, history, overwrite)
