"""ShapeNet in the layout of the CAPNet authors."""

import numpy as np
import pytest
from PIL import Image

from tests import dataset_trees as trees
from tests.corruption import assert_refused
from tests.scenes import block
from tso_cli.datasets import common
from tso_cli.datasets.shapenet import open_shapenet, shapenet_camera


@pytest.fixture
def root(tmp_path):
    return trees.write_shapenet(tmp_path / "data", ("abc", "def"))


def model(root, name="abc"):
    return root / "ShapeNet_rendered" / trees.CHAIR / name


@pytest.mark.parametrize(("azimuth", "elevation"), [(0.0, 0.0), (-110.0, -15.0)])
def test_a_point_lands_where_the_formula_of_the_authors_code_puts_it(azimuth, elevation):
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (50, 3))
    x = trees.authors_points(points, azimuth, elevation)
    rows, columns = 120.0 * x[:, :2].T / np.abs(x[:, 2]) + 32.0
    pixels, depth = shapenet_camera(azimuth, elevation, (64, 64)).project(points)
    # Theirs is half a pixel off the middle of the image.
    np.testing.assert_allclose(pixels, np.stack([columns, rows], axis=1) - 0.5, atol=1e-9)
    np.testing.assert_allclose(depth, -x[:, 2], atol=1e-12)


@pytest.mark.parametrize("clouds", ["ShapeNet_pcl", "ShapeNet_v1_pcl"])
def test_the_cloud_seen_by_the_cameras_covers_the_masks(tmp_path, clouds):
    (item,) = open_shapenet(trees.write_shapenet(tmp_path, clouds=clouds)).objects
    assert (item.name, item.category, len(item.views)) == (f"{trees.CHAIR}/abc", "chair", 3)
    assert trees.agreement(item) > 0.85
    assert trees.agreement_of_surface(item, trees.lopsided()) > 0.98
    np.testing.assert_array_equal(item.target(), trees.lopsided_points().astype(np.float32))


def test_the_object_is_what_is_nearer_than_254_and_the_picture_keeps_its_colours(root):
    Image.fromarray(np.uint8(254 - block(np.s_[10:20, 30:40]))).save(model(root) / "depth_1.png")
    image, mask = open_shapenet(root).objects[0].views[1].load()
    assert mask.sum() == 100
    assert mask[10:20, 30:40].all()
    np.testing.assert_array_equal(
        image, np.asarray(Image.open(model(root) / "render_1.png"))[..., :3]
    )


def test_pictures_of_any_size_have_the_camera_for_it(tmp_path):
    (item,) = open_shapenet(trees.write_shapenet(tmp_path, size=96)).objects
    assert item.views[0].camera.width == 96
    assert item.views[0].camera.K[0, 0] == 180.0
    assert trees.agreement(item) > 0.85


def test_two_columns_will_do_and_a_distance_counts(tmp_path):
    plain = open_shapenet(trees.write_shapenet(tmp_path, columns=2)).objects[0].views[1].camera
    np.testing.assert_allclose(plain.t, [0, 0, 2])
    (model(tmp_path) / "view.txt").write_text("10 20 0 2.5\n" * 3)
    assert open_shapenet(tmp_path).objects[0].views[2].camera.t[2] == 2.5


def test_only_the_first_picture_of_a_category_is_read_on_opening(root, monkeypatch):
    reads = []
    original = common.read_image
    monkeypatch.setattr(common, "read_image", lambda path: (reads.append(path), original(path))[1])
    data = open_shapenet(root / "ShapeNet_rendered")
    assert [path.name for path in reads] == ["depth_0.png"]
    assert [item.name for item in data.objects] == [f"{trees.CHAIR}/abc", f"{trees.CHAIR}/def"]


def test_a_category_without_any_readable_picture_is_left_out(root):
    for path in model(root).parent.rglob("depth_*.png"):
        path.write_bytes(b"not a picture")
    assert_refused(
        r"no object can be used, the first: .*abc: no picture of the category can be read",
        open_shapenet,
        root,
    )
