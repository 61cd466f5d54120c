"""Other packages that do a part of the same work, measured where they are installed."""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from contextlib import redirect_stdout
from importlib import import_module
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ...refinement.optimise import Array, Term
from .timing import Contestant, Records, Sample, Setting, record


def race(setting: Setting, what: str, samples: Mapping[str, Sample | str], calls: int = 1, **fields: Any) -> Records:
    """A record of every contestant, tso's compiled loops first; of a reason in place of a sample one that says so."""
    contestants = [Contestant(name, sample, fields, calls) for name, sample in samples.items() if not isinstance(sample, str)]
    left_out = [record(what, name, left_out=why, **fields) for name, why in samples.items() if isinstance(why, str)]
    return [*setting.race(what, contestants, "over_tso"), *left_out]


def tensor(values: Array) -> Tensor:
    return torch.as_tensor(values, dtype=torch.float32)


def differentiated(loss: Callable[[Tensor], Tensor]) -> Term:
    """Value and gradient of a loss in torch, at points [N, D]."""

    def term(points: Array) -> tuple[float, Array]:
        leaf = tensor(points).requires_grad_()
        value = loss(leaf).sum()
        return value.item(), torch.autograd.grad(value, leaf)[0].numpy()

    return term


def tried(package: str, make: Callable[[Any], Term], points: Array) -> Term | str:
    """The term that ``make`` makes of the package if one call of it at ``points`` succeeds; else why not."""
    # A package may print; stdout is for the answer alone.
    with redirect_stdout(sys.stderr):
        try:
            term = make(import_module(package))
            term(points)
        except ImportError as error:
            return "not installed" if error.name == package else f"cannot be imported ({_line(error)})"
        except Exception as error:
            # Whatever another package raises, the run goes on without it.
            return f"does not run here ({_line(error)})"
    return term


def _line(error: Exception) -> str:
    text = " ".join(str(error).split()) or type(error).__name__
    return text if len(text) <= 120 else text[:117] + "..."


def chamfer_terms(initial: Array) -> Mapping[str, Callable[[Any], Term]]:
    """Package -> what makes of it the Chamfer distance to ``initial`` [N, 3], both ways."""
    start = tensor(initial)

    def chamferdist(module: Any) -> Term:
        distance = module.ChamferDistance()
        return differentiated(lambda moved: distance(moved[None], start[None], bidirectional=True, point_reduction="mean"))

    def pykeops(module: Any) -> Term:
        lazy = import_module("pykeops.torch").LazyTensor

        def term(moved: Array) -> tuple[float, Array]:
            squared = ((lazy(tensor(moved)[:, None]) - lazy(start[None])) ** 2).sum(-1)  # [N, N], never held
            return paired(initial, moved, *(squared.argmin(axis).flatten().numpy() for axis in (1, 0)))

        return term

    def point_cloud_utils(module: Any) -> Term:
        def term(moved: Array) -> tuple[float, Array]:
            pairs = ((moved, initial), (initial, moved))
            return paired(initial, moved, *(module.k_nearest_neighbors(*pair, 1)[1].reshape(-1) for pair in pairs))

        return term

    def pytorch3d(module: Any) -> Term:
        distance = import_module("pytorch3d.loss").chamfer_distance
        return differentiated(lambda moved: distance(moved[None], start[None])[0])

    return {make.__name__: make for make in (chamferdist, pykeops, point_cloud_utils, pytorch3d)}


def paired(initial: Array, moved: Array, to_initial: NDArray[np.int64], to_moved: NDArray[np.int64]) -> tuple[float, Array]:
    """The Chamfer distance and its gradient, by each moved point's nearest initial point, [N], and the reverse."""
    ahead, back = moved - initial[to_initial], moved[to_moved] - initial
    gradient = ahead.copy()
    np.add.at(gradient, to_moved, back)
    return float(np.square(ahead).sum() + np.square(back).sum()) / len(moved), (2.0 / len(moved)) * gradient
