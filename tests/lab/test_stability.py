"""`tso lab stability`: axes alter what they name and no more, knees are where rows change."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tso_cli.diagnosis.assumptions import Assumption, as_meant
from tso_cli.diagnosis.confidence import Trust
from tso_cli.diagnosis.examine import Diagnosis, NoOverlapError
from tso_cli.diagnosis.findings import Finding
from tso_cli.diagnosis.hypotheses import HYPOTHESES
from tso_cli.errors import InputError
from tso_cli.geometry.rotations import angle_between
from tso_cli.lab.stability import study
from tso_cli.lab.stability.axes import AXES
from tso_cli.lab.stability.knees import AXIS, figures, knee
from tso_cli.lab.stability.peers import PEERS
from tso_cli.lab.stability.runs import Outcome, findings_of, level_rows, outcome_of, run_of
from tso_cli.lab.studies.refining import POINTS, Variant
from tso_cli.refinement import RefineConfig, refine

GROSS = [axis for axis in AXES if axis.gross]
# Axes that change the true points too: the cloud is in another frame, or the object is another.
FRAMES = [axis.name for axis in GROSS if axis.group == "cloud"]
OF_ANOTHER_OBJECT = [*FRAMES, "cloud of the other handedness", "thin object", "holed object"]
OF_ANOTHER_OBJECT += ["cameras of Blender, cloud of glTF", "axes of OpenGL, cloud with z up"]
OF_ANOTHER_OBJECT += ["yaw before a thin object", "camera moved aside, thin object"]


@pytest.fixture(scope="module")
def cases():
    return study.example_cases()


def altered(cases, name, level, seed=0):
    return AXIS[name].apply(cases[0], level, np.random.default_rng(seed), cases[1])[0]


def foreground(case):
    return case.views[0].mask > 0.5


def shares_inside(case):
    """Of the true points, and of another shape's: the shares that fall on the mask."""
    mask, camera = foreground(case), case.views[0].camera
    shares = []
    for points in (case.target, case.initial):
        pixels = camera.project(points)[0].round().astype(int)
        seen = ((pixels >= 0) & (pixels < [camera.width, camera.height])).all(1)
        shares.append(mask[tuple(pixels[seen].T[::-1])].mean())
    return shares


# Axes


def test_levels_of_an_axis_go_one_way_and_their_names_are_its_own():
    assert len({axis.name for axis in AXES}) == len(AXES)
    for axis in AXES:
        steps = np.sign(np.diff(axis.levels))
        assert abs(steps.sum()) == len(steps), axis.name
    assert all(len(axis.mistakes) == len(axis.levels) for axis in GROSS)


@pytest.mark.parametrize("axis", GROSS, ids=lambda axis: axis.name)
def test_a_mistake_undone_puts_the_true_points_on_the_mask_again(cases, axis):
    for level in axis.levels:
        case = altered(cases, axis.name, level)
        width = round(level * case.views[0].camera.width)
        names = axis.mistake(level).replace("K-of-width", f"K-of-width={width}")
        right = [Assumption(one) for one in Finding(names).hypotheses]
        mended = as_meant(case.views[0], right)
        assert shares_inside(replace(case, views=(mended,)))[0] > 0.95, level


@pytest.mark.parametrize(
    "axis", [axis for axis in AXES if axis.group != "settings"], ids=lambda axis: axis.name
)
def test_every_level_gives_a_case_or_is_refused_and_leaves_the_given_case_alone(cases, axis):
    def arrays():
        view = cases[0].views[0]
        return [cases[0].initial.copy(), view.mask.copy(), view.camera.R.copy()]

    before = arrays()
    for level in study.fewer_levels(axis):
        try:
            first, again = (altered(cases, axis.name, level, 1) for _ in range(2))
        except InputError:
            continue
        np.testing.assert_array_equal(first.initial, again.initial)
        np.testing.assert_array_equal(first.views[0].mask, again.views[0].mask)
        assert axis.name in OF_ANOTHER_OBJECT or np.array_equal(first.target, cases[0].target)
        if axis.adds_points:
            own = axis.own(cases[0], first.initial)
            np.testing.assert_array_equal(own, cases[0].initial)
            assert len(first.initial) > len(own)
    for now, then in zip(arrays(), before, strict=True):
        np.testing.assert_array_equal(now, then)


