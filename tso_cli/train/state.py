"""An unfinished training on disk: the network, the moments of Adam, the schedule and the losses so far; no pickle."""

from __future__ import annotations

import copy
import dataclasses
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from ..errors import InputError
from ..io.checkpoints import STATE_PREFIX, load_network, load_state, read_metadata, save_network, save_tensors
from ..io.reading import shown
from ..network.model import BaseNetwork, NetworkConfig
from .losses import AffinitySchedule

MOMENTS = ("exp_avg", "exp_avg_sq")
# Columns of the history: the loss, its two terms (forward and backward, or BCE and affinity), lambda.
COLUMNS = 4


@dataclass(eq=False)
class TrainingState:
    """Everything that the next step depends on, besides the data.

    history : float64 [steps done, 4], one row a step.
    fingerprint : of the data it was trained on.
    average : running mean of each parameter, in the order of the network; empty until it is asked for.
    """

    network: BaseNetwork
    optimiser: torch.optim.Adam
    schedule: AffinitySchedule
    history: list[tuple[float, float, float, float]]
    fingerprint: str
    average: list[Tensor] = field(default_factory=list)

    @property
    def step(self) -> int:
        """Steps done."""
        return len(self.history)

    def update_average(self, kept: float) -> None:
        """Take the weights after a step into their running mean, which keeps the share ``kept`` of what it was."""
        if kept == 0.0:
            return
        with torch.no_grad():
            weights = [parameter.detach() for parameter in self.network.parameters()]
            if not self.average:
                self.average = [weight.clone() for weight in weights]
            # In the first steps the mean is over the steps there were: the random start must not linger in it.
            kept = min(kept, self.step / (self.step + 9.0))
            torch._foreach_lerp_(self.average, weights, 1.0 - kept)

    def averaged(self) -> BaseNetwork:
        """The network to be saved: with the mean weights where there is a mean, else the network itself."""
        if not self.average:
            return self.network
        network = copy.deepcopy(self.network)
        with torch.no_grad():
            for parameter, mean in zip(network.parameters(), self.average, strict=True):
                parameter.copy_(mean)
        return network


def state_path(checkpoint: Path) -> Path:
    """Where the state of the training of ``checkpoint`` lies: base.safetensors -> base.training.safetensors."""
    return checkpoint.with_name(f"{checkpoint.stem}.training.safetensors")


def save_training(checkpoint: Path, state: TrainingState, config: NetworkConfig) -> None:
    """Write the network alone to ``checkpoint``, and network and state beside it; each file is replaced whole."""
    tensors = dict(state.network.state_dict())
    for name, parameter in state.network.named_parameters():
        for moment in MOMENTS:
            stored = state.optimiser.state[parameter].get(moment, torch.zeros_like(parameter))
            tensors[f"{STATE_PREFIX}{moment}.{name}"] = stored
    for (name, _), mean in zip(state.network.named_parameters(), state.average, strict=False):
        tensors[f"{STATE_PREFIX}average.{name}"] = mean
    tensors[f"{STATE_PREFIX}history"] = torch.tensor(state.history, dtype=torch.float64).reshape(-1, COLUMNS)
    values = {"step": state.step, "schedule": state.schedule.to_json(), "fingerprint": state.fingerprint}
    save_tensors(state_path(checkpoint), tensors, config, values, overwrite=True)
    save_network(checkpoint, state.averaged(), config, overwrite=True)


