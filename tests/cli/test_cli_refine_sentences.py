"""Findings and results as sentences, with the options that mend what they report."""

from dataclasses import replace

import pytest

from tests.scenes import example
from tso_cli import RefineConfig, RefineResult, refine
from tso_cli.cloud.cloud import Cloud
from tso_cli.commands.refine.sentences import (
    ADVICE_OF_CAMERA,
    LOOK,
    OPTIONS_OF_NOTES,
    Words,
    two_places,
    why_unmoved,
)
from tso_cli.diagnosis.assumptions import INVERTED, Assumption
from tso_cli.diagnosis.confidence import REASONS
from tso_cli.diagnosis.examine import AXES_ADVICE, Diagnosis, NoOverlapError
from tso_cli.diagnosis.findings import NOTES, Finding
from tso_cli.diagnosis.hypotheses import HYPOTHESES
from tso_cli.diagnosis.trust import FINDING, Trust

ONE, TWO = Words(["a.png"]), Words(["a.png", "b.png"])
SIX = Words([f"{number}.png" for number in range(6)])
EXCHANGED = Finding("mispaired", (0, 1), 0.7, 0.3, pairs=((1, 0), (0, 1)))


def wrong(name: str, view: str = "") -> Assumption:
    return Assumption(HYPOTHESES[name], view)


# What may be wrong, and what mends it


@pytest.mark.parametrize("name", HYPOTHESES)
def test_a_hypothesis_about_the_whole_input_is_tried_by_its_name(name):
    says = HYPOTHESES[name].says
    sentence = f"it looks as if {says}: try --assume {name}"
    if name.startswith("cloud-") and HYPOTHESES[name].turns:
        sentence += ", or --move pose"
    assert ONE.suspicion([Finding(name, (0,), 0.7)]) == sentence
    assert TWO.suspicion([Finding(name, (0, 1), 0.7)]) == sentence
    suspect = {"what": says, "option": f"--assume {name}", "score": 0.7}
    assert ONE.suspects([Finding(name, (0,), 0.7)]) == [suspect]


@pytest.mark.parametrize(
    ("words", "finding", "what", "option"),
    [
        (
            TWO,
            Finding("opengl", (1,)),
            "for b.png alone the camera's axes are OpenGL's (y up, z backward)",
            "--assume opengl@b.png",
        ),
        (
            SIX,
            Finding("opengl", (1, 4)),
            "for 1.png, 4.png alone the camera's axes are OpenGL's (y up, z backward)",
            "--assume opengl@1.png --assume opengl@4.png",
        ),
        (
            ONE,
            Finding("cloud-z-up", (0,), without=wrong("cloud-z-up")),
            "--assume cloud-z-up is wrong",
            "without --assume cloud-z-up",
        ),
        (
            ONE,
            Finding("mask-inverted", (0,), without=INVERTED),
            "--assume mask-inverted is wrong",
            "without --assume mask-inverted",
        ),
        (
            Words(["a.png"], inverted=True),
            Finding("mask-inverted", (0,), without=INVERTED),
            "--invert-mask is wrong",
            "without --invert-mask",
        ),
        (
            TWO,
            Finding("mask-inverted", (1,), without=INVERTED),
            "for b.png alone --assume mask-inverted is wrong",
            "without --assume mask-inverted for b.png",
        ),
        (
            TWO,
            Finding("mask-inverted", (0, 1), without=wrong("mask-inverted", "b.png")),
            "--assume mask-inverted@b.png is wrong",
            "without --assume mask-inverted@b.png",
        ),
        (
            TWO,
            Finding("box", (1,)),
            "the mask is the bounding box of the object in b.png",
            "a mask of its outline",
        ),
        (
            TWO,
            Finding("opengl+cloud-z-up", (0, 1)),
            f"{HYPOTHESES['opengl'].says} and {HYPOTHESES['cloud-z-up'].says}",
            "--assume opengl --assume cloud-z-up",
        ),
    ],
)
def test_what_may_be_wrong_and_what_mends_it(words, finding, what, option):
    assert words.suspects([finding]) == [{"what": what, "option": option, "score": 0.0}]
    assert words.suspicion([finding]) == f"it looks as if {what}: try {option}"


@pytest.mark.parametrize(
    ("words", "name", "values", "option"),
    [
        (ONE, "focal-length", {}, "--camera fit if the camera was guessed, or "),
        (TWO, "focal-length", {}, "another focal length in the camera file if the camera was "),
        (ONE, "outline", {"pixels": 2.24}, "--mask-error 2.2 if the mask is wrong, or "),
        (ONE, "depth-apart", {"times": 1.25}, "--depth-scale 0.8 if the maps are wrong, or "),
    ],
)
def test_each_way_to_read_a_symptom_has_its_option(words, name, values, option):
    of_all = {"percent": 5.0, "how": "long", "otherwise": "smaller", "other": "near", "share": 9.0}
    finding = Finding(name, tuple(range(len(words.names))), values={**of_all, **values})
    assert words.suspects([finding])[0]["option"].startswith(option)


