"""Mirror planes: search, symmetry check and flipped views."""

from functools import partial

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.corruption import assert_refused
from tests.losses.common import COMPILED, FORMS, in_form
from tests.scenes import EXAMPLES, example, seen
from tso_cli import RefineConfig, View, refine
from tso_cli.geometry.points import sample_surface
from tso_cli.geometry.rotations import from_vectors
from tso_cli.io.meshes import read_mesh
from tso_cli.losses.silhouette import silhouette_of
from tso_cli.optimisation.symmetry import MirrorPlane, find_mirror_plane
from tso_cli.render import look_at


@pytest.mark.parametrize("name", ["chair", "car"])
def test_the_plane_of_a_rotated_symmetric_object_is_found(name):
    points = example(name).points
    plane = find_mirror_plane(points)
    assert plane.symmetric
    turn = from_vectors(np.array([1.0, -2.0, 0.5]))
    turned = find_mirror_plane(points @ turn.T + 5.0)
    assert turned.symmetric
    assert abs(turned.normal @ (turn @ plane.normal)) > np.cos(np.radians(1.0))


def test_a_chair_with_one_arm_has_no_plane(chair):
    points = chair.points
    side = (points - points.mean(0)) @ find_mirror_plane(points).normal
    upper = points[:, 1] > np.quantile(points[:, 1], 0.6)
    assert not find_mirror_plane(points[~(upper & (side > 0.0))]).symmetric


def test_the_plane_of_a_large_cloud_is_found_in_any_order_of_its_points(chair):
    rng = np.random.default_rng(0)
    body = np.repeat(chair.points, 40, axis=0) + rng.normal(scale=2e-3, size=(40 * 1024, 3))
    for axis in range(3):
        assert find_mirror_plane(body[body[:, axis].argsort()]).symmetric


@pytest.mark.parametrize("name", ["chair", "car", "airplane"])
def test_the_plane_does_not_depend_on_how_the_last_bits_are_rounded(name):
    points = example(name).points
    noise = [
        np.random.default_rng(seed).normal(scale=1e-13, size=points.shape) for seed in range(3)
    ]
    first, *others = (find_mirror_plane(points + bits).reflect(points) for bits in noise)
    others.append(in_form(COMPILED, find_mirror_plane, points).reflect(points))
    for other in others:
        np.testing.assert_allclose(other, first, atol=1e-6)


def test_the_planes_of_many_shapes_do_not_depend_on_it_either():
    """Of two points that are each other's mirror image rounding decides which is farther; one alone would turn the plane."""
    for number, path in enumerate(sorted((EXAMPLES / "meshes").glob("*/*.ply"))):
        mesh, rng = read_mesh(path), np.random.default_rng(number)
        for _ in range(3):
            points = sample_surface(mesh.vertices, mesh.faces, 600, rng)
            other = find_mirror_plane(points + rng.normal(scale=1e-13, size=points.shape))
            np.testing.assert_allclose(
                other.reflect(points), find_mirror_plane(points).reflect(points), atol=1e-6
            )


@pytest.mark.parametrize("count", [1, 3])
def test_too_few_points_have_no_plane(count):
    assert not find_mirror_plane(np.eye(3)[:count]).symmetric


def _seen(points: np.ndarray) -> list[View]:
    """Masks of a cloud from half right and from half left."""
    return [
        seen(points, look_at(azimuth, elevation, 3.0, (64, 64)))
        for azimuth, elevation in ((35.0, 20.0), (-70.0, 30.0))
    ]


def _boxes(*sides: float) -> np.ndarray:
    """A slab with a post on its top at each of ``sides``; sampled on a grid."""

    def grid(*axes: np.ndarray) -> np.ndarray:
        return np.stack(np.meshgrid(*axes), -1).reshape(-1, 3)

    deep = np.linspace(-0.3, 0.3, 16)
    slab = grid(np.linspace(-0.5, 0.5, 26), np.linspace(-0.1, 0.1, 6), deep)
    post = grid(np.linspace(-0.08, 0.08, 5), np.linspace(0.14, 0.5, 10), deep)
    return np.concatenate([slab, *(post + [side, 0.0, 0.0] for side in sides)])


