"""`tso bench stability`: axes alter what they name and no more, knees are where rows change, and the record says it."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from tso_cli.diagnosis.hypotheses import ASSUMPTIONS, Suspect
from tso_cli.errors import InputError
from tso_cli.geometry.rotations import angle_between
from tso_cli.lab.stability import runs, study
from tso_cli.lab.stability.axes import AXES
from tso_cli.lab.stability.knees import AXIS, FIGURES, figures, knee
from tso_cli.lab.stability.peers import PEERS
from tso_cli.lab.stability.runs import Outcome, judge, outcomes_of, run_of
from tso_cli.lab.studies.refining import POINTS, Variant
from tso_cli.refinement import RefineConfig, refine

# Axes that change the true points too: the cloud is in another frame, or the object is another.
FRAMES = [axis.name for axis in AXES if axis.group == "cloud" and axis.gross]
THIN = ["thin object", "yaw before a thin object", "camera moved aside, thin object"]
OF_ANOTHER_OBJECT = [*FRAMES, "cloud of the other handedness", *THIN, "holed object"]


@pytest.fixture(scope="module")
def cases():
    return study.example_cases()


def altered(cases, name, level, seed=0):
    return AXIS[name].apply(cases[0], level, np.random.default_rng(seed), cases[1])[0]


def shares_inside(case):
    """Of the true points, and of another shape's: those that fall on the mask."""
    mask, camera = case.views[0].mask > 0.5, case.views[0].camera
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
    assert all(len(axis.mistakes) == len(axis.levels) for axis in AXES if axis.gross)


@pytest.mark.parametrize("axis", [axis for axis in AXES if axis.gross], ids=lambda axis: axis.name)
def test_a_mistake_undone_puts_the_true_points_on_the_mask_again(cases, axis):
    for level in axis.levels:
        case = altered(cases, axis.name, level)
        mended = ASSUMPTIONS[axis.mistake(level)].read(case.views[0])
        assert shares_inside(replace(case, views=(mended,)))[0] > 0.95, level


@pytest.mark.parametrize(
    "axis", [axis for axis in AXES if axis.group != "settings"], ids=lambda axis: axis.name
)
def test_every_level_gives_a_case_or_is_refused_and_leaves_the_given_case_alone(cases, axis):
    before = (
        cases[0].initial.copy(),
        cases[0].views[0].mask.copy(),
        cases[0].views[0].camera.R.copy(),
    )
    for level in study.fewer_levels(axis):
        try:
            first, again = (
                AXIS[axis.name].apply(cases[0], level, np.random.default_rng(1), cases[1])[0]
                for _ in range(2)
            )
        except InputError:
            continue
        np.testing.assert_array_equal(first.initial, again.initial)
        np.testing.assert_array_equal(first.views[0].mask, again.views[0].mask)
        assert axis.name in OF_ANOTHER_OBJECT or np.array_equal(first.target, cases[0].target)
        own = axis.own(cases[0], first.initial)
        assert not axis.adds_points or (
            np.array_equal(own, cases[0].initial) and len(first.initial) > len(own)
        )
    for now, then in zip(
        (cases[0].initial, cases[0].views[0].mask, cases[0].views[0].camera.R), before, strict=True
    ):
        np.testing.assert_array_equal(now, then)


def test_settings_change_one_setting():
    for axis in AXES:
        if axis.group == "settings" and axis.name != "nothing wrong":
            config = axis.apply(None, axis.levels[0], None)[1]
            changed = {
                key for key, value in vars(config).items() if value != vars(RefineConfig())[key]
            }
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
    areas = [
        int((altered(cases, name, level).views[0].mask > 0.5).sum())
        for level in AXIS[name].levels[:4]
    ]
    assert (grows * np.diff(areas) > 0).all()


