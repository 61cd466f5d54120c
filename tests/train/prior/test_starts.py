"""Batches: starts, and the scenes that they belong to."""

from dataclasses import fields

import numpy as np
import pytest
import torch

from tso_cli.prior.network import TROUBLES
from tso_cli.train.prior import scenes, shown, starts
from tso_cli.train.prior.bank import build_bank
from tso_cli.train.prior.masks import HALF_SIDE, SCENE_GRID
from tso_cli.train.prior.shapes import POINTS
from tso_cli.train.prior.starts import draw, mirrored


@pytest.fixture
def plain(monkeypatch):
    """Only the kinds of start differ: no noise, no other frame, no points that belong nowhere."""
    none = (
        "SHIFTED_SHARE", "STREWN_CHANCE", "DISTANCE_NOISE", "PLANE_SHARE", "UNEVEN_SHARE",
        "CAMERA_SHARE", "UNRELATED_SHARE", "TURNED_SHARE", "ANY_SHARE", "DEPTH_SHARE",
    )  # fmt: skip
    for name in none:
        monkeypatch.setattr(starts if hasattr(starts, name) else shown, name, 0.0)
    monkeypatch.setattr(starts, "ALL_POINTS_CHANCE", 1.0)


def only(monkeypatch, right, near):
    monkeypatch.setattr(starts, "RIGHT_SHARE", right)
    monkeypatch.setattr(starts, "NEAR_SHARE", near)


def chamfer(first, second):
    """Squared Chamfer distances [B], both ways."""
    squared = torch.cdist(first, second).square()
    return squared.amin(1).mean(1) + squared.amin(2).mean(1)


def looked_up(maps, w):
    """Maps [B, V, S, S] at image coordinates w [B, V, N, 2], by the nearest cell."""
    place = ((w / HALF_SIDE + 1.0) / 2.0 * SCENE_GRID).floor().long().clamp(0, SCENE_GRID - 1)
    return maps.flatten(2).gather(2, place[..., 1] * SCENE_GRID + place[..., 0])


def seen(points, batch):
    """Image coordinates [B, V, N, 2] of points [B, N, 3]."""
    turned = points[:, None] @ batch.rotation.mT
    return turned[..., :2] / (1.0 + batch.closeness[..., None, None] * turned[..., 2:])


def test_a_batch_has_the_shapes_that_it_states(bank):
    batch = draw(bank, np.random.default_rng(0), 16)
    points = batch.start.shape[1]
    shapes = {
        "start": (16, points, 3), "target": (16, POINTS, 3), "counterpart": (16, points, 3),
        "foreign_points": (16, points),
        "rotation": (16, 2, 3, 3), "shift": (16, 2, 2), "troubles": (16, 2, len(TROUBLES)),
        **dict.fromkeys(("closeness", "zoom", "metric", "size"), (16, 2)),
        **dict.fromkeys(
            ("distance", "known", "foreign", "hidden", "depth"), (16, 2, SCENE_GRID, SCENE_GRID)
        ),
    }  # fmt: skip
    assert {
        field.name: tuple(getattr(batch, field.name).shape) for field in fields(batch)
    } == shapes
    assert {getattr(batch, name).dtype for name in shapes} == {torch.float32}


def test_the_same_seed_gives_the_same_batch(shapes, bank):
    again = build_bank(shapes, 60, seed=0)
    other = draw(bank, np.random.default_rng([0, 2]), 8)
    first, second = (draw(each, np.random.default_rng([0, 1]), 8) for each in (bank, again))
    for field in fields(first):
        values = [getattr(batch, field.name) for batch in (first, second)]
        torch.testing.assert_close(*values, rtol=0.0, atol=0.0, equal_nan=True)
    assert not torch.equal(first.target, other.target)


def test_a_scene_does_not_depend_on_how_many_there_are(shapes, bank):
    few = build_bank(shapes, 3, seed=0)
    assert torch.equal(few.truths, bank.truths[:3])
    assert torch.equal(few.distance, bank.distance[:3])


def test_a_right_start_lies_on_its_target(bank, monkeypatch, plain):
    only(monkeypatch, right=1.0, near=0.0)
    batch = draw(bank, np.random.default_rng(0), 32)
    assert torch.equal(batch.start, batch.counterpart)
    # Two samplings of a surface are about as far apart as their points.
    assert (chamfer(batch.start, batch.target) < 2e-3).all()


