"""The examination of the input: what it finds, whether others outvote it, and what it refuses."""

import pickle
from dataclasses import replace

import numpy as np
import pytest

from tests.corruption import assert_one_line
from tests.scenes import block, example, seen, turned
from tso_cli import Camera, RefineConfig, View, refine
from tso_cli.cloud.cloud import Cloud
from tso_cli.diagnosis.examine import NoOverlapError, examine
from tso_cli.diagnosis.findings import Finding

from .common import EXAMPLES, PLANE, around, boxed, changed, examined, named, paired
from .mistakes import mistaken


@pytest.mark.parametrize("name", EXAMPLES)
def test_right_input_has_no_findings(name):
    scene = example(name)
    diagnosis = examined(scene.points, [scene.view])
    assert diagnosis.findings == ()
    assert not diagnosis.outvoted


# Suspicious findings


@pytest.mark.parametrize(
    ("views", "outvoted", "suspicious"),
    [
        (around(4), False, []),
        ([boxed(PLANE.view)], False, [("box", (0,))]),
        ([boxed(around()[0]), *around()[1:]], True, [("box", (0,))]),
        ([boxed(around()[0]), around()[1]], False, [("box", (0,))]),
        (
            [*map(boxed, around()[:3]), around()[3]],
            False,
            [("box", (0,)), ("box", (1,)), ("box", (2,))],
        ),
        (paired(around(4), [1, 2, 3, 0]), False, None),
        (paired(around(8), [1, 0, 2, 3, 4, 5, 6, 7]), True, [("mispaired", (0, 1))]),
    ],
    ids=[
        "right",
        "box",
        "one box of four",
        "one box of two",
        "three boxes of four",
        "pairs",
        "a pair of eight",
    ],
)
def test_what_is_wrong_with_few_views_the_others_outvote(views, outvoted, suspicious):
    diagnosis = examined(PLANE.points, views)
    assert diagnosis.outvoted == outvoted
    if suspicious is not None:
        assert named(diagnosis.suspicious) == suspicious


def test_findings_of_the_whole_input_come_before_those_of_views():
    views = [boxed(changed(view, "opengl")) for view in around(3)[:1]]
    views += [changed(view, "opengl") for view in around(3)[1:]]
    diagnosis = examined(PLANE.points, views)
    assert named(diagnosis.suspicious) == [("opengl", (0, 1, 2))]
    assert diagnosis.of_views == ()


def test_what_is_wrong_with_all_masks_but_a_box_is_about_all_views():
    chair = example("chair")
    views = [seen(chair.target, turned(chair.camera, 90.0 * i)) for i in range(4)]
    wrong = [changed(view, "mask-turned") for view in (boxed(views[0]), *views[1:])]
    assert ("mask-turned", (0, 1, 2, 3)) in named(examined(chair.target, wrong).of_input)


def test_a_box_is_found_beside_a_mask_that_lacks_a_part_of_the_object():
    views = around(3)
    rows = np.flatnonzero(views[2].inside.any(1))
    hidden = views[2].mask.copy()
    hidden[int(np.quantile(rows, 0.6)) :] = 0.0
    diagnosis = examined(PLANE.target, [boxed(views[0]), views[1], replace(views[2], mask=hidden)])
    assert ("box", (0,)) in named(diagnosis.suspicious)


@pytest.mark.parametrize("name", EXAMPLES)
def test_no_cloud_follows_a_box_in_place_of_its_mask(name):
    scene = example(name)
    result = refine(scene.points, boxed(scene.view))
    assert named(result.findings) == [("box", (0,))]
    assert result.trust.verdict == "doubtful"
    assert not result.trust.moves
    assert np.array_equal(result.points, scene.points)


def test_a_box_among_masks_hides_no_mistake_of_the_others():
    """The contours of the other masks are compared, so that these do not outvote the box."""
    chair = example("chair")
    cameras = [turned(chair.camera, 90.0 * i) for i in range(4)]
    views = [seen(chair.target, camera) for camera in cameras]
    wrong = [changed(view, "pix3d") for view in (boxed(views[0]), *views[1:])]
    result = refine(chair.points, wrong)
    assert "pix3d" in [one.name for one in result.findings]
    assert np.array_equal(result.points, chair.points)


def test_with_one_box_among_masks_the_cloud_follows_the_others():
    scene = example("car")
    others = [seen(scene.target, turned(scene.camera, angle)) for angle in (90.0, 180.0)]
    result = refine(scene.points, [boxed(scene.view), *others])
    assert ("box", (0,)) in named(result.findings)
    assert result.trust.moves


def test_with_a_pair_among_many_views_the_cloud_follows_the_others():
    result = refine(PLANE.points, paired(around(8), [0, 1, 2, 3, 4, 5, 7, 6]))
    assert ("mispaired", (6, 7)) in named(result.findings)
    assert result.trust.verdict == "doubtful"
    assert result.trust.moves
    assert PLANE.error(result.points) < 0.9 * PLANE.error(PLANE.points)


# Notes


