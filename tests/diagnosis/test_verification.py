"""A hypothesis that silhouettes hardly show is confirmed where short optimisations agree."""

import time
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import binary_dilation

from tests.scenes import example
from tso_cli import InputError, RefineConfig, View, refine
from tso_cli.cloud.cloud import Cloud
from tso_cli.diagnosis import verification
from tso_cli.diagnosis.examine import Diagnosis, examine
from tso_cli.diagnosis.findings import Finding
from tso_cli.diagnosis.verification import verify_hypotheses
from tso_cli.optimisation.problem import prepare
from tso_cli.refinement.run import check
from tso_cli.refinement.scene import as_scene

from .common import PLANE, around, changed, named, paired

CHAIR = example("chair")
MISTAKES = ("mask-flipped", "mask-upside-down", "R-transposed")
FLIPPED = changed(CHAIR.view, "mask-flipped")


def verified(view: View, weak: str = "", until: float = np.inf, **config) -> Diagnosis:
    """The diagnosis of the chair in a view, with a ``weak`` hypothesis unless it finds its own."""
    settings = RefineConfig(**config).settings(1)
    cloud = Cloud(CHAIR.points, "cloud").controlled(settings.points, [view])
    diagnosis = examine(cloud, [view], [view])
    if weak:
        diagnosis = replace(diagnosis, weak=(Finding(weak, (0,)),))
    assert diagnosis.suspicious == ()
    problem = prepare(cloud, [view], settings)
    return verify_hypotheses(diagnosis, problem, [view], (), settings, until)


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_that_silhouettes_hardly_show_is_confirmed(name):
    assert (name, (0,)) in named(verified(changed(CHAIR.view, name)).suspicious)


@pytest.mark.parametrize("name", MISTAKES)
def test_a_hypothesis_that_is_not_true_is_not_confirmed(name):
    assert verified(CHAIR.view, name).suspicious == ()


def test_without_a_weak_hypothesis_there_is_nothing_to_verify():
    settings = RefineConfig().settings(1)
    cloud = Cloud(PLANE.target, "cloud").controlled(views=[PLANE.view])
    diagnosis = replace(examine(cloud, [PLANE.view], [PLANE.view]), weak=())
    problem = prepare(cloud, [PLANE.view], settings)
    assert verify_hypotheses(diagnosis, problem, [PLANE.view], (), settings) is diagnosis


@pytest.mark.parametrize("config", [{"preset": "paper"}, {"steps": 0}], ids=str)
def test_other_settings_confirm_nothing(config):
    assert verified(FLIPPED).suspicious
    assert not verified(FLIPPED, **config).suspicious


def test_with_a_depth_map_nothing_is_confirmed():
    """A flipped mask has its depth map as it was read, even if that is a single pixel."""
    row, column = np.argwhere((FLIPPED.mask > 0.5) & (CHAIR.mask > 0.5))[0]
    depth = np.full(FLIPPED.mask.shape, np.nan)
    depth[row, column] = np.median(CHAIR.camera.project(CHAIR.target)[1])
    assert not verified(replace(FLIPPED, depth=depth)).suspicious


@pytest.mark.parametrize("seconds", [-1.0, 1e-3])
def test_without_time_nothing_is_confirmed(seconds):
    assert not verified(FLIPPED, until=time.perf_counter() + seconds).suspicious


def test_a_hypothesis_under_which_the_mask_shows_no_object_is_not_confirmed():
    """The background is known only in thin columns, which the coarse cells cannot resolve."""
    inside = (CHAIR.mask > 0.5).repeat(4, 0).repeat(4, 1)
    far = ~binary_dilation(inside, iterations=24)
    known = inside | (far & (np.indices(inside.shape)[1] % 5 == 0))
    view = View(np.float32(inside), CHAIR.camera.resized(*inside.shape), known)
    settings = RefineConfig().settings(1)
    problem = prepare(Cloud(CHAIR.points, "cloud").controlled(), [view], settings)
    with pytest.raises(InputError, match="no cell of its window"):
        problem.with_views([changed(view, "mask-inverted")])
    assert not verified(view, "mask-inverted").suspicious


# Of pairs


def _with_pairs(views: list[View]) -> Diagnosis:
    """The diagnosis of the aeroplane, verified, if masks 0 and 1 seem to be exchanged."""
    settings = RefineConfig().settings(len(views))
    cloud = Cloud(PLANE.points, "cloud").controlled(settings.points, views)
    diagnosis = examine(cloud, views, views)
    pairs = Finding("mispaired", (0, 1), pairs=((1, 0), (0, 1)))
    diagnosis = replace(diagnosis, of_input=(pairs,), of_views=(), most_confidence=0.15)
    return verify_hypotheses(diagnosis, prepare(cloud, views, settings), views, (), settings)


@pytest.mark.parametrize("order", [[1, 0], [1, 0, 2, 3], [1, 0, 2, 3, 4, 5, 6, 7]])
def test_masks_that_are_exchanged_are_confirmed_also_among_many(order):
    diagnosis = _with_pairs(paired(around(len(order)), order))
    assert named(diagnosis.suspicious) == [("mispaired", (0, 1))]
    assert diagnosis.most_confidence == 0.15


@pytest.mark.parametrize("count", [2, 4, 8])
def test_masks_that_seem_to_be_exchanged_and_are_not_are_paired_rightly(count):
    diagnosis = _with_pairs(around(count))
    assert diagnosis.suspicious == ()
    assert diagnosis.most_confidence == 1.0


# In a refinement


@pytest.mark.parametrize("name", MISTAKES)
def test_a_refinement_and_a_check_find_the_same(name):
    view = changed(CHAIR.view, name)
    settings = RefineConfig().settings(1)
    diagnosis, *_ = check(as_scene(CHAIR.points, view), settings)
    assert (name, (0,)) in named(diagnosis.suspicious)
    assert refine(CHAIR.points, view).findings == diagnosis.findings


@pytest.mark.parametrize("budget", [1e-3, 1e-9])
def test_a_refinement_without_time_finds_nothing_more(budget):
    assert refine(CHAIR.points, FLIPPED, config=RefineConfig(budget=budget)).findings == ()


def test_a_refinement_of_right_input_spends_time_on_a_weak_hypothesis_and_finds_nothing():
    result = refine(CHAIR.points, CHAIR.view)
    weak = examine(Cloud(CHAIR.points, "cloud").controlled(), [CHAIR.view], [CHAIR.view]).weak
    assert ("check mistake" in result.cost.seconds) == bool(weak)
    assert result.findings == ()


def test_ctrl_c_during_the_verification_leaves_the_cloud_as_it_was(monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(verification, "final_losses", interrupted)
    result = refine(CHAIR.points, FLIPPED)
    assert result.fit.stop_reason == "interrupted"
    np.testing.assert_array_equal(result.points, result.initial)
