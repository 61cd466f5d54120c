"""The parts of the default preset."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from ...kernels.dispatch import planned
from ...refinement import RefineConfig, refine
from ...refinement.cloud import Cloud
from ...refinement.objective import MaskChamferObjective, ViewTargets
from ...refinement.presets import BEST, STAGES
from ...refinement.prior import position_prior
from ...refinement.problem import Problem
from ...refinement.run import view_ious
from ...refinement.smooth_field import SmoothField
from ...refinement.symmetry import find_mirror_plane
from ...refinement.symmetry_check import verified_symmetry
from .material import chair_views, cloud
from .timing import FORMS, Contestant, Records, Sample, Setting, timed

SIZES = (1024, 16384)


def measure(setting: Setting, sizes: tuple[int, ...] = SIZES) -> Records:
    """One call of each part beside a whole refinement, in both forms of the loops."""
    records = []
    for points in sizes:
        for form, work in FORMS.items():
            with planned(work, work):
                contestants = [
                    Contestant(name, sample, {"points": points, "form": form})
                    for name, sample in samples(points, setting.seed).items()
                ]
                records += setting.race("parts", contestants, "of_refine")
    return records


def samples(count: int, seed: int = 0) -> dict[str, Sample]:
    """Name -> one call, in the form of the loops that is planned; the whole refinement is the first.

    There are two views, since one is not asked about a mirror plane.
    """
    views = tuple(chair_views(2))
    settings = RefineConfig(symmetry="x").settings()
    problem = Problem.of(Cloud(cloud(count, seed), "points"), views, settings)
    points, given = problem.cloud.normalised(), problem.cloud.given
    field, targets = SmoothField(points), ViewTargets.of(problem.resampled, [1.0] * len(problem.resampled))
    values = np.random.default_rng(seed).normal(size=(len(field.nodes), 3))
    mask_chamfer = MaskChamferObjective(targets, STAGES[0].robust_scale, targets.resolvability(points, field))
    works: dict[str, Callable[[], object]] = {
        "mirror plane search": partial(find_mirror_plane, points),
        "symmetry check": partial(verified_symmetry, problem, [1.0, 1.0], settings, field),
        "farthest points and field": partial(SmoothField, points),
        "one smoothed product": partial(field.smoothed, values, STAGES[0].smoothness),
        "mask Chamfer loss, value and gradient": partial(mask_chamfer, points),
        "position prior": partial(position_prior, points, targets, field, BEST),
        "resampling of the windows": partial(problem.with_views, views, settings),
        "judging": partial(view_ious, given, given, views, views),
    }

    def factors() -> float:
        fresh = SmoothField(points)
        return timed(lambda: [fresh.smoothed(values, stage.smoothness) for stage in STAGES])()

    whole = timed(partial(refine, given, views))
    return {"refine": whole, "factors of the three stages": factors} | {name: timed(work) for name, work in works.items()}
