"""The study of poses: what counts as found."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tso_cli.geometry.rotations import from_vectors
from tso_cli.geometry.view import View
from tso_cli.pose.fit import Alternative, FittedCamera
from tso_cli.render.viewpoints import look_at
from tso_lab.studies import pose
from tso_lab.studies.cases import Case


def test_the_first_answer_counts_and_so_does_the_nearest_of_all():
    true = look_at(0.0, 0.0, 2.0, (64, 64))
    first, second = (
        replace(true, R=from_vectors(np.radians([0.0, angle, 0.0])) @ true.R)
        for angle in (40.0, 5.0)
    )
    focal, cloud = float(true.K[0, 0]), np.zeros((1, 3))
    alternatives = (Alternative(second, 0.8, 0.4, 90.0),)
    fitted = FittedCamera(first, 0.9, 0.1, alternatives, (focal / 2, focal * 2))
    names = ("other", "car", "car/a", 0, "car/b")
    case = Case(*names, cloud, cloud, cloud, (View(np.eye(64), true),), 0.0)
    row = pose.figures(case, fitted)
    assert (row["degrees"], row["answers"]) == (pytest.approx(40.0), pytest.approx(5.0))
    assert (row["shortest"], row["longest"], row["sure"]) == (0.5, 2.0, True)


def test_the_summary_counts_cases_within_three_and_fifteen_degrees():
    rest = {"cloud": pose.TRUE, "answers": 14.0, "shortest": 1.0, "longest": 1.0, "seconds": 1.0}
    found = ((2.0, True), (14.9, False), (15.1, True))
    summary = pose.conclude([{**rest, "degrees": d, "sure": sure} for d, sure in found])
    assert pose.tables(summary)[0].rows[0][:7] == [pose.TRUE, 3, 14.9, 1, 2, 3, 2]
