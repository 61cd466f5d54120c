"""The renders of ShapeNet made for 3D-R2N2."""

import numpy as np
import pytest
from PIL import Image

from tests import dataset_trees as trees
from tso_cli.datasets.r2n2 import open_r2n2, r2n2_camera


@pytest.fixture
def root(tmp_path):
    return trees.write_r2n2(tmp_path / "ShapeNetRendering", ("abc", "def"))


def pictures(root, name="abc"):
    return root / trees.CHAIR / name / "rendering"


@pytest.mark.parametrize("rotation", [0.0, 25.0])
def test_the_cloud_seen_by_the_cameras_covers_the_masks(tmp_path, rotation):
    root = trees.write_r2n2(tmp_path / "ShapeNetRendering", rotation=rotation)
    trees.write_clouds(tmp_path, "abc")
    (item,) = open_r2n2(root).objects
    assert (item.name, item.category, len(item.views)) == (f"{trees.CHAIR}/abc", "chair", 3)
    assert trees.agreement(item) > 0.85
    assert trees.agreement_of_surface(item, trees.lopsided()) > 0.98


@pytest.mark.parametrize("in_the_middle", [False, True])
def test_voxels_are_a_target_in_the_frame_of_the_cameras(tmp_path, in_the_middle):
    trees.write_r2n2(tmp_path / "ShapeNetRendering")
    trees.write_binvox(
        tmp_path / "ShapeNetVox32" / trees.CHAIR / "abc" / "model.binvox", in_the_middle
    )
    (item,) = open_r2n2(tmp_path).objects
    assert trees.agreement(item) > 0.8
    points = item.target()
    assert points.shape == (1024, 3)
    np.testing.assert_array_equal(points, item.target())
    # The voxels reach at most one of them, a 32nd of the longest side, beyond the object.
    true = trees.lopsided_points()
    extent = np.ptp(true, axis=0)
    np.testing.assert_allclose(np.ptp(points, axis=0), extent, atol=extent.max() / 16)
    np.testing.assert_allclose(points.max(0) + points.min(0), 0.0, atol=extent.max() / 16)


def test_clouds_go_before_voxels_and_neither_is_needed(root):
    assert [item.target for item in open_r2n2(root).objects] == [None, None]
    trees.write_binvox(root.parent / "ShapeNetVox32" / trees.CHAIR / "abc" / "model.binvox", True)
    trees.write_clouds(root.parent, "abc")
    np.testing.assert_array_equal(
        open_r2n2(root).objects[0].target(), trees.lopsided_points().astype(np.float32)
    )


def test_a_name_in_the_list_cannot_lead_out_of_the_folder(root):
    (root / "secret.png").write_bytes((pictures(root) / "00.png").read_bytes())
    (pictures(root) / "renderings.txt").write_text("../../../secret.png\n01.png\n")
    data = open_r2n2(root)
    assert [view.name[-6:] for view in data.objects[0].views] == ["01.png"]
    assert len(data.skipped) == 1


def test_the_mask_is_the_alpha_channel_soft_edges_and_all(root):
    pixels = np.zeros((64, 64, 4), dtype=np.uint8)
    pixels[5, 7] = 10, 20, 30, 51
    Image.fromarray(pixels).save(pictures(root) / "01.png")
    image, mask = open_r2n2(root).objects[0].views[1].load()
    assert mask[5, 7] == np.float32(0.2)
    assert mask.sum() == mask[5, 7]
    assert image[5, 7].tolist() == [10, 20, 30]


def test_lines_of_the_table_belong_to_the_listed_names_else_to_the_numbers(tmp_path):
    root = trees.write_r2n2(tmp_path, listed=False)
    for names in (["00.png", "01.png", "02.png"], ["02.png", "00.png", "01.png"]):
        cameras = {view.name[-6:]: view.camera for view in open_r2n2(root).objects[0].views}
        for name, angles in zip(names, trees.ANGLES, strict=True):
            np.testing.assert_allclose(cameras[name].R, r2n2_camera(*angles, 1.0, (64, 64)).R)
        (pictures(root) / "renderings.txt").write_text("02.png\n00.png\n01.png\n")


def test_the_focal_length_is_35_of_a_sensor_of_32_whatever_the_field_of_view_says():
    camera = r2n2_camera(0.0, 0.0, 0.8, (137, 137))
    assert camera.K[0, 0] == pytest.approx(35 / 32 * 137)
    assert camera.K[0, 2] == 68.0
    np.testing.assert_allclose(-camera.R.T @ camera.t, [1.4, 0.0, 0.0], atol=1e-12)
