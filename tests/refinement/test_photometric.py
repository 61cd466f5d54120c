"""The pull of photos on clouds that have colours: what it asks, what it leaves alone, and its gradient."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tests.painted import CAMERA, COLUMNS, MASK, SIZE, painted, photo, sheet
from tso_cli import Camera, RefineConfig, refine
from tso_cli.errors import InputError
from tso_cli.geometry.view import View
from tso_cli.refinement import refine_batch
from tso_cli.refinement.photometric import PhotometricLoss, blurred, sampled
from tso_cli.refinement.resampled_view import resample_view


def pull(colours: np.ndarray, image: np.ndarray, start: np.ndarray, blur: float = 1.0) -> PhotometricLoss:
    like = torch.tensor(start, dtype=torch.float64)[None]
    view = resample_view(View(MASK, CAMERA, image=image), 0.4, np.zeros(3), 1.0)
    made = PhotometricLoss.of([view], [1.0], torch.tensor(colours), like)
    return made.at(like, blur)


def loss(points: np.ndarray, colours: np.ndarray, image: np.ndarray, blur: float = 1.0) -> float:
    return float(pull(colours, image, points, blur)(torch.tensor(points)[None]))


def test_a_cloud_that_lies_where_the_photo_has_its_colours_costs_next_to_nothing():
    points, colours = sheet()
    aside = points + [0.05, 0.0, 0.0]
    assert loss(points, colours, photo()) < 1e-6
    assert loss(aside, colours, photo()) > 1000.0


def test_neither_exposure_nor_background_of_the_photo_matters():
    points, colours = sheet()
    aside = points + [0.02, 0.01, 0.0]
    wanted = loss(aside, colours, photo())
    assert loss(aside, colours, photo(0.6)) == pytest.approx(wanted, rel=1e-5)
    assert loss(aside, colours, photo(behind=0.0)) == pytest.approx(wanted, rel=1e-9)


def test_light_that_is_added_and_changes_slowly_across_the_object_matters_little():
    points, colours = sheet()
    lit = np.where(MASK[..., None] > 0.5, 0.6 * photo() + 0.006 * COLUMNS[..., None], 1.0)
    aside = points + [0.05, 0.0, 0.0]
    assert loss(points, colours, lit) < 0.1 * loss(aside, colours, lit)


def test_what_is_hidden_or_beside_the_mask_costs_nothing():
    points, colours = sheet()
    aside = points + [0.02, 0.01, 0.0]
    wanted = loss(aside, colours, photo())
    hidden, beside = aside * 0.9 - [0.0, 0.0, 0.1], np.array([[0.0, 0.49, 0.0]])
    more = np.concatenate([aside, hidden, beside])
    other = np.concatenate([colours, 1.0 - colours, [[1.0, 0.0, 1.0]]])
    assert loss(more, other, photo()) == pytest.approx(wanted * len(points) / len(more), rel=1e-9)


def test_colours_that_differ_much_cost_no_more_than_the_tolerance_squared():
    points, _ = sheet()
    image = photo()
    image[..., 0] = 1.0 - image[..., 1]
    colours = np.stack([painted(*points.T[:2])[:, 1], np.full(len(points), 0.5), np.full(len(points), 0.5)], 1)
    assert loss(points, colours, image) <= 3000.0 * 0.1**2 * 1024.0


def test_paint_of_another_object_asks_nothing():
    points, colours = sheet()
    assert loss(points, 1.0 - colours, photo()) == 0.0
    assert loss(points, np.full_like(colours, 0.5), photo()) < 1e-3


def test_the_gradient_is_that_of_finite_differences():
    rng = np.random.default_rng(5)
    points, colours = sheet(6.0)
    points = points + rng.uniform(-0.01, 0.01, points.shape) * [1.0, 1.0, 0.1]
    asked = pull(colours, photo(0.8), points)
    moved = torch.tensor(points + [0.013, -0.011, 0.0])[None].requires_grad_()
    assert float(asked(moved).detach()) > 1.0
    assert torch.autograd.gradcheck(asked, moved, eps=1e-7, atol=1e-4, rtol=1e-4)


def test_a_photo_is_interpolated_between_pixels_and_its_border_goes_on():
    image = torch.rand(4, 5, 3, dtype=torch.float64)
    places = torch.tensor([[2.0, 1.0], [2.5, 1.0], [2.0, 1.25], [-3.0, 1.0], [9.0, 9.0]], dtype=torch.float64)
    found = sampled(image, places)
    wanted = [
        image[1, 2],
        (image[1, 2] + image[1, 3]) / 2,
        0.75 * image[1, 2] + 0.25 * image[2, 2],
        image[1, 0],
        image[3, 4],
    ]
    assert torch.allclose(found, torch.stack(wanted))


def test_the_blur_is_the_gaussian_mean_over_what_has_a_share():
    rng = np.random.default_rng(1)
    image, share = rng.random((6, 7, 3)), rng.integers(0, 2, (6, 7)).astype(float)
    found = blurred(torch.tensor(image), torch.tensor(share), 1.3).numpy()
    for row, column in ((0, 0), (3, 4), (5, 6)):
        rows, columns = np.mgrid[:6, :7]
        weight = share * np.exp(-((rows - row) ** 2 + (columns - column) ** 2) / (2 * 1.3**2))
        assert np.allclose(found[row, column], (weight[..., None] * image).sum((0, 1)) / weight.sum())


def test_a_photo_brings_the_colours_of_a_cloud_to_their_places_where_its_mask_does_not():
    wanted, colours = sheet(2.0)
    x, y, _ = wanted.T
    start = wanted + np.stack([0.03 * np.cos(3.3 * x), -0.03 * np.cos(3.3 * y), 0.0 * x], 1)
    config = RefineConfig(symmetry="none")
    before, alone, both = (
        np.linalg.norm(points - wanted, axis=1).mean()
        for points in (
            start,
            refine(start, View(MASK, CAMERA), config=config).points,
            refine(start, View(MASK, CAMERA, image=photo(0.7)), config=config, colours=colours).points,
        )
    )
    assert alone > 0.75 * before
    assert both < 0.5 * before


def test_a_flipped_picture_has_no_flipped_photo():
    """Letters are not mirrored: with a mirror plane the photo asks once, of the points that it shows."""
    points, colours = sheet(3.0)
    start, config = points + [0.01, 0.0, 0.0], RefineConfig(steps=6, symmetry="x")
    found = refine(start, View(MASK, CAMERA, image=photo()), config=config, colours=colours)
    assert found.symmetry is not None
    assert found.loss_after < found.loss_before


def test_colours_without_an_image_change_nothing_and_bytes_are_fractions():
    points, colours = sheet(3.0)
    start, config = points * [0.95, 1.0, 1.0], RefineConfig(steps=6, symmetry="none")
    plain = refine(start, View(MASK, CAMERA), config=config).points
    assert np.array_equal(refine(start, View(MASK, CAMERA), config=config, colours=colours).points, plain)
    view, in_bytes = View(MASK, CAMERA, image=photo()), np.rint(255.0 * colours).astype(np.uint8)
    found = (refine(start, view, config=config, colours=own).points for own in (in_bytes, in_bytes / 255.0))
    assert np.abs(np.subtract(*found)).max() < 1e-6


def test_images_and_colours_that_cannot_be_used_are_refused_in_one_line():
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


def test_the_loop_averages_the_foreground_of_a_photo_and_nothing_else():
    mask = np.zeros((256, 256), np.float32)
    mask[64:192, 66:192] = 1.0
    image = np.where(mask[..., None] > 0.5, [0.2, 0.4, 0.6], 1.0)
    known = np.ones((256, 256), bool)
    image[100:110, 100:110], known[100:110, 100:110] = 0.0, False
    found = resample_view(View(mask, Camera.canonical(256, 256), known, image=image), 0.4, np.zeros(3), 1.0)
    assert found.image.shape == (64, 64, 3)
    assert np.allclose(found.image[found.inside], [0.2, 0.4, 0.6])
    assert not found.image[found.mask == 0.0].any()
