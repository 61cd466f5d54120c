import json
import shutil

import numpy as np
import pytest

from tests.dataset_trees import lopsided, write_binvox
from tests.io.test_shapes import SQUARE_OFF, SQUARE_PLY
from tests.scenes import block
from tso_cli.evaluation.compare import evaluate
from tso_cli.evaluation.config import EvalConfig
from tso_cli.evaluation.footprint import IOU_MEANS, Solid, window_iou
from tso_cli.evaluation.metrics import chamfer, emd, iou
from tso_cli.evaluation.pairs import Pair
from tso_cli.geometry.camera import Camera
from tso_cli.geometry.points import farthest_point_sample, normalise_longest_side, sample_surface
from tso_cli.io.cameras import CameraRecord, write_cameras
from tso_cli.io.clouds import read_cloud, write_cloud
from tso_cli.io.images import write_image
from tso_cli.io.masks import read_mask
from tso_cli.io.meshes import read_mesh, write_mesh
from tso_cli.io.shipped import examples_folder
from tso_cli.io.views import ViewFiles, load_views
from tso_cli.losses.silhouette import silhouette_of


@pytest.fixture
def run(tso):
    return lambda *arguments: tso("eval", *arguments)


@pytest.fixture
def document(run):
    return lambda *arguments: run(*arguments, "--json").document


@pytest.fixture
def refusal(run):
    return lambda *arguments: run(*arguments).refusal


def points_of(seed, count=40):
    """A random cloud of longest side 1."""
    points = np.random.default_rng(seed).uniform(-0.5, 0.5, (count, 3))
    points[:2] = [[-0.5, 0, 0], [0.5, 0, 0]]
    return points


@pytest.fixture
def cloud(tmp_path):
    """Write `points_of` a seed."""

    def write(name, seed=0, count=40, scale=1.0):
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        write_cloud(path, scale * points_of(seed, count), dtype="float64")
        return path

    return write


@pytest.fixture
def square(tmp_path):
    """A mesh of two triangles."""
    (tmp_path / "a.off").write_text(SQUARE_OFF)
    return tmp_path / "a.off"


@pytest.fixture
def grid(tmp_path):
    """A full voxel grid."""
    np.save(tmp_path / "grid.npy", np.ones((4, 4, 4), bool))
    return tmp_path / "grid.npy"


def test_two_files_give_one_pair_with_raw_numbers(cloud, document):
    found = document("--chamfer", cloud("a.ply", 1), cloud("b.ply", 2, 50))
    (pair,) = found["pairs"]
    expected = chamfer(points_of(1), points_of(2, 50))
    assert (pair["forward"], pair["backward"], pair["chamfer"]) == (
        expected.forward,
        expected.backward,
        expected.chamfer,
    )
    assert (pair["name"], pair["prediction_points"], pair["target_points"]) == ("a", 40, 50)
    assert found["mean"] == {key: pair[key] for key in ("forward", "backward", "chamfer")}
    assert (found["convention"]["protocol"], found["convention"]["seed"]) == ("plain", 0)


def test_arrays_of_clouds_are_compared_cloud_by_cloud(pictured, document, refusal):
    clouds, masks = pictured / "a.npy", pictured / "masks.npy"
    dense = read_cloud(pictured / "cloud.ply").points
    np.save(clouds, np.stack([dense, dense + [0.0, 0.5, 0.0]]))
    np.savez(pictured / "b.npz", points=np.stack([dense, dense]))
    inside = read_mask(pictured / "mask.png") > 0.5
    np.save(masks, np.stack([inside, inside[::-1, ::-1]]))
    found = document(clouds, pictured / "b.npz", "--chamfer", "--iou", "--mask", masks)["pairs"]
    assert [pair["name"] for pair in found] == ["a[0]", "a[1]"]
    assert [pair["chamfer"] > 0.01 for pair in found] == [False, True]
    assert [pair["iou"] > 0.5 for pair in found] == [True, False]
    np.save(pictured / "b.npy", dense)
    message = refusal(clouds, pictured / "b.npy")
    assert "a.npy holds 2 shapes and" in message
    assert "b.npy 1, expected the same number" in message


