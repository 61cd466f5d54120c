"""The study of sigma^2: the true cloud's silhouette against the mask."""

from __future__ import annotations

import numpy as np
import pytest

from tso_cli.lab.studies import sigma
from tso_cli.lab.studies.parts import see, shapes_of_part
from tso_cli.lab.studies.sigma import SIGMAS, mask_errors
from tso_cli.lab.study import Progress
from tso_cli.render import RenderSettings
from tso_cli.silhouette.projection import silhouette_of

from ..training import make_known
from .studying import MESHES, check_command, write_split

NAMES = ["car/qreal_Cop", "car/qreal_SUV", "airplane/qplane_MilitaryAirplane2", "airplane/qplane_SmallPlane", "chair/q17_Chair"]


@pytest.fixture(scope="module")
def record(tmp_path_factory):
    """The study of five shapes."""
    split = write_split(tmp_path_factory.mktemp("split"), test=NAMES)
    return sigma.run(Progress(), meshes=MESHES, split=split, part="test", categories=(), limit=None, views=1, seed=0)


def test_the_error_is_the_mean_difference_of_silhouette_and_mask(tmp_path):
    shape = shapes_of_part(MESHES, write_split(tmp_path, test=NAMES[:1]))[0]
    seen = see(shape, RenderSettings(views=2), 0)
    errors = mask_errors(seen, [0.4])
    expected = np.mean([np.abs(silhouette_of(seen.target, v.camera, 0.4) - v.mask / 255.0).mean() for v in seen.views])
    assert errors["l1"][0] == pytest.approx(expected)
    assert errors["l1"][0] == pytest.approx(errors["missing"][0] + errors["stray"][0])


def test_a_wider_gaussian_leaves_fewer_holes_and_strays_farther(record):
    for row in record["shapes"]:
        assert (np.diff(row["missing"]) < 0.0).all()
        assert (np.diff(row["stray"]) > 0.0).all()


def test_aeroplanes_want_a_narrower_gaussian_than_cars_and_the_paper_is_near_the_best(record):
    summary = record["summary"]
    assert summary["airplane"]["best"] < summary["car"]["best"]
    for row in (summary["airplane"], summary["car"]):
        assert row["l1_at_best"] == min(row["l1"]) == row["l1"][SIGMAS.index(row["best"])]
        assert row["l1_at_paper"] == row["l1"][SIGMAS.index(row["paper"])]
        assert 0.5 <= row["best"] / row["paper"] <= 2.0
    assert summary["all"]["shapes"] == 5
    assert [claim["holds"] for claim in record["claims"]][:3] == [True, True, True]


@pytest.mark.slow
def test_the_command_states_the_best_beside_the_papers_even_of_a_category_that_the_paper_lacks(tmp_path, capsys, monkeypatch):
    make_known(monkeypatch)
    folder = tmp_path / "meshes" / "tricycle"
    folder.mkdir(parents=True)
    (folder / "one.ply").write_bytes((MESHES / "car" / "qreal_Cop.ply").read_bytes())
    split = write_split(tmp_path, test=["tricycle/one"])
    arguments = ("sigma", "--meshes", folder.parent, "--split", split, "--views", 1, "--limit", 1)
    record = check_command(tmp_path / "sigma.json", capsys, *arguments, words=("best sigma^2", "the paper's", "tricycle"))
    row = record["summary"]["tricycle"]
    assert row["best"] in SIGMAS
    assert row["paper"] is row["l1_at_paper"] is None
