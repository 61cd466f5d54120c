"""A result says how far it can be trusted."""

from dataclasses import replace

import numpy as np
import pytest

from tests.scenes import about, example, in_photo, seen, turned
from tso_cli import RefineConfig, View, refine, refine_batch
from tso_cli.diagnosis.confidence import (
    FINDING,
    LEAST_CONFIDENCE,
    LEAST_TO_MOVE,
    MOST_IF_CAMERA_COUNTS,
    MOST_IF_UNSURE,
    REASONS,
    WITHOUT_FEATURES,
    Trust,
    _model,
    confidence_of,
    words_of,
)
from tso_cli.diagnosis.examine import Diagnosis, examine
from tso_cli.diagnosis.findings import Finding
from tso_cli.optimisation.learned_start import beginning
from tso_cli.optimisation.optimise import optimise, weigh
from tso_cli.optimisation.problem import prepare
from tso_cli.pose.move import unmoved
from tso_cli.prior import named_prior
from tso_cli.refinement.judge import judge
from tso_cli.refinement.result import RefineResult
from tso_cli.refinement.scene import as_scene

from .common import EXAMPLES, changed, named

CHAIR, AIRPLANE = example("chair"), example("airplane")
FOUR = tuple(
    seen(AIRPLANE.target, turned(AIRPLANE.camera, angle)) for angle in (0.0, 90.0, 180.0, 270.0)
)
INVERTED = changed(CHAIR.view, "mask-inverted")
NOTHING = Diagnosis(())
OPENGL = Diagnosis((), of_input=(Finding("opengl", (0,)),))
BOX = Diagnosis((), of_views=(Finding("box", (0,)),))


def _yawed(view: View, degrees: float) -> View:
    R = view.camera.R @ about("y", degrees)
    return replace(view, camera=replace(view.camera, R=R))


@pytest.fixture(scope="module")
def right() -> RefineResult:
    """The aeroplane, refined from right input."""
    return refine(AIRPLANE.points, AIRPLANE.view)


@pytest.fixture(scope="module")
def wrong() -> RefineResult:
    """The chair, refined with a camera that is 45 degrees off."""
    config = RefineConfig(accept_doubtful=True)
    return refine(CHAIR.points, _yawed(CHAIR.view, 45.0), config=config)


# Of features and a diagnosis


def test_right_features_without_findings_are_an_improvement(right):
    trust = Trust.of(right.trust.features, NOTHING)
    assert trust == right.trust
    assert trust.verdict == "improved"
    assert trust.confidence > 0.9
    assert trust.moves
    assert trust.reason == ""
    assert trust.says == ""


def test_features_of_a_wrong_camera_are_doubtful(wrong):
    trust = Trust.of(wrong.trust.features, NOTHING)
    assert trust.confidence < LEAST_CONFIDENCE
    assert trust.verdict == "doubtful"
    assert trust.reason in REASONS
    assert trust.says == REASONS[trust.reason]


@pytest.mark.parametrize(
    ("confidence", "verdict", "moves"),
    [
        (LEAST_CONFIDENCE, "improved", True),
        (LEAST_CONFIDENCE - 0.01, "doubtful", True),
        (LEAST_TO_MOVE, "doubtful", True),
        (LEAST_TO_MOVE - 0.01, "doubtful", False),
    ],
)
def test_a_doubtful_cloud_moves_unless_it_is_likely_to_get_worse(confidence, verdict, moves, right):
    trust = Trust.of(right.trust.features, replace(NOTHING, most_confidence=confidence))
    assert trust.verdict == verdict
    assert trust.moves is moves


