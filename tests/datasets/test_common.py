"""What holds for both layouts of SYNSET/MODEL folders: the CAPNet authors' and 3D-R2N2's."""

import pickle
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import pytest
from PIL import Image

from tests.corruption import assert_one_line, assert_refused
from tests.dataset_trees import CHAIR, write_clouds, write_r2n2, write_shapenet
from tso_cli.datasets.r2n2 import open_r2n2
from tso_cli.datasets.shapenet import open_shapenet
from tso_cli.errors import InputError

CLOUD = f"ShapeNet_pcl/{CHAIR}/abc/pcl_1024_fps_trimesh.npy"


class Layout(NamedTuple):
    open: Callable[..., Any]
    pictures: str  # folder of the model's pictures
    table: str
    names: tuple[str, str, str]  # of the three pictures


AUTHORS = Layout(
    open_shapenet,
    f"ShapeNet_rendered/{CHAIR}/abc",
    "view.txt",
    ("render_0.png", "render_1.png", "render_2.png"),
)
R2N2 = Layout(
    open_r2n2,
    f"ShapeNetRendering/{CHAIR}/abc/rendering",
    "rendering_metadata.txt",
    ("00.png", "01.png", "02.png"),
)


@pytest.fixture(params=[AUTHORS, R2N2], ids=["authors", "r2n2"])
def layout(request, tmp_path):
    """Two models with clouds, in tmp_path."""
    if request.param is AUTHORS:
        write_shapenet(tmp_path, ("abc", "def"))
    else:
        write_r2n2(tmp_path / "ShapeNetRendering", ("abc", "def"))
        write_clouds(tmp_path, "abc", "def")
    return request.param


def test_views_are_a_sequence_that_can_go_to_another_process(layout, tmp_path):
    views = layout.open(tmp_path).objects[0].views
    assert [view.name for view in views] == [views[number].name for number in range(3)]
    assert views[-1].name == views[2].name
    assert views[-1].name.endswith(layout.names[2])
    with pytest.raises(IndexError):
        views[3]
    assert pickle.loads(pickle.dumps(views))[1].name == views[1].name


BROKEN = [
    (AUTHORS, ["10 20", "10 up", "10 20"], "", r"view\.txt: line 2 has 'up'"),
    (
        AUTHORS,
        ["10 20", "10 20"],
        "render_2.png",
        r"view\.txt: has 2 rows, expected one for render_2\.png",
    ),
    (
        AUTHORS,
        ["10 20 0 2", "10 20 5 2", "10 20 0 2"],
        "render_1.png",
        r"view\.txt: line 2 has a tilt of 5",
    ),
    (
        AUTHORS,
        ["10 20 0 2", "10 20 0 2", "10 20 0 -1"],
        "render_2.png",
        r"view\.txt: line 3 has a distance of -1",
    ),
    (AUTHORS, "depth_1.png", "render_1.png", r"depth_1\.png: does not exist"),
    (AUTHORS, "render_*.png", "", "holds no picture"),
    (R2N2, ["1 2"], "", r"rendering_metadata\.txt: line 1 has 2 numbers, expected 4 or more"),
    (
        R2N2,
        ["1 2 0 0.8 25"] * 2,
        "02.png",
        r"rendering_metadata\.txt: has 2 rows, expected one for 02\.png",
    ),
    (
        R2N2,
        ["1 2 0 0 25", *["1 2 0 0.8 25"] * 2],
        "00.png",
        r"_metadata\.txt: line 1 has a distance ratio of 0",
    ),
    (R2N2, "01.png", "'01.png'", r"renderings\.txt: names '01\.png'"),
    (R2N2, "*s.txt *.png", "", "holds no picture"),
    (R2N2, "", "", "rendering: does not exist"),
]


@pytest.mark.parametrize(("layout", "change", "picture", "message"), BROKEN, indirect=["layout"])
def test_what_is_missing_is_named_and_skipped_or_an_error(
    layout, tmp_path, change, picture, message
):
    """The rows of the table change or files are deleted; without either, the folder is missing."""
    folder = tmp_path / layout.pictures
    if isinstance(change, list):
        (folder / layout.table).write_text("\n".join(change) + "\n")
    elif not change:
        folder.rename(folder.with_name("other"))
    for path in (
        [path for pattern in change.split() for path in folder.glob(pattern)]
        if isinstance(change, str)
        else ()
    ):
        path.unlink()
    data = layout.open(tmp_path)
    item = f"{CHAIR}/abc/{picture}" if picture else f"{CHAIR}/abc"
    assert list(data.skipped) == [item]
    with pytest.raises(InputError, match=message) as raised:
        layout.open(tmp_path, strict=True)
    assert_one_line(data.skipped[item])
    assert str(raised.value) == data.skipped[item]
    usable = {item.name: len(item.views) for item in data.objects}
    assert usable == ({f"{CHAIR}/abc": 2} if picture else {}) | {f"{CHAIR}/def": 3}


def test_a_model_without_its_3d_file_keeps_its_pictures(layout, tmp_path):
    (tmp_path / CLOUD).unlink()
    lacking, whole = layout.open(tmp_path, strict=True).objects
    assert (lacking.target, len(lacking.views)) == (None, 3)
    assert (
        lacking.lacking == f"{tmp_path / CLOUD}: does not exist, expected the shape of this object"
    )
    assert whole.target is not None
    assert whole.lacking == ""
    (tmp_path / "ShapeNet_pcl").rename(tmp_path / "other")
    assert [(item.target, item.lacking) for item in layout.open(tmp_path).objects] == [
        (None, "")
    ] * 2


def test_a_damaged_picture_says_so_when_it_is_loaded(layout, tmp_path):
    folder, authors = tmp_path / layout.pictures, layout is AUTHORS
    path = folder / layout.names[0]
    path.write_bytes(path.read_bytes()[:100])
    if authors:
        (folder / "depth_1.png").write_bytes(b"not a picture")
        messages = (
            r"render_0\.png: is not",
            r"depth_1\.png: is not a readable",
            r"depth_2\.png: is 32x64, expected 64x64",
        )
    else:
        Image.new("RGB", (64, 64)).save(folder / "01.png")
        messages = (
            r"00\.png: is not",
            r"01\.png: has no alpha",
            r"02\.png: is 32x64, expected 64x64",
        )
    Image.new("L" if authors else "RGBA", (32, 64)).save(
        folder / ("depth_2.png" if authors else "02.png")
    )
    views = layout.open(tmp_path, strict=True).objects[0].views
    assert views[0].camera.width == 64  # from the next picture that can be read
    for number, message in enumerate(messages):
        assert_refused(message, views[number].load)


def test_a_pickled_cloud_is_not_loaded(layout, tmp_path):
    np.save(tmp_path / CLOUD, np.array([{}], dtype=object))
    assert_refused(
        r"pcl_1024_fps_trimesh\.npy: holds values of type 'object'",
        layout.open(tmp_path).objects[0].target,
    )


@pytest.mark.parametrize(
    ("layout", "folder", "expected"),
    [
        (AUTHORS, "ShapeNet_rendered", "ShapeNet_rendered/SYNSET/MODEL"),
        (R2N2, "ShapeNetRendering", "SYNSET/MODEL/rendering"),
    ],
)
def test_an_empty_folder_is_no_data_set(tmp_path, layout, folder, expected):
    (tmp_path / folder).mkdir()
    assert_refused(f"holds no object, expected {expected}", layout.open, tmp_path)