def test_the_table_shows_thousandfold_values_and_names_its_convention(cloud, run, document):
    a, b = cloud("a.ply", 1), cloud("b.ply", 2)
    result = run(a, b)
    value = chamfer(points_of(1), points_of(2)).chamfer
    assert f"{1000 * value:.3f}" in result.out.splitlines()[2].split()
    assert "Chamfer x1000: squared distances" in result.out
    assert "seed 0" in result.out
    assert result.err == ""
    assert document(a, b) == document("--chamfer", a, b)


def test_folders_are_matched_by_the_path_without_suffix(cloud, tmp_path, document):
    cloud("ours/chair/one.ply", 1), cloud("ours/two.v2.ply", 2), cloud("theirs/two.v2.ply", 4)
    (tmp_path / "theirs" / "chair").mkdir()
    np.save(tmp_path / "theirs" / "chair" / "one.npy", points_of(3))
    (tmp_path / "theirs" / "notes.txt").write_text("not a shape")
    (tmp_path / "ours" / ".hidden.ply").write_text("not a shape")
    found = document(tmp_path / "ours", tmp_path / "theirs")
    assert [pair["name"] for pair in found["pairs"]] == ["chair/one", "two.v2"]
    values = [
        chamfer(points_of(1), points_of(3)).chamfer,
        chamfer(points_of(2), points_of(4)).chamfer,
    ]
    assert [pair["chamfer"] for pair in found["pairs"]] == values
    assert found["mean"]["chamfer"] == pytest.approx(np.mean(values))


def test_an_unmatched_name_is_an_error_that_names_it(cloud, tmp_path, refusal):
    cloud("ours/a.ply"), cloud("theirs/a.ply"), cloud("ours/b.ply"), cloud("theirs/c.ply")
    message = refusal(tmp_path / "ours", tmp_path / "theirs")
    assert f"{tmp_path / 'ours'} has b, which" in message
    assert f"{tmp_path / 'theirs'} has c, which" in message
    for name in "defg":
        cloud(f"ours/{name}.ply")
    assert "b, d, e and 2 more" in refusal(tmp_path / "ours", tmp_path / "theirs")


def test_a_suffix_of_the_predictions_is_dropped_only_on_request(cloud, tmp_path, document, refusal):
    cloud("ours/a.refined.ply", 1), cloud("ours/a.ply", 2), cloud("theirs/a.ply", 3)
    assert "--suffix .refined" in refusal(tmp_path / "ours", tmp_path / "theirs")
    found = document(tmp_path / "ours", tmp_path / "theirs", "--suffix", ".refined")
    assert found["mean"]["chamfer"] == chamfer(points_of(1), points_of(3)).chamfer


def test_inputs_that_do_not_pair_are_refused(cloud, tmp_path, refusal):
    file, (folder, empty) = cloud("a.ply"), (tmp_path / "folder", tmp_path / "empty")
    cloud("folder/a.ply")
    empty.mkdir()
    assert "expected two files or two folders" in refusal(folder, file)
    assert "expected two files or two folders" in refusal(file, folder)
    assert "no file to evaluate" in refusal(folder, empty)
    assert "missing.ply: no such file" in refusal(file, tmp_path / "missing.ply")
    assert "is a file" in refusal(file, file, "--suffix", ".refined")
    np.save(folder / "a.npy", points_of(0))
    assert "have the same name" in refusal(folder, folder)


