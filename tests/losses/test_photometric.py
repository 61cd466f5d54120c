"""The photometric loss of clouds with colours."""

import numpy as np
import pytest
import torch
from scipy.ndimage import gaussian_filter

from tests import oracles
from tests.painted import CAMERA, MASK, photo, sheet
from tso_cli.losses.photometric import Photo, PhotometricTerm, _detail

from .common import assert_equal, assert_gradient, by_autograd


def term(
    colours: np.ndarray, image: np.ndarray, start: np.ndarray, weight: float = 1.0, mask=MASK > 0.5
) -> PhotometricTerm:
    shown = np.where(mask[..., None], image, 0.0).astype(float)
    return PhotometricTerm.at(Photo(shown, mask, CAMERA, weight), colours, start)


def loss(points: np.ndarray, colours: np.ndarray, image: np.ndarray) -> float:
    return term(colours, image, points)(points)[0]


POINTS, COLOURS = sheet()
ASIDE = POINTS + [0.02, 0.01, 0.0]


def test_the_loss_of_points_that_lie_on_their_colours_is_next_to_nothing():
    assert loss(POINTS, COLOURS, photo()) < 1e-6
    assert loss(POINTS + [0.05, 0.0, 0.0], COLOURS, photo()) > 1000.0


def test_the_loss_ignores_exposure_and_grows_with_the_weight_of_the_view():
    expected = loss(ASIDE, COLOURS, photo())
    assert loss(ASIDE, COLOURS, photo(0.6)) == pytest.approx(expected, rel=1e-5)
    assert term(COLOURS, photo(), ASIDE, weight=0.3)(ASIDE)[0] == pytest.approx(0.3 * expected)


def test_points_hidden_or_outside_the_mask_add_nothing():
    hidden, outside = ASIDE * 0.9 - [0.0, 0.0, 0.1], np.array([[0.0, 0.49, 0.0]])
    more = np.concatenate([ASIDE, hidden, outside])
    of_more = np.concatenate([COLOURS, 1.0 - COLOURS, [[1.0, 0.0, 1.0]]])
    expected = loss(ASIDE, COLOURS, photo()) * len(POINTS) / len(more)
    assert loss(more, of_more, photo()) == pytest.approx(expected, rel=1e-9)


def test_the_loss_vanishes_where_the_paint_is_another():
    assert loss(POINTS, 1.0 - COLOURS, photo()) == 0.0
    assert loss(POINTS, np.full_like(COLOURS, 0.5), photo()) < 1e-3


@pytest.fixture
def scene() -> tuple[PhotometricTerm, np.ndarray]:
    """A term, and points near its start: some hidden, some outside the mask or the image."""
    rng = np.random.default_rng(5)
    points, colours = sheet(6.0)
    points = points + rng.uniform(-0.01, 0.01, points.shape) * [1.0, 1.0, 0.1]
    # Behind their neighbours: the camera stands at z = 2.
    points[3:60:7] = points[2:59:7] * 1.1 - [0.0, 0.0, 0.2]
    # Outside the image, behind the camera, and beyond the centres of the outermost pixels.
    points[5:8] = [[0.7, 0.1, 0.0], [0.1, 0.2, 3.0], [-0.544, 0.2, 0.0]]
    inside = (MASK > 0.5) | (np.arange(64) < 3)
    return term(colours, photo(0.8), points, mask=inside), points + [0.013, -0.011, 0.0]


def test_the_gradient_is_that_of_finite_differences(scene):
    objective, points = scene
    assert objective(points)[0] > 1.0
    assert_gradient(objective, points, 1e-7, 1e-4)


def test_value_and_gradient_are_those_of_bilinear_samples_of_the_details(scene):
    """The grid sampler of torch, and visibility point by point."""
    objective, points = scene
    depth = 2.0 - points[:, 2]
    pixels = 120.0 * points[:, :2] * [1.0, -1.0] / depth[:, None] + 31.5
    inside = (depth > 0.0) & (np.abs(pixels - 31.5) < 32.0).all(1)
    near = (np.abs(np.rint(pixels)[:, None] - np.rint(pixels)) <= 1.0).all(2) & inside
    first = np.where(near, depth, np.inf).min(1, initial=np.inf)
    visible = inside & (depth <= first + 0.015)
    visible[inside] &= objective.photo.inside[tuple(np.rint(pixels[inside]).astype(int).T[::-1])]
    assert 0 < visible.sum() < len(points) - 7

    def oracle(leaf: torch.Tensor) -> torch.Tensor:
        places = ((oracles.project(leaf, CAMERA)[0] - 31.5) / 31.5)[None, None]
        image = torch.tensor(objective.detail).permute(2, 0, 1)[None]
        sampled = torch.nn.functional.grid_sample(
            image, places, padding_mode="border", align_corners=True
        )[0, :, 0].T
        difference = (sampled - torch.tensor(objective.expected)) / torch.tensor(objective.exposure)
        squared = difference.square().sum(1)[torch.tensor(visible)]
        return (
            3000.0 * objective.agreement * 1024.0 / len(points) * oracles.robust(squared, 0.1).sum()
        )

    assert_equal(objective(points), by_autograd(oracle, points))


def test_the_detail_of_a_picture_is_a_difference_of_gaussian_blurs_among_its_own_pixels():
    rng = np.random.default_rng(6)
    image, weight = rng.random((20, 30, 3)), (rng.random((20, 30)) < 0.7).astype(float)

    def blurred(sigma: float) -> np.ndarray:
        both = np.concatenate([image * weight[..., None], weight[..., None]], 2)
        both = gaussian_filter(both, sigma, axes=(0, 1), mode="constant", truncate=30.0)
        return both[..., :3] / both[..., 3:]

    np.testing.assert_allclose(_detail(image, weight, 1.5), blurred(1.5) - blurred(6.0), atol=1e-9)
