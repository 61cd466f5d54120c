"""Mirror planes: which clouds have one, and what the mirror image shows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tso_cli.errors import InputError
from tso_cli.geometry.camera import Camera
from tso_cli.geometry.view import View
from tso_cli.io.cameras import read_camera
from tso_cli.io.clouds import read_cloud
from tso_cli.io.images import read_mask
from tso_cli.refinement import RefineConfig, refine, refine_batch
from tso_cli.refinement.symmetry import MirrorPlane, find_mirror_plane
from tso_cli.render import look_at
from tso_cli.silhouette.projection import silhouette_of

EXAMPLES = Path(__file__).parents[2] / "examples"


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


@pytest.mark.parametrize("name", ["chair", "airplane", "car"])
def test_the_plane_stays_where_it_is_however_the_last_bits_are_rounded(name):
    points = _cloud(name)
    planes = [
        find_mirror_plane(points + np.random.default_rng(seed).normal(scale=1e-13, size=points.shape)) for seed in range(3)
    ]
    images = [plane.reflect(points) for plane in planes]
    for image in images[1:]:
        np.testing.assert_allclose(image, images[0], atol=1e-6)


def _seen(points: np.ndarray) -> tuple[np.ndarray, Camera]:
    """The mask of a cloud seen from half right, and its camera."""
    camera = look_at(35.0, 20.0, 3.0, (64, 64))
    return (silhouette_of(points, camera) > 0.5).astype(np.float32), camera


def _boxes(*sides: float) -> np.ndarray:
    """A slab with a post on its top at each of ``sides``; evenly sampled, so that it is its own mirror image if they are."""

    def grid(*axes: np.ndarray) -> np.ndarray:
        return np.stack(np.meshgrid(*axes), -1).reshape(-1, 3)

    deep = np.linspace(-0.3, 0.3, 16)
    slab = grid(np.linspace(-0.5, 0.5, 26), np.linspace(-0.1, 0.1, 6), deep)
    post = grid(np.linspace(-0.08, 0.08, 5), np.linspace(0.14, 0.5, 10), deep)
    return np.concatenate([slab, *(post + [side, 0.0, 0.0] for side in sides)])


def test_the_flipped_picture_helps_where_the_object_is_its_own_mirror_image():
    mask, camera = _seen(_boxes(-0.42, 0.42) * [1.1, 1.1, 1.0])
    found = refine(_boxes(-0.42, 0.42), mask, camera)
    assert found.symmetry is not None
    assert found.symmetry_outcome == "used"
    assert "at most 1.1" in found.symmetry_reason


def test_the_flipped_picture_is_given_up_where_the_object_has_lost_one_side():
    mask, camera = _seen(_boxes(-0.42))
    start = _boxes(-0.42, 0.42)
    found = refine(start, mask, camera)
    assert found.symmetry is None
    assert found.symmetry_outcome == "contradicted"
    assert "over 1.1" in found.symmetry_reason
    np.testing.assert_array_equal(found.points, refine(start, mask, camera, RefineConfig(symmetry="none")).points)


def test_a_cloud_that_is_not_its_own_mirror_image_has_no_plane():
    start = np.random.default_rng(0).uniform(-0.5, 0.5, (400, 3)) ** 2 * [1.0, 0.7, 0.4]
    found = refine(start, *_seen(start), RefineConfig(steps=0))
    assert (found.symmetry, found.symmetry_outcome) == (None, "none_found")


@pytest.mark.parametrize("config", [RefineConfig(preset="paper", symmetry="auto"), RefineConfig(learning_rate=1e-4)])
def test_how_fast_the_points_move_does_not_decide_whether_the_plane_is_borne_out(config):
    mask, camera = _seen(_boxes(-0.42))
    assert refine(_boxes(-0.42, 0.42), mask, camera, config).symmetry is None


def test_a_cloud_with_two_pictures_and_one_with_a_picture_and_its_mirror_image_are_not_mistaken_for_each_other():
    start, (mask, camera) = _boxes(-0.42, 0.42), _seen(_boxes(-0.42, 0.42) * [1.1, 1.1, 1.0])
    lopsided = start[start[:, 0] < 0.3]
    view = View(mask, camera)
    config = RefineConfig(steps=12)
    together = refine_batch([(start, [view]), (lopsided, [view, view])], config)
    assert [len(result.view_ious) for result in together] == [1, 2]
    for result, (points, views) in zip(together, [(start, [view]), (lopsided, [view, view])], strict=True):
        np.testing.assert_allclose(result.points, refine(points, views, config=config).points, atol=1e-4)


def test_one_cloud_of_a_batch_may_lose_its_plane_and_the_others_keep_theirs():
    start = _boxes(-0.42, 0.42)
    scenes = [(start, View(*_seen(truth))) for truth in (_boxes(-0.42), _boxes(-0.42, 0.42) * [1.1, 1.1, 1.0])]
    config = RefineConfig(steps=12)
    together = refine_batch(scenes, config)
    assert [result.symmetry is None for result in together] == [True, False]
    for result, (points, view) in zip(together, scenes, strict=True):
        np.testing.assert_allclose(result.points, refine(points, view, config=config).points, atol=1e-4)


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
        assert result.symmetry_outcome == ("not_asked" if symmetry == "none" else "given")
    middle = (points[:, 0].min() + points[:, 0].max()) / 2.0
    assert told == {"none": None, "x": pytest.approx((1, 0, 0, middle)), "2,0,0,0.1": pytest.approx((1, 0, 0, 0.05))}


@pytest.mark.parametrize("bad", ["w", "1,0,0", "0,0,0,1", "1,a,0,0", "nan,0,0,0"])
def test_a_plane_that_is_none_is_refused(bad):
    with pytest.raises(InputError, match="symmetry is"):
        RefineConfig(symmetry=bad)


@pytest.mark.parametrize("preset", ["best", "paper"])
@pytest.mark.parametrize("plane", ["0,0,1,9", "1,0,0,5", "0,1,0,-0.9"])
def test_a_plane_beside_the_cloud_is_refused(plane, preset):
    chair = EXAMPLES / "chair"
    mask = read_mask(chair / "mask.png")
    camera = read_camera(chair / "camera.json", mask.shape[1], mask.shape[0])
    with pytest.raises(InputError, match=f"symmetry is '{plane}', expected a plane .* through the cloud"):
        refine(_cloud("chair"), mask, camera, RefineConfig(preset=preset, symmetry=plane))


def test_a_given_plane_is_judged_as_one_that_was_found():
    points = _cloud("airplane")
    found = find_mirror_plane(points)
    judged = MirrorPlane(found.normal, found.offset).judged(points)
    assert (judged.misfit, judged.far) == pytest.approx((found.misfit, found.far))
    assert MirrorPlane(found.normal, found.offset + 0.2).judged(points).misfit > 2.0 * found.misfit


def test_a_cloud_whose_points_lie_on_one_another_is_told_how_a_plane_fits():
    half = np.random.default_rng(0).uniform(0.1, 0.5, (50, 3))
    cloud = np.concatenate([half, half * [-1.0, 1.0, 1.0]] * 2)
    exact = MirrorPlane(np.array([1.0, 0.0, 0.0]), 0.0).judged(cloud)
    assert (exact.misfit, exact.far) == (0.0, 0.0)
    beside = MirrorPlane(np.array([1.0, 0.0, 0.0]), 0.1).judged(cloud)
    assert (beside.misfit, beside.far) == (np.inf, np.inf)
