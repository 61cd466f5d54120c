"""Reading back the folder that render writes."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.corruption import assert_refused, full_disk
from tso_cli import Camera, InputError, TsoError
from tso_cli.datasets import rendered
from tso_cli.datasets.rendered import UNFINISHED, open_rendered, stored_record, writing
from tso_cli.io.images import write_image

CAMERA = Camera.canonical(12, 10)


def picture(seed):
    rng = np.random.default_rng(seed)
    image = rng.integers(0, 256, (10, 12, 3), dtype=np.uint8)
    mask = np.where(rng.random((10, 12)) > 0.5, 255, 0).astype(np.uint8)
    return image, mask, CAMERA


def cloud(seed, count=20):
    return np.random.default_rng(seed).uniform(-0.5, 0.5, (count, 3)).astype(np.float32)


def write(folder, number, views=1, **options):
    pictures = [picture(10 * number + view) for view in range(views)]
    with writing(folder.parent) as writer:
        writer.write(
            folder.name, pictures, cloud(number, 50), cloud(number), {"n": number}, **options
        )


@pytest.fixture
def folder(tmp_path):
    """Two objects, the second below a category, of two views each."""
    for number, name in enumerate(("b", "a/chair")):
        write(tmp_path / "data" / name, number, views=2)
    return tmp_path / "data"


def test_unfinished_objects_are_left_out_and_one_object_is_a_data_set_of_one(folder):
    (folder / UNFINISHED).mkdir()
    (folder / "b").rename(folder / UNFINISHED / "new")
    assert [item.name for item in open_rendered(folder).objects] == ["a/chair"]
    assert [item.name for item in open_rendered(folder / "a" / "chair").objects] == ["chair"]
    shutil.rmtree(folder / "a")
    assert_refused("no object", open_rendered, folder)


def test_an_object_is_written_whole_or_not_at_all(tmp_path, monkeypatch):
    write(tmp_path / "a", 1)
    monkeypatch.setattr(rendered, "write_cameras", full_disk)
    for name in ("a", "b"):
        with pytest.raises(TsoError, match="No space left on device"):
            write(tmp_path / name, 2)
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    assert stored_record(tmp_path / "a") == {"n": 1}


def test_the_old_object_comes_back_when_the_new_one_cannot_take_its_place(tmp_path, monkeypatch):
    write(tmp_path / "a", 1)
    rename = Path.rename

    def stubborn(self, target):
        if self.name.startswith("new"):
            raise OSError(5, "Input/output error")
        return rename(self, target)

    monkeypatch.setattr(Path, "rename", stubborn)
    with pytest.raises(TsoError, match="Input/output error"):
        write(tmp_path / "a", 2)
    assert stored_record(tmp_path / "a") == {"n": 1}
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_an_object_is_replaced_only_when_asked(tmp_path):
    write(tmp_path / "a", 1, views=2)
    assert (stored_record(tmp_path / "a"), stored_record(tmp_path / "other")) == ({"n": 1}, None)
    write(tmp_path / "a", 2)
    assert stored_record(tmp_path / "a") == {"n": 2}
    assert not (tmp_path / "a/001.png").exists()


def test_as_a_data_set_an_object_has_its_views_target_and_category(folder):
    data = open_rendered(folder)
    assert [(item.name, item.category, len(item.views)) for item in data.objects] == [
        ("a/chair", "a", 2),
        ("b", "", 2),
    ]
    assert data.skipped == {}
    assert data.description == "data"
    item = data.objects[0]
    np.testing.assert_array_equal(item.target(), cloud(1))
    for number, view in enumerate(item.views):
        image, mask, _ = picture(10 + number)
        loaded = view.load()
        np.testing.assert_array_equal(loaded[0], image)
        np.testing.assert_array_equal(loaded[1], mask / np.float32(255), strict=True)
        np.testing.assert_array_equal(view.camera.K, CAMERA.K)
        assert view.name.endswith(f"{number:03d}.mask.png")


def test_missing_damaged_and_resized_pictures_are_named_when_they_are_loaded(folder):
    views = open_rendered(folder, strict=True).objects[1].views
    (folder / "b/000.png").write_bytes(b"not a picture")
    assert_refused(r"b/000\.png: is not a readable image", views[0].load)
    (folder / "b/000.png").unlink()
    assert_refused(r"b/000\.png: does not exist", views[0].load)
    write_image(folder / "b/001.mask.png", np.zeros((10, 13), np.uint8), overwrite=True)
    assert_refused(r"001\.mask\.png: is 13x10.*12x10", views[1].load)


def test_a_camera_file_is_read_once_until_it_changes(folder, monkeypatch):
    reads = []
    original = rendered.read_cameras
    monkeypatch.setattr(
        rendered, "read_cameras", lambda path: (reads.append(path), original(path))[1]
    )
    views = open_rendered(folder / "b").objects[0].views
    assert [views[index].camera.width for index in (0, 1, 0, 1)] == [12] * 4
    assert len(reads) == 1
    path = folder / "b/cameras.json"
    path.write_text(path.read_text())
    assert views[0].camera.width == 12
    assert len(reads) == 2


@pytest.mark.parametrize(
    ("cameras", "message"),
    [
        (None, r"b/target\.ply: does not exist"),
        (("{", ""), r"b/cameras\.json: is not"),
        (('"mask": "001.mask.png",', ""), r"views\[1\] names no mask"),
    ],
)
def test_an_unusable_object_of_a_data_set_is_skipped_or_an_error(folder, cameras, message):
    """Either it has no target, or the text of its camera file is changed."""
    if cameras is None:
        (folder / "b/target.ply").unlink()
    else:
        path = folder / "b/cameras.json"
        path.write_text(path.read_text().replace(*cameras))
    data = open_rendered(folder)
    assert [item.name for item in data.objects] == ["a/chair"]
    assert list(data.skipped) == ["b"]
    with pytest.raises(InputError, match=message) as raised:
        open_rendered(folder, strict=True)
    assert str(raised.value) == data.skipped["b"]
