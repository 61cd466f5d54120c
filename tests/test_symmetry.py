"""Mirror planes: which clouds have one, and what the mirror image shows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tso_cli.errors import InputError
from tso_cli.files.cameras import read_camera
from tso_cli.files.clouds import read_cloud
from tso_cli.files.images import read_mask
from tso_cli.projection import silhouette_of
from tso_cli.refinement import RefineConfig, refine
from tso_cli.scene import View
from tso_cli.symmetry import MirrorPlane, find_mirror_plane

EXAMPLES = Path(__file__).parents[1] / "examples"


def _cloud(name: str) -> np.ndarray:
    return read_cloud(EXAMPLES / name / "initial.ply").points


def _rotation(seed: int) -> np.ndarray:
    matrix = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return matrix * np.sign(np.linalg.det(matrix))


@pytest.mark.parametrize("name", ["chair", "airplane", "car"])
def test_the_plane_of_a_symmetric_object_is_found_however_it_is_turned(name):
    points = _cloud(name)
    plane = find_mirror_plane(points)
    assert plane.symmetric
    turn = _rotation(3)
    turned = find_mirror_plane(points @ turn.T + 5.0)
    assert turned.symmetric
    assert abs(turned.normal @ (turn @ plane.normal)) > np.cos(np.radians(1.0))


def test_a_chair_with_one_arm_has_no_plane():
    chair = _cloud("chair")
    normal = find_mirror_plane(chair).normal
    side = (chair - chair.mean(0)) @ normal
    upper = chair[:, 1] > np.quantile(chair[:, 1], 0.6)
    lopsided = chair[~(upper & (side > 0.0))]
    assert not find_mirror_plane(lopsided).symmetric


def test_the_plane_of_a_large_cloud_is_found_whatever_the_order_of_its_points():
    rng = np.random.default_rng(0)
    body = np.repeat(_cloud("chair"), 40, axis=0) + rng.normal(scale=2e-3, size=(40 * 1024, 3))
    for axis in range(3):
        assert find_mirror_plane(body[body[:, axis].argsort()]).symmetric


def test_a_random_heap_of_points_has_no_plane():
    assert not find_mirror_plane(np.random.default_rng(0).normal(size=(300, 3)) ** 3).symmetric


@pytest.mark.parametrize("count", [1, 2, 3])
def test_too_few_points_have_no_plane(count):
    assert not find_mirror_plane(np.eye(3)[:count]).symmetric


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000), st.floats(-2.0, 2.0))
def test_reflecting_twice_changes_nothing_and_points_of_the_plane_stay(seed, offset):
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=3)
    plane = MirrorPlane(normal / np.linalg.norm(normal), offset)
    points = rng.normal(size=(5, 3))
    image = plane.reflect(points)
    np.testing.assert_allclose(plane.reflect(image), points, atol=1e-9)
    middle = (points + image) / 2.0
    np.testing.assert_allclose(middle @ plane.normal, offset, atol=1e-9)


def test_the_flipped_picture_is_what_its_camera_sees_of_the_mirror_image():
    points = _cloud("chair")
    mask = read_mask(EXAMPLES / "chair" / "mask.png")
    camera = read_camera(EXAMPLES / "chair" / "camera.json", mask.shape[1], mask.shape[0])
    normal = np.array([0.6, 0.0, 0.8])
    plane = MirrorPlane(normal, 0.05)
    view = plane.view(View(silhouette_of(points, camera), camera))
    np.testing.assert_allclose(silhouette_of(plane.reflect(points), view.camera), view.mask, atol=1e-4)


def test_a_plane_asked_for_is_used_and_told():
    points = _cloud("chair")
    mask = read_mask(EXAMPLES / "chair" / "mask.png")
    camera = read_camera(EXAMPLES / "chair" / "camera.json", mask.shape[1], mask.shape[0])
    told = {}
    for symmetry in ("none", "x", "2,0,0,0.1"):
        result = refine(points, mask, camera, RefineConfig(steps=0, symmetry=symmetry))
        told[symmetry] = result.symmetry
    middle = (points[:, 0].min() + points[:, 0].max()) / 2.0
    assert told == {"none": None, "x": pytest.approx((1, 0, 0, middle)), "2,0,0,0.1": pytest.approx((1, 0, 0, 0.05))}


@pytest.mark.parametrize("bad", ["w", "1,0,0", "0,0,0,1", "1,a,0,0", "nan,0,0,0"])
def test_a_plane_that_is_none_is_refused(bad):
    with pytest.raises(InputError, match="symmetry is"):
        RefineConfig(symmetry=bad)
