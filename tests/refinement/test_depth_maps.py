"""Depth maps that hold something else are left out, and those of known kinds are used."""

from dataclasses import replace

import numpy as np
import pytest

from tests.scenes import about, depth_of, example
from tso_cli import InputError, RefineConfig, View, refine
from tso_cli.diagnosis.depth_map import fitted
from tso_cli.refinement import depth_maps
from tso_cli.refinement.clock import Clock
from tso_cli.refinement.scene import as_scene

NAMES = "chair", "car", "airplane"
SCENES = {name: example(name) for name in NAMES}
DEPTHS = {name: depth_of(scene) for name, scene in SCENES.items()}
CHAIR, DEPTH = SCENES["chair"], DEPTHS["chair"]
WRONG = {
    "depth-inverse": 40.0 / DEPTH - 3.0,
    "depth-affine": 255.0 * (DEPTH - 0.99 * np.nanmin(DEPTH)),
    "depth-unit": 1000.0 * DEPTH,
}


def with_map(depth: np.ndarray, kind: str = "auto", name: str = "chair") -> View:
    return replace(SCENES[name].view, depth=depth, depth_kind=kind)


def of_maps(result) -> list[tuple[str, tuple[int, ...]]]:
    """What was found of depth maps, and in which views."""
    return [(one.name, one.views) for one in result.findings if one.name.startswith("depth-")]


@pytest.fixture(scope="module")
def by_mask():
    return refine(CHAIR.points, CHAIR.view)


@pytest.mark.parametrize("name", WRONG)
def test_with_a_wrong_map_the_result_is_that_of_the_mask_alone(by_mask, name):
    result = refine(CHAIR.points, with_map(WRONG[name]))
    assert of_maps(result) == [(name, (0,))]
    np.testing.assert_allclose(result.points, by_mask.points, atol=1e-12)
    assert result.trust.confidence == by_mask.trust.confidence
    assert result.trust.verdict == by_mask.trust.verdict


@pytest.mark.parametrize("name", NAMES)
def test_a_right_map_is_used_as_if_it_had_not_been_tested(name):
    tested, told = (
        refine(SCENES[name].points, with_map(DEPTHS[name], kind, name)) for kind in ("auto", "z")
    )
    assert of_maps(tested) == []
    np.testing.assert_array_equal(tested.points, told.points)


@pytest.mark.parametrize("name", NAMES)
def test_a_cloud_that_fits_its_mask_is_not_bent_to_a_map_that_is_shifted(name):
    """A shift alone is no sign of a wrong map, since a cloud may be as far out of place."""
    result = refine(SCENES[name].target, with_map(DEPTHS[name] + 0.25, name=name))
    assert of_maps(result) == [("depth-apart", (0,))]
    assert result.trust.verdict == "doubtful"
    assert "too far, or the cloud is as much too near" in result.trust.says
    np.testing.assert_array_equal(result.points, SCENES[name].target)


@pytest.mark.parametrize("times", [0.9, 1.1])
@pytest.mark.parametrize("name", NAMES)
def test_a_map_at_another_distance_does_not_draw_a_cloud_of_another_shape(name, times):
    scene = SCENES[name]
    result = refine(scene.points, with_map(times * DEPTHS[name], name=name))
    assert of_maps(result) == [("depth-apart", (0,))]
    np.testing.assert_array_equal(result.points, scene.points)


def test_a_map_that_contradicts_a_cloud_is_used_if_the_cloud_is_said_to_be_wrong():
    config = RefineConfig(accept_doubtful=True)
    result = refine(CHAIR.target, with_map(1.05 * DEPTH), config=config)
    assert result.trust.verdict == "doubtful"
    assert np.abs(result.points - CHAIR.target).max() > 0.01


def test_what_is_told_is_believed(by_mask):
    result = refine(CHAIR.points, with_map(2.0 + WRONG["depth-inverse"] / 20.0, "z"))
    assert of_maps(result) == []
    assert not np.array_equal(result.points, by_mask.points)


