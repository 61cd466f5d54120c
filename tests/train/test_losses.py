"""The training losses and the schedule of lambda."""

import numpy as np
import pytest
import torch

from tso_cli.geometry.camera import Camera
from tso_cli.train.batches import Draw, Drawing, assemble, draw_batch
from tso_cli.train.data import TrainingData
from tso_cli.train.losses import (
    DROP,
    AffinitySchedule,
    mask_loss,
    mask_loss_by_category,
    point_loss,
)

from ..training import make_objects


def test_the_chamfer_loss_is_zero_for_the_targets_themselves(data):
    batch = draw_batch(data, Drawing(0, 2, "view"), 0)
    loss, forward, backward = point_loss(torch.from_numpy(np.stack(batch.targets)), batch)
    assert float(loss) == forward == backward == 0.0


def test_true_points_have_a_far_lower_mask_loss_than_displaced_ones(data):
    batch = draw_batch(data, Drawing(0, 2, "view", 3), 0)
    points = torch.from_numpy(np.stack(batch.targets))
    true, bce, outliers = mask_loss(points, batch, 0.4, 0.01, "points")
    displaced, *_ = mask_loss(points + torch.tensor([0.2, 0.0, 0.0]), batch, 0.4, 0.01, "points")
    assert float(true) < 0.2 * float(displaced)
    assert float(true) == pytest.approx(bce + 0.01 * outliers, rel=1e-4)


@pytest.mark.parametrize("weight", [0.0, 1.0])
def test_the_affinity_loss_moves_a_point_beyond_the_edge_of_the_crop_back_and_bce_does_not(
    data, weight
):
    batch = draw_batch(data, Drawing(0, 1, "view", 1), 0)
    points = torch.from_numpy(np.stack(batch.targets))
    points[0, 0] = torch.tensor([0.9, 0.0, 0.0])
    points.requires_grad_(True)
    (gradient,) = torch.autograd.grad(mask_loss(points, batch, 0.4, weight, "points")[0], points)
    stepped = points[0, 0].detach() - 0.01 * torch.sign(gradient[0, 0])
    camera = Camera(batch.K[0, 0], batch.R[0, 0], batch.t[0, 0], 64, 64)
    pixels, _ = camera.project(torch.stack([points[0, 0].detach(), stepped]).numpy().astype(float))
    before, after = np.abs(pixels - 31.5).max(1)
    assert before > 32.0
    assert (after < before - 0.1) == (weight > 0.0)


def test_each_category_is_compared_with_its_own_kernel():
    data = TrainingData([*make_objects(2), *make_objects(1, category="crate")], "boxes and a crate")
    batch = assemble(
        data, [Draw(0, 0, (1, 2)), Draw(1, 0, (1, 2)), Draw(2, 1, (0, 3))], "canonical"
    )
    points = torch.from_numpy(np.stack(batch.targets))[:, ::4]
    kernels = enumerate((0.4, 0.4, 1.5))
    alone = [
        mask_loss(points[i : i + 1], batch.select(np.array([i])), kernel, 0.5, "points")[0]
        for i, kernel in kernels
    ]
    together, bce, outliers = mask_loss_by_category(
        points, batch, 0.4, {"crate": 1.5}, 0.5, "points"
    )
    torch.testing.assert_close(together, torch.stack(alone).mean())
    assert float(together) == pytest.approx(bce + 0.5 * outliers, rel=1e-5)
    same, *_ = mask_loss_by_category(points, batch, 0.4, {}, 0.5, "points")
    torch.testing.assert_close(same, mask_loss(points, batch, 0.4, 0.5, "points")[0])


def test_lambda_drops_once_to_a_fiftieth_when_the_running_mean_stops_falling():
    schedule = AffinitySchedule(2.0, window=3)
    for step, loss in enumerate([9.0, 9.0, 9.0, 6.0, 6.0, 6.0, 5.0, 5.0, 5.0], 1):
        schedule.observe(loss, step)
        assert schedule.weight == 2.0
    for step, loss in enumerate([5.0, 5.0, 4.99, 0.0], 10):
        schedule.observe(loss, step)
    assert schedule.dropped_at == 12
    assert schedule.weight == DROP * 2.0