@pytest.mark.parametrize(
    ("diagnosis", "confidence", "taken"),
    [
        (OPENGL, 1.0, False),
        (OPENGL, 0.1, False),
        (BOX, 1.0, False),
        (replace(BOX, outvoted=True), LEAST_TO_MOVE, True),
        (replace(BOX, outvoted=True), LEAST_TO_MOVE - 0.01, False),
    ],
)
def test_a_suspicious_finding_leaves_the_cloud_unless_other_views_outvote_it(
    diagnosis, confidence, taken, right
):
    assert right.trust.confidence > 0.9
    trust = Trust.of(right.trust.features, replace(diagnosis, most_confidence=confidence))
    assert trust.moves is taken
    assert trust.confidence == min(confidence, right.trust.confidence)
    assert trust.verdict == "doubtful"
    assert trust.reason == FINDING
    assert trust.says == words_of(diagnosis)


def test_without_overlap_before_or_after_nothing_is_sure(right):
    trust = right.trust.limited(NOTHING, 0.05, 0.9)
    assert trust.verdict == "doubtful"
    assert trust.confidence == MOST_IF_UNSURE
    assert trust.reason == "overlap"
    assert "IoU 0.05" in trust.says
    assert right.trust.limited(NOTHING, 0.1, 0.9) == right.trust
    assert Trust.unchanged(OPENGL).limited(OPENGL, 0.05, 0.9).reason == FINDING


def test_after_a_move_no_result_is_more_than_just_sure_enough(right, wrong):
    """A wrong camera gives the same picture as a cloud that is out of place."""
    explained = Trust.of(wrong.trust.features, NOTHING, explained=True)
    assert (explained.verdict, explained.confidence) == ("improved", MOST_IF_CAMERA_COUNTS)
    assert Trust.of(right.trust.features, NOTHING, explained=False).confidence == (
        MOST_IF_CAMERA_COUNTS
    )
    alone = Trust.of(wrong.trust.features, NOTHING)
    assert Trust.of(wrong.trust.features, NOTHING, explained=False) == alone


def test_nor_is_one_with_a_camera_that_nobody_gave():
    note = Finding("assumed-camera", (0,))
    for trust in (Trust("improved", 0.97), Trust("unchanged", 1.0)):
        expected = replace(trust, confidence=MOST_IF_CAMERA_COUNTS)
        assert trust.limited(replace(NOTHING, notes=(note,)), 0.6, 0.9) == expected


def test_a_cloud_that_hardly_fits_a_camera_that_nobody_gave_is_doubtful():
    note = replace(NOTHING, notes=(Finding("assumed-camera", (0,)),))
    trust = Trust("improved", 0.97).limited(note, 0.3, 0.9)
    assert (trust.verdict, trust.reason) == ("doubtful", "assumed-camera")
    assert not trust.moves
    assert Trust("improved", 0.97).limited(NOTHING, 0.3, 0.9).verdict == "improved"


def test_where_the_iou_of_a_start_that_fits_falls_a_result_is_doubtful():
    trust = Trust("improved", WITHOUT_FEATURES).limited(NOTHING, 0.9, 0.7)
    assert (trust.verdict, trust.reason) == ("doubtful", "misfit")
    assert trust.confidence == MOST_IF_UNSURE
    other = Trust("improved", WITHOUT_FEATURES)
    assert other.limited(NOTHING, 0.8, 0.7) == other


def test_without_features_a_finding_halves_the_confidence():
    assert Trust.of(None, NOTHING).confidence == WITHOUT_FEATURES
    assert Trust.of(None, OPENGL).confidence == MOST_IF_UNSURE


def test_a_weak_hypothesis_that_is_not_confirmed_changes_nothing(right):
    weak = Diagnosis((), weak=(Finding("mask-flipped", (0,)),))
    assert Trust.of(right.trust.features, weak) == right.trust


@pytest.mark.parametrize(
    ("diagnosis", "verdict", "reason"),
    [(NOTHING, "unchanged", ""), (OPENGL, "doubtful", FINDING), (BOX, "doubtful", FINDING)],
)
def test_a_start_that_is_kept_is_sure_and_doubtful_only_with_a_finding(diagnosis, verdict, reason):
    trust = Trust.unchanged(diagnosis)
    assert trust.verdict == verdict
    assert trust.reason == reason
    assert trust.confidence == (None if reason else 1.0)
    assert not trust.moves


