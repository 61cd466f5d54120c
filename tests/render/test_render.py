"""Rendering one mesh: cameras, rays, surface samples."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial import cKDTree

from tests.corruption import assert_refused
from tso_cli import Camera, TsoError
from tso_cli.geometry.points import farthest_point_sample, sample_surface
from tso_cli.io.meshes import Mesh
from tso_cli.io.paint import Paint
from tso_cli.render import rays, viewpoints
from tso_cli.render.folder import render_mesh
from tso_cli.render.normalise import normalise
from tso_cli.render.rays import RayScene, render_view
from tso_cli.render.settings import RenderSettings
from tso_cli.render.viewpoints import MARGIN_PX, sample_cameras

from .conftest import box, joined, look_at, stool


def near(mask, pixels):
    """Whether each of ``pixels`` [N, 2] lies within a pixel of the mask."""
    columns, rows = np.rint(pixels).astype(int).T
    return ndimage.binary_dilation(mask > 0, np.ones((3, 3)))[rows, columns]


# Cameras


def test_the_camera_in_front_is_the_canonical_one():
    camera, canonical = viewpoints.look_at(0.0, 0.0, 2.0, (64, 64)), Camera.canonical(64, 64)
    for name in "KRt":
        np.testing.assert_allclose(getattr(camera, name), getattr(canonical, name), atol=1e-15)


@pytest.mark.parametrize(
    ("azimuth", "elevation"), [(0, 0), (90, 0), (-40, 30), (200, -80), (10, 90)]
)
def test_the_camera_stands_where_azimuth_and_elevation_say_and_looks_at_the_origin(
    azimuth, elevation
):
    camera = viewpoints.look_at(azimuth, elevation, 3.0, (40, 30))
    a, e = np.radians([azimuth, elevation])
    position = 3.0 * np.array([np.cos(e) * np.sin(a), np.sin(e), np.cos(e) * np.cos(a)])
    np.testing.assert_allclose(camera.position, position, atol=1e-14)
    pixels, depth = camera.project(np.array([[0.0, 0.0, 0.0], [0.0, 0.1, 0.0]]))
    np.testing.assert_allclose(pixels[0], [19.5, 14.5])
    assert depth[0] == pytest.approx(3.0)
    assert np.linalg.det(camera.R) == pytest.approx(1.0)
    if abs(elevation) < 90:
        assert pixels[1, 0] == pytest.approx(19.5)
        assert pixels[1, 1] < 14.5


@pytest.mark.parametrize("size", [(64, 64), (96, 40), (30, 80)])
def test_the_distance_is_the_smallest_that_keeps_the_object_in_the_frame(size):
    mesh = normalise(stool())
    settings = RenderSettings(views=20, size=size)
    for camera in sample_cameras(settings, mesh.vertices, np.random.default_rng(0)):
        pixels, _ = camera.project(mesh.vertices)
        border = np.minimum(pixels + 0.5, np.array(size) - 0.5 - pixels).min()
        assert border >= MARGIN_PX - 1e-9
        if camera.t[2] > 2.0:
            assert border == pytest.approx(MARGIN_PX)


def test_cameras_are_drawn_from_the_ranges():
    settings = RenderSettings(views=200, azimuth=(30.0, 60.0), elevation=(-5.0, 40.0))
    cameras = sample_cameras(settings, box().vertices, np.random.default_rng(1))
    x, y, z = np.array([camera.position / camera.t[2] for camera in cameras]).T
    azimuth, elevation = np.degrees(np.arctan2(x, z)), np.degrees(np.arcsin(y))
    assert 30 <= azimuth.min() < 32
    assert 58 < azimuth.max() <= 60
    assert -5 <= elevation.min() < -2
    assert 37 < elevation.max() <= 40


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"views": 0}, "`views` is 0"),
        ({"size": (4, 64)}, "`size` is 4x64"),
        ({"azimuth": (90.0, 10.0)}, "azimuth"),
        ({"elevation": (-5.0, 91.0)}, "elevation"),
        ({"points": 300, "samples": 200}, "`points` is 300"),
    ],
)
def test_impossible_settings_are_refused(change, words):
    assert_refused(words, replace, RenderSettings(), **change)


# Pictures


@pytest.mark.parametrize("focal", [60.0, 61.7, 61.3])
def test_the_mask_of_a_cube_from_the_front_is_its_projected_front_face(focal):
    view = render_view(RayScene(box()), look_at(0.0, 0.0, 2.0, (64, 48), focal))
    half = focal * 0.5 / 1.5  # the front face, at depth 1.5
    rows, columns = (
        np.clip(half + 0.5 - np.abs(np.arange(n) - (n - 1) / 2), 0.0, 1.0) for n in (48, 64)
    )
    np.testing.assert_array_equal(view.mask > 0, np.outer(rows, columns) > 0.5)
    assert set(np.unique(view.mask)) == {0, 255}


def test_the_area_of_a_sphere_is_that_of_its_outline():
    import trimesh

    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.5)
    camera = look_at(70.0, 25.0, 2.0, (128, 128), 200.0)
    view = render_view(
        RayScene(Mesh(np.array(ball.vertices), np.array(ball.faces, dtype=np.int64))), camera
    )
    radius = 200.0 * 0.5 / np.sqrt(2.0**2 - 0.5**2)  # the tangent cone, cut by the image plane
    assert (view.mask > 0).sum() == pytest.approx(np.pi * radius**2, rel=0.01)
    np.testing.assert_allclose(ndimage.center_of_mass(view.mask), [63.5, 63.5], atol=0.05)


@pytest.mark.parametrize("model", ["perspective", "orthographic"])
def test_mask_and_projected_surface_agree_for_any_camera(model):
    rng = np.random.default_rng(2)
    mesh = normalise(stool())
    points = sample_surface(mesh.vertices, mesh.faces, 4000, rng)
    K = np.array([[75.0, 6.0, 47.3], [0.0, 60.0, 32.1], [0.0, 0.0, 1.0]])
    for _ in range(5):
        camera = replace(
            viewpoints.look_at(rng.uniform(0, 360), rng.uniform(-40, 60), 2.5, (90, 70)),
            K=K,
            model=model,
        )
        if model == "orthographic":  # the object straddles the camera's plane
            camera = replace(
                camera,
                K=K * [[0.5, 0.5, 1], [0.5, 0.5, 1], [1, 1, 1]],
                t=np.array([0.1, 0.05, 0.0]),
            )
        mask = render_view(RayScene(mesh), camera).mask
        pixels, _ = camera.project(points)
        assert near(mask, pixels).mean() > 0.99
        # Each covered pixel has a projected point near it.
        assert cKDTree(pixels).query(np.argwhere(mask > 0)[:, ::-1])[0].max() < 2.5


def test_nearer_parts_hide_those_behind():
    mesh = joined(box((0.4, 0.4, 0.1), (0, 0, 0.3)), box((1, 1, 0.1), (0, 0, -0.3)))
    scene = RayScene(
        replace(
            mesh,
            paint=Paint.of_faces(np.repeat(np.uint8([[255, 0, 0], [0, 0, 255]]), 12, axis=0)),
        )
    )
    front, back = (
        render_view(scene, look_at(azimuth, 0.0, 3.0, (33, 33), 40.0)).image
        for azimuth in (0.0, 180.0)
    )
    assert front[16, 16, 0] > 50
    assert front[16, 16, 2] == 0
    assert back[16, 16, 2] > 50
    assert back[16, 16, 0] == 0
    assert (front[0, 0] == 255).all()


def test_an_object_out_of_sight_has_an_empty_mask_and_one_around_the_camera_a_full_mask():
    camera, scene = look_at(0.0, 0.0, 2.0, (20, 20), 10.0), RayScene(box())
    view = render_view(scene, replace(camera, t=np.array([50.0, 0.0, 2.0])))
    assert not view.mask.any()
    assert (view.image == 255).all()
    assert render_view(scene, replace(camera, t=np.zeros(3))).mask.all()


def test_a_large_picture_is_cast_in_pieces_that_fit_together(monkeypatch):
    camera, scene, calls = viewpoints.look_at(30.0, 20.0, 2.5, (70, 64)), RayScene(stool()), []
    whole = render_view(scene, camera)

    class Counted(RayScene):
        def cast(self, camera, columns, rows):
            calls.append(len(rows) * len(columns))
            return super().cast(camera, columns, rows)

    monkeypatch.setattr(rays, "RAYS_AT_ONCE", 10_000)
    pieces = render_view(Counted(stool()), camera)
    assert len(calls) > 1
    assert max(calls) <= 10_000
    np.testing.assert_array_equal(whole.image, pieces.image)
    np.testing.assert_array_equal(whole.mask, pieces.mask)


def test_without_open3d_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "open3d", None)
    with pytest.raises(
        TsoError, match=r"^.*tso-cli\[render\].*libusb-1.0-0 libgl1 libegl1 libx11-6 libgomp1\Z"
    ):
        RayScene(box())


# Ground truth


def test_a_rendered_mesh_lies_inside_its_pictures_with_its_target():
    settings = RenderSettings(views=6, samples=200, points=50)
    rendered = render_mesh(stool(), settings, np.random.default_rng(3))
    assert rendered.samples.shape == (200, 3)
    kept = rendered.samples[farthest_point_sample(rendered.samples, 50)]
    np.testing.assert_allclose(np.sort(rendered.target, axis=0), np.sort(kept, axis=0), atol=1e-6)
    for view in rendered.views:
        assert view.mask.any()
        assert not view.mask[[0, -1]].any()
        assert not view.mask[:, [0, -1]].any()
        assert (
            near(view.mask, view.camera.project(rendered.target.astype(np.float64))[0]).mean()
            > 0.99
        )


def test_a_mesh_is_centred_and_scaled_without_its_unused_vertices():
    mesh = box((2.0, 4.0, 1.0), (1e6, -5.0, 3.0))
    vertices = normalise(Mesh(np.vstack([[1e9, 0, 0], mesh.vertices]), mesh.faces + 1)).vertices
    np.testing.assert_allclose(
        [-vertices.min(axis=0), vertices.max(axis=0)], [[0.25, 0.5, 0.125]] * 2, atol=1e-9
    )
