"""What people get wrong in cloud, camera and mask is named, and the option that is named mends it."""

from dataclasses import replace

import numpy as np
import pytest

from tests.corruption import assert_refused
from tests.scenes import about as about_axis
from tests.scenes import example, in_photo, seen, turned
from tso_cli import View, refine
from tso_cli.diagnosis.agreement import Agreement
from tso_cli.diagnosis.hypotheses import (
    ASSUMPTIONS,
    AssumedView,
    about,
    assumptions_of,
    in_axes_of_cloud,
)
from tso_cli.geometry.camera import Camera
from tso_cli.losses.silhouette import silhouette_of

PLANE = example("airplane")
# The mistake that an assumption mends, where that is not the same change again.
OPPOSITE = {
    **{"cloud-z-up": "cloud-y-up", "cloud-yzx": "cloud-zxy", "K-of-half-size": "K-of-double-size"},
    **{"cloud-millimetres": "camera-millimetres", "cloud-centimetres": "camera-centimetres"},
    **{"cloud-inches": "camera-inches", "cloud-ten-times-large": "cloud-ten-times-small"},
    "cloud-twice-large": "cloud-half-large",
}
OPPOSITE |= {mistake: mended for mended, mistake in OPPOSITE.items()}
# In a picture whose middle is the principal point it changes nothing; of a thing seen so nothing that a mask shows.
UNSEEN = {"principal-point-swapped", "R-transposed"}


def _mistaken(name: str):
    """The aeroplane's cloud and view, wrong so that the assumption is right."""
    view = PLANE.view
    if name == "opengl-camera-to-world":
        R = np.diag([1.0, -1.0, -1.0]) @ view.camera.R
        t = view.camera.t * [1.0, -1.0, -1.0]
        return PLANE.target, replace(view, camera=replace(view.camera, R=R.T, t=-R.T @ t))
    if name == "t-of-position":
        return PLANE.target, replace(view, camera=replace(view.camera, t=view.camera.position))
    mistake = ASSUMPTIONS[OPPOSITE.get(name, name)]
    return PLANE.target @ mistake.matrix.T, mistake.of_view(view)


@pytest.mark.parametrize("name", sorted(set(ASSUMPTIONS) - UNSEEN))
def test_a_mistake_is_named_before_the_start(name):
    points, view = _mistaken(name)
    suspects = [suspect.option for suspect in Agreement.of(points, [view]).suspects]
    assert f"--assume {name}" in suspects


@pytest.mark.parametrize("name", ["chair", "car", "airplane"])
def test_right_input_is_not_suspected(name):
    scene = example(name)
    for points in (scene.points, scene.target):
        assert Agreement.of(points, [scene.view]).suspects == ()


def _boxed(view: View) -> View:
    """The view whose mask is the box of the object, as a detector gives it."""
    rows, columns = np.nonzero(view.mask > 0.5)
    mask = np.zeros_like(view.mask)
    mask[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1] = 1.0
    return replace(view, mask=mask)


@pytest.mark.parametrize("name", ["chair", "car", "airplane"])
def test_a_box_in_place_of_a_mask_is_suspected_and_no_cloud_follows_it(name):
    scene = example(name)
    result = refine(scene.points, _boxed(scene.view))
    assert [suspect.what for suspect in result.suspects] == [
        f"{scene.view.name} is the box of the object"
    ]
    assert result.verdict == "doubtful"
    assert result.step_taken == 0.0
    assert np.array_equal(result.points, scene.points)


def test_one_box_among_masks_is_named_and_the_cloud_follows_the_others():
    scene = example("car")
    others = [
        replace(seen(scene.target, turned(scene.camera, angle)), name=f"{angle:g}.png")
        for angle in (90.0, 180.0)
    ]
    result = refine(scene.points, [replace(_boxed(scene.view), name="1.png"), *others])
    assert [suspect.what for suspect in result.suspects] == ["1.png is the box of the object"]
    assert result.step_taken > 0.0