def test_alternatives_are_one_sentence():
    findings = [Finding(name, (0, 1)) for name in ("opengl", "pytorch3d", "camera-to-world")]
    assert TWO.suspicion(findings) == (
        f"it looks as if {HYPOTHESES['opengl'].says}: try --assume opengl, or --assume pytorch3d, "
        "or --assume camera-to-world"
    )


def test_findings_of_views_are_a_sentence_each():
    findings = [Finding("box", (0,)), Finding("mask-inverted", (1,))]
    assert TWO.suspicion(findings) == (
        "it looks as if the mask is the bounding box of the object in a.png: try a mask of its "
        "outline; it looks as if for b.png alone the mask is inverted: try --assume "
        "mask-inverted@b.png"
    )


def test_without_findings_nothing_is_suspicious():
    assert ONE.suspicion([]) == ""


def test_wrong_pairs_are_named_by_their_masks():
    assert SIX.suspicion([EXCHANGED]) == (
        "it looks as if masks and cameras are paired wrongly: try 1.png with the camera that 0.png "
        "has now, 0.png with the camera that 1.png has now"
    )


def test_where_all_views_are_paired_wrongly_the_cloud_may_be_turned():
    what = TWO.suspects([EXCHANGED])[0]["what"]
    assert what == "masks and cameras are paired wrongly, or the cloud is turned"


def test_three_pairs_are_named_and_the_rest_is_counted():
    pairs = tuple((camera + 1, camera) for camera in range(5))
    (suspect,) = SIX.suspects([Finding("mispaired", (0, 1, 2, 3, 4), pairs=pairs)])
    option = suspect["option"]
    assert option.count("with the camera that") == 3
    assert option.endswith(", and so on, 5 in all")


def test_views_of_one_name_are_numbered():
    option = Words(["mask", "mask"]).suspects([EXCHANGED])[0]["option"]
    assert option == (
        "view 2 with the camera that view 1 has now, view 1 with the camera that view 2 has now"
    )


# Notes


@pytest.mark.parametrize("name", NOTES)
def test_a_note_names_its_view_and_the_option_that_mends_it(name):
    numbers = dict.fromkeys(("pixels", "side", "behind", "points", "weight", "times", "share"), 3.0)
    numbers |= dict.fromkeys(("distance", "size", "count", "rank", "covered", "relief"), 3.0)
    numbers |= dict.fromkeys(("off", "of_ray", "scale", "shift", "places", "deviation"), 3.0)
    words = dict.fromkeys(("why", "kind", "what", "how"), "a face is degenerate")
    finding = Finding(name, (1,), values={**numbers, **words})
    option = OPTIONS_OF_NOTES.get(name, "")
    if name == "depth-unit":
        option = ": try --depth-scale 0.33, or --depth-kind affine"
    assert TWO.note(finding) == f"b.png: {finding.says}{option}"
    assert TWO.note(replace(finding, views=())) == f"{finding.says}{option}"


@pytest.mark.parametrize(
    ("given", "times", "scale"),
    [(1.0, 993.0, "0.001"), (0.1, 9.1, "0.01"), (1.0, 5020.0, "0.0002, or"), (1.0, 0.1, "10")],
)
def test_a_depth_map_is_named_by_its_file_and_its_scale_is_rounded(given, times, scale):
    words = Words(["a.png", "b.png"], depths=["near.npy", "far.npy"], depth_scale=given)
    note = words.note(Finding("depth-unit", (1,), values={"times": times}))
    assert note.startswith("far.npy: ")
    assert f": try --depth-scale {scale}" in note


def test_notes_leave_out_what_is_said_of_suspicious_findings():
    notes = [Finding("outliers", values={"count": 3}), Finding("unsure-camera", (0,), values={})]
    notes[1] = replace(notes[1], values={"why": "two poses fit"})
    assert ONE.notes([Finding("box", (0,)), *notes]) == [
        "points far from the rest stay where they are, and no measure counts them (found 3)",
        "a.png: the fitted camera is unsure: two poses fit (give --fov or --focal, or a cloud of "
        "the right shape, and look at --overlay)",
    ]


# Errors


@pytest.mark.parametrize(
    ("of_input", "advice"),
    [
        (
            (Finding("camera-to-world", (0,)),),
            "it looks as if R and t are camera-to-world: try --assume camera-to-world",
        ),
        ((), f"{AXES_ADVICE}; {LOOK}"),
    ],
)
def test_cloud_and_mask_that_do_not_meet_come_with_advice(of_input, advice):
    cloud = Cloud(example("chair").points, "cloud").controlled()
    diagnosis = Diagnosis((), of_input, apart="a.png: no point falls inside")
    error = ONE.no_overlap(NoOverlapError(diagnosis, cloud))
    assert str(error) == f"a.png: no point falls inside; {advice}"
    assert "--check" in LOOK


# Results


@pytest.fixture(scope="module")
def moved() -> RefineResult:
    """The chair after a few steps."""
    scene = example("chair")
    return refine(scene.points, scene.view, config=RefineConfig(steps=6, symmetry="none"))


def changed(result: RefineResult, *, fit=None, **fields) -> RefineResult:
    """The result with other ``fields``, and with other fields of its ``fit``."""
    return replace(result, fit=replace(result.fit, **(fit or {})), **fields)