@pytest.mark.parametrize(
    ("name", "share"),
    [("holes in the mask", 0.4), ("mask occluded", 0.4), ("object cut by the border", 0.4)],
)
def test_forty_per_cent_are_gone(cases, name, share):
    whole, left = (
        int((case.views[0].mask > 0.5).sum())
        for case in (cases[0], altered(cases, name, 100.0 * share))
    )
    assert left / whole == pytest.approx(1.0 - share, abs=0.02)


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
def test_a_start_that_is_left_as_it_was_given_is_no_worse_and_added_points_do_not_count(
    cases, name
):
    run = run_of(cases, AXIS[name], AXIS[name].levels[:2][-1], 0, 0)
    case, _ = run.altered(RefineConfig())
    assert Outcome(run, altered=case, points=case.initial).ratio() == 1.0
    truth = np.resize(case.target, case.initial.shape)
    assert Outcome(run, altered=case, points=truth).ratio() < 0.5
    moved = case.initial.copy()
    moved[len(cases[0].initial) :] += 1.0
    assert Outcome(run, altered=case, points=moved).ratio() == 1.0


def test_a_floor_lies_under_the_object_and_reaches_beyond_it(cases):
    object_points = cases[0].initial
    floor = altered(cases, "floor under the object", 100.0).initial[len(object_points) :]
    assert len(floor) == len(object_points)
    assert (floor[:, 1] == object_points[:, 1].min()).all()
    width = max(np.ptp(object_points[:, [0, 2]], axis=0))
    np.testing.assert_allclose(np.ptp(floor[:, [0, 2]], axis=0), 2.0 * width, rtol=0.02)


def test_a_box_covers_the_mask_to_its_edges(cases):
    mask, box = (
        view.mask > 0.5
        for view in (cases[0].views[0], altered(cases, "box in place of the mask", 1.0).views[0])
    )
    assert box[mask].all()
    for axis in (0, 1):
        np.testing.assert_array_equal(box.any(axis), mask.any(axis))


def test_a_camera_with_another_handedness_is_refused_and_so_is_an_empty_mask(cases):
    with pytest.raises(InputError, match="not a rotation"):
        altered(cases, "camera's x mirrored", 1.0)
    with pytest.raises(InputError, match="every pixel is foreground"):
        altered(cases, "mask nearly full", 100.0)


# Knees


def rows(name, *ratios, said=None):
    """Rows of an axis: one run a level."""
    said = said or "-" * len(ratios)
    levels = AXIS[name].levels[: len(ratios)]
    return [
        {"axis": name, "variant": "best", "level": level, **figures(word, [ratio], [0.1])}
        for level, ratio, word in zip(levels, ratios, said, strict=True)
    ]


@pytest.mark.parametrize(
    ("ratios", "said", "words"),
    [
        ((0.5, 0.6, 0.9, 1.2, 2.0), "---ww", "works to 5 degrees, warns from 10, fails at 10"),
        ((0.5, 0.6, 1.2, 1.2, None), "----r", "works to 2 degrees, warns from 20, fails at 5"),
        ((0.5, 0.6, 0.7), "w--", "works throughout, never warns"),
        ((0.5, 1.2, 0.9), "-w-", "works to 1 degrees, warns from 2, fails at 2"),
        ((1.5, None, None), "drr", "does not work at 1 degrees, warns from 1, fails at 1"),
        ((0.5, None), "-r", "works to 1 degrees, warns from 2, is refused at 2"),
        ((0.5, None), "-n", "works to 1 degrees, never warns, fails at 2"),
    ],
)
def test_the_knee_in_words(ratios, said, words):
    assert knee(rows("yaw of the camera", *ratios, said=said))["words"] == words


@pytest.mark.parametrize(
    ("ratio", "said", "words"), [(2.0, "-", "fails, without a word"), (None, "r", "is refused")]
)
def test_a_mistake_is_made_or_not(ratio, said, words):
    assert knee(rows("mask inverted", ratio, said=said))["words"] == words


def test_figures_tell_harm_without_a_word_from_harm_with_one():
    found = figures("-w-rn", [0.5, 1.2, 1.3, None, None], [0.1, 0.2, 0.3, None, None])
    shares = dict(worse=0.6, non_finite=0.2, refused=0.2, spoke=0.4, silent=0.4)
    assert found == {"median": 1.2, "p95": None, "worst": None, **shares, "seconds": 0.2} | {
        "median": found["median"]
    }
    assert set(found) == set(FIGURES)


