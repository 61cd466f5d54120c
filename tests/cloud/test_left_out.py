"""Points that masks leave out: they stay, change nothing else, and `--crop` leaves them out."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from tests.scenes import EXAMPLES, example
from tso_cli import Camera, View, read_cloud, write_cloud
from tso_cli.cloud.cloud import Cloud
from tso_cli.cloud.left_out import find_left_out
from tso_cli.errors import InputError
from tso_cli.evaluation.footprint import footprint
from tso_cli.refinement import refine

NAMES = pytest.mark.parametrize("name", ["airplane", "car", "chair"])
CHAIR = example("chair")


def with_floor(points, times=2.0, count=600):
    """A cloud [N, 3] and a floor under it, ``times`` as wide."""
    low, high = points.min(0), points.max(0)
    width = times * (high - low)[[0, 2]].max()
    floor = (low + high) / 2 + width * np.random.default_rng(0).uniform(-0.5, 0.5, (count, 3))
    floor[:, 1] = low[1]
    return np.concatenate([points, floor])


def views_around(points, count):
    """Views of a cloud [N, 3], from all sides and slightly above."""
    middle, size = points.mean(0), np.ptp(points, axis=0).max()
    views = []
    for angle in np.linspace(0.0, 2.0 * np.pi, count, endpoint=False):
        back = np.array([np.sin(angle), 0.3, np.cos(angle)])
        back /= np.linalg.norm(back)
        right = np.cross([0.0, 1.0, 0.0], back)
        right /= np.linalg.norm(right)
        R = np.stack([right, -np.cross(back, right), -back])
        K = np.array([[240.0, 0.0, 63.5], [0.0, 240.0, 63.5], [0.0, 0.0, 1.0]])
        camera = Camera(K=K, R=R, t=-R @ (middle + 3.0 * size * back), width=128, height=128)
        views.append(View(footprint(points, camera).astype(np.float32), camera))
    return views


@NAMES
def test_a_longer_object_is_no_other_object(name):
    """Its ends lie outside of the masks, and the rest fits."""
    scene = example(name)
    longest = np.argmax(np.ptp(scene.target, axis=0))
    longer = scene.target * np.where(np.arange(3) == longest, 1.3, 1.0)
    views = views_around(scene.target, 2)
    assert not Cloud(longer, "cloud").controlled(views=views).left_out.any()


@pytest.mark.parametrize("count", [1, 4, 30])
@pytest.mark.parametrize(
    ("name", "start"),
    [(name, "target") for name in ("airplane", "car", "chair")]
    + [(name, "points") for name in ("car", "chair")],
)
def test_a_floor_is_left_out_under_right_and_other_clouds(name, start, count):
    scene = example(name)
    points = getattr(scene, start)
    cloud = with_floor(points)
    left = Cloud(cloud, "cloud").controlled(views=views_around(scene.target, count)).left_out
    assert left[len(points) :].mean() > 0.9
    assert left[: len(points)].mean() < 0.15


@NAMES
@pytest.mark.parametrize("count", [1, 4, 30])
def test_no_point_of_a_cloud_of_another_shape_size_or_place_is_left_out(name, count):
    scene = example(name)
    views, middle = views_around(scene.target, count), scene.target.mean(0)
    larger = middle + 1.15 * (scene.target - middle)
    shifted = scene.target + [0.0, 0.0, 0.2]
    turned = middle + (scene.target - middle)[:, [2, 1, 0]]
    for points in (scene.target, scene.points, larger, shifted, turned):
        assert find_left_out(points, views) is None


def test_the_result_is_that_of_the_object_alone_and_a_note_counts_the_floor():
    cloud = with_floor(CHAIR.points)
    views = views_around(CHAIR.target, 4)
    alone, result = refine(CHAIR.points, views), refine(cloud, views)
    floor = result.outliers
    count = len(CHAIR.points)
    assert floor[count:].all()
    (note,) = [one for one in result.findings if one.name == "left-out"]
    assert note.values["count"] == floor.sum()
    assert note.values["share"] == pytest.approx(100.0 * floor.mean())
    np.testing.assert_array_equal(result.points[floor], cloud[floor])
    before = CHAIR.error(CHAIR.points)
    ratios = [CHAIR.error(some) / before for some in (alone.points, result.points[:count])]
    assert ratios[0] < 0.9
    assert ratios[1] == pytest.approx(ratios[0], abs=0.1)


def test_strewn_points_are_left_out_around_a_right_cloud():
    low, high = CHAIR.target.min(0), CHAIR.target.max(0)
    strewn = np.random.default_rng(1).uniform(low - 0.2, high + 0.2, (60, 3))
    cloud = np.concatenate([CHAIR.target, strewn])
    left = Cloud(cloud, "cloud").controlled(views=views_around(CHAIR.target, 4)).left_out
    assert not left[:-60].any()
    assert left[-60:].mean() > 0.3


def test_the_floor_of_a_mesh_stays_and_only_its_faces_are_left_out():
    mesh = trimesh.load(next((EXAMPLES / "meshes/chair").glob("*.ply")), process=False)
    points, (low, high) = mesh.vertices, mesh.bounds
    views = views_around(mesh.sample(4096, seed=0), 4)
    x, z = np.meshgrid(*(np.linspace(-1.0, 1.0, 12) * (high - low).max(),) * 2)
    ground = np.stack([x.ravel(), np.full(144, low[1]), z.ravel()], 1)
    cells = (np.arange(11)[:, None] * 12 + np.arange(11)).ravel()
    faces = np.concatenate([cells[:, None] + [0, 1, 12], cells[:, None] + [1, 13, 12]])
    cloud = Cloud(
        np.concatenate([points, ground]),
        "mesh",
        faces=np.concatenate([mesh.faces, faces + len(points)]),
    )
    controlled = cloud.controlled(views=views)
    assert controlled.outliers[len(points) :].all()
    assert controlled.outliers[: len(points)].mean() < 0.05
    moved = controlled.moved(np.full((len(controlled.control_points), 3), 0.1))
    np.testing.assert_array_equal(moved.points[len(points) :], ground)
    assert not np.isclose(moved.points, cloud.points)[~controlled.outliers].any()


def test_a_view_that_sees_no_point_leaves_none_out():
    camera = replace(CHAIR.camera, t=CHAIR.camera.t - [0.0, 0.0, 100.0])
    assert find_left_out(CHAIR.points, [View(CHAIR.mask, camera)]) is None


# Files of the object alone


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_a_cropped_mesh_keeps_whole_faces_and_all_numbers_of_its_vertices(tmp_path, encoding):
    mesh = trimesh.creation.box()
    mesh.visual.vertex_colors = np.arange(32).reshape(8, 4)
    (tmp_path / "box.ply").write_bytes(mesh.export(file_type="ply", encoding=encoding))
    file = read_cloud(tmp_path / "box.ply")
    kept = np.ones(8, bool)
    kept[2] = False
    write_cloud(tmp_path / "cut.ply", file.points + 1.0, like=file, kept=kept)
    cut = read_cloud(tmp_path / "cut.ply")
    np.testing.assert_allclose(cut.points, file.points[kept] + 1.0)
    np.testing.assert_array_equal(cut.colours(), file.colours()[kept])
    whole = kept[mesh.faces].all(1)
    np.testing.assert_array_equal(
        cut.points[cut.faces()], (file.points + 1.0)[mesh.faces[whole]].round(6)
    )


@pytest.mark.parametrize("suffix", [".npy", ".xyz"])
def test_points_alone_are_cropped_too(tmp_path, suffix):
    points = np.arange(12.0).reshape(4, 3)
    write_cloud(tmp_path / f"cut{suffix}", points, kept=points[:, 0] > 2.0)
    np.testing.assert_array_equal(read_cloud(tmp_path / f"cut{suffix}").points, points[1:])


def test_a_file_that_is_written_whole_or_names_vertices_elsewhere_is_not_cropped(tmp_path):
    points = np.arange(12.0).reshape(4, 3)
    with pytest.raises(InputError, match=r"expected \.ply or \.npy or \.xyz"):
        write_cloud(tmp_path / "cut.glb", points, like=None, kept=points[:, 0] > 2.0)
    text = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\n"
    text += "property float z\nelement edge 1\nproperty int vertex1\nproperty int vertex2\n"
    (tmp_path / "a.ply").write_text(f"{text}end_header\n0 0 0\n1 0 0\n0 1\n")
    file = read_cloud(tmp_path / "a.ply")
    with pytest.raises(InputError, match="holds 'edge' besides vertices and faces"):
        write_cloud(tmp_path / "b.ply", file.points, like=file, kept=np.array([True, False]))