@pytest.mark.parametrize(
    ("name", "kind"), [("depth-inverse", "inverse"), ("depth-affine", "affine")]
)
def test_a_map_of_a_known_kind_brings_the_cloud_nearer_than_the_mask(by_mask, name, kind):
    result = refine(CHAIR.points, with_map(WRONG[name], kind))
    assert of_maps(result) == [("depth-fitted", (0,))]
    assert CHAIR.error(result.points) < 0.9 * CHAIR.error(by_mask.points)


def test_ctrl_c_in_the_second_fit_leaves_the_first(monkeypatch):
    scene = as_scene(CHAIR.points, with_map(WRONG["depth-affine"], "affine"))
    settings = RefineConfig().settings()
    cloud = scene.cloud.controlled(settings.points, scene.views)
    moved = cloud.control_points + [0.0, 0.0, 0.1]

    def interrupted(cloud, views, *rest):
        if views[0].depth is not None:
            raise KeyboardInterrupt
        return moved

    monkeypatch.setattr(depth_maps, "_begun", interrupted)
    (found,) = depth_maps.fit_maps(scene, cloud, settings, Clock()).views
    ((first,), _) = fitted(moved, scene.views)
    np.testing.assert_array_equal(found.depth, first.depth)


def test_distance_along_the_ray_gives_the_result_of_depth():
    row, column = np.indices(DEPTH.shape)
    at = np.stack([column, row, np.ones_like(row)], -1) @ np.linalg.inv(CHAIR.camera.K).T
    along = DEPTH * np.linalg.norm(at, axis=-1)
    results = [refine(CHAIR.points, view) for view in (with_map(along, "ray"), with_map(DEPTH))]
    np.testing.assert_allclose(results[0].points, results[1].points, atol=1e-9)


def test_each_view_has_a_map_of_its_own(by_mask):
    views = [
        with_map(DEPTH),
        with_map(WRONG["depth-unit"]),
        with_map(WRONG["depth-inverse"], "inverse"),
    ]
    result = refine(CHAIR.points, [replace(view, name=str(i)) for i, view in enumerate(views)])
    assert sorted(of_maps(result)) == [("depth-fitted", (2,)), ("depth-unit", (1,))]


# A cloud that is given elsewhere


def test_a_map_is_tested_where_the_masks_put_a_cloud_that_is_given_in_its_own_units():
    config = RefineConfig(move="similarity", steps=0)
    target, middle = CHAIR.target, CHAIR.target.mean(0)
    given = 30.0 * (target - middle) @ about("y", 6.0).T + middle
    right = refine(given, with_map(DEPTH), config=config)
    assert of_maps(right) == []
    assert right.move.size == pytest.approx(1.0 / 30.0, rel=0.05)
    wrong = refine(given, with_map(WRONG["depth-inverse"]), config=config)
    mask = refine(given, CHAIR.view, config=config)
    assert of_maps(wrong) == [("depth-inverse", (0,))]
    np.testing.assert_allclose(wrong.points, mask.points, atol=1e-12)


def test_a_map_that_seems_wrong_because_the_cloud_is_out_of_place_is_tested_again():
    # So far off that another unit is the likelier reading of the map where the cloud is given.
    eye = CHAIR.camera.position
    given = eye + 2.4 * (CHAIR.target - eye)
    result = refine(given, with_map(DEPTH), config=RefineConfig(move="similarity", steps=0))
    assert of_maps(result) == []
    assert CHAIR.error(result.points) < 0.001
    assert of_maps(refine(given, with_map(DEPTH), config=RefineConfig(move="shape"))) == [
        ("depth-unit", (0,))
    ]


def test_the_papers_preset_takes_no_map_whatever_it_holds():
    for depth in (DEPTH, *WRONG.values()):
        with pytest.raises(InputError, match="a depth map"):
            refine(CHAIR.points, with_map(depth), config=RefineConfig(preset="paper"))


@pytest.mark.parametrize("kind", ["depth", "disparity", ""])
def test_another_kind_is_refused(kind):
    with pytest.raises(InputError, match="kind of its depth map is .*, expected one of auto, z,"):
        with_map(DEPTH, kind)
