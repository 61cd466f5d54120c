"""Which view of a camera file belongs to which mask."""

import pytest

from tso_cli.errors import InputError
from tso_cli.geometry.camera import Camera
from tso_cli.io.cameras import CameraRecord, write_cameras
from tso_cli.io.pairing import named_masks, pair_with_masks


@pytest.fixture
def save(tmp_path):
    """Write a camera file whose view number i has width 10 + i and names the i-th of the masks (None: no mask)."""

    def write(*masks):
        cameras = [Camera.canonical(10 + i, 8) for i in range(len(masks))]
        records = [CameraRecord(c, m and tmp_path / m) for c, m in zip(cameras, masks, strict=True)]
        write_cameras(tmp_path / "views.json", records, overwrite=True)
        return tmp_path / "views.json"

    return write


def _order(path, *masks, folder=""):
    return [camera.width - 10 for camera in pair_with_masks(path, [path.parent / folder / mask for mask in masks])]


def test_masks_that_are_named_find_their_views_in_whatever_order(save):
    path = save("a.png", "b.png", "c.png")
    assert _order(path, "c.png", "a.png", "b.png") == [2, 0, 1]
    assert _order(path, "c.png", "b.png") == [2, 1]
    assert _order(path, "c.png", "a.png", folder="moved") == [2, 0]
    assert _order(save("1/mask.png", "2/mask.png"), "2/mask.png", "1/mask.png") == [1, 0]


def test_views_that_name_no_mask_are_taken_in_their_order(save, recwarn):
    assert _order(save(None, None, None), "c.png", "a.png", "b.png") == [0, 1, 2]
    assert not recwarn.list


def test_views_that_name_other_masks_are_taken_in_their_order_with_a_warning(save):
    with pytest.warns(UserWarning, match=r"views\[1\] names the mask .*b\.png, used for .*other\.png"):
        assert _order(save("a.png", "b.png"), "a.png", "other.png") == [0, 1]


def test_another_number_of_masks_than_views_is_refused_with_both_counts(save):
    with pytest.raises(InputError, match=r"views\.json: holds 3 views, found 2 masks; expected as many"):
        _order(save(None, None, None), "a.png", "b.png")


def test_an_order_that_contradicts_the_names_is_refused(save):
    with pytest.raises(InputError, match=r"b\.png is named by views\[1\] and given at place 0, expected the same order"):
        _order(save("a.png", "b.png", "c.png"), "b.png", "a.png", "other.png")


def test_the_masks_that_the_views_name_are_listed_relative_to_the_file(save):
    path = save("b.png", "in/a.png")
    assert named_masks(path) == [path.parent / "b.png", path.parent / "in" / "a.png"]
    with pytest.raises(InputError, match=r"views\.json: views\[1\] of 2 names no mask"):
        named_masks(save("a.png", None))
