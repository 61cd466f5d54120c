"""The silhouette of a cloud and its IoU with a mask."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree

from tests.scenes import EXAMPLES, block, example, in_photo
from tso_cli import Camera, RefineConfig, View, refine
from tso_cli.evaluation import footprint as module
from tso_cli.evaluation.footprint import RIM, Solid, common_window, footprint, spacing
from tso_cli.geometry.resampling import area_resize
from tso_cli.geometry.window import window_of
from tso_cli.io.meshes import read_mesh
from tso_cli.render.folder import ground_truth
from tso_cli.render.normalise import normalise
from tso_cli.render.rays import RayScene, render_view
from tso_cli.render.settings import RenderSettings
from tso_cli.render.viewpoints import fitting_distance, look_at

NAMES = ("chair", "car", "airplane")
# One unit is 100 px; x to the right, y down.
FLAT = Camera(np.diag([100.0, 100.0, 1.0]), np.eye(3), np.zeros(3), 100, 100, "orthographic")


def window_iou(points, view, box=None):
    """The IoU of a cloud."""
    return module.window_iou(Solid(points), view, box)


def in_window(points, view, box):
    return module.in_window(Solid(points), view, box)


def _example(name):
    """The true cloud and the view of an example."""
    scene = example(name)
    return scene.target, scene.view


def _resized(view, size):
    cover, _ = area_resize(
        view.mask, (-0.5, -0.5, view.camera.width - 0.5, view.camera.height - 0.5), size, size
    )
    return View(np.float32(cover > 0.5), view.camera.resized(size, size))


def _straight(focal, column, row, width, height):
    """A camera at the origin; x to the right, y down."""
    K = np.array([[focal, 0.0, column], [0.0, focal, row], [0.0, 0.0, 1.0]])
    return Camera(K, np.eye(3), np.zeros(3), width, height)


def _plate(step=0.02, last=0.88):
    """A square lattice in the plane z = 0, from 0.1 on."""
    steps = np.arange(0.1, last + 1e-9, step)
    return np.stack([*np.meshgrid(steps, steps), np.zeros((len(steps), len(steps)))], -1).reshape(
        -1, 3
    )


# The mask of that plate: it reaches half a pixel beyond the outermost points.
SQUARE = block(np.s_[10:89, 10:89], (100, 100))


@pytest.mark.parametrize("size", [64, 1024])
@pytest.mark.parametrize("name", NAMES)
def test_the_truth_scores_near_1_on_every_example_and_about_the_same_on_a_mask_of_another_size(
    name, size
):
    points, view = _example(name)
    score = window_iou(points, view)
    assert score > 0.93
    # What differs is the outline's pixels: of the aeroplane at 64 px they are a fifth of the mask.
    assert window_iou(points, _resized(view, size)) == pytest.approx(score, abs=0.011)


@pytest.mark.parametrize("mesh", ["chair/kfurn_chairDesk", "airplane/qplane_Private_plane"])
def test_more_points_bring_the_truth_nearer_to_1_and_its_triangles_reach_it(mesh):
    shape = normalise(read_mesh(EXAMPLES / "meshes" / f"{mesh}.ply"))
    camera = look_at(
        35.0,
        20.0,
        fitting_distance(shape.vertices, look_at(35.0, 20.0, 2.0, (256, 256)), 8.0),
        (256, 256),
    )
    view = View(np.float32(render_view(RayScene(shape), camera).mask > 0), camera)
    samples, target = ground_truth(shape, RenderSettings(), np.random.default_rng(0))
    assert len(target) == 1024
    assert len(samples) == 16384
    assert window_iou(target, view) > 0.92
    assert window_iou(samples, view) > 0.96
    # Its triangles are the truth itself.
    assert module.window_iou(Solid(shape.vertices, shape.faces), view) > 0.995


@pytest.mark.parametrize(("name", "size"), [("car", 64), ("airplane", 256)])
def test_a_cloud_scores_the_same_in_a_canvas_of_any_size(name, size):
    points, view = _example(name)
    view = _resized(view, size)
    score = window_iou(points, view)
    for times, left, top in ((2, 0, 17), (4, 611 * size // 256, 5), (8, 3 * size, 7 * size)):
        assert window_iou(points, in_photo(view, times, left, top)) == pytest.approx(
            score, abs=0.01
        )


@pytest.mark.parametrize("name", ["chair", "airplane"])
def test_a_cloud_that_is_shifted_scaled_or_of_another_shape_scores_clearly_lower(name):
    points, view = _example(name)
    right, down, _ = 0.05 * np.ptp(points, axis=0).max() * view.camera.R
    score = window_iou(points, view)
    for other in (
        points + right,
        points - right,
        points + down,
        points - down,
        1.1 * points,
        0.9 * points,
    ):
        assert window_iou(other, view) < score - 0.1
    assert window_iou(example(name).points, view) < score - 0.1


def test_half_of_the_object_scores_half():
    points, view = _plate(), View(SQUARE, FLAT)
    assert window_iou(points, view) > 0.97
    assert window_iou(points[points[:, 0] < 0.49], view) == pytest.approx(0.5, abs=0.02)


def test_what_lies_beyond_the_border_of_the_image_is_unknown():
    points, view = _example("car")
    camera = view.camera.cropped((89.5, 69.5, 219.5, 219.5), 130, 150)
    assert window_iou(points, View(view.mask[70:220, 90:220], camera)) > 0.95


@pytest.mark.parametrize("size", [300, 1200])
def test_pixels_compared_do_not_grow_with_the_photo(size):
    points, view = _example("chair")
    large = _resized(view, size)
    seen = in_window(points, large, window_of(large, points))
    assert max(seen.mask.shape) <= 257
    assert seen.silhouette.shape == seen.mask.shape


def test_a_hole_wider_than_two_spacings_stays_open_and_the_gaps_between_points_are_closed():
    points = _plate()
    # Without two by two points there are three spacings from point to point; the outline takes a
    # little of them.
    hole = (np.abs(points[:, :2] - 0.49) < 0.02).all(1)
    assert hole.sum() == 4
    seen = in_window(points[~hole], View(SQUARE, FLAT), (-0.5, -0.5, 99.5, 99.5))
    assert not seen.silhouette[48:51, 48:51].any()
    around = block(np.s_[11:88, 11:88], (100, 100)) - block(np.s_[46:53, 46:53], (100, 100))
    assert seen.silhouette[around > 0.0].all()


def test_outliers_lower_the_score_and_fill_nothing():
    rng = np.random.default_rng(0)
    points, view = _example("chair")
    strays = rng.uniform(points.min(0), points.max(0), (50, 3))
    assert window_iou(np.concatenate([points, strays]), view) < window_iou(points, view) - 0.01
    assert window_iou(strays[:20], view) < 0.3
    upper = points[:, 1] > 0.0
    half = window_iou(points[upper], view)
    assert half < 0.82
    assert window_iou(np.concatenate([points[upper], points[~upper][::12]]), view) < half + 0.02


def test_what_the_mask_does_not_know_says_nothing():
    points, known = _plate(), np.arange(100) + np.zeros((100, 1)) < 60
    less, more = (np.where(known, SQUARE, np.float32(value)) for value in (0.0, 1.0))
    assert window_iou(points, View(less, FLAT)) < 0.7
    assert window_iou(points, View(less, FLAT, known)) > 0.97
    assert window_iou(points[points[:, 0] < 0.61], View(more, FLAT, known)) > 0.97


def test_points_beyond_the_border_close_gaps_within():
    points = _plate(0.05)
    narrow = replace(FLAT, width=48)
    assert points[points[:, 0] < 0.475].max(0)[0] == pytest.approx(0.45)
    np.testing.assert_array_equal(footprint(points, narrow), footprint(points, FLAT)[:, :48])
    assert footprint(points, narrow)[15:80, 40:].all()


def test_points_at_the_camera_take_no_part():
    points, close = _plate() + [-0.5, -0.5, 2.0], np.array([[1e-3, 0.0, 1e-3]])
    camera = _straight(200.0, 59.5, 59.5, 300, 120)
    np.testing.assert_allclose(camera.project(close)[0], [[259.5, 59.5]])
    np.testing.assert_array_equal(
        footprint(np.concatenate([points, close]), camera), footprint(points, camera)
    )


def test_the_common_window_holds_both_clouds():
    points, view = _example("chair")
    moved = points + 0.3 * view.camera.R[0]
    box = common_window([(Solid(points), view), (Solid(moved), view)])
    assert box == common_window([(Solid(moved), view), (Solid(points), view)])
    alone = np.array([window_of(view, cloud) for cloud in (points, moved)])
    assert box == (*alone.min(0)[:2], *alone.max(0)[2:])
    assert window_iou(moved, view, box) != window_iou(moved, view, window_of(view, points))


def test_before_and_after_are_compared_in_one_window():
    scene = example("chair")
    result = refine(scene.points, scene.view, config=RefineConfig(steps=6))
    stages = [(solid, scene.view) for solid in result.solids]
    box = common_window(stages)
    before, after = (module.window_iou(*stage, box) for stage in stages)
    assert result.fit.iou_before == before
    assert result.fit.iou_after == after
    assert before < after


def test_the_silhouette_is_the_cloud_dilated_by_a_disc_and_eroded_by_a_little_less():
    # On a plate at random, seen by an orthographic camera: one radius for all points.
    points = np.random.default_rng(0).uniform([0.2, 0.2, 0.0], [0.8, 0.6, 0.0], (400, 3))
    camera = FLAT.resized(200, 200)
    spaced, radius = (200.0 * length for length in spacing(points))
    everywhere = np.stack(
        np.meshgrid(np.arange(25.0, 175.0, 0.125), np.arange(25.0, 135.0, 0.125)), -1
    ).reshape(-1, 2)
    empty = everywhere[cKDTree(camera.project(points)[0]).query(everywhere)[0] > radius]
    expected = np.zeros((200, 200), bool)
    cells = np.stack(np.meshgrid(np.arange(35, 165), np.arange(35, 125)), -1)
    expected[35:125, 35:165] = cKDTree(empty).query(cells)[0] > radius - RIM * spaced
    found = footprint(points, camera)
    assert expected.sum() > 7000
    # Empty spots smaller than a cell are missed.
    assert (found != expected).sum() < 0.03 * expected.sum()


def test_the_disc_is_as_wide_as_the_spacing_is_seen_at_its_depth():
    # Two plates of one spacing, the second three times as far: the spacing is 6 px and 2 px.
    near, far = _plate() - [0.78, 0.49, -1.0], _plate(last=1.3) + [0.4, -0.7, 3.0]
    middle = np.array([1.1, 0.0, 3.0])
    far = far[(np.abs(far - middle) > 0.05).any(1)]
    found = footprint(np.concatenate([near, far]), _straight(300.0, 214.5, 129.5, 400, 260))
    assert found[20:240, 20:240].all()
    # Around the pixel of that middle, 324 and 129.
    assert not found[127:132, 322:327].any()
    assert found[79:119, 274:374].all()


@pytest.mark.parametrize("count", [300, 30_000])
def test_the_spacing_is_that_of_the_points_on_their_surface_and_random_points_need_a_larger_disc(
    count,
):
    ball = np.random.default_rng(0).standard_normal((count, 3))
    spaced, radius = spacing(7.0 * ball / np.linalg.norm(ball, axis=1, keepdims=True))
    assert spaced == pytest.approx(7.0 * np.sqrt(4.0 * np.pi / count), rel=0.06)
    assert 1.3 < radius / spaced < 1.41
    spaced, radius = spacing(_plate())
    assert spaced == radius == pytest.approx(0.02, rel=0.15)


def test_scans_far_from_the_origin_and_very_large_or_small_units_change_nothing():
    points, view = _example("car")
    score = pytest.approx(window_iou(points, view), abs=1e-3)
    for unit, shift in ((1.0, [4e6, -3e6, 5e6]), (1e-30, np.zeros(3)), (1e30, np.zeros(3))):
        camera = replace(view.camera, t=unit * view.camera.t - view.camera.R @ shift)
        assert window_iou(unit * points + shift, replace(view, camera=camera)) == score


DEGENERATE = {
    "one point": [[0.0, 0.0, 0.0]],
    "equal points": [[0.1, 0.1, 0.1]] * 50,
    "points behind the camera": [[0.1, 0.1, 2.5], [0.2, 0.0, 3.0], [0.0, 0.0, 4.0]],
    "a point at the camera": [[0.1, 0.1, 2.0], [0.0, 0.0, 0.0]],
    "points far outside": [[0.0, 0.0, 0.0], [1e12, 0.0, 0.0], [0.0, 1e12, 0.0]],
}


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("model", ["perspective", "orthographic"])
@pytest.mark.parametrize("cloud", DEGENERATE)
def test_degenerate_clouds_get_a_number_and_no_warning(cloud, model):
    camera = replace(Camera.canonical(60, 40), model=model)
    if model == "orthographic":
        camera = replace(camera, K=_straight(40.0, 29.5, 19.5, 60, 40).K)
    assert (
        0.0
        <= window_iou(
            np.array(DEGENERATE[cloud]), View(block(np.s_[5:30, 20:50], (40, 60)), camera)
        )
        < 0.1
    )


def test_a_window_whose_cells_miss_all_that_is_known_scores_0():
    mask, known = (block(np.s_[1500, 1500 : 1500 + width], (3000, 3000)) for width in (1, 2))
    view, box = View(mask, FLAT.resized(3000, 3000), known > 0.5), (-0.5, -0.5, 2999.5, 2999.5)
    assert not in_window(_plate(), view, box).known.any()
    assert window_iou(_plate(), view, box) == 0.0


@st.composite
def _cases(draw):
    seed, count, size = (
        draw(st.integers(0, 1 << 30)),
        draw(st.integers(1, 60)),
        draw(st.sampled_from([7, 40, 300])),
    )
    rng = np.random.default_rng(seed)
    points = (
        rng.normal(size=(count, 3))
        * 10.0 ** draw(st.integers(-3, 2))
        * rng.uniform(0.0, 1.0, 3).round()
    )
    mask = np.zeros((size, size + draw(st.integers(0, 20))), np.float32)
    mask[tuple(rng.integers(0, mask.shape[i], 4 * size) for i in (0, 1))] = rng.uniform(
        0.0, 1.0, 4 * size
    )
    mask[0, 0], mask[-1, -1] = 1.0, 0.0
    camera = Camera.canonical(mask.shape[1], mask.shape[0])
    if draw(st.booleans()):
        camera = replace(camera, model="orthographic", K=camera.K * [[0.5], [0.5], [1.0]])
    known = rng.random(mask.shape) < 0.7
    known[0, 0] = known[-1, -1] = True
    return points, View(mask, camera, known if draw(st.booleans()) else None)


@settings(max_examples=60, deadline=None)
@given(_cases())
def test_of_any_cloud_and_mask_it_is_a_number_from_0_to_1_and_the_same_every_time(case):
    score = window_iou(*case)
    assert 0.0 <= score <= 1.0
    assert window_iou(case[0].copy(), case[1]) == score