def test_the_symmetry_check_passes_for_a_symmetric_object():
    result = refine(
        _boxes(-0.42, 0.42),
        _seen(_boxes(-0.42, 0.42) * [1.1, 1.1, 1.0]),
        config=RefineConfig(steps=12),
    )
    assert result.symmetry is not None
    assert result.symmetry_outcome == "used"
    assert "at most 1.1" in result.symmetry_reason


@FORMS
@pytest.mark.parametrize("views", [1, 2])
def test_the_symmetry_check_fails_for_an_object_that_lost_one_side(form, views):
    start, views = _boxes(-0.42, 0.42), _seen(_boxes(-0.42))[:views]
    configs = RefineConfig(steps=12), RefineConfig(steps=12, symmetry="none")
    result, without = (
        in_form(form, partial(refine, start, views, config=config)) for config in configs
    )
    assert (result.symmetry, result.symmetry_outcome) == (None, "contradicted")
    assert "over 1.1" in result.symmetry_reason
    np.testing.assert_array_equal(result.points, without.points)


def test_an_asymmetric_cloud_has_no_plane():
    start = np.random.default_rng(0).uniform(-0.5, 0.5, (400, 3)) ** 2 * [1.0, 0.7, 0.4]
    result = refine(start, _seen(start), config=RefineConfig(steps=0))
    assert (result.symmetry, result.symmetry_outcome) == (None, "none_found")


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 1000), st.floats(-2.0, 2.0))
def test_two_reflections_are_the_identity_and_midpoints_lie_on_the_plane(seed, offset):
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=3)
    plane = MirrorPlane(normal / np.linalg.norm(normal), offset)
    points = rng.normal(size=(5, 3))
    image = plane.reflect(points)
    np.testing.assert_allclose(plane.reflect(image), points, atol=1e-9)
    middle = (points + image) / 2.0
    np.testing.assert_allclose(middle @ plane.normal, offset, atol=1e-9)


def test_a_flipped_view_shows_the_mirror_image_of_the_cloud(chair):
    plane = MirrorPlane(np.array([0.6, 0.0, 0.8]), 0.05)
    view = plane.view(View(silhouette_of(chair.points, chair.camera), chair.camera))
    mirrored = plane.reflect(chair.points)
    np.testing.assert_allclose(silhouette_of(mirrored, view.camera), view.mask, atol=1e-4)
    np.testing.assert_allclose(
        view.camera.project(mirrored)[1], chair.camera.project(chair.points)[1]
    )


def test_a_given_plane_is_used_and_reported(chair):
    middle = (chair.points[:, 0].min() + chair.points[:, 0].max()) / 2.0
    for symmetry, plane in ("none", None), ("x", (1, 0, 0, middle)), ("2,0,0,0.1", (1, 0, 0, 0.05)):
        result = refine(*chair[:3], RefineConfig(steps=0, symmetry=symmetry))
        assert result.symmetry == (plane and pytest.approx(plane))
        assert result.symmetry_outcome == ("given" if plane else "not_asked")


@pytest.mark.parametrize("bad", ["w", "1,0,0", "0,0,0,1", "1,a,0,0", "nan,0,0,0"])
def test_malformed_planes_are_refused(bad):
    assert_refused("symmetry is", RefineConfig, symmetry=bad)


@pytest.mark.parametrize("plane", ["0,0,1,9", "0,1,0,-0.9"])
def test_a_plane_beside_the_cloud_is_refused(chair, plane):
    message = f"symmetry is '{plane}', expected a plane .* through the cloud"
    assert_refused(message, refine, *chair[:3], RefineConfig(symmetry=plane))


def test_given_and_searched_planes_have_the_same_misfit():
    points = example("airplane").points
    found = find_mirror_plane(points)
    given, aside = (
        MirrorPlane(found.normal, found.offset + by).judged(points) for by in (0.0, 0.2)
    )
    assert (given.misfit, given.far) == pytest.approx((found.misfit, found.far))
    assert aside.misfit > 2.0 * found.misfit


def test_the_misfit_of_coinciding_points_is_zero_or_infinite():
    half = np.random.default_rng(0).uniform(0.1, 0.5, (50, 3))
    cloud = np.concatenate([half, half * [-1.0, 1.0, 1.0]] * 2)
    for offset, misfit in ((0.0, 0.0), (0.1, np.inf)):
        judged = MirrorPlane(np.array([1.0, 0.0, 0.0]), offset).judged(cloud)
        assert (judged.misfit, judged.far) == (misfit, misfit)
