"""Which camera each mask gets, from files of tso and of other programs, and what the run says."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.corruption import assert_refused
from tso_cli.io.cameras import find_camera
from tso_cli.io.views import ViewFiles, load_views, summary_of

FILES = Path(__file__).parent / "files"


@pytest.fixture
def masks(tmp_path):
    """Four masks, named like the pictures of the COLMAP model and told apart by their columns."""

    def write(*names, size=(256, 256)):
        paths = []
        for number, name in enumerate(names):
            array = np.zeros(size[::-1], np.uint8)
            array[10:20, 10 : 20 + number] = 255
            path = tmp_path / name
            path.parent.mkdir(exist_ok=True)
            Image.fromarray(array).save(path, format="PNG")
            paths.append(path)
        return paths

    return write


def test_masks_find_their_views_by_the_names_of_the_pictures(masks):
    names = ["masks/002.png.png", "masks/000.png.png"]
    views, origins = load_views(ViewFiles(masks(*names), FILES / "colmap"))
    truth = json.loads((FILES / "colmap/truth.json").read_text())["views"]
    for view, number in zip(views, (2, 0), strict=True):
        np.testing.assert_allclose(view.camera.R, truth[number]["R"], atol=1e-9)
    assert [origin.view for origin in origins] == ["002.png", "000.png"]
    assert str(origins[0]) == f"{FILES / 'colmap'} (a COLMAP model; 002.png)"
    assert summary_of(origins) == f"cameras of {FILES / 'colmap'} (a COLMAP model)"


def test_other_names_take_the_views_in_their_order_and_the_run_says_so(masks):
    paths = masks("a.png", "b.png", "c.png", "d.png")
    _, origins = load_views(ViewFiles(paths, FILES / "colmap"))
    assert [origin.view for origin in origins] == ["000.png", "001.png", "002.png", "003.png"]
    assert summary_of(origins).endswith("(a COLMAP model; views in the order of the masks)")
    assert_refused(
        r"none of its 4 views \(000\.png, .*\) names the mask .*a\.png, expected one",
        load_views,
        ViewFiles(paths[:2], FILES / "colmap"),
    )
    assert_refused(
        r"none of its 4 views \(000\.png, .*\) names the mask .*a\.png, expected one; name the",
        load_views,
        ViewFiles(paths[:1], FILES / "colmap"),
    )


def test_K_of_a_larger_picture_is_scaled_to_the_mask_and_the_run_says_so(masks):
    (mask,) = masks("000.png", size=(128, 128))
    (view,), (origin,) = load_views(ViewFiles([mask], FILES / "colmap"))
    np.testing.assert_allclose(view.camera.K, [[240, 0, 63.5], [0, 240, 63.5], [0, 0, 1]])
    assert origin.notes == ("K scaled from 256x256 to 128x128",)
    (turned,) = masks("001.png", size=(128, 256))
    assert_refused(
        "image 2: is for a picture of 256x256, the mask is 128x256, expected the same proportions",
        load_views,
        ViewFiles([turned], FILES / "colmap"),
    )


def test_a_mask_next_to_a_foreign_camera_file_takes_it_unasked(masks, tmp_path):
    (mask,) = masks("r_1.png")
    table = (FILES / "nerf/transforms_train.json").read_bytes()
    (tmp_path / "transforms.json").write_bytes(table)
    (view,), (origin,) = load_views(ViewFiles([mask]))
    assert origin.view == "r_1"
    assert view.camera.K[0, 0] == pytest.approx(480.0)


def test_masks_of_a_lens_with_distortion_are_undistorted_with_what_belongs_to_them(masks, tmp_path):
    (mask,) = masks("frame_00001.png")
    document = json.loads((FILES / "nerfstudio/transforms.json").read_text())
    (tmp_path / "transforms.json").write_text(json.dumps(document | {"k1": 0.3}))
    (view,), (origin,) = load_views(ViewFiles([mask], tmp_path / "transforms.json"))
    assert origin.notes == ("lens distortion undone",)
    assert view.known is not None
    assert not view.known[0, 0]
    (tmp_path / "transforms.json").write_text(json.dumps(document))
    (plain,), (origin,) = load_views(ViewFiles([mask], tmp_path / "transforms.json"))
    assert origin.notes == ()
    # The square stands near a corner, which this lens moves outward.
    rows = [np.nonzero(one.inside)[0].min() for one in (plain, view)]
    assert rows[1] > rows[0]


def test_poses_without_K_take_it_from_another_file(masks):
    log, info = (FILES / "cameras" / n for n in ("open3d_trajectory.log", "camera_info.yaml"))
    files = ViewFiles(masks("mask.png"), log, intrinsics=info)
    (view,), (origin,) = load_views(files)
    truth = json.loads((FILES / "cameras/own.json").read_text())
    np.testing.assert_allclose(view.camera.K, truth["K"])
    np.testing.assert_allclose(view.camera.t, truth["t"], atol=1e-6)
    assert origin.notes == (f"K of {info}",)
    assert_refused("has a pose but no focal length", load_views, replace(files, intrinsics=None))
    assert_refused("has no focal length, expected K", load_views, replace(files, intrinsics=log))


def test_a_windows_path_in_a_camera_file_names_its_mask(masks, tmp_path):
    paths = masks("masks/b.png", "masks/a.png")
    truth = json.loads((FILES / "cameras/own.json").read_text())
    document = [
        truth | {"mask": f"masks\\{name}.png", "t": [0, 0, z]} for name, z in (("a", 2), ("b", 3))
    ]
    (tmp_path / "win.json").write_text(json.dumps(document))
    views, origins = load_views(ViewFiles(paths, tmp_path / "win.json"))
    assert [view.camera.t[2] for view in views] == [3.0, 2.0]
    assert all(origin.by_name for origin in origins)


@pytest.mark.parametrize(("turn", "size"), [(6, (256, 192)), (3, (256, 256))])
def test_a_turned_mask_with_a_camera_file_is_taken_as_it_is_stored(tmp_path, turn, size):
    exif = Image.Exif()
    exif[0x0112] = turn
    array = np.zeros(size[::-1], np.uint8)
    array[10:20, 30:60] = 255
    Image.fromarray(array).save(tmp_path / "mask.png", exif=exif)
    photo = np.zeros((*size[::-1], 3), np.uint8)
    photo[0, 0] = 255
    Image.fromarray(photo).save(tmp_path / "photo.png", exif=exif)
    truth = json.loads((FILES / "cameras/own.json").read_text())
    truth |= {"width": size[0], "height": size[1]}
    (tmp_path / "camera.json").write_text(json.dumps(truth))
    files = ViewFiles([tmp_path / "mask.png"], image=[tmp_path / "photo.png"])
    (view,), (origin,) = load_views(files)
    np.testing.assert_array_equal(view.mask > 0.5, array > 0)
    assert view.image[0, 0, 0] == 1.0
    assert origin.notes[0] == "mask.png is taken as it is stored, without its EXIF orientation"
    # A camera of the upright picture, if the sizes tell, takes the upright mask.
    if turn == 6:
        (tmp_path / "camera.json").write_text(
            json.dumps(truth | {"width": size[1], "height": size[0]})
        )
        (view,), (origin,) = load_views(files)
        assert view.mask.shape == size
        assert origin.notes[0] == "mask.png is turned upright by its EXIF orientation"
    # Without a camera file a picture is seen upright.
    (tmp_path / "camera.json").unlink()
    (view,), (origin,) = load_views(files)
    assert origin.notes[0] == "mask.png is turned upright by its EXIF orientation"


def test_an_order_that_contradicts_the_names_of_the_pictures_is_refused(masks):
    paths = masks("002.png", "001.png", "00l.png", "003.png")
    assert_refused(
        r"the mask .*002\.png is named like view 3 of 4 and is mask 1, expected the order",
        load_views,
        ViewFiles(paths, FILES / "colmap"),
    )


def test_the_camera_file_of_a_data_set_is_found_above_the_mask(tmp_path):
    files = FILES
    for scene, mask, name in (
        ("nerfstudio", "images/frame_00002.png", "transforms.json"),
        ("nerf", "train/r_1.png", "transforms_train.json"),
        ("bop", "mask_visib/000002_000000.png", "scene_camera.json"),
    ):
        assert find_camera(files / scene / mask) == files / scene / name
    other = tmp_path / "images/frame_00002.png"
    other.parent.mkdir()
    shutil.copy(files / "nerfstudio/transforms.json", tmp_path)
    assert find_camera(other.with_name("mask.png")) is None
    assert find_camera(other) == tmp_path / "transforms.json"
    poses = json.loads((files / "bop/scene_gt.json").read_text())
    poses["0"].append(poses["0"][0] | {"obj_id": 5})
    (tmp_path / "scene_gt.json").write_text(json.dumps(poses))
    shutil.copy(files / "bop/scene_camera.json", tmp_path)
    shutil.copytree(files / "bop/mask_visib", tmp_path / "mask_visib")
    mask = tmp_path / "mask_visib/000002_000000.png"
    assert_refused("holds the objects 1, 5, expected one", load_views, ViewFiles([mask]))
    (tmp_path / "transforms.json").write_text("{")
    assert find_camera(other) is None


def test_the_output_says_that_a_mask_without_a_camera_is_turned(tmp_path):
    exif = Image.Exif()
    exif[0x0112] = 6
    picture = np.zeros((40, 60), np.uint8)
    picture[5:20, 5:20] = 255
    Image.fromarray(picture).save(tmp_path / "a.png", exif=exif)
    _, origins = load_views(ViewFiles([tmp_path / "a.png"]))
    said = "a.png is turned upright by its EXIF orientation"
    assert said in summary_of(origins)
    assert said in str(origins[0])


def test_a_mask_given_twice_is_named(tmp_path):
    mask = FILES / "colmap/masks/000.png.png"
    assert_refused(
        r"000\.png\.png: is given twice", load_views, ViewFiles([mask, mask], FILES / "colmap")
    )
    shutil.copy(mask, tmp_path / "000.png")
    assert_refused(
        r"the masks .* are both named like the view 000\.png",
        load_views,
        ViewFiles([mask, tmp_path / "000.png"], FILES / "colmap"),
    )


def test_views_without_pictures_take_masks_in_their_order_alone(tmp_path):
    document = json.loads((FILES / "cameras/open3d_trajectory.json").read_text())
    document["parameters"] *= 3
    (tmp_path / "t.json").write_text(json.dumps(document))
    assert_refused(
        "without names of pictures, found 1 mask; expected as many; give a mask for each view",
        load_views,
        ViewFiles([FILES / "cameras/mask.png"], tmp_path / "t.json"),
    )


def test_an_ambiguous_name_of_a_data_set_says_a_name_that_is_not(tmp_path):
    shutil.copy(FILES / "bop/scene_camera.json", tmp_path)
    poses = json.loads((FILES / "bop/scene_gt.json").read_text())
    twice = {picture: entries * 2 for picture, entries in poses.items()}
    (tmp_path / "scene_gt.json").write_text(json.dumps(twice))
    mask = tmp_path / "000002.png"
    shutil.copy(FILES / "bop/mask_visib/000002_000000.png", mask)
    message = r"000002_000000 and 000002_000001, .* name it like its view: 000002_000000\.png"
    assert_refused(message, load_views, ViewFiles([mask], tmp_path))
    message = r"name the mask like its view, such as 000000_000000\.png"
    other = mask.rename(tmp_path / "m.png")
    assert_refused(message, load_views, ViewFiles([other], tmp_path))


def test_a_wrong_size_names_the_file_that_says_it(tmp_path):
    text = (FILES / "cameras/camera_info.yaml").read_text()
    (tmp_path / "k.yaml").write_text(text.replace("width: 256", "width: 512"))
    files = ViewFiles(
        [FILES / "cameras/mask.png"],
        FILES / "cameras/open3d_trajectory.log",
        intrinsics=tmp_path / "k.yaml",
    )
    assert_refused(r"k\.yaml: is for a picture of 512x256", load_views, files)


def test_a_mask_of_another_object_says_which_mask_is_expected(tmp_path):
    shutil.copy(FILES / "bop/scene_camera.json", tmp_path)
    poses = json.loads((FILES / "bop/scene_gt.json").read_text())
    both = {picture: [*one, one[0] | {"obj_id": 5}] for picture, one in poses.items()}
    (tmp_path / "scene_gt.json").write_text(json.dumps(both))
    mask = FILES / "bop/mask_visib/000002_000000.png"
    assert_refused(
        "is of another object of its picture, expected 000002_000001",
        load_views,
        ViewFiles([mask], tmp_path, object_id=5),
    )
