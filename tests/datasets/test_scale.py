"""Objects of ShapeNet's layouts get one size, and no picture changes by it."""

from dataclasses import replace

import numpy as np
import pytest

from tests.dataset_trees import (
    CHAIR,
    agreement,
    lopsided_points,
    write_clouds,
    write_r2n2,
    write_shapenet,
)
from tso_cli.datasets.items import Dataset
from tso_cli.datasets.opening import open_dataset
from tso_cli.datasets.scale import normalised, of_unit_diagonal


@pytest.fixture
def root(tmp_path):
    """Two chairs, and a third that has pictures and no 3D file."""
    write_r2n2(tmp_path / "ShapeNetRendering", ("abc", "def", "ghi"))
    write_clouds(tmp_path, "abc", "def")
    return tmp_path


def test_targets_are_centred_with_longest_side_1_and_still_fill_their_masks(root):
    for item in open_dataset(root).objects[:2]:
        points = item.target()
        np.testing.assert_allclose(np.ptp(points, axis=0).max(), 1.0, rtol=1e-6)
        np.testing.assert_allclose(points.max(0) + points.min(0), 0.0, atol=1e-6)
    raw, one = open_dataset(root, own_scale=True).objects[0], open_dataset(root).objects[0]
    np.testing.assert_array_equal(raw.target(), lopsided_points().astype(np.float32))
    assert agreement(one) == pytest.approx(agreement(raw), abs=0.01)


def test_the_layout_of_the_authors_is_scaled_alike(tmp_path):
    (item,) = open_dataset(write_shapenet(tmp_path)).objects
    np.testing.assert_allclose(np.ptp(item.target(), axis=0).max(), 1.0, rtol=1e-6)
    assert agreement(item) > 0.85


def test_objects_of_two_sizes_come_out_alike(root):
    """A shape twice as large, seen from twice as far, is the same item."""
    item = open_dataset(root, own_scale=True).objects[0]
    views = [
        replace(view, camera=replace(view.camera, t=2.0 * view.camera.t)) for view in item.views
    ]
    large = replace(item, name="large", views=views, target=lambda: 2.0 * item.target())
    one, other = normalised(Dataset([item, large], "both")).objects
    np.testing.assert_allclose(one.target(), other.target(), atol=1e-6)
    for ours, theirs in zip(one.views, other.views, strict=True):
        np.testing.assert_allclose(ours.camera.t, theirs.camera.t, rtol=1e-6)


def test_an_object_without_a_3d_file_takes_the_size_that_is_usual_for_its_category(root):
    data = open_dataset(root)
    known, lacking = data.objects[0], data.objects[2]
    assert lacking.target is None
    assert "ghi" in lacking.lacking
    assert "does not exist" in lacking.lacking
    # The pictures of the three are the same.
    np.testing.assert_allclose(lacking.views[0].camera.t, known.views[0].camera.t)
    assert agreement(replace(lacking, target=known.target)) > 0.85


def test_a_category_without_any_3d_file_takes_the_usual_size_of_the_others(root):
    (root / "ShapeNetRendering" / CHAIR).rename(root / "ShapeNetRendering" / "chairs")
    (root / "ShapeNet_pcl" / CHAIR).rename(root / "ShapeNet_pcl" / "chairs")
    write_r2n2(root / "ShapeNetRendering", ("car",))
    chair, other = (
        next(item for item in open_dataset(root).objects if item.category == name)
        for name in ("chairs", "chair")
    )
    assert other.target is None
    np.testing.assert_allclose(other.views[0].camera.t, chair.views[0].camera.t)


def test_shapes_that_have_lost_their_size_get_a_unit_diagonal_where_sizes_are_kept(root):
    raw = open_dataset(root, own_scale=True)
    one = of_unit_diagonal(normalised(raw)).objects[0]
    assert np.linalg.norm(np.ptp(one.target(), axis=0)) == pytest.approx(1.0, rel=1e-6)
    # ShapeNet's models have one from the start.
    np.testing.assert_allclose(
        one.views[0].camera.t, raw.objects[0].views[0].camera.t, rtol=0.05, atol=0.02
    )


def test_a_damaged_3d_file_does_not_stop_masks(root):
    (root / "ShapeNet_pcl" / CHAIR / "abc" / "pcl_1024_fps_trimesh.npy").write_bytes(b"no array")
    data = open_dataset(root)
    np.testing.assert_allclose(data.objects[0].views[0].camera.t, data.objects[1].views[0].camera.t)


def test_without_any_3d_file_everything_stays_in_its_own_scale(tmp_path):
    write_r2n2(tmp_path / "ShapeNetRendering")
    raw, same = (open_dataset(tmp_path, own_scale=own).objects[0] for own in (True, False))
    np.testing.assert_array_equal(raw.views[0].camera.t, same.views[0].camera.t)
    assert open_dataset(tmp_path).scale == "units of the data set"


def test_what_learns_from_points_leaves_out_objects_without_them(root):
    data = open_dataset(root).with_points()
    assert [item.name[-3:] for item in data.objects] == ["abc", "def"]
    assert list(data.skipped) == [f"{CHAIR}/ghi"]
