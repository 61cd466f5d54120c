"""What `tso refine` says of input that looks wrong, and of results that may be worse."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.scenes import EXAMPLES
from tso_cli.diagnosis.hypotheses import HYPOTHESES, of_width
from tso_cli.diagnosis.trust import LEAST_CONFIDENCE
from tso_cli.io.cameras import CameraRecord, read_camera, write_cameras
from tso_cli.io.clouds import read_cloud, write_cloud

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


def test_the_json_of_a_result_and_of_a_check_have_the_same_entries_of_a_verdict(folder, refine):
    result = refine(*POINTS, "--json").document
    check = refine(*POINTS, "--check", "--json").document
    assert set(result) >= CONTRACT
    assert set(check) >= CONTRACT
    assert result["verdict"] == "fits better"
    assert LEAST_CONFIDENCE <= result["confidence"] <= 1.0
    assert check["verdict"] is None
    assert check["confidence"] is None
    for document in (result, check):
        assert document["reason"] == ""
        assert document["suspects"] == []


@pytest.mark.parametrize(
    "options", [(), ("--preset", "paper"), ("--points", "256"), ("--steps", "0")]
)
def test_a_check_finds_what_a_refinement_with_the_same_options_finds(folder, refine, options):
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


def test_an_inverted_mask_is_reported_with_the_option_that_mends_it(inverted, refine):
    run = refine(*POINTS)
    assert run.code == 0
    assert run.err.count("\n") == 1
    assert "the result is doubtful, so the cloud is left as it was: it looks as if" in run.err
    assert "the mask is inverted: try --assume mask-inverted" in run.err
    assert "(doubtful)" in run.out
    assert "nothing: the input looks wrong (--accept-doubtful refines the cloud all the" in run.out
    assert (read_cloud("initial.refined.ply").points == read_cloud("initial.ply").points).all()
    accepted = refine(*POINTS, "--accept-doubtful", "-o", "all.ply", "--json").document
    assert accepted["moved"] is True
    document = refine(*POINTS, "--check", "--json").document
    assert document["verdict"] == "doubtful"
    assert document["confidence"] is None
    assert "mask-inverted" in document["warnings"][0]
    (suspect, *_) = document["suspects"]
    assert suspect["what"] == "the mask is inverted"
    assert suspect["option"] == "--assume mask-inverted"
    assert 0.4 < suspect["score"] <= 1.0


def test_strict_writes_nothing_where_the_result_is_doubtful(inverted, refine, tmp_path):
    run = refine(*POINTS, "--strict", "-o", "strict.ply", "--overlay", "strict.png")
    assert run.code == 3
    assert run.out == ""
    assert "with --strict nothing is written" in run.err
    assert not list(tmp_path.glob("**/strict*"))
    document = json.loads(refine(*POINTS, "--strict", "--json").out)
    assert document["verdict"] == "doubtful"
    assert document["output"] is None
    assert document["assume"] == []
    assert refine(*POINTS, "--strict", "--assume", "mask-inverted", "-o", "strict.ply").code == 0


@pytest.mark.parametrize("options", [(), ("--preset", "paper"), ("--steps", "0")])
def test_a_result_of_an_unsure_camera_is_doubtful(folder, refine, options):
    """An aeroplane fits no chair."""
    fitted = (str(EXAMPLES / "airplane" / "initial.ply"), "mask.png", "--camera", "fit", *options)
    result, check = (refine(*fitted, *more, "--json").document for more in ((), ("--check",)))
    assert result["verdict"] == check["verdict"] == "doubtful"
    assert result["reason"].startswith("the fitted camera is unsure")
    assert check["reason"] == result["reason"]
    assert result["confidence"] is None
    assert result["moved"] is False


def test_without_a_camera_file_one_is_assumed_and_a_wrong_one_is_doubtful(folder, refine):
    Path("camera.json").unlink()
    for more in ((), ("--check",)):
        run = refine(*POINTS, *more, "--json")
        assert "mask.png: no camera was given" in run.err
        assert "(--camera FILE, or --camera fit)" in run.err
    result = refine(*POINTS, "--accept-doubtful", "-o", "all.ply", "--json").document
    assert result["verdict"] == "doubtful"


def test_strict_writes_nothing_of_an_unsure_camera(folder, refine, tmp_path):
    other = str(EXAMPLES / "airplane" / "initial.ply")
    run = refine(other, "mask.png", "--camera", "fit", "--strict", "-o", "other.ply")
    assert run.code == 3
    assert "the fitted camera is unsure" in run.err
    assert not (tmp_path / "other.ply").exists()


def test_strict_writes_nothing_without_a_confidence(folder, refine, tmp_path):
    np.save("few.npy", read_cloud("initial.ply").points[:15])
    run = refine("few.npy", *POINTS[1:], "--strict", "-o", "strict.ply")
    assert run.code == 3
    expected = "the result is without confidence: 15 points are too few; with --strict nothing is"
    assert f"few.npy: {expected}" in run.err
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
    refine(*up, "x.ply", "--symmetry", "x", "--write-camera", "up.json")
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
        "--assume is 'mask-flipped@other.png': there is no such mask, expected one of mask.png"
        in run.err
    )


def test_an_assumption_may_name_its_mask_by_the_last_part_of_the_path(folder, refine, inverted):
    Path("a").mkdir()
    for name in ("mask.png", "camera.json"):
        Path(name).rename(Path("a") / name)
    assume = ("--assume", "mask-inverted@mask.png", "--check")
    run = refine("initial.ply", "a/mask.png", *assume, "--json")
    assert run.code == 0
    assert run.document["suspects"] == []
    Path("b").symlink_to("a")
    run = refine("initial.ply", "a/mask.png", "b/mask.png", *assume)
    assert run.code == 2
    assert "@mask.png': there are 2 such masks, expected one of a/mask.png, b/mask.png" in run.err


def test_a_camera_found_beside_the_mask_is_not_overwritten(folder, refine):
    before = Path("camera.json").read_bytes()
    run = refine(*POINTS, "--write-camera", "camera.json", "--overwrite")
    assert run.code == 2
    assert "camera.json: is an input" in run.err
    assert Path("camera.json").read_bytes() == before


def test_list_prints_every_name_and_its_meaning_without_any_input(refine):
    run = refine("--assume", "list")
    assert run.code == 0
    rows = [line.split(maxsplit=1) for line in run.out.splitlines()]
    listed = [*HYPOTHESES.values(), of_width(518)]
    assert rows == [[one.name, one.says] for one in listed]


def test_a_photo_in_place_of_a_mask_is_refused_with_advice(folder, refine):
    rng = np.random.default_rng(0)
    photo = np.clip(rng.normal(128, 30, (256, 256, 3)), 0, 255).astype(np.uint8)
    photo[60:200, 80:180] //= 2
    Image.fromarray(photo).save("photo.png")
    for name in ("photo.png", "image.png"):
        refusal = refine("initial.ply", name, "--camera", "camera.json").refusal
        assert f"{name}: is a photo, grey over large parts, expected a mask; segment" in refusal


def test_a_grey_map_that_looks_like_a_photo_is_warned_of(folder, refine):
    with Image.open("image.png") as image:
        np.save("grey.npy", np.asarray(image.convert("L")))
    for options in ((), ("--check",)):
        run = refine("initial.ply", "grey.npy", "--camera", "camera.json", "--json", *options,
                     "-o", "photo.ply")  # fmt: skip
        (warning,) = [text for text in run.document["warnings"] if "photo" in text]
        assert warning.startswith("grey.npy: looks like a photo, grey in many places; expected")


def test_an_unknown_assumption_names_the_likeliest_and_where_all_are_listed(folder, refine):
    refusal = refine(*POINTS, "--assume", "upside").refusal
    assert "such as mask-upside-down" in refusal
    assert "--assume list" in refusal
    listed = refine("--assume", "list").out
    assert all(name in listed for name in HYPOTHESES)


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
