"""The state of an unfinished training of a prior, in memory and on disk (no pickle)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
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
from ..trainer import Course, resumable, state_path, write_log
from .config import OF_PREDICTIONS, PriorConfig
from .loss import PARTS
from .optimiser import Optimiser

FORMAT = "tso-prior-training-2"
OF_RATE = ("steps", "cooled_at")  # settings that the learning rate depends on
# Places of the learning curve in a prior's metadata.
PLACES = 20
Weights = Mapping[str, NDArray[Any]]


@dataclass(eq=False, kw_only=True)
class PriorState(Course):
    """Everything that the next step depends on, except the data and the settings.

    weights : name -> parameter, in the order of the optimiser.
    history : the parts of the loss of every step (`loss.PARTS`).
    """

    weights: dict[str, Tensor]
    optimiser: Optimiser

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
    return PriorState(weights=weights, optimiser=Optimiser(weights), fingerprint=fingerprint)


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


def check_resumable(path: Path, config: PriorConfig) -> Mapping[str, Any]:
    """What is known about the training of the prior ``path``, as `save_training` wrote it.

    Raises InputError if there is no state of a training with the same settings.
    """
    file, about, step = resumable(path, lambda file: read_about(file, FORMAT))
    found = about.get("settings")
    settings = found if isinstance(found, dict) else {}
    # With all settings the same, the name of the recipe is that of this run.
    of_this_run: dict[str, Any] = dict.fromkeys(OF_PREDICTIONS) | config.settings()
    of_this_run.pop("recipe", None)
    for name, value in of_this_run.items():
        before = settings.get(name)
        if before == value or (name in OF_RATE and _begins_alike(config, settings, step)):
            continue
        raise InputError(
            f"{file}: was trained with `{name}` {shown(before)}, this run asks for {value}; "
            "expected the same settings to resume"
        )
    return about


def _begins_alike(config: PriorConfig, settings: Mapping[str, Any], done: int) -> bool:
    """Whether the training of ``settings`` has done what this one does in its first ``done``."""
    try:
        rates = {name: settings.get(name, 0) for name in OF_RATE}
        other = replace(config, **rates)
    except InputError:
        return False
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
    rows = [(sum(parts), *parts) for parts in state.history]
    write_log(path, about | config.settings(), ("loss", *PARTS), rows, overwrite)
