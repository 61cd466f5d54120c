"""The state of an unfinished training of a prior, in memory and on disk (no pickle)."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ...errors import InputError
from ...io.checkpoints import read_about, read_tensors, write_tensors
from ...io.output import write_file
from ...io.reading import shown
from ...prior.file import packed_prior
from ...version import __version__
from ..state import MOMENTS, state_path
from .config import AVERAGING, LEARNING_RATE, OF_PREDICTIONS, WEIGHT_DECAY, PriorConfig

FORMAT = "tso-prior-training-1"
Weights = Mapping[str, NDArray[Any]]


@dataclass(eq=False)
class PriorState:
    """Everything that the next step depends on, except the data and the settings.

    weights : name -> parameter, in the order of the optimiser.
    fingerprint : digest of the shapes of the training.
    history : the loss of every step.
    average : running mean of each weight; empty before the first step.
    """

    weights: dict[str, Tensor]
    optimiser: torch.optim.AdamW
    fingerprint: str
    history: list[float] = field(default_factory=list)
    average: dict[str, Tensor] = field(default_factory=dict)

    @property
    def step(self) -> int:
        """Steps done."""
        return len(self.history)

    def update_average(self) -> None:
        """Update the running mean of the weights after a step."""
        weights = [weight.detach() for weight in self.weights.values()]
        if not self.average:
            self.average = {name: weight.detach().clone() for name, weight in self.weights.items()}
        # The decay is smaller in the first steps, so that the initial weights are forgotten.
        decay = min(AVERAGING, self.step / (self.step + 9.0))
        with torch.no_grad():
            torch._foreach_lerp_(list(self.average.values()), weights, 1.0 - decay)

    def averaged(self) -> dict[str, NDArray[Any]]:
        """The weights to be saved: their mean, or the weights before the first step."""
        tensors = self.average or self.weights
        return {name: tensor.detach().cpu().numpy() for name, tensor in tensors.items()}


def new_state(initial: Weights, fingerprint: str, device: torch.device) -> PriorState:
    """A training at step 0 that starts from the ``initial`` weights."""
    weights = {
        # A copy: the arrays that were given stay as they are.
        name: torch.tensor(np.asarray(array, np.float32), device=device, requires_grad=True)
        for name, array in initial.items()
    }
    optimiser = torch.optim.AdamW(
        weights.values(), lr=LEARNING_RATE, weight_decay=WEIGHT_DECAY, fused=True
    )
    return PriorState(weights, optimiser, fingerprint)


def save_training(
    path: Path, state: PriorState, config: PriorConfig, training_set: str, overwrite: bool = True
) -> None:
    """Write the prior to ``path``, and all that a resumed training needs to `state_path`.

    Each file is replaced whole. InputError, and no file is written, if a weight is too large for
    the prior.
    """
    about = {
        "training_set": training_set,
        "settings": config.settings() | {"steps": state.step},
        "version": __version__,
    }
    prior = packed_prior(state.averaged(), about)
    tensors = dict(state.weights)
    for name, weight in state.weights.items():
        for moment in MOMENTS:
            value = state.optimiser.state[weight].get(moment, torch.zeros_like(weight))
            tensors[f"{moment}.{name}"] = value
    tensors |= {f"average.{name}": mean for name, mean in state.average.items()}
    tensors["history"] = torch.tensor(state.history, dtype=torch.float64)
    values = {
        "training_set": training_set,
        "settings": config.settings(),
        "step": state.step,
        "fingerprint": state.fingerprint,
        "version": __version__,
    }
    write_tensors(state_path(path), tensors, FORMAT, values, overwrite)
    write_file(path, prior, overwrite)


def check_resumable(path: Path, config: PriorConfig) -> dict[str, Any]:
    """What is known about the training of the prior ``path``, as `save_training` wrote it.

    Raises InputError if there is no state of a training with the same settings.
    """
    file = state_path(path)
    if not file.exists():
        raise InputError(
            f"{file}: does not exist, expected the state of an unfinished training to resume"
        )
    about = read_about(file, FORMAT)
    step, settings = about.get("step"), about.get("settings")
    if not isinstance(step, int) or isinstance(step, bool) or step < 0:
        raise InputError(f"{file}: step in the state is {shown(step)}, expected a whole number")
    of_this_run: dict[str, Any] = dict.fromkeys(OF_PREDICTIONS) | config.settings()
    for name, value in of_this_run.items():
        before = settings.get(name) if isinstance(settings, dict) else None
        if before != value:
            raise InputError(
                f"{file}: was trained with `{name}` {shown(before)}, this run asks for {value}; "
                "expected the same settings to resume"
            )
    return about


def load_training(
    path: Path,
    config: PriorConfig,
    initial: Weights,
    fingerprint: str,
    device: torch.device,
) -> PriorState:
    """Read the state of the prior ``path``; training continues from it bit for bit.

    ``initial`` has the names and shapes of the weights. Raises InputError as `check_resumable`, and
    if the state is damaged or comes from a training on other shapes.
    """
    about, file = check_resumable(path, config), state_path(path)
    step = about["step"]
    if about.get("fingerprint") != fingerprint:
        found = f"was trained on other shapes ({shown(about.get('training_set'))})"
        raise InputError(f"{file}: {found}, expected the same shapes to resume")
    kinds = (*MOMENTS, "average") if step else MOMENTS
    shapes: dict[str, tuple[int, ...]] = {"history": (step,)}
    for name, array in initial.items():
        shapes |= {f"{prefix}{name}": array.shape for prefix in ("", *(f"{k}." for k in kinds))}
    tensors = read_tensors(file, shapes)
    state = new_state({name: tensors[name].numpy() for name in initial}, fingerprint, device)
    state.history.extend(tensors["history"].double().tolist())
    for name, weight in state.weights.items() if step else ():
        moments = {kind: tensors[f"{kind}.{name}"].to(device) for kind in MOMENTS}
        done = torch.tensor(float(step), device=device)
        state.optimiser.state[weight] = {"step": done, **moments}
        state.average[name] = tensors[f"average.{name}"].to(device)
    return state


def write_history(
    path: Path, state: PriorState, config: PriorConfig, training_set: str, overwrite: bool = True
) -> None:
    """Write the settings, then the loss of every step, one JSON object on each line."""
    about = {"supervision": "prior", "training_set": training_set, "version": __version__}
    lines = [json.dumps(about | config.settings())]
    for step, value in enumerate(state.history, 1):
        lines.append(json.dumps({"step": step, "loss": value}))
    write_file(path, ("\n".join(lines) + "\n").encode(), overwrite)
