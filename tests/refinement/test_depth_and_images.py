"""Refinements with depth maps and photos, in addition to the mask."""

from dataclasses import replace

import numpy as np
import pytest

from tests.corruption import assert_refused
from tests.painted import CAMERA, MASK, SIZE, photo, sheet
from tests.scenes import block
from tso_cli import Camera, RefineConfig, View, refine
from tso_cli.evaluation.metrics import chamfer
from tso_cli.geometry.mirror_plane import MirrorPlane
from tso_cli.optimisation.objective import ViewTargets
from tso_cli.optimisation.resampled_view import resample_view

# No confidence was fitted to such sheets.
CONFIG = RefineConfig(steps=45, symmetry="none", accept_doubtful=True)
ACROSS = (np.arange(SIZE) - 31.5) / 120.0
# A sheet tilted about the vertical axis, which its mask hardly shows.
TILTED = View(MASK, CAMERA, depth=np.where(MASK > 0.5, 2.0 / (1.0 + 0.4 * ACROSS), np.nan))


def _plain_sheet(slope: float) -> np.ndarray:
    """A square sheet, nearer to the camera on its right."""
    x, y = np.random.default_rng(0).uniform(-0.45, 0.45, (2, 600))
    return np.stack([x, y, slope * x], 1)


def test_a_depth_map_is_resampled_without_averaging_across_edges():
    depth = np.where(np.arange(256) < 130, 2.0, 3.0)[None].repeat(256, 0)
    view = View(block(np.s_[64:192, 64:192], (256, 256)), Camera.canonical(256, 256), depth=depth)
    resampled = resample_view(view, 0.4, np.zeros(3), 2.0)
    assert resampled.depth.shape == (64, 64)
    assert set(np.unique(resampled.depth)) == {1.0, 1.5}


def test_a_depth_map_brings_a_cloud_nearer_than_its_mask_alone():
    start, target = _plain_sheet(0.0), _plain_sheet(0.4)
    views = TILTED, View(MASK, CAMERA)
    with_depth, without = (
        chamfer(refine(start, view, config=CONFIG).points, target).chamfer for view in views
    )
    assert with_depth < 0.3 * without


def test_views_with_and_without_a_depth_map_add_up_by_their_weights():
    start = _plain_sheet(0.0)
    plain = View(MASK.T.copy(), replace(CAMERA, R=np.eye(3)))

    def total(weights: list[float], *views: View) -> float:
        resampled = [resample_view(view, 0.4, np.zeros(3), 1.0) for view in views]
        return ViewTargets.of(resampled, weights).loss(start)[0]

    assert total([1.0, 0.5], TILTED, plain) == pytest.approx(
        total([1.0], TILTED) + 0.5 * total([1.0], plain)
    )
    assert total([1.0], TILTED) > total([1.0], View(MASK, CAMERA)) + 10.0


def test_a_photo_bends_no_shape():
    start = sheet(2.0)[0] * [0.95, 1.0, 1.0]
    alone, with_photo = (
        refine(start, View(MASK, CAMERA, image=image), config=CONFIG).points
        for image in (None, photo(0.7))
    )
    np.testing.assert_array_equal(with_photo, alone)


def test_a_flipped_view_has_a_flipped_depth_map_and_no_photo():
    """Letters are not symmetric where the shape is."""
    depth = np.where(MASK > 0.5, 2.0 + 0.1 * ACROSS, np.nan)
    view = View(MASK, CAMERA, image=photo(), depth=depth)
    flipped = MirrorPlane(np.array([1.0, 0.0, 0.0]), 0.0).flipped(view)
    assert flipped.image is None
    np.testing.assert_array_equal(flipped.depth, view.depth[:, ::-1])


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        (dict(depth=np.ones((3, 3))), r"depth map has shape \[3, 3\], the mask is 64x64"),
        (dict(depth=-np.ones((SIZE, SIZE))), "smallest depth is -1, expected 0"),
        (dict(depth=np.where(MASK > 0.5, 0.0, 2.0)), "no foreground pixel has a depth"),
        (
            dict(depth=MASK, camera=replace(CAMERA, model="orthographic")),
            "orthographic, expected perspective",
        ),
        (
            dict(image=np.ones((3, 3, 3))),
            r"image has shape \[3, 3, 3\], the mask is 64x64 .*|expected \[64, 64, 3\]",
        ),
        (
            dict(image=np.full((SIZE, SIZE, 3), [0.0, 255.0, 0.0])),
            "image's values span 0 to 255, expected 0 to 1",
        ),
    ],
)
def test_unusable_depth_maps_and_images_are_refused(parts, words):
    assert_refused(words, View, **(dict(mask=MASK, camera=CAMERA) | parts))


def test_a_depth_map_with_the_papers_preset_is_refused():
    words = "a depth map, expected mode points with preset best, found points with paper"
    config = RefineConfig(preset="paper")
    assert_refused(words, refine, sheet(3.0)[0], TILTED, config=config)