def test_a_near_start_moves_to_its_target_along_its_counterparts(bank, monkeypatch, plain):
    only(monkeypatch, right=0.0, near=1.0)
    batch = draw(bank, np.random.default_rng(0), 32)
    before, after = (chamfer(points, batch.target) for points in (batch.start, batch.counterpart))
    assert (after < 2e-3).all()
    assert before.mean() > 1.2 * after.mean()
    # A small deformation.
    assert (batch.start - batch.counterpart).norm(dim=2).mean() < 0.1


def test_another_shape_has_no_counterparts_and_is_normalised_mostly(bank, monkeypatch, plain):
    only(monkeypatch, right=0.0, near=0.0)
    batch = draw(bank, np.random.default_rng(0), 64)
    assert batch.counterpart.isnan().all()
    sides = (batch.start.amax(1) - batch.start.amin(1)).amax(1)
    assert (torch.isclose(sides, torch.ones(()), atol=1e-5)).float().mean() > 0.7
    assert chamfer(batch.start, batch.target).median() > 4e-3


def test_starts_are_of_the_category_but_of_another_type(shapes, bank):
    kept = shapes.shapes
    truths = np.arange(len(kept)).repeat(20)
    others = starts._draw_others(bank, truths, np.random.default_rng(0))
    pairs = [(kept[truth], kept[other]) for truth, other in zip(truths, others, strict=True)]
    assert all(truth.category == other.category for truth, other in pairs)
    assert all(truth.kind != other.kind for truth, other in pairs)


def test_kinds_of_start_have_their_shares(bank, plain):
    known = np.concatenate([
        (~draw(bank, np.random.default_rng(seed), 64).counterpart.isnan().any(2).any(1)).numpy()
        for seed in range(6)
    ])  # fmt: skip
    share = starts.RIGHT_SHARE + starts.NEAR_SHARE
    assert known.mean() == pytest.approx(share, abs=0.08)


def test_rows_are_in_random_order(bank, monkeypatch, plain):
    only(monkeypatch, right=1.0, near=0.0)
    batch = draw(bank, np.random.default_rng(0), 8)
    # In the order of farthest-point sampling the first points are far apart.
    few = batch.start[:, :32]
    nearest = torch.cdist(few, few).add(torch.eye(32)).amin(2)
    spread = batch.target[:, :32]
    nearest_spread = torch.cdist(spread, spread).add(torch.eye(32)).amin(2)
    assert nearest.mean() < 0.7 * nearest_spread.mean()


def test_few_points_are_spread_evenly_too(bank, monkeypatch, plain):
    only(monkeypatch, right=1.0, near=0.0)
    monkeypatch.setattr(starts, "ALL_POINTS_CHANCE", 0.0)
    batch = draw(bank, np.random.default_rng(0), 8)
    assert starts.LEAST_POINTS <= batch.start.shape[1] < POINTS
    assert torch.cdist(batch.target, batch.start).amin(2).max() < 0.2


def test_the_target_is_seen_inside_its_masks(bank, plain):
    batch = draw(bank, np.random.default_rng(0), 64)
    w = seen(batch.target, batch)
    inside = looked_up(batch.distance, w) < 1.5 * HALF_SIDE * 2.0 / 40
    right = (
        batch.troubles[..., [TROUBLES.index(name) for name in ("hidden", "outline")]].sum(2) == 0
    )
    known = (looked_up(batch.known, w) == 1.0) & right[..., None]
    assert inside[known].float().mean() > 0.99
    # The mask is no larger than the object: its cells have a target's point near them.
    centres = ((torch.arange(SCENE_GRID) + 0.5) / SCENE_GRID * 2.0 - 1.0) * HALF_SIDE
    cells = torch.stack(torch.meshgrid(centres, centres, indexing="xy"), -1).reshape(-1, 2)
    own = (batch.known == 1.0) & (batch.foreign == 0.0) & right[..., None, None]
    foreground = ((batch.distance < -0.02) & own).flatten(2)
    distance = torch.cdist(cells.expand(64, 2, -1, -1), w).amin(3)
    assert (distance[foreground] < 0.1).float().mean() > 0.99