def test_capnet_protocol_hides_scale_and_place_and_plain_does_not(cloud, document):
    a, b, b_large = cloud("a.ply", 1), cloud("b.ply", 2), cloud("large.ply", 2, scale=7.0)
    assert document(a, b)["mean"]["chamfer"] != pytest.approx(
        document(a, b_large)["mean"]["chamfer"]
    )
    scaled = document(a, b_large, "--protocol", "capnet", "--emd", "--chamfer")
    assert scaled["mean"] == pytest.approx(
        document(a, b, "--protocol", "capnet", "--emd", "--chamfer")["mean"]
    )
    boxed = map(normalise_longest_side, (points_of(1), points_of(2)))
    assert scaled["mean"]["emd"] == pytest.approx(emd(*boxed, squared=True))
    assert "squared" in scaled["convention"]["emd"]
    assert document(a, b, "--emd")["mean"]["emd"] == pytest.approx(emd(points_of(1), points_of(2)))


CHAIR_MESH = examples_folder() / "meshes" / "chair" / "q17_ChairHandle.ply"


def papers_chamfer(prediction, thinned=1024):
    """The paper's: 16,384 points of a mesh, farthest-point sampling, each cloud in its own box."""
    mesh = read_mesh(CHAIR_MESH)
    clouds = (
        read_cloud(prediction).points,
        sample_surface(mesh.vertices, mesh.faces, 16384, np.random.default_rng(0)),
    )
    if thinned is not None:
        clouds = [points[farthest_point_sample(points, thinned)] for points in clouds]
    return chamfer(*map(normalise_longest_side, clouds)).chamfer


@pytest.mark.parametrize("prediction", ["target.ply", "initial.ply"])
def test_capnet_protocol_is_the_papers_evaluation(prediction, document):
    ours = examples_folder() / "chair" / prediction
    result = document(ours, CHAIR_MESH, "--protocol", "capnet")
    expected = papers_chamfer(ours)
    assert result["mean"]["chamfer"] == pytest.approx(expected, rel=0.04)
    assert (result["pairs"][0]["prediction_points"], result["pairs"][0]["target_points"]) == (
        1024,
        1024,
    )
    assert result["convention"]["points"] == 1024
    # Without the thinning it would be another figure.
    assert abs(papers_chamfer(ours, thinned=None) / expected - 1) > 0.06


def test_capnet_protocol_takes_other_numbers_on_request_and_small_clouds_whole(
    cloud, run, document, refusal
):
    a, b = cloud("a.ply", 1, 40), cloud("b.ply", 2, 1500)

    def counts(*more):
        (pair,) = document(a, b, *more)["pairs"]
        return pair["prediction_points"], pair["target_points"]

    assert counts("--protocol", "capnet") == (40, 1024)
    assert counts("--protocol", "capnet", "--points", 30) == (30, 30)
    assert counts("--protocol", "plain") == (40, 1500)
    assert "a.ply: holds 40 points" in refusal(a, b, "--points", 50)
    assert "1024 points at most (farthest-point)" in run(a, b, "--protocol", "capnet").out


@pytest.mark.parametrize("in_the_middle", [False, True])
def test_a_binvox_grid_of_a_shape_lies_on_it_whatever_its_header_places_where(
    tmp_path, in_the_middle, run
):
    write_mesh(tmp_path / "shape.ply", lopsided())
    write_binvox(tmp_path / "grid" / "shape.binvox", in_the_middle)
    result = run(tmp_path / "shape.ply", tmp_path / "grid" / "shape.binvox", "--json")
    # Half a voxel off all over, of 32 along a longest side of 0.66, would be 0.0002 to and fro.
    assert result.document["mean"]["chamfer"] < 0.0004
    assert "centres" not in result.err


def test_a_grid_far_from_what_it_is_compared_with_is_remarked_on(cloud, grid, run):
    path = grid.with_name("shifted.ply")
    for shift, remarked in ((0.1, False), (0.4, True)):
        write_cloud(path, points_of(0) + [0, shift, 0], dtype="float64", overwrite=True)
        for pair in ((path, grid), (grid, path)):
            assert ("voxel grids are centred at the origin" in run(*pair).err) == remarked
            assert "voxel grids are centred" not in run(*pair, "--protocol", "capnet").err
    assert "voxel grids are centred" not in run(cloud("a.ply"), path).err


