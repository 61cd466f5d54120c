"""Lens distortion: where a lens shows points, and pictures without it."""

import math

import numpy as np
import pytest

from tso_cli.geometry.distortion import Distortion, undistorted

K = np.array([[120.0, 0.0, 79.5], [0.0, 125.0, 59.5], [0.0, 0.0, 1.0]])
LENSES = [
    Distortion("radial-tangential", (-0.2, 0.05, 0.004, -0.003, 0.01)),
    Distortion("radial-tangential", (0.1, -0.02, 0.0, 0.0, 0.0, 0.05, 0.01, 0.002)),
    Distortion("equidistant", (-0.05, 0.01, -0.002, 0.0005)),
]


def by_the_book(lens, x, y):
    """One point, by the formulas of OpenCV's manual."""
    r = math.hypot(x, y)
    if lens.model == "equidistant":
        k1, k2, k3, k4 = lens.coefficients
        theta = math.atan(r)
        theta_d = theta * (1 + k1 * theta**2 + k2 * theta**4 + k3 * theta**6 + k4 * theta**8)
        return theta_d / r * x, theta_d / r * y
    k1, k2, p1, p2, k3, k4, k5, k6 = (*lens.coefficients, 0, 0, 0)[:8]
    radial = (1 + k1 * r**2 + k2 * r**4 + k3 * r**6) / (1 + k4 * r**2 + k5 * r**4 + k6 * r**6)
    return (
        x * radial + 2 * p1 * x * y + p2 * (r**2 + 2 * x**2),
        y * radial + p1 * (r**2 + 2 * y**2) + 2 * p2 * x * y,
    )


@pytest.mark.parametrize("lens", LENSES)
def test_a_point_is_displaced_by_the_formula_of_its_lens(lens):
    x, y = np.array([0.3, -0.2, 0.01]), np.array([0.1, 0.25, -0.4])
    found = np.stack(lens.distorted(x, y), 1)
    expected = [by_the_book(lens, *point) for point in zip(x, y, strict=True)]
    np.testing.assert_allclose(found, expected, atol=1e-14)


@pytest.mark.parametrize("lens", LENSES)
def test_a_spot_moves_to_where_a_camera_without_distortion_sees_it(lens):
    rows, columns = np.mgrid[:120, :160].astype(float)
    for x, y in ((0.3, 0.2), (-0.35, 0.1), (0.05, -0.25)):
        u, v = by_the_book(lens, x, y)
        u, v = K[0, 0] * u + K[0, 2], K[1, 1] * v + K[1, 2]
        spot = np.exp(-((columns - u) ** 2 + (rows - v) ** 2) / 8.0)
        picture, _ = undistorted(spot, K, lens)
        weight = picture / picture.sum()
        found = (weight * columns).sum(), (weight * rows).sum()
        expected = K[0, 0] * x + K[0, 2], K[1, 1] * y + K[1, 2]
        assert np.hypot(*np.subtract(found, expected)) < 0.3


def test_what_the_lens_did_not_show_is_unknown():
    picture = np.ones((120, 160))
    wide, seen = undistorted(picture, K, Distortion("radial-tangential", (0.5,)))
    assert not seen[0, 0]
    assert seen[60, 80]
    assert wide[0, 0] == 1.0  # filled with a value of the picture, and not counted
    _, seen = undistorted(picture, K, Distortion("radial-tangential", (-0.2,)))
    assert seen.all()


def test_a_picture_with_channels_and_labels_keeps_its_type():
    labels = np.arange(120 * 160, dtype=np.int64).reshape(120, 160)
    same, seen = undistorted(labels, K, Distortion("radial-tangential", ()), nearest=True)
    assert seen.all()
    assert (same == labels).all()
    assert same.dtype == labels.dtype
    photo = np.zeros((120, 160, 3))
    assert undistorted(photo, K, LENSES[0])[0].shape == photo.shape


def test_a_lens_shows_nothing_a_second_time_where_its_polynomial_turns_back():
    K = np.array([[600.0, 0.0, 959.5], [0.0, 600.0, 539.5], [0.0, 0.0, 1.0]])
    lens = Distortion("radial-tangential", (-0.3,))
    picture = np.zeros((1080, 1920))
    picture[440:640, 860:1060] = 1.0
    straight, seen = undistorted(picture, K, lens)
    assert not (straight[~seen] > 0.5).all()
    rows, columns = np.nonzero((straight > 0.5) & seen)
    assert rows.min() > 400
    assert columns.max() < 1100
    assert lens.reach() == pytest.approx(np.sqrt(1.0 / 0.9), abs=3e-3)
    assert Distortion("radial-tangential", (0.3,)).reach() == np.inf