def test_notes_name_what_is_worth_reading(cloud):
    mask = block(np.s_[20:44, 20:44])
    mask[62, 60:63] = 1.0
    camera = Camera.canonical(64, 64)
    # Fewer points far away would be outliers.
    clump = np.random.default_rng(0).normal([0.0, 0.0, 3.0], 0.01, (300, 3))
    view = View(mask, camera)
    diagnosis = examined(np.vstack([cloud, clump]), [view])
    expected = ["specks", "behind"]
    assert named(diagnosis.notes) == [(name, (0,)) for name in expected]
    assert not any(note.suspicious for note in diagnosis.notes)


def test_outliers_are_noted_with_their_number(cloud):
    far = np.random.default_rng(0).normal([30.0, 30.0, 0.0], 0.01, (3, 3))
    view = View(block(np.s_[20:44, 20:44]), Camera.canonical(64, 64))
    (note,) = examined(np.vstack([cloud, far]), [view]).notes
    assert note == Finding("outliers", values={"count": 3})


def test_faces_that_are_no_mesh_are_noted(cloud):
    view = View(block(np.s_[20:44, 20:44]), Camera.canonical(64, 64))
    degenerate = Cloud(cloud, "cloud", faces=[[0, 0, 0]]).controlled()
    (note,) = examine(degenerate, [view], [view]).notes
    assert note.name == "not-a-mesh"
    assert note.says.endswith("so the vertices are taken for a cloud")


def test_what_the_reader_found_comes_first_and_is_noted_once():
    mask = PLANE.mask.copy()
    mask[:3, :3] = 1.0
    view = replace(PLANE.view, mask=mask)
    known = (Finding("specks", (0,), values={"pixels": 4}), Finding("unsure-camera", (0,)))
    diagnosis = examined(PLANE.points, [view])
    assert diagnosis.notes == (Finding("specks", (0,), values={"pixels": 9}),)
    assert diagnosis.after(known).notes == known


def test_in_the_network_modes_only_symptoms_of_the_mask_are_looked_for():
    inverted = changed(PLANE.view, "mask-inverted")
    assert examined(PLANE.points, [inverted]).suspicious
    cloud = Cloud(PLANE.points, "cloud").controlled(views=[inverted])
    assert examine(cloud, [inverted], [inverted], hypotheses=False).findings == ()


def test_points_behind_the_camera_are_a_finding_of_the_result(cloud):
    view = View(block(np.s_[20:44, 20:44]), Camera.canonical(64, 64))
    clump = np.random.default_rng(0).normal([0.0, 0.0, 3.0], 0.01, (300, 3))
    result = refine(np.vstack([cloud, clump]), view, config=RefineConfig(steps=0))
    (finding,) = [one for one in result.findings if one.name == "behind"]
    assert finding.says == "300 of 800 points lie behind the camera and take no part"


# Cloud and mask that do not meet


def _refused(points: np.ndarray, view: View) -> NoOverlapError:
    with pytest.raises(NoOverlapError) as caught:
        refine(points, view)
    assert_one_line(str(caught.value))
    assert str(caught.value).startswith(caught.value.diagnosis.apart)
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)
    return caught.value


@pytest.mark.parametrize(
    ("move", "words"),
    [
        ((0.0, 0.0, 5.0), "mask.png: all 500 points lie behind the camera"),
        ((9.0, 0.0, 0.0), "mask.png: no point falls inside the 64x64 image"),
    ],
)
def test_a_cloud_that_misses_the_mask_is_refused_with_general_advice(cloud, move, words):
    view = View(block(np.s_[4:12, 4:12]), Camera.canonical(64, 64), name="mask.png")
    error = _refused(cloud * 0.2 + move, view)
    assert error.diagnosis.apart == words
    assert "OpenCV: x right, y down, z forward" in str(error)
    assert "--" not in str(error)


def test_a_cloud_that_misses_the_mask_by_a_known_mistake_is_refused_with_the_finding():
    error = _refused(PLANE.points, changed(PLANE.view, "camera-to-world"))
    assert [finding.name for finding in error.diagnosis.suspicious] == ["camera-to-world"]
    assert str(error).endswith("; it looks as if R and t are camera-to-world")


# Assumptions from Python


@pytest.mark.parametrize("name", ["opengl", "mask-inverted", "cloud-z-up"])
def test_a_refinement_under_the_right_assumption_is_that_of_right_input(name):
    config = RefineConfig(steps=12, symmetry="none")
    right = refine(PLANE.target, PLANE.view, config=config)
    points, view = mistaken(name)
    result = refine(points, view, config=config, assume=(name,))
    assert result.findings == ()
    assert result.fit.iou_after == pytest.approx(right.fit.iou_after, abs=0.01)
    assert result.fit.loss_after == pytest.approx(right.fit.loss_after, rel=0.05)


def test_an_assumption_may_name_one_view_of_several():
    views = around(3)
    wrong = [*views[:2], changed(views[2], "mask-inverted")]
    result = refine(PLANE.points, wrong, assume=("mask-inverted@2.png",))
    right = refine(PLANE.points, views)
    np.testing.assert_array_equal(result.points, right.points)