def kept(result: RefineResult, stop_reason: str) -> RefineResult:
    fit = {"stop_reason": stop_reason, "outcome": "left", "best_step": 0, "moved_max": 0.0}
    return changed(result, fit=fit, trust=Trust("left", None, moves=False))


@pytest.mark.parametrize(
    ("stop_reason", "why"),
    [
        ("max_steps", "no steps of the shape were asked for"),
        ("interrupted", "interrupted at step 6, before one lowered the loss"),
        ("non_finite", "the loss was not a number after step 6, and no loss before was lower"),
        ("not_improved", "nothing that was tried agrees better with what the mask shows"),
    ],
)
def test_why_nothing_moved(moved, stop_reason, why):
    result = kept(moved, stop_reason)
    assert why_unmoved(moved) is None
    assert why_unmoved(result).startswith(why)
    (warning,) = ONE.warnings(result)
    assert warning == f"nothing moved: {why_unmoved(result)}; the cloud is as it was"


def test_a_displacement_that_is_left_can_be_accepted(moved):
    result = kept(moved, "doubtful")
    assert why_unmoved(result) == (
        "the displacement is doubtful (--accept-doubtful takes it all the same)"
    )


@pytest.mark.parametrize(
    ("fit", "trust", "warning"),
    [
        (
            {"stop_reason": "interrupted"},
            Trust("fits better", 0.9),
            "interrupted at step 6 of 6: the result is the best so far",
        ),
        (
            {"stop_reason": "non_finite"},
            Trust("fits better", 0.9),
            "the loss was not a number after step 6: the result is the best before that",
        ),
        (
            {"moved_max": 9e-4},
            Trust("fits better", 0.9),
            "hardly anything moved: no point by more than 0.1 % of the object's size",
        ),
        (
            {},
            Trust("doubtful", 0.43, "motion", REASONS["motion"]),
            f"the result is doubtful (confidence 0.43), and the points moved: {REASONS['motion']}",
        ),
        (
            {},
            Trust("doubtful", 0.43, "camera", REASONS["camera"]),
            "the result is doubtful (confidence 0.43), and the points moved: "
            f"{REASONS['camera']}{ADVICE_OF_CAMERA}",
        ),
        (
            {},
            Trust("doubtful", None, "unsure-camera", "two poses fit"),
            "the result is doubtful, and the points moved: two poses fit",
        ),
        ({}, Trust("fits better", 0.9), None),
    ],
)
def test_the_warning_of_a_result(moved, fit, trust, warning):
    result = changed(moved, fit={"stop_reason": "max_steps", **fit}, trust=trust)
    assert ONE.warnings(result) == ([warning] if warning else [])


@pytest.mark.parametrize(
    ("fit", "taken"),
    [
        ({}, ", and the points moved"),
        ({"outcome": "left", "stop_reason": "doubtful"}, ", so the cloud is left as it was"),
    ],
)
def test_a_suspicious_finding_is_the_reason_and_its_option_is_named(moved, fit, taken):
    finding = Finding("opengl", (0,))
    trust = Trust("doubtful", None, FINDING, "in Python's words")
    result = changed(moved, fit=fit, trust=trust, findings=(finding,))
    assert ONE.reason(result) == ONE.suspicion([finding])
    assert ONE.warnings(result) == [f"the result is doubtful{taken}: {ONE.suspicion([finding])}"]


def test_notes_follow_the_warnings_of_a_result(moved):
    notes = (Finding("specks", (0,), values={"pixels": 3}), Finding("contradicted", (0,)))
    notes = (notes[0], replace(notes[1], values={"weight": 0.25}))
    assert ONE.warnings(changed(moved, trust=Trust("fits better", 0.9), findings=notes)) == [
        "a.png: foreground far from the object is left out (3 px)",
        "a.png: the other views contradict it, so it counts for little (inlier weight 0.25 of 1); "
        "is its mask or camera wrong?",
    ]


def test_an_unsure_camera_is_said_once(moved):
    camera = Finding("unsure-camera", (0,), values={"why": "two poses fit"})
    trust = Trust("doubtful", None, camera.name, camera.says, moves=False)
    (warning,) = ONE.warnings(changed(moved, trust=trust, findings=(camera,)))
    assert warning.endswith("the fitted camera is unsure: two poses fit")


@pytest.mark.parametrize(
    ("confidence", "text"), [(0.7999, "0.79"), (0.8, "0.80"), (0.999, "0.99"), (1.0, "1.00")]
)
def test_a_confidence_is_rounded_down_so_that_a_printed_limit_is_not_doubtful(confidence, text):
    assert two_places(confidence) == text


def test_every_reason_of_the_model_has_words(moved):
    for group, says in REASONS.items():
        result = changed(moved, trust=Trust("doubtful", 0.3, group, says))
        hint = ADVICE_OF_CAMERA if group == "camera" else ""
        assert ONE.reason(result) == says + hint


def test_a_right_result_has_no_reason(moved):
    assert ONE.reason(changed(moved, trust=Trust("fits better", 0.9))) == ""
