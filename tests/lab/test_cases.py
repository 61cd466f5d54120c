"""Cases to refine: where their starts are from, and what their masks show."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest

from tso_cli.errors import InputError
from tso_cli.evaluation.metrics import chamfer
from tso_cli.io.checkpoints import load_network
from tso_cli.io.meshes import read_mesh
from tso_cli.render.folder import ground_truth
from tso_cli.render.normalise import normalise
from tso_cli.render.settings import RenderSettings
from tso_cli.render.viewpoints import fitting_distance
from tso_lab.studies.cases import LEVELS, MASKS, CaseBuilder
from tso_lab.studies.shapes import shapes_of_part

from .studying import MESHES, TRAIN, thin_checkpoint


@pytest.fixture(scope="module")
def builder(split):
    return CaseBuilder(MESHES, split, views=2, size=64, points=1024)


@pytest.fixture(scope="module")
def shapes(split):
    return {shape.category: shape for shape in shapes_of_part(MESHES, split)}


@pytest.fixture(scope="module")
def cars(builder, shapes):
    """The cases of the car, by kind."""
    kinds = ("other", "turned", "near", "cut")
    return {kind: builder.cases(shapes["car"], kind) for kind in kinds}


def on_mask(case) -> float:
    """Share of the truth that falls on its mask, give or take a pixel."""
    view = case.views[0]
    pixels = np.rint(view.camera.project(case.target)[0]).astype(int)
    inside = ((pixels >= 0) & (pixels < [view.camera.width, view.camera.height])).all(1)
    near = view.mask.copy()
    for axis in (0, 1):
        near = np.maximum(near, np.maximum(np.roll(near, 1, axis), np.roll(near, -1, axis)))
    return float((near[pixels[inside, 1], pixels[inside, 0]] > 0.5).mean())


def border(mask) -> bool:
    return bool((mask[[0, -1]] > 0.5).any() or (mask[:, [0, -1]] > 0.5).any())


def distances_of(names, target) -> dict[str, float]:
    """Chamfer distance of samplings of training shapes to a target."""
    meshes = {name: normalise(read_mesh(MESHES / f"{name}.ply")) for name in names}
    clouds = {
        name: ground_truth(mesh, RenderSettings(), np.random.default_rng(0))[1]
        for name, mesh in meshes.items()
    }
    return {name: chamfer(cloud, target).chamfer for name, cloud in clouds.items()}


@pytest.mark.slow
def test_the_start_is_the_training_shape_nearest_to_the_categorys_level_or_the_most_similar(
    builder, shapes, cars
):
    for kind in ("other", "near"):
        case = cars[kind][0]
        away = {
            name: abs(d - LEVELS[kind]["car"])
            for name, d in distances_of(TRAIN[:3], case.target).items()
        }
        # Another sampling of a shape is a little nearer or further.
        assert away[case.start] <= min(away.values()) + 1e-4
    case = builder.cases(shapes["chair"], "other")[0]
    distances = distances_of(TRAIN[3:5], case.target)
    assert case.start == min(distances, key=distances.get)


@pytest.mark.slow
def test_a_training_shape_starts_from_one_of_another_type(builder, split, tmp_path):
    chair = shapes_of_part(MESHES, split, "train", ["chair"])[1]
    assert (chair.name, builder.cases(chair, "other")[0].start) == (TRAIN[4], TRAIN[3])
    # Two files of one type: `fg_ka50_black` and `fg_ka50_red`.
    for name, source in (
        ("fg_ka50_black", TRAIN[4]),
        ("fg_ka50_red", TRAIN[4]),
        ("kfurn_chair", TRAIN[3]),
    ):
        (tmp_path / "chair").mkdir(exist_ok=True)
        shutil.copy(MESHES / f"{source}.ply", tmp_path / "chair" / f"{name}.ply")
    names = ["chair/fg_ka50_black", "chair/fg_ka50_red", "chair/kfurn_chair"]
    lists = tmp_path / "split.json"
    lists.write_text(json.dumps({"train": names}))
    black = shapes_of_part(tmp_path, lists, "train")[0]
    assert CaseBuilder(tmp_path, lists, 1, 64, 1024).cases(black, "other")[0].start == names[2]
    lists.write_text(json.dumps({"train": names[:2]}))
    with pytest.raises(
        InputError, match="fg_ka50_black: no chair of another type is in the list train"
    ):
        CaseBuilder(tmp_path, lists, 1, 64, 1024).cases(black, "other")


@pytest.mark.slow
def test_the_whole_object_is_seen_unless_it_is_to_be_truncated(cars, shapes):
    vertices = normalise(read_mesh(shapes["car"].path)).vertices
    for case in cars["other"]:
        assert not any(border(view.mask) for view in case.views)
        assert on_mask(case) > 0.99
    for case in cars["cut"]:
        for view in case.views:
            assert border(view.mask)
            assert view.camera.t[2] == pytest.approx(0.75 * fitting_distance(vertices, view.camera))
        assert on_mask(case) > 0.99


@pytest.mark.slow
def test_a_turned_case_is_the_same_world_at_an_angle_to_its_axes(cars, builder, shapes):
    for plain, turned in zip(cars["other"], cars["turned"], strict=True):
        assert on_mask(turned) > 0.99
        for one, other in zip(plain.views, turned.views, strict=True):
            np.testing.assert_array_equal(one.mask, other.mask)
            np.testing.assert_allclose(
                one.camera.project(plain.initial)[0],
                other.camera.project(turned.initial)[0],
                atol=1e-9,
            )
        distances = [chamfer(case.initial, case.target).chamfer for case in (plain, turned)]
        assert distances[0] == pytest.approx(distances[1])
        # The axes of the cloud are not those of the world.
        R = plain.views[0].camera.R.T @ turned.views[0].camera.R
        assert np.abs(R).max() < 0.999
    again = builder.cases(shapes["car"], "turned")[0]
    np.testing.assert_array_equal(again.initial, cars["turned"][0].initial)


@pytest.mark.slow
def test_a_start_that_is_right_is_another_sampling_of_the_truth_and_the_floor_its_distance(
    builder, shapes, cars
):
    case = builder.cases(shapes["car"], "right")[0]
    assert case.start == "the truth"
    assert chamfer(case.initial, case.target).chamfer == pytest.approx(case.floor)
    assert not np.array_equal(case.initial, case.target)
    far = cars["other"][0]
    assert 2e-4 < far.floor < 0.6 * chamfer(far.initial, far.target).chamfer


@pytest.mark.slow
def test_a_case_depends_on_the_seed_alone(cars, split, shapes):
    first, same = cars["cut"]
    assert len(first.views) == len(same.views) == MASKS
    assert first.views[1] is same.views[0]
    again, other = (
        CaseBuilder(MESHES, split, 2, 64, 1024, seed).cases(shapes["car"], "cut")[1]
        for seed in (0, 1)
    )
    np.testing.assert_array_equal(again.initial, same.initial)
    np.testing.assert_array_equal(again.views[0].mask, same.views[0].mask)
    assert not np.array_equal(other.views[0].mask, same.views[0].mask)


@pytest.mark.slow
def test_a_networks_case_is_in_the_axes_of_a_camera_that_stands_where_it_stood(
    split, shapes, tmp_path, monkeypatch
):
    network, about = load_network(thin_checkpoint(tmp_path, monkeypatch, 1024))
    builder = CaseBuilder(MESHES, split, 2, 64, 1024, 0, network, about)
    for case in builder.cases(shapes["car"], "network"):
        assert len(case.views) == MASKS
        assert case.views[0].mask.shape == (64, 64)
        # The turned truth falls on the masks of the crop and of the other cameras.
        for view in case.views:
            assert on_mask(replace(case, views=(view,))) > 0.99
        assert chamfer(case.target, case.dense).backward == 0.0
        left, top, right, bottom = case.views[0].box()
        pixels = case.views[0].camera.project(case.target)[0]
        assert (
            np.abs([*(pixels.min(0) - [left, top]), *(pixels.max(0) - [right, bottom])]).max() < 2.0
        )
