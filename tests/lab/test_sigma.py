"""The study of sigma^2: the true cloud's silhouette against the mask."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tso_cli.cli import main
from tso_cli.errors import InputError
from tso_cli.lab.studies.parts import see, shapes_of_part
from tso_cli.lab.studies.sigma import SIGMAS, mask_errors, study_sigma
from tso_cli.render import RenderSettings
from tso_cli.silhouette.projection import silhouette_of

MESHES = Path(__file__).parents[2] / "examples" / "meshes"
NAMES = ["car/qreal_Cop", "car/qreal_SUV", "airplane/qplane_MilitaryAirplane2", "airplane/qplane_SmallPlane", "chair/q17_Chair"]


@pytest.fixture
def split(tmp_path):
    path = tmp_path / "split.json"
    path.write_text(json.dumps({"test": NAMES}))
    return path


def test_the_sweep_spans_the_papers_values():
    assert (SIGMAS[0], SIGMAS[-1]) == (0.05, 3.2)
    assert {0.1, 0.2, 0.4, 0.8, 1.6} <= set(SIGMAS)


def test_the_error_is_the_mean_difference_of_silhouette_and_mask(split):
    seen = see(shapes_of_part(MESHES, split, limit=1)[0], RenderSettings(views=2), 0)
    found = mask_errors(seen, [0.4])
    expected = np.mean([np.abs(silhouette_of(seen.target, v.camera, 0.4) - v.mask / 255.0).mean() for v in seen.views])
    assert found["l1"][0] == pytest.approx(expected)
    assert found["l1"][0] == pytest.approx(found["missing"][0] + found["stray"][0])


def test_a_wider_gaussian_leaves_fewer_holes_and_strays_farther(split):
    seen = see(shapes_of_part(MESHES, split, limit=1)[0], RenderSettings(views=1), 0)
    found = mask_errors(seen, SIGMAS)
    assert (np.diff(found["missing"]) < 0.0).all()
    assert (np.diff(found["stray"]) > 0.0).all()


def test_aeroplanes_want_a_narrower_gaussian_than_cars_and_the_paper_is_near_the_best(split):
    record, maps = study_sigma(MESHES, split, views=2)
    summary = record["summary"]
    assert summary["airplane"]["best"] < summary["car"]["best"]
    for name in ("airplane", "car"):
        own = summary[name]
        assert own["l1_at_best"] == min(own["l1"]) == own["l1"][SIGMAS.index(own["best"])]
        assert own["l1_at_paper"] == own["l1"][SIGMAS.index(own["paper"])]
        assert 0.5 <= own["best"] / own["paper"] <= 2.0
    assert summary["all"]["shapes"] == 5
    assert [own.shape for own in maps] == [NAMES[2], NAMES[0], NAMES[4]]
    # holes at the smallest, the outline swollen at the largest
    for own in maps:
        sums = {name: silhouette.sum() for name, silhouette in own.silhouettes.items()}
        assert sums["sigma^2 0.05"] < own.mask.sum() < sums["sigma^2 3.2"]
        rounded, depth = own.silhouettes["discretised"], own.silhouettes["Lin et al., U = 5"]
        assert set(np.unique(rounded)) == {0.0, 1.0}
        assert (rounded[own.mask == 1.0] == 0.0).any(), "holes"
        np.testing.assert_array_equal(depth > 0.0, rounded > 0.0)
        assert depth.max() == 1.0 and depth[depth > 0.0].min() == pytest.approx(0.4)
    assert [claim["holds"] for claim in record["claims"]][:3] == [True, True, True]


def test_the_best_is_told_for_a_category_that_the_paper_lacks(tmp_path):
    folder = tmp_path / "meshes" / "tricycle"
    folder.mkdir(parents=True)
    (folder / "one.ply").write_bytes((MESHES / "car" / "qreal_Cop.ply").read_bytes())
    split = tmp_path / "split.json"
    split.write_text(json.dumps({"test": ["tricycle/one"]}))
    record, _ = study_sigma(tmp_path / "meshes", split, views=1, sigmas=(0.2, 0.8))
    own = record["summary"]["tricycle"]
    assert own["best"] in (0.2, 0.8)
    assert own["paper"] is own["l1_at_paper"] is None


def test_a_sigma_that_no_mask_resolves_is_refused(split):
    for sigmas in ((), (0.001, 0.4), (0.4, 1e4), (float("nan"),)):
        with pytest.raises(InputError, match="sigma"):
            study_sigma(MESHES, split, sigmas=sigmas)


def test_the_command_states_the_best_beside_the_papers_and_shows_the_maps(split, tmp_path, capsys):
    output = tmp_path / "sigma.json"
    arguments = ["lab", "sigma", "--meshes", str(MESHES), "--split", str(split), "--views", "1", "--limit", "1"]
    with pytest.raises(SystemExit) as stopped:
        main([*arguments, "-o", str(output)])
    assert stopped.value.code == 0
    out = capsys.readouterr().out
    assert "best sigma^2" in out
    assert "the paper's" in out
    record = json.loads(output.read_text())
    assert record["settings"]["sigma_sq"] == list(SIGMAS)
    with Image.open(output.with_suffix(".png")) as chart:
        assert chart.size[1] > 800  # curves above, a row of maps for each category below
    with pytest.raises(SystemExit) as stopped:
        main([*arguments, "--json"])
    assert json.loads(capsys.readouterr().out)["study"] == "sigma"
