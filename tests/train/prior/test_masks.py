"""Masks of meshes and maps of signed distances."""

import numpy as np
import pytest

from tso_cli.geometry.camera import CANONICAL_ROTATION, Camera
from tso_cli.geometry.raster import ACROSS
from tso_cli.io.meshes import Mesh
from tso_cli.render.rays import RayScene
from tso_cli.train.prior.masks import (
    HALF_SIDE,
    SCENE_GRID,
    Border,
    known_window,
    seen,
    signed_distance,
    silhouette,
)
from tso_cli.train.prior.scenes import CUT_OFF, draw_border
from tso_cli.train.prior.views import draw_pose, draw_view

SQUARE = np.array([[-0.3, -0.3], [0.3, -0.3], [0.3, 0.3], [-0.3, 0.3]])
TRIANGLES = np.array([[0, 1, 2], [0, 2, 3]], np.int32)


def cast(shape, rotation, closeness, cells):
    """The mask by ray casting, with the samples of `silhouette`."""
    per_unit = cells / (2.0 * HALF_SIDE)
    middle = (cells - 1) / 2.0
    focal = per_unit / closeness if closeness else per_unit
    K = np.array([[focal, 0.0, middle], [0.0, focal, middle], [0.0, 0.0, 1.0]])
    distance = 1.0 / closeness if closeness else 5.0
    model = "perspective" if closeness else "orthographic"
    camera = Camera(K, rotation, np.array([0.0, 0.0, distance]), cells, cells, model=model)
    offsets = (np.arange(ACROSS) + 0.5) / ACROSS - 0.5
    places = (np.arange(cells)[:, None] + offsets).ravel()
    mesh = Mesh(shape.vertices.astype(np.float64), shape.faces.astype(np.int64))
    hit = RayScene(mesh).cast(camera, places, places)["hit"]
    covered = hit.reshape(cells, ACROSS, cells, ACROSS).sum((1, 3))
    return 2 * covered > ACROSS**2


@pytest.mark.parametrize("orthographic", [False, True])
def test_drawn_triangles_cover_what_rays_hit(shapes, orthographic):
    pytest.importorskip("open3d")
    rng = np.random.default_rng(0)
    differing = total = 0
    for shape in shapes.shapes[::3]:
        rotation, closeness = draw_view(rng, draw_pose(rng))
        closeness = 0.0 if orthographic else closeness or 0.5
        mask = silhouette(seen(shape.vertices, rotation, closeness), shape.faces, 96)
        differing += (mask != cast(shape, rotation, closeness, 96)).sum()
        total += mask.sum()
    # Rays along edges, and single precision.
    assert differing <= 1e-3 * total
    assert total > 5000


def test_a_square_covers_its_cells():
    mask = silhouette(SQUARE, TRIANGLES, 60)
    rows, columns = np.nonzero(mask)
    assert mask.sum() == 20**2
    assert (rows.min(), rows.max(), columns.min(), columns.max()) == (20, 39, 20, 39)


@pytest.mark.parametrize("cells", [40, 96, 192])
def test_the_signed_distance_is_the_distance_to_the_outline(cells):
    mask = silhouette(SQUARE, TRIANGLES, cells)
    distance = signed_distance(mask, Border.whole(cells))
    centres = ((np.arange(SCENE_GRID) + 0.5) / SCENE_GRID * 2.0 - 1.0) * HALF_SIDE
    middle = distance[SCENE_GRID // 2]
    cell = 2.0 * HALF_SIDE / cells
    np.testing.assert_allclose(middle, np.abs(centres) - 0.3, atol=0.75 * cell)
    assert distance.shape == (SCENE_GRID, SCENE_GRID)


def test_a_view_is_a_rotation():
    rng = np.random.default_rng(1)
    for _ in range(20):
        rotation, _ = draw_view(rng, draw_pose(rng))
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1.0)


def test_a_camera_above_the_horizon_sees_the_top():
    rng = np.random.default_rng(2)
    above = [-(draw_view(rng, np.eye(3))[0].T @ [0.0, 0.0, 1.0])[1] for _ in range(300)]
    # Elevations are -5 to 40 degrees in three of four views.
    assert np.mean(np.array(above) > np.sin(np.radians(-5.1))) > 0.75
    assert np.median(above) == pytest.approx(np.sin(np.radians(17.0)), abs=0.15)


def test_objects_are_seen_upright_in_half_of_the_views_and_else_at_any_roll():
    rng = np.random.default_rng(3)
    ups = [draw_view(rng, draw_pose(rng))[0] @ [0.0, 1.0, 0.0] for _ in range(300)]
    # y is down in the view.
    upright = [up[1] < -0.95 * np.hypot(up[0], up[1]) for up in ups]
    assert 0.4 < np.mean(upright) < 0.65


def test_the_canonical_view_looks_along_minus_z():
    w = seen(np.array([[0.25, 0.5, 0.5]]), CANONICAL_ROTATION, 0.5)
    np.testing.assert_allclose(w, [[0.25 / 0.75, -0.5 / 0.75]])


def test_beyond_its_border_a_picture_goes_on_as_at_the_border():
    mask = silhouette(SQUARE, TRIANGLES, 96)
    border = Border(40, 0, 96, 60)
    distance = signed_distance(mask, border)
    left, top, right, bottom = known_window(border, 96)
    assert (left, top, right, bottom) == (20, 0, 48, 30)
    np.testing.assert_allclose(
        distance[:, :left], np.broadcast_to(distance[:, :1], (SCENE_GRID, left)), atol=1e-6
    )
    # The outline that is cut away is not known: the foreground goes on beyond the border.
    assert distance[20, left] < 0.0
    assert (distance[bottom:] == distance[-1]).all()


def test_a_border_cuts_off_a_part_of_the_object_on_one_or_two_sides():
    mask = silhouette(SQUARE, TRIANGLES, 96)
    rng = np.random.default_rng(0)
    sides = []
    for _ in range(100):
        border = draw_border(mask, rng)
        shown = mask[border.top : border.bottom, border.left : border.right].sum() / mask.sum()
        assert 1.0 - 2.0 * CUT_OFF[1] - 0.03 < shown < 1.0
        edges = (border.left, border.top, 96 - border.right, 96 - border.bottom)
        sides.append(sum(edge > 0 for edge in edges))
    assert set(sides) == {1, 2}
