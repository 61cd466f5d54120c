"""The preset "best": the mean over its stages, the position prior, and what the views say nothing about."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from tso_cli.geometry.view import View
from tso_cli.refinement import RefineConfig, refine
from tso_cli.refinement.cloud import Cloud
from tso_cli.refinement.objective import ViewTargets
from tso_cli.refinement.presets import BEST
from tso_cli.refinement.prior import position_prior
from tso_cli.refinement.problem import Problem
from tso_cli.refinement.smooth_field import SmoothField
from tso_cli.render import look_at
from tso_cli.silhouette.projection import silhouette_of


def test_points_outside_every_image_hardly_move():
    """A long bar extends beyond the left border of an image in which it lies higher."""
    axes = np.linspace(-2.0, 0.4, 120), np.linspace(-0.1, 0.1, 5), np.linspace(-0.1, 0.1, 4)
    bar = np.stack(np.meshgrid(*axes), -1).reshape(-1, 3)
    camera = look_at(0.0, 0.0, 2.2, (64, 64))
    observed = camera.project(bar)[0][:, 0] > -0.5
    assert 0.3 < observed.mean() < 0.7
    mask = (silhouette_of(bar + [0.0, 0.06, 0.0], camera) > 0.5).astype(np.float32)
    config = RefineConfig(symmetry="none", coarse_to_fine=replace(BEST, least_prior_weight=0.0, most_prior_weight=0.0))
    moved = refine(bar, mask, camera, config).points[:, 1] - bar[:, 1]
    assert moved[observed].mean() > 0.02
    assert np.abs(moved[~observed]).mean() < 0.15 * moved[observed].mean()


def test_the_result_is_the_weighted_mean_of_the_stages_and_more_masks_raise_the_weight_of_the_last(chair):
    points, mask, camera, _ = chair
    side = look_at(90.0, 10.0, 2.0, (64, 64))
    views = [View(mask, camera), View((silhouette_of(points * [1.0, 1.1, 1.0], side) > 0.5).astype(np.float32), side)]

    def refined(*weights):
        stages = tuple(replace(stage, averaging_weight=weight) for stage, weight in zip(BEST.stages, weights, strict=True))
        config = replace(BEST, stages=stages, least_prior_weight=0.0)
        return refine(points, views, config=RefineConfig(steps=24, symmetry="none", coarse_to_fine=config))

    alone = [refined(*np.eye(3)[stage].clip(1e-12)).points for stage in range(3)]
    result = refined(1.0, 2.0, 3.0)
    weights = np.array([1.0, 2.0, 3.0 * sum(result.view_weights) ** 2])
    assert sum(result.view_weights) > 1.9
    expected = np.einsum("s,snk->nk", weights / weights.sum(), alone)
    np.testing.assert_allclose(result.points, expected, atol=1e-6)
    assert np.abs(alone[0] - alone[2]).max() > 1e-3


def test_as_evidence_a_flipped_mask_counts_a_quarter_and_a_depth_map_as_a_mask(chair):
    points, mask, camera, _ = chair
    depth = np.where(mask > 0.5, camera.t[2], 0.0)

    def evidence(views, symmetry="none", weights=(1.0, 1.0)):
        problem = Problem.of(Cloud(points, "points"), tuple(views), RefineConfig(symmetry=symmetry).settings())
        return problem.evidence(list(weights[: len(views)]))

    plain, deep = View(mask, camera), View(mask, camera, depth=depth)
    assert evidence([plain]) == 1.0
    assert evidence([plain, plain]) == 2.0
    assert evidence([plain], "x") == 1.25
    assert evidence([deep]) == 2.0
    assert evidence([plain, deep], "x") == 3.5
    assert evidence([plain, deep], "x", (0.5, 0.1)) == pytest.approx(0.5 * 1.25 + 0.1 * 2.25)


def _truncated(view: View) -> View:
    """The view without its upper half: the border truncates the object."""
    camera, half = view.camera, view.mask.shape[0] // 2
    lower = replace(camera, K=camera.K - [[0.0, 0.0, 0.0], [0.0, 0.0, half], [0.0, 0.0, 0.0]], height=camera.height - half)
    return View(view.mask[half:], lower)


def test_the_position_prior_of_a_truncated_object_has_three_times_the_weight(chair):
    points, mask, camera, _ = chair
    cloud = Cloud(points, "points")
    initial, counts = torch.tensor(cloud.normalised(), dtype=torch.float32)[None], torch.tensor([len(points)])
    field, config = SmoothField(initial, counts), replace(BEST, prior_weight=1e-6, by_area=False)
    priors = []
    for view in (View(mask, camera), _truncated(View(mask, camera))):
        resampled = [Problem.of(cloud, (view,), RefineConfig(symmetry="none").settings()).resampled]
        priors.append(position_prior(initial, counts, ViewTargets(resampled, counts, initial), field, config).weights)
    torch.testing.assert_close(priors[1], 3.0 * priors[0])


@pytest.mark.parametrize(("truncated", "expected"), [((True, True), 1.0), ((True, False), 2.0), ((False, False), 2.0)])
def test_views_that_all_truncate_the_object_are_no_more_evidence_than_one(chair, monkeypatch, truncated, expected):
    points, mask, camera, _ = chair
    side = look_at(90.0, 10.0, 3.0, (64, 64))
    views = [View(mask, camera), View((silhouette_of(points, side) > 0.5).astype(np.float32), side)]
    evidence = []

    def spied(*arguments):
        evidence.append(float(arguments[-1][0]))
        return position_prior(*arguments)

    monkeypatch.setattr("tso_cli.refinement.coarse_to_fine.position_prior", spied)
    views = [_truncated(view) if cut else view for view, cut in zip(views, truncated, strict=True)]
    refine(points, views, config=RefineConfig(steps=3, symmetry="none"))
    assert evidence
    assert evidence == [pytest.approx(expected, rel=0.05)] * len(evidence)
