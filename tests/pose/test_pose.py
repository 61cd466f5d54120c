"""The camera fitted to a mask and a cloud, and the options about cameras."""

import shutil

import numpy as np
import pytest

from tests.corruption import assert_refused
from tests.scenes import about, block
from tso_cli.geometry.camera import Camera
from tso_cli.geometry.rotations import angle_between, from_vectors, spread
from tso_cli.io.cameras import read_camera
from tso_cli.pose.everywhere import same_by_symmetry, spacing
from tso_cli.pose.fit import Alternative, FittedCamera, fit_camera


@pytest.fixture(scope="module")
def fitted_chair(chair):
    return fit_camera(chair.target, chair.mask)


def test_the_camera_of_the_true_cloud_is_found_with_confidence(fitted_chair, chair):
    fitted, camera = fitted_chair, chair.camera
    assert angle_between(fitted.camera.R, camera.R) < 2.0
    assert fitted.sure
    assert fitted.iou > 0.8
    assert fitted.camera.t == pytest.approx(camera.t, abs=0.1 * camera.t[2])
    assert fitted.focal_range[0] <= fitted.camera.K[0, 0] <= fitted.focal_range[1]


def test_alternatives_are_over_20_degrees_away_and_miss_more_of_the_contour(fitted_chair):
    missed = [alternative.missed for alternative in fitted_chair.alternatives]
    assert fitted_chair.gap == pytest.approx(min(missed) - fitted_chair.missed)
    assert fitted_chair.gap > 0.1
    for alternative in fitted_chair.alternatives:
        degrees = angle_between(alternative.camera.R, fitted_chair.camera.R)
        assert alternative.degrees == pytest.approx(degrees)
        assert degrees > 20.0


def test_a_rotated_cloud_in_other_units_gets_the_same_picture(fitted_chair, chair):
    points = chair.target
    moved = 1000.0 * points @ from_vectors(np.array([0.0, 0.0, np.pi])).T + 5000.0
    before, _ = fitted_chair.camera.project(points)
    after, _ = fit_camera(moved, chair.mask).camera.project(moved)
    # Other starting poses: the same basin, not the same bits.
    assert np.abs(after - before).mean() < 4.0


def test_two_poses_that_fit_equally_well_are_unsure():
    # A bar from the side, thicker at one end, which the mask does not show.
    rng = np.random.default_rng(0)
    bar = rng.uniform(-1.0, 1.0, (600, 3)) * [0.5, 0.08, 0.08]
    bar[:, 2] += 0.05 * (bar[:, 0] > 0.2)
    assert not fit_camera(bar, block(np.s_[28:36, 10:54])).sure


def test_a_symmetry_of_the_cloud_is_no_alternative():
    rng = np.random.default_rng(0)
    quarter = rng.uniform(0.0, 1.0, (150, 3)) * [0.5, 0.05, 0.2]
    turns = [about("y", 90.0 * quarters) for quarters in range(4)]
    cross = np.concatenate([quarter @ turn.T for turn in turns])
    gap = spacing(cross)
    assert same_by_symmetry(cross, np.eye(3), turns[1], gap)
    assert not same_by_symmetry(cross, np.eye(3), about("y", 45.0), gap)
    # The axis of three legs does not go through the middle of their box.
    third = [about("y", 120.0 * thirds) for thirds in range(3)]
    stool = np.concatenate([quarter @ turn.T for turn in third])
    stool -= (stool.min(0) + stool.max(0)) / 2.0
    assert same_by_symmetry(stool, np.eye(3), third[1], spacing(stool))
    # Paint breaks a symmetry of the shape.
    paint = np.zeros((len(cross), 3))
    paint[: len(quarter)] = 1.0
    assert not same_by_symmetry(cross, np.eye(3), turns[1], gap, paint)
    assert same_by_symmetry(cross, np.eye(3), turns[1], gap, np.ones_like(paint))


