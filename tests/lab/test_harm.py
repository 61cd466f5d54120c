"""`tso lab harm`: each trouble changes what it says, and runs are called what they are."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.ndimage import label
from scipy.spatial import cKDTree

from tso_cli.errors import InputError
from tso_cli.evaluation.metrics import chamfer
from tso_cli.geometry.points import longest_side
from tso_cli.geometry.rotations import angle_between
from tso_cli.refinement import RefineConfig
from tso_lab.harm import study as runs
from tso_lab.harm.scenes import SIDES, gallery, unseen_shapes, warped
from tso_lab.harm.study import (
    GAINED,
    KEPT,
    SAID,
    SILENT,
    STUDY,
    WITHHELD,
    altered,
    became,
    conclude,
    figures,
    plan,
    scenes_of,
)
from tso_lab.harm.troubles import FLOOR_SHARES, TROUBLE, TROUBLES
from tso_lab.study import Progress

from .studying import MESHES, rng, timeless

ADD = ("arm", "stand", "shadow", "second object", "grown")
ALL_VIEWS = ("grown", "shrunk")
EXAMPLES = dict(meshes=None, split=None, part="validation", unseen=None, seed=0)
QUICK = dict(EXAMPLES, quick=True, per=1, variants=False)


@pytest.fixture(scope="module")
def shown():
    return gallery(**EXAMPLES)


@pytest.fixture(scope="module")
def scene(shown):
    """An exact start of a chair, seen four times."""
    number = next(i for i in range(3) if shown.shape(i).category == "chair")
    return shown.scene(number, "exact", 4)


def in_trouble(scene, name, strength=1, seed=0):
    return TROUBLE[name].apply(scene, strength, np.random.default_rng(seed))


def masks(scene):
    return [view.inside for view in scene.views]


def depths(scene):
    """Of the foreground pixels of the first view."""
    return scene.views[0].depth[scene.views[0].inside]


# Scenes


def test_a_scene_shows_the_whole_object_and_its_starts_are_the_truth_and_another_shape(shown):
    for number in range(3):
        exact, other = (shown.scene(number, start, 4) for start in ("exact", "other"))
        floor, off = (chamfer(each.initial, exact.dense).chamfer for each in (exact, other))
        assert longest_side(exact.dense) == pytest.approx(1.0, abs=0.02)
        assert off > 2.0 * floor
        for view in exact.views:
            assert view.camera.width in SIDES
            assert not view.truncated
            assert min(shape for shape in view.mask.shape) == view.camera.width


def test_a_warped_object_keeps_its_mirror_plane():
    half = rng().uniform(-0.5, 0.5, (500, 3)) * [1.0, 0.3, 0.6]
    for sides in (np.array([-1.0, 1.0, 1.0]), np.array([1.0, 1.0, -1.0])):
        points = np.concatenate([half, half * sides])
        bent = warped(points, rng())
        np.testing.assert_allclose(bent[500:], bent[:500] * sides, atol=1e-9)
        assert np.abs(bent - points).max() > 0.02


def test_every_trouble_meets_other_shapes_and_both_numbers_of_views(shown):
    names = [name for name, _ in scenes_of(shown, TROUBLE["yaw"], "exact", 6)]
    assert [name["views"] for name in names] == [1, 4, 1, 4, 1, 4]
    assert [name["strength"] for name in names] == [0, 1, 2, 0, 1, 2]
    assert len({name["shape"] for name in names}) == 3
    assert not list(scenes_of(shown, TROUBLE["mirrored"], "other", 6))


def test_a_scene_is_the_same_each_time(shown):
    pair = [altered(gallery(**EXAMPLES), TROUBLE["arm"], "other", 0, 1)[1] for _ in range(2)]
    np.testing.assert_array_equal(*(each.views[0].mask for each in pair))
    np.testing.assert_array_equal(*(each.initial for each in pair))


def test_unseen_shapes_are_those_of_the_table(tmp_path):
    (tmp_path / "index.csv").write_text("file,name,category\ncup/mug.ply,mug,cup\n")
    (shape,) = unseen_shapes(tmp_path)
    assert (shape.category, shape.path) == ("cup", tmp_path / "cup" / "mug.ply")
    (tmp_path / "index.csv").write_text("name\nmug\n")
    with pytest.raises(InputError, match="columns file and category"):
        unseen_shapes(tmp_path)


# Troubles


@pytest.mark.parametrize("trouble", TROUBLES, ids=lambda trouble: trouble.name)
@pytest.mark.parametrize("strength", [0, 2])
def test_a_trouble_changes_what_its_group_says_and_no_more(scene, trouble, strength):
    changed = in_trouble(scene, trouble.name, strength)
    assert changed.dense is scene.dense
    assert (changed.initial is not scene.initial) == (trouble.group == "cloud")
    pairs = list(zip(scene.views, changed.views, strict=True))
    if trouble.name != "portrait":
        same = [np.array_equal(before.mask, after.mask) for before, after in pairs]
        wrong = 0 if trouble.group != "mask" else 4 if trouble.name in ALL_VIEWS else 1
        assert same == [False] * wrong + [True] * (4 - wrong)
    moved = [before.camera is not after.camera for before, after in pairs]
    wrong = 0 if trouble.group != "camera" else 1 if trouble.name == "other camera" else 4
    assert sum(moved) == wrong
    assert all((after.depth is not None) == (trouble.group == "depth") for _, after in pairs)


@pytest.mark.parametrize("name", [*ADD, "bite", "shrunk"])
def test_a_wrong_mask_only_adds_or_only_takes_and_the_more_the_stronger(scene, name):
    before, areas = masks(scene)[0], []
    for strength in range(3):
        after = masks(in_trouble(scene, name, strength))[0]
        assert (after[before].all()) if name in ADD else (before[after].all())
        areas.append(abs(int(after.sum()) - int(before.sum())))
    assert areas == sorted(areas)


def test_what_is_added_to_a_mask_touches_the_object(scene):
    for name in ("arm", "stand", "shadow", "second object"):
        parts = label(masks(in_trouble(scene, name))[0], np.ones((3, 3)))[1]
        assert parts == label(masks(scene)[0], np.ones((3, 3)))[1], name


def test_an_arm_reaches_the_border_and_a_stand_lies_below(scene):
    assert in_trouble(scene, "arm").views[0].truncated
    before, after = (np.nonzero(masks(each)[0])[0] for each in (scene, in_trouble(scene, "stand")))
    assert after.min() == before.min()
    assert after.max() > before.max()


def test_a_bite_takes_its_share_and_masks_grow_and_shrink_by_a_pixel_at_least(scene):
    left = masks(in_trouble(scene, "bite", 2))[0].sum() / masks(scene)[0].sum()
    assert left == pytest.approx(0.7, abs=0.03)
    camera = replace(scene.views[0].camera, width=49, height=49)
    small = replace(scene.views[0], mask=np.pad(np.ones((9, 9)), 20), camera=camera)
    for name, side in (("grown", 11), ("shrunk", 7)):
        mask = masks(in_trouble(replace(scene, views=(small,)), name, 0))[0]
        assert mask.any(0).sum() == mask.any(1).sum() == side


def test_cameras_turn_by_the_degrees_that_are_said(scene):
    for name, degrees in (("yaw", 6.0), ("rolled", 5.0)):
        for before, after in zip(scene.views, in_trouble(scene, name).views, strict=True):
            turned = angle_between(before.camera.R, after.camera.R)
            assert turned == pytest.approx(degrees)


def test_focal_lengths_are_wrong_by_their_factor(scene):
    before, both, down = (
        each.views[0].camera.K
        for each in (scene, in_trouble(scene, "focal"), in_trouble(scene, "squashed"))
    )
    assert both[0, 0] / before[0, 0] == both[1, 1] / before[1, 1]
    assert both[0, 0] / before[0, 0] in (pytest.approx(0.85), pytest.approx(1.0 / 0.85))
    assert down[0, 0] == before[0, 0]
    assert down[1, 1] / before[1, 1] in (pytest.approx(1.1), pytest.approx(1.0 / 1.1))


def test_of_an_upright_picture_the_principal_point_is_exchanged(scene):
    side, camera = scene.views[0].camera.width, in_trouble(scene, "portrait").views[0].camera
    assert camera.width / camera.height == pytest.approx(0.75, abs=0.01)
    assert camera.K[0, 2] == pytest.approx((camera.height - 1) / 2.0, abs=0.6)
    assert camera.K[1, 2] == (side - 1) / 2.0


def test_under_the_wrong_crop_the_cloud_still_meets_its_masks(scene):
    for strength in range(3):
        for view in in_trouble(scene, "crop", strength).views:
            pixels = view.camera.project(scene.initial)[0].round().astype(int)
            seen = ((pixels >= 0) & (pixels < view.camera.width)).all(1)
            assert view.inside[tuple(pixels[seen].T[::-1])].any()


def test_the_second_view_has_the_camera_of_the_third(scene):
    changed = in_trouble(scene, "other camera")
    assert changed.views[1].camera is scene.views[2].camera


def test_right_depth_lies_on_the_surface_and_wrong_depth_is_off_as_far_as_said(scene):
    right = in_trouble(scene, "depth right").views[0]
    rows, columns = np.nonzero(np.isfinite(right.depth) & right.inside)
    at = np.stack([columns, rows, np.ones_like(rows)], 1) @ np.linalg.inv(right.camera.K).T
    points = (at * right.depth[rows, columns][:, None] - right.camera.t) @ right.camera.R
    assert np.quantile(cKDTree(scene.dense).query(points)[0], 0.95) < 0.02
    exact = depths(in_trouble(scene, "depth right"))
    np.testing.assert_allclose(depths(in_trouble(scene, "depth far")), 1.1 * exact)
    assert np.nanstd(depths(in_trouble(scene, "depth noise")) - exact) == pytest.approx(0.03, 0.1)
    relief = depths(in_trouble(scene, "depth relief"))
    assert np.nanstd(relief) / np.nanstd(exact) == pytest.approx(1.6)


@pytest.mark.parametrize("name", ["floor", "floaters"])
def test_added_points_follow_those_of_the_object_and_are_as_many_as_said(scene, name):
    own = len(scene.initial)
    for strength, level in enumerate(TROUBLE[name].levels):
        points = in_trouble(scene, name, strength).initial
        np.testing.assert_array_equal(points[:own], scene.initial)
        share = FLOOR_SHARES[level] if name == "floor" else level / 100.0
        assert 1.0 - own / len(points) == pytest.approx(share, abs=0.001)


def test_clouds_are_as_far_off_as_said(scene):
    size = longest_side(scene.initial)
    assert longest_side(in_trouble(scene, "too large").initial) == pytest.approx(1.1 * size)
    moved = in_trouble(scene, "out of place").initial
    centred = [points - points.mean(0) for points in (moved, scene.initial)]
    u, _, vt = np.linalg.svd(centred[0].T @ centred[1])
    assert angle_between(u @ vt, np.eye(3)) == pytest.approx(6.0)
    twice = in_trouble(in_trouble(scene, "backwards"), "backwards").initial
    np.testing.assert_allclose(twice, scene.initial)


# Runs


@pytest.mark.parametrize(
    ("ratio", "verdict", "withheld", "expected"),
    [
        (1.2, "fits better", None, SILENT),
        (1.2, None, None, SILENT),
        (1.2, "doubtful", None, SAID),
        (0.8, "fits better", None, GAINED),
        (0.8, "doubtful", None, GAINED),
        (1.0, "doubtful", 0.8, WITHHELD),
        (1.0, "doubtful", 1.3, KEPT),
        (1.04, "fits better", None, KEPT),
    ],
)
def test_what_a_run_became(ratio, verdict, withheld, expected):
    row = {"ratio": ratio, "verdict": verdict, "suspicious": False}
    row |= {} if withheld is None else {"withheld_ratio": withheld}
    assert became(row) == expected
    if expected == SILENT:
        assert became({**row, "suspicious": True}) == SAID


def test_only_the_object_counts_and_what_is_refused_is_said(scene, monkeypatch):
    with_floor = in_trouble(scene, "floor")
    moved = with_floor.initial.copy()
    moved[scene.own :] += 1.0
    assert runs.distance(moved, with_floor) == runs.distance(scene.initial, scene)
    away = replace(scene, initial=scene.initial + [9.0, 0.0, 0.0])
    row = runs.run_row(away, RefineConfig())
    assert (row["ratio"], row["outcome"], row["became"]) == (None, "error", SAID)
    assert runs.run_row(InputError("no pixel"), RefineConfig())["message"] == "no pixel"


def test_what_was_withheld_is_what_accepting_would_have_given(scene, monkeypatch):
    def refine(points, views, config):
        outcome, reason = ("moved", "max_steps") if config.accept_doubtful else ("left", "doubtful")
        fit = SimpleNamespace(outcome=outcome, stop_reason=reason, iou_before=0.5, iou_after=0.5)
        trust = SimpleNamespace(verdict="doubtful", confidence=0.3)
        result = scene.initial if config.accept_doubtful else points
        move = SimpleNamespace(kind="nothing")
        return SimpleNamespace(points=result, fit=fit, trust=trust, move=move, findings=())

    monkeypatch.setattr(runs, "refine", refine)
    row = runs.run_row(in_trouble(scene, "too large"), RefineConfig())
    assert (row["ratio"], row["moved"], row["became"]) == (1.0, 0.0, WITHHELD)
    assert row["withheld_ratio"] < 0.5


def test_figures_are_shares_of_all_runs_and_means_of_those_that_ended():
    rows = [dict(ratio=1.5, became=SILENT), dict(ratio=0.5, became=GAINED)]
    row = figures([*rows, *[dict(ratio=None, became=SAID)] * 2])
    expected = dict(runs=4, ratio=1.0, worst=1.5, silent=25.0, said=50.0, withheld=0.0, gained=25.0)
    assert row == expected


# The study


def test_the_study_asks_for_meshes_and_for_troubles_that_exist():
    with pytest.raises(InputError, match="--meshes is missing"):
        plan(Progress(), **{**QUICK, "quick": False}, names=())
    with pytest.raises(InputError, match="--trouble is 'rain', expected some of nothing wrong"):
        plan(Progress(), **QUICK, names=("rain",))


def test_the_papers_preset_is_not_asked_about_depth_maps():
    jobs = plan(Progress(), **{**QUICK, "variants": True}, names=("yaw", "depth far")).jobs
    variants = [shared["variant"] for shared, _ in jobs if shared["start"] == "exact"]
    assert variants == ["default", "shape", "paper", "default", "shape"]


def test_a_quick_study_goes_on_from_what_it_kept_and_is_drawn(tmp_path):
    kept = []
    options = dict(QUICK, names=("nothing wrong", "floor"))
    record = STUDY.run(Progress(keep=kept.append), **options)
    places = [(case["trouble"], case["start"]) for case in record["cases"]]
    names = ("nothing wrong", "floor")
    assert places == [(name, start) for name in names for start in ("exact", "other")]
    resumed = STUDY.run(Progress(earlier=kept[2]), **options)
    assert timeless(resumed) == timeless(record)
    assert record["summary"]["default"]["all"]["exact"]["runs"] == 2
    assert list(record["strengths"]) == ["floor"]
    assert conclude(record["cases"])["summary"] == record["summary"]
    text = "\n".join(table.text() for table in STUDY.tables(record))
    assert "1.5 times" in text
    STUDY.draw(tmp_path / "harm.png", record, False)
    assert (tmp_path / "harm.png").stat().st_size > 1000


@pytest.mark.slow
def test_starts_of_listed_shapes_are_other_shapes_of_their_category(split):
    mixed = gallery(MESHES, split, "validation", None, 0)
    names = {mixed.shape(i).name for i in range(len(mixed.shapes))}
    assert names == set(mixed.listed)
    scene = mixed.scene(0, "other", 1)
    assert chamfer(scene.initial, scene.dense).chamfer > 5e-4
