"""The study of points mode: what its cases are, and what is made of their figures."""

from __future__ import annotations

import shutil

import numpy as np
import pytest

from tso_cli.errors import InputError
from tso_cli.evaluation.metrics import chamfer
from tso_cli.lab.studies.parts import shape_type
from tso_cli.lab.studies.points import INITIAL_CHAMFER, build_cases

from ..training import make_known
from .studying import MESHES, check_command


@pytest.fixture(scope="module")
def meshes(tmp_path_factory):
    """Four of the shipped cars."""
    folder = tmp_path_factory.mktemp("meshes") / "car"
    folder.mkdir()
    for path in sorted((MESHES / "car").glob("*.ply"))[:4]:
        shutil.copy(path, folder)
    return folder.parent


@pytest.fixture(scope="module")
def cars(meshes):
    return build_cases(meshes, "car")


def test_a_case_starts_from_the_shape_nearest_to_the_categorys_level_and_sees_the_whole_object(cars):
    for case in cars[:2]:
        assert case.start != case.shape
        before = chamfer(case.initial, case.target).chamfer
        for other in (other.initial for other in cars if other.start not in (case.start, case.shape)):
            level = INITIAL_CHAMFER["car"]
            assert abs(chamfer(other, case.target).chamfer - level) >= abs(before - level)
        left, top, right, bottom = case.view.box()
        assert min(left, top) > 0.0 and max(right, bottom) < 63.0
        # the truth falls on its own mask, give or take a pixel
        pixels = np.rint(case.view.camera.project(case.target)[0]).astype(int)
        near = case.view.mask.copy()
        for axis in (0, 1):
            near = np.maximum(near, np.maximum(np.roll(near, 1, axis), np.roll(near, -1, axis)))
        assert (near[pixels[:, 1], pixels[:, 0]] > 0.5).mean() > 0.99


def test_variants_of_one_aeroplane_are_one_type():
    assert shape_type("fg_767_763") == shape_type("fg_767_767") != shape_type("fg_777_77F")
    assert shape_type("qreal_Cop") != shape_type("qreal_Cop_SUV")


@pytest.mark.slow
def test_the_papers_settings_gain_on_the_shipped_shapes_and_nothing_gets_much_worse(tmp_path, capsys, monkeypatch):
    make_known(monkeypatch)
    arguments = ("points", "--meshes", MESHES, "--category", "car", "--limit", 4)
    record = check_command(tmp_path / "points.json", capsys, *arguments, words=("after/before", "car"))
    summary = record["summary"]["car"]
    assert summary["cases"] == 4
    assert summary["ratio_of_means"] < 0.98
    assert summary["worst_ratio"] < 1.02
    assert summary["iou_after"] > summary["iou_before"]


def test_a_folder_without_shapes_of_the_category_is_refused(tmp_path):
    with pytest.raises(InputError, match="chair"):
        build_cases(tmp_path, "chair")