@pytest.mark.parametrize(
    ("diagnosis", "expected"),
    [
        (NOTHING, Trust(None, None, "steps", "6 steps are too few")),
        (OPENGL, Trust("doubtful", None, FINDING, words_of(OPENGL), False)),
    ],
)
def test_without_a_confidence_there_is_no_verdict_except_with_a_finding(diagnosis, expected):
    assert Trust.unknown("steps", "6 steps are too few", diagnosis) == expected


def unsure(diagnosis: Diagnosis, name: str = "unsure-camera") -> Diagnosis:
    """The diagnosis of an input whose camera was fitted, and is unsure."""
    note = Finding(name, (0,), values={"why": "two poses fit"})
    return replace(diagnosis, notes=(note,))


def test_a_sure_camera_costs_no_confidence():
    trust = Trust("improved", 0.97)
    assert trust.limited(NOTHING, 0.6, 0.9) == trust


@pytest.mark.parametrize("confidence", [0.97, 0.3, None])
def test_an_unsure_camera_makes_any_result_doubtful(confidence):
    trust = Trust("improved", confidence).limited(unsure(NOTHING), 0.6, 0.9)
    assert trust.verdict == "doubtful"
    assert trust.reason == "unsure-camera"
    assert trust.says == "the fitted camera is unsure: two poses fit"
    expected = None if confidence is None else min(confidence, MOST_IF_UNSURE)
    assert trust.confidence == expected


def test_so_does_an_unsure_place_of_the_cloud():
    trust = Trust("improved", 0.9).limited(unsure(NOTHING, "unsure-place"), 0.6, 0.9)
    assert (trust.verdict, trust.confidence) == ("doubtful", MOST_IF_UNSURE)
    assert trust.says == "the place of the cloud is unsure: two poses fit"


def test_a_finding_is_the_reason_also_with_an_unsure_camera():
    trust = Trust.unchanged(OPENGL).limited(unsure(OPENGL), 0.6, 0.9)
    assert trust.reason == FINDING
    assert trust.says == words_of(OPENGL)
    assert trust.confidence is None


@pytest.mark.parametrize(
    ("about", "findings", "joined"),
    [
        ("of_input", [Finding("opengl", (0,))], "{0}"),
        ("of_input", [Finding("opengl", (0,)), Finding("pytorch3d", (0,))], "{0} or {1}"),
        ("of_views", [Finding("box", (0,)), Finding("mispaired", (1, 2))], "{0}; {1}"),
    ],
)
def test_alternatives_are_joined_by_or_and_findings_of_views_are_listed(about, findings, joined):
    diagnosis = Diagnosis((), **{about: tuple(findings)})
    says = joined.format(*(finding.says for finding in findings))
    assert words_of(diagnosis) == f"it looks as if {says}"


def test_the_model_knows_every_feature(right):
    _, terms = _model()
    assert set(terms) == set(right.trust.features)
    assert len(terms) == 7
    assert {name.split(":")[0] for name in terms} == {*REASONS, "input"}
    assert all(deviation > 0.0 for _, deviation, _ in terms.values())


def test_without_an_answer_of_the_learned_prior_its_sureness_counts_as_average(right):
    _, terms = _model()
    alone = refine(AIRPLANE.points, AIRPLANE.view, config=RefineConfig(prior="none"))
    assert set(terms) - set(alone.trust.features) == {"prior: sureness"}
    average = {"prior: sureness": terms["prior: sureness"][0]}
    assert alone.trust.confidence == confidence_of(alone.trust.features | average)[0]
    assert alone.trust.verdict == "improved"


def test_the_reason_is_the_group_without_which_the_confidence_would_be_highest(wrong):
    _, terms = _model()
    features = wrong.trust.features
    _, group = confidence_of(features)
    average = {name: mean for name, (mean, *_) in terms.items()}
    without = {
        one: confidence_of({k: average[k] if k.startswith(one) else v for k, v in features.items()})
        for one in REASONS
    }
    assert without[group][0] == max(confidence for confidence, _ in without.values())


