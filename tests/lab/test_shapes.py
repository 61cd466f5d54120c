"""The shapes of a split, their pictures, and the network of a study."""

from __future__ import annotations

import json

import numpy as np
import pytest

from tso_cli.errors import InputError
from tso_cli.render.settings import RenderSettings
from tso_lab.studies.shapes import see, shapes_of_part, view_aligned_network

from .studying import MESHES, thin_checkpoint, write_split

NAMES = [
    "car/qreal_Cop",
    "car/qreal_SUV",
    "car/qbasic_RaceCar",
    "chair/q19_Chair",
    "chair/q17_Chair",
]


@pytest.fixture
def split(tmp_path):
    return write_split(tmp_path, test=NAMES, validation=["chair/kfurn_chair"])


def test_only_shapes_of_the_part_are_studied_spread_over_each_category(split):
    def names(*arguments, **options):
        return [shape.name for shape in shapes_of_part(MESHES, split, *arguments, **options)]

    assert sorted(names()) == sorted(NAMES)
    assert names("validation") == ["chair/kfurn_chair"]
    assert names(limit=2) == [
        "car/qreal_Cop",
        "car/qbasic_RaceCar",
        "chair/q19_Chair",
        "chair/q17_Chair",
    ]
    assert names(categories=["chair"], limit=1) == ["chair/q19_Chair"]


def test_a_shape_or_category_that_is_not_there_is_named(split, tmp_path):
    with pytest.raises(InputError, match="aeroplane"):
        shapes_of_part(MESHES, split, categories=["aeroplane"])
    with pytest.raises(InputError, match="train"):
        shapes_of_part(MESHES, split, "train")
    split.write_text(json.dumps({"test": [*NAMES, "car/Batmobile"]}))
    with pytest.raises(InputError, match=r"car/Batmobile \(1 of 6 are missing\)"):
        shapes_of_part(MESHES, split)


@pytest.mark.slow
def test_a_shape_is_seen_alike_whatever_else_is_studied(split):
    settings = RenderSettings(views=2)
    alone = see(shapes_of_part(MESHES, split, limit=1)[0], settings, 0)
    again, other_seed = (see(shapes_of_part(MESHES, split)[0], settings, seed) for seed in (0, 1))
    np.testing.assert_array_equal(alone.target, again.target)
    np.testing.assert_array_equal(alone.views[1].image, again.views[1].image)
    assert not np.array_equal(alone.views[1].image, other_seed.views[1].image)


def test_a_network_of_another_frame_is_refused(tmp_path, monkeypatch):
    with pytest.raises(InputError, match="view-aligned"):
        view_aligned_network(thin_checkpoint(tmp_path, monkeypatch, 64, frame="canonical"))