def test_a_surface_against_itself_is_as_far_as_two_samples_of_it(square, run, document):
    assert (
        "prediction and target draw their own points" in run(square, square, "--samples", 4000).out
    )
    distance = document(square, square, "--samples", 4000)["mean"]
    # The nearest of N random points on an area A has the mean squared distance A / (pi N).
    assert distance["forward"] == pytest.approx(4 / (np.pi * 4000), rel=0.1)
    assert distance["backward"] == pytest.approx(distance["forward"], rel=0.1)
    assert document(square, square, "--vertices")["mean"]["chamfer"] == 0.0
    assert "draw" not in run(square, square, "--vertices").out


def test_a_single_point_is_compared_by_distance_and_not_by_its_own_size(
    tmp_path, run, document, refusal
):
    one, two = tmp_path / "one.xyz", tmp_path / "two.xyz"
    one.write_text("1 0 0\n")
    two.write_text("0 0 0\n1 0 0\n")
    assert document(one, two)["mean"] == {"forward": 0.5, "backward": 0.0, "chamfer": 0.5}
    assert document(two, one, "--f-score", "--threshold", 0.1)["mean"]["precision"] == 0.5
    assert run(two, one).err == ""
    reason = f"{two} against {one}: target: holds a single point, expected a cloud of some extent"
    assert refusal(two, one, "--f-score") == f"tso: error: {reason}"
    assert "prediction: holds a single point" in refusal(one, two, "--protocol", "capnet")
    one.write_text("1 0 0\n1 0 0\n")
    assert document(two, one)["mean"]["backward"] == 0.5
    assert "target: all 2 points are equal" in refusal(two, one, "--protocol", "capnet")


def test_plain_protocol_says_when_the_target_is_not_of_size_one(cloud, run):
    large = cloud("large.ply", 2, scale=7.0)
    assert "longest side of the target is 7" in run(large, large).err
    assert run(large, large, "--protocol", "capnet").err == ""


def test_emd_of_unequal_clouds_advises_points_and_names_the_files(cloud, refusal):
    message = refusal(cloud("a.ply", 1, 60), cloud("b.ply", 2, 30), "--emd")
    assert "a.ply against" in message
    assert "--points 30" in message


def test_f_score_takes_a_threshold(cloud, document):
    a, b = cloud("a.ply", 1), cloud("b.ply", 2)
    assert document(a, b, "--f-score")["pairs"][0]["threshold"] == pytest.approx(0.01)
    wide = document(a, b, "--f-score", "--threshold", 5)
    assert wide["mean"] == {"precision": 1.0, "recall": 1.0, "f_score": 1.0}


def test_meshes_and_voxel_grids_are_compared_by_their_surface_and_this_is_logged(
    square, grid, run, document
):
    mesh = square.with_name("b.ply")
    mesh.write_text(SQUARE_PLY)
    result = run(square, mesh, "--samples", 500, "--json")
    assert "prediction: 1 of 1 are meshes, compared by 500 points of the surface" in result.err
    (pair,) = result.document["pairs"]
    assert (pair["prediction_kind"], pair["prediction_points"]) == ("mesh", 500)
    assert document(mesh, mesh, "--vertices")["pairs"][0]["prediction_points"] == 4
    (pair,) = document(grid, grid, "--samples", 300, "--points", 50)["pairs"]
    assert (pair["target_kind"], pair["target_points"]) == ("voxels", 50)
    assert 0.0 < pair["chamfer"] < 0.05


def test_the_same_seed_gives_the_same_numbers(square, cloud, document):
    b = cloud("b.ply")
    means = [document(square, b, "--samples", 50, "--seed", seed)["mean"] for seed in (1, 1, 2)]
    assert means[0] == means[1] != means[2]


