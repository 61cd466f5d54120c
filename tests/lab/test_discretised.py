"""The discrete projections against loops over points, and training through them."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tso_cli.train.batches import Batch, Drawing, draw_batch
from tso_cli.train.data import TrainingData
from tso_cli.train.loop import start, train
from tso_cli.train.losses import mask_loss
from tso_lab.studies.paper_measures import (
    DEPTH,
    PLAIN,
    depth_loss,
    discrete_depth,
    projected_objective,
    silhouette_sums,
)

from ..training import config, make_objects, make_thin

HEIGHT, WIDTH = 6, 9


def scattered(count: int) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
    """Points inside and around a small picture, their depths, and which are valid.

    None is valid in the last of three images.
    """
    rng = np.random.default_rng(0)
    points = rng.uniform([-2.0, -2.0], [WIDTH + 1.0, HEIGHT + 1.0], (3, count, 2))
    valid = rng.random((3, count)) < [[0.8], [0.8], [0.0]]
    return (
        torch.from_numpy(points),
        torch.from_numpy(rng.uniform(1.0, 3.0, (3, count))),
        torch.from_numpy(valid),
    )


def depth_by_loops(
    points: np.ndarray, depth: np.ndarray, valid: np.ndarray, upsampling: int
) -> np.ndarray:
    """Each cell of the finer grid keeps its last point; each pixel shows its nearest cell."""
    fine = np.full((HEIGHT * upsampling, WIDTH * upsampling), np.inf)
    for (x, y), z in zip(points[valid], depth[valid], strict=True):
        column, row = int(np.floor((x + 0.5) * upsampling)), int(np.floor((y + 0.5) * upsampling))
        if 0 <= column < WIDTH * upsampling and 0 <= row < HEIGHT * upsampling:
            fine[row, column] = z
    nearest = fine.reshape(HEIGHT, upsampling, WIDTH, upsampling).min((1, 3))
    return np.where(np.isinf(nearest), 0.0, nearest)


@pytest.mark.parametrize("upsampling", [1, 2, 5])
def test_a_depth_map_shows_the_nearest_point_of_a_pixel_and_the_last_of_a_cell(upsampling):
    arrays = scattered(200)
    depth, hit = discrete_depth(*arrays, HEIGHT, WIDTH, upsampling)
    expected = np.stack(
        [depth_by_loops(*(array[i].numpy() for array in arrays), upsampling) for i in range(3)]
    )
    np.testing.assert_allclose(depth.numpy(), expected, rtol=1e-12)
    np.testing.assert_array_equal(hit.numpy(), expected > 0.0)
    assert hit[0].any()
    assert not hit[2].any()


def test_only_the_depth_of_the_nearest_point_has_a_derivative():
    points = torch.tensor(
        [[[2.3, 1.2], [1.8, 0.9], [40.0, 1.0]]], dtype=torch.float64, requires_grad=True
    )
    depth = torch.tensor([[1.0, 2.0, 1.5]], dtype=torch.float64, requires_grad=True)
    nearest, _ = discrete_depth(points, depth, torch.ones(1, 3, dtype=torch.bool), HEIGHT, WIDTH)
    by_depth, by_place = torch.autograd.grad(nearest.sum(), [depth, points], allow_unused=True)
    np.testing.assert_allclose(by_depth.numpy(), [[1.0, 0.0, 0.0]])
    assert by_place is None
    cloud, depths, valid = (array[:1] for array in scattered(20))
    assert torch.autograd.gradcheck(
        lambda z: discrete_depth(cloud, z, valid, HEIGHT, WIDTH)[0],
        (depths.requires_grad_(True),),
        eps=1e-7,
    )


@pytest.fixture(scope="module")
def data() -> TrainingData:
    return TrainingData(make_objects(), "three boxes")


@pytest.fixture(scope="module")
def batch(data: TrainingData) -> Batch:
    return draw_batch(data, Drawing(0, 2, "canonical", 2), 0)


@pytest.fixture(scope="module")
def truth(batch: Batch) -> torch.Tensor:
    return torch.from_numpy(np.stack(batch.targets))


def test_bce_through_rounded_points_has_no_gradient_but_a_lower_loss_at_the_truth(batch, truth):
    leaf = (truth * 0.7).requires_grad_(True)
    assert not mask_loss(leaf, batch, 0.4, 0.0, "points", silhouette_sums)[0].requires_grad
    true, moved = (
        mask_loss(cloud, batch, 0.4, 0.0, "points", silhouette_sums)[0]
        for cloud in (truth, truth + 0.2)
    )
    assert float(true) < 0.5 * float(moved)


def test_the_depth_loss_is_zero_at_the_truth_and_pushes_along_the_line_of_sight_alone(data):
    batch = draw_batch(data, Drawing(0, 2, "canonical", 1), 0)
    truth = torch.from_numpy(np.stack(batch.targets))
    assert float(depth_loss(truth, batch)) == 0.0
    ahead = torch.from_numpy(batch.R[:, :1, 2]).float()
    farther = (truth + 0.1 * ahead).requires_grad_(True)
    (gradient,) = torch.autograd.grad(depth_loss(farther, batch), farther)
    along = (gradient * ahead).sum(-1, keepdim=True)
    np.testing.assert_allclose(gradient.numpy(), (along * ahead).numpy(), atol=1e-4)
    pushed = along[along != 0.0]
    assert len(pushed) > 100
    assert float((pushed > 0.0).float().mean()) > 0.8


@pytest.mark.parametrize("projection", [PLAIN, DEPTH])
def test_training_through_a_discrete_projection_lowers_the_affinity_loss(
    monkeypatch, data, batch, projection
):
    make_thin(monkeypatch)
    settings = config(
        supervision="masks",
        frame="canonical",
        steps=20,
        learning_rate=2e-3,
        points=64,
        saturation_steps=500,
    )
    networks = (
        start(data, settings).network,
        train(data, settings, objective=projected_objective(settings, projection)).network,
    )
    with torch.no_grad():
        before, after = (
            mask_loss(net(torch.from_numpy(batch.images)), batch, 0.4, 1.0, "points")[2]
            for net in networks
        )
    assert after < 0.7 * before
