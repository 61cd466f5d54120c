import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.distance import cdist

from tests.corruption import assert_refused
from tests.geometry.test_points import clouds
from tso_cli.evaluation import metrics
from tso_cli.evaluation.metrics import chamfer, emd, f_score, iou


@settings(max_examples=80, deadline=None)
@given(clouds(), clouds())
def test_chamfer_is_the_mean_of_the_smallest_of_all_squared_distances(prediction, target):
    table = cdist(prediction, target, "sqeuclidean")
    result = chamfer(prediction, target)
    assert result.forward == pytest.approx(table.min(0).mean(), rel=1e-12)
    assert result.backward == pytest.approx(table.min(1).mean(), rel=1e-12)
    assert result.chamfer == result.forward + result.backward


@settings(max_examples=40, deadline=None)
@given(clouds(), st.integers(0, 1000))
def test_a_cloud_is_at_distance_zero_of_itself_in_any_order(points, seed):
    shuffled = np.random.default_rng(seed).permutation(points)
    assert chamfer(points, shuffled).chamfer == 0.0
    assert emd(points, shuffled) == 0.0
    assert f_score(points, shuffled, 1e-9).f_score == 1.0


def test_chamfer_is_directed_and_exact_far_from_the_origin():
    target = np.array([[0.0, 0, 0], [2, 0, 0]])
    uncovered = chamfer(target[:1], target)
    assert uncovered.forward == 2.0
    assert uncovered.backward == 0.0
    far = np.array([4e6, -4e6, 4e6])
    a, b = np.eye(3) / 1024 + far, np.zeros((1, 3)) + far
    assert chamfer(a, b).chamfer == 2.0 / 1024**2


@settings(max_examples=60, deadline=None)
@given(clouds(), clouds(), st.floats(1e-3, 3.0))
def test_f_score_counts_points_with_a_near_counterpart(prediction, target, threshold):
    table = np.sqrt(cdist(prediction, target, "sqeuclidean"))
    result = f_score(prediction, target, threshold)
    precision, recall = (table.min(1) < threshold).mean(), (table.min(0) < threshold).mean()
    assert result.precision == precision
    assert result.recall == recall
    expected = (
        0.0
        if precision + recall == 0
        else 2 / (1 / precision + 1 / recall)
        if precision * recall
        else 0.0
    )
    assert result.f_score == pytest.approx(expected)


def test_f_score_leaves_the_bound_itself_out():
    at_bound = f_score([[0.0, 0, 0]], [[0.5, 0, 0]], 0.5)
    assert at_bound.precision == 0.0
    assert at_bound.recall == 0.0
    assert at_bound.f_score == 0.0
    assert f_score([[0.0, 0, 0]], [[0.5, 0, 0]], 0.500001).f_score == 1.0


def test_the_default_threshold_is_a_hundredth_of_the_targets_longest_side_which_has_to_have_one():
    target = np.array([[0.0, 0, 0], [4, 1, 2]])
    assert f_score(10 * target, target).threshold == pytest.approx(0.04)
    assert_refused("target: holds a single point", f_score, [[0.0, 0, 0]], [[0.0, 0, 0]])


@settings(max_examples=40, deadline=None)
@given(st.integers(1, 6), st.integers(0, 2**32 - 1), st.booleans(), st.booleans())
def test_emd_is_the_best_of_all_permutations(count, seed, squared, coarse):
    rng = np.random.default_rng(seed)
    a, b = rng.normal(size=(2, count, 3))
    if coarse:
        a, b = a.round(), b.round()
    cost = cdist(a, b, "sqeuclidean")
    if not squared:
        cost = np.sqrt(cost)
    best = min(cost[range(count), list(p)].mean() for p in itertools.permutations(range(count)))
    assert emd(a, b, squared) == pytest.approx(best, abs=1e-12)


def test_emd_measures_a_translation():
    points = np.random.default_rng(5).normal(size=(60, 3))
    for squared, length in ((False, 0.5), (True, 0.25)):
        assert emd(points, points + [0.0, 0.3, 0.4], squared) == pytest.approx(length)


def test_emd_refuses_clouds_of_different_or_excessive_size_with_advice(monkeypatch):
    assert_refused(
        r"found 3 \(prediction\) and 2 \(target\).*`points` 2", emd, np.eye(3), np.eye(3)[:2]
    )
    monkeypatch.setattr(metrics, "EMD_LIMIT", 2)
    assert_refused(r"EMD of 3 points .*at most 2.*`points`", emd, np.eye(3), np.eye(3))


@pytest.mark.parametrize("metric", [chamfer, f_score, emd])
def test_an_empty_or_infinite_cloud_is_refused_by_its_role(metric):
    assert_refused("prediction: holds no points", metric, np.zeros((0, 3)), np.eye(3))
    assert_refused("target: point 2 has a NaN", metric, np.eye(3), np.diag([1, 1, np.nan]))


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.sampled_from([None, 0.0, 0.7]), st.sampled_from([0.5, 1.0]))
def test_iou_counts_pixels_over_a_half_is_1_for_nothing_and_undefined_without_known_pixels(
    seed, part, largest
):
    rng = np.random.default_rng(seed)
    silhouette, mask = np.minimum(rng.choice([0.0, 0.3, 0.5, 0.51, 1.0], (2, 4, 6)), largest)
    known = None if part is None else rng.random((4, 6)) < part
    counted = np.ones((4, 6), bool) if known is None else known
    ours, theirs = (
        set(map(tuple, np.argwhere(counted & (picture > 0.5)))) for picture in (silhouette, mask)
    )
    result, either = iou(silhouette, mask, known), ours | theirs
    if not counted.any():
        assert math.isnan(result)
    else:
        assert result == (len(ours & theirs) / len(either) if either else 1.0)
