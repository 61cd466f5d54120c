"""Camera files read back exactly; what is wrong in one is said with the file and the key."""

import json
from pathlib import Path

import numpy as np
import pytest

from tests.corruption import assert_reads_or_refuses, assert_refused
from tso_cli.geometry.camera import Camera
from tso_cli.io.cameras import (
    CameraRecord,
    find_camera,
    named_masks,
    paired,
    read_camera,
    read_cameras,
    read_partial_cameras,
    write_cameras,
)

TURN = 0.3
GOOD = {
    "width": 64,
    "height": 48,
    "K": [[120.0, 0.0, 31.5], [0.0, 118.5, 23.5], [0.0, 0.0, 1.0]],
    "R": [[np.cos(TURN), 0.0, np.sin(TURN)], [0.0, 1.0, 0.0], [-np.sin(TURN), 0.0, np.cos(TURN)]],
    "t": [0.1, -0.2, 2.0],
}


def changed(**keys):
    return GOOD | keys


def without(key):
    return {k: v for k, v in GOOD.items() if k != key}


@pytest.fixture(name="save")
def save_camera(save):
    return lambda content, name="camera.json": save(name, content)


def assert_same(a, b):
    assert all(np.array_equal(getattr(a, name), getattr(b, name)) for name in "KRt")
    assert a.width == b.width
    assert a.height == b.height
    assert a.model == b.model


def test_a_single_camera_is_read_as_it_stands(save):
    (record,) = read_cameras(
        save(b"\xef\xbb\xbf" + json.dumps(GOOD).encode())
    )  # a byte order mark is no obstacle
    assert record.mask is None
    assert record.image is None
    assert_same(record.camera, Camera(GOOD["K"], GOOD["R"], GOOD["t"], 64, 48))
    assert_same(read_camera(save(GOOD), 64, 48), record.camera)


def test_views_name_their_files_relative_to_the_camera_file(save, tmp_path):
    views = [
        changed(mask="a.png", image="photos/a.jpg", model="orthographic"),
        changed(mask="/b.png", width=32.0),
    ]
    first, second = read_cameras(save({"views": views}))
    assert first.mask == tmp_path / "a.png"
    assert first.image == tmp_path / "photos" / "a.jpg"
    assert first.camera.model == "orthographic"
    assert str(second.mask) == "/b.png"
    assert second.camera.width == 32


def test_what_is_written_reads_back_exactly(tmp_path):
    camera = Camera.canonical(64, 48).cropped((1.3, 2.7, 50.1, 40.9), 33, 31)
    write_cameras(tmp_path / "flat.json", [CameraRecord(camera)])
    document = json.loads((tmp_path / "flat.json").read_text())
    assert set(document) == {"width", "height", "model", "K", "R", "t"}
    assert_same(read_camera(tmp_path / "flat.json", 33, 31), camera)

    (tmp_path / "sub").mkdir()
    records = [
        CameraRecord(camera, tmp_path / "m.png"),
        CameraRecord(camera.resized(7, 8), None, tmp_path / "sub" / "i.png"),
    ]
    write_cameras(tmp_path / "sub" / "views.json", records)
    assert (
        json.loads((tmp_path / "sub" / "views.json").read_text())["views"][0]["mask"] == "../m.png"
    )
    for written, read in zip(records, read_cameras(tmp_path / "sub" / "views.json"), strict=True):
        assert_same(written.camera, read.camera)
        for name in ("mask", "image"):
            a, b = getattr(written, name), getattr(read, name)
            assert a is b is None or a.resolve() == b.resolve()


def test_the_masks_own_camera_comes_before_the_folders(save, tmp_path):
    mask = tmp_path / "front.mask.png"
    assert find_camera(mask) is None
    folder = save(GOOD)
    assert find_camera(mask) == folder
    own = save(GOOD, "front.mask.camera.json")
    assert find_camera(mask) == own


def test_K_of_a_picture_of_another_size_is_scaled(save, tmp_path):
    given = read_camera(save(GOOD), 64, 48)
    assert_same(read_camera(save(GOOD), 128, 96, tmp_path / "m.png"), given.resized(128, 96))
    # A program that halves 97 rows may write 48.
    assert read_camera(save(GOOD), 129, 97).height == 97


def test_a_camera_of_a_picture_with_other_proportions_is_refused(save, tmp_path):
    message = r"camera\.json: is for a picture of 64x48, the mask is 48x64, expected the same prop"
    assert_refused(message, read_camera, save(GOOD), 48, 64, tmp_path / "m.png")


def test_the_view_that_names_the_mask_is_chosen(save, tmp_path):
    path = save({"views": [changed(mask="a.png"), changed(mask="b.png", t=[0, 0, 9])]})
    assert read_camera(path, 64, 48, tmp_path / "b.png").t[2] == 9
    assert_refused(
        r"none of its 2 views \(a\.png, b\.png\) names the mask .*c\.png, expected one; name",
        read_camera,
        path,
        64,
        48,
        tmp_path / "c.png",
    )
    assert_refused("0 of its 2 views name a mask", read_camera, path, 64, 48)