@pytest.mark.parametrize("order", [[1, 0], [1, 0, 2], [1, 2, 3, 0]])
def test_masks_that_are_not_in_the_order_of_their_cameras_are_named_in_pairs(order):
    views = _around()[: len(order)]
    mixed = [replace(views[i], camera=view.camera) for i, view in zip(order, views, strict=True)]
    agreement = Agreement.of(PLANE.points, mixed)
    (suspect,) = agreement.suspects
    assert agreement.most_confidence < 0.3
    assert not agreement.outvoted
    assert suspect.what == "masks and cameras are paired wrongly" + ", or the cloud is turned" * (
        order[-1] != len(order) - 1
    )
    # What has the camera of view i is named after the mask that came with it.
    pairs = [
        f"{views[i].name} with the camera that {mixed[i].name} has now"
        for i in range(len(order))
        if order[i] != i
    ]
    named = suspect.option.partition(", and so on")[0].split(", ")
    assert named == pairs[:3]
    assert suspect.option.endswith(", 4 in all") == (len(pairs) > 3)


def test_a_pair_among_many_is_named_and_the_cloud_follows_the_others():
    views = [
        replace(seen(PLANE.target, turned(PLANE.camera, 40.0 * i)), name=f"{i}.png")
        for i in range(8)
    ]
    mixed = [
        *views[:6],
        replace(views[7], camera=views[6].camera),
        replace(views[6], camera=views[7].camera),
    ]
    result = refine(PLANE.points, mixed)
    assert [suspect.option.partition(",")[0] for suspect in result.suspects] == [
        "6.png with the camera that 7.png has now"
    ]
    assert result.verdict == "doubtful"
    assert result.step_taken == 1.0
    assert PLANE.error(result.points) < 0.9 * PLANE.error(PLANE.points)


def test_a_pair_is_named_beside_a_view_that_fits_a_mask_of_it_too():
    """From 0 and 5 degrees the chair fits either's mask; one of the two has the mask from 90 degrees."""
    chair = example("chair")
    views = [
        replace(seen(chair.target, turned(chair.camera, angle)), name=f"{angle:.0f}")
        for angle in (0.0, 5.0, 90.0)
    ]
    mixed = [
        views[0],
        replace(views[2], camera=views[1].camera),
        replace(views[1], camera=views[2].camera),
    ]
    (suspect,) = Agreement.of(chair.points, mixed).suspects
    assert suspect.option == "5 with the camera that 90 has now, 90 with the camera that 5 has now"


def test_flipped_masks_of_a_symmetric_object_do_not_pass_for_exchanged_ones():
    """From 45 degrees left and right of its mirror plane each looks like the other, flipped."""
    car = example("car")
    views = [
        replace(seen(car.target, turned(car.camera, angle)), name=f"{angle}.png")
        for angle in (0.0, 90.0)
    ]
    flipped = [ASSUMPTIONS["mask-flipped"].of_view(view) for view in views]
    assert "--assume mask-flipped" in [
        suspect.option for suspect in Agreement.of(car.target, flipped).suspects
    ]


def test_views_that_agree_are_exchanged_with_none():
    """Though each may fit another's mask a little better: the masks of an object of revolution are much the same."""
    ball = np.random.default_rng(0).normal(size=(1024, 3)) * [0.1, 0.2, 0.1]
    views = [replace(seen(ball, turned(PLANE.camera, 40.0 * i)), name=f"{i}.png") for i in range(4)]
    mixed = [replace(views[i - 1], camera=views[i].camera) for i in range(4)]
    assert Agreement.of(ball, mixed).named == ()


