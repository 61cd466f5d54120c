"""The discrete projections, against loops over points and pixels; and what training through them is."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tso_cli.lab.studies.discretised import discrete_depth, discrete_mask
from tso_cli.lab.studies.other_projections import (
    DEPTH,
    GAUSSIAN,
    PLAIN,
    bce_gradient,
    depth_loss,
    depth_map,
    first_gradients,
    projected_objective,
)
from tso_cli.lab.studies.other_projections import silhouette_sums as plain_sums
from tso_cli.silhouette.projection import CameraBatch, silhouette_sums
from tso_cli.train import start, train
from tso_cli.train.batches import Drawing, draw_batch
from tso_cli.train.data import TrainingData
from tso_cli.train.losses import mask_loss

from ..training import config, make_objects, make_thin

HEIGHT, WIDTH = 6, 9


def scattered(seed: int = 0, images: int = 3, count: int = 60) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Points inside and around a small picture, their depths, and which count."""
    rng = np.random.default_rng(seed)
    points = rng.uniform([-2.0, -2.0], [WIDTH + 1.0, HEIGHT + 1.0], (images, count, 2))
    depth = rng.uniform(1.0, 3.0, (images, count))
    return torch.from_numpy(points), torch.from_numpy(depth), torch.from_numpy(rng.random((images, count)) < 0.8)


def mask_by_loops(points: np.ndarray, valid: np.ndarray) -> np.ndarray:
    picture = np.zeros((HEIGHT, WIDTH))
    for (x, y), counts in zip(points, valid, strict=True):
        column, row = int(np.floor(x + 0.5)), int(np.floor(y + 0.5))
        if counts and 0 <= column < WIDTH and 0 <= row < HEIGHT:
            picture[row, column] = 1.0
    return picture


def depth_by_loops(points: np.ndarray, depth: np.ndarray, valid: np.ndarray, upsampling: int) -> np.ndarray:
    """Each cell of the finer grid keeps the last point that falls into it; each pixel shows the nearest of its cells."""
    fine = np.zeros((HEIGHT * upsampling, WIDTH * upsampling))
    for (x, y), z, counts in zip(points, depth, valid, strict=True):
        column, row = int(np.floor((x + 0.5) * upsampling)), int(np.floor((y + 0.5) * upsampling))
        if counts and 0 <= column < WIDTH * upsampling and 0 <= row < HEIGHT * upsampling:
            fine[row, column] = z
    picture = np.zeros((HEIGHT, WIDTH))
    for row in range(HEIGHT):
        for column in range(WIDTH):
            cells = fine[row * upsampling : (row + 1) * upsampling, column * upsampling : (column + 1) * upsampling]
            if (cells > 0.0).any():
                picture[row, column] = cells[cells > 0.0].min()
    return picture


def test_the_discretised_mask_marks_the_pixels_that_points_are_rounded_to():
    points, _, valid = scattered()
    found = discrete_mask(points, valid, HEIGHT, WIDTH).numpy()
    for i in range(len(points)):
        np.testing.assert_array_equal(found[i], mask_by_loops(points[i].numpy(), valid[i].numpy()))


@pytest.mark.parametrize("upsampling", [1, 2, 5])
def test_a_depth_map_shows_the_nearest_point_of_a_pixel_and_the_last_of_a_cell(upsampling):
    points, depth, valid = scattered(1, count=200)
    found, hit = discrete_depth(points, depth, valid, HEIGHT, WIDTH, upsampling)
    for i in range(len(points)):
        expected = depth_by_loops(points[i].numpy(), depth[i].numpy(), valid[i].numpy(), upsampling)
        np.testing.assert_allclose(found[i].numpy(), expected, rtol=1e-12)
        np.testing.assert_array_equal(hit[i].numpy(), expected > 0.0)


def test_a_finer_grid_keeps_the_nearest_of_two_points_of_one_pixel():
    points = torch.tensor([[[2.3, 1.2], [1.8, 0.9]]])
    depth, valid = torch.tensor([[1.0, 2.0]]), torch.ones(1, 2, dtype=torch.bool)
    assert float(discrete_depth(points, depth, valid, HEIGHT, WIDTH, 1)[0][0, 1, 2]) == 2.0
    assert float(discrete_depth(points, depth, valid, HEIGHT, WIDTH, 5)[0][0, 1, 2]) == 1.0


def test_only_the_depth_of_the_point_that_shows_has_a_derivative():
    points = torch.tensor([[[2.3, 1.2], [1.8, 0.9], [40.0, 1.0]]], dtype=torch.float64, requires_grad=True)
    depth = torch.tensor([[1.0, 2.0, 1.5]], dtype=torch.float64, requires_grad=True)
    shown, _ = discrete_depth(points, depth, torch.ones(1, 3, dtype=torch.bool), HEIGHT, WIDTH)
    by_depth, by_place = torch.autograd.grad(shown.sum(), [depth, points], allow_unused=True)
    np.testing.assert_allclose(by_depth.numpy(), [[1.0, 0.0, 0.0]])
    assert by_place is None
    cloud, depths, valid = scattered(2)
    assert torch.autograd.gradcheck(
        lambda z: discrete_depth(cloud, z, valid, HEIGHT, WIDTH)[0], (depths.requires_grad_(True),), eps=1e-7
    )


