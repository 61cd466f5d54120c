"""The photo of a view tells apart placements that fit its mask alike."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tests.scenes import EXAMPLES, about, block, example
from tso_cli import Camera, View
from tso_cli.geometry.points import normalise_longest_side
from tso_cli.io.images import read_image
from tso_cli.pose import appearance as module
from tso_cli.pose.appearance import appearance, decides
from tso_cli.pose.fit import fit_camera
from tso_cli.pose.placement import Placements

# Where a search leaves the right placement, and the same turned the other way round.
NEARLY = about("y", 2.0) @ about("x", -2.0)
RIGHT, TURNED = Placements.unmoved(), Placements.unmoved()
RIGHT = replace(RIGHT, R=NEARLY[None])
TURNED = replace(TURNED, R=(about("y", 180.0) @ NEARLY)[None])
BOTH = Placements.joined([RIGHT, TURNED])


def two_tone(points: np.ndarray) -> np.ndarray:
    """Red in front (+z, half a car), blue behind."""
    return np.where(points[:, 2:] > 0.1, [[0.7, 0.25, 0.2]], [[0.2, 0.3, 0.6]])


def waves(points: np.ndarray) -> np.ndarray:
    """Smooth paint that is the same on the left and on the right."""
    x, y, z = np.abs(points[:, 0]), points[:, 1], points[:, 2]
    waves = [np.sin(9.0 * z + 4.0 * y), np.sin(8.0 * x - 5.0 * z), np.cos(7.0 * z - 6.0 * y)]
    return 0.5 + 0.3 * np.stack(waves, 1)


def lamps(points: np.ndarray) -> np.ndarray:
    """A car of one colour with pale lamps in front, and red ones behind."""
    low = np.abs(points[:, 1:2]) < 0.08
    front, back = low & (points[:, 2:] > 0.36), low & (points[:, 2:] < -0.36)
    return np.select([front, back], [[0.9, 0.9, 0.8], [0.8, 0.05, 0.05]], [0.35, 0.4, 0.45])


@cache
def nearest_point(name: str) -> np.ndarray:
    """[H, W] the point of the example that each pixel shows; nearer points hide others."""
    shown = example(name)
    px, depth = shown.camera.project(normalise_longest_side(shown.target))
    rows, columns = np.indices(shown.mask.shape)
    index, front = np.zeros(shown.mask.shape, np.int64), np.full(shown.mask.shape, np.inf)
    for number, ((column, row), z) in enumerate(zip(px, depth, strict=True)):
        part = np.s_[max(int(row) - 8, 0) : int(row) + 9, max(int(column) - 8, 0) : int(column) + 9]
        # A cone from the point: of points alike in depth the nearest in the picture counts.
        cone = z + 0.01 * np.hypot(rows[part] - row, columns[part] - column)
        index[part] = np.where(cone < front[part], number, index[part])
        front[part] = np.minimum(cone, front[part])
    return index


def painted(name: str, paint) -> tuple[np.ndarray, np.ndarray, View]:
    """Points and colours of an example, and its view with a photo of the paint.

    The light in the photo is that of the example's picture, which was ray cast.
    """
    shown = example(name)
    points = normalise_longest_side(shown.target)
    light = read_image(EXAMPLES / name / "image.png")[..., :3].mean(-1, keepdims=True) / 200.0
    colours = paint(points)
    image = np.where(shown.mask[..., None] > 0.5, light * colours[nearest_point(name)], 1.0)
    return points, colours, replace(shown.view, image=np.clip(image, 0.0, 1.0))


def photographed(view: View, change) -> View:
    return replace(view, image=np.clip(change(view.image), 0.0, 1.0))


@pytest.mark.parametrize("paint", [two_tone, lamps, waves])
def test_a_cars_photo_tells_its_front_from_its_back(paint):
    points, colours, view = painted("car", paint)
    right, turned = appearance(points, colours, BOTH, view)
    assert decides(right, turned)
    assert not decides(turned, right)


@pytest.mark.parametrize("name", ["airplane", "chair"])
@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_photo_tells_the_right_placement_from_a_half_turn(name, axis):
    points, colours, view = painted(name, waves)
    turned = replace(RIGHT, R=(about(axis, 180.0) @ NEARLY)[None])
    assert decides(*appearance(points, colours, Placements.joined([RIGHT, turned]), view))


def from_the_right(image: np.ndarray) -> np.ndarray:
    """Light that falls to a third across the picture."""
    return image * np.linspace(0.33, 1.0, image.shape[1])[:, None]


def with_highlights(image: np.ndarray) -> np.ndarray:
    """White spots on about 5 % of the picture."""
    spots = np.random.default_rng(0).uniform(size=(32, 32)) < 0.05
    return np.where(np.kron(spots, np.ones((8, 8)))[..., None] > 0.0, 1.0, image)


@pytest.mark.parametrize(
    "change",
    [
        lambda image: 0.5 * image,
        lambda image: image * [1.0, 0.8, 0.55],
        lambda image: image**0.7,
        from_the_right,
        with_highlights,
    ],
    ids=["darker", "warmer", "of another gamma", "lit from the right", "with highlights"],
)
def test_a_photo_under_other_light_decides_alike(change):
    points, colours, view = painted("car", two_tone)
    usual = appearance(points, colours, BOTH, view)
    other = appearance(points, colours, BOTH, photographed(view, change))
    assert decides(*other)
    assert other == pytest.approx(usual, abs=0.2)


def test_a_darker_or_warmer_photo_changes_the_appearance_little():
    points, colours, view = painted("car", waves)
    usual = appearance(points, colours, BOTH, view)
    for factor in (0.5, np.array([1.0, 0.8, 0.55])):
        changed = photographed(view, lambda image, factor=factor: factor * image)
        assert appearance(points, colours, BOTH, changed) == pytest.approx(usual, abs=0.05)


def test_a_cloud_without_colour_is_told_by_light_and_dark():
    points, colours, view = painted("car", lambda points: waves(points)[:, :1] * np.ones(3))
    assert decides(*appearance(points, colours, BOTH, view))


def test_slow_changes_of_light_do_not_count():
    points, colours, view = painted("car", lambda points: waves(points)[:, :1] * np.ones(3))
    usual = appearance(points, colours, BOTH, view)
    fading = np.linspace(1.0, 0.2, view.mask.shape[1])[:, None]
    dim_at_right = photographed(view, lambda image: image * fading)
    assert appearance(points, colours, BOTH, dim_at_right) == pytest.approx(usual, abs=0.03)


def test_the_opposite_paint_disagrees():
    points, colours, view = painted("car", waves)
    assert appearance(points, 1.0 - colours, RIGHT, view)[0] < -0.5


def test_what_hardly_agrees_or_hardly_differs_decides_nothing():
    assert decides(0.6, 0.3)
    assert not decides(0.6, 0.55)
    assert not decides(0.15, -0.3)


def test_a_cloud_of_one_colour_decides_nothing():
    points, _, view = painted("car", two_tone)
    for colour in (0.0, 0.4, 1.0):
        found = appearance(points, np.full((len(points), 3), colour), BOTH, view)
        assert found == pytest.approx(0.0, abs=1e-9)
        assert not decides(*found)


def test_a_photo_of_one_colour_decides_nothing():
    points, colours, view = painted("car", two_tone)
    plain = photographed(view, lambda image: np.full_like(image, 0.4))
    assert appearance(points, colours, BOTH, plain) == pytest.approx(0.0, abs=1e-6)


def test_unrelated_colours_decide_nothing():
    points, _, view = painted("car", waves)
    for seed in range(5):
        other = np.random.default_rng(seed).uniform(size=(len(points), 3))
        found = appearance(points, other, BOTH, view)
        assert not decides(*found)
        assert not decides(*found[::-1])


def test_a_large_photo_looks_as_a_small_one():
    points, colours, view = painted("car", waves)
    height, width = view.mask.shape
    mask, image = (part.repeat(6, 0).repeat(6, 1) for part in (view.mask, view.image))
    large = View(mask, view.camera.resized(6 * width, 6 * height), image=image)
    usual, found = (appearance(points, colours, BOTH, seen) for seen in (view, large))
    assert found == pytest.approx(usual, abs=0.03)


def test_without_a_photo_nothing_can_be_told():
    points, colours, view = painted("car", two_tone)
    assert appearance(points, colours, BOTH, replace(view, image=None)).tolist() == [0.0, 0.0]


def test_a_cloud_beside_the_mask_says_nothing():
    points, colours, view = painted("car", two_tone)
    beside = replace(RIGHT, t=np.array([[0.0, 5.0, 0.0]]))
    assert appearance(points, colours, beside, view).tolist() == [0.0]


def test_few_cells_say_less_than_many():
    points, colours, view = painted("car", waves)
    few = appearance(points[:20], colours[:20], RIGHT, view)
    assert abs(few[0]) < 0.6 * appearance(points, colours, RIGHT, view)[0]


def test_pixels_of_which_nothing_is_known_do_not_count():
    points, colours, view = painted("car", two_tone)
    known = np.ones(view.mask.shape, bool)
    known[:, :100] = False
    view = replace(view, known=known)
    noise = np.random.default_rng(0).uniform(size=view.image.shape)
    spoilt = replace(view, image=np.where(known[..., None], view.image, noise))
    usual, found = (appearance(points, colours, BOTH, seen) for seen in (view, spoilt))
    assert found.tolist() == usual.tolist()


def test_the_background_does_not_count():
    points, colours, view = painted("car", two_tone)
    noise = np.random.default_rng(0).uniform(size=view.image.shape)
    before_noise = replace(view, image=np.where(view.inside[..., None], view.image, noise))
    usual, found = (appearance(points, colours, BOTH, seen) for seen in (view, before_noise))
    assert found.tolist() == usual.tolist()


@pytest.mark.parametrize("model", ["perspective", "orthographic"])
def test_points_on_the_far_side_do_not_show_through(model):
    # Two sheets, one behind the other; the photo shows the paint of the front one.
    K = np.array([[60.0, 0.0, 31.5], [0.0, 60.0, 31.5], [0.0, 0.0, 1.0]])
    K[:2, :2] *= 2.0 if model == "perspective" else 1.0
    camera = replace(Camera.canonical(64, 64), K=K, model=model)
    across = np.linspace(-0.4, 0.4, 40)
    x, y = (part.ravel() for part in np.meshgrid(across, across))
    front = np.stack([x, y, np.full_like(x, 0.2)], 1)
    points = np.concatenate([front, front * [1.0, 1.0, -1.0]])
    red, blue = np.array([0.8, 0.2, 0.2]), np.array([0.2, 0.2, 0.8])
    near = np.where(x[:, None] > 0.0, red, blue)
    halves = np.where(np.arange(64)[:, None] > 31.5, red, blue)
    view = View(block(np.s_[8:56, 8:56]), camera, image=np.tile(halves, (64, 1, 1)))
    for far in (near, 1.0 - near, np.full_like(near, 0.5)):
        found = appearance(points, np.concatenate([near, far]), Placements.unmoved(), view)
        assert found[0] > 0.8


def test_a_cloud_of_few_points_is_compared_in_larger_cells():
    points, colours, view = painted("car", two_tone)
    assert module._side(view, 200) < module._side(view, 800) <= module.LARGEST_SIDE
    some = np.random.default_rng(0).permutation(len(points))[:200]
    assert decides(*appearance(points[some], colours[some], BOTH, view))


def test_placements_are_judged_each_by_itself():
    points, colours, view = painted("car", waves)
    found = appearance(points, colours, BOTH, view)
    single = [appearance(points, colours, one, view)[0] for one in (RIGHT, TURNED)]
    assert found == pytest.approx(single, abs=1e-12)


def test_the_photo_chooses_among_poses_of_a_camera_that_fit_the_mask_alike():
    # A bar whose silhouette is the same from both sides, and red on one end.
    rng = np.random.default_rng(0)
    bar = rng.uniform(-1.0, 1.0, (1500, 3)) * [0.5, 0.08, 0.08]
    colours = np.where(bar[:, :1] > 0.0, [[0.9, 0.1, 0.1]], [[0.2, 0.4, 0.8]])
    mask = np.zeros((64, 64), np.float32)
    mask[28:36, 10:54] = 1.0
    for red_on_the_left in (True, False):
        image = np.full((64, 64, 3), [0.2, 0.4, 0.8], np.float32)
        image[:, 0:32] = [0.9, 0.1, 0.1]
        image = image if red_on_the_left else image[:, ::-1].copy()
        fitted = fit_camera(bar, mask, image=image, colours=colours)
        pixels, _ = fitted.camera.project(bar)
        assert (np.corrcoef(pixels[:, 0], bar[:, 0])[0, 1] < -0.9) == red_on_the_left
    alone = fit_camera(bar, mask)
    assert not any(one.unlike_photo for one in alone.alternatives)