def test_settings_change_one_setting():
    default = vars(RefineConfig())
    for axis in AXES:
        if axis.group == "settings" and axis.name != "nothing wrong":
            config = axis.apply(None, axis.levels[0], None)[1]
            changed = {key for key, value in vars(config).items() if value != default[key]}
            assert len(changed - {"preset"}) == 1, axis.name


@pytest.mark.parametrize("name", ["yaw of the camera", "pitch of the camera", "roll of the camera"])
def test_a_turn_of_40_degrees_turns_every_camera_by_40_degrees(cases, name):
    for view, turned in zip(cases[0].views, altered(cases, name, 40.0).views, strict=True):
        assert angle_between(view.camera.R, turned.camera.R) == pytest.approx(40.0)
        np.testing.assert_array_equal(view.camera.t, turned.camera.t)


@pytest.mark.parametrize(
    ("name", "grows"),
    [("mask dilated", 1), ("mask eroded", -1), ("threshold too high, 0.5 is right", -1)],
)
def test_a_mask_grows_or_shrinks_with_the_level(cases, name, grows):
    levels = AXIS[name].levels[:4]
    areas = [int(foreground(altered(cases, name, level)).sum()) for level in levels]
    assert (grows * np.diff(areas) > 0).all()


@pytest.mark.parametrize("name", ["holes in the mask", "mask occluded", "object cut by the border"])
def test_forty_per_cent_are_gone(cases, name):
    left = foreground(altered(cases, name, 40.0)).sum() / foreground(cases[0]).sum()
    assert left == pytest.approx(0.6, abs=0.02)


@pytest.mark.parametrize(
    ("name", "level"),
    [
        ("thin object", 4.0),
        ("object cut by the border", 20.0),
        ("small in the picture", 20.0),
        ("large picture", 512.0),
    ],
)
def test_true_points_still_fall_on_the_mask_of_another_picture_of_the_object(cases, name, level):
    true, other = shares_inside(altered(cases, name, level))
    assert true > 0.93
    assert other < true - 0.1


@pytest.mark.parametrize("name", ["noise", "start far off", "outliers", "few points", *FRAMES])
def test_a_start_that_stays_is_no_worse_and_added_points_do_not_count(cases, name):
    run = run_of(cases, AXIS[name], AXIS[name].levels[:2][-1], 0, 0)
    case, _ = run.altered(RefineConfig())

    def ratio(points):
        return Outcome(run, altered=case, points=points).ratio()

    moved = case.initial.copy()
    moved[len(cases[0].initial) :] += 1.0
    assert ratio(case.initial) == ratio(moved) == 1.0
    assert ratio(np.resize(case.target, case.initial.shape)) < 0.5


def test_a_floor_lies_under_the_object_and_reaches_beyond_it(cases):
    points = cases[0].initial
    floor = altered(cases, "floor under the object", 100.0).initial[len(points) :]
    assert len(floor) == len(points)
    assert (floor[:, 1] == points[:, 1].min()).all()
    width = max(np.ptp(points[:, [0, 2]], axis=0))
    np.testing.assert_allclose(np.ptp(floor[:, [0, 2]], axis=0), 2.0 * width, rtol=0.02)


def test_a_box_covers_the_mask_to_its_edges(cases):
    mask, box = map(foreground, (cases[0], altered(cases, "box in place of the mask", 1.0)))
    assert box[mask].all()
    for axis in (0, 1):
        np.testing.assert_array_equal(box.any(axis), mask.any(axis))


def test_a_camera_with_another_handedness_is_refused_and_so_is_an_empty_mask(cases):
    with pytest.raises(InputError, match="not a rotation"):
        altered(cases, "camera's x mirrored", 1.0)
    with pytest.raises(InputError, match="every pixel is foreground"):
        altered(cases, "mask nearly full", 100.0)


# Knees


def rows(name, ratios, said):
    """Rows of an axis: one run a level."""
    return [
        {"axis": name, "variant": "best", "level": level, **figures(word, [ratio])}
        for level, ratio, word in zip(AXIS[name].levels, ratios, said, strict=False)
    ]


