"""Chamfer distance to the initial cloud: value and gradient along a refinement."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from scipy.spatial import cKDTree
from torch import Tensor

from ...silhouette.chamfer import ChamferToInitial
from . import peers
from .material import STEPS, trajectory
from .timing import Setting, Work

SIZES, LARGE = (1024, 4096, 16384), (65536,)
# Every tenth of the 50 steps is measured: the first are the cheapest for a method that remembers the initial cloud.
EVERY = 10
# torch.cdist holds all pairs at once.
CDIST_UP_TO = 1024
# Packages that compare all pairs would take minutes beyond this size on the CPU.
PAIRS_UP_TO = 16384
BUILT = "tso, built once"


def makers(initial: Tensor, setting: Setting) -> dict[str, peers.Make]:
    """Contestant -> what makes its Chamfer distance to ``initial`` [1, N, 3], or says why it is left out."""
    count, on_cpu = initial.shape[1], setting.device.type == "cpu"
    result: dict[str, peers.Make] = {"tso": lambda: ChamferToInitial(initial)}
    if on_cpu:
        result["two k-d trees a step, 1 worker"] = lambda: _k_d_trees(initial, 1)
        result["two k-d trees a step, all workers"] = lambda: _k_d_trees(initial, -1)
        result["one k-d tree kept, all queried"] = lambda: _k_d_trees(initial, 1, keep=True)
    if count <= (4 * CDIST_UP_TO if setting.full else CDIST_UP_TO):
        result["cdist"] = lambda: _cdist(initial)
    else:
        result["cdist"] = lambda: f"{float(count) ** 2:.1e} pairs held at once"
    for name, make in peers.chamfer_terms(initial).items():
        slow = on_cpu and name in peers.COMPARE_ALL and count > PAIRS_UP_TO
        result[name] = (lambda: f"compares all {float(count) ** 2:.1e} pairs, minutes") if slow else make
    return result


def measure(setting: Setting, sizes: Sequence[int] | None = None, steps: int = STEPS) -> list[dict[str, Any]]:
    """Seconds a step of every contestant at every size; building tso's tree once for all steps has its own record."""
    records: list[dict[str, Any]] = []
    for count in sizes or ((*SIZES, *LARGE) if setting.full else SIZES):
        setting.report(f"Chamfer {count:,}")
        iterates = trajectory(count, setting.device, setting.seed, steps)
        moved = iterates[EVERY::EVERY] or iterates[-1:]
        terms = {name: make() for name, make in makers(iterates[0], setting).items()}
        works: dict[str, Work] = {name: _along(term, moved) for name, term in terms.items() if not isinstance(term, str)}
        works[BUILT] = lambda initial=iterates[0]: ChamferToInitial(initial)  # type: ignore[misc]
        timings = setting.race(works)
        built = timings.pop(BUILT)
        each = {name: timing.scaled(1.0 / len(moved)) for name, timing in timings.items()}
        records += setting.records("chamfer", each, "over_tso", points=count)
        records.append(setting.record("chamfer", BUILT, built, points=count))
        records += left_out(setting, "chamfer", terms, points=count)
    return records


def left_out(setting: Setting, what: str, terms: Mapping[str, Any], **fields: Any) -> list[dict[str, Any]]:
    """A record of every contestant that is a reason in place of a term or work."""
    return [setting.record(what, n, left_out=reason, **fields) for n, reason in terms.items() if isinstance(reason, str)]


def _along(term: peers.Term, iterates: Sequence[Tensor]) -> Work:
    leaves = [moved.clone().requires_grad_() for moved in iterates]

    def work() -> None:
        for leaf in leaves:
            torch.autograd.grad(term(leaf).sum(), leaf)

    return work


def _k_d_trees(initial: Tensor, workers: int, keep: bool = False) -> peers.Term:
    """Nearest neighbours of all points, both ways; ``keep`` builds the tree of the initial points once."""
    start = initial[0].numpy()
    kept = cKDTree(start) if keep else None

    def term(moved: Tensor) -> Tensor:
        end = moved[0].detach().numpy()
        to_initial = (kept or cKDTree(start)).query(end, workers=workers)[1]
        to_moved = cKDTree(end).query(start, workers=workers)[1]
        return peers.gathered(initial, moved, torch.from_numpy(to_initial), torch.from_numpy(to_moved))

    return term


def _cdist(initial: Tensor) -> peers.Term:
    def term(moved: Tensor) -> Tensor:
        squared = torch.cdist(initial, moved).square()
        return squared.amin(1).mean() + squared.amin(2).mean()

    return term