# Runs


def test_what_a_result_says_of_itself_is_kept(cases, monkeypatch):
    result = refine(cases[0].initial, cases[0].views[0], config=RefineConfig(steps=1))
    doubtful = replace(result, verdict="doubtful", confidence=0.25)
    suspect = replace(
        result,
        verdict="improved",
        suspects=(Suspect("the camera is another", "--assume opengl", 0.8),),
    )
    warned, refused = replace(result, warnings=("read this",)), InputError("no object")
    monkeypatch.setattr(
        runs, "refine_batch", lambda scenes, config: [doubtful, suspect, warned, refused, result]
    )
    found = list(
        outcomes_of([run_of(cases[:1], AXIS["nothing wrong"], 1.0, 0, 0)] * 5, POINTS["best"])
    )
    assert "".join(outcome.said for outcome in found) == "ddwr-"
    assert [outcome.result for outcome in found] == [doubtful, suspect, warned, None, result]


def test_points_behind_the_camera_are_warned_of_on_the_way(cases):
    for name, said in (("start partly behind the camera", "d"), ("start far off", "-")):
        (row,) = judge(cases[:1], [0], AXIS[name], "best", Variant(RefineConfig(steps=2)), [5.0])
        assert row["said"] == said


@pytest.mark.slow
def test_a_yaw_of_40_degrees_makes_the_chair_worse_and_one_of_2_does_not(cases):
    good, bad = judge(
        cases[:1], [0, 1], AXIS["yaw of the camera"], "best", POINTS["best"], [2.0, 40.0]
    )
    assert max(good["ratio"]) < 0.7
    assert min(bad["ratio"]) > 1.05


@pytest.mark.slow
def test_the_plain_cross_entropy_does_what_the_paper_does_near_the_mask_and_stays_where_it_is_far_from_it(
    cases,
):
    ways = {"paper": POINTS["paper"], **PEERS}
    near = {
        name: judge(cases[:1], [0], AXIS["nothing wrong"], name, way, [1.0])[0]
        for name, way in ways.items()
    }
    assert near["log(tanh + 1e-8)"]["median"] == pytest.approx(near["paper"]["median"], abs=0.01)
    assert all(0.9 < row["median"] < 1.0 for row in near.values())
    far = replace(cases[0], initial=cases[0].initial + [0.0, 10.0, 0.0])
    for peer in PEERS.values():
        np.testing.assert_allclose(peer(far.initial, far.views[:1]), far.initial, atol=2e-3)


# The command


@pytest.mark.slow
def test_the_command_writes_record_chart_page_and_pictures_and_goes_on_where_it_was(
    tso, tmp_path, monkeypatch
):
    names = ("mask inverted", "yaw of the camera", "start far off")
    monkeypatch.setattr(study, "AXES", tuple(AXIS[name] for name in names))
    monkeypatch.setattr(study, "COMPARED", ("mask inverted",))
    monkeypatch.setattr("tso_cli.lab.studies.fingerprint.today", lambda part: {"IoU": 1.0})
    output, pictures = tmp_path / "stability.json", tmp_path / "stability.pictures.png"
    arguments = ("bench", "stability", "--quick", "-o", output, "--pictures", pictures)
    assert "works to" in tso(*arguments).out
    record = json.loads(output.read_text())
    assert record["complete"]
    assert record["command"].startswith("tso bench stability --quick")
    assert set(record["knees"]["best"]) == set(names)
    assert {row["variant"] for row in record["cases"] if row["axis"] == "mask inverted"} >= {
        "paper",
        "best",
        *PEERS,
    }
    assert all(len(row["ratio"]) == len(row["said"]) == 3 for row in record["cases"])
    for suffix in (".png", ".md", ".pictures.png"):
        assert output.with_suffix(suffix).stat().st_size > 1000
    monkeypatch.setattr(study, "judge", None)
    assert tso(*arguments, "--resume").code == 0
    assert json.loads(output.read_text())["cases"] == record["cases"]


def test_without_meshes_only_the_quick_run_is_there(tso):
    assert "--meshes is missing" in tso("bench", "stability").refusal
