"""The renders of ShapeNet made for 3D-R2N2."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import open3d  # noqa: F401  pictures are made by casting rays
import pytest
from PIL import Image

from tests.dataset_trees import (
    ANGLES,
    CHAIR,
    agreement,
    agreement_of_surface,
    iou,
    lopsided,
    lopsided_points,
    write_binvox,
    write_clouds,
    write_r2n2,
)
from tso_cli.datasets.r2n2 import open_r2n2, r2n2_camera
from tso_cli.errors import InputError


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return write_r2n2(tmp_path / "ShapeNetRendering", ("abc", "def"))


def pictures(root: Path, name: str = "abc") -> Path:
    return root / CHAIR / name / "rendering"


@pytest.mark.parametrize("rotation", [0.0, 25.0])
def test_the_cloud_seen_by_the_cameras_covers_the_masks(tmp_path: Path, rotation: float) -> None:
    root = write_r2n2(tmp_path / "ShapeNetRendering", rotation=rotation)
    write_clouds(tmp_path, "abc")
    (item,) = open_r2n2(root).objects
    assert (item.name, item.category, len(item.views)) == (f"{CHAIR}/abc", "chair", 3)
    assert agreement(item) > 0.75
    assert agreement_of_surface(item, lopsided()) > 0.98


def test_no_other_choice_of_axes_covers_the_masks(root: Path) -> None:
    masks = [view.load()[1] for view in open_r2n2(root).objects[0].views]
    points, size = lopsided_points(), (64, 64)
    seen = [(az, el, 0.7 + 0.1 * k) for k, (az, el) in enumerate(ANGLES)]
    wrong = {
        "azimuth": [(r2n2_camera(-az, el, d, size), points) for az, el, d in seen],
        "elevation": [(r2n2_camera(az, -el, d, size), points) for az, el, d in seen],
        "quarter": [(r2n2_camera(az + 90, el, d, size), points) for az, el, d in seen],
        "half": [(r2n2_camera(az + 180, el, d, size), points) for az, el, d in seen],
        "distance": [(r2n2_camera(az, el, d / 1.75, size), points) for az, el, d in seen],
        "z up": [(r2n2_camera(az, el, d, size), points[:, [0, 2, 1]] * [1, 1, -1]) for az, el, d in seen],
        "mirrored": [(r2n2_camera(az, el, d, size), points * [1, 1, -1]) for az, el, d in seen],
    }
    for name, cameras in wrong.items():
        values = [iou(cloud, camera, mask) for (camera, cloud), mask in zip(cameras, masks, strict=True)]
        assert np.mean(values) < 0.7, name


@pytest.mark.parametrize("in_the_middle", [False, True])
def test_voxels_are_a_target_in_the_frame_of_the_cameras(tmp_path: Path, in_the_middle: bool) -> None:
    write_r2n2(tmp_path / "ShapeNetRendering")
    write_binvox(tmp_path / "ShapeNetVox32" / CHAIR / "abc" / "model.binvox", in_the_middle)
    (item,) = open_r2n2(tmp_path).objects
    assert agreement(item) > 0.7
    assert item.target is not None
    points = item.target()
    assert points.shape == (1024, 3)
    np.testing.assert_array_equal(points, item.target())
    # The voxels reach at most one of them, a 32nd of the longest side, beyond the object.
    true = lopsided_points()
    extent = np.ptp(true, axis=0)
    np.testing.assert_allclose(np.ptp(points, axis=0), extent, atol=extent.max() / 16)
    np.testing.assert_allclose(points.max(0) + points.min(0), 0.0, atol=extent.max() / 16)


def test_clouds_go_before_voxels_and_neither_is_needed(root: Path) -> None:
    assert [item.target for item in open_r2n2(root).objects] == [None, None]
    for model in ("abc", "def"):
        write_binvox(root.parent / "ShapeNetVox32" / CHAIR / model / "model.binvox", True)
    write_clouds(root.parent, "abc", "def")
    target = open_r2n2(root).objects[0].target
    assert target is not None
    np.testing.assert_array_equal(target(), lopsided_points().astype(np.float32))


def test_the_mask_is_the_alpha_channel_soft_edges_and_all(root: Path) -> None:
    pixels = np.zeros((64, 64, 4), dtype=np.uint8)
    pixels[5, 7] = 10, 20, 30, 51
    Image.fromarray(pixels).save(pictures(root) / "01.png")
    image, mask = open_r2n2(root).objects[0].views[1].load()
    assert mask[5, 7] == np.float32(0.2) and mask.sum() == mask[5, 7]
    assert image[5, 7].tolist() == [10, 20, 30]


def test_lines_of_the_table_belong_to_the_listed_names_else_to_the_numbers(tmp_path: Path) -> None:
    root = write_r2n2(tmp_path, listed=False)
    by_number = {view.name[-6:]: view.camera for view in open_r2n2(root).objects[0].views}
    (pictures(root) / "renderings.txt").write_text("02.png\n00.png\n01.png\n")
    by_list = {view.name[-6:]: view.camera for view in open_r2n2(root).objects[0].views}
    for line, (number, name) in enumerate(zip(("00.png", "01.png", "02.png"), ("02.png", "00.png", "01.png"), strict=True)):
        np.testing.assert_allclose(by_number[number].R, r2n2_camera(*ANGLES[line], 1.0, (64, 64)).R)
        np.testing.assert_array_equal(by_number[number].R, by_list[name].R)


def test_the_focal_length_is_35_of_a_sensor_of_32_whatever_the_field_of_view_says() -> None:
    camera = r2n2_camera(0.0, 0.0, 0.8, (137, 137))
    assert camera.K[0, 0] == pytest.approx(35 / 32 * 137) and camera.K[0, 2] == 68.0
    np.testing.assert_allclose(-camera.R.T @ camera.t, [1.4, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize(
    ("what", "item", "views", "message"),
    [
        ("pictures", "abc", 0, "holds no picture"),
        ("folder", "abc", 0, "rendering: does not exist"),
        ("table", "abc", 0, r"rendering_metadata\.txt: does not exist"),
        ("columns", "abc", 0, r"rendering_metadata\.txt: line 1 has 2 numbers, expected 4 or more"),
        ("nan", "abc", 0, r"rendering_metadata\.txt: line 1 has 'nan'"),
        ("row", "abc/02.png", 2, r"rendering_metadata\.txt: has 2 rows, expected one for 02\.png"),
        ("ratio", "abc/00.png", 2, r"rendering_metadata\.txt: line 1 has a distance ratio of 0"),
        ("picture", "abc/'01.png'", 2, r"renderings\.txt: names '01\.png'"),
    ],
)
def test_what_is_missing_is_named_and_skipped_or_an_error(root: Path, what: str, item: str, views: int, message: str) -> None:
    folder = pictures(root)
    table = folder / "rendering_metadata.txt"
    rows = table.read_text().splitlines()
    if what == "pictures":
        for path in (*folder.glob("*.png"), folder / "renderings.txt"):
            path.unlink()
    elif what == "folder":
        folder.rename(folder.with_name("other"))
    elif what == "table":
        table.unlink()
    elif what == "picture":
        (folder / "01.png").unlink()
    else:
        changed = {"columns": ["1 2"], "nan": ["nan 2 0 0.8 25"], "row": rows[:2], "ratio": ["1 2 0 0 25", *rows[1:]]}[what]
        table.write_text("\n".join(changed) + "\n")
    data = open_r2n2(root)
    assert list(data.skipped) == [f"{CHAIR}/{item}"]
    with pytest.raises(InputError, match=message) as raised:
        open_r2n2(root, strict=True)
    assert str(raised.value) == data.skipped[f"{CHAIR}/{item}"] and "\n" not in str(raised.value)
    kept = {item.name: len(item.views) for item in data.objects}
    assert kept == {f"{CHAIR}/abc": views, f"{CHAIR}/def": 3} if views else kept == {f"{CHAIR}/def": 3}


def test_a_model_without_its_3d_file_keeps_its_pictures(root: Path) -> None:
    write_binvox(root.parent / "ShapeNetVox32" / CHAIR / "def" / "model.binvox", True)
    lacking, whole = open_r2n2(root, strict=True).objects
    assert (lacking.target, len(lacking.views)) == (None, 3)
    assert lacking.lacking.endswith("model.binvox: does not exist, expected the shape of this object")
    assert whole.target is not None
    assert whole.lacking == ""


def test_a_damaged_picture_says_so_when_it_is_loaded(root: Path) -> None:
    path = pictures(root) / "00.png"
    path.write_bytes(path.read_bytes()[:100])
    Image.new("RGB", (64, 64)).save(pictures(root) / "01.png")
    Image.new("RGBA", (64, 32)).save(pictures(root) / "02.png")
    views = open_r2n2(root, strict=True).objects[0].views
    assert views[0].camera.width == 64  # from the next picture that can be read
    for number, message in enumerate((r"00\.png: is not", "01.png: has no alpha", "02.png: is 64x32, expected 64x64")):
        with pytest.raises(InputError, match=message):
            views[number].load()


def test_a_name_in_the_list_cannot_lead_out_of_the_folder(root: Path) -> None:
    (root / "secret.png").write_bytes((pictures(root) / "00.png").read_bytes())
    (pictures(root) / "renderings.txt").write_text("../../../secret.png\n01.png\n")
    data = open_r2n2(root)
    assert [view.name[-6:] for view in data.objects[0].views] == ["01.png"]
    assert len(data.skipped) == 1


def test_an_empty_folder_is_no_data_set(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no object, expected SYNSET/MODEL/rendering"):
        open_r2n2(tmp_path)
    with pytest.raises(InputError, match="missing: does not exist"):
        open_r2n2(tmp_path / "missing")
