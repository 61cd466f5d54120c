"""What `tso refine` says of input that looks wrong, and of results that are likely worse."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.scenes import EXAMPLES
from tso_cli.diagnosis.hypotheses import ASSUMPTIONS
from tso_cli.io.cameras import CameraRecord, read_camera, write_cameras
from tso_cli.io.clouds import read_cloud, write_cloud
from tso_cli.io.images import read_mask

POINTS = ("initial.ply", "mask.png")
CONTRACT = {"confidence", "verdict", "reason", "warnings", "suspects"}


@pytest.fixture
def inverted(folder):
    """The chair's mask, dark on white."""
    Image.fromarray(255 - np.asarray(Image.open("mask.png").convert("L"))).save("mask.png")


@pytest.fixture
def to_world(folder):
    """The chair's camera, given as a pose."""
    camera = read_camera("camera.json", 256, 256)
    pose = replace(camera, R=camera.R.T, t=camera.position)
    write_cameras(Path("camera.json"), [CameraRecord(pose)], overwrite=True)


def test_the_json_of_a_result_and_of_a_check_hold_the_same_judgement(folder, refine):
    result, check = (
        refine(*POINTS, "--json").document,
        refine(*POINTS, "--check", "--json").document,
    )
    assert set(result) >= CONTRACT
    assert set(check) >= CONTRACT
    assert (result["verdict"], result["reason"], result["suspects"]) == ("improved", "", [])
    assert 0.5 < result["confidence"] <= 1.0
    assert (check["verdict"], check["confidence"], check["suspects"]) == (None, None, [])


@pytest.mark.parametrize(
    "options", [(), ("--preset", "paper"), ("--points", "256"), ("--steps", "0")]
)
def test_a_check_hints_at_what_a_refinement_with_the_same_options_does(folder, refine, options):
    Image.fromarray(np.asarray(Image.open("mask.png"))[:, ::-1]).save("mask.png")
    result, check = (
        refine(*POINTS, *options, *more, "--json").document for more in ((), ("--check",))
    )
    assert result["suspects"] == check["suspects"]
    assert options or check["suspects"][0]["option"] == "--assume mask-flipped"


def test_a_check_warns_once_of_points_behind_the_camera_in_its_document_too(folder, refine):
    cloud = read_cloud("initial.ply").points
    camera = read_camera("camera.json", 256, 256)
    clump = np.random.default_rng(0).normal(camera.position - 0.3 * camera.R[2], 0.01, (600, 3))
    write_cloud(Path("behind.ply"), np.vstack([cloud, clump]))
    run = refine("behind.ply", "mask.png", "--check", "--json")
    assert run.err.count("behind the camera") == 1
    assert sum("behind the camera" in text for text in run.document["warnings"]) == 1


def test_a_strict_check_of_what_looks_wrong_fails(inverted, refine):
    run = refine(*POINTS, "--strict", "--check", "--json")
    assert run.code == 3
    assert json.loads(run.out)["verdict"] == "doubtful"


def test_an_inverted_mask_is_told_with_the_option_that_mends_it(inverted, refine):
    run = refine(*POINTS)
    assert (run.code, run.err.count("\n")) == (0, 1)
    assert "is doubtful" in run.err
    assert "the mask is inverted: try --assume mask-inverted" in run.err
    assert "(doubtful, confidence" in run.out
    assert "nothing: the step is doubtful (--accept-doubtful" in run.out
    assert (read_cloud("initial.refined.ply").points == read_cloud("initial.ply").points).all()
    assert (
        refine(*POINTS, "--accept-doubtful", "-o", "all.ply", "--json").document["step_taken"]
        == 1.0
    )
    document = refine(*POINTS, "--check", "--json").document
    (suspect, *_) = document["suspects"]
    assert (document["verdict"], document["confidence"]) == ("doubtful", None)
    assert (suspect["what"], suspect["option"]) == (
        "the mask is inverted",
        "--assume mask-inverted",
    )
    assert 0.4 < suspect["score"] <= 1.0
    assert "mask-inverted" in document["warnings"][0]