def test_fail_above_prints_the_result_and_then_fails_the_gate(cloud, run, document):
    a, b = cloud("a.ply", 1), cloud("b.ply", 2)
    thousandfold = 1000 * document(a, b)["mean"]["chamfer"]
    assert run(a, b, "--fail-above", thousandfold * 1.01).code == 0
    result = run(a, b, "--json", "--fail-above", thousandfold * 0.99)
    assert result.code == 3
    assert json.loads(result.out)["pairs"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--points", 1], "points is 1"),
        (["--samples", 1], "samples is 1"),
        (["--samples", 10, "--points", 20], "as many as --points"),
        (["--f-score", "--threshold", 0], "threshold is 0"),
        (["--threshold", 1], "--threshold 1 says nothing without --f-score"),
        (["--iou"], "--iou needs --mask"),
        (["--camera", "."], "says nothing without --iou"),
        (["--emd", "--fail-above", 3], "--fail-above bounds the Chamfer"),
        (["--fail-above", "nan"], "expected a number, 0 or more"),
    ],
)
def test_options_that_make_no_sense_are_refused(cloud, options, message, refusal):
    assert message in refusal(cloud("a.ply"), cloud("b.ply"), *options)


@pytest.fixture
def pictured(cloud, tmp_path):
    """A folder with `cloud.ply`, dense and in the left half of the picture, its mask and camera."""
    points = np.stack(
        np.meshgrid(np.linspace(-0.5, 0.0, 40), np.linspace(-0.25, 0.25, 40), 0.0), -1
    ).reshape(-1, 3)
    write_cloud(tmp_path / "cloud.ply", points)
    mask = block(np.s_[8:24, 1:16], (32, 32)) > 0.5
    write_image(tmp_path / "mask.png", mask)
    write_image(tmp_path / "inverse.png", ~mask)
    write_cameras(tmp_path / "camera.json", [CameraRecord(Camera.canonical(32, 32))])
    return tmp_path


def test_iou_compares_the_silhouette_with_the_mask(pictured, document):
    cloud = pictured / "cloud.ply"
    found = document(
        cloud, cloud, "--iou", "--mask", pictured / "mask.png", "--camera", pictured / "camera.json"
    )
    assert found["pairs"][0]["iou"] > 0.85
    assert found["convention"]["iou"] == IOU_MEANS
    assert set(found["mean"]) == {"iou"}
    assert document(cloud, cloud, "--iou", "--mask", pictured / "inverse.png")["mean"]["iou"] < 0.15


def test_sigma_sq_asks_for_the_silhouette_of_the_papers_projector(pictured, document, refusal):
    cloud, mask = pictured / "cloud.ply", pictured / "mask.png"
    found = document(cloud, cloud, "--iou", "--mask", mask, "--sigma-sq", 0.3)
    silhouette = silhouette_of(read_cloud(cloud).points, Camera.canonical(32, 32), 0.3)
    assert found["mean"]["iou"] == iou(silhouette, read_mask(mask))
    assert "Gaussian silhouette (sigma^2 0.3 px^2)" in found["convention"]["iou"]
    assert "says nothing without --iou" in refusal(cloud, cloud, "--sigma-sq", 0.3)


def test_iou_is_the_mean_over_the_views_of_a_camera_file(pictured, document):
    cloud, camera = pictured / "cloud.ply", Camera.canonical(32, 32)
    views = [CameraRecord(camera, mask=pictured / name) for name in ("mask.png", "inverse.png")]
    write_cameras(pictured / "views.json", views)
    single = [document(cloud, cloud, "--iou", "--mask", view.mask)["mean"]["iou"] for view in views]
    (pair,) = document(cloud, cloud, "--iou", "--camera", pictured / "views.json")["pairs"]
    assert (pair["iou"], pair["views"]) == (pytest.approx(np.mean(single)), 2)