def test_the_order_of_the_views_does_not_matter():
    views = [changed(view, "mask-inverted") if i == 1 else view for i, view in enumerate(FOUR)]
    config = RefineConfig(accept_doubtful=True, symmetry="none")
    found = [
        refine(AIRPLANE.points, [views[i] for i in order], config=config).trust
        for order in ([0, 1, 2, 3], [1, 2, 3, 0], [3, 2, 0, 1])
    ]
    for trust in found[1:]:
        assert trust.confidence == pytest.approx(found[0].confidence, abs=0.02)


# Of refinements


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_result_of_right_input_is_trusted(name):
    scene = example(name)
    result = refine(scene.points, scene.view)
    assert result.trust.verdict == "improved"
    assert result.trust.reason == ""
    assert result.trust.confidence >= LEAST_CONFIDENCE
    assert result.findings == ()


@pytest.mark.parametrize(("name", "least"), [("chair", 0.2), ("airplane", 0.05)])
def test_a_camera_far_off_leaves_less_confidence_though_iou_rises(name, least):
    scene = example(name)
    config = RefineConfig(accept_doubtful=True)
    views = scene.view, _yawed(scene.view, 45.0)
    right, wrong = (refine(scene.points, view, config=config) for view in views)
    assert wrong.fit.iou_after > wrong.fit.iou_before
    assert scene.error(wrong.points) > scene.error(scene.points)
    assert wrong.trust.confidence < right.trust.confidence - least
    assert wrong.fit.outcome == "moved"


def test_a_displacement_of_no_confidence_is_not_taken_unless_accepted():
    careful, accepted = (
        refine(CHAIR.points, INVERTED, config=RefineConfig(accept_doubtful=accept))
        for accept in (False, True)
    )
    assert (careful.points == careful.initial).all()
    assert careful.fit.outcome == "refused"
    assert careful.fit.stop_reason == "doubtful"
    assert careful.fit.best_step == 0
    assert careful.fit.moved_max == 0.0
    assert careful.fit.iou_after == careful.fit.iou_before
    assert careful.fit.loss_after == careful.fit.loss_before
    assert not careful.trust.moves
    assert (accepted.trust.verdict, accepted.trust.says) == ("doubtful", careful.trust.says)
    assert accepted.fit.outcome == "moved"
    assert accepted.fit.moved_mean > 0.01


def _judged(diagnosis: Diagnosis, inlier_weight: float = 1.0) -> RefineResult:
    """The aeroplane's result from right input, if its input had this ``diagnosis``."""
    settings = RefineConfig().settings(1)
    scene = as_scene(AIRPLANE.points, AIRPLANE.view)
    cloud = scene.cloud.controlled(settings.points, scene.views)
    found = examine(cloud, scene.read, scene.views)
    diagnosis = replace(diagnosis, explanation=found.explanation)
    weighed = weigh(prepare(cloud, scene.views, settings), settings)
    prior = named_prior(settings.prior)
    begin = beginning(weighed.problem, weighed.weights.loss, prior)
    optimised = optimise(weighed, settings, settings.steps, begin=begin)
    still = unmoved(scene.views)
    weights = replace(weighed.weights, inlier=[inlier_weight])
    weighed = replace(weighed, weights=weights)
    return judge(weighed, optimised, scene.views, still, diagnosis, settings, seconds={})


def test_a_result_of_suspicious_input_is_never_called_an_improvement():
    for inlier_weight, taken in ((0.3, True), (0.6, False)):
        result = _judged(replace(BOX, outvoted=True), inlier_weight)
        assert result.trust.verdict == "doubtful"
        assert result.trust.moves is taken
        assert result.trust.reason == FINDING


def test_a_finding_costs_confidence_by_itself():
    with_finding, without = (_judged(diagnosis).trust for diagnosis in (BOX, NOTHING))
    assert without.confidence > 0.9
    assert 1.0 - with_finding.confidence > 3.0 * (1.0 - without.confidence)