BAD = {
    "empty": ("", "is empty"),
    "not JSON": ("{'width': 1}", "is not JSON .*line 1 column 2"),
    "cut": (json.dumps(GOOD)[:-30], "is not JSON"),
    "binary": (b"\x80\x00\xff", "is not text .*codec"),
    "an empty list": ([], "holds a list of 0, expected an object"),
    "nested deep": ("[" * 200_000, "nested too deep"),
    "key twice": ('{"K": 1, "K": 2}', "the key 'K' appears twice"),
    "endless digits": ('{"width": ' + "9" * 5000 + "}", "is not JSON"),
    "no R": (without("R"), ": R is missing, expected"),
    "no K and no pose": ({"width": 64, "height": 48, "K_": 1}, ": K is missing, expected"),
    "no height": (without("height"), ": height is missing, expected"),
    "K under two names": (changed(intrinsics=GOOD["K"]), "intrinsics' says K again"),
    "a rotation that may go either way": (changed(rotation=GOOD["R"]), "world to camera"),
    "width of text": (changed(width="64"), "width is '64', expected a number"),
    "width true": (changed(width=True), "width is True, expected a number"),
    "width and a half": (changed(width=64.5), "width is 64.5, expected a whole number"),
    "height zero": (changed(height=0), "height is 0, expected a whole number of pixels, 1 or more"),
    "width huge": (changed(width=10**30), r"width is 1e\+30, expected .* at most"),
    "too many pixels": (
        changed(width=10**6, height=10**6), "1000000x1000000, expected at most 100,000,000 pixels",
    ),
    "K of 8": (changed(K=[1, 0, 0, 0, 1, 0, 0, 0]), r"K is an array \[8\], expected 3x3 or \[9\]"),
    "K ragged": (changed(K=[[1, 0, 0], [0, 1], [0, 0, 1]]), r"K is a list of 3, expected 3x3 or"),
    "K of text": (
        changed(K=[["1", 0, 0], [0, 1, 0], [0, 0, 1]]), r"K\[0\]\[0\] is '1', expected a number",
    ),
    "K NaN": (
        changed(K=[[np.nan, 0, 0], [0, 1, 0], [0, 0, 1]]),
        r"K\[0\]\[0\] is nan, expected a finite number",
    ),
    "K singular": (changed(K=[[0, 0, 0], [0, 1, 0], [0, 0, 1]]), "K is singular.* fx = 0"),
    "R not a rotation": (changed(R=[[2, 0, 0], [0, 1, 0], [0, 0, 1]]), "R is not a rotation"),
    "R too large to multiply": (
        changed(R=[[1e300, 1e300, 0], [-1e300, 1e300, 0], [0, 0, 1]]), r"R\[0\]\[0\] is 1e\+300",
    ),
    "R of angles": (changed(R=[0.1, 0.2, 0.3]), r"R is an array \[3\], expected 3x3 or \[9\]"),
    "t a matrix": (changed(t=[[0, 0, 2]]), r"t is an array \[1, 3\], expected \[3\]"),
    "t infinite": (
        json.dumps(GOOD).replace("2.0]", "1e999]"), r"t\[2\] is inf, expected a finite number",
    ),
    "other model": (
        changed(model="fisheye"), "model is 'fisheye', expected one of perspective, orthographic",
    ),
    "mask empty": (changed(mask=""), "mask is '', expected the path"),
    "mask with a NUL": (changed(mask="a\0b"), "expected the path"),
    "small k": ({**without("K"), "k": GOOD["K"]}, "key 'k' is not one of camera files, expected K"),
    "Views": ({"Views": [GOOD]}, "key 'Views' is not one of camera files, expected views"),
    "views and K": ({"views": [GOOD], "K": GOOD["K"]}, "the key K is out of place"),
    "views in a view": (
        {"views": [{"views": [GOOD]}]}, r"the key views\[0\]\.views is out of place",
    ),
    "no views": ({"views": []}, "views is a list of 0, expected a list of at least one"),
    "views of text": ({"views": "ab"}, "views is 'ab', expected a list"),
    "a view of text": ({"views": [GOOD, "ab"]}, r"views\[1\] is 'ab', expected an object"),
    "a bad view": ({"views": [GOOD, without("t")]}, r"views\[1\]\.t is missing"),
    "a bad rotation in a view": (
        {"views": [changed(R=[[0] * 3] * 3)]}, r"views\[0\]: R is not a rotation",
    ),
}  # fmt: skip


