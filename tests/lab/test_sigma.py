"""The study of sigma^2: the true cloud's silhouette against the mask."""

from __future__ import annotations

import numpy as np
import pytest

from tso_cli.lab.studies.shapes import Shape, see
from tso_cli.lab.studies.sigma import SIGMAS, conclude, mask_errors
from tso_cli.losses.silhouette import silhouette_of
from tso_cli.render import RenderSettings

from .studying import MESHES


def test_the_error_is_the_mean_difference_of_silhouette_and_mask():
    seen = see(Shape("car/qreal_Cop", MESHES / "car" / "qreal_Cop.ply"), RenderSettings(views=2), 0)
    errors = mask_errors(seen, [0.4])
    expected = np.mean(
        [
            np.abs(silhouette_of(seen.target, v.camera, 0.4) - v.mask / 255.0).mean()
            for v in seen.views
        ]
    )
    assert errors["l1"][0] == pytest.approx(expected)
    assert errors["l1"][0] == pytest.approx(errors["missing"][0] + errors["stray"][0])


def test_aeroplanes_want_a_narrower_gaussian_than_cars_and_the_paper_is_near_the_best():
    cases = []
    for shape in (
        "car/qreal_Cop",
        "car/qreal_SUV",
        "airplane/qplane_MilitaryAirplane2",
        "airplane/qplane_SmallPlane",
    ):
        seen = see(Shape(shape, MESHES / f"{shape}.ply"), RenderSettings(views=1), 0)
        cases.append({"category": shape.split("/")[0], "shape": shape, **mask_errors(seen)})
        # A wider Gaussian leaves fewer holes and strays farther.
        assert (np.diff(cases[-1]["missing"]) < 0.0).all()
        assert (np.diff(cases[-1]["stray"]) > 0.0).all()
    record = conclude([*cases, {**cases[0], "category": "tricycle"}])
    summary = record["summary"]
    assert summary["airplane"]["best"] < summary["car"]["best"]
    for row in (summary["airplane"], summary["car"]):
        assert row["l1_at_best"] == min(row["l1"]) == row["l1"][SIGMAS.index(row["best"])]
        assert row["l1_at_paper"] == row["l1"][SIGMAS.index(row["paper"])]
        assert 0.5 <= row["best"] / row["paper"] <= 2.0
    assert summary["all"]["shapes"] == 5
    assert [claim["holds"] for claim in record["claims"]][:3] == [True, True, True]
    # The paper says nothing of tricycles.
    assert summary["tricycle"]["paper"] is summary["tricycle"]["l1_at_paper"] is None