def test_a_confirmed_weak_hypothesis_leaves_the_cloud_as_any_named_mistake_does():
    result = refine(CHAIR.points, changed(CHAIR.view, "mask-flipped"))
    assert named(result.findings) == [("mask-flipped", (0,))]
    assert result.trust.verdict == "doubtful"
    assert np.array_equal(result.points, CHAIR.points)


def test_a_result_of_a_depth_map_has_the_features_of_any_displacement():
    middle = np.median(AIRPLANE.camera.project(AIRPLANE.target)[1])
    depth = np.where(AIRPLANE.mask > 0.5, middle, np.nan)
    trust = refine(AIRPLANE.points, replace(AIRPLANE.view, depth=depth, depth_kind="z")).trust
    _, terms = _model()
    assert set(trust.features) == set(terms)
    assert trust.confidence == confidence_of(trust.features)[0]


def test_a_result_of_the_papers_preset_has_the_confidence_of_its_kind():
    paper = RefineConfig(preset="paper")
    assert refine(CHAIR.points, CHAIR.view, config=paper).trust.confidence == WITHOUT_FEATURES
    wrong = refine(CHAIR.points, INVERTED, config=paper)
    assert wrong.trust.verdict == "doubtful"
    assert (wrong.points == wrong.initial).all()


def test_wrong_input_is_doubtful():
    wrong = refine(CHAIR.points, INVERTED).trust
    assert wrong.verdict == "doubtful"
    assert "the mask is inverted" in wrong.says


def test_a_result_of_few_points_has_no_confidence():
    trust = refine(CHAIR.target[::103], CHAIR.view, config=RefineConfig(symmetry="none")).trust
    assert trust == Trust(None, None, "points", "10 points are too few")


def test_what_did_not_move_is_unchanged_and_sure():
    trust = refine(CHAIR.points, CHAIR.view, config=RefineConfig(steps=0)).trust
    assert trust == Trust("unchanged", 1.0, moves=False)


def test_suspicious_input_is_found_also_where_nothing_moves():
    result = refine(CHAIR.points, INVERTED, config=RefineConfig(steps=0))
    assert result.trust.verdict == "doubtful"
    assert not result.trust.moves
    assert ("mask-inverted", (0,)) in named(result.findings)


def test_a_batch_has_the_confidence_of_a_single_cloud(right):
    (batched,) = refine_batch([(AIRPLANE.points, AIRPLANE.view)])
    assert batched.trust.verdict == right.trust.verdict
    assert batched.trust.confidence == pytest.approx(right.trust.confidence, abs=0.02)


def test_an_object_in_a_large_picture_has_the_confidence_of_one_in_a_small_picture():
    scene = example("airplane")
    view = _yawed(scene.view, 20.0)
    K = np.diag([4.0, 4.0, 1.0]) @ view.camera.K + 1.5 * np.outer([1.0, 1.0, 0.0], [0.0, 0.0, 1.0])
    mask = np.kron(view.mask, np.ones((4, 4), np.float32))
    large = View(mask, replace(view.camera, K=K, width=1024, height=1024))
    small, large = (
        refine(scene.points, each).trust for each in (view, in_photo(large, 2, 300, 500))
    )
    assert abs(large.confidence - small.confidence) < 0.05
    assert abs(large.features["misfit: contours"] - small.features["misfit: contours"]) < 0.1


def test_points_of_a_floor_cost_confidence():
    low, high = AIRPLANE.target.min(0), AIRPLANE.target.max(0)
    floor = np.random.default_rng(0).uniform(low - 0.5, high + 0.5, (1024, 3))
    floor[:, 1] = low[1]
    alone, with_floor = (
        refine(points, AIRPLANE.view).trust
        for points in (AIRPLANE.points, np.concatenate([AIRPLANE.points, floor]))
    )
    assert alone.verdict == "improved"
    assert with_floor.verdict == "doubtful"
    assert with_floor.confidence < alone.confidence - 0.2