@pytest.mark.parametrize("case", BAD)
def test_what_is_wrong_is_said_with_file_and_key(save, case):
    content, message = BAD[case]
    assert_refused(rf"camera\.json: .*{message.removeprefix(': ')}", read_cameras, save(content))


def test_a_file_too_large_for_a_camera_file_is_refused(tmp_path):
    with (tmp_path / "huge.json").open("wb") as file:
        file.truncate(65 << 20)
    assert_refused(
        r"huge\.json: holds 68,157,440 bytes, .* at most 16,777,216",
        read_cameras,
        tmp_path / "huge.json",
    )


def test_unknown_keys_are_ignored_with_one_warning(save):
    with pytest.warns(
        UserWarning, match=r"camera\.json: unknown keys are ignored: 'author, date'"
    ) as caught:
        assert (
            len(
                read_cameras(save({"views": [changed(author="me"), changed(author="you", date=1)]}))
            )
            == 2
        )
    assert len(caught) == 1


@pytest.mark.parametrize("form", ["flat", "views"])
def test_any_damage_is_read_or_refused_in_one_line(save, form):
    path = save(
        GOOD
        if form == "flat"
        else {"views": [changed(mask="a.png"), changed(model="orthographic")]},
        "good.json",
    )

    def read(path):
        for camera in (record.camera for record in read_cameras(path)):
            assert np.isfinite(camera.K).all()
            assert np.abs(camera.R @ camera.R.T - np.eye(3)).max() < 2e-3

    was_read, refused = assert_reads_or_refuses(read, path, count=200)
    assert was_read > 5
    assert refused > 60


# Which view of a camera file belongs to which mask


@pytest.fixture
def save_views(tmp_path):
    """Write a camera file: view i has width 10 + i and names the i-th of the masks (None: none)."""

    def write(*masks):
        records = [
            CameraRecord(Camera.canonical(10 + i, 8), mask and tmp_path / mask)
            for i, mask in enumerate(masks)
        ]
        write_cameras(tmp_path / "views.json", records, overwrite=True)
        return tmp_path / "views.json"

    return write


def _order(path, *masks, folder=""):
    return [
        camera.size[0] - 10
        for camera in paired(
            path, read_partial_cameras(path)[0], [path.parent / folder / mask for mask in masks]
        )[0]
    ]


def test_masks_that_are_named_find_their_views_in_whatever_order(save_views):
    path = save_views("a.png", "b.png", "c.png")
    assert _order(path, "c.png", "a.png", "b.png") == [2, 0, 1]
    assert _order(path, "c.png", "b.png") == [2, 1]
    assert _order(path, "c.png", "a.png", folder="moved") == [2, 0]
    assert _order(save_views("1/mask.png", "2/mask.png"), "2/mask.png", "1/mask.png") == [1, 0]


def test_views_that_name_no_mask_are_taken_in_their_order(save_views, recwarn):
    assert _order(save_views(None, None, None), "c.png", "a.png", "b.png") == [0, 1, 2]
    assert not recwarn.list


def test_views_that_name_other_masks_are_taken_in_their_order_with_a_warning(save_views):
    with pytest.warns(
        UserWarning, match=r"views\[1\] names the mask .*b\.png, used for .*other\.png"
    ):
        assert _order(save_views("a.png", "b.png"), "a.png", "other.png") == [0, 1]


def test_another_number_of_masks_than_views_and_an_order_that_contradicts_the_names_are_refused(
    save_views,
):
    message = r"views\.json: holds 3 views without names of pictures, found 2 masks"
    assert_refused(message, _order, save_views(None, None, None), "a.png", "b.png")
    message = r"b\.png is named like view 2 of 3 and is mask 1, expected the order of the views"
    assert_refused(
        message, _order, save_views("a.png", "b.png", "c.png"), "b.png", "a.png", "other.png"
    )


def test_the_masks_that_the_views_name_are_listed_relative_to_the_file(save_views):
    path = save_views("b.png", "in/a.png")
    assert named_masks(path) == [path.parent / "b.png", path.parent / "in" / "a.png"]
    assert_refused(
        r"views\.json: views\[1\] of 2 names no mask", named_masks, save_views("a.png", None)
    )


def test_pictures_with_alpha_are_the_masks_of_a_file_that_names_none():
    # Blender's file names its pictures without ".png".
    nerf = Path(__file__).parent / "files/nerf"
    found = named_masks(nerf / "transforms_train.json")
    assert found == [nerf / "train" / f"r_{number}.png" for number in range(4)]


def test_a_picture_that_does_not_exist_is_named(tmp_path):
    file = Path(__file__).with_name("files") / "cameras/own.json"
    view = json.loads(file.read_text()) | {"image": "none.png"}
    (tmp_path / "c.json").write_text(json.dumps(view))
    assert_refused(r"names .*none\.png, which does not exist", named_masks, tmp_path / "c.json")
