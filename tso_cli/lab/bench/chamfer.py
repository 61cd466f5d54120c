"""Chamfer distance to the initial cloud: value and gradient along a refinement."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from importlib import import_module
from typing import Any

import torch
from scipy.spatial import cKDTree
from torch import Tensor

from ...silhouette.chamfer import ChamferToInitial
from .material import STEPS, trajectory
from .timing import Setting, Work

SIZES, LARGE = (1024, 4096, 16384), (65536,)
# Every tenth of the 50 steps is measured: the first are the cheapest for a method that remembers the initial cloud.
EVERY = 10
# These hold or compare all pairs; beyond so many points they would take gigabytes or minutes.
UP_TO = {"cdist": 1024, "pykeops": 16384}
BUILT = "tso, built once"
NOT_INSTALLED = "not installed"

Term = Callable[[Tensor], Tensor]


def contestants(initial: Tensor) -> dict[str, Term | str]:
    """Contestant -> its Chamfer distance to ``initial`` [1, N, 3], or why it is left out."""
    terms: dict[str, Term | str] = {"tso": ChamferToInitial(initial)}
    if initial.device.type == "cpu":
        terms["two k-d trees a step, 1 worker"] = _k_d_trees(initial, 1)
        terms["two k-d trees a step, all workers"] = _k_d_trees(initial, -1)
        terms["one k-d tree kept, all queried"] = _k_d_trees(initial, 1, keep=True)
    for name, maker in {"cdist": _cdist, "pykeops": _pykeops, "point_cloud_utils": _point_cloud_utils}.items():
        if initial.shape[1] > UP_TO.get(name, initial.shape[1]):
            terms[name] = f"compares all {float(initial.shape[1]) ** 2:.1e} pairs"
            continue
        try:
            terms[name] = maker(initial)
        except ImportError:
            terms[name] = NOT_INSTALLED
    return terms


def measure(setting: Setting, sizes: Sequence[int] | None = None, steps: int = STEPS) -> list[dict[str, Any]]:
    """Seconds a step of every contestant at every size; building tso's tree once for all steps has its own record."""
    records: list[dict[str, Any]] = []
    for count in sizes or ((*SIZES, *LARGE) if setting.full else SIZES):
        setting.report(f"Chamfer {count:,}")
        iterates = trajectory(count, setting.device, setting.seed, steps)
        moved = iterates[EVERY::EVERY] or iterates[-1:]
        terms = contestants(iterates[0])
        works: dict[str, Work] = {name: _along(term, moved) for name, term in terms.items() if not isinstance(term, str)}
        works[BUILT] = lambda initial=iterates[0]: ChamferToInitial(initial)  # type: ignore[misc]
        timings = setting.race(works)
        built = timings.pop(BUILT)
        each = {name: timing.scaled(1.0 / len(moved)) for name, timing in timings.items()}
        records += setting.records("chamfer", each, "over_tso", points=count)
        records.append(setting.record("chamfer", BUILT, built, points=count))
        records += setting.left_out("chamfer", terms, points=count)
    return records


def _along(term: Term, iterates: Sequence[Tensor]) -> Work:
    leaves = [moved.clone().requires_grad_() for moved in iterates]

    def work() -> None:
        for leaf in leaves:
            torch.autograd.grad(term(leaf).sum(), leaf)

    return work


def _by_indices(initial: Tensor, moved: Tensor, to_initial: Any, to_moved: Any) -> Tensor:
    """Chamfer distance by the indices [N] of each moved point's nearest initial point, and of the reverse."""
    start, end = initial[0], moved[0]
    forward = end - start[torch.as_tensor(to_initial).long()]
    return forward.square().sum(1).mean() + (start - end[torch.as_tensor(to_moved).long()]).square().sum(1).mean()


def _k_d_trees(initial: Tensor, workers: int, keep: bool = False) -> Term:
    """Nearest neighbours of all points, both ways; ``keep`` builds the tree of the initial points once."""
    start = initial[0].numpy()
    kept = cKDTree(start) if keep else None

    def term(moved: Tensor) -> Tensor:
        end = moved[0].detach().numpy()
        to_initial = (kept or cKDTree(start)).query(end, workers=workers)[1]
        return _by_indices(initial, moved, to_initial, cKDTree(end).query(start, workers=workers)[1])

    return term


def _cdist(initial: Tensor) -> Term:
    def term(moved: Tensor) -> Tensor:
        squared = torch.cdist(initial, moved).square()
        return squared.amin(1).mean() + squared.amin(2).mean()

    return term


def _pykeops(initial: Tensor) -> Term:
    lazy = import_module("pykeops.torch").LazyTensor

    def term(moved: Tensor) -> Tensor:
        squared = ((lazy(moved[0].detach()[:, None]) - lazy(initial[0][None])) ** 2).sum(-1)  # [N, N], never held
        return _by_indices(initial, moved, squared.argmin(1).flatten(), squared.argmin(0).flatten())

    return term


def _point_cloud_utils(initial: Tensor) -> Term:
    nearest, start = import_module("point_cloud_utils").k_nearest_neighbors, initial[0].cpu().numpy()

    def term(moved: Tensor) -> Tensor:
        end = moved[0].detach().cpu().numpy()
        to_initial, to_moved = (nearest(a, b, 1)[1].reshape(-1) for a, b in ((end, start), (start, end)))
        return _by_indices(initial, moved, to_initial, to_moved)

    return term
