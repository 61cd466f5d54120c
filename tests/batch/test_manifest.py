"""Manifests and folders become items; what is wrong is said with its row and column."""

import io
import json

import pytest

from tests.corruption import assert_refused
from tso_cli.batch import manifest as manifests
from tso_cli.batch.manifest import in_shard


@pytest.fixture
def manifest(tmp_path):
    def write(text, name="items.csv"):
        path = tmp_path / name
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


def read_manifest(path):
    return list(manifests.read_manifest(path))


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
        ("\ufeff \n\n", "is empty"),
        ("cloud,mask\nb\u00fc.ply,a.png\n".encode("latin-1"), r"not UTF-8 \(row 2 .* 0xfc"),
        ("cloud,mask\n".encode("utf-16"), "is not UTF-8"),
        ("cloud,mask\n".encode("utf-16-le"), "is not UTF-8"),
        ("cloud|mask\n", r"first row is cloud\|mask, expected .* with commas, semicolons"),
        ("cloud;mask\na.ply;a.png;b.png\n", "3 cells, expected 2 .* several masks .* need quotes"),
        ('{"cloud": "a.ply", "Cloud": "b.ply"}\n', "row 1 has the column cloud twice"),
        ("cloud,mask\n", "holds no item"),
        (
            "file,mask\na.ply,a.png\n",
            "its first row is file,mask, expected the columns cloud, mask",
        ),
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
    assert_refused(r"a\.png: is not UTF-8 \(row 1 .* a manifest", read_manifest, tmp_path / "a.png")


def test_an_empty_stdin_is_refused(monkeypatch):
    monkeypatch.setattr("sys.stdin", type("Stdin", (), {"buffer": io.BytesIO(b"")}))
    assert_refused("stdin: is empty", read_manifest, manifests.STDIN)


@pytest.mark.parametrize("separator", [",", ";", "\t"])
def test_the_header_says_what_separates_the_cells(manifest, separator):
    rows = [("Cloud", " MASK "), ("a.ply", '"a.png;b.png"')]
    path = manifest("\n".join(map(separator.join, rows)))
    assert values(path) == [{"cloud": "a.ply", "mask": "a.png;b.png"}]


def test_rows_end_at_line_feeds_alone(manifest):
    rows = [{"cloud": "a\u2028\x85.ply", "MASK": "a.png"}, {"cloud": "b.ply"}]
    path = manifest("\r\n".join(json.dumps(one, ensure_ascii=False) for one in rows))
    assert values(path) == [{"cloud": "a\u2028\x85.ply", "mask": "a.png"}, {"cloud": "b.ply"}]
    assert [one["cloud"] for one in values(manifest("cloud\na\u2028.ply\n"))] == ["a\u2028.ply"]


def test_a_manifest_may_be_at_an_address(manifest):
    pytest.importorskip("fsspec")
    path = manifest("cloud,mask\na.ply,a.png\n")
    address = f"file://{path}"
    assert values(address) == [{"cloud": "a.ply", "mask": "a.png"}]
    assert manifests.folder_of(address) == address.rpartition("/")[0]
    assert_refused("file:///none.csv: does not exist", read_manifest, "file:///none.csv")
    assert_refused("nothing://a.csv: cannot be opened", read_manifest, "nothing://a.csv")


def touch(folder, *names):
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).touch()


def test_files_of_a_folder_belong_together_by_their_names(tmp_path):
    names = ("a.ply", "a.png", "a.camera.json", "in/b.glb", "in/b.mask.png", "c.npy", "c/1.png",
             "a.refined.ply", ".hidden.ply", "notes.txt")  # fmt: skip
    touch(tmp_path, *names)
    found = values(tmp_path)
    assert found == [
        {"cloud": f"{tmp_path}/a.ply", "mask": f"{tmp_path}/a.png",
         "camera": f"{tmp_path}/a.camera.json", "output": "a.refined.ply"},
        {"cloud": f"{tmp_path}/c.npy", "mask": f"{tmp_path}/c", "output": "c.refined.ply"},
        {"cloud": f"{tmp_path}/in/b.glb", "mask": f"{tmp_path}/in/b.mask.png",
         "output": "in/b.refined.glb"},
    ]  # fmt: skip
    (tmp_path / "d.ply").touch()
    assert_refused(r"found no mask for the clouds d\.ply; expected", read_manifest, tmp_path)


def test_clouds_masks_and_cameras_may_lie_apart(tmp_path):
    touch(tmp_path, "clouds/x/a.ply", "masks/x/a.png", "cameras/x/a.json")
    (found,) = values(tmp_path)
    assert found == {
        "cloud": f"{tmp_path}/clouds/x/a.ply",
        "mask": f"{tmp_path}/masks/x/a.png",
        "camera": f"{tmp_path}/cameras/x/a.json",
        "output": "x/a.refined.ply",
    }


@pytest.mark.parametrize(
    ("names", "mask"),
    [
        (("a.png", "a.mask.png"), "a.mask.png"),
        (("a.png", "a/1.png"), "a"),
        (("a.png", "a/b.txt"), "a.png"),
        (("a.jpg", "a.png"), "a.png"),
        (("a.jpg",), "a.jpg"),
    ],
)
def test_of_several_masks_of_a_name_one_is_preferred(tmp_path, names, mask):
    touch(tmp_path, "a.ply", *names)
    assert [one["mask"] for one in values(tmp_path)] == [f"{tmp_path}/{mask}"]


@pytest.mark.parametrize("names", [("a", "a.mask.png"), ("a.png", "a.tif"), ("a.npy", "a.jpg")])
def test_two_masks_of_a_name_of_one_rank_are_refused(tmp_path, names):
    touch(tmp_path, "a.ply", *(name if "." in name else f"{name}/1.png" for name in names))
    found = ".*".join(f"/{name}" for name in names)
    assert_refused(rf"a\.ply: its mask may be .*{found}, expected one", read_manifest, tmp_path)


def test_two_clouds_of_a_name_and_a_folder_without_clouds_are_refused(tmp_path):
    assert_refused("holds no cloud; expected NAME.png or", read_manifest, tmp_path)
    touch(tmp_path, "a.ply", "a.glb", "a.png")
    assert_refused(r"a\.glb and a\.ply have one name", read_manifest, tmp_path)


@pytest.mark.parametrize("count", [1, 2, 3, 7])
def test_the_shards_of_a_batch_have_every_item_once(count):
    names = [f"scans/{number}.ply" for number in range(1000)]
    parts = [
        [name for name in names if in_shard(name, (index, count))] for index in range(1, count + 1)
    ]
    assert sorted(sum(parts, [])) == sorted(names)
    assert max(map(len, parts)) < 1.3 * len(names) / count


def test_the_shard_of_a_name_is_the_same_on_every_machine():
    found = [[in_shard(name, (i, 5)) for i in range(1, 6)].index(True) for name in "abc\u00fc"]
    assert found == [2, 1, 0, 4]


def test_lines_may_end_as_on_old_macs_and_columns_have_no_name(manifest):
    assert values(manifest("cloud,mask\ra.ply,a.png\r")) == [{"cloud": "a.ply", "mask": "a.png"}]
    assert values(manifest(",cloud,,\n0,a.ply,,\n")) == [{"": "0", "cloud": "a.ply"}]
