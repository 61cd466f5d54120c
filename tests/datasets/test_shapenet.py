"""ShapeNet in the layout of the CAPNet authors."""

from __future__ import annotations

import pickle
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
    authors_points,
    iou,
    lopsided,
    lopsided_points,
    write_shapenet,
)
from tso_cli.datasets import common
from tso_cli.datasets.r2n2 import r2n2_camera
from tso_cli.datasets.shapenet import open_shapenet, shapenet_camera
from tso_cli.errors import InputError


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return write_shapenet(tmp_path / "data", ("abc", "def"))


def model(root: Path, name: str = "abc") -> Path:
    return root / "ShapeNet_rendered" / CHAIR / name


@pytest.mark.parametrize(("azimuth", "elevation"), [(0.0, 0.0), (30.0, 20.0), (-110.0, -15.0), (179.0, 40.0)])
def test_a_point_lands_where_the_formula_of_the_authors_code_puts_it(azimuth: float, elevation: float) -> None:
    points = np.random.default_rng(0).uniform(-0.5, 0.5, (50, 3))
    x = authors_points(points, azimuth, elevation)
    rows, columns = 120.0 * x[:, :2].T / np.abs(x[:, 2]) + 32.0
    pixels, depth = shapenet_camera(azimuth, elevation, (64, 64)).project(points)
    # Theirs is half a pixel off the middle of the image.
    np.testing.assert_allclose(pixels, np.stack([columns, rows], axis=1) - 0.5, atol=1e-9)
    np.testing.assert_allclose(depth, -x[:, 2], atol=1e-12)


def test_the_camera_circles_the_other_way_round_than_in_the_renders_of_3d_r2n2() -> None:
    for azimuth, elevation in ANGLES:
        here, there = shapenet_camera(azimuth, elevation, (64, 64)), r2n2_camera(-azimuth, elevation, 1.0, (64, 64))
        np.testing.assert_allclose(here.R, there.R, atol=1e-12)


@pytest.mark.parametrize("clouds", ["ShapeNet_pcl", "ShapeNet_v1_pcl"])
def test_the_cloud_seen_by_the_cameras_covers_the_masks(tmp_path: Path, clouds: str) -> None:
    (item,) = open_shapenet(write_shapenet(tmp_path, clouds=clouds)).objects
    assert (item.name, item.category, len(item.views)) == (f"{CHAIR}/abc", "chair", 3)
    assert agreement(item) > 0.8
    assert agreement_of_surface(item, lopsided()) > 0.98
    assert item.target is not None
    np.testing.assert_array_equal(item.target(), lopsided_points().astype(np.float32))


def test_no_other_choice_of_axes_covers_the_masks(root: Path) -> None:
    masks = [view.load()[1] for view in open_shapenet(root).objects[0].views]
    points = lopsided_points()
    wrong = {
        "azimuth": [(shapenet_camera(-az, el, (64, 64)), points) for az, el in ANGLES],
        "elevation": [(shapenet_camera(az, -el, (64, 64)), points) for az, el in ANGLES],
        "quarter": [(shapenet_camera(az + 90, el, (64, 64)), points) for az, el in ANGLES],
        "half": [(shapenet_camera(az + 180, el, (64, 64)), points) for az, el in ANGLES],
        "z up": [(shapenet_camera(az, el, (64, 64)), points[:, [0, 2, 1]] * [1, 1, -1]) for az, el in ANGLES],
        "mirrored": [(shapenet_camera(az, el, (64, 64)), points * [1, 1, -1]) for az, el in ANGLES],
    }
    for name, seen in wrong.items():
        values = [iou(cloud, camera, mask) for (camera, cloud), mask in zip(seen, masks, strict=True)]
        assert np.mean(values) < 0.7, name


def test_the_object_is_what_is_nearer_than_254_and_the_picture_keeps_its_colours(root: Path) -> None:
    depth = np.full((64, 64), 254, dtype=np.uint8)
    depth[10:20, 30:40] = 253
    Image.fromarray(depth).save(model(root) / "depth_1.png")
    image, mask = open_shapenet(root).objects[0].views[1].load()
    assert mask.sum() == 100 and mask[10:20, 30:40].all()
    np.testing.assert_array_equal(image, np.asarray(Image.open(model(root) / "render_1.png"))[..., :3])


def test_pictures_of_any_size_have_the_camera_for_it(tmp_path: Path) -> None:
    (item,) = open_shapenet(write_shapenet(tmp_path, size=96)).objects
    assert item.views[0].camera.width == 96 and item.views[0].camera.K[0, 0] == 180.0
    assert agreement(item) > 0.7


def test_two_columns_will_do_and_a_distance_counts(tmp_path: Path) -> None:
    plain = open_shapenet(write_shapenet(tmp_path, columns=2)).objects[0].views[1].camera
    np.testing.assert_allclose(plain.t, [0, 0, 2])
    table = model(tmp_path) / "view.txt"
    table.write_text("10 20 0 2.5\n" * 3)
    assert open_shapenet(tmp_path).objects[0].views[2].camera.t[2] == 2.5


def test_without_a_folder_of_clouds_there_are_no_targets(tmp_path: Path) -> None:
    (item,) = open_shapenet(write_shapenet(tmp_path, clouds=None)).objects
    assert item.target is None


