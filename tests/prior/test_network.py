"""Features and network of the learned prior: one text for numpy and torch."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from tests.prior.common import discs, some_weights
from tso_cli.prior.backend import NUMPY
from tso_cli.prior.features import (
    FAR_DEPTH,
    HALF,
    MAPS,
    OF_NODE,
    OF_VIEW,
    Sight,
    bernstein,
    features,
)
from tso_cli.prior.network import fused, initial, predict, shapes
from tso_cli.prior.torch_backend import TORCH, nearest_few_in_rows


def in_torch(sight):
    return Sight(**{name: torch.from_numpy(value) for name, value in vars(sight).items()})


def answers_of(weights, given, backend=NUMPY):
    return list(vars(predict(backend, weights, given)).values())


def test_numpy_and_torch_see_the_same_and_answer_the_same():
    cloud, sight = discs()
    weights = some_weights()
    given = features(NUMPY, cloud, 128, sight)
    same = features(TORCH, torch.from_numpy(cloud), 128, in_torch(sight))
    for name, array in vars(given).items():
        np.testing.assert_allclose(getattr(same, name).numpy(), array, atol=1e-12, err_msg=name)
    assert given.maps.shape[1] == MAPS
    assert given.nodes.shape[2] == OF_NODE
    assert given.view.shape[1] == OF_VIEW
    answers = answers_of(weights, given)
    of_torch = {name: torch.from_numpy(array) for name, array in weights.items()}
    for answer, other in zip(answers, answers_of(of_torch, same, TORCH), strict=True):
        np.testing.assert_allclose(other.numpy(), answer, atol=1e-10)
        assert np.abs(answer).max() > 0.01


def test_the_gradients_of_the_network_are_those_of_finite_differences():
    cloud, sight = discs(1, 64, 40)
    given = features(TORCH, torch.from_numpy(cloud), 8, in_torch(sight))
    weights = {name: torch.from_numpy(array) for name, array in some_weights().items()}

    def answer(*changed):
        answers = answers_of({**weights, **dict(zip(names, changed, strict=True))}, given, TORCH)
        return torch.cat([one[:, :2].flatten() for one in answers])

    names = ["map1.offset", "map3b.offset", "view2.offset", "node1.offset", "moved.offset"]
    names += ["cells1.offset", "troubles.offset"]
    chosen = [weights[name].clone().requires_grad_() for name in names]
    # In a random direction of all weights: one for each weight would take minutes.
    assert torch.autograd.gradcheck(answer, chosen, fast_mode=True)


def test_a_new_network_moves_nothing():
    cloud, sight = discs()
    weights = {name: array.astype(float) for name, array in initial(0).items()}
    assert {name: array.shape for name, array in weights.items()} == shapes()
    assert not any(
        answer.any() for answer in answers_of(weights, features(NUMPY, cloud, 128, sight))
    )


def test_a_disc_that_is_larger_than_the_cloud_pulls_outward():
    """The last features of a node: how the mask pulls the points that belong to it."""
    rng = np.random.default_rng(0)
    cloud = rng.normal(size=(1, 400, 3))
    cloud *= 0.2 * rng.uniform(0.2, 1.0, (1, 400, 1)) / np.linalg.norm(cloud, axis=2, keepdims=True)
    _, sight = discs(1)
    angles = np.linspace(0.0, 2.0 * np.pi, 60)
    ring = 0.45 * np.stack([np.cos(angles), np.sin(angles)], 1)[None]
    sight = replace(sight, cells=ring, counted=np.ones((1, 60)))
    given = features(NUMPY, cloud, 100, sight)
    pull, cloud = given.nodes[0, :, 11:13], cloud[0, :100]
    pulled = np.linalg.norm(pull, axis=1) > 1.0
    assert pulled.sum() > 10
    outward = (pull * cloud[:, :2]).sum(1)[pulled]
    assert (outward > 0.0).all()
    # Cells that are covered pull nothing.
    covered = cloud[None, :, :2]
    sight = replace(sight, closeness=np.zeros(1), cells=covered, counted=np.ones(covered.shape[:2]))
    flat = features(NUMPY, cloud[None], 100, sight)
    assert np.abs(flat.nodes[0, :, 11:14]).max() < 1e-6


def test_what_is_seen_beyond_the_maps_is_in_no_map():
    cloud, sight = discs(1)
    far = cloud.copy()
    far[:, 0] = [5.0 * HALF, 0.0, 0.0]
    maps = features(NUMPY, far, 128, sight).maps
    without = features(NUMPY, far[:, 1:], 128, sight).maps
    np.testing.assert_allclose(maps, without)


@pytest.mark.parametrize("depth", [0.0, -1.0])
def test_a_point_at_the_plane_of_the_camera_or_behind_it_is_in_no_map(depth):
    cloud, sight = discs(1)
    behind = cloud.copy()
    behind[0, -1] = [0.1, 0.0, (depth - 1.0) / sight.closeness[0]]
    given = features(NUMPY, behind, 128, sight)
    without = features(NUMPY, behind[:, :-1], 128, sight)
    np.testing.assert_allclose(given.maps, without.maps)
    assert all(np.isfinite(answer).all() for answer in answers_of(some_weights(), given))


def test_the_lattice_is_a_partition_of_unity():
    t = np.random.default_rng(0).uniform(0.0, 1.0, (1, 50, 3))
    np.testing.assert_allclose(bernstein(NUMPY, t).sum(2), 1.0)


def test_views_at_right_angles_say_each_what_it_sees():
    """Each is unsure of its own depth, so the other decides there."""
    rotations = np.stack([np.eye(3), [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]])[None]
    truth = np.array([0.1, 0.2, 0.3])
    displacements = (rotations @ truth)[:, :, None].copy()
    displacements[..., 2] = 7.0
    log_weights = np.broadcast_to([0.0, 0.0, -30.0], displacements.shape)
    found = fused(NUMPY, displacements, log_weights, rotations)
    np.testing.assert_allclose(found[0, 0], truth, atol=1e-6)
    alone = fused(NUMPY, displacements[:, :1], log_weights[:, :1], rotations[:, :1])
    np.testing.assert_allclose(alone[0, 0], [0.1, 0.2, 7.0])


def test_a_surface_before_a_point_is_seen_at_its_node():
    """How far the depth map lies behind it, and whether there is one."""
    cloud, sight = discs(1)
    given = features(NUMPY, cloud, 128, sight)
    behind, measured = given.nodes[0, :, 16], given.nodes[0, :, 17]
    right = given.places[0, :, 0] > 0.1
    np.testing.assert_allclose(measured[right], 1.0)
    expected = 5.0 * np.clip(0.1 - cloud[0, :128, 2], -FAR_DEPTH, FAR_DEPTH)
    np.testing.assert_allclose(behind[right], expected[right], atol=1e-9)
    assert not behind[given.places[0, :, 0] < -0.1].any()


def test_a_node_says_how_far_it_lies_behind_the_front_of_the_cloud():
    """Of two walls, the nearer one is the front."""
    x, y = np.random.default_rng(0).uniform(-0.4, 0.4, (2, 512))
    z = np.where(np.arange(512) % 2, 0.1, -0.1)
    given = features(NUMPY, np.stack([x, y, z], -1)[None], 128, discs(1)[1])
    np.testing.assert_allclose(given.nodes[0, ::2, 18], 0.0, atol=1e-9)
    assert np.median(given.nodes[0, 1::2, 18]) == pytest.approx(5.0 * 0.2)


def test_the_surface_of_a_depth_map_pulls_the_nodes_before_it():
    """A wall at z = .1 pulls a wall at z = .05 by .05 along z; the pull is 12 of it."""
    x, y = np.random.default_rng(0).uniform(-0.5, 0.5, (2, 512))
    sight = replace(discs(1)[1], closeness=np.zeros(1))
    cloud = np.stack([x, y, np.full(512, 0.05)], -1)[None]
    given = features(NUMPY, cloud, 128, sight)
    pull, count = given.nodes[0, :, 19:22], given.nodes[0, :, 23]
    pulled = count > 0.3
    assert pulled.sum() > 30
    assert (given.places[0, pulled, 0] > -0.25).all()
    share = np.expm1(count) / 0.5
    expected = 12.0 * 0.05 * share / (share + 0.3)
    np.testing.assert_allclose(pull[pulled, 2], expected[pulled], atol=1e-9)
    without = features(NUMPY, cloud, 128, replace(sight, measured=0.0 * sight.measured))
    assert not without.nodes[0, :, 19:24].any()


@pytest.mark.parametrize("name", ["dilated", "sampled", "convolved", "nearest", "sums", "largest"])
def test_each_operation_is_the_same_in_numpy_and_torch(name):
    rng = np.random.default_rng(1)
    maps, places = rng.normal(size=(2, 3, 9, 9)), rng.uniform(-1.3, 1.3, (2, 20, 2))
    index, values = rng.integers(0, 7, (2, 20)), rng.normal(size=(2, 20, 4))
    arguments = {
        "dilated": (maps,),
        "sampled": (maps, places),
        "convolved": (maps, rng.normal(size=(5, 3, 3, 3)), rng.normal(size=5), 2),
        "nearest": (places, rng.normal(size=(2, 30, 2))),
        "sums": (index, values, 8),
        "largest": (index, values[..., 0], 8, -1.5),
    }[name]
    tensors = [torch.from_numpy(a) if isinstance(a, np.ndarray) else a for a in arguments]
    other = getattr(TORCH, name)(*tensors).numpy()
    np.testing.assert_allclose(getattr(NUMPY, name)(*arguments), other, atol=1e-12)


def test_bilinear_samples_are_the_linear_function_that_maps_hold():
    """Of maps of [-1, 1]^2 with a cell of 2 / 8."""
    centres = (np.arange(8) + 0.5) / 4.0 - 1.0
    maps = (2.0 * centres[None, :] + 3.0 * centres[:, None])[None, None]
    places = np.random.default_rng(2).uniform(-0.8, 0.8, (1, 30, 2))
    found = NUMPY.sampled(maps, places)[..., 0]
    np.testing.assert_allclose(found, places @ [2.0, 3.0])


def test_the_nearest_few_in_single_precision_are_those_of_all_pairs():
    generator = torch.Generator().manual_seed(3)
    queries, data = (torch.rand(5, count, 3, generator=generator) for count in (40, 70))
    near = nearest_few_in_rows(queries, data, 4)
    distances = torch.cdist(queries, data)
    expected = distances.topk(4, largest=False).values
    torch.testing.assert_close(distances.gather(2, near), expected, rtol=2e-4, atol=1e-6)
    assert (near.sort(2).values.diff(dim=2) > 0).all()
    assert torch.equal(TORCH.nearest(queries, data), near[..., 0])
