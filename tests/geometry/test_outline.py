"""Where the outline of a mask is: masks whose outline moves, and how exactly a mask shows it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from tests.corruption import assert_one_line
from tests.scenes import block, example
from tso_cli import Camera, InputError, View
from tso_cli.geometry.outline import LEAST_SHARE, MOST_SHARE, shrunk
from tso_cli.geometry.view import OUTLINE_ERROR

CAMERA = Camera.canonical(64, 64)
RADIUS = 20.0


def _disc(radius: float = RADIUS, sharp: bool = True) -> np.ndarray:
    """[64, 64] a disc off the middle, each pixel 0 or 1, or the share of it that is covered."""
    times = 1 if sharp else 8
    rows, columns = (np.indices((64 * times, 64 * times)) + 0.5) / times
    inside = np.float32(np.hypot(rows - 31.7, columns - 32.4) < radius)
    return inside.reshape(64, times, 64, times).mean((1, 3))


def _view(mask: np.ndarray, **pictures) -> View:
    return View(mask, CAMERA, **pictures)


DISC = _view(_disc())


# Of a changed outline


@pytest.mark.parametrize("pixels", [0.3, 0.5, 1.0, 1.7, 3.0, -0.3, -0.5, -1.0, -1.7, -3.0])
@pytest.mark.parametrize("sharp", [True, False], ids=["sharp", "soft"])
def test_a_disc_that_is_shrunk_has_the_area_of_the_smaller_disc(pixels, sharp):
    area = shrunk(_view(_disc(sharp=sharp)), pixels).mask.sum()
    assert area == pytest.approx(np.pi * (RADIUS - pixels) ** 2, rel=0.03)


@pytest.mark.parametrize("pixels", [0.4, 1.0, 2.5, -0.4, -1.0, -2.5])
def test_what_is_shrunk_and_grown_again_is_about_the_mask(pixels):
    once = shrunk(DISC, pixels)
    changed, left = (
        float(np.abs(mask - DISC.mask).sum()) / (2.0 * np.pi * RADIUS)
        for mask in (once.mask, shrunk(once, -pixels).mask)
    )
    assert changed == pytest.approx(abs(pixels), rel=0.15)
    # Pixels of 0 or 1 show steps of half a pixel, which become soft.
    assert left < 0.4


@pytest.mark.parametrize("pixels", [2.0, -2.0])
def test_a_change_goes_on_at_the_border_of_the_picture(pixels):
    """A bar that a picture cuts off at the left does not end there."""
    bar = shrunk(_view(block(np.s_[20:40, :50])), pixels)
    heights, widths = (bar.mask[:, :45].sum(0), bar.mask[24:36].sum(1))
    np.testing.assert_allclose(heights, 20.0 - 2.0 * pixels, atol=0.3)
    np.testing.assert_allclose(widths, 50.0 - pixels, atol=0.2)


@pytest.mark.parametrize("pixels", [0.5, 1.0, 5.0, 50.0])
def test_a_line_of_one_pixel_does_not_vanish(pixels):
    line = shrunk(_view(block(np.s_[30:31, 10:50])), pixels)
    assert (line.mask > 0.5).any()


@pytest.mark.parametrize("pixels", [15.0, 20.0, 50.0])
def test_of_a_mask_that_is_shrunk_by_about_all_of_it_the_middle_stays(pixels):
    left = RADIUS * (1.0 - MOST_SHARE)
    assert shrunk(DISC, pixels).mask.sum() == pytest.approx(np.pi * left**2, rel=0.1)


@pytest.mark.parametrize("pixels", [1.0, -1.0])
def test_all_else_of_a_view_stays(pixels):
    rng = np.random.default_rng(0)
    given = _view(
        DISC.mask,
        name="a.png",
        known=rng.random((64, 64)) > 0.1,
        depth=rng.uniform(1.0, 2.0, (64, 64)),
        depth_kind="affine",
        image=rng.random((64, 64, 3)),
        mask_error=2.0,
    )
    changed = shrunk(given, pixels)
    assert (changed.mask != given.mask).any()
    for name in ("camera", "name", "depth_kind", "mask_error"):
        assert getattr(changed, name) == getattr(given, name)
    for name in ("known", "depth", "image"):
        np.testing.assert_array_equal(getattr(changed, name), getattr(given, name))


def test_what_nothing_could_resolve_changes_nothing():
    for pixels in (0.0, 0.09, -0.09):
        assert shrunk(DISC, pixels) is DISC
    large = example("chair").view
    left, top, right, bottom = large.pixels_of_object
    least = LEAST_SHARE * max(right - left, bottom - top)
    assert shrunk(large, 0.95 * least) is large
    assert shrunk(large, 1.05 * least) is not large


def test_a_mask_that_would_fill_all_that_is_known_stays():
    known = np.zeros((64, 64), bool)
    known[28:36, 30:54] = True
    view = _view(DISC.mask, known=known)
    assert shrunk(view, -8.0) is view


def test_pixels_far_from_the_object_stay_as_they_are():
    mask = DISC.mask.copy()
    mask[:3, :3] = 0.3
    np.testing.assert_array_equal(shrunk(_view(mask), 1.0).mask[:3, :3], mask[:3, :3])


# Of the outline error


def test_the_outline_error_of_a_sharp_mask_is_that_of_its_pixels():
    assert DISC.outline_error == OUTLINE_ERROR == 0.5
    assert example("chair").view.outline_error == 0.5
    assert _view(_disc(sharp=False)).outline_error == pytest.approx(0.5, abs=0.1)


@pytest.mark.parametrize("sigma", [1.0, 2.0, 3.0])
@pytest.mark.parametrize("sharp", [True, False], ids=["sharp", "soft"])
def test_the_outline_error_of_a_blurred_mask_is_the_blur(sigma, sharp):
    blurred = gaussian_filter(_disc(sharp=sharp), sigma)
    assert _view(blurred).outline_error == pytest.approx(sigma, rel=0.2)


@pytest.mark.parametrize("times", [2, 4, 8])
def test_the_squares_of_an_enlarged_mask_are_its_pixels(times):
    mask = _disc()[::2, ::2]
    small, enlarged = (
        View(some, Camera.canonical(*some.shape)).outline_error
        for some in (mask, np.kron(mask, np.ones((times, times))))
    )
    assert enlarged == pytest.approx(times * small)


@pytest.mark.parametrize("error", [5.0, 1e9])
def test_an_error_that_is_large_for_the_object_is_refused(error):
    mask = np.zeros((64, 64))
    mask[20:38, 20:30] = 1.0
    with pytest.raises(InputError, match="the object is 18 px long, expected at most 4.5 px"):
        _view(mask, mask_error=error)


def test_an_error_that_is_known_is_the_outline_error():
    for mask in (_disc(), gaussian_filter(_disc(), 2.0)):
        assert _view(mask, mask_error=0.2).outline_error == 0.2
        assert _view(mask, mask_error=4).outline_error == 4


@pytest.mark.parametrize("error", [0.0, -1.0, np.nan, np.inf])
def test_an_error_that_is_no_length_is_refused(error):
    with pytest.raises(InputError, match="mask.png: the error of the mask is") as caught:
        replace(example("chair").view, mask_error=error)
    assert_one_line(str(caught.value))
    assert "expected pixels over 0" in str(caught.value)
