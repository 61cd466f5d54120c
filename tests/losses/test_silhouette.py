"""The silhouette (Eq. 2) and its cross-entropy (Eq. 4).

They are finite, and have a gradient, where the printed formula has none.

The form of the training, in torch, must fulfil the same statements.
"""

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from tests import oracles
from tests.scenes import block
from tso_cli.geometry.camera import Camera
from tso_cli.kernels.splat import splat
from tso_cli.kernels.window import NEGLIGIBLE
from tso_cli.losses import silhouette
from tso_cli.losses.projection import project_differentiably
from tso_cli.losses.silhouette import silhouette_bce, silhouette_of, silhouette_sums
from tso_cli.silhouette import bce

from .common import assert_equal, assert_gradient, by_autograd
from .scenes import camera_of

SIGMA_SQ = 0.4
RANDOM = np.random.default_rng(0)
ROWS, COLUMNS = np.mgrid[:64, :64]
DISC = ((ROWS - 31.5) ** 2 + (COLUMNS - 31.5) ** 2 < 144).astype(float)
# Tolerance of each form: neglected rows hold sums under 1e-8, and torch's form drops no more.
TOLERANCES = {"numpy": 1e-7, "torch": 1e-5}
FORMS = pytest.mark.parametrize("form", TOLERANCES)


def _bce(form, points, mask, known=None, valid=None, sigma_sq=SIGMA_SQ) -> tuple[float, np.ndarray]:
    """Value and gradient in one form, of ``valid`` points and ``known`` pixels (None: all)."""
    points = np.asarray(points, float)
    valid = np.ones(len(points), bool) if valid is None else valid
    known = np.ones(mask.shape) if known is None else known
    if form == "numpy":
        return silhouette_bce(points, valid, mask * known, (1.0 - mask) * known, sigma_sq)
    shown, target, weight = (torch.tensor(part)[None] for part in (valid, mask, known))

    def loss(leaf):
        sums = splat(leaf[None], shown, *mask.shape, sigma_sq)
        return bce.silhouette_bce(sums, target, leaf[None], shown, sigma_sq, weight)[0]

    return by_autograd(loss, points)


def _oracle(
    points: torch.Tensor, mask: np.ndarray, known: np.ndarray, valid: np.ndarray, sigma_sq: float
) -> torch.Tensor:
    """Every point at every pixel; negligible sums are those of the nearest point alone."""
    height, width = mask.shape
    sums = oracles.silhouette_sums(points[torch.tensor(valid)], height, width, sigma_sq)
    rows, columns = torch.meshgrid(torch.arange(height), torch.arange(width), indexing="ij")
    centres = torch.stack([columns, rows], -1).double()
    nearest = (centres[:, :, None] - points[torch.tensor(valid)]).square().sum(3).amin(2)
    covered = sums > NEGLIGIBLE
    missed = torch.where(
        covered, -torch.log(torch.tanh(torch.where(covered, sums, 1.0))), nearest / (2.0 * sigma_sq)
    )
    extra = torch.nn.functional.softplus(2.0 * sums) - math.log(2.0)
    foreground, background = (torch.tensor(part) for part in (mask * known, (1.0 - mask) * known))
    return (missed * foreground + extra * background).sum() * (4096.0 / (width * height))


def _soft(height: int = 22, width: int = 30) -> np.ndarray:
    return np.random.default_rng(2).random((height, width))


# Mask, known pixels, points, sigma^2.
SCENES = {
    "a disc, half covered": (DISC, None, RANDOM.uniform(25, 50, (200, 2)), SIGMA_SQ),
    "a soft mask": (_soft(), None, RANDOM.uniform(-5, 35, (50, 2)), SIGMA_SQ),
    "unknown pixels": (
        _soft(),
        (_soft()[::-1] > 0.4) * _soft(),
        RANDOM.uniform(0, 30, (20, 2)),
        SIGMA_SQ,
    ),
    "narrow Gaussians": (_soft(), None, RANDOM.uniform(0, 30, (30, 2)), 0.1),
    "wide Gaussians": (_soft(), None, RANDOM.uniform(0, 30, (30, 2)), 6.4),
    "points on borders of pixels": (
        _soft(),
        None,
        [[3.5, 4.5], [2.5, 7.0], [-0.5, 3.2], [29.5, 21.5], [8.0, 9.0]],
        SIGMA_SQ,
    ),
    "points outside the image": (
        _soft(),
        None,
        [[-2.3, 4.0], [11.2, -14.0], [50.0, 9.6], [12.0, 11.0]],
        SIGMA_SQ,
    ),
    "stacked points": (1.0 - DISC, None, [[10.3, 10.0]] * 6 + [[50.2, 40.7]], SIGMA_SQ),
}


@FORMS
@pytest.mark.parametrize("name", SCENES)
def test_value_and_gradient_are_those_of_all_points_and_pixels(name, form):
    mask, known, points, sigma_sq = SCENES[name]
    known, points = np.ones(mask.shape) if known is None else known, np.array(points)
    valid = np.arange(len(points)) % 7 != 3
    results = _bce(form, points, mask, known, valid, sigma_sq)
    expected = by_autograd(lambda leaf: _oracle(leaf, mask, known, valid, sigma_sq), points)
    assert not results[1][~valid].any()
    if name == "stacked points":
        # Of points equally near any may be attracted: only their sum counts.
        for _, gradient in (results, expected):
            gradient[:6] = gradient[:6].sum(0)
    assert_equal(results, expected, TOLERANCES[form])