def load_training(checkpoint: Path, config: NetworkConfig, fingerprint: str, device: torch.device) -> TrainingState:
    """Read the state beside ``checkpoint``, to go on with exactly as if it had never stopped.

    Raises
    ------
    InputError
        There is no state, it is damaged, or it is from a training with other settings or other data.
    """
    path = state_path(checkpoint)
    if not path.exists():
        raise InputError(f"{path}: does not exist, expected the state of an unfinished training to resume")
    network, stored = load_network(path)
    _require_same(path, stored, config)
    _, values = read_metadata(path)
    step, found = values.get("step"), values.get("fingerprint")
    if not isinstance(step, int) or isinstance(step, bool) or step < 0:
        raise InputError(f"{path}: step in the training state is {shown(step)}, expected a whole number")
    if found != fingerprint:
        raise InputError(f"{path}: was trained on other data ({stored.training_set}), expected the same data to resume")
    schedule = AffinitySchedule.from_json(values.get("schedule"), str(path))
    shapes: dict[str, tuple[int, ...]] = {"history": (step, COLUMNS)}
    averaged = bool(step and config.settings.get("averaging"))
    kept = (*MOMENTS, "average") if averaged else MOMENTS
    for name, parameter in network.named_parameters():
        shapes.update({f"{moment}.{name}": tuple(parameter.shape) for moment in kept})
    tensors = load_state(path, shapes)
    state = new_state(network, config, schedule, fingerprint, device)
    state.history.extend(tuple(row) for row in tensors.pop("history").double().tolist())
    if step:
        for name, parameter in state.network.named_parameters():
            # The layout of the parameter is kept: the sums of a convolution depend on it in the last bit.
            moments = {moment: torch.empty_like(parameter).copy_(tensors[f"{moment}.{name}"]) for moment in MOMENTS}
            state.optimiser.state[parameter] = {"step": torch.tensor(float(step)), **_detached(moments)}
            if averaged:
                state.average.append(torch.empty_like(parameter).copy_(tensors[f"average.{name}"]).detach())
    return state


def stored_window(checkpoint: Path) -> int | None:
    """``saturation_steps`` of the training beside ``checkpoint``, None where it has none: a resumed run keeps it."""
    path = state_path(checkpoint)
    found = read_metadata(path)[0].settings.get("saturation_steps") if path.exists() else None
    return found if isinstance(found, int) else None


def new_state(
    network: BaseNetwork, config: NetworkConfig, schedule: AffinitySchedule, fingerprint: str, device: torch.device
) -> TrainingState:
    """A training at its start. Convolutions run a third faster on the CPU with channels last."""
    network = network.to(device).to(memory_format=torch.channels_last).train()  # type: ignore[call-overload]
    optimiser = torch.optim.Adam(network.parameters(), lr=config.settings["learning_rate"], fused=True)
    return TrainingState(network, optimiser, schedule, [], fingerprint)


def _detached(tensors: dict[str, Tensor]) -> dict[str, Tensor]:
    return {name: tensor.detach() for name, tensor in tensors.items()}


def _require_same(path: Path, stored: NetworkConfig, asked: NetworkConfig) -> None:
    """Settings that shape the result must be the same; more steps may be asked for, and the version may differ."""

    def flat(config: NetworkConfig) -> dict[str, Any]:
        values = dataclasses.asdict(config)
        settings = values.pop("settings")
        for name in ("steps", "version", "training_set"):
            values.pop(name)
        return {**values, **settings}

    before, now = flat(stored), flat(asked)
    # What decides on the other settings is compared first.
    for name in sorted(set(before) | set(now), key=lambda name: (name != "supervision", name)):
        if before.get(name) != now.get(name):
            raise InputError(
                f"{path}: was trained with {name} {shown(before.get(name))}, this run asks for {shown(now.get(name))}; "
                "expected the same settings to resume"
            )


def write_history(path: Path, history: list[tuple[float, float, float, float]], config: NetworkConfig) -> None:
    """The settings, then the losses of every step so far, one JSON object a line; the file is replaced whole."""
    from ..io.output import atomic_output

    terms = {"points": ("forward", "backward"), "masks": ("bce", "affinity", "lambda"), "joint": ("chamfer", "bce", "lambda")}
    names = ("step", "loss", *terms[config.supervision])
    lines = [json.dumps(dataclasses.asdict(config), allow_nan=False)]
    for step, row in enumerate(history, 1):
        lines.append(json.dumps(dict(zip(names, (step, *row), strict=False))))
    with atomic_output(path) as temporary:
        temporary.write_text("\n".join(lines) + "\n", encoding="utf-8")