def test_a_mirrored_scene_is_seen_mirrored(bank, plain):
    batch = draw(bank, np.random.default_rng(0), 16)
    image = mirrored(batch, torch.ones(16, dtype=torch.bool))
    torch.testing.assert_close(
        seen(image.target, image), seen(batch.target, batch) * torch.tensor([-1.0, 1.0])
    )
    assert torch.equal(image.distance, batch.distance.flip(-1))
    torch.testing.assert_close(
        image.rotation @ image.rotation.mT, torch.eye(3).expand(16, 2, -1, -1)
    )
    np.testing.assert_allclose(torch.linalg.det(image.rotation), 1.0, atol=1e-5)
    same = mirrored(batch, torch.zeros(16, dtype=torch.bool))
    assert torch.equal(same.start, batch.start)


def test_a_truncated_picture_knows_nothing_beyond_its_border(shapes, monkeypatch, plain):
    monkeypatch.setattr(scenes, "TRUNCATED_CHANCE", 1.0)
    batch = draw(build_bank(shapes, 12, seed=1), np.random.default_rng(0), 32)
    whole = (batch.known == 1.0).flatten(2).all(2)
    assert (whole.sum(1) == 1).all()
    truncated = batch.known[~whole]
    rows, columns = truncated.amax(2), truncated.amax(1)
    assert torch.equal(truncated, rows[:, :, None] * columns[:, None, :])
    # A part of the object lies beyond the border.
    beyond = looked_up(batch.known, seen(batch.target, batch)) == 0.0
    assert beyond[~whole].any(1).float().mean() > 0.9
    assert not beyond[whole].any()


def test_points_that_belong_nowhere_have_no_counterpart(bank, monkeypatch, plain):
    only(monkeypatch, right=1.0, near=0.0)
    monkeypatch.setattr(starts, "STREWN_CHANCE", 1.0)
    batch = draw(bank, np.random.default_rng(0), 16)
    nowhere = batch.counterpart.isnan().any(2)
    points = batch.start.shape[1]
    assert 1 <= nowhere.sum(1).min() <= 5
    assert 0.04 * points < nowhere.sum(1).max() <= np.ceil(starts.MOST_STREWN * points)
    assert torch.equal(batch.start[~nowhere], batch.counterpart[~nowhere])
    assert batch.start.abs().max() <= starts.STREWN_BOX / 2.0


def test_a_frame_that_is_off_keeps_the_counterparts(bank, monkeypatch, plain):
    only(monkeypatch, right=1.0, near=0.0)
    monkeypatch.setattr(starts, "SHIFTED_SHARE", 1.0)
    batch = draw(bank, np.random.default_rng(0), 16)
    assert (chamfer(batch.counterpart, batch.target) < 2e-3).all()
    assert not torch.equal(batch.start, batch.counterpart)
    # Scale and offset alone.
    moved = [points - points.mean(1, keepdim=True) for points in (batch.start, batch.counterpart)]
    ratio = moved[0].norm(dim=(1, 2)) / moved[1].norm(dim=(1, 2))
    torch.testing.assert_close(moved[0], moved[1] * ratio[:, None, None], atol=1e-5, rtol=1e-4)


def test_noise_makes_an_outline_wider_or_narrower(bank, monkeypatch, plain):
    clean = draw(bank, np.random.default_rng(0), 8)
    monkeypatch.setattr(shown, "DISTANCE_NOISE", 0.002)
    difference = (draw(bank, np.random.default_rng(0), 8).distance - clean.distance).flatten(2)
    torch.testing.assert_close(
        difference, difference[..., :1].expand_as(difference), atol=1e-6, rtol=0.0
    )
    assert 5e-4 < difference.std() < 4e-3


@pytest.mark.slow
def test_a_batch_is_drawn_quickly(bank):
    import time

    draw(bank, np.random.default_rng(0), 64)
    begin = time.perf_counter()
    for seed in range(5):
        draw(bank, np.random.default_rng(seed), 64)
    # It takes 30 ms on one thread; a loaded machine is slower.
    assert time.perf_counter() - begin < 5 * 0.3


@pytest.mark.slow
def test_the_number_of_processes_does_not_change_the_scenes(shapes):
    alone, shared = (build_bank(shapes, 30, 0, processes=count) for count in (1, 2))
    for name in ("truths", "rotation", "distance", "foreign", "depth", "size"):
        torch.testing.assert_close(
            getattr(alone, name), getattr(shared, name), rtol=0.0, atol=0.0, equal_nan=True
        )
