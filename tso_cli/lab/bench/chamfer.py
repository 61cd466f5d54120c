"""Chamfer distance to the initial cloud: value and gradient along a refinement."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import torch
from scipy.spatial import cKDTree

from ...kernels.dispatch import planned
from ...losses.chamfer import ChamferToStart
from ...refinement import RefineConfig, refine
from ...refinement.optimise import Array, Term
from . import peers
from .material import chair_views, cloud
from .timing import FORMS, Records, Setting, timed

SIZES, LARGE = (1024, 4096, 16384), (65536,)
# Numbers of the paper's steps after which it is measured: points that have hardly moved need no search.
STEPS = (10, 30, 50)
# torch.cdist holds all pairs at once; packages that compare all pairs take minutes.
CDIST_UP_TO, PAIRS_UP_TO = 4096, 16384
COMPARE_ALL = ("chamferdist", "pykeops", "pytorch3d")


def measure(setting: Setting, sizes: Sequence[int] = ()) -> Records:
    """Seconds a step of every contestant at every size, on one thread unless its name says otherwise."""
    records = []
    for count in sizes or ((*SIZES, *LARGE) if setting.full else SIZES):
        initial, configs = cloud(count, setting.seed), [RefineConfig(preset="paper", steps=steps) for steps in STEPS]
        moved = [refine(initial, chair_views(), config=config).points for config in configs]
        samples = {
            name: term if isinstance(term, str) else timed(partial(_along, term, moved))
            for name, term in terms(initial).items()
        }
        records += peers.race(setting, "chamfer", samples, len(moved), points=count)
    return records


def _along(term: Term, iterates: Sequence[Array]) -> None:
    for points in iterates:
        term(points)


def terms(initial: Array) -> dict[str, Term | str]:
    """Contestant -> its Chamfer distance to ``initial`` [N, 3], or why it is left out; tso's compiled loops are first."""
    count, start = len(initial), peers.tensor(initial)
    result: dict[str, Term | str] = {}
    for form, work in FORMS.items():
        with planned(work, work):
            result[f"tso, {form}"] = ChamferToStart(initial)
    result["two k-d trees a step, 1 worker"] = partial(_k_d_trees, initial, None, 1)
    result["two k-d trees a step, all workers"] = partial(_k_d_trees, initial, None, -1)
    result["one k-d tree kept, all queried"] = partial(_k_d_trees, initial, cKDTree(initial), 1)
    pairs = f"{float(count) ** 2:.1e} pairs"
    result["cdist, torch"] = f"{pairs} held at once"
    if count <= CDIST_UP_TO:
        result["cdist, torch"] = peers.differentiated(lambda moved: _cdist(start, moved))
    for name, make in peers.chamfer_terms(initial).items():
        slow = name in COMPARE_ALL and count > PAIRS_UP_TO
        result[name] = f"compares all {pairs}, minutes" if slow else peers.tried(name, make, initial)
    return result


def _k_d_trees(initial: Array, kept: cKDTree | None, workers: int, moved: Array) -> tuple[float, Array]:
    """Nearest neighbours of all points, both ways; ``kept`` is the tree of the initial points, else built at each call."""
    to_initial = (kept or cKDTree(initial)).query(moved, workers=workers)[1]
    return peers.paired(initial, moved, to_initial, cKDTree(moved).query(initial, workers=workers)[1])


def _cdist(start: torch.Tensor, moved: torch.Tensor) -> torch.Tensor:
    squared = torch.cdist(start, moved).square()
    return squared.amin(0).mean() + squared.amin(1).mean()
