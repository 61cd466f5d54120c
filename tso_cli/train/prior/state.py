"""The state of an unfinished training of a prior, in memory and on disk (no pickle)."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
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
from ..state import state_path
from .config import AVERAGING, OF_PREDICTIONS, PriorConfig
from .loss import PARTS
from .optimiser import Optimiser

FORMAT = "tso-prior-training-2"
# Places of the learning curve in a prior's metadata.
PLACES = 20
Weights = Mapping[str, NDArray[Any]]


@dataclass(eq=False)
class PriorState:
    """Everything that the next step depends on, except the data and the settings.

    weights : name -> parameter, in the order of the optimiser.
    fingerprint : digest of the shapes of the training.
    history : the parts of the loss of every step (`loss.PARTS`).
    average : running mean of each weight; empty before the first step.
    """

    weights: dict[str, Tensor]
    optimiser: Optimiser
    fingerprint: str
    history: list[list[float]] = field(default_factory=list)
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

    def curve(self) -> list[list[float]]:
        """Up to `PLACES` pairs: a step, and the mean of what was left of the starts up to it.

        Each mean begins where the last one ended.
        """
        left = np.array([parts[0] for parts in self.history])
        ends = np.unique(np.linspace(0, self.step, PLACES + 1).astype(int)).tolist()
        pairs = zip(ends, ends[1:], strict=False)
        return [[end, round(float(left[start:end].mean()), 4)] for start, end in pairs]

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
    return PriorState(weights, Optimiser(weights), fingerprint)


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
        "shapes": state.fingerprint,
        "curve": state.curve(),
        "version": __version__,
    }
    prior = packed_prior(state.averaged(), about)
    tensors = state.weights | state.optimiser.state(state.step)
    tensors |= {f"average.{name}": mean for name, mean in state.average.items()}
    tensors["history"] = torch.tensor(state.history, dtype=torch.float64).reshape(-1, len(PARTS))
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
    # With all settings the same, the name of the recipe is that of this run.
    of_this_run: dict[str, Any] = dict.fromkeys(OF_PREDICTIONS) | config.settings()
    of_this_run.pop("recipe", None)
    for name, value in of_this_run.items():
        before = settings.get(name) if isinstance(settings, dict) else None
        if before == value or (name == "steps" and _begins_alike(config, before, step)):
            continue
        raise InputError(
            f"{file}: was trained with `{name}` {shown(before)}, this run asks for {value}; "
            "expected the same settings to resume"
        )
    return about


def _begins_alike(config: PriorConfig, steps: Any, done: int) -> bool:
    """Whether a training of ``steps`` steps has done what this one does in its first ``done``."""
    if not isinstance(steps, int) or steps < 1:
        return False
    other = replace(config, steps=steps)
    return all(config.rate(step) == other.rate(step) for step in range(done))


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
    state = new_state(initial, fingerprint, device)
    shapes: dict[str, tuple[int, ...]] = {"history": (step, len(PARTS))}
    for prefix in ("", "average.") if step else ("",):
        shapes |= {f"{prefix}{name}": weight.shape for name, weight in state.weights.items()}
    shapes |= {name: tensor.shape for name, tensor in state.optimiser.state(0).items()}
    tensors = read_tensors(file, shapes)
    with torch.no_grad():
        for name, weight in state.weights.items():
            weight.copy_(tensors[name])
    state.history.extend(tensors["history"].double().tolist())
    if step:
        state.optimiser.restore(tensors, step)
        state.average |= {name: tensors[f"average.{name}"].to(device) for name in initial}
    return state


def write_history(
    path: Path, state: PriorState, config: PriorConfig, training_set: str, overwrite: bool = True
) -> None:
    """Write the settings, then the loss of every step, one JSON object on each line."""
    about = {"supervision": "prior", "training_set": training_set, "version": __version__}
    lines = [json.dumps(about | config.settings())]
    for step, parts in enumerate(state.history, 1):
        row = {"step": step, "loss": sum(parts), **dict(zip(PARTS, parts, strict=True))}
        lines.append(json.dumps(row))
    write_file(path, ("\n".join(lines) + "\n").encode(), overwrite)