def test_an_image_without_points_shows_nothing():
    points, depth, valid = torch.zeros(1, 4, 2), torch.ones(1, 4), torch.zeros(1, 4, dtype=torch.bool)
    assert float(discrete_mask(points, valid, HEIGHT, WIDTH).abs().max()) == 0.0
    shown, hit = discrete_depth(points, depth, valid, HEIGHT, WIDTH)
    assert float(shown.abs().max()) == 0.0 and not hit.any()


@pytest.fixture(scope="module")
def data() -> TrainingData:
    return TrainingData(make_objects(), "three boxes")


@pytest.fixture
def thin(monkeypatch: pytest.MonkeyPatch) -> None:
    make_thin(monkeypatch)


def weights(network: torch.nn.Module) -> dict[str, torch.Tensor]:
    return dict(network.state_dict())


def test_the_objective_of_the_comparison_trains_as_the_real_one_does(thin, data):
    """With the paper's projection it gives the very same network: nothing but the projection differs."""
    settings = config(supervision="masks", frame="canonical", averaging=0.9, learning_rate=1e-3)
    other = train(data, settings, objective=projected_objective(settings, GAUSSIAN))
    result = train(data, settings)
    for name, tensor in weights(result.network).items():
        assert torch.equal(tensor, weights(other.network)[name]), name
    assert other.lambda_dropped_at == result.lambda_dropped_at


def test_the_hook_of_the_mask_loss_changes_nothing_for_our_own_sums(data):
    batch = draw_batch(data, Drawing(0, 2, "canonical", 3), 0)
    points = torch.from_numpy(np.stack(batch.targets)) * 0.8
    ours = mask_loss(points, batch, 0.4, 0.5, "points")[0]
    hooked = mask_loss(points, batch, 0.4, 0.5, "points", lambda p, c: silhouette_sums(p, c, 0.4))[0]
    assert float(ours) == float(hooked)


def test_bce_through_rounded_points_tells_no_point_where_to_go(data):
    batch = draw_batch(data, Drawing(0, 2, "canonical", 2), 0)
    points = torch.from_numpy(np.stack(batch.targets)) * 0.7
    assert bce_gradient(points, batch, 0.4, plain_sums) == 0.0
    assert bce_gradient(points, batch, 0.4, None) > 1.0


def test_the_discretised_silhouette_of_the_truth_has_a_lower_loss_than_that_of_another_place(data):
    batch = draw_batch(data, Drawing(0, 2, "canonical", 2), 0)
    points = torch.from_numpy(np.stack(batch.targets))
    true, moved = (mask_loss(cloud, batch, 0.4, 0.0, "points", plain_sums)[0] for cloud in (points, points + 0.2))
    assert float(true) < 0.5 * float(moved)


def test_the_depth_loss_is_zero_at_the_truth_and_pushes_along_the_line_of_sight_alone(data):
    batch = draw_batch(data, Drawing(0, 2, "canonical", 1), 0)
    points = torch.from_numpy(np.stack(batch.targets))
    assert float(depth_loss(points, batch)) == 0.0
    # away from the camera by a tenth: what shows must come nearer
    ahead = torch.from_numpy(batch.R[:, 0, 2]).float()
    moved = (points + 0.1 * ahead.unsqueeze(1)).requires_grad_(True)
    (gradient,) = torch.autograd.grad(depth_loss(moved, batch), moved)
    along = (gradient * ahead.unsqueeze(1)).sum(-1)
    np.testing.assert_allclose(gradient.numpy(), (along.unsqueeze(-1) * ahead.unsqueeze(1)).numpy(), atol=1e-4)
    pushed = along[along != 0.0]
    assert len(pushed) > 100
    assert float((pushed > 0.0).float().mean()) > 0.8


def test_the_depth_map_of_the_truth_fills_the_mask_of_its_view(data):
    batch = draw_batch(data, Drawing(0, 1, "canonical", 2), 0)
    K, R, t = (torch.from_numpy(value[0]) for value in (batch.K, batch.R, batch.t))
    shown, hit = depth_map(torch.from_numpy(batch.targets[0]).double(), CameraBatch(K, R, t, 64, 64), 5)
    masks = batch.masks[0] > 0.0
    assert float((hit.numpy() & masks).sum() / hit.numpy().sum()) > 0.99
    assert float((hit.numpy() & masks).sum() / masks.sum()) > 0.3
    nearest, farthest = float(t[0, 2]) - 0.87, float(t[0, 2]) + 0.87
    assert nearest < float(shown[0][hit[0]].min()) < float(shown[0][hit[0]].max()) < farthest


@pytest.mark.parametrize("projection", [PLAIN, DEPTH])
def test_training_through_a_discrete_projection_lowers_what_it_still_can(thin, data, projection):
    settings = config(supervision="masks", frame="canonical", steps=30, learning_rate=1e-3, points=128, saturation_steps=500)
    network = train(data, settings, objective=projected_objective(settings, projection)).network
    before = start(data, settings).network
    batch = draw_batch(data, Drawing(9, 3, "canonical", 2), 0)
    images = torch.from_numpy(batch.images)
    with torch.no_grad():
        losses = [mask_loss(net(images), batch, 0.4, 1.0, "points")[2] for net in (before, network)]
    assert losses[1] < 0.7 * losses[0]
    gradients = first_gradients(data, settings)
    assert gradients["own"] == 0.0 < gradients[GAUSSIAN]
