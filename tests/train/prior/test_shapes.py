"""The shapes that a prior learns from."""

import shutil
from collections import Counter

import numpy as np
import pytest

from tso_cli.errors import InputError
from tso_cli.io.meshes import Mesh, write_mesh
from tso_cli.io.shipped import examples_folder
from tso_cli.train.prior import shapes as module
from tso_cli.train.prior.neighbours import find_neighbours
from tso_cli.train.prior.shapes import ShapeSet, mirror_axis, read_shapes

MESHES = examples_folder() / "meshes"
CHAIRS = ("q17_Chair", "q19_Chair")


@pytest.fixture
def folder(tmp_path):
    """Two chairs in a folder of their own category."""
    (tmp_path / "chair").mkdir()
    for name in CHAIRS:
        shutil.copy(MESHES / "chair" / f"{name}.ply", tmp_path / "chair")
    return tmp_path


def test_shapes_are_centred_and_their_longest_side_is_1(shapes):
    for shape in shapes.shapes:
        low, high = shape.vertices.min(0), shape.vertices.max(0)
        np.testing.assert_allclose(low + high, 0.0, atol=1e-6)
        assert (high - low).max() == pytest.approx(1.0)
        assert (np.abs(shape.samplings) <= 0.5 + 1e-6).all()


def test_every_category_is_drawn_and_a_large_one_does_not_drown_the_others(shapes):
    chances = shapes.chances()
    of_category = Counter()
    for shape, chance in zip(shapes.shapes, chances, strict=True):
        of_category[shape.category] += chance
    assert chances.sum() == pytest.approx(1.0)
    # 10 chairs and 5 aeroplanes.
    assert of_category["chair"] / of_category["airplane"] == pytest.approx(2.0**0.5)


def test_variants_share_the_chance_of_their_kind(shapes):
    first, second, third = shapes.shapes[:3]
    pair = [vars(first) | {"kind": "airplane/fg_1", "name": name} for name in ("a", "b")]
    three = ShapeSet([*(type(first)(**values) for values in pair), second])
    np.testing.assert_allclose(three.chances(), [0.25, 0.25, 0.5])


def test_cars_have_their_mirror_plane_across_x(shapes):
    axes = Counter(shape.mirror_axis for shape in shapes.shapes if shape.category == "car")
    assert axes[0] >= 8


def test_a_shape_is_turned_and_so_is_its_mirror_axis(shapes):
    car = next(shape for shape in shapes.shapes if shape.category == "car")
    assert mirror_axis(car.samplings[0]) == 0
    assert mirror_axis(car.samplings[0][:, [2, 1, 0]]) == 2


def test_meshes_right_in_the_folder_are_one_category_of_its_name(folder):
    assert {shape.category for shape in read_shapes(folder / "chair").shapes} == {"chair"}


def test_a_broken_mesh_is_left_out_and_named(folder):
    (folder / "chair" / "broken.ply").write_bytes(b"ply\nnothing")
    found = read_shapes(folder)
    assert [shape.name for shape in found.shapes] == [f"chair/{name}" for name in CHAIRS]
    assert list(found.skipped) == [str(folder / "chair" / "broken.ply")]
    with pytest.raises(InputError, match=r"broken\.ply"):
        read_shapes(folder, strict=True)


def test_a_mesh_with_too_many_faces_is_left_out(folder, monkeypatch):
    monkeypatch.setattr(module, "MOST_FACES", 10)
    with pytest.raises(InputError, match="no category can be learned from.*at most 10; simplify"):
        read_shapes(folder)


def test_meshes_of_one_name_in_folders_of_their_own_are_different_objects(tmp_path):
    for name in CHAIRS:
        (tmp_path / "chair" / name / "models").mkdir(parents=True)
        mesh = tmp_path / "chair" / name / "models" / "model_normalized.ply"
        shutil.copy(MESHES / "chair" / f"{name}.ply", mesh)
    names = [f"chair/{name}/models/model_normalized" for name in CHAIRS]
    assert [shape.name for shape in read_shapes(tmp_path).shapes] == names


def test_one_mesh_is_too_few(folder):
    (folder / "chair" / "q17_Chair.ply").unlink()
    with pytest.raises(InputError, match="has 1 usable objects of the category 'chair'"):
        read_shapes(folder)


def test_variants_of_one_object_are_too_few(folder):
    for name, variant in zip(CHAIRS, ("fg_767_763", "fg_767_767"), strict=True):
        (folder / "chair" / f"{name}.ply").rename(folder / "chair" / f"{variant}.ply")
    with pytest.raises(InputError, match="expected 2 at least"):
        read_shapes(folder)


def test_a_category_is_left_out_on_request():
    found = read_shapes(MESHES, without=["car", "chair"])
    assert {shape.category for shape in found.shapes} == {"airplane"}
    with pytest.raises(InputError, match="no category 'cars' to leave out.*airplane, car, chair"):
        read_shapes(MESHES, without=["cars"])


def test_neighbours_are_of_the_category_but_of_another_kind_nearest_first(shapes):
    kept = shapes.shapes
    neighbours = find_neighbours(kept, np.random.default_rng(0))
    for number, shape in enumerate(kept):
        row = neighbours.order[number]
        others = [kept[index] for index in row[row >= 0]]
        assert {other.category for other in others} == {shape.category}
        assert shape.kind not in {other.kind for other in others}
        assert 1 <= neighbours.near[number] <= neighbours.eligible[number] <= len(others)
    truth, nearest = kept[0], kept[neighbours.order[0, 0]]
    farthest = kept[neighbours.order[0][neighbours.order[0] >= 0][-1]]
    squared = [
        np.square(truth.samplings[0][:, None] - other.samplings[0]).sum(2).min(1).mean()
        for other in (nearest, farthest)
    ]
    assert squared[0] < squared[1]


def test_in_a_large_category_a_shape_is_compared_with_some(shapes, monkeypatch):
    monkeypatch.setattr("tso_cli.train.prior.neighbours.MOST_COMPARED", 3)
    neighbours = find_neighbours(shapes.shapes, np.random.default_rng(0))
    assert neighbours.order.shape[1] == 3
    assert (neighbours.order >= 0).all()


def test_a_flat_mesh_is_a_shape(folder):
    square = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    write_mesh(folder / "chair" / "flat.ply", Mesh(square, np.array([[0, 1, 2], [0, 2, 3]])))
    assert "chair/flat" in {shape.name for shape in read_shapes(folder).shapes}
