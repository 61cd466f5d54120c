import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.corruption import assert_refused
from tso_cli.geometry.points import (
    as_points,
    bounding_box_normalisation,
    farthest_point_sample,
    normalise_longest_side,
    quantile,
    sample_surface,
    scattered,
    spread_subset,
)


def clouds(smallest=1, largest=30):
    """Small clouds: spread, clustered, on a coarse grid (many ties) or with duplicated points."""

    def build(seed, count, kind):
        rng = np.random.default_rng(seed)
        if kind == "grid":
            return rng.integers(-2, 3, (count, 3)).astype(float)
        if kind == "duplicates":
            return rng.normal(size=(max(count // 3, 1), 3))[
                rng.integers(0, max(count // 3, 1), count)
            ]
        if kind == "clusters":
            return rng.normal(size=(3, 3))[rng.integers(0, 3, count)] + 1e-6 * rng.normal(
                size=(count, 3)
            )
        if kind == "far":
            return 4e6 + rng.normal(size=(count, 3))
        return rng.normal(size=(count, 3))

    kinds = st.sampled_from(["spread", "grid", "duplicates", "clusters", "far"])
    return st.builds(build, st.integers(0, 2**32 - 1), st.integers(smallest, largest), kinds)


def naive_farthest(points, count):
    """From the first point on, each time the first of those farthest from the chosen ones."""
    pairs, chosen = np.square(points[:, None] - points).sum(2), [0]
    while len(chosen) < count:
        distance = pairs[:, chosen].min(1)
        distance[chosen] = -1.0
        chosen.append(int(distance.argmax()))
    return chosen


@settings(max_examples=30, deadline=None)
@given(clouds(), st.data())
def test_farthest_points_are_those_of_a_plain_loop(points, data):
    count = data.draw(st.integers(1, len(points)))
    assert farthest_point_sample(points, count).tolist() == naive_farthest(points, count)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((0, 3)), "no points"),
        (np.zeros((3, 2)), r"\[3, 2\]"),
        ([[0, 0, 0], [0, np.nan, 0]], "point 1 has a NaN"),
        ([[np.inf, 0, 0]], "point 0 has a NaN or infinite"),
    ],
)
def test_what_is_not_a_cloud_is_refused_by_name(points, message):
    assert_refused(f"chair.ply: .*{message}", as_points, points, "chair.ply")


@settings(max_examples=40, deadline=None)
@given(clouds(smallest=2), st.floats(1e-6, 1e6), st.integers(0, 1000))
def test_normalising_undoes_scale_and_place(points, scale, seed):
    if np.ptp(points, axis=0).max() < 1e-9:
        return
    points = points - points.mean(0)
    place = np.random.default_rng(seed).normal(size=3)
    ours = normalise_longest_side(points)
    tolerance = 1e-9 / np.ptp(points, axis=0).max()
    np.testing.assert_allclose(
        normalise_longest_side(points * scale + place * scale), ours, atol=tolerance
    )
    assert np.ptp(ours, axis=0).max() == pytest.approx(1.0, abs=1e-9)
    np.testing.assert_allclose(ours.min(0) + ours.max(0), 0.0, atol=1e-9)


def test_centre_and_scale_are_those_of_the_bounding_box_not_of_the_points():
    centre, scale = bounding_box_normalisation([[0, 0, 0], [0, 0, 0], [0, 0, 0], [4, 2, 1]])
    assert (centre.tolist(), scale) == ([2.0, 1.0, 0.5], 4.0)


@pytest.mark.parametrize(
    "points", [[[1.0, 2.0, 3.0]], [[1.0, 2.0, 3.0]] * 5, [[-1.7e308, 0, 0], [1.7e308, 0, 0]]]
)
def test_a_cloud_without_a_measurable_extent_cannot_be_normalised(points):
    assert_refused(r"a\.ply: ", bounding_box_normalisation, points, "a.ply")


TWO_SQUARES = np.array(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [0, 0, 5], [3, 0, 5], [3, 3, 5], [0, 3, 5]],
    dtype=float,
)
SQUARE_FACES = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7], [0, 0, 1]])


def test_surface_samples_share_out_by_area():
    points = sample_surface(TWO_SQUARES, SQUARE_FACES, 20000, np.random.default_rng(0))
    upper = points[:, 2] == 5
    assert set(np.unique(points[:, 2])) == {0.0, 5.0}
    assert upper.mean() == pytest.approx(0.9, abs=0.01)
    # Uniform within a square too: mean and variance of a uniform coordinate.
    np.testing.assert_allclose(points[upper, :2].mean(0), 1.5, atol=0.03)
    np.testing.assert_allclose(points[upper, :2].var(0), 9 / 12, atol=0.03)
    assert 0 <= points[upper, :2].min() <= points[upper, :2].max() <= 3


@pytest.mark.parametrize("scale", [1e-170, 1e150])
def test_surface_samples_do_not_depend_on_the_unit(scale):
    ours = sample_surface(TWO_SQUARES * scale, SQUARE_FACES, 50, np.random.default_rng(3))
    np.testing.assert_allclose(
        ours / scale,
        sample_surface(TWO_SQUARES, SQUARE_FACES, 50, np.random.default_rng(3)),
        atol=1e-9,
    )


def test_the_last_face_is_not_drawn_from_if_it_has_no_area():
    class Highest:
        def random(self, shape):
            return np.full(shape, 1.0)  # where rounding of the product below can lead

    faces = np.array([[0, 1, 2], [4, 4, 4]])
    points = sample_surface(TWO_SQUARES, faces, 5, Highest())
    assert (points[:, 2] == 0).all()


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: farthest_point_sample(np.zeros((5, 3)), 0),
            "asked for 0 of 5 points, expected 1 to 5",
        ),
        (
            lambda: farthest_point_sample(np.zeros((5, 3)), 6),
            "asked for 6 of 5 points, expected 1 to 5",
        ),
        (
            lambda: sample_surface(TWO_SQUARES, np.zeros((0, 3), int), 5, np.random.default_rng(0)),
            "at least one triangle",
        ),
        (
            lambda: sample_surface(TWO_SQUARES, [[0, 1, 8]], 5, np.random.default_rng(0)),
            "expected 0 to 7",
        ),
        (lambda: sample_surface(TWO_SQUARES, [[0, 0, 1]], 5, np.random.default_rng(0)), "no area"),
    ],
)
def test_samples_that_cannot_be_are_refused(call, message):
    assert_refused(message, call)


@given(
    st.lists(st.tuples(*[st.floats(-1e3, 1e3)] * 2), min_size=1, max_size=20), st.floats(0.0, 1.0)
)
def test_a_quantile_is_that_of_numpy(rows, share):
    values = np.array(rows)
    np.testing.assert_allclose(
        quantile(values, share), np.quantile(values, share, axis=0), rtol=1e-12, atol=1e-9
    )


@pytest.mark.parametrize("columns", [640, 1024])
def test_a_subset_of_an_organised_cloud_reaches_every_part_of_it(columns):
    row, column = np.mgrid[:2048, :columns]
    cloud = np.stack([column, row, 0 * row], -1).reshape(-1, 3) / 64.0
    subset = cloud[spread_subset(cloud, 1024)]
    assert len(np.unique(subset // 1.0, axis=0)) > 0.95 * 32 * columns // 64


@given(st.integers(1, 300), st.integers(1, 300))
def test_a_part_of_many_points_keeps_their_order_and_repeats_none(count, most):
    part = scattered(np.arange(count), most)
    assert len(part) <= most
    assert (np.diff(part) > 0).all()
    assert len(part) == count if count <= most else len(part) >= min(most, count) * 0.6
