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
from tso_cli.diagnosis.examine import Diagnosis, examine
from tso_cli.diagnosis.findings import Finding
from tso_cli.diagnosis.hypotheses import HYPOTHESES
from tso_cli.diagnosis.verification import closed, verify_hypotheses
from tso_cli.optimisation.presets import PRESETS
from tso_cli.refinement.run import check
from tso_cli.refinement.scene import as_scene

from .common import PLANE, around, boxed, changed, named, paired

CHAIR = example("chair")
MISTAKES = ("mask-flipped", "mask-upside-down", "R-transposed")
FLIPPED = changed(CHAIR.view, "mask-flipped")


def verified(view: View, weak: str = "", points: np.ndarray = CHAIR.points) -> Diagnosis:
    """The diagnosis of a cloud in a view, with a ``weak`` hypothesis unless it finds its own."""
    cloud = Cloud(points, "cloud").controlled(views=[view])
    diagnosis = examine(cloud, [view], [view])
    if weak:
        diagnosis = replace(diagnosis, weak=(Finding(weak, (0,)),))
    assert diagnosis.suspicious == ()
    return verify_hypotheses(diagnosis, cloud.body, [view], ())


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_that_silhouettes_hardly_show_is_confirmed(name):
    assert (name, (0,)) in named(verified(changed(CHAIR.view, name)).suspicious)


@pytest.mark.parametrize("name", MISTAKES)
def test_a_hypothesis_that_is_not_true_is_not_confirmed(name):
    assert verified(CHAIR.view, name).suspicious == ()


@pytest.mark.parametrize("name", MISTAKES)
def test_a_cloud_of_other_proportions_is_no_reason_to_confirm_what_is_not_true(name):
    """It may stretch as given too."""
    stretched = CHAIR.target * [1.25, 0.9, 1.0]
    assert verified(CHAIR.view, name, stretched).suspicious == ()


@pytest.mark.parametrize("what", ["depth", "image"])
def test_a_mistake_is_confirmed_also_with_a_depth_map_and_with_a_photo(what):
    """A mask that is flipped by mistake has other pictures as they were taken."""
    photo = np.zeros((*FLIPPED.mask.shape, 3), np.float32)
    view = replace(FLIPPED, **{what: depth_of(CHAIR) if what == "depth" else photo})
    assert ("mask-flipped", (0,)) in named(verified(view).suspicious)


def test_without_a_hypothesis_there_is_nothing_to_verify():
    cloud = Cloud(PLANE.target, "cloud").controlled(views=[PLANE.view])
    diagnosis = replace(examine(cloud, [PLANE.view], [PLANE.view]), weak=())
    assert verify_hypotheses(diagnosis, cloud.body, [PLANE.view], ()) is diagnosis


def test_a_hypothesis_under_which_the_mask_shows_no_object_is_not_confirmed():
    """The background is known only in thin columns, which the coarse cells cannot resolve."""
    inside = (CHAIR.mask > 0.5).repeat(4, 0).repeat(4, 1)
    far = ~binary_dilation(inside, iterations=24)
    known = inside | (far & (np.indices(inside.shape)[1] % 5 == 0))
    view = View(np.float32(inside), CHAIR.camera.resized(*inside.shape), known)
    assert not verified(view, "mask-inverted").suspicious


# Of what silhouettes show clearly


def test_what_silhouettes_show_clearly_stays_unless_the_contours_contradict_it():
    view = changed(PLANE.view, "mask-upside-down")
    cloud = Cloud(PLANE.points, "cloud").controlled(views=[view])
    diagnosis = examine(cloud, [view], [view])
    (likeliest, *_) = named(diagnosis.suspicious)
    assert likeliest == ("mask-upside-down", (0,))
    assert likeliest in named(verify_hypotheses(diagnosis, cloud.body, [view], ()).suspicious)
    untrue = replace(diagnosis, of_input=(Finding("mask-upside-down", (0,)),), weak=())
    right = verify_hypotheses(untrue, cloud.body, [PLANE.view], ())
    assert right.suspicious == ()


# Of pairs


def _verified_pairs(points: np.ndarray, views: list[View], given=()) -> Diagnosis:
    """What the views find of pairs, verified."""
    meant = [as_meant(view, given) for view in views]
    cloud = Cloud(points, "cloud").controlled(views=meant)
    diagnosis = examine(cloud, views, meant, given)
    assert "mispaired" in [one.name for one in diagnosis.suspicious]
    return verify_hypotheses(diagnosis, cloud.body, views, given)


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
    diagnosis = _verified_pairs(PLANE.points, paired(around(len(order)), order))
    assert named(diagnosis.suspicious) == [("mispaired", views)]


def test_an_exchange_is_verified_with_the_views_that_gain_nothing_by_it():
    """The car looks alike from 0 and 180 degrees, so one of its three masks gains nothing."""
    car = example("car")
    views = [seen(car.target, turned(car.camera, angle)) for angle in (0.0, 90.0, 180.0)]
    diagnosis = _verified_pairs(car.points, paired(views, [1, 2, 0]))
    (finding,) = diagnosis.suspicious
    assert len(finding.pairs) == 2
    assert closed(finding.pairs) == [(0, 1), (1, 2), (2, 0)]


def test_an_exchange_is_verified_under_the_assumptions_about_single_cameras():
    views = paired(around(2), [1, 0])
    given = (Assumption(HYPOTHESES["opengl"], views[0].name),)
    views[0] = as_meant(views[0], given)
    diagnosis = _verified_pairs(PLANE.points, views, given)
    assert named(diagnosis.suspicious) == [("mispaired", (0, 1))]


def _seeming(views: list[View], pairs: tuple[tuple[int, int], ...]) -> list[Finding]:
    """What is found by `explain` if masks seem to be exchanged as ``pairs`` say."""
    numbers = tuple(sorted(camera for _, camera in pairs))
    return [Finding("mispaired", numbers, 0.7, 0.3, pairs=pairs)]


@pytest.mark.parametrize("count", [2, 4, 8])
def test_masks_that_seem_to_be_exchanged_and_are_not_are_paired_rightly(count, monkeypatch):
    views, pairs = around(count), ((1, 0), (0, 1))
    monkeypatch.setattr("tso_cli.diagnosis.explain._mispaired", lambda *_: _seeming(views, pairs))
    diagnosis = _verified_pairs(PLANE.points, views)
    assert diagnosis.suspicious == ()
    assert not diagnosis.outvoted
    result = refine(PLANE.points, views)
    assert result.findings == ()
    assert result.trust.verdict == "fits better"


def test_what_else_is_wrong_is_found_if_masks_are_paired_rightly(monkeypatch):
    views, pairs = around(4), ((1, 0), (2, 1), (0, 2))
    views[3] = boxed(views[3])
    monkeypatch.setattr("tso_cli.diagnosis.explain._mispaired", lambda *_: _seeming(views, pairs))
    diagnosis = _verified_pairs(PLANE.points, views)
    assert named(diagnosis.suspicious) == [("box", (3,))]
    assert diagnosis.outvoted


# In a refinement


@pytest.mark.parametrize("preset", PRESETS)
@pytest.mark.parametrize("name", MISTAKES)
def test_a_refinement_and_a_check_find_the_same_under_any_preset(name, preset):
    view, config = changed(CHAIR.view, name), RefineConfig(preset=preset)
    diagnosis, *_ = check(as_scene(CHAIR.points, view), config.settings(1))
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
