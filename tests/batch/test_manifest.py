"""Manifests and folders become items; what is wrong is said with its row and column."""

import io
import json

import pytest

from tests.corruption import assert_refused
from tso_cli.batch.manifest import read_manifest, shard_of


@pytest.fixture
def manifest(tmp_path):
    def write(text, name="items.csv"):
        path = tmp_path / name
        path.write_text(text)
        return path

    return write


def values(path):
    return [item.values for item in read_manifest(path)]


def test_a_csv_file_names_its_columns_and_empty_cells_say_nothing(manifest):
    path = manifest('cloud, mask ,steps\na.ply,a.png;b.png,\n\nb.ply,"c,d.png",5\n')
    assert values(path) == [
        {"cloud": "a.ply", "mask": "a.png;b.png"},
        {"cloud": "b.ply", "mask": "c,d.png", "steps": "5"},
    ]
    assert [item.place for item in read_manifest(path)] == [f"{path}: row 2", f"{path}: row 4"]


def test_json_lines_have_an_object_in_each_line(manifest):
    rows = [{"cloud": "a.ply", "mask": ["a.png", "b.png"], "steps": None}, {"cloud": "b.ply"}]
    path = manifest("\n".join(map(json.dumps, rows)) + "\n", "items.jsonl")
    assert values(path) == [{"cloud": "a.ply", "mask": ["a.png", "b.png"]}, {"cloud": "b.ply"}]


def test_a_manifest_may_come_from_stdin(monkeypatch, tmp_path):
    stream = type("Stdin", (), {"buffer": io.BytesIO(b"\xef\xbb\xbfcloud,mask\na.ply,a.png\n")})
    monkeypatch.setattr("sys.stdin", stream)
    from pathlib import Path

    assert values(Path("-")) == [{"cloud": "a.ply", "mask": "a.png"}]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "is empty"),
        ("cloud,mask\n", "holds no item"),
        ("file,mask\na.ply,a.png\n", "its columns are file, mask, expected cloud, mask"),
        ("cloud,mask,mask\na,b,c\n", "has the column mask twice"),
        ("cloud,mask\na.ply\n", "row 2 has 1 cells, expected 2"),
        ("cloud,mask\n,a.png\n", "row 2 has no cloud"),
        ('cloud,mask\n"a.ply,a.png\n', "row 2 is not CSV"),
        ('{"cloud": "a.ply"}\n[1]\n', r"row 2 is \[1\], expected an object"),
        ('{"cloud": "a.ply"}\n{"cloud": \n', "row 2 is not JSON"),
        ('{"mask": "a.png"}\n', "row 1 has no cloud"),
    ],
)
def test_a_wrong_manifest_is_refused_with_its_row(manifest, text, message):
    assert_refused(message, read_manifest, manifest(text))


def test_a_picture_in_place_of_a_manifest_is_refused(tmp_path):
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n")
    assert_refused(r"a\.png: is not text, expected a manifest", read_manifest, tmp_path / "a.png")


def test_files_of_a_folder_belong_together_by_their_names(tmp_path):
    names = ("a.ply", "a.png", "a.camera.json", "in/b.glb", "in/b.mask.png", "c.npy", "c/1.png",
             "a.refined.ply", ".hidden.ply", "notes.txt")  # fmt: skip
    for name in names:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).touch()
    found = values(tmp_path)
    assert found == [
        {"cloud": f"{tmp_path}/a.ply", "mask": f"{tmp_path}/a.png",
         "camera": f"{tmp_path}/a.camera.json"},
        {"cloud": f"{tmp_path}/c.npy", "mask": f"{tmp_path}/c"},
        {"cloud": f"{tmp_path}/in/b.glb", "mask": f"{tmp_path}/in/b.mask.png"},
    ]  # fmt: skip
    (tmp_path / "d.ply").touch()
    assert_refused(r"found no mask for the clouds d\.ply; expected", read_manifest, tmp_path)


def test_clouds_masks_and_cameras_may_lie_apart(tmp_path):
    for name in ("clouds/x/a.ply", "masks/x/a.png", "cameras/x/a.json"):
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).touch()
    (found,) = values(tmp_path)
    assert found == {
        "cloud": f"{tmp_path}/clouds/x/a.ply",
        "mask": f"{tmp_path}/masks/x/a.png",
        "camera": f"{tmp_path}/cameras/x/a.json",
    }


@pytest.mark.parametrize("count", [1, 2, 3, 7])
def test_the_shards_of_a_batch_have_every_item_once(count):
    parts = [shard_of(list(range(10)), (index, count)) for index in range(1, count + 1)]
    assert sorted(sum(parts, [])) == list(range(10))
    assert max(map(len, parts)) - min(map(len, parts)) <= 1