@pytest.mark.parametrize("name", sorted(set(SCENES) - {"stacked points"}))
def test_the_gradient_is_that_of_finite_differences(name):
    mask, known, points, sigma_sq = SCENES[name]
    assert_gradient(
        lambda at: _bce("numpy", at, mask, known, None, sigma_sq), np.array(points[:30])
    )


@FORMS
def test_a_thousand_points_stacked_on_a_background_pixel_have_a_gradient(form):
    value, gradient = _bce(form, [[10.3, 10.0]] * 1000, DISC)
    assert np.isfinite(value)
    assert np.isfinite(gradient).all()
    assert (np.abs(gradient).sum(1) > 1e-3).all()


@FORMS
def test_where_points_cover_the_mask_the_loss_is_equation_4_over_all_points(form):
    rng = np.random.default_rng(0)
    points = np.concatenate([rng.uniform(17, 47, (1500, 2)), rng.uniform(0, 63, (5, 2))])
    expected = by_autograd(lambda leaf: oracles.bce(leaf, torch.tensor(DISC), SIGMA_SQ), points)
    assert_equal(_bce(form, points, DISC), expected, 1e-5)


# Beyond every window; and a pixel in the corner of the first point's square window that is nearer
# to the second point.
FAR_PIXELS = [((10, slice(12, 40)), [[11.3, 9.8]]), ((20, 20), [[24.4, 24.4], [24.55, 20.0]])]


@FORMS
@pytest.mark.parametrize(
    ("place", "points"), FAR_PIXELS, ids=["beyond every window", "in the corner of a window"]
)
def test_far_pixels_attract_the_nearest_point_as_equation_4_does(place, points, form):
    mask = block(place) * COLUMNS / 40.0
    expected = by_autograd(
        lambda leaf: oracles.bce(leaf, torch.tensor(mask), SIGMA_SQ), np.array(points)
    )
    assert_equal(_bce(form, points, mask), expected, 1e-5)


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.tuples(st.floats(0, 39), st.floats(0, 39)), min_size=1, max_size=5),
    st.integers(0, 39),
    st.integers(0, 39),
)
def test_of_a_few_points_the_loss_is_equation_4_up_to_the_count_of_the_nearest(points, row, column):
    mask = block(np.s_[row, column], (40, 40))
    oracle = oracles.bce(
        torch.tensor(points, dtype=torch.float64), torch.tensor(mask), SIGMA_SQ
    ).item()
    for form in ("numpy", "torch"):
        excess = (_bce(form, points, mask)[0] - oracle) / (4096 / 1600)
        assert -1e-2 <= excess <= math.log(len(points)) + 1e-2


@settings(max_examples=25, deadline=None)
@given(
    st.lists(st.tuples(st.floats(0, 11), st.floats(0, 9)), min_size=1, max_size=6, unique=True),
    st.integers(0, 1000),
)
def test_the_total_gradient_on_soft_masks_is_that_of_equation_4(points, seed):
    mask = np.random.default_rng(seed).random((10, 12))
    expected = by_autograd(
        lambda leaf: oracles.bce(leaf, torch.tensor(mask), SIGMA_SQ), np.array(points)
    )[1]
    # The nearest point stands for all points beyond the window; if several are equally near,
    # log-sum-exp shares the attraction.
    for form in ("numpy", "torch"):
        error = _bce(form, points, mask)[1].sum(0) - expected.sum(0)
        assert np.abs(error).max() <= 0.2 * (np.abs(expected).sum() + 1.0)


def test_sums_are_those_of_equation_2():
    points, valid = RANDOM.uniform(-5, 35, (40, 2)), RANDOM.random(40) < 0.8
    expected = oracles.silhouette_sums(torch.tensor(points[valid]), 22, 30, SIGMA_SQ)
    np.testing.assert_allclose(
        silhouette_sums(points, valid, 22, 30, SIGMA_SQ), expected, atol=1e-12
    )


def test_a_silhouette_on_a_coarser_grid_is_that_of_every_pixel():
    cloud = np.random.default_rng(5).uniform(-0.4, 0.4, (900, 3)) * [1.0, 0.6, 0.8]
    camera = Camera.canonical(600, 450)
    projected = project_differentiably(cloud, camera)
    exact = np.tanh(
        silhouette_sums(projected.points_px, projected.valid, 450, 600, 0.4 * (600 / 64) ** 2)
    )
    coarse = silhouette_of(cloud, camera)
    assert coarse.shape == (450, 600)
    assert np.abs(coarse - exact).max() < 0.04
    assert ((coarse > 0.5) != (exact > 0.5)).mean() < 0.002


def test_a_silhouette_of_points_drawn_in_parts_is_that_of_all_at_once(monkeypatch):
    cloud, camera = np.random.default_rng(6).uniform(-0.4, 0.4, (300, 3)), camera_of()
    whole = silhouette_of(cloud, camera)
    monkeypatch.setattr(silhouette, "POINTS_AT_ONCE", 130)
    np.testing.assert_allclose(silhouette_of(cloud, camera), whole, atol=1e-5)
    assert whole.max() > 0.1
