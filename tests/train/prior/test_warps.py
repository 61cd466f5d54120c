"""Smooth random deformations."""

import numpy as np
import pytest
import torch

from tso_cli.train.prior.warps import SIDE, draw_lattices, warped

SIZES = np.array([[1.0, 0.5, 0.8]], np.float32)


def unit_box(count):
    return -torch.ones(count, 3) / 2.0, torch.ones(count, 3) / 2.0


def test_a_lattice_without_displacements_moves_nothing():
    points = torch.rand(2, 50, 3) - 0.5
    assert torch.equal(warped(points, *unit_box(2), torch.zeros(2, SIDE**3, 3)), points)


def test_a_linear_displacement_of_the_nodes_is_linear_in_space():
    along = np.linspace(-0.5, 0.5, SIDE)
    nodes = np.stack(np.meshgrid(along, along, along, indexing="ij"), -1).reshape(1, -1, 3)
    matrix = torch.tensor([[0.1, 0.2, 0.0], [0.0, -0.1, 0.3], [0.05, 0.0, 0.2]])
    points = torch.rand(1, 50, 3) - 0.5
    moved = warped(points, *unit_box(1), torch.tensor(nodes, dtype=torch.float32) @ matrix)
    torch.testing.assert_close(moved, points + points @ matrix)


def test_a_flat_box_is_warped_without_a_division_by_zero():
    low, high = torch.tensor([[-0.5, 0.0, -0.5]]), torch.tensor([[0.5, 0.0, 0.5]])
    lattice = torch.tensor(draw_lattices(np.random.default_rng(0), SIZES, np.array([0])))
    points = (torch.rand(1, 50, 3) - 0.5) * torch.tensor([1.0, 0.0, 1.0])
    assert warped(points, low, high, lattice).isfinite().all()


@pytest.mark.parametrize("axis", [0, 2])
def test_four_of_five_deformations_keep_a_mirror_plane(axis):
    count = 200
    rng = np.random.default_rng(0)
    lattices = draw_lattices(rng, SIZES.repeat(count, 0), np.full(count, axis))
    flip = torch.where(torch.arange(3) == axis, -1.0, 1.0)
    points = (torch.rand(1, 20, 3) - 0.5).expand(count, -1, -1)
    moved = warped(points, *unit_box(count), torch.tensor(lattices))
    image = warped(points * flip, *unit_box(count), torch.tensor(lattices)) * flip
    symmetric = torch.isclose(moved, image, atol=1e-5).all(2).all(1)
    assert symmetric.float().mean() == pytest.approx(0.8, abs=0.08)


def test_a_weak_deformation_is_small():
    rows = SIZES.repeat(100, 0), np.zeros(100, np.int64)
    weak = draw_lattices(np.random.default_rng(0), *rows, strength=(0.05, 0.1))
    strong = draw_lattices(np.random.default_rng(0), *rows)
    assert np.abs(weak).mean() < 0.2 * np.abs(strong).mean()
