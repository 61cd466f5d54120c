"""The study of poses: what counts as found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tso_cli.geometry.rotations import from_vectors
from tso_cli.lab.studies import pose
from tso_cli.lab.studies.accuracy_cases import CaseBuilder
from tso_cli.lab.studies.parts import shapes_of_part
from tso_cli.lab.studies.pose import CLOUDS, TRUE, WRONG_PRIOR, judge, summarise
from tso_cli.pose.fit import Alternative, FittedCamera

from ..training import make_known
from .studying import MESHES, check_command, write_split


@pytest.fixture(scope="module")
def split(tmp_path_factory):
    folder = tmp_path_factory.mktemp("split")
    return write_split(folder, train=["car/qreal_SUV", "chair/q19_Chair"], validation=["car/qreal_Cop", "chair/kfurn_chair"])


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
    true, focals = case.views[0].camera, []
    answer = fitted(turned(true, 40.0), turned(true, 5.0))
    monkeypatch.setattr(pose, "fit_camera", lambda cloud, mask, focal: focals.append(focal) or answer)
    rows = judge(case)
    assert [row["cloud"] for row in rows] == [CLOUDS["other"], TRUE, WRONG_PRIOR]
    for row in rows:
        assert (row["degrees"], row["answers"]) == (pytest.approx(40.0), pytest.approx(5.0))
        assert (row["shortest"], row["longest"], row["sure"]) == (0.5, 2.0, True)
    # The last row's prior of the focal length is wrong.
    assert focals == [None, None, pytest.approx(1.2 * 64)]


def test_the_summary_counts_what_is_within_fifteen_degrees():
    rest = {"cloud": TRUE, "answers": 14.0, **dict.fromkeys(("shortest", "longest", "seconds"), 1.0)}
    row = summarise([{**rest, "degrees": d, "sure": s} for d, s in ((2.0, True), (14.9, False), (15.1, True))])[TRUE]
    assert (row["cases"], row["right"], row["answers"]) == (3, 2, 3)
    assert (row["sure"], row["sure_right"], row["median_degrees"]) == (2, 1, 14.9)
    assert pose.tables({"summary": {TRUE: row}})[0].rows[0][:7] == [TRUE, 3, 14.9, 2, 3, 2, 1]


@pytest.mark.slow
def test_the_command_finds_the_camera_of_a_true_cloud(split, tmp_path, capsys, monkeypatch):
    make_known(monkeypatch)
    monkeypatch.setattr(pose, "CATEGORIES", ("car",))
    arguments = ("pose", "--meshes", MESHES, "--split", split, "--views", 1)
    record = check_command(tmp_path / "pose.json", capsys, *arguments, words=("the true one",))
    assert record["complete"]
    assert record["summary"][TRUE]["answers"] == 1
