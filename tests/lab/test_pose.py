"""The study of poses: what counts as found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tso_cli.geometry.rotations import from_vectors
from tso_cli.geometry.view import View
from tso_cli.lab.studies import pose
from tso_cli.lab.studies.cases import Case
from tso_cli.lab.studies.pose import CLOUDS, TRUE, WRONG_PRIOR, conclude, judge
from tso_cli.pose.fit import Alternative, FittedCamera
from tso_cli.render import look_at


def test_the_first_answer_counts_and_the_nearest_of_all_beside_it(monkeypatch):
    true, focals = look_at(0.0, 0.0, 2.0, (64, 64)), []
    first, second = (
        replace(true, R=from_vectors(np.radians([0.0, angle, 0.0])) @ true.R)
        for angle in (40.0, 5.0)
    )
    focal = float(true.K[0, 0])
    fitted = FittedCamera(
        first, 0.9, 0.1, (Alternative(second, 0.8, 90.0),), (focal / 2, focal * 2)
    )
    monkeypatch.setattr(
        pose, "fit_camera", lambda cloud, mask, focal: focals.append(focal) or fitted
    )
    cloud = np.zeros((1, 3))
    rows = judge(
        Case(
            "other", "car", "car/a", 0, "car/b", cloud, cloud, cloud, (View(np.eye(64), true),), 0.0
        )
    )
    assert [row["cloud"] for row in rows] == [CLOUDS["other"], TRUE, WRONG_PRIOR]
    for row in rows:
        assert (row["degrees"], row["answers"]) == (pytest.approx(40.0), pytest.approx(5.0))
        assert (row["shortest"], row["longest"], row["sure"]) == (0.5, 2.0, True)
    # The last row's prior of the focal length is wrong.
    assert focals == [None, None, pytest.approx(1.2 * 64)]


def test_the_summary_counts_what_is_within_fifteen_degrees():
    rest = {
        "cloud": TRUE,
        "answers": 14.0,
        **dict.fromkeys(("shortest", "longest", "seconds"), 1.0),
    }
    summary = conclude(
        [{**rest, "degrees": d, "sure": s} for d, s in ((2.0, True), (14.9, False), (15.1, True))]
    )
    assert pose.tables(summary)[0].rows[0][:7] == [TRUE, 3, 14.9, 2, 3, 2, 1]