def test_strict_writes_nothing_where_the_result_is_doubtful(inverted, refine, tmp_path):
    run = refine(*POINTS, "--strict", "-o", "strict.ply", "--overlay", "strict.png")
    assert (run.code, run.out) == (3, "")
    assert "with --strict nothing is written" in run.err
    assert not list(tmp_path.glob("**/strict*"))
    document = json.loads(refine(*POINTS, "--strict", "--json").out)
    assert (document["verdict"], document["output"], document["assume"]) == ("doubtful", None, [])
    assert refine(*POINTS, "--strict", "--assume", "mask-inverted", "-o", "strict.ply").code == 0


@pytest.mark.parametrize("options", [(), ("--preset", "paper"), ("--steps", "0")])
def test_a_result_of_an_unsure_camera_is_doubtful(folder, refine, options):
    """An aeroplane fits no chair."""
    fitted = (str(EXAMPLES / "airplane" / "initial.ply"), "mask.png", "--camera", "fit", *options)
    result, check = (refine(*fitted, *more, "--json").document for more in ((), ("--check",)))
    assert result["verdict"] == check["verdict"] == "doubtful"
    assert result["reason"].startswith("the fitted camera is unsure")
    assert check["reason"] == result["reason"]
    assert (result["confidence"] or 0.0) < 0.5


def test_strict_writes_nothing_of_an_unsure_camera(folder, refine, tmp_path):
    run = refine(
        str(EXAMPLES / "airplane" / "initial.ply"),
        "mask.png",
        "--camera",
        "fit",
        "--strict",
        "-o",
        "other.ply",
    )
    assert run.code == 3
    assert not (tmp_path / "other.ply").exists()


def test_strict_writes_nothing_that_a_short_budget_left_no_time_to_judge(folder, refine, tmp_path):
    run = refine(*POINTS, "--strict", "--budget", "1e-6", "-o", "strict.ply")
    assert run.code == 3
    assert "the result is not judged: 1e-06 s were too few; with --strict nothing" in run.err
    assert not list(tmp_path.glob("**/strict*"))


def test_strict_writes_nothing_that_is_not_judged(folder, refine, tmp_path):
    np.save("depth.npy", np.where(read_mask("mask.png") > 0.5, 2.0, 0.0))
    for reason, *options in (
        ("11 steps are too few", "--steps", "11"),
        ("none with a depth map", "--depth", "depth.npy"),
    ):
        run = refine(*POINTS, "--strict", *options, "-o", "strict.ply")
        assert run.code == 3
        assert f"initial.ply: the result is not judged: {reason}" in run.err
    paper = refine(*POINTS, "--strict", "--preset", "paper", "-o", "strict.ply")
    assert (
        "--strict is for results that are judged, of --mode points --preset best, found --mode points --pre"
        in paper.refusal
    )
    assert not list(tmp_path.glob("**/strict*"))


def test_a_pose_is_refused_with_what_it_looks_like_and_taken_under_that_assumption(
    to_world, refine
):
    run = refine(*POINTS)
    assert run.code == 2
    assert "camera-to-world: try --assume camera-to-world" in run.err
    assert refine(*POINTS, "--assume", "camera-to-world").code == 0


