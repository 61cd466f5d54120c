"""The study of evidence: what is done to its cases is what the rows say."""

from __future__ import annotations

import numpy as np
import pytest

from tso_cli.optimisation.symmetry import find_mirror_plane
from tso_cli.refinement import RefineConfig
from tso_lab.studies.cases import CaseBuilder, Variant
from tso_lab.studies.evidence import (
    MAPS,
    PLANES,
    Question,
    Truth,
    conclude,
    no_plane,
    refine_rows,
    tables,
    unaltered,
    with_depth,
    with_fov,
    with_map,
    without,
)
from tso_lab.studies.shapes import shapes_of_part

from .studying import MESHES, VALIDATION, rng


@pytest.fixture(scope="module")
def truths(split):
    shapes = {shape.name: shape for shape in shapes_of_part(MESHES, split, "validation")}
    return {"car": Truth(shapes[VALIDATION[0]]), "chair": Truth(shapes[VALIDATION[2]])}


@pytest.fixture(scope="module")
def cases(split, truths):
    builder = CaseBuilder(MESHES, split, views=1, size=64, points=1024)
    return {name: builder.cases(truth.shape, "other")[0] for name, truth in truths.items()}


def lifted(view) -> np.ndarray:
    """The points of a depth map, [M, 3] in the world."""
    rows, columns = np.nonzero(np.isfinite(view.depth) & (view.mask > 0.5))
    at = np.stack([columns, rows, np.ones_like(rows)], 1) @ np.linalg.inv(view.camera.K).T
    return (at * view.depth[rows, columns][:, None] - view.camera.t) @ view.camera.R


def test_depth_maps_lie_on_the_true_surface_and_noise_is_as_large_as_the_row_says(cases, truths):
    from scipy.spatial import cKDTree

    surface = cKDTree(cases["chair"].dense)
    exact, noisy = (
        with_depth(cases["chair"], truths["chair"], rng(), noise) for noise in (0.0, 0.03)
    )
    assert np.median(surface.query(lifted(exact.views[1]))[0]) < 0.006
    off = noisy.views[1].depth - exact.views[1].depth
    assert np.nanstd(off) == pytest.approx(0.03, rel=0.1)
    assert cases["chair"].views[0].depth is None


@pytest.mark.slow
@pytest.mark.parametrize("part", ["side", "low"])
def test_an_object_that_lacks_a_part_lacks_it_in_truth_and_masks_and_keeps_its_start(
    part, cases, truths
):
    whole = cases["chair"]
    lacking = without(whole, truths["chair"], rng(), part)
    np.testing.assert_array_equal(lacking.initial, whole.initial)
    assert (
        sum((b.mask < a.mask).any() for a, b in zip(whole.views, lacking.views, strict=True)) >= 3
    )
    assert all((b.mask <= a.mask).all() for a, b in zip(whole.views, lacking.views, strict=True))
    assert find_mirror_plane(whole.target).symmetric
    assert not find_mirror_plane(lacking.target).symmetric
    axis = int(np.abs(find_mirror_plane(whole.initial).plane.normal).argmax())
    # A face that reaches across the limit goes or stays as a whole.
    left = 0.4 if part == "side" else 1.0
    assert (lacking.dense[:, axis] > 0.12).mean() < left * (whole.dense[:, axis] > 0.12).mean()


@pytest.mark.slow
def test_a_row_that_a_case_cannot_have_is_left_out_and_planes_are_counted(cases, truths):
    none, auto = (
        Variant(RefineConfig(steps=3, symmetry=symmetry)) for symmetry in ("none", "auto")
    )
    rows = {
        "cars": (lambda case, *_: case if case.category == "car" else None, none),
        "as it is": (unaltered, auto),
    }
    question = Question("Cars", ("other",), rows, ("car", "chair"), {PLANES: no_plane})
    records = [
        record
        for name in cases
        for record in refine_rows("cars", question, [(cases[name], truths[name])], 0)
    ]
    summary = conclude(records)["summary"]["cars"]["other"]
    assert summary["all"]["as it is"]["cases"] == 2
    assert summary["all"]["cars"]["cases"] == 1
    assert summary["all"]["cars"]["no mirror plane"] == 1.0
    assert summary["all"]["as it is"]["no mirror plane"] < 1.0


def a_case(category: str, rows: dict[str, tuple[float, float]]) -> dict:
    names = {
        "question": "depth",
        "kind": "other",
        "category": category,
        "shape": f"{category}/a",
        "view": 0,
    }
    return {
        **names,
        "rows": {
            row: {"before": before, "chamfer": after} for row, (before, after) in rows.items()
        },
    }


def test_the_summary_is_of_the_cases_own_ratios():
    cases = [
        a_case("car", {"mask": (1.0, 0.5)}),
        a_case("car", {"mask": (4.0, 4.4)}),
        a_case("chair", {"mask": (1.0, 1.0)}),
    ]
    summary = conclude(cases)
    figures = {"cases": 3, "worse": 1, "mean_ratio": 0.86667, "worst_ratio": 1.1}
    assert summary["summary"]["depth"]["other"] == {"all": {"mask": figures}}
    (table,) = tables(summary)
    assert table.title == "Depth maps"
    assert [row[:5] for row in table.rows] == [["other", "mask", 3, 0.86667, 1.1]]


@pytest.mark.parametrize("name", MAPS)
def test_a_wrong_map_holds_what_its_row_says(name, cases, truths):
    case, truth = cases["chair"], truths["chair"]
    holds, called, fov = MAPS[name]
    seen = case if fov is None else with_fov(case, truth, rng(), fov)
    view = with_map(seen, truth, rng(), holds).views[0]
    true = with_depth(seen, truth, rng()).views[0].depth
    known = view.inside & np.isfinite(view.depth) & np.isfinite(true)
    held, depth = view.depth[known], true[known]
    rays = view.camera.ray_lengths(*np.nonzero(known))
    # What is constant in a map of this kind.
    ratios = {"unit": held / depth, "ray": held / depth / rays}
    lines = {"inverse": 1.0 / depth, "affine": depth}
    if called in ratios:
        np.testing.assert_allclose(ratios[called], ratios[called][0], rtol=1e-4)
    elif called in lines:
        assert np.corrcoef(held, lines[called])[0, 1] == pytest.approx(1.0, abs=1e-6)
    else:
        assert np.median(np.abs(held - depth)) > 0.01
    if fov:
        across = np.ptp(np.argwhere(view.mask > 0.5), axis=0).max()
        assert across > 0.8 * view.camera.width
