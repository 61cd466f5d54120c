"""What a prior learns from: how priors are judged, and what the record shows."""

import numpy as np
import pytest
import torch

from tso_cli.io.shipped import examples_folder
from tso_cli.prior.network import TROUBLES, initial
from tso_cli.train.prior.bank import build_bank
from tso_cli.train.prior.shapes import read_shapes
from tso_lab.studies import priors
from tso_lab.studies.priors import SHIPPED, STUDY, WHOLE, conclude, draw_chart, tables


def cases():
    """Two trainings, and what the shipped prior says of one trouble."""
    rows = []
    for name, steps, left in ((SHIPPED, 70_000, 0.6), (WHOLE, 2000, 0.8), ("500 steps", 500, 0.9)):
        about = {"training": name, "steps": steps, "minutes": steps / 300}
        for start in ("another shape", "near"):
            for condition in (priors.CLEAN, priors.WITH_DEPTH):
                row = {"set": "validation", "start": start, "condition": condition}
                rows.append({**about, **row, "starts": 9, "left": left, "worse": 0.1})
        figures = {"frequency": 0.1, "AUC": 0.9, "error": 0.02}
        rows.append({**about, "set": "validation", "start": "", "troubles": {"plane": figures}})
    return rows


def test_the_record_shows_every_training_and_what_the_shipped_prior_doubts(tmp_path):
    record = conclude(cases())
    left, worse, doubts = tables(record)
    assert [row[0] for row in left.rows] == [SHIPPED, WHOLE, "500 steps"]
    assert left.rows[1][1:4] == [2000, 6.7, 0.8]
    assert worse.rows[0][-1] == 0.1
    assert doubts.rows == [["plane", 0.1, 0.9, 0.02]]
    draw_chart(tmp_path / "chart.png", record)
    assert (tmp_path / "chart.png").stat().st_size > 10_000


def test_a_probability_that_is_the_frequency_has_no_error():
    said = np.repeat([0.1, 0.9], 100)
    right = np.concatenate([np.arange(100) < 10, np.arange(100) < 90])
    assert priors._error(said, right) == pytest.approx(0.0)
    assert priors._error(said, ~right) == pytest.approx(0.8)


def test_a_prior_that_moves_nothing_leaves_the_whole_error_under_each_condition(monkeypatch):
    pytest.importorskip("open3d")
    monkeypatch.setattr(priors, "JUDGED_BATCHES", 2)
    bank = build_bank(read_shapes(examples_folder() / "meshes"), 12, 0)
    weights = {name: torch.tensor(array) for name, array in initial(0).items()}
    of = priors.outcomes(weights, bank)
    assert not (of[priors.OTHER] & of[priors.NEAR]).any()
    for condition, column in priors.CONDITIONS.items():
        left = of["left"][of[condition] & of[priors.OTHER], column]
        np.testing.assert_allclose(left, 1.0, atol=1e-5)
    assert sum(of[condition].sum() for condition in priors.CONDITIONS) > 64
    doubts = priors.doubts(of)
    assert list(doubts) == [*TROUBLES, "a foreign cell"]
    # It says one half of everything.
    assert doubts["plane"]["error"] == pytest.approx(0.5 - doubts["plane"]["frequency"], abs=1e-4)


def test_the_study_asks_for_kinds_in_no_list():
    (unseen,) = [option for option in STUDY.options if option.flag == "--unseen"]
    assert unseen.required
