"""The studies, on the shipped shapes."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tso_cli.cli import main
from tso_cli.errors import InputError
from tso_cli.evaluation.metrics import chamfer
from tso_cli.lab.studies.points import study_points, summarise
from tso_cli.lab.studies.protocol import INITIAL_CHAMFER, build_cases, shape_type
from tso_cli.refinement import RefineConfig

from ..training import make_known

MESHES = Path(__file__).parents[2] / "examples" / "meshes"


def test_a_case_starts_from_another_shape_and_sees_the_whole_object():
    for case in build_cases(MESHES, "airplane", limit=2):
        assert case.start != case.shape
        assert case.chamfer_before == pytest.approx(chamfer(case.initial, case.target).chamfer)
        left, top, right, bottom = case.view.box()
        assert min(left, top) > 0.0
        assert max(right, bottom) < 63.0
        # the truth falls on its own mask, give or take a pixel
        pixels = np.rint(case.view.camera.project(case.target)[0]).astype(int)
        near = case.view.mask.copy()
        for axis in (0, 1):
            near = np.maximum(near, np.maximum(np.roll(near, 1, axis), np.roll(near, -1, axis)))
        assert (near[pixels[:, 1], pixels[:, 0]] > 0.5).mean() > 0.99


def test_the_start_is_the_shape_whose_error_is_nearest_to_the_categorys_level():
    case = build_cases(MESHES, "car", limit=1)[0]
    others = [c.initial for c in build_cases(MESHES, "car") if c.start != case.start and c.start != case.shape]
    level = INITIAL_CHAMFER["car"]
    for other in others:
        assert abs(chamfer(other, case.target).chamfer - level) >= abs(case.chamfer_before - level)


def test_variants_of_one_aeroplane_are_one_type():
    assert shape_type("fg_767_763") == shape_type("fg_767_767")
    assert shape_type("fg_767_763") != shape_type("fg_777_77F")
    assert shape_type("qreal_Cop") != shape_type("qreal_Cop_SUV")


def test_cases_depend_on_the_seed_alone():
    first, again, other = (build_cases(MESHES, "car", seed, limit=1)[0] for seed in (0, 0, 1))
    np.testing.assert_array_equal(first.target, again.target)
    np.testing.assert_array_equal(first.view.mask, again.view.mask)
    assert not np.array_equal(first.view.mask, other.view.mask)


def test_the_papers_settings_gain_on_the_shipped_shapes_and_nothing_gets_much_worse():
    record = study_points(MESHES, RefineConfig(), ["car"], limit=4)
    summary = record["summary"]["car"]
    assert summary["cases"] == 4
    assert summary["ratio_of_means"] < 0.98
    assert summary["worst_ratio"] < 1.02
    assert summary["iou_after"] > summary["iou_before"]


def test_the_summary_tells_ratio_of_means_from_mean_of_ratios():
    common = {"iou_before": 0.0, "iou_after": 0.0, "seconds": 0.0}
    records = [
        {"chamfer_before": 1.0, "chamfer_after": 0.5, "ratio": 0.5, **common},
        {"chamfer_before": 9.0, "chamfer_after": 9.9, "ratio": 1.1, **common},
    ]
    summary = summarise(records)
    assert summary["ratio_of_means"] == pytest.approx(1.04)
    assert summary["mean_ratio"] == pytest.approx(0.8)
    assert (summary["worst_ratio"], summary["worse"]) == (1.1, 1)


def test_a_folder_without_shapes_of_the_category_is_refused(tmp_path):
    with pytest.raises(InputError, match="chair"):
        build_cases(tmp_path, "chair")


def test_the_command_writes_the_record_and_a_chart_beside_it(tmp_path, capsys, monkeypatch):
    make_known(monkeypatch)
    output = tmp_path / "points.json"
    arguments = ["lab", "points", "--meshes", str(MESHES), "--category", "car", "--limit", "2", "-o", str(output)]
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    assert stopped.value.code == 0
    assert "after/before" in capsys.readouterr().out
    record = json.loads(output.read_text())
    assert record["summary"]["car"]["cases"] == len(record["cases"]) == 2
    with Image.open(output.with_suffix(".png")) as chart:
        assert chart.size[0] > 600
    with pytest.raises(SystemExit) as stopped:
        main(arguments)
    assert stopped.value.code == 2
    assert "exists" in capsys.readouterr().err
