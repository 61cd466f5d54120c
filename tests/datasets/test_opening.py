"""Recognising layouts, and the files that say what is for training."""

import numpy as np
import pytest

from tests.corruption import assert_refused
from tests.dataset_trees import CHAIR, write_pix3d, write_r2n2, write_shapenet
from tests.datasets.test_rendered import write
from tso_cli.datasets.opening import open_dataset
from tso_cli.datasets.splits import read_split


@pytest.mark.parametrize(
    ("make", "inside", "name"),
    [
        (write_shapenet, "", f"{CHAIR}/abc"),
        (write_shapenet, "ShapeNet_rendered", f"{CHAIR}/abc"),
        (write_r2n2, "", f"{CHAIR}/abc"),
        (write_pix3d, "", "chair/IKEA_X/model"),
        (lambda root: write(root / "chair/abc", 0), "", "chair/abc"),
    ],
)
def test_every_layout_is_recognised(tmp_path, make, inside, name):
    make(tmp_path / "data")
    data = open_dataset(tmp_path / "data" / inside, strict=True)
    assert [item.name for item in data.objects] == [name]
    assert data.objects[0].category == "chair"
    assert data.select([name], "split.json").objects[0].name == name


def test_an_unknown_layout_is_one_line_that_names_those_known(tmp_path):
    (tmp_path / "a/b").mkdir(parents=True)
    for path, message in (
        (tmp_path, "has no known layout"),
        (tmp_path / "none", "does not exist"),
    ):
        assert_refused(
            f"{message}.*ShapeNet_rendered.*ShapeNetRendering.*pix3d.json.*tso render",
            open_dataset,
            path,
        )
    (tmp_path / "file").touch()
    assert_refused("is a file", open_dataset, tmp_path / "file")


def test_two_layouts_in_one_folder_are_refused(tmp_path):
    write_shapenet(tmp_path)
    write_r2n2(tmp_path / "ShapeNetRendering")
    assert_refused(
        "holds ShapeNet_rendered and ShapeNetRendering, expected one", open_dataset, tmp_path
    )
    assert len(open_dataset(tmp_path / "ShapeNetRendering").objects) == 1


def test_a_json_split_is_read_in_its_order(tmp_path):
    path = tmp_path / "split.json"
    path.write_text('{"test": ["t"], "train": ["b", "a", "b"]}')
    assert read_split(path) == {"train": ["b", "a"], "test": ["t"]}


@pytest.mark.parametrize(
    ("inside", "kind"), [("", "txt"), ("splits", "npy"), ("ShapeNet_rendered/splits", "bytes")]
)
def test_the_authors_lists_are_a_split_with_their_category_before_the_name(tmp_path, inside, kind):
    folder = tmp_path / inside
    folder.mkdir(parents=True, exist_ok=True)
    lists = {
        "03001627_train": ["b", "a"],
        "02958343_train": ["c"],
        "03001627_val": ["v"],
        "03001627_test": ["t"],
    }
    for name, names in lists.items():
        stem = folder / f"{name}_list"
        if kind == "txt":
            stem.with_suffix(".txt").write_text("\n".join(names) + "\r\n\n")
        else:
            np.save(
                stem.with_suffix(".npy"), np.array(names, dtype="S" if kind == "bytes" else "U")
            )
    assert read_split(tmp_path) == {
        "train": ["02958343/c", "03001627/b", "03001627/a"],
        "validation": ["03001627/v"],
        "test": ["03001627/t"],
    }


def test_a_split_selects_objects_and_skipped_ones_are_not_missed(tmp_path):
    write_shapenet(tmp_path, ("a", "b", "c"))
    (tmp_path / "ShapeNet_rendered" / CHAIR / "b" / "view.txt").unlink()
    (tmp_path / "splits").mkdir()
    path = tmp_path / "splits" / f"{CHAIR}_train_list.txt"
    path.write_text("c\nb\n")
    data = open_dataset(tmp_path)
    assert [
        item.name for item in data.select(read_split(tmp_path)["train"], str(path)).objects
    ] == [f"{CHAIR}/c"]
    path.write_text("c\nnone\n")
    message = f"_train_list.txt: names {CHAIR}/none, expected objects of"
    assert_refused(message, data.select, read_split(tmp_path)["train"], str(path))


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("split.json", b"{", "is not JSON"),
        ("split.json", b"[]", r"holds \[\], expected"),
        (
            "split.json",
            b'{"training": []}',
            "has the part 'training', expected train, validation, test",
        ),
        ("split.json", b'{"train": [1]}', r"train is \[1\], expected a list of names"),
        ("split.json", b'{"train": []}', "names no object"),
        ("split.json", b'{"train": ["a", "b"], "test": ["b"]}', "names 'b' for train and for test"),
        ("0_val_list.npy", b"PK\x03\x04", r"is not a readable \.npy file"),
        ("0_val_list.npy", np.zeros(3), r"holds 'float64' \[3\], expected an array of texts"),
        (
            "0_val_list.npy",
            np.array([{}]),
            r"holds pickled Python objects.*numpy\.save.*astype\(str\).*\.txt",
        ),
        ("0_test_list.txt", b"\xff\xfe\x00", "is not text"),
        ("0_notes.txt", b"a", "holds no list, expected SYNSET_train_list"),
    ],
)
def test_a_damaged_split_is_one_clear_line(tmp_path, name, content, message):
    path = tmp_path / name
    path.write_bytes(content) if isinstance(content, bytes) else np.save(path, content)
    assert_refused(f"{tmp_path}.*{message}", read_split, path if name == "split.json" else tmp_path)
