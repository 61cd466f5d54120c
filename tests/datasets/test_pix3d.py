"""Pix3D: photos with masks, aligned models and cameras."""

import numpy as np
import pytest
from PIL import Image

from tests.corruption import assert_refused
from tests.dataset_trees import (
    agreement,
    agreement_of_surface,
    lopsided,
    write_entries,
    write_pix3d,
)
from tso_cli.datasets import pix3d
from tso_cli.datasets.pix3d import open_pix3d
from tso_cli.errors import InputError
from tso_cli.geometry.points import normalise_longest_side
from tso_cli.io.meshes import Mesh

NAME = "chair/IKEA_X/model"


def model_vertices():
    return 1.7 * lopsided().vertices + np.array([0.4, -0.3, 0.2])


@pytest.fixture
def entries(tmp_path):
    return write_pix3d(tmp_path)


def test_the_target_seen_by_the_cameras_covers_the_masks(tmp_path, entries):
    (item,) = open_pix3d(tmp_path).objects
    assert (item.name, item.category, len(item.views)) == (NAME, "chair", 3)
    assert np.ptp(item.target(), axis=0).max() == pytest.approx(1.0, abs=0.02)
    assert agreement(item) > 0.85
    assert (
        agreement_of_surface(item, Mesh(normalise_longest_side(model_vertices()), lopsided().faces))
        > 0.98
    )


def test_a_point_lands_where_the_data_sets_own_formula_puts_it(tmp_path, entries):
    """u = w/2 - f X/Z, v = h/2 - f Y/Z from the picture's corner; X = rot_mat x + trans_mat."""
    vertices = model_vertices()
    for entry, view in zip(entries, open_pix3d(tmp_path).objects[0].views, strict=True):
        point = vertices @ np.array(entry["rot_mat"]).T + entry["trans_mat"]
        focal = entry["focal_length"] / 32 * entry["img_size"][0]
        expected = np.array(entry["img_size"]) / 2 - focal * point[:, :2] / point[:, 2:] - 0.5
        np.testing.assert_allclose(
            view.camera.project(normalise_longest_side(vertices))[0], expected, atol=1e-4
        )


def test_models_are_read_once_and_only_when_needed(tmp_path, entries, monkeypatch):
    reads = []
    original = pix3d._read
    monkeypatch.setattr(pix3d, "_read", lambda path: (reads.append(path), original(path))[1])
    data = open_pix3d(tmp_path)
    assert reads == []
    for _ in range(2):
        for view in data.objects[0].views:
            view.load()
    assert len(reads) == 1


@pytest.mark.parametrize("flag", ["truncated", "slightly_occluded"])
def test_objects_partly_out_of_sight_are_left_out_even_if_strict(tmp_path, entries, flag):
    entries[1][flag] = True
    write_entries(tmp_path, entries)
    data = open_pix3d(tmp_path, strict=True)
    assert [view.name[-8:] for view in data.objects[0].views] == ["0000.png", "0002.png"]
    assert (
        f"entry 1 (img/chair/0001.png): the object is {flag.replace('_', ' ')}"
        in data.skipped["img/chair/0001.png"]
    )


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("img", None, r"pix3d\.json: entry 1 \(entry 1\): img is None, expected a text"),
        (
            "mask",
            "mask/chair/none.png",
            r"mask/chair/none\.png: does not exist, .*entry 1 \(img/chair/0001\.png\) names it",
        ),
        ("category", 3, "category is 3, expected a text"),
        ("rot_mat", [[1, 0], [0, 1]], "rot_mat is .*, expected 3 x 3 finite numbers"),
        (
            "rot_mat",
            [[1, 0, 0], [0, 1, 0], [0, 0, -1]],
            r"entry 1 \(img/chair/0001\.png\): R is not a rotation",
        ),
        ("focal_length", None, "focal_length is None, expected a finite number"),
        ("img_size", [88.5, 60], r"img_size is \[88\.5, 60\], expected 2 whole numbers"),
    ],
)
def test_a_damaged_entry_is_named_and_skipped_or_an_error(tmp_path, entries, key, value, message):
    entries[1][key] = value
    write_entries(tmp_path, entries)
    data = open_pix3d(tmp_path)
    assert len(data.skipped) == 1
    assert len(data.objects[0].views) == 2
    with pytest.raises(InputError, match=message) as raised:
        open_pix3d(tmp_path, strict=True)
    assert str(raised.value) in data.skipped.values()
    assert "\n" not in str(raised.value)


def test_a_damaged_model_is_named_when_its_views_or_points_are_loaded(tmp_path, entries):
    (tmp_path / entries[0]["model"]).write_text("v 0 0 0\n")
    (item,) = open_pix3d(tmp_path).objects
    for load in (item.views[0].load, item.target):
        assert_refused(r"model\.obj: ", load)


def test_pictures_of_another_size_than_the_table_says_are_named_when_loaded(tmp_path, entries):
    Image.new("RGB", (60, 88)).save(tmp_path / "img/chair/0000.png")
    Image.new("L", (88, 61)).save(tmp_path / "mask/chair/0001.png")
    views = open_pix3d(tmp_path, strict=True).objects[0].views
    assert_refused("img/chair/0000.png: is 60x88, expected 88x60 as pix3d.json", views[0].load)
    assert_refused("0001.png: is 88x61", views[1].load)


def test_a_table_of_another_form_is_one_clear_line(tmp_path):
    for content, message in {
        "[{": "is not JSON",
        "{}": "holds a dict, expected a list",
        "[]": "holds no object, expected entries",
        "[3]": "no object can be used, the first: .*entry 0.*: is a int",
    }.items():
        (tmp_path / "pix3d.json").write_text(content)
        assert_refused(message, open_pix3d, tmp_path)