def test_only_the_first_picture_of_a_category_is_read_on_opening(root: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reads = []
    original = common.read_image
    monkeypatch.setattr(common, "read_image", lambda path: (reads.append(path), original(path))[1])
    data = open_shapenet(root / "ShapeNet_rendered")
    assert [path.name for path in reads] == ["depth_0.png"]
    assert [item.name for item in data.objects] == [f"{CHAIR}/abc", f"{CHAIR}/def"]


def test_views_are_a_sequence(root: Path) -> None:
    views = open_shapenet(root).objects[0].views
    assert [view.name for view in views] == [view.name for view in views[0:3]]
    assert views[-1].name == views[2].name and views[-1].name.endswith("render_2.png")
    with pytest.raises(IndexError):
        views[3]
    assert len(pickle.loads(pickle.dumps(views))) == 3  # other processes may load pictures


def test_progress_is_told_of_every_model(root: Path) -> None:
    told: list[tuple[int, int, str]] = []
    open_shapenet(root, progress=lambda *what: told.append(what))
    assert told == [(1, 2, f"{CHAIR}/abc"), (2, 2, f"{CHAIR}/def")]


def break_tree(root: Path, what: str) -> None:
    folder = model(root)
    if what == "pictures":
        for path in folder.glob("render_*.png"):
            path.unlink()
    elif what == "table":
        (folder / "view.txt").unlink()
    elif what == "number":
        (folder / "view.txt").write_text("10 20\n10 up\n10 20\n")
    elif what == "columns":
        (folder / "view.txt").write_text("10 20\n10\n10 20\n")
    elif what == "row":
        (folder / "view.txt").write_text("10 20\n10 20\n")
    elif what == "tilt":
        (folder / "view.txt").write_text("10 20 0 2\n10 20 5 2\n10 20 0 2\n")
    elif what == "distance":
        (folder / "view.txt").write_text("10 20 0 2\n10 20 0 2\n10 20 0 -1\n")
    elif what == "depth":
        (folder / "depth_1.png").unlink()


@pytest.mark.parametrize(
    ("what", "item", "views", "message"),
    [
        ("pictures", "abc", 0, "holds no picture"),
        ("table", "abc", 0, r"view\.txt: does not exist"),
        ("number", "abc", 0, r"view\.txt: line 2 has 'up'"),
        ("columns", "abc", 0, r"view\.txt: line 2 has 1 numbers, expected 2 or more"),
        ("row", "abc/render_2.png", 2, r"view\.txt: has 2 rows, expected one for render_2\.png"),
        ("tilt", "abc/render_1.png", 2, r"view\.txt: line 2 has a tilt of 5"),
        ("distance", "abc/render_2.png", 2, r"view\.txt: line 3 has a distance of -1"),
        ("depth", "abc/render_1.png", 2, r"depth_1\.png: does not exist"),
    ],
)
def test_what_is_missing_is_named_and_skipped_or_an_error(root: Path, what: str, item: str, views: int, message: str) -> None:
    break_tree(root, what)
    data = open_shapenet(root)
    assert list(data.skipped) == [f"{CHAIR}/{item}"]
    with pytest.raises(InputError, match=message) as raised:
        open_shapenet(root, strict=True)
    assert str(raised.value) == data.skipped[f"{CHAIR}/{item}"] and "\n" not in str(raised.value)
    kept = {item.name: len(item.views) for item in data.objects}
    assert kept == {f"{CHAIR}/abc": views, f"{CHAIR}/def": 3} if views else kept == {f"{CHAIR}/def": 3}


def test_a_model_without_its_cloud_keeps_its_pictures(root: Path) -> None:
    (root / "ShapeNet_pcl" / CHAIR / "abc" / "pcl_1024_fps_trimesh.npy").unlink()
    lacking, whole = open_shapenet(root, strict=True).objects
    assert (lacking.target, len(lacking.views)) == (None, 3)
    assert "pcl_1024_fps_trimesh.npy: does not exist" in lacking.lacking
    assert whole.target is not None


def test_a_damaged_picture_says_so_when_it_is_loaded(root: Path) -> None:
    path = model(root) / "render_0.png"
    path.write_bytes(path.read_bytes()[:100])
    (model(root) / "depth_1.png").write_bytes(b"not a picture")
    Image.new("L", (32, 64)).save(model(root) / "depth_2.png")
    views = open_shapenet(root).objects[0].views
    for number, message in enumerate(
        (r"render_0\.png: is not", r"depth_1\.png: is not a readable image", r"depth_2\.png: is 32x64, expected 64x64")
    ):
        with pytest.raises(InputError, match=message):
            views[number].load()


def test_a_category_without_any_readable_picture_is_left_out(root: Path) -> None:
    for path in model(root).parent.rglob("depth_*.png"):
        path.write_bytes(b"not a picture")
    with pytest.raises(InputError, match=r"no object can be used, the first: .*abc: no picture of the category can be read"):
        open_shapenet(root)


def test_a_pickled_cloud_is_not_loaded(root: Path) -> None:
    np.save(root / "ShapeNet_pcl" / CHAIR / "abc" / "pcl_1024_fps_trimesh.npy", np.array([{}], dtype=object))
    target = open_shapenet(root).objects[0].target
    assert target is not None
    with pytest.raises(InputError, match=r"pcl_1024_fps_trimesh\.npy: holds values of type 'object'"):
        target()


def test_an_empty_folder_is_no_data_set(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="ShapeNet_rendered: does not exist"):
        open_shapenet(tmp_path)
    (tmp_path / "ShapeNet_rendered").mkdir()
    with pytest.raises(InputError, match="holds no object, expected ShapeNet_rendered/SYNSET/MODEL"):
        open_shapenet(tmp_path)
