"""A result says how far it can be trusted."""

from dataclasses import replace

import numpy as np
import pytest

from tests.scenes import example, in_photo
from tso_cli import RefineConfig, View, refine, refine_batch
from tso_cli.diagnosis import confidence as verdict
from tso_cli.diagnosis.agreement import Agreement
from tso_cli.diagnosis.confidence import REASONS, _model
from tso_cli.geometry.rotations import from_vectors

EXAMPLES = "chair", "car", "airplane"


def _yawed(view: View, degrees: float) -> View:
    turn = from_vectors(np.radians(degrees) * np.array([0.0, 1.0, 0.0]))
    return replace(view, camera=replace(view.camera, R=view.camera.R @ turn))


@pytest.mark.parametrize("name", EXAMPLES)
def test_right_input_is_trusted(name):
    scene = example(name)
    result = refine(scene.points, scene.view)
    assert (result.verdict, result.reason, result.suspects) == ("improved", "", ())
    assert result.confidence > 0.6
    assert not result.warnings


@pytest.mark.parametrize("name", ["chair", "airplane"])
def test_a_camera_far_off_leaves_less_confidence_though_iou_rises(name):
    scene = example(name)
    right, wrong = (refine(scene.points, view) for view in (scene.view, _yawed(scene.view, 45.0)))
    assert wrong.iou_after > wrong.iou_before
    assert scene.error(wrong.points) > scene.error(scene.points)
    assert wrong.confidence < right.confidence - 0.3
    assert wrong.verdict == "doubtful"
    assert wrong.step_taken == 1.0
    assert wrong.reason in REASONS.values() or "--assume" in wrong.reason
    assert any(wrong.reason in warning for warning in wrong.warnings)


def test_a_step_of_no_confidence_is_not_taken_unless_accepted():
    scene = example("chair")
    view = replace(scene.view, mask=1.0 - scene.mask)
    careful, accepted = (
        refine(scene.points, view),
        refine(scene.points, view, config=RefineConfig(accept_doubtful=True)),
    )
    assert (careful.points == careful.initial).all()
    assert careful.iou_after == careful.iou_before
    assert (careful.stop_reason, careful.best_step, careful.step_taken, careful.moved_max) == (
        "doubtful",
        0,
        0.0,
        0.0,
    )
    assert "so the cloud is left as it was" in careful.warnings[0]
    assert careful.loss_after == careful.loss_before
    assert (accepted.verdict, accepted.confidence) == (careful.verdict, careful.confidence)
    assert accepted.step_taken == 1.0
    assert accepted.moved_mean > 0.01


def test_a_step_of_little_confidence_is_taken_in_part_where_a_mistake_is_suspected(monkeypatch):
    scene = example("chair")
    whole = refine(scene.points, scene.view)
    monkeypatch.setattr(verdict, "_judged", lambda signs: (0.75, "camera"))
    assert refine(scene.points, scene.view).step_taken == 1.0
    monkeypatch.setattr(Agreement, "suspicion", "it looks as if the camera is another")
    part = refine(scene.points, scene.view)
    np.testing.assert_allclose(part.points, 0.5 * (whole.initial + whole.points), atol=1e-12)
    assert part.step_taken == pytest.approx(0.5)
    assert part.verdict == "doubtful"
    assert "only 50 % of the step" in part.warnings[0]
    assert whole.loss_after < part.loss_after < part.loss_before
    assert part.iou_before < part.iou_after < whole.iou_after
    assert part.moved_mean == pytest.approx(0.5 * whole.moved_mean)
    monkeypatch.setattr(verdict, "_judged", lambda signs: (0.6, "camera"))
    assert "so the cloud is left as it was" in refine(scene.points, scene.view).warnings[0]


def test_a_suspected_mistake_is_never_called_an_improvement(monkeypatch):
    scene = example("chair")
    monkeypatch.setattr(Agreement, "suspicion", "it looks as if the camera is another")
    result = refine(scene.points, scene.view)
    assert result.confidence > 0.9
    assert (result.verdict, result.step_taken) == ("doubtful", 1.0)
    assert result.reason == "it looks as if the camera is another"


