"""Depth maps of scenes: by rays, with noise and holes, and in the axes of a view."""

import numpy as np
import pytest
import torch

from tso_cli.train.prior import scenes, shown, starts
from tso_cli.train.prior.bank import build_bank
from tso_cli.train.prior.depths import depth_of
from tso_cli.train.prior.masks import HALF_SIDE, SCENE_GRID
from tso_cli.train.prior.starts import draw

from .test_starts import looked_up, seen

o3d = pytest.importorskip("open3d")

BOX = np.array(
    [[x, y, z] for x in (-0.4, 0.4) for y in (-0.3, 0.3) for z in (-0.2, 0.2)], np.float32
)


@pytest.mark.parametrize("closeness", [0.0, 0.5])
def test_the_front_of_a_box_is_seen_at_its_depth(closeness):
    from scipy.spatial import ConvexHull

    faces = ConvexHull(BOX).simplices.astype(np.int32)
    depth = depth_of(BOX, faces, np.eye(3), closeness)
    middle = SCENE_GRID // 2
    assert depth[middle, middle] == pytest.approx(-0.2, abs=1e-5)
    half = 0.4 / (1.0 - 0.2 * closeness)  # of the front, as it is seen
    inside = (
        np.abs(np.arange(SCENE_GRID) + 0.5 - middle) * 2.0 * HALF_SIDE / SCENE_GRID < half - 0.02
    )
    np.testing.assert_allclose(depth[middle, inside], -0.2, atol=1e-5)
    assert np.isnan(depth[middle, :3]).all()


@pytest.fixture
def of_maps(shapes, monkeypatch):
    """A batch whose scenes all have maps, metric or not."""

    def make(**shares):
        none = (
            "SHIFTED_SHARE", "STREWN_CHANCE", "PLANE_SHARE", "CAMERA_SHARE", "UNRELATED_SHARE",
            "NOISY_SHARE", "HOLES_SHARE", "FITTED_SHARE",
        )  # fmt: skip
        for name in none:
            module = starts if hasattr(starts, name) else shown
            monkeypatch.setattr(module, name, shares.get(name, 0.0))
        monkeypatch.setattr(shown, "DEPTH_SHARE", 1.0)
        bank = build_bank(shapes, 12, 1, chances=scenes.Chances(marred=0.0, depth_maps=1.0))
        return draw(bank, np.random.default_rng(0), 24)

    return make


def front_errors(batch):
    """How far the points of the truth lie behind the maps where they are seen: 0 in front."""
    z = (batch.target[:, None] @ batch.rotation.mT)[..., 2]
    behind = z - looked_up(batch.depth, seen(batch.target, batch))
    return behind[~behind.isnan()]


def test_no_point_of_the_truth_lies_before_its_depth_map(of_maps):
    batch = of_maps()
    assert (batch.metric == 1.0).all()
    behind = front_errors(batch)
    # The nearest cell of a map is up to half a cell from the place of a point.
    assert (behind > -0.1).float().mean() > 0.97
    assert (behind.abs() < 0.03).float().mean() > 0.25


def test_maps_that_are_to_be_fitted_and_maps_with_holes_have_their_shares(of_maps):
    batch = of_maps(FITTED_SHARE=1.0, HOLES_SHARE=1.0)
    assert (batch.metric == 0.0).all()
    holes, whole = (of.depth.isnan().float().mean() for of in (batch, of_maps()))
    assert holes > whole + 0.02


def test_noise_of_the_relief_is_smooth(of_maps):
    noise = of_maps(NOISY_SHARE=1.0).depth - of_maps().depth
    steps = (noise[..., 1:] - noise[..., :-1]).nan_to_num()
    assert 1e-3 < noise.nan_to_num().std() < 0.1
    assert steps.std() < 1.5 * noise.nan_to_num().std()


def test_a_scene_without_depth_maps_has_none(shapes):
    bank = build_bank(shapes, 3, 0, chances=scenes.Chances(depth_maps=0.0))
    batch = draw(bank, np.random.default_rng(0), 4)
    assert batch.depth.isnan().all()
    assert not torch.any(batch.metric)
