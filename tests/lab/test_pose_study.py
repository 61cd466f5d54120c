"""The study of poses: what counts as found, and a stopped one goes on."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.readme_evidence import pose_table
from tso_cli.cli import main
from tso_cli.geometry.rotations import from_vectors
from tso_cli.lab.studies import pose
from tso_cli.lab.studies.accuracy_cases import CaseBuilder
from tso_cli.lab.studies.parts import shapes_of_part
from tso_cli.lab.studies.pose import CLOUDS, TRUE, WRONG_PRIOR, PoseConfig, judge, study_pose, summarise
from tso_cli.pose.fit import Alternative, FittedCamera
from tso_cli.refinement.symmetry import find_mirror_plane

from ..training import make_known

MESHES = Path(__file__).parents[2] / "examples" / "meshes"
TRAIN = ["car/qreal_SUV", "chair/q19_Chair"]


@pytest.fixture(scope="module")
def split(tmp_path_factory):
    path = tmp_path_factory.mktemp("split") / "split.json"
    path.write_text(json.dumps({"train": TRAIN, "validation": ["car/qreal_Cop", "chair/kfurn_chair"]}))
    return path


@pytest.fixture(scope="module")
def case(split):
    shape = shapes_of_part(MESHES, split, "validation", ["car"])[0]
    return CaseBuilder(MESHES, split, views=1, size=64, points=1024).cases(shape, "other")[0]


def fitted(camera, *others) -> FittedCamera:
    alternatives = tuple(Alternative(other, 0.8, 90.0) for other in others)
    return FittedCamera(camera, 0.9, 0.1, alternatives, (60.0, 240.0))


def turned(camera, degrees: float):
    return replace(camera, R=from_vectors(np.radians([0.0, degrees, 0.0])) @ camera.R)


def test_an_answer_counts_by_its_angle_the_others_as_one_of_the_answers(case, monkeypatch):
    true = case.views[0].camera
    monkeypatch.setattr(pose, "fit_camera", lambda *_, **__: fitted(turned(true, 40.0), turned(true, 5.0)))
    found = judge(case)
    assert [one["cloud"] for one in found] == [CLOUDS["other"], TRUE, WRONG_PRIOR]
    for one in found:
        assert one["degrees"] == pytest.approx(40.0)
        assert one["answers"] == pytest.approx(5.0)
        assert (one["shortest"], one["longest"], one["sure"]) == (0.5, 2.0, True)


def test_the_pose_that_a_distant_camera_cannot_tell_apart_counts_as_mirrored_in_depth(case, monkeypatch):
    true, normal = case.views[0].camera, find_mirror_plane(case.target).normal
    other = replace(true, R=np.diag([1.0, 1.0, -1.0]) @ true.R @ (np.eye(3) - 2.0 * np.outer(normal, normal)))
    # The cloud falls where it fell, as far as the picture without perspective tells: each point, or its mirror image.
    mirrored = find_mirror_plane(case.target).reflect(case.target)
    np.testing.assert_allclose((mirrored @ other.R.T)[:, :2], (case.target @ true.R.T)[:, :2], atol=0.02)
    monkeypatch.setattr(pose, "fit_camera", lambda *_, **__: fitted(other))
    assert all(one["mirrored"] < 1e-3 < one["degrees"] for one in judge(case))


def test_the_focal_length_is_taken_from_the_prior_that_the_row_says(case, monkeypatch):
    asked = []
    monkeypatch.setattr(pose, "fit_camera", lambda cloud, mask, focal: asked.append(focal) or fitted(case.views[0].camera))
    judge(case)
    assert asked == [None, None, pytest.approx(1.2 * 64)]


def test_the_summary_counts_what_is_within_fifteen_degrees():
    def one(degrees, sure):
        return {"cloud": TRUE, "degrees": degrees, "mirrored": 1.0, "answers": 14.0, "sure": sure} | dict.fromkeys(
            ("shortest", "longest", "seconds"), 1.0
        )

    own = summarise([one(2.0, True), one(14.9, False), one(15.1, True)])[TRUE]
    assert (own["cases"], own["right"], own["mirrored"], own["answers"]) == (3, 2, 3, 3)
    assert (own["sure"], own["sure_right"], own["median_degrees"]) == (2, 1, 14.9)
    assert "| the true one | 14.9 | 2 of 3 | 3 of 3 | 3 of 3 | 2 (1) |" in pose_table({"summary": {TRUE: own}})


def tso(*arguments) -> int:
    with pytest.raises(SystemExit) as stopped:
        main([str(argument) for argument in arguments])
    return stopped.value.code


def test_the_command_finds_the_camera_of_a_true_cloud_and_goes_on_from_its_record(split, tmp_path, capsys, monkeypatch):
    make_known(monkeypatch)
    monkeypatch.setattr(pose, "CATEGORIES", ("car",))
    output = tmp_path / "pose.json"
    arguments = ["lab", "pose", "--meshes", MESHES, "--split", split, "--views", 1, "-o", output]
    assert tso(*arguments) == 0
    assert "the true one" in capsys.readouterr().out
    record = json.loads(output.read_text())
    assert record["complete"]
    assert record["summary"][TRUE]["mirrored"] == 1
    with Image.open(output.with_suffix(".png")) as picture:
        assert min(picture.size) > 100
    assert tso(*arguments, "--resume", "--json") == 0
    assert json.loads(capsys.readouterr().out)["cases"] == record["cases"]
    kept = {**record, "cases": []}
    assert [case["cloud"] for case in study_pose(MESHES, PoseConfig(views=1), split, kept)["cases"]] == [
        case["cloud"] for case in record["cases"]
    ]
