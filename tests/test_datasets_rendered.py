"""Reading back the folder that render writes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tso_cli.camera import Camera
from tso_cli.datasets import rendered
from tso_cli.datasets.rendered import RenderedDataset, list_objects, stored_record, write_object
from tso_cli.errors import InputError, TsoError
from tso_cli.files.images import write_image


def picture(seed: int, width: int = 12, height: int = 10) -> tuple[np.ndarray, np.ndarray, Camera]:
    rng = np.random.default_rng(seed)
    image = rng.integers(0, 256, (height, width, 3), dtype=np.uint8)
    mask = np.where(rng.random((height, width)) > 0.5, 255, 0).astype(np.uint8)
    return image, mask, Camera.canonical(width, height)


def cloud(seed: int, count: int = 20) -> np.ndarray:
    return np.random.default_rng(seed).uniform(-0.5, 0.5, (count, 3)).astype(np.float32)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Two objects, the second below a category, of two views each."""
    for number, name in enumerate(("b", "a/chair")):
        views = [picture(10 * number), picture(10 * number + 1)]
        write_object(tmp_path / "data" / name, views, cloud(number, 50), cloud(number), {"views": 2})
    return tmp_path / "data"


def test_what_was_written_is_read_back_exactly(folder: Path) -> None:
    data = RenderedDataset(folder)
    assert len(data) == 2
    assert [item.name for item in data.objects] == ["a/chair", "b"]
    first = data.objects[0]
    np.testing.assert_array_equal(first.target(), cloud(1))
    assert first.target().dtype == np.float32
    for number, view in enumerate(first.views):
        image, mask, camera = picture(10 + number)
        np.testing.assert_array_equal(view.image(), image)
        np.testing.assert_array_equal(view.mask(), mask / np.float32(255))
        assert view.mask().dtype == np.float32
        np.testing.assert_array_equal(view.camera.K, camera.K)
        assert view.mask_path.name == f"{number:03d}.mask.png"
    np.testing.assert_array_equal(data.targets(), np.stack([cloud(1), cloud(0)]))


def test_one_object_is_a_data_set_of_one(folder: Path) -> None:
    assert [item.name for item in list_objects(folder / "a" / "chair")] == ["chair"]


def test_unfinished_objects_are_left_out(folder: Path) -> None:
    (folder / "b").rename(folder / ".b.1234.partial")
    assert [item.name for item in list_objects(folder)] == ["a/chair"]


def test_a_picture_is_decoded_once_while_there_is_room(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    reads: list[Path] = []
    original = rendered.read_image
    monkeypatch.setattr(rendered, "read_image", lambda path: (reads.append(path), original(path))[1])
    size = 12 * 10 * 3
    for room, expected in ((10 * size, 2), (size, 4)):
        reads.clear()
        views = RenderedDataset(folder, cache_bytes=room).objects[0].views
        for view in (*views, *views):
            view.image()
        assert len(reads) == expected


def test_the_memory_kept_stays_below_the_bound(folder: Path) -> None:
    data = RenderedDataset(folder, cache_bytes=1000)
    for _ in range(2):
        for item in data.objects:
            for view in item.views:
                view.image(), view.mask()
                assert data._cache.used <= 1000
                assert data._cache.used == sum(pixels.nbytes for pixels in data._cache._items.values())


def test_a_kept_picture_cannot_be_changed_by_its_user(folder: Path) -> None:
    image = list_objects(folder)[0].views[0].image()
    with pytest.raises(ValueError, match="read-only"):
        image[0, 0, 0] = 1


def test_a_missing_target_is_named(folder: Path) -> None:
    (folder / "b" / "target.ply").unlink()
    with pytest.raises(InputError, match=r"b/target\.ply: does not exist"):
        RenderedDataset(folder)


def test_targets_of_different_sizes_are_refused_together_and_fine_alone(folder: Path) -> None:
    write_object(folder / "c", [picture(3)], cloud(3), cloud(3, 7), {})
    data = RenderedDataset(folder)
    assert data.objects[-1].target().shape == (7, 3)
    with pytest.raises(InputError, match=r"c/target\.ply: 7 points, expected 20"):
        data.targets()


def test_a_mask_or_image_of_another_size_is_named(folder: Path) -> None:
    image, mask, _ = picture(0, 13, 10)
    write_image(folder / "b/000.mask.png", mask, overwrite=True)
    write_image(folder / "b/001.png", image, overwrite=True)
    views = RenderedDataset(folder).objects[1].views
    with pytest.raises(InputError, match=r"000\.mask\.png: is 13x10.*12x10"):
        views[0].mask()
    with pytest.raises(InputError, match=r"001\.png: is 13x10.*12x10"):
        views[1].image()


@pytest.mark.parametrize("key", ["image", "mask"])
def test_a_view_without_image_or_mask_is_named(folder: Path, key: str) -> None:
    path = folder / "b/cameras.json"
    document = json.loads(path.read_text())
    del document["views"][1][key]
    path.write_text(json.dumps(document))
    with pytest.raises(InputError, match=rf"views\[1\] names no {key}"):
        _ = RenderedDataset(folder).objects[1].views


def test_a_missing_picture_is_named(folder: Path) -> None:
    (folder / "b/000.png").unlink()
    with pytest.raises(InputError, match=r"b/000\.png: does not exist"):
        RenderedDataset(folder).objects[1].views[0].image()


def test_a_folder_without_objects_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="holds no object"):
        RenderedDataset(tmp_path)
    with pytest.raises(InputError, match="does not exist"):
        RenderedDataset(tmp_path / "missing")
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="is a file"):
        RenderedDataset(tmp_path / "file")


def test_an_object_is_written_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    old = cloud(1)
    write_object(tmp_path / "a", [picture(1)], old, old, {"n": 1})
    monkeypatch.setattr(rendered, "write_cameras", full)
    for name in ("a", "b"):
        with pytest.raises(TsoError, match="No space left on device"):
            write_object(tmp_path / name, [picture(2)], cloud(2), cloud(2), {"n": 2}, overwrite=True)
    assert [path.name for path in tmp_path.iterdir()] == ["a"]
    assert stored_record(tmp_path / "a") == {"n": 1}


def test_the_old_object_comes_back_when_the_new_one_cannot_take_its_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_object(tmp_path / "a", [picture(1)], cloud(1), cloud(1), {"n": 1})
    original = Path.rename

    def stubborn(self: Path, target: Path) -> Path:
        if self.name.endswith(".partial"):
            raise OSError(5, "Input/output error")
        return original(self, target)

    monkeypatch.setattr(Path, "rename", stubborn)
    with pytest.raises(TsoError, match="Input/output error"):
        write_object(tmp_path / "a", [picture(2)], cloud(2), cloud(2), {"n": 2}, overwrite=True)
    assert stored_record(tmp_path / "a") == {"n": 1}
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_an_object_is_replaced_only_when_asked(tmp_path: Path) -> None:
    write_object(tmp_path / "a", [picture(1), picture(2)], cloud(1), cloud(1), {"n": 1})
    with pytest.raises(InputError, match="--overwrite"):
        write_object(tmp_path / "a", [picture(1)], cloud(1), cloud(1), {"n": 2})
    assert stored_record(tmp_path / "a") == {"n": 1}
    write_object(tmp_path / "a", [picture(1)], cloud(1), cloud(1), {"n": 2}, overwrite=True)
    assert stored_record(tmp_path / "a") == {"n": 2}
    assert not (tmp_path / "a/001.png").exists()
    assert stored_record(tmp_path / "other") is None
