"""Chamfer to the initial cloud, value and gradient, along a real refinement."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any

import torch
from torch import Tensor

from ...silhouette.chamfer import ChamferToInitial
from . import peers
from .material import STEPS, trajectory
from .timing import Setting, Work

WHAT = "chamfer"
SIZES, LARGE = (1024, 4096, 16384), (65536,)
# Of the 50 steps every tenth is measured, for all alike: the first are the cheapest for what remembers the start.
EVERY = 10
# All pairs at once are held up to this size.
CDIST_UP_TO = 1024
# On the CPU, packages that compare all pairs one by one.
PAIRS_UP_TO = 16384


def makers(initial: Tensor, setting: Setting) -> dict[str, peers.Make]:
    """Contestant -> what makes its Chamfer distance to ``initial`` [1, N, 3], both directions summed; or why it is left out."""
    count = initial.shape[1]
    found: dict[str, peers.Make] = {"tso": lambda: ChamferToInitial(initial)}
    if setting.device.type == "cpu":
        found["two k-d trees a step, 1 worker"] = lambda: _Trees(initial, 1)
        found["two k-d trees a step, all workers"] = lambda: _Trees(initial, -1)
        found["one k-d tree kept, all queried"] = lambda: _Trees(initial, 1, keep=True)
    if count <= (4 * CDIST_UP_TO if setting.full else CDIST_UP_TO):
        found["cdist"] = lambda: partial(_cdist, initial)
    else:
        found["cdist"] = lambda: f"{float(count) ** 2:.1e} pairs held at once"
    for name, make in peers.chamfer_terms(initial).items():
        slow = setting.device.type == "cpu" and name in peers.COMPARE_ALL and count > PAIRS_UP_TO
        found[name] = (lambda: f"compares all {float(count) ** 2:.1e} pairs, minutes") if slow else make
    return found


def measure(setting: Setting, sizes: Sequence[int] | None = None, steps: int = STEPS) -> list[dict[str, Any]]:
    """Seconds a step of every contestant at every size; what is built once for all steps has a record of its own."""
    records: list[dict[str, Any]] = []
    absent: set[str] = set()
    if sizes is None:
        sizes = (*SIZES, *LARGE) if setting.full else SIZES
    for count in sizes:
        setting.report(f"Chamfer {count:,}")
        iterates = trajectory(count, setting.device, setting.seed, steps)
        moved = iterates[EVERY::EVERY] or iterates[-1:]
        made = {name: make() for name, make in makers(iterates[0], setting).items()}
        contestants = {name: _along(term, moved) for name, term in made.items() if not isinstance(term, str)}
        reasons = {name: reason for name, reason in made.items() if isinstance(reason, str)}
        timings = setting.race(contestants | {"tso, built once": lambda: ChamferToInitial(iterates[0])})  # noqa: B023
        built = timings.pop("tso, built once")
        own = timings["tso"].median / len(moved)
        for name, timing in timings.items():
            each = timing.scaled(1.0 / len(moved))
            records.append(setting.record(WHAT, name, each, points=count, over_tso=each.median / own))
        records.append(setting.record(WHAT, "tso, built once", built, points=count))
        absent |= {name for name, reason in reasons.items() if reason == peers.NOT_INSTALLED}
        records += [setting.record(WHAT, name, points=count, left_out=reasons[name]) for name in reasons if name not in absent]
    return records + [setting.record(WHAT, name, left_out=peers.NOT_INSTALLED) for name in sorted(absent)]


def _along(term: peers.Term, iterates: Sequence[Tensor]) -> Work:
    leaves = [moved.clone().requires_grad_() for moved in iterates]

    def work() -> None:
        for leaf in leaves:
            torch.autograd.grad(term(leaf).sum(), leaf)

    return work


class _Trees:
    """Nearest neighbours by k-d trees, both ways, every point of them; ``keep`` builds that of the start once."""

    def __init__(self, initial: Tensor, workers: int, keep: bool = False) -> None:
        from scipy.spatial import cKDTree

        self._build, self._workers, self._initial = cKDTree, workers, initial[0]
        self._tree = cKDTree(self._initial.numpy()) if keep else None

    def __call__(self, moved: Tensor) -> Tensor:
        start, now = self._initial, moved[0]
        tree, other = self._tree or self._build(start.numpy()), self._build(now.detach().numpy())
        to_start = torch.from_numpy(tree.query(now.detach().numpy(), workers=self._workers)[1])
        to_now = torch.from_numpy(other.query(start.numpy(), workers=self._workers)[1])
        return (now - start[to_start]).square().sum(1).mean() + (start - now[to_now]).square().sum(1).mean()


def _cdist(initial: Tensor, moved: Tensor) -> Tensor:
    squared = torch.cdist(initial, moved).square()
    return squared.amin(1).mean() + squared.amin(2).mean()