def test_a_cloud_in_other_axes_is_refined_as_meant_and_written_in_its_own(folder, refine):
    write_cloud("up.ply", read_cloud("initial.ply").points[:, [0, 2, 1]] * [1.0, -1.0, 1.0])
    up = ("up.ply", "mask.png", "--assume", "cloud-z-up", "-o")
    given, document = (
        refine(*words, "--json").document
        for words in ((*POINTS, "-o", "right.ply"), (*up, "turned.ply"))
    )
    right, turned = (read_cloud(name).points for name in ("right.ply", "turned.ply"))
    np.testing.assert_allclose(turned[:, [0, 2, 1]] * [1.0, 1.0, -1.0], right, atol=1e-4)
    plane = np.array(given["symmetry"])[[0, 2, 1]] * [1.0, -1.0, 1.0]
    assert abs(plane @ document["symmetry"][:3]) == pytest.approx(1.0, abs=1e-9)
    assert document["assume"] == ["cloud-z-up"]
    # A camera of the cloud as it is, and planes of its own axes: its x is the scene's.
    refine(
        "up.ply",
        "mask.png",
        "--assume",
        "cloud-z-up",
        "-o",
        "x.ply",
        "--symmetry",
        "x",
        "--write-camera",
        "up.json",
    )
    assert refine("up.ply", "mask.png", "--camera", "up.json", "-o", "up-again.ply").code == 0
    np.testing.assert_allclose(read_cloud("up-again.ply").points, turned, atol=1e-4)


def test_no_camera_is_written_of_a_cloud_with_left_handed_axes(folder, refine, tmp_path):
    write_cloud("left.ply", read_cloud("initial.ply").points[:, [1, 0, 2]])
    assume = ("--assume", "cloud-xy-swapped")
    run = refine("left.ply", "mask.png", *assume, "--write-camera", "left.json")
    assert run.code == 2
    assert "left-handed" in run.err
    assert run.err.count("\n") == 1
    assert not (tmp_path / "left.json").exists()
    document = refine("left.ply", "mask.png", *assume, "--json").document
    assert document["iou_after"] > document["iou_before"]
    assert "mirrored" in document["camera"]["source"]


@pytest.mark.parametrize(
    "option", [("--invert-mask",), ("--assume", "mask-inverted"), ("--assume", "cloud-z-up")]
)
def test_what_is_given_is_never_advised_again(folder, refine, option):
    (suspect, *_) = suspects = refine(*POINTS, *option, "--check", "--json").document["suspects"]
    assert suspect["option"] == f"without {' '.join(option)}"
    assert suspect["what"] == f"{' '.join(option)} is wrong"
    assert all(suspect["option"].startswith("without") for suspect in suspects)


def test_an_assumption_about_a_mask_that_is_not_there_is_refused(folder, refine):
    run = refine(*POINTS, "--assume", "mask-flipped@other.png")
    assert run.code == 2
    assert (
        "--assume mask-flipped@other.png: there is no such mask, expected one of mask.png"
        in run.err
    )


def test_an_assumption_may_name_its_mask_by_the_last_part_of_the_path(folder, refine, inverted):
    Path("a").mkdir()
    for name in ("mask.png", "camera.json"):
        Path(name).rename(Path("a") / name)
    run = refine(
        "initial.ply", "a/mask.png", "--assume", "mask-inverted@mask.png", "--check", "--json"
    )
    assert run.code == 0
    assert run.document["suspects"] == []
    Path("b").symlink_to("a")
    run = refine(
        "initial.ply", "a/mask.png", "b/mask.png", "--assume", "mask-inverted@mask.png", "--check"
    )
    assert run.code == 2
    assert "@mask.png: there are 2 such masks, expected one of a/mask.png, b/mask.png" in run.err


def test_a_camera_found_beside_the_mask_is_not_overwritten(folder, refine):
    before = Path("camera.json").read_bytes()
    run = refine(*POINTS, "--write-camera", "camera.json", "--overwrite")
    assert run.code == 2
    assert "camera.json: is another file of this command" in run.err
    assert Path("camera.json").read_bytes() == before


def test_an_unknown_assumption_lists_all(folder, refine):
    run = refine(*POINTS, "--assume", "upside")
    assert run.code == 2
    assert all(name in run.err for name in ASSUMPTIONS)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            "initial.ply mask.png --camera fit --assume opengl",
            "--camera fit finds the camera by itself",
        ),
        (
            "image.png mask.png --mode encoder --assume mask-inverted",
            "--assume is for --mode points",
        ),
    ],
)
def test_assumptions_that_have_no_place_are_refused(folder, refine, arguments, message):
    assert message in refine(*arguments.split()).refusal