def test_an_unsure_camera_names_the_rival_that_the_photo_leaves():
    camera = Camera.canonical(64, 64)
    refuted = Alternative(camera, 0.9, 0.05, 180.0, unlike_photo=True)
    others = Alternative(camera, 0.8, 0.8, 25.0), Alternative(camera, 0.85, 0.12, 40.0)
    fitted = FittedCamera(camera, 0.9, 0.05, (refuted, *others), (50.0, 90.0))
    assert not fitted.sure
    assert "turned by 40 degrees" in fitted.why_unsure
    assert fitted.chosen(3).focal_range == (camera.K[0, 0],) * 2


def test_starting_rotations_cover_all_directions():
    rotations = spread(150, 18)
    assert np.abs(rotations @ rotations.transpose(0, 2, 1) - np.eye(3)).max() < 1e-12
    assert np.linalg.det(rotations) == pytest.approx(np.ones(len(rotations)))
    anywhere = from_vectors(np.random.default_rng(0).normal(size=(50, 3)) * 2.0)
    assert max(angle_between(rotations, R).min() for R in anywhere) < 17.0


@pytest.mark.parametrize(
    ("points", "mask", "said"),
    [
        (np.eye(3), np.eye(8), "holds 3 points, expected at least 16"),
        (np.zeros((20, 3)), np.eye(8), "all 20 points are equal"),
        (np.random.default_rng(0).normal(size=(20, 3)), np.zeros((8, 8)), "no pixel is foreground"),
    ],
)
def test_a_cloud_or_mask_that_cannot_be_fitted_is_refused(points, mask, said):
    assert_refused(said, fit_camera, points, mask)


@pytest.mark.parametrize("line", [np.s_[:, 30], np.s_[5, 3:60]])
def test_a_mask_one_pixel_wide_gets_a_finite_camera(line):
    fitted = fit_camera(np.random.default_rng(0).normal(size=(40, 3)), block(line))
    assert np.isfinite(fitted.camera.R).all()
    assert 0.0 <= fitted.iou <= 1.0


def test_the_command_fits_refines_and_writes_a_camera_that_reads_back(refine, folder, chair):
    written = folder / "fitted.json"
    run = refine(
        "target.ply", "mask.png", "--camera", "fit", "--steps", "0", "--write-camera", written, "-v"
    )
    assert "tso: camera: fitted, IoU 0." in run.err
    assert "next best" in run.err
    assert "used   camera fitted to cloud and mask: pose sure; focal length " in run.out
    assert f"{written}: camera" in run.out
    assert angle_between(read_camera(written, 256, 256, "mask.png").R, chair.camera.R) < 8.0
    assert refine("target.ply", "mask.png", "--camera", written, "--check").code == 0


def test_the_cameras_of_several_masks_are_written_with_their_masks(refine, folder):
    shutil.copy("mask.png", "second.png")
    shutil.copy("camera.json", "second.camera.json")
    options = "--refine-camera", "--steps", "2", "-v", "--write-camera", "used.json"
    assert refine("target.ply", "mask.png", "second.png", *options).out.count("camera turned") == 2
    assert (
        "view        2 of 2, second.png"
        in refine("target.ply", "--camera", "used.json", "--check").out
    )


def test_a_camera_file_called_fit_is_read_when_written_with_its_folder(refine, folder):
    (folder / "fit").write_text("no camera")
    assert "fit: is no camera file" in refine("target.ply", "mask.png", "--camera", "./fit").refusal


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ("--mode encoder --camera fit", "--camera fit is for --mode points"),
        ("--mode encoder --refine-camera", "--refine-camera is for --mode points"),
        ("image.png --camera fit", "finds the camera of one mask, found 2 masks"),
        ("--write-camera camera.txt", "expected .json"),
        ("--write-camera camera.json", "exists already"),
        ("--write-camera camera.json --overwrite", "is an input"),
        (
            "-o x.ply --record --write-camera x.record.json --overwrite",
            "x.record.json: is another file of this command",
        ),
    ],
)
def test_wrong_use_of_the_camera_options_is_refused_in_one_line(options, message, refine, folder):
    before = set(folder.iterdir())
    assert (
        message
        in refine("initial.ply", "mask.png", "--camera", "camera.json", *options.split()).refusal
    )
    assert set(folder.iterdir()) == before