def test_pixels_that_are_unknown_in_a_mask_are_so_with_the_camera_of_another():
    views = _around()[:2]
    known = np.ones(views[0].mask.shape, bool)
    known[:, : known.shape[1] // 2] = False
    mixed = [
        replace(views[1], camera=views[0].camera, known=known),
        replace(views[0], camera=views[1].camera),
    ]
    assert Agreement.of(PLANE.target, mixed).suspects[0].score > 0.8


def test_views_of_one_name_are_numbered():
    views = [replace(view, name="mask") for view in _around()[:2]]
    (suspect,) = Agreement.of(
        PLANE.points, [replace(views[1 - i], camera=views[i].camera) for i in (0, 1)]
    ).suspects
    assert (
        suspect.option
        == "view 2 with the camera that view 1 has now, view 1 with the camera that view 2 has now"
    )


def test_masks_of_another_size_are_exchanged_with_none():
    views = _around()[:2]
    larger = in_photo(replace(views[0], camera=views[1].camera), 2, 0, 0)
    mixed = [larger, replace(views[1], camera=views[0].camera)]
    assert not any("paired" in suspect.what for suspect in Agreement.of(PLANE.points, mixed).named)


def test_an_inverted_mask_that_fills_the_picture_is_no_box():
    view = in_photo(example("car").view, 12, 1000, 1000)
    inverted = replace(view, mask=1.0 - view.mask)
    assert inverted.inside.mean() > 0.99
    assert "--assume mask-inverted" in Agreement.of(example("car").points, [inverted]).suspicion


def _panel(count: int = 1024) -> np.ndarray:
    """A frontal sheet [N, 3]."""
    rng = np.random.default_rng(0)
    return np.stack(
        [rng.uniform(-0.5, 0.5, count), rng.uniform(-0.2, 0.2, count), np.zeros(count)], axis=1
    )


PANELS = {
    "as it is": _panel(),
    "of few points": _panel(512),
    "turned": _panel() @ about_axis("z", 10.0).T,
    "noisy": _panel() + np.random.default_rng(1).normal(scale=[0.02, 0.02, 0.0], size=(1024, 3)),
    "with strays": np.concatenate(
        [_panel(), np.random.default_rng(1).uniform(-0.6, 0.6, (10, 3)) * [1.0, 1.0, 0.0]]
    ),
    "rounded": _panel()[np.square(_panel()[:, :2] / [0.5, 0.2]).sum(1) < 1.0],
}


@pytest.mark.parametrize("name", PANELS)
def test_a_panel_that_fills_its_box_is_not_suspected(name):
    camera = Camera.canonical(256, 256)
    pixels = np.rint(camera.project(_panel())[0]).astype(int)
    mask = np.zeros((256, 256), np.float32)
    mask[
        pixels[:, 1].min() : pixels[:, 1].max() + 1, pixels[:, 0].min() : pixels[:, 0].max() + 1
    ] = 1.0
    assert not Agreement.of(PANELS[name], [View(mask, camera)]).named


def test_a_small_box_or_one_of_few_points_is_not_told():
    scene = example("car")
    small = replace(
        scene.view, mask=scene.view.mask[::20, ::20], camera=scene.view.camera.resized(13, 13)
    )
    for points, view in ((scene.points, _boxed(small)), (scene.points[:100], _boxed(scene.view))):
        assert not Agreement.of(points, [view]).named


@pytest.mark.parametrize("name", ["chair", "car", "airplane"])
@pytest.mark.parametrize("times", [24, 48, 64, 80, 96, 128, 160])
def test_right_input_of_a_few_pixels_is_not_suspected(name, times):
    scene = example(name)
    corner = 20 * times + times // 3
    large = in_photo(scene.view, 64 * times // len(scene.mask), corner, corner)
    pixels = large.mask.reshape(64, times, 64, times).mean((1, 3)) > 0.5
    K = large.camera.K / [[times], [times], [1.0]]
    K[:2, 2] -= 0.5 - 0.5 / times
    if pixels.any():
        view = View(np.float32(pixels), replace(large.camera, K=K, width=64, height=64))
        assert Agreement.of(scene.points, [view]).suspects == ()


@pytest.mark.parametrize("name", ASSUMPTIONS)
def test_under_its_assumption_a_mistake_projects_as_the_right_input_does(name):
    points, view = _mistaken(name)
    if name == "principal-point-swapped":
        view = replace(
            PLANE.view,
            camera=replace(PLANE.camera, K=PLANE.camera.K + [[0, 0, 9.0], [0, 0, -4.0], [0, 0, 0]]),
        )
        swapped = ASSUMPTIONS[name].of_view(view).camera.K
        assert swapped[0, 2] == view.camera.K[1, 2]
        assert swapped[1, 2] == view.camera.K[0, 2]
        return
    (assumption,) = assumptions_of([name])
    meant = assumption.of_view(view)
    pixels, _ = meant.camera.project(points @ assumption.matrix.T)
    np.testing.assert_allclose(pixels, PLANE.camera.project(PLANE.target)[0], atol=1e-6)
    np.testing.assert_array_equal(meant.mask, PLANE.mask)


@pytest.mark.parametrize(
    "name", sorted(name for name in ASSUMPTIONS if ASSUMPTIONS[name].axes != "x y z")
)
def test_a_camera_in_the_axes_of_the_cloud_sees_it_as_the_scene_was_seen(name):
    axes = ASSUMPTIONS[name].matrix
    depth = np.where(PLANE.mask > 0.5, np.arange(1.0, 1.0 + PLANE.mask.shape[1]), np.nan)
    photo = np.stack([np.nan_to_num(depth, nan=0.0)] * 3, axis=2).astype(np.float32) / np.float32(
        256.0
    )
    view = in_axes_of_cloud(replace(PLANE.view, depth=depth, image=photo), axes)
    pixels, _ = view.camera.project(PLANE.target @ axes)
    expected, _ = PLANE.camera.project(PLANE.target)
    if np.linalg.det(axes) < 0.0:
        expected = [PLANE.camera.width - 1.0, 0.0] + expected * [-1.0, 1.0]
        view = replace(
            view, mask=view.mask[:, ::-1], depth=view.depth[:, ::-1], image=view.image[:, ::-1]
        )
    np.testing.assert_allclose(pixels, expected, atol=1e-9)
    np.testing.assert_array_equal(view.mask, PLANE.mask)
    np.testing.assert_array_equal(view.depth, depth)
    np.testing.assert_array_equal(view.image, photo)


def _around() -> list[View]:
    return [
        replace(seen(PLANE.target, turned(PLANE.camera, 40.0 * i)), name=f"{i}.png")
        for i in range(4)
    ]


@pytest.mark.parametrize("name", ["mask-inverted", "mask-upside-down", "opengl", "camera-to-world"])
def test_a_mistake_in_one_view_of_several_is_named_with_the_view(name):
    views = _around()[:3]
    assert Agreement.of(PLANE.points, views).suspicion is None
    agreement = Agreement.of(PLANE.points, [*views[:2], ASSUMPTIONS[name].of_view(views[2])])
    assert agreement.suspects == ()
    assert [one.option for one in agreement.of_views] == [f"--assume {name}@2.png"]
    assert (
        f"for 2.png alone {ASSUMPTIONS[name].what}: try --assume {name}@2.png"
        in agreement.suspicion
    )
    assert about(views[1], assumptions_of([f"{name}@2.png"])) == []


@pytest.mark.parametrize("wrong", [0, 1])
def test_of_two_views_the_one_that_shows_nothing_of_the_cloud_is_the_wrong_one(wrong):
    views = _around()[:2]
    views[wrong] = ASSUMPTIONS["camera-to-world"].of_view(views[wrong])
    (suspect,) = Agreement.of(PLANE.points, views).of_views
    assert suspect.option == f"--assume camera-to-world@{wrong}.png"
    # Flipped, it shows the cloud as well as the other does.
    views = [
        ASSUMPTIONS["mask-flipped"].of_view(view) if i == wrong else view
        for i, view in enumerate(_around()[:2])
    ]
    assert Agreement.of(PLANE.points, views).of_views == ()


def test_units_of_an_orthographic_camera_are_in_its_k():
    camera = Camera(
        np.diag([100.0, 100.0, 1.0]), np.eye(3), np.array([0.0, 0.0, 2.0]), 64, 64, "orthographic"
    )
    points = np.array([[0.1, 0.2, 0.0]])
    (metres,) = assumptions_of(["cloud-millimetres"])
    np.testing.assert_allclose(
        metres.of_camera(camera).project(1000.0 * points)[0], camera.project(points)[0]
    )


def test_the_order_of_the_points_does_not_matter():
    """Of an organised cloud, points at equal steps are of one column."""
    side = np.linspace(-0.5, 0.5, 1024)
    grid = np.stack([np.repeat(side, 1024), np.tile(side, 1024), np.zeros(1024 * 1024)], 1)
    view = PLANE.view
    shuffled = np.random.default_rng(0).permutation(grid)
    assert Agreement.of(grid, [view]).as_given == pytest.approx(
        Agreement.of(shuffled, [view]).as_given, abs=0.05
    )


def test_points_on_unknown_pixels_are_no_disagreement():
    known = np.ones(PLANE.mask.shape, bool)
    known[:, : known.shape[1] // 2] = False
    given = Agreement.of(PLANE.target, [replace(PLANE.view, known=known)]).as_given
    assert given > 0.9 * Agreement.of(PLANE.target, [PLANE.view]).as_given


def test_an_object_that_the_border_truncates_does_not_pass_for_an_inverted_mask():
    camera = replace(
        PLANE.camera, K=PLANE.camera.K * [[3.0, 1.0, 1.0], [1.0, 3.0, 1.0], [1.0, 1.0, 1.0]]
    )
    near = View(silhouette_of(PLANE.target, camera), camera)
    assert not any(
        "inverted" in suspect.option for suspect in Agreement.of(PLANE.points, [near]).suspects
    )


def test_the_unknown_part_of_a_border_does_not_hide_that_a_mask_is_inverted():
    view = PLANE.view
    known = np.ones(view.mask.shape, bool)
    known[:, : known.shape[1] // 2 - 20] = False
    inverted = replace(
        view, mask=np.where(known, 1.0 - view.mask, 0.0).astype(np.float32), known=known
    )
    (suspect, *_) = Agreement.of(PLANE.target, [inverted]).suspects
    assert suspect.option == "--assume mask-inverted"


def test_a_wrong_assumption_about_one_view_is_named_as_it_was_given():
    views = _around()
    given = tuple(assumptions_of([f"mask-inverted@{views[1].name}"]))
    views = [
        AssumedView(v.mask, v.camera, None, v.name, given=given, camera_read=v.camera)
        for v in views
    ]
    views[1] = given[0].of_view(views[1])
    (suspect,) = Agreement.of(PLANE.target, views).named
    assert suspect.option == f"without --assume mask-inverted@{views[1].name}"


@pytest.mark.parametrize(("name", "named"), [("mask-inverted", True), ("mask-upside-down", False)])
def test_of_two_views_either_may_be_the_wrong_one_but_a_mask_that_fills_the_border(name, named):
    views = _around()[:2]
    agreement = Agreement.of(PLANE.target, [views[0], ASSUMPTIONS[name].of_view(views[1])])
    assert bool(agreement.of_views) == named


def test_two_wrong_views_of_four_are_both_named():
    views = _around()
    for number in (1, 2):
        views[number] = ASSUMPTIONS["mask-inverted"].of_view(views[number])
    options = {suspect.option for suspect in Agreement.of(PLANE.target, views).named}
    assert options == {f"--assume mask-inverted@{views[number].name}" for number in (1, 2)}


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (["mask-inverted@"], "expected one of"),
        (["cloud-z-up@a.png"], "expected cloud-z-up alone: the cloud is the same for all masks"),
        (["opengl", "opengl"], "--assume opengl is given twice"),
    ],
)
def test_assumptions_that_say_nothing_are_refused(texts, message):
    assert_refused(message, assumptions_of, texts)


def test_assumptions_about_the_cloud_are_those_named_after_it():
    assert {name for name, one in ASSUMPTIONS.items() if one.of_cloud} == {
        n for n in ASSUMPTIONS if n.startswith("cloud-")
    }
