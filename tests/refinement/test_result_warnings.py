"""A result says so when nothing moved, and why; and what its masks are too coarse to tell."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tso_cli.errors import InputError
from tso_cli.geometry.camera import Camera
from tso_cli.geometry.view import View
from tso_cli.io.cameras import read_camera
from tso_cli.io.clouds import read_cloud
from tso_cli.io.images import read_mask
from tso_cli.refinement import PRESETS, RefineConfig, RefineResult, refine, refine_batch
from tso_cli.render import look_at

CHAIR = Path(__file__).parents[2] / "examples" / "chair"


@pytest.fixture(scope="module")
def chair():
    mask = read_mask(CHAIR / "mask.png")
    camera = read_camera(CHAIR / "camera.json", mask.shape[1], mask.shape[0])
    return read_cloud(CHAIR / "initial.ply").points, View(mask, camera, name="chair.png")


def _square_and_a_cloud_that_fills_it() -> tuple[np.ndarray, View]:
    """24 pixels of 64 across, and points all over it, closer than pixels are wide."""
    camera = Camera(
        np.array([[60.0, 0.0, 31.5], [0.0, 60.0, 31.5], [0.0, 0.0, 1.0]]), np.eye(3), np.zeros(3), 64, 64, "orthographic"
    )
    mask = np.zeros((64, 64), np.float32)
    mask[20:44, 20:44] = 1.0
    across = np.linspace(20.0, 43.0, 64)
    columns, rows = np.meshgrid(across, across)
    points = np.stack([(columns - 31.5) / 60.0, (rows - 31.5) / 60.0, np.full_like(rows, 0.5)], -1).reshape(-1, 3)
    return points, View(mask, camera)


def _few_pixels(points: np.ndarray, rows: int, columns: int) -> View:
    """A photo of 640x480 in which the object is so large, and a camera that sees ``points`` there."""
    mask = np.zeros((480, 640), np.float32)
    mask[200 : 200 + rows, 300 : 300 + columns] = 1.0
    camera = look_at(30.0, 20.0, 3.0, (640, 480))
    pixels, _ = camera.project(points)
    K = camera.K.copy()
    K[:2] *= rows / np.ptp(pixels[:, 1])
    moved = Camera(K, camera.R, camera.t, 640, 480)
    middle = (lambda p: (p.min(0) + p.max(0)) / 2.0)(moved.project(points)[0])
    K[:2, 2] += np.array([300.0 + (columns - 1) / 2.0, 200.0 + (rows - 1) / 2.0]) - middle
    return View(mask, Camera(K, camera.R, camera.t, 640, 480), name="small.png")


def test_a_cloud_that_fills_its_mask_has_nothing_to_do():
    points, view = _square_and_a_cloud_that_fills_it()
    found = refine(points, view, config=RefineConfig(steps=3, symmetry="none"))
    assert (found.stop_reason, found.best_step, found.loss_before) == ("nothing_to_do", 0, 0.0)
    assert found.warnings == ("nothing to do: the cloud already agrees with all that the mask shows; the cloud is as it was",)
    assert (found.moved_mean, found.moved_max) == (0.0, 0.0)
    np.testing.assert_array_equal(found.points, points)


def test_of_a_batch_only_the_cloud_that_fills_its_mask_has_nothing_to_do():
    points, view = _square_and_a_cloud_that_fills_it()
    wide = points * [1.2, 1.0, 1.0]
    done, moved = refine_batch([(points, view), (wide, view)], RefineConfig(steps=3, symmetry="none"))
    assert (done.stop_reason, moved.stop_reason) == ("nothing_to_do", "max_steps")
    assert (len(done.warnings), moved.warnings) == (1, ())
    assert moved.moved_max > 0.0


def test_steps_that_lower_no_loss_are_told_from_none_that_were_asked_for(chair):
    points, view = chair
    wild = refine(points, view, config=RefineConfig(learning_rate=0.5, steps=5, preset="paper"))
    assert (wild.stop_reason, wild.steps) == ("not_improved", 5)
    why = "none of 5 steps agrees better with what the mask shows than the start does"
    assert wild.warnings == (f"nothing moved: {why}; the cloud is as it was",)
    none = refine(points, view, config=RefineConfig(steps=0))
    assert (none.stop_reason, none.steps) == ("max_steps", 0)
    assert none.warnings == ("nothing moved: no steps were asked for; the cloud is as it was",)


def test_a_movement_too_small_to_be_seen_is_told(chair):
    points, view = chair
    found = refine(points, view, config=RefineConfig(learning_rate=1e-6, steps=2, preset="paper"))
    assert found.stop_reason == "max_steps" and 0.0 < found.moved_max < 1e-3
    assert found.warnings == ("hardly anything moved: no point by more than 0.1 % of the object's size",)


def test_movements_are_shares_of_the_objects_size_in_any_unit(chair):
    points, view = chair
    config = RefineConfig(steps=6, symmetry="none")
    found = refine(points, view, config=config)
    moved = np.linalg.norm(found.points - points, axis=1) / np.ptp(points, axis=0).max()
    assert (found.moved_mean, found.moved_max) == pytest.approx((moved.mean(), moved.max()))
    camera = Camera(view.camera.K, view.camera.R, 1000.0 * view.camera.t, view.camera.width, view.camera.height)
    large = refine(1000.0 * points, View(view.mask, camera), config=config)
    assert large.moved_max == pytest.approx(found.moved_max, rel=1e-3)


def test_an_interrupt_tells_what_was_reached_and_what_had_not_begun(chair):
    points, view = chair

    def interrupt(step, steps, loss):
        if step == 4:
            raise KeyboardInterrupt

    config = RefineConfig(steps=6, symmetry="none")
    reached, waiting = refine_batch([(points, view), (points[:300], view)], config, progress=interrupt)
    assert reached.warnings == ("interrupted at step 4 of 6: the result is the best so far",)
    assert waiting.stop_reason == "interrupted"
    assert waiting.warnings[0].startswith("nothing moved: interrupted at step 0, before one lowered the loss")


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize(
    ("rows", "columns", "told"),
    [
        (1, 1, "shows the object with a single pixel, which tells where it is and nothing of its shape"),
        (2, 1, "shows the object with only 2 pixels: details smaller than 1/2 of its size cannot be seen"),
        (3, 2, "shows the object with only 6 pixels: details smaller than 1/3 of its size cannot be seen"),
        (5, 3, "shows the object with only 15 pixels: details smaller than 1/5 of its size cannot be seen"),
    ],
)
def test_a_mask_of_a_few_pixels_is_refined_and_warned_of(chair, preset, rows, columns, told):
    points, _ = chair
    found = refine(points, _few_pixels(points, rows, columns), config=RefineConfig(preset=preset))
    assert np.isfinite(found.points).all()
    assert f"small.png: {told}" in found.warnings
    assert bool(found.best_step) != any(text.startswith("nothing ") for text in found.warnings)


def test_pixels_wider_than_the_spacing_of_the_points_are_warned_of_where_they_are_few(chair):
    points, view = chair
    six = "small.png: shows the object with only 30 pixels: details smaller than 1/6 of its size cannot be seen"

    def warned(cloud: np.ndarray, seen: View) -> bool:
        return six in refine(cloud, seen, config=RefineConfig(steps=0)).warnings

    small = _few_pixels(points, 6, 5)
    assert warned(points, small)
    # of a cloud so thin the pixels show all that there is
    assert not warned(points[::20], small)
    # of fewer pixels than these no cloud can be told much
    assert refine(points[::60], _few_pixels(points, 5, 3), config=RefineConfig(steps=0)).warnings[1:]
    assert len(refine(points, view, config=RefineConfig(steps=0)).warnings) == 1


def test_a_cloud_none_of_whose_points_falls_on_the_image_is_refused():
    """Half of it lies left of the picture, half right of it: their common box covers it all the same."""
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (40, 3)) + np.where(np.arange(40) % 2, 3.0, -3.0)[:, None] * [1, 0, 0]
    mask = np.zeros((64, 64), np.float32)
    mask[:, 20:40] = 1.0
    for preset in PRESETS:
        with pytest.raises(InputError, match="no point falls inside the 64x64 image"):
            refine(points, View(mask, look_at(0.0, 0.0, 3.0, (64, 64))), config=RefineConfig(preset=preset))


def test_results_of_the_network_modes_say_it_too():
    from tso_cli.network.model import build_network

    mask = np.zeros((64, 64), np.float32)
    mask[10:54, 14:50] = 1.0
    for mode in ("encoder", "encoder-decoder", "latent"):
        found: RefineResult = refine(
            None,
            View(mask, Camera.canonical(64, 64)),
            config=RefineConfig(mode, steps=2, learning_rate=1.0),
            network=build_network(points=128, seed=0),
            image=np.full((3, 64, 64), 0.5, np.float32),
        )
        assert (found.stop_reason, found.best_step) == ("not_improved", 0)
        assert found.warnings[0].startswith("nothing moved: none of ")
