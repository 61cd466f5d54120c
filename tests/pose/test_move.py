"""What moves as one before the shape is refined."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from tests.scenes import EXAMPLES, about, example, seen
from tso_cli import Camera, RefineConfig, View, refine
from tso_cli.cloud.cloud import Cloud
from tso_cli.errors import InputError
from tso_cli.evaluation.metrics import chamfer
from tso_cli.geometry.camera import intrinsics
from tso_cli.geometry.points import sample_surface
from tso_cli.geometry.rotations import angle_between, from_vectors
from tso_cli.io.clouds import read_cloud, write_cloud
from tso_cli.io.meshes import Mesh, read_mesh
from tso_cli.pose.causes import find_move
from tso_cli.render.folder import ground_truth, normalise
from tso_cli.render.rays import RayScene, render_view
from tso_cli.render.settings import RenderSettings
from tso_cli.render.viewpoints import look_at

CHAIR, PLANE = example("chair"), example("airplane")
TILT = from_vectors(np.radians([3.0, 4.0, -3.0]))  # 5.8 degrees


def _wrong(points, turn=TILT, shift=(0.03, -0.02, 0.0), size=1.0):
    return size * points @ turn.T + np.array(shift)


def _move(points, *views, **settings):
    return find_move(Cloud(points, "points").controlled().body, views, **settings)


def _error(move, points, truth):
    return chamfer(move.apply(points), truth).chamfer


@pytest.mark.parametrize("shown", [CHAIR, PLANE], ids=["chair", "airplane"])
def test_a_right_shape_in_a_wrong_pose_is_moved_back_by_default(shown):
    wrong = _wrong(shown.target)
    move = _move(wrong, shown.view)
    assert (move.kind, move.keep) == ("pose", "distance")
    assert move.explains
    assert move.degrees == pytest.approx(5.8, abs=1.0)
    assert angle_between(move.matrix[:3, :3] @ TILT, np.eye(3)) < 2.0
    # What is left is the distance, which one camera cannot tell.
    assert _error(move, wrong, shown.target) < 0.6 * chamfer(wrong, shown.target).chamfer


def test_a_shifted_cloud_stays_since_the_principal_point_may_be_off_instead():
    move = _move(CHAIR.target + [0.06, 0.04, 0.0], CHAIR.view)
    assert move.kind == "nothing"
    assert {cause.name for cause in move.causes} == {"shift", "principal-point"}


@pytest.mark.parametrize("shown", [CHAIR, PLANE], ids=["chair", "airplane"])
def test_a_cloud_that_is_right_or_of_another_shape_does_not_move_by_default(shown):
    view = shown.view
    for points in (shown.target, shown.points):
        move = _move(points, view)
        assert move.kind == "nothing"
        assert move.apply(points) is points
        assert move.views == (view,)


def test_a_picture_that_cuts_off_the_object_moves_nothing_by_default():
    left = PLANE.view.box()[0]
    cut = int(left) + 60
    camera = PLANE.camera.cropped((cut - 0.5, -0.5, 255.5, 255.5), 256 - cut, 256)
    view = View(PLANE.mask[:, cut:], camera)
    assert view.truncated
    assert _move(_wrong(PLANE.target), view).kind == "nothing"


def test_one_camera_keeps_the_size_of_a_pose_and_the_distance_of_a_similarity():
    wrong = _wrong(PLANE.target, size=1.05)
    depth = PLANE.camera.R[2]
    for asked, keep, kept in (
        ("pose", "auto", "size"), ("pose", "distance", "distance"),
        ("similarity", "auto", "distance"), ("similarity", "size", "size"),
    ):  # fmt: skip
        move = _move(wrong, PLANE.view, asked=asked, keep=keep)
        assert move.keep == kept
        middle = (wrong.min(0) + wrong.max(0)) / 2.0
        along = (move.apply(middle[None])[0] - middle) @ depth
        if kept == "distance":
            assert along == pytest.approx(0.0, abs=1e-9)
        else:
            assert abs(along) > 0.02
        assert (abs(move.size - 1.0) > 0.02) == (asked == "similarity" and kept == "distance")


@pytest.fixture(scope="module")
def rig():
    """Samples of a chair, and what three cameras around it see of its surface."""
    mesh = normalise(read_mesh(EXAMPLES / "meshes/chair/q19_OfficeChair.ply"))
    points, _ = ground_truth(mesh, RenderSettings(samples=2048), np.random.default_rng(0))
    cameras = [look_at(azimuth, 15.0, 2.4, (128, 128)) for azimuth in (10.0, 80.0, 160.0)]
    scene = RayScene(mesh)
    return points, [
        View(np.float32(render_view(scene, camera).mask > 0), camera) for camera in cameras
    ]


def test_several_views_tell_size_from_distance_and_find_a_cloud_in_another_frame(rig):
    points, views = rig
    floor = 2.0 * chamfer(points[::2], points[1::2]).chamfer
    wrong = _wrong(points, size=1.08, shift=(0.05, -0.03, 0.06))
    near = _move(wrong, *views, asked="similarity")
    assert near.keep is None
    assert near.size == pytest.approx(1.0 / 1.08, rel=0.02)
    assert _error(near, wrong, points) < floor
    # The frame of a trainer: turned, far away and of another scale.
    elsewhere = _wrong(points, about("x", 100.0) @ about("y", 30.0), (5.0, -3.0, 8.0), 0.2)
    found = _move(elsewhere, *views, asked="similarity")
    assert found.alternatives
    assert found.why_unsure == ""
    assert found.size == pytest.approx(5.0, rel=0.02)
    assert _error(found, elsewhere, points) < floor


def test_a_place_found_in_all_directions_is_unsure_if_the_cloud_is_of_another_shape():
    away = CHAIR.points + [0.0, 5.0, 0.0]
    result = refine(away, CHAIR.view, config=RefineConfig(move="pose", steps=0))
    assert "of the contours at best, expected at most 20%" in result.move.why_unsure
    assert (result.trust.verdict, result.trust.reason) == ("doubtful", "unsure-place")


def test_a_place_is_unsure_if_another_one_that_is_no_symmetry_fits_as_well():
    # A plate with a hole: its mask does not tell which of its sides is seen.
    x, y = np.mgrid[-0.5:0.5:60j, -0.3:0.3:36j].reshape(2, -1)
    dent = 0.1 * np.exp(-(((x - 0.3) / 0.05) ** 2) - ((y - 0.1) / 0.05) ** 2)
    hole = (x + 0.2) ** 2 + (y + 0.1) ** 2 > 0.1**2
    plate = np.stack([x, y, dent], 1)[hole]
    view = seen(plate, replace(Camera.canonical(128, 128), R=np.eye(3) * [1.0, -1.0, -1.0]))
    move = _move(plate + [9.0, 0.0, 0.0], view, asked="pose")
    assert "turned by another" in move.why_unsure


def test_a_camera_that_moves_leaves_the_cloud_where_it_is():
    given = replace(PLANE.camera, R=TILT @ PLANE.camera.R)
    result = refine(
        PLANE.target, replace(PLANE.view, camera=given), config=RefineConfig(move="camera")
    )
    assert result.move.kind == "camera"
    np.testing.assert_array_equal(result.move.matrix, np.eye(4))
    assert angle_between(result.cameras[0].R, PLANE.camera.R) < 1.5
    assert angle_between(given.R, PLANE.camera.R) > 5.0
    np.testing.assert_array_equal(result.points, PLANE.target)
    assert result.fit.iou_after > result.fit.iou_before + 0.1


@pytest.mark.parametrize("model", ["perspective", "orthographic"])
def test_the_cloud_at_rest_is_seen_as_the_cloud_that_moved(model):
    camera = CHAIR.camera
    if model == "orthographic":
        camera = replace(camera, K=intrinsics(150.0, 256, 256), model=model)
    points = CHAIR.target
    R, t, size = about("z", 30.0) @ about("x", 10.0), np.array([0.1, 0.2, 0.3]), 1.2
    moved, _ = camera.project(size * points @ R.T + t)
    np.testing.assert_allclose(
        camera.before_placed(R, t, size).project(points)[0], moved, atol=1e-9
    )


def test_only_a_move_keeps_the_shape_to_rounding_in_the_units_of_the_file():
    wrong = 1000.0 * _wrong(CHAIR.target) + 5000.0
    centre = np.full(3, 5000.0)
    camera = CHAIR.camera.before_placed(np.eye(3), -centre / 1000.0, 1.0 / 1000.0)
    result = refine(wrong, View(CHAIR.mask, camera), config=RefineConfig(move="pose", only=True))
    moved = wrong @ result.move.matrix[:3, :3].T + result.move.matrix[:3, 3]
    np.testing.assert_allclose(result.points, moved, atol=1e-9)
    R = result.move.matrix[:3, :3]
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
    truth = 1000.0 * CHAIR.target + 5000.0
    assert result.fit.moved_max == 0.0
    assert chamfer(result.points, truth).chamfer < 0.5 * chamfer(wrong, truth).chamfer


def test_after_a_move_that_explains_the_misfit_the_shape_is_hardly_bent():
    wrong = _wrong(PLANE.target)
    result = refine(wrong, PLANE.view)
    # Nobody asked for it, and the camera may be wrong instead.
    assert (result.trust.verdict, result.trust.reason) == ("doubtful", "place")
    assert result.moved
    assert result.fit.moved_mean < 0.003
    as_shape = refine(wrong, PLANE.view, config=RefineConfig(move="shape"))
    assert PLANE.error(result.points) < 0.7 * PLANE.error(as_shape.points)


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"move": "sideways"}, "`move` is 'sideways', expected one of auto, shape, pose"),
        ({"keep": "colour"}, "`keep` is 'colour', expected one of auto, size, distance"),
        ({"only": True, "move": "shape"}, "`only` is for `move` auto, pose, similarity or camera"),
        ({"only": True, "preset": "paper"}, "nothing moves"),
        ({"only": True, "steps": 5}, "`only` with `steps`, expected one of the two"),
        (
            {"keep": "size", "move": "camera"},
            "pose or similarity, found `move` camera",
        ),
        (
            {"move": "pose", "mode": "encoder"},
            "`move` pose is for `mode` points, found",
        ),
    ],
)
def test_moves_that_do_not_exist_are_refused(settings, said):
    with pytest.raises(InputError, match=said):
        RefineConfig(**settings)


def test_only_a_move_may_be_asked_for_without_saying_which():
    assert RefineConfig(only=True).settings().steps == 0


def test_a_cloud_that_fits_stays_though_a_move_was_asked_for():
    result = refine(CHAIR.target, CHAIR.view, config=RefineConfig(move="pose", only=True))
    assert result.move.kind == "nothing"
    assert "no other place fits much better" in result.move.why_unmoved
    np.testing.assert_array_equal(result.points, CHAIR.target)
    assert (result.trust.verdict, result.trust.confidence) == ("left", 1.0)
    assert not result.moved


def test_by_default_nothing_moves_by_a_large_turn():
    move = _move(_wrong(PLANE.target, about("y", 40.0)), PLANE.view)
    assert move.kind == "nothing"
    assert "no small turn and shift" in move.why_unmoved


def test_a_photo_of_one_colour_changes_no_move():
    plain = replace(PLANE.view, image=np.ones((256, 256, 3)))
    moves = [_move(_wrong(PLANE.target), view) for view in (PLANE.view, plain)]
    np.testing.assert_array_equal(*(move.matrix for move in moves))


@pytest.mark.parametrize("times", [0.01, 4.0, 300.0])
def test_a_cloud_in_other_units_keeps_its_distance_before_one_camera(times):
    wrong = times * _wrong(PLANE.target, about("z", 100.0))
    move = _move(wrong, PLANE.view, asked="similarity")
    middle = (wrong.min(0) + wrong.max(0)) / 2.0
    before, after = (
        PLANE.camera.R[2] @ point + PLANE.camera.t[2]
        for point in (middle, move.apply(middle[None])[0])
    )
    in_front = (wrong @ PLANE.camera.R[2] + PLANE.camera.t[2]).min() > 0.0
    assert move.keep == ("distance" if in_front else "size")
    if in_front:
        assert after == pytest.approx(before, rel=1e-6)
    else:
        assert move.size == pytest.approx(1.0, rel=1e-6)


@pytest.mark.parametrize("times", [1e-3, 137.0, 1e3])
def test_several_views_find_a_cloud_in_any_units(rig, times):
    points, views = rig
    wrong = times * _wrong(points)
    move = _move(wrong, *views[:2], asked="similarity")
    assert move.size * times == pytest.approx(1.0, rel=0.02)
    assert _error(move, wrong, points) < 2.0 * chamfer(points[::2], points[1::2]).chamfer


def test_a_turned_cloud_that_meets_a_flipped_mask_is_not_believed():
    view = View(np.ascontiguousarray(CHAIR.mask[:, ::-1]), CHAIR.camera)
    result = refine(CHAIR.target, view, config=RefineConfig(move="pose"))
    assert (result.trust.verdict, result.trust.reason) == ("doubtful", "unsure-place")
    assert "mask is flipped left to right" in result.trust.says


def test_a_check_says_what_would_move(refine, folder):
    write_cloud(folder / "turned.ply", _wrong(CHAIR.target))
    run = refine("turned.ply", "mask.png", "--check", "--move", "pose")
    assert "moves       as one: turned by" in run.out
    assert refine("turned.ply", "mask.png", "--check", "--json").document["moved_as"] == "pose"


def test_a_matrix_is_not_written_where_the_cloud_cannot_move(refine, folder):
    run = refine("target.ply", "mask.png", "--move", "camera", "--write-transform", "matrix.json")
    assert "--write-transform is for a cloud that moves as one" in run.refusal


def test_the_command_says_what_moved_and_writes_its_matrix(refine, folder):
    write_cloud(folder / "turned.ply", _wrong(CHAIR.target))
    run = refine("turned.ply", "mask.png", "--write-transform", "matrix.json", "-o", "out.ply")
    assert "moved  as one: turned by" in run.out
    assert "--move camera if the cloud is" in run.err
    matrix = np.array(json.loads((folder / "matrix.json").read_text())["matrix"])
    document = refine("turned.ply", "mask.png", "--json", "-o", "again.ply").document
    assert document["moved_as"] == "pose"
    np.testing.assert_allclose(document["transform"], matrix)
    moved = _wrong(CHAIR.target) @ matrix[:3, :3].T + matrix[:3, 3]
    assert np.abs(read_cloud(folder / "out.ply").points - moved).mean() < 0.003
    still = refine("turned.ply", "mask.png", "--move", "shape", "--json", "-o", "s.ply").document
    assert still["moved_as"] == "nothing"
    assert still["transform"] == np.eye(4).tolist()
    assert "as one" not in refine("target.ply", "mask.png", "-o", "t.ply").out


def test_a_camera_moves_by_either_name(refine, folder):
    write_cloud(folder / "turned.ply", _wrong(CHAIR.target))
    for number, words in enumerate((["--refine-camera"], ["--move", "camera"])):
        run = refine("turned.ply", "mask.png", *words, "--json", "-o", f"{number}.ply")
        assert run.document["moved_as"] == "camera"
        assert run.document["moved_cameras"][0]["turned_degrees"] == pytest.approx(5.8, abs=1.0)
    both = "--refine-camera", "--move", "pose", "-o", "both.ply"
    refused = refine("turned.ply", "mask.png", *both).refusal
    assert "is for --mode points and --move camera" in refused


def _pliers():
    """The mesh of flat pliers made of boxes."""
    parts = []
    # Length, width, middle x and y, degrees of the long side.
    boxes = [(0.55, 0.07, 0.2, 0.05, 12), (0.55, 0.07, 0.2, -0.05, -12), (0.12, 0.12, 0, 0, 0)]
    boxes += [(0.3, 0.06, -0.22, 0.02, -6), (0.3, 0.06, -0.22, -0.02, 6)]
    for length, width, x, y, degrees in boxes:
        box = trimesh.creation.box((length, width, 0.05))
        parts.append((box.vertices @ about("z", degrees).T + [x, y, 0.0], box.faces))
    faces = np.concatenate([faces + 8 * number for number, (_, faces) in enumerate(parts)])
    return Mesh(np.concatenate([vertices for vertices, _ in parts]), faces)


@pytest.mark.parametrize(("pitch", "yaw", "roll"), [(35.0, 50.0, 60.0), (50.0, 25.0, 0.0)])
def test_a_thin_cloud_that_is_stretched_is_not_turned_by_default(pitch, yaw, roll):
    mesh, rng = _pliers(), np.random.default_rng(0)
    R = np.diag([1.0, -1.0, -1.0]) @ about("x", pitch) @ about("y", yaw) @ about("z", roll)
    camera = Camera(intrinsics(900.0, 640, 480), R, np.array([0.0, 0.0, 900.0 / 160]), 640, 480)
    mask = render_view(RayScene(mesh), camera, rng).mask > 127
    truth = sample_surface(mesh.vertices, mesh.faces, 4096, rng)
    middle, shear = truth.mean(0), np.array([[1.15, 0.1, 0], [0, 0.85, 0.1], [0, 0, 1.1]])
    wrong = (truth[::2] - middle) @ shear.T + middle
    assert _move(wrong, View(np.float32(mask), camera)).kind == "nothing"
    result = refine(wrong, np.float32(mask), camera)
    assert chamfer(result.points, truth).chamfer < 0.6 * chamfer(wrong, truth).chamfer


def test_what_the_masks_do_not_determine_is_not_called_exact():
    # How a bottle is turned about its axis is anyone's guess.
    profile = [[0.0, -0.5], [0.17, -0.5], [0.17, 0.15], [0.07, 0.3], [0.07, 0.5], [0.0, 0.5]]
    revolved = trimesh.creation.revolve(profile, sections=64)
    mesh = Mesh(revolved.vertices[:, [0, 2, 1]], revolved.faces[:, ::-1])
    camera = look_at(30.0, 25.0, 2.4, (128, 128))
    mask = np.float32(render_view(RayScene(mesh), camera).mask > 127)
    points = sample_surface(mesh.vertices, mesh.faces, 4096, np.random.default_rng(0))
    move = _move(_wrong(points), View(mask, camera), asked="pose")
    about_x, about_axis, about_z = move.exact_to.degrees
    assert max(about_x, about_z) < 20.0
    assert about_axis > 90.0
    assert move.exact_to.size == 0.0  # it was kept