def test_what_is_shown_as_a_half_is_not_doubtful():
    assert (verdict.shown(0.4999), verdict.shown(0.5), verdict.shown(1.0)) == (
        "0.49",
        "0.50",
        "1.00",
    )


def test_a_result_of_a_depth_map_is_not_judged():
    scene = example("chair")
    depth = np.where(scene.mask > 0.5, np.median(scene.camera.project(scene.target)[1]), np.nan)
    result = refine(scene.points, replace(scene.view, depth=depth))
    assert (result.verdict, result.confidence, result.signs) == (None, None, {})


def test_what_did_not_move_is_unchanged_and_sure():
    scene = example("chair")
    result = refine(scene.points, scene.view, config=RefineConfig(steps=0))
    assert (result.verdict, result.confidence) == ("unchanged", 1.0)


@pytest.mark.parametrize(
    ("config", "why"),
    [
        (RefineConfig(preset="paper", steps=3), "only mode points with preset best is"),
        (RefineConfig(steps=11), "11 steps are too few"),
    ],
)
def test_without_a_confidence_wrong_input_is_doubtful_and_right_input_is_not_judged(config, why):
    scene = example("chair")
    wrong = refine(scene.points, replace(scene.view, mask=1.0 - scene.mask), config=config)
    assert (wrong.verdict, wrong.confidence) == ("doubtful", None)
    assert "mask is inverted" in wrong.reason
    right = refine(scene.points, scene.view, config=config)
    assert (right.verdict, right.confidence, right.reason) == (None, None, why)


def test_suspect_input_is_told_also_where_nothing_moves():
    scene = example("chair")
    result = refine(
        scene.points, replace(scene.view, mask=1.0 - scene.mask), config=RefineConfig(steps=0)
    )
    assert (result.verdict, result.step_taken) == ("doubtful", 0.0)
    assert "mask is inverted" in result.reason
    assert any("--assume mask-inverted" in text for text in result.warnings)


def test_a_batch_judges_as_a_single_cloud_is_judged():
    scene = example("chair")
    (batched,) = refine_batch([(scene.points, scene.view)])
    alone = refine(scene.points, scene.view)
    assert (batched.verdict, batched.confidence) == (
        alone.verdict,
        pytest.approx(alone.confidence, abs=0.02),
    )


def test_an_object_in_a_large_picture_is_judged_as_in_a_small_one():
    scene = example("airplane")
    view = _yawed(scene.view, 20.0)
    K = np.diag([4.0, 4.0, 1.0]) @ view.camera.K + 1.5 * np.outer([1.0, 1.0, 0.0], [0.0, 0.0, 1.0])
    large = View(
        np.kron(view.mask, np.ones((4, 4), np.float32)),
        replace(view.camera, K=K, width=1024, height=1024),
    )
    small, large = (refine(scene.points, each) for each in (view, in_photo(large, 2, 300, 500)))
    assert abs(large.confidence - small.confidence) < 0.05
    assert abs(large.signs["input: pixels"] - small.signs["input: pixels"]) < 0.1


def test_points_of_a_floor_fall_beside_the_mask_and_cost_confidence():
    scene = example("chair")
    low, high = scene.target.min(0), scene.target.max(0)
    floor = np.random.default_rng(0).uniform(low - 0.5, high + 0.5, (1024, 3)) * [1.0, 0.0, 1.0] + [
        0.0,
        low[1],
        0.0,
    ]
    alone, with_floor = (
        refine(points, scene.view)
        for points in (scene.target, np.concatenate([scene.target, floor]))
    )
    assert with_floor.signs["misfit: beside after"] > alone.signs["misfit: beside after"] + 0.1
    assert with_floor.verdict == "doubtful"
    assert with_floor.confidence < alone.confidence - 0.3


def test_the_model_knows_every_sign():
    scene = example("chair")
    names, (mean, deviation, hidden, offset, output) = _model()
    assert names == list(refine(scene.points, scene.view).signs)
    assert {name.split(":")[0] for name in names} == set(REASONS)
    assert hidden.shape == (len(names), len(offset))
    assert len(output) == len(offset) + 1
    assert (deviation > 0.0).all()
    assert len(mean) == len(names)
