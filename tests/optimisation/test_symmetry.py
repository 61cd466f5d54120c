"""Mirror planes: the search, and flipped views."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.corruption import assert_refused
from tests.scenes import EXAMPLES, example, problem_of, seen
from tso_cli import RefineConfig, View, refine
from tso_cli.geometry.mirror_plane import MirrorPlane
from tso_cli.geometry.points import sample_surface
from tso_cli.geometry.rotations import from_vectors
from tso_cli.io.meshes import read_mesh
from tso_cli.losses.silhouette import silhouette_of
from tso_cli.optimisation.symmetry import find_mirror_plane, fitted_plane
from tso_cli.render.viewpoints import look_at


@pytest.mark.parametrize("name", ["chair", "car"])
def test_the_plane_of_a_rotated_symmetric_object_is_found(name):
    points = example(name).points
    found = find_mirror_plane(points)
    assert found.symmetric
    turn = from_vectors(np.array([1.0, -2.0, 0.5]))
    turned = find_mirror_plane(points @ turn.T + 5.0)
    assert turned.symmetric
    cosine = turned.plane.normal @ (turn @ found.plane.normal)
    assert abs(cosine) > np.cos(np.radians(1.0))


def test_a_chair_with_one_arm_has_no_plane(chair):
    points = chair.points
    side = (points - points.mean(0)) @ find_mirror_plane(points).plane.normal
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
    first, *others = (find_mirror_plane(points + bits).plane.reflect(points) for bits in noise)
    for other in others:
        np.testing.assert_allclose(other, first, atol=1e-6)


def test_the_planes_of_many_shapes_do_not_depend_on_it_either():
    """Rounding decides which of two mirrored points is farther. One alone would turn the plane."""
    for number, path in enumerate(sorted((EXAMPLES / "meshes").glob("*/*.ply"))):
        mesh, rng = read_mesh(path), np.random.default_rng(number)
        for _ in range(3):
            points = sample_surface(mesh.vertices, mesh.faces, 600, rng)
            rounded = points + rng.normal(scale=1e-13, size=points.shape)
            image, other = (
                find_mirror_plane(cloud).plane.reflect(points) for cloud in (points, rounded)
            )
            np.testing.assert_allclose(other, image, atol=1e-6)


@pytest.mark.parametrize("count", [1, 3])
def test_too_few_points_have_no_plane(count):
    assert not find_mirror_plane(np.eye(3)[:count]).symmetric


def _seen(points: np.ndarray) -> list[View]:
    """Masks of a cloud from half right and from half left."""
    return [
        seen(points, look_at(azimuth, elevation, 3.0, (64, 64)))
        for azimuth, elevation in ((35.0, 20.0), (-70.0, 30.0))
    ]


def test_an_asymmetric_cloud_has_no_plane():
    start = np.random.default_rng(0).uniform(-0.5, 0.5, (400, 3)) ** 2 * [1.0, 0.7, 0.4]
    problem = problem_of(start, *_seen(start), symmetry="auto")
    assert problem.symmetry.outcome == "none_found"
    assert problem.symmetry.coefficients is None
    assert problem.flipped == ()


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
    view = plane.flipped(View(silhouette_of(chair.points, chair.camera), chair.camera))
    mirrored = plane.reflect(chair.points)
    np.testing.assert_allclose(silhouette_of(mirrored, view.camera), view.mask, atol=1e-4)
    np.testing.assert_allclose(
        view.camera.project(mirrored)[1], chair.camera.project(chair.points)[1]
    )


@pytest.mark.parametrize(
    ("symmetry", "outcome"), [("none", "not_asked"), ("x", "given"), ("2,0,0,0.1", "given")]
)
def test_a_given_plane_is_used_and_reported(chair, symmetry, outcome):
    middle = (chair.points[:, 0].min() + chair.points[:, 0].max()) / 2.0
    planes = {"x": (1.0, 0.0, 0.0, middle), "2,0,0,0.1": (1.0, 0.0, 0.0, 0.05)}
    result = refine(*chair[:3], RefineConfig(steps=0, symmetry=symmetry))
    assert result.symmetry.outcome == outcome
    expected = planes.get(symmetry)
    assert result.symmetry.coefficients == (expected and pytest.approx(expected))


@pytest.mark.parametrize("bad", ["w", "1,0,0", "0,0,0,1", "1,a,0,0", "nan,0,0,0"])
def test_malformed_planes_are_refused(bad):
    assert_refused("symmetry is", RefineConfig, symmetry=bad)


@pytest.mark.parametrize("plane", ["0,0,1,9", "0,1,0,-0.9"])
def test_a_plane_that_misses_the_cloud_is_refused(chair, plane):
    message = f"symmetry is '{plane}', expected a plane .* through the cloud"
    assert_refused(message, refine, *chair[:3], RefineConfig(symmetry=plane))


def test_given_and_searched_planes_have_the_same_misfit():
    points = example("airplane").points
    found = find_mirror_plane(points)
    given, shifted = (
        fitted_plane(MirrorPlane(found.plane.normal, found.plane.offset + by), points)
        for by in (0.0, 0.2)
    )
    assert given.mean == pytest.approx(found.mean)
    assert given.tail == pytest.approx(found.tail)
    assert shifted.mean > 2.0 * found.mean


@pytest.mark.parametrize(("offset", "misfit"), [(0.0, 0.0), (0.1, np.inf)])
def test_the_misfit_of_coinciding_points_is_zero_or_infinite(offset, misfit):
    half = np.random.default_rng(0).uniform(0.1, 0.5, (50, 3))
    cloud = np.concatenate([half, half * [-1.0, 1.0, 1.0]] * 2)
    fitted = fitted_plane(MirrorPlane(np.array([1.0, 0.0, 0.0]), offset), cloud)
    assert fitted.mean == misfit
    assert fitted.tail == misfit
