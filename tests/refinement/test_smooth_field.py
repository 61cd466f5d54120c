"""Smooth displacement fields, averages and areas."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from tso_cli.refinement.smooth_field import FIELD_NODES, SmoothField


def _cloud(count: int, seed: int = 0) -> torch.Tensor:
    return torch.tensor(np.random.default_rng(seed).uniform(-0.5, 0.5, (1, count, 3)))


def _moved(field: SmoothField, weight: float, values: torch.Tensor) -> torch.Tensor:
    return field.displacement(field.smoother(weight), values)


def test_a_translation_is_not_smoothed():
    for count in (5, 200, FIELD_NODES + 500):
        field = SmoothField(_cloud(count))
        translation = torch.tensor([0.1, -0.2, 0.3], dtype=torch.float64).expand(field.shape)
        torch.testing.assert_close(
            _moved(field, 10.0, translation), translation[:, :1].expand(1, count, 3), rtol=1e-9, atol=1e-12
        )


def test_a_larger_lambda_moves_a_larger_neighbourhood():
    points = _cloud(400)
    field = SmoothField(points)
    values = torch.zeros(field.shape, dtype=torch.float64)
    values[0, 0] = 1.0
    distance = (points[0] - points[0, 0]).norm(dim=1)
    mean_distances = []
    for weight in (1.0, 100.0):
        moved = _moved(field, weight, values)[0, :, 0]
        assert moved[0] == moved.max()
        assert moved[distance < 0.2].mean() > 1.5 * moved[distance > 0.6].mean() > 0.0
        mean_distances.append((moved * distance).sum() / moved.sum())
    assert mean_distances[1] > 1.3 * mean_distances[0]


def test_unconnected_parts_move_independently():
    left, right = _cloud(60), _cloud(60, 1) + 100.0
    field = SmoothField(torch.cat([left, right], 1))
    values = torch.zeros(field.shape, dtype=torch.float64)
    values[0, :60] = 1.0
    moved = _moved(field, 10.0, values)
    assert moved[0, 60:].abs().max() == 0.0


@pytest.mark.parametrize("nodes", [FIELD_NODES, 64])
def test_padding_changes_neither_displacements_nor_areas(nodes):
    small, large = _cloud(40), _cloud(90, 1)
    counts = torch.tensor([40, 90])
    padded = torch.cat([torch.cat([small, torch.zeros(1, 50, 3, dtype=torch.float64)], 1), large])
    both = SmoothField(padded, counts, nodes)
    values = torch.randn(both.shape, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    moved, areas = _moved(both, 5.0, values), both.areas(padded, counts)
    for number, cloud in enumerate((small, large)):
        alone, count = SmoothField(cloud, nodes=nodes), cloud.shape[1]
        torch.testing.assert_close(moved[number : number + 1, :count], _moved(alone, 5.0, values[number : number + 1, :count]))
        torch.testing.assert_close(areas[number : number + 1, :count], alone.areas(cloud, counts[number : number + 1]))


@pytest.mark.parametrize("count", [300, FIELD_NODES + 500])
def test_averages_spread_a_peak_to_its_neighbours_and_keep_a_constant(count):
    cloud = _cloud(count)
    field, ones = SmoothField(cloud), torch.ones(1, count, dtype=torch.float64)
    torch.testing.assert_close(field.averaged(ones, 1.0), ones)
    order = (cloud[0] - cloud[0, 0]).norm(dim=1).argsort()
    peak = torch.zeros_like(ones)
    peak[0, order[:10]] = 1.0
    around = field.averaged(peak, 1.0)[0]
    assert around[order[:10]].mean() > 0.2
    assert around[order[count // 2 :]].max() < 0.01


def test_points_of_a_large_cloud_follow_their_nodes():
    points = _cloud(5000)
    field = SmoothField(points)
    assert field.shape == (1, FIELD_NODES, 3)
    values = torch.zeros(field.shape, dtype=torch.float64)
    values[0, 0] = 1.0
    moved = _moved(field, 10.0, values)[0, :, 0]
    order = (points[0] - points[0, moved.argmax()]).norm(dim=1).argsort()
    assert moved[order[:50]].mean() > 5.0 * moved[order[2500:]].mean()


def test_the_area_of_a_point_is_the_square_of_its_spacing():
    flat = np.stack(np.meshgrid(np.linspace(0.0, 1.0, 12), np.linspace(0.0, 1.0, 12), [0.0]), -1).reshape(-1, 3)
    cloud = torch.tensor(np.concatenate([flat, 0.5 * flat + [3.0, 0.0, 0.0]]))[None]
    areas = SmoothField(cloud).areas(cloud, torch.tensor([288]))[0]
    torch.testing.assert_close(areas[:144] / areas[144:], torch.full((144,), 4.0, dtype=torch.float64), rtol=1e-6, atol=0)
    assert areas.mean() == pytest.approx(1.0)


def test_points_share_the_area_of_their_node():
    rng = np.random.default_rng(0)
    flat = np.concatenate([rng.uniform(size=(6000, 3)), rng.uniform(size=(2000, 3)) + [1.0, 0.0, 0.0]]) * [1.0, 1.0, 0.0]
    cloud = torch.tensor(flat)[None]
    areas = SmoothField(cloud).areas(cloud, torch.tensor([8000]))[0]
    assert areas[6000:].mean() / areas[:6000].mean() == pytest.approx(3.0, rel=0.15)


def test_the_gradient_is_that_of_finite_differences():
    field = SmoothField(_cloud(FIELD_NODES + 20))
    smoother = field.smoother(3.0)
    padding = torch.zeros(field.shape, dtype=torch.float64)

    def displacements(values: torch.Tensor) -> torch.Tensor:
        return field.displacement(smoother, torch.cat([values, padding[:, values.shape[1] :]], 1))[:, :30]

    assert torch.autograd.gradcheck(displacements, torch.randn(1, 4, 3, dtype=torch.float64, requires_grad=True))


@pytest.mark.parametrize("count", [1, 2, 3])
def test_tiny_clouds_and_coinciding_points_have_fields(count):
    for points in (_cloud(count), torch.zeros(1, count, 3, dtype=torch.float64)):
        assert torch.isfinite(_moved(SmoothField(points), 10.0, torch.ones(1, count, 3, dtype=torch.float64))).all()
