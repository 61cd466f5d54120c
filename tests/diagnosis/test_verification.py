"""Hypotheses are confirmed where a cloud of other proportions then misses less of the contours."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from tests.scenes import depth_of, example, seen, turned
from tso_cli import RefineConfig, View, refine
from tso_cli.cloud.cloud import Cloud
from tso_cli.diagnosis import verification
from tso_cli.diagnosis.assumptions import Assumption, as_meant
from tso_cli.diagnosis.findings import Finding
from tso_cli.diagnosis.hypotheses import HYPOTHESES
from tso_cli.diagnosis.verification import closed, confirmed
from tso_cli.optimisation.presets import PRESETS
from tso_cli.refinement.run import check
from tso_cli.refinement.scene import as_scene

from .common import PLANE, around, changed, examined, named, paired

CHAIR = example("chair")
MISTAKES = ("mask-flipped", "mask-upside-down", "R-transposed")
FLIPPED = changed(CHAIR.view, "mask-flipped")


def confirms(view: View, name: str, points: np.ndarray = CHAIR.points) -> bool:
    """Whether the contours confirm the hypothesis of this ``name``."""
    body = Cloud(points, "cloud").controlled(views=[view]).body
    return bool(confirmed([Finding(name, (0,))], body, [view], ()))


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_that_silhouettes_hardly_show_is_confirmed(name):
    assert (name, (0,)) in named(examined(CHAIR.points, [changed(CHAIR.view, name)]).suspicious)


@pytest.mark.parametrize("name", MISTAKES)
def test_a_hypothesis_that_is_not_true_is_not_confirmed(name):
    assert not confirms(CHAIR.view, name)


@pytest.mark.parametrize("name", MISTAKES)
def test_a_cloud_of_other_proportions_is_no_reason_to_confirm_what_is_not_true(name):
    """It may stretch as given too."""
    stretched = CHAIR.target * [1.25, 0.9, 1.0]
    assert not confirms(CHAIR.view, name, stretched)


@pytest.mark.parametrize("what", ["depth", "image"])
def test_a_mistake_is_confirmed_also_with_a_depth_map_and_with_a_photo(what):
    """A mask that is flipped by mistake has other pictures as they were taken."""
    photo = np.zeros((*FLIPPED.mask.shape, 3), np.float32)
    view = replace(FLIPPED, **{what: depth_of(CHAIR) if what == "depth" else photo})
    assert ("mask-flipped", (0,)) in named(examined(CHAIR.points, [view]).suspicious)


def test_a_hypothesis_under_which_the_mask_shows_no_object_is_not_confirmed():
    """The background is known only in thin columns, which the coarse cells cannot resolve."""
    inside = (CHAIR.mask > 0.5).repeat(4, 0).repeat(4, 1)
    far = ~binary_dilation(inside, iterations=24)
    known = inside | (far & (np.indices(inside.shape)[1] % 5 == 0))
    view = View(np.float32(inside), CHAIR.camera.resized(*inside.shape), known)
    assert examined(CHAIR.points, [view]).suspicious == ()


# Of pairs


@pytest.mark.parametrize(
    ("order", "views"),
    [
        ([1, 0], (0, 1)),
        ([1, 0, 2, 3], (0, 1)),
        ([1, 2, 3, 0], (0, 1, 2, 3)),
        ([0, 1, 2, 3, 4, 5, 7, 6], (6, 7)),
    ],
    ids=str,
)
def test_masks_that_are_exchanged_are_confirmed_also_among_many(order, views):
    diagnosis = examined(PLANE.points, paired(around(len(order)), order))
    assert named(diagnosis.suspicious) == [("mispaired", views)]


def test_an_exchange_is_verified_with_the_views_that_gain_nothing_by_it():
    """The car looks alike from 0 and 180 degrees, so one of its three masks gains nothing."""
    car = example("car")
    views = [seen(car.target, turned(car.camera, angle)) for angle in (0.0, 90.0, 180.0)]
    diagnosis = examined(car.points, paired(views, [1, 2, 0]))
    (finding,) = diagnosis.suspicious
    assert len(finding.pairs) == 2
    assert closed(finding.pairs) == [(0, 1), (1, 2), (2, 0)]


def test_an_exchange_is_verified_under_the_assumptions_about_single_cameras():
    views = paired(around(2), [1, 0])
    given = (Assumption(HYPOTHESES["opengl"], views[0].name),)
    views[0] = as_meant(views[0], given)
    diagnosis = examined(PLANE.points, views, given)
    assert named(diagnosis.suspicious) == [("mispaired", (0, 1))]


@pytest.mark.parametrize("count", [2, 4, 8])
def test_masks_that_seem_to_be_exchanged_and_are_not_are_paired_rightly(count):
    views, pairs = around(count), ((1, 0), (0, 1))
    body = Cloud(PLANE.points, "cloud").controlled(views=views).body
    assert confirmed([Finding("mispaired", (0, 1), pairs=pairs)], body, views, ()) == ()


# In a refinement


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("name", MISTAKES)
def test_a_refinement_and_a_check_find_the_same_under_any_preset(name, preset):
    view, config = changed(CHAIR.view, name), RefineConfig(preset=preset)
    diagnosis, *_ = check(as_scene(CHAIR.points, view), config.settings())
    assert (name, (0,)) in named(diagnosis.suspicious)
    assert refine(CHAIR.points, view, config=config).findings == diagnosis.findings


def test_a_refinement_of_right_input_finds_nothing():
    assert refine(CHAIR.points, CHAIR.view).findings == ()


def test_ctrl_c_during_the_verification_leaves_the_cloud_as_it_was(monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(verification, "missed_if_stretched", interrupted)
    result = refine(CHAIR.points, FLIPPED)
    assert result.fit.stop_reason == "interrupted"
    np.testing.assert_array_equal(result.points, result.initial)