def test_masks_and_cameras_of_a_folder_are_found_by_name(pictured, tmp_path, document, refusal):
    for folder in ("clouds", "masks", "cameras"):
        (tmp_path / folder).mkdir()
    clouds, masks, cameras = tmp_path / "clouds", tmp_path / "masks", tmp_path / "cameras"
    for name, mask in (("one", "mask.png"), ("two", "inverse.png")):
        shutil.copy(pictured / "cloud.ply", clouds / f"{name}.ply")
        shutil.copy(pictured / mask, masks / f"{name}.png")
        shutil.copy(pictured / "camera.json", cameras / f"{name}.camera.json")
    found = document(clouds, clouds, "--iou", "--mask", masks, "--camera", cameras)
    assert found["pairs"][0]["iou"] > 0.85 > 0.15 > found["pairs"][1]["iou"]
    assert found == document(
        clouds, clouds, "--iou", "--mask", masks, "--camera", pictured / "camera.json"
    )
    (masks / "two.png").unlink()
    assert "no mask for 'two', expected two.png" in refusal(
        clouds, clouds, "--iou", "--mask", masks
    )


def test_iou_is_of_the_object_that_a_label_names(pictured, document, refusal):
    cloud, labels = pictured / "cloud.ply", pictured / "labels.png"
    codes = (read_mask(pictured / "mask.png") > 0.5).astype(np.uint8)
    codes[8:24, 20:30] = 2
    write_image(labels, codes)
    masked = (cloud, cloud, "--iou", "--mask", labels, "--camera", pictured / "camera.json")
    assert document(*masked, "--label", 1)["mean"]["iou"] > 0.85
    assert document(*masked, "--label", 2)["mean"]["iou"] < 0.15
    assert "say nothing without --iou" in refusal(cloud, cloud, "--label", 1)


def test_iou_is_of_the_picture_without_lens_distortion(pictured, document):
    cloud, mask = pictured / "cloud.ply", pictured / "mask.png"
    lens = dict(w=32, h=32, fl_x=40.0, fl_y=40.0, cx=16.0, cy=16.0)
    camera, to_world = Camera.canonical(32, 32), np.eye(4)
    to_world[:3, :3] = camera.R.T @ np.diag([1.0, -1.0, -1.0])
    to_world[:3, 3] = camera.position
    frame = {"transform_matrix": to_world.tolist(), "mask_path": "mask.png"}
    scores = []
    for k1 in (0.0, 0.6):
        path = pictured / f"transforms_{k1}.json"
        path.write_text(json.dumps({**lens, "k1": k1, "frames": [frame]}))
        (view,) = load_views(ViewFiles([mask], path))[0]
        found = document(cloud, cloud, "--iou", "--mask", mask, "--camera", path)
        assert found["mean"]["iou"] == window_iou(Solid(read_cloud(cloud).points), view)
        scores.append(found["mean"]["iou"])
    assert scores[0] != scores[1]


def test_iou_without_a_fitting_camera_is_refused(pictured, refusal):
    cloud, masked = pictured / "cloud.ply", ("--iou", "--mask", pictured / "mask.png")
    assert "names no mask" in refusal(cloud, cloud, "--iou", "--camera", pictured / "camera.json")
    (pictured / "camera.json").unlink()
    assert "found no mask.camera.json or camera.json next to it" in refusal(cloud, cloud, *masked)
    write_cameras(pictured / "small.json", [CameraRecord(Camera.canonical(16, 32))])
    message = refusal(cloud, cloud, *masked, "--camera", pictured / "small.json")
    assert "16x32" in message
    assert "32x32" in message


def test_progress_counts_the_pairs(cloud):
    pair, reports = Pair("a", cloud("a.ply"), cloud("b.ply")), []
    evaluate([pair] * 3, EvalConfig(), progress=lambda *report: reports.append(report))
    assert reports == [(1, 3), (2, 3), (3, 3)]