@pytest.mark.parametrize(
    ("ratios", "said", "works", "warns", "fails", "refused"),
    [
        ((0.5, 0.6, 0.9, 1.2, 2.0), "---ww", 5, 10, 10, False),
        ((0.5, 0.6, 1.2, 1.2, None), "----r", 2, 20, 5, False),
        ((0.5, 0.6, 0.7), "w--", 5, None, None, False),
        ((0.5, 1.2, 0.9), "-w-", 1, 2, 2, False),
        ((1.5, None, None), "drr", None, 1, 1, False),
        ((0.5, None), "-r", 1, 2, 2, True),
        ((0.5, None), "-n", 1, None, 2, False),
    ],
)
def test_the_knee(ratios, said, works, warns, fails, refused):
    found = knee(rows("yaw of the camera", ratios, said))
    keys = ("works_to", "speaks_from", "fails_at", "refused")
    assert [found[key] for key in keys] == [works, warns, fails, refused]


def test_figures_separate_harm_with_a_warning_from_harm_without_one():
    found = figures("-w-rn", [0.5, 1.2, 1.3, None, None])
    assert found == dict(median=found["median"], worse=0.6, refused=0.2, spoke=0.4, silent=0.4)


# Runs


def test_what_a_result_says_of_itself_is_kept(cases):
    result = refine(cases[0].initial, cases[0].views[0], config=RefineConfig(steps=1))
    improved, doubtful = Trust("improved", 0.9), Trust("doubtful", 0.4, "motion", "they moved far")
    result = replace(result, trust=improved, findings=())
    opengl, specks = Finding("opengl", (0,), 0.8), Finding("specks", (0,), values={"pixels": 3})
    run = run_of(cases[:1], AXIS["nothing wrong"], 1.0, 0, 0)
    found = {
        "d": [replace(result, trust=doubtful), replace(result, findings=(opengl,))],
        "w": [replace(result, findings=(specks,))],
        "r": [InputError("no object")],
        "-": [result],
    }
    for said, results in found.items():
        assert {outcome_of(run, cases[0], one).said for one in results} == {said}


def test_points_behind_the_camera_are_warned_of_on_the_way(cases):
    two_steps = Variant(RefineConfig(steps=2))
    for name, said in (("start partly behind the camera", "d"), ("start far off", "-")):
        (row,) = level_rows(cases[:1], [0], AXIS[name], "best", two_steps, [5.0])
        assert row["said"] == said


@pytest.mark.slow
def test_a_chair_is_doubtful_under_a_yaw_of_40_degrees_and_gets_better_under_one_of_2(cases):
    axis = AXIS["yaw of the camera"]
    good, bad = level_rows(cases[:1], [0, 1], axis, "best", POINTS["best"], [2.0, 40.0])
    assert max(good["ratio"]) < 0.7
    assert set(good["said"]) == {"-"}
    assert min(bad["ratio"]) >= 1.0
    assert set(bad["said"]) == {"d"}


@pytest.mark.slow
def test_peers_do_what_the_paper_does_near_the_mask_and_stay_where_it_is_far_from_it(cases):
    near = {
        name: level_rows(cases[:1], [0], AXIS["nothing wrong"], name, way, [1.0])[0]["median"]
        for name, way in {"paper": POINTS["paper"], **PEERS}.items()
    }
    assert near["log(tanh + 1e-8)"] == pytest.approx(near["paper"], abs=0.01)
    assert all(0.9 < median < 1.0 for median in near.values())
    far = cases[0].initial + [0.0, 10.0, 0.0]
    for peer in PEERS.values():
        np.testing.assert_allclose(peer(far, cases[0].views[:1]), far, atol=2e-3)


OPENGL = Finding("opengl", (0,))
TAKEN_BACK = Finding("mask-inverted", (0,), without=Assumption(HYPOTHESES["mask-inverted"]))


@pytest.mark.parametrize(
    ("findings", "names"),
    [
        ((OPENGL, Finding("cloud-z-up", (0,))), ("opengl", "cloud-z-up")),
        # An assumption that is taken back names no mistake.
        ((TAKEN_BACK,), ("",)),
        ((Finding("mispaired", (0, 1), pairs=((0, 1), (1, 0))),), ("mispaired",)),
        ((Finding("coarse", (0,)),), ()),
        ((), ()),
    ],
)
def test_findings_of_a_result_and_of_a_refusal(findings, names, chair):
    result = refine(*chair[:3], RefineConfig(steps=0))
    assert findings_of(replace(result, findings=findings)) == names
    refusal = NoOverlapError("mask: no point falls inside")
    refusal.diagnosis = Diagnosis((), of_input=tuple(one for one in findings if one.suspicious))
    assert findings_of(refusal) == names
    assert findings_of(InputError("no object")) == ()
