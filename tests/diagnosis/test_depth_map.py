"""What a depth map holds is told by the cloud, and kinds that are known are brought to depth."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import binary_erosion
from scipy.stats import spearmanr

from tests.scenes import Example, block, depth_of, example
from tso_cli import Camera, View
from tso_cli.diagnosis.depth_map import SeenSurface, along_z, fitted, line, wrong_maps

from .common import EXAMPLES

SCENES = {name: example(name) for name in EXAMPLES}
DEPTHS = {name: depth_of(scene) for name, scene in SCENES.items()}
CHAIR = SCENES["chair"]


def with_map(name: str, depth: np.ndarray, kind: str = "auto") -> View:
    return replace(SCENES[name].view, depth=depth, depth_kind=kind)


def starts(scene: Example) -> dict[str, np.ndarray]:
    """Clouds for which the map of the scene is right."""
    noise = np.random.default_rng(0).normal(0.0, 0.01, scene.target.shape)
    return {
        "the truth": scene.target,
        "another shape": scene.points,
        "noisy": scene.target + noise,
        "farther": scene.points + 0.3 * scene.camera.R[2],
        "aside": scene.points + 0.1 * scene.camera.R[0],
        "larger": 1.2 * scene.points,
    }


def held(points: np.ndarray, view: View) -> str:
    return SeenSurface.of(points, view).contents()


# What a map holds


@pytest.mark.parametrize("start", starts(CHAIR))
@pytest.mark.parametrize("name", EXAMPLES)
def test_a_right_map_is_not_suspected(name, start):
    view = with_map(name, DEPTHS[name])
    points = starts(SCENES[name])[start]
    assert held(points, view) == "z"
    holes = np.random.default_rng(0).random(view.mask.shape) < 0.7
    assert held(points, replace(view, depth=np.where(holes, np.nan, view.depth))) == "z"
    assert wrong_maps(points, [view]) == []


@given(scale=st.floats(1e-2, 1e4), shift=st.floats(-0.9, 0.9))
def test_inverse_depth_is_named_whatever_its_two_numbers_are(scale, shift):
    inverse = 1.0 / DEPTHS["chair"]
    view = with_map("chair", scale * (inverse + shift * np.nanmin(inverse)))
    assert held(CHAIR.target, view) == "inverse"


@pytest.mark.parametrize("name", EXAMPLES)
@pytest.mark.parametrize("most", [1.0, 255.0, 65535.0])
def test_depth_from_0_to_a_largest_value_is_named_affine(name, most):
    depth = DEPTHS[name]
    low, high = np.nanmin(depth), np.nanmax(depth)
    view = with_map(name, most * (depth - low) / (high - low))
    assert held(SCENES[name].points, view) == "affine"


@pytest.mark.parametrize("name", EXAMPLES)
@pytest.mark.parametrize("times", [1e-3, 0.2, 10.0, 1e3, 5e3])
def test_another_unit_is_named_with_its_factor(name, times):
    view = with_map(name, times * DEPTHS[name])
    (finding,) = wrong_maps(SCENES[name].points, [CHAIR.view, view])
    assert finding.name == "depth-unit"
    assert finding.views == (1,)
    assert finding.values["times"] == pytest.approx(times, rel=0.1)
    # A cloud of unknown size has an unknown unit.
    assert wrong_maps(SCENES[name].points, [view], any_size=True) == []


def wall(fov: float) -> tuple[np.ndarray, View]:
    """A wavy wall that fills the picture of a camera of this field of view, and its depth."""
    focal = 32.0 / np.tan(np.radians(fov) / 2.0)
    K = np.array([[focal, 0.0, 31.5], [0.0, focal, 31.5], [0.0, 0.0, 1.0]])
    camera = Camera(K, np.eye(3), np.zeros(3), 64, 64)
    row, column = np.indices((64, 64))
    depth = (1.0 + 0.2 * np.sin(row / 5.0) * np.cos(column / 7.0)) * focal / 32.0
    at = np.stack([column, row, np.ones_like(row)], -1) @ np.linalg.inv(K).T
    mask = block(np.s_[1:63, 1:63])
    points = (at * depth[..., None])[mask > 0.5]
    return points[np.random.default_rng(0).permutation(len(points))[:1024]], View(
        mask, camera, depth=depth
    )


def test_distance_along_the_ray_is_named_with_a_wide_field_of_view_alone():
    found = {}
    for fov in (10.0, 90.0):
        points, view = wall(fov)
        rough = points + np.random.default_rng(0).normal(0.0, 0.02, points.shape)
        assert held(rough, view) == "z"
        rays = view.camera.ray_lengths(*np.indices(view.mask.shape))
        found[fov] = held(rough, replace(view, depth=view.depth * rays))
    assert found == {10.0: "z", 90.0: "ray"}


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_dense_map_that_is_known_on_a_small_part_of_the_mask_is_of_something_else(name):
    depth, mask = DEPTHS[name], SCENES[name].mask > 0.5
    filled = np.cumsum(mask.sum(0)) / mask.sum()
    found = {
        share: held(SCENES[name].points, with_map(name, np.where(filled < share, depth, np.nan)))
        for share in (0.5, 0.8)
    }
    assert found == {0.5: "unrelated", 0.8: "z"}


def test_a_map_whose_relief_is_not_the_clouds_is_of_something_else():
    rng = np.random.default_rng(0)
    stripes = 2.7 + np.where(rng.random(256) < 0.5, -1.2, 1.2) * np.ones((256, 1))
    finding = wrong_maps(CHAIR.points, [with_map("chair", stripes)])[0]
    assert finding.name == "depth-unrelated"
    assert "does not fit the cloud or is of another picture" in finding.says


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_map_without_relief_is_of_something_else(name):
    scene = SCENES[name]
    assert held(scene.points, with_map(name, np.full(scene.mask.shape, 2.0))) == "unrelated"


def test_a_flat_or_small_object_tells_nothing_but_another_unit():
    camera = Camera.canonical(64, 64)
    rng = np.random.default_rng(0)
    flat = rng.uniform(-0.3, 0.3, (1000, 3)) * [1.0, 1.0, 0.1]
    slope = 2.0 + 0.3 * np.linspace(-1.0, 1.0, 64) * np.ones((64, 1))
    view = View(block(np.s_[16:48, 16:48]), camera, depth=slope)
    few = View(block(np.s_[30:34, 30:34]), camera, depth=slope)
    deep = rng.uniform(-0.05, 0.05, (1000, 3)) * [1.0, 1.0, 8.0]
    for points, some in ((flat, view), (deep, few)):
        assert held(points, some) == "z"
        assert held(points, replace(some, depth=1.0 / slope)) == "unit"


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_rank_correlation_is_spearmans(name):
    surface = SeenSurface.of(SCENES[name].points, with_map(name, DEPTHS[name].round(1)))
    assert surface.rank == pytest.approx(spearmanr(surface.values, surface.depth).statistic)


# Known kinds


def test_distance_along_the_ray_becomes_depth_exactly():
    view = with_map("chair", DEPTHS["chair"])
    row, column = np.indices(view.mask.shape)
    at = np.stack([column, row, np.ones_like(row)], -1) @ np.linalg.inv(view.camera.K).T
    distance = np.linalg.norm(at * view.depth[..., None], axis=-1)
    found = along_z(replace(view, depth=distance, depth_kind="ray"))
    np.testing.assert_allclose(found.depth, view.depth, rtol=1e-12)
    assert found.depth_kind == "z"


@given(scale=st.floats(1e-2, 1e4), shift=st.floats(-5.0, 5.0), inverse=st.booleans())
def test_two_unknown_numbers_are_found_where_the_cloud_is_right(scale, shift, inverse):
    depth = DEPTHS["chair"]
    related = 1.0 / depth if inverse else depth
    kind = "inverse" if inverse else "affine"
    view = with_map("chair", scale * (related + shift), kind)
    (found,), (finding,) = fitted(CHAIR.target, [view])
    assert finding.name == "depth-fitted"
    assert finding.values["scale"] == pytest.approx(1.0 / scale, rel=0.1)
    assert np.nanmedian(np.abs(found.depth - depth)) < 0.01
    assert found.depth_kind == "z"


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_fit_to_another_shape_lies_near_the_true_surface(name):
    view = with_map(name, 255.0 / DEPTHS[name] - 30.0, "inverse")
    (found,), _ = fitted(SCENES[name].points, [view])
    assert np.nanmedian(np.abs(found.depth - DEPTHS[name])) < 0.06


def test_a_map_that_rises_where_its_kind_falls_is_left_out():
    view = with_map("chair", DEPTHS["chair"], "inverse")
    (found,), (finding,) = fitted(CHAIR.points, [view])
    assert found.depth is None
    assert finding.name == "depth-unfitted"
    assert not finding.suspicious


def test_a_line_is_that_of_least_squares_or_of_most_pairs():
    rng = np.random.default_rng(0)
    x = rng.uniform(0.0, 5.0, 300)
    exact = 0.3 * x + 2.0
    assert line(x, exact) == pytest.approx((0.3, 2.0))
    strays = rng.random(300) < 0.3
    found = line(x, np.where(strays, 4.0, exact + rng.normal(0.0, 0.01, 300)))
    assert found == pytest.approx((0.3, 2.0), abs=0.01)


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_map_whose_border_mixes_object_and_background_is_not_suspected(name):
    view, depth = SCENES[name].view, DEPTHS[name]
    border = view.inside & ~binary_erosion(view.inside, iterations=2)
    mixed = np.where(
        border, depth + np.linspace(0.3, 3.0, border.size).reshape(border.shape), depth
    )
    assert held(SCENES[name].points, with_map(name, mixed)) == "z"
