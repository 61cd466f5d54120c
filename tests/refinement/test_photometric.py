"""The photometric loss of clouds with colours."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tso_cli.refinement.photometric import PhotometricLoss

from tests.painted import CAMERA, MASK, SIZE, painted, photo, sheet
from tso_cli import Camera, RefineConfig, refine
from tso_cli.errors import InputError
from tso_cli.geometry.view import View
from tso_cli.refinement import refine_batch
from tso_cli.refinement.resampled_view import resample_view


def photometric(colours: np.ndarray, image: np.ndarray, start: np.ndarray, blur: float = 1.0) -> PhotometricLoss:
    like = torch.tensor(start, dtype=torch.float64)[None]
    view = resample_view(View(MASK, CAMERA, image=image), 0.4, np.zeros(3), 1.0)
    terms = PhotometricLoss.of([view], [1.0], torch.tensor(colours), like)
    return terms.at(like, blur)


def loss(points: np.ndarray, colours: np.ndarray, image: np.ndarray, blur: float = 1.0) -> float:
    return float(photometric(colours, image, points, blur)(torch.tensor(points)[None]))


def test_the_loss_of_points_that_lie_on_their_colours_is_next_to_nothing():
    points, colours = sheet()
    aside = points + [0.05, 0.0, 0.0]
    assert loss(points, colours, photo()) < 1e-6
    assert loss(aside, colours, photo()) > 1000.0


def test_the_loss_ignores_exposure_and_background():
    points, colours = sheet()
    aside = points + [0.02, 0.01, 0.0]
    expected = loss(aside, colours, photo())
    assert loss(aside, colours, photo(0.6)) == pytest.approx(expected, rel=1e-5)
    assert loss(aside, colours, photo(behind=0.0)) == pytest.approx(expected, rel=1e-9)


def test_points_hidden_or_beside_the_mask_add_nothing():
    points, colours = sheet()
    aside = points + [0.02, 0.01, 0.0]
    expected = loss(aside, colours, photo())
    hidden, beside = aside * 0.9 - [0.0, 0.0, 0.1], np.array([[0.0, 0.49, 0.0]])
    more = np.concatenate([aside, hidden, beside])
    other = np.concatenate([colours, 1.0 - colours, [[1.0, 0.0, 1.0]]])
    assert loss(more, other, photo()) == pytest.approx(expected * len(points) / len(more), rel=1e-9)


def test_the_loss_of_a_point_is_bounded_by_the_robust_scale():
    points, _ = sheet()
    image = photo()
    image[..., 0] = 1.0 - image[..., 1]
    colours = np.stack([painted(*points.T[:2])[:, 1], np.full(len(points), 0.5), np.full(len(points), 0.5)], 1)
    assert loss(points, colours, image) <= 3000.0 * 0.1**2 * 1024.0


def test_the_loss_vanishes_where_the_paint_is_another():
    points, colours = sheet()
    assert loss(points, 1.0 - colours, photo()) == 0.0
    assert loss(points, np.full_like(colours, 0.5), photo()) < 1e-3


def test_the_gradient_is_that_of_finite_differences():
    rng = np.random.default_rng(5)
    points, colours = sheet(6.0)
    points = points + rng.uniform(-0.01, 0.01, points.shape) * [1.0, 1.0, 0.1]
    objective = photometric(colours, photo(0.8), points)
    moved = torch.tensor(points + [0.013, -0.011, 0.0])[None].requires_grad_()
    assert float(objective(moved).detach()) > 1.0
    assert torch.autograd.gradcheck(objective, moved, eps=1e-7, atol=1e-4, rtol=1e-4)


def test_a_photo_moves_points_along_a_surface_where_a_mask_does_not():
    target, colours = sheet(2.0)
    x, y, _ = target.T
    start = target + np.stack([0.03 * np.cos(3.3 * x), -0.03 * np.cos(3.3 * y), 0.0 * x], 1)
    config = RefineConfig(symmetry="none")
    before, alone, both = (
        np.linalg.norm(points - target, axis=1).mean()
        for points in (
            start,
            refine(start, View(MASK, CAMERA), config=config).points,
            refine(start, View(MASK, CAMERA, image=photo(0.7)), config=config, colours=colours).points,
        )
    )
    assert alone > 0.75 * before
    assert both < 0.5 * before


def test_colours_without_an_image_change_nothing_and_uint8_stands_for_fractions():
    points, colours = sheet(3.0)
    start, config = points * [0.95, 1.0, 1.0], RefineConfig(steps=6, symmetry="none")
    plain = refine(start, View(MASK, CAMERA), config=config).points
    assert np.array_equal(refine(start, View(MASK, CAMERA), config=config, colours=colours).points, plain)
    view, as_uint8 = View(MASK, CAMERA, image=photo()), np.rint(255.0 * colours).astype(np.uint8)
    results = (refine(start, view, config=config, colours=values).points for values in (as_uint8, as_uint8 / 255.0))
    assert np.abs(np.subtract(*results)).max() < 1e-6


def test_unusable_images_and_colours_are_refused():
    points, colours = sheet(3.0)
    view = View(MASK, CAMERA, image=photo())
    with pytest.raises(InputError, match=r"image has shape \[3, 3, 3\], the mask is 64x64 .*|expected \[64, 64, 3\]"):
        View(MASK, CAMERA, image=np.ones((3, 3, 3)))
    with pytest.raises(InputError, match="image's values span 0 to 255, expected 0 to 1"):
        View(MASK, CAMERA, image=np.array([0.0, 255.0, 0.0]) * np.ones((SIZE, SIZE, 1)))
    with pytest.raises(InputError, match="expected a cloud with colours, found none"):
        refine(points, view)
    assert "expected a cloud with colours" in str(refine_batch([(points, view)])[0])
    with pytest.raises(InputError, match="preset best, found points with paper"):
        refine(points, view, config=RefineConfig(preset="paper"), colours=colours)
    with pytest.raises(InputError, match=r"colours have shape \[2, 3\], expected \[324, 3\]"):
        refine(points, view, colours=colours[:2])
    with pytest.raises(InputError, match="colours span 0 to 300, expected 0 to 1"):
        refine(points, view, colours=np.linspace(0, 300, 972).reshape(-1, 3))
    with pytest.raises(InputError, match="colours are no array of numbers"):
        refine(points, view, colours="red")


def test_a_resampled_image_averages_the_known_foreground_alone():
    mask = np.zeros((256, 256), np.float32)
    mask[64:192, 66:192] = 1.0
    image = np.where(mask[..., None] > 0.5, [0.2, 0.4, 0.6], 1.0)
    known = np.ones((256, 256), bool)
    image[100:110, 100:110], known[100:110, 100:110] = 0.0, False
    resampled = resample_view(View(mask, Camera.canonical(256, 256), known, image=image), 0.4, np.zeros(3), 1.0)
    assert resampled.image.shape == (64, 64, 3)
    assert np.allclose(resampled.image[resampled.inside], [0.2, 0.4, 0.6])
    assert not resampled.image[resampled.mask == 0.0].any()


def test_a_flipped_view_has_no_flipped_photo():
    """Letters are not mirrored: with a mirror plane the photo counts once, for the points that it shows."""
    points, colours = sheet(3.0)
    view = View(MASK, CAMERA, image=photo())
    result = refine(points + [0.01, 0.0, 0.0], view, config=RefineConfig(steps=6, symmetry="x"), colours=colours)
    assert result.symmetry is not None
    assert result.loss_after < result.loss_before
