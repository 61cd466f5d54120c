"""A mesh is a surface: points of its faces are moved, and its vertices follow."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from tso_cli.cli import main
from tso_cli.errors import InputError
from tso_cli.evaluation.footprint import window_iou
from tso_cli.evaluation.metrics import chamfer, nearest_squared
from tso_cli.geometry.camera import Camera
from tso_cli.geometry.points import farthest_point_sample, sample_surface
from tso_cli.geometry.view import View
from tso_cli.io.cameras import read_camera
from tso_cli.io.clouds import read_cloud
from tso_cli.io.images import read_mask
from tso_cli.io.meshes import read_mesh
from tso_cli.plots.overlay import AGREED, PANEL, draw_overlay
from tso_cli.refinement import RefineConfig, refine
from tso_cli.refinement.cloud import Cloud
from tso_cli.refinement.run import view_ious
from tso_cli.refinement.surface import SAMPLES, Surface
from tso_cli.render import normalise
from tso_cli.silhouette.projection import silhouette_of

EXAMPLES = Path(__file__).parents[2] / "examples"
CORNERS = np.array([[x, y, z] for x in (-0.25, 0.25) for y in (-0.2, 0.2) for z in (-0.15, 0.15)])
QUADS = np.array([[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]])
BOX = np.concatenate([QUADS[:, [0, 1, 2]], QUADS[:, [0, 2, 3]]])
FRONT = Camera.canonical(64, 64)
BACK = replace(FRONT, R=FRONT.R @ np.diag([-1.0, 1.0, -1.0]))
# Wider by a fifth, as pictures from in front and from behind show it.
WIDE = CORNERS * [1.2, 1.0, 1.0]


def _dense(vertices: np.ndarray, faces: np.ndarray, count: int = 16_384) -> np.ndarray:
    return sample_surface(vertices, faces, count, np.random.default_rng(7))


def _subdivided(vertices: np.ndarray, faces: np.ndarray, times: int) -> tuple[np.ndarray, np.ndarray]:
    """Every triangle in four, so many times; the vertices before stay the first."""
    for _ in range(times):
        edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
        edges, middle = np.unique(edges, axis=0, return_inverse=True)
        a, b, c = (middle.reshape(3, -1) + len(vertices)).tolist()
        i, j, k = faces.T
        vertices = np.concatenate([vertices, vertices[edges].mean(1)])
        faces = np.concatenate([np.stack(own, 1) for own in ([i, a, c], [a, j, b], [c, b, k], [a, b, c])])
    return vertices, faces


@pytest.fixture(scope="module")
def views() -> list[View]:
    solid = _dense(WIDE, BOX)
    return [View((silhouette_of(solid, camera, 0.1) > 0.5).astype(np.float32), camera) for camera in (FRONT, BACK)]


@pytest.fixture(scope="module")
def stretched(views):
    return refine(CORNERS, views, faces=BOX)


def test_a_box_is_stretched_toward_a_wider_mask_and_stays_a_box(stretched):
    size = np.ptp(stretched.points, axis=0) / np.ptp(CORNERS, axis=0)
    assert 1.08 < size[0] < 1.2
    assert (np.abs(size[1:] - 1.0) < 0.06).all()
    # every corner is where three sides of a box meet
    sides = np.stack([stretched.points[:, k].reshape(2, 2, 2).swapaxes(0, k).reshape(2, 4) for k in range(3)])
    assert sides.std(2).max() < 0.01


def test_the_vertices_alone_would_not_have_told(stretched, views):
    alone = refine(CORNERS, views)
    assert alone.surface_samples is None
    assert np.ptp(alone.points[:, 0]) < np.ptp(stretched.points[:, 0]) - 0.02


def test_the_result_is_of_the_vertices_and_its_figures_are_of_the_moved_faces(stretched, views):
    before, after = stretched.surface
    np.testing.assert_array_equal(stretched.initial, CORNERS)
    assert (stretched.points.shape, stretched.surface_samples) == (CORNERS.shape, SAMPLES)
    surface = Surface(CORNERS, BOX)
    np.testing.assert_allclose(after, surface.all_samples(stretched.points), atol=1e-12)
    assert stretched.view_ious == view_ious(before, after, views, views)
    assert all(new > old + 0.04 for old, new in stretched.view_ious)
    moved = surface.at(stretched.points)
    ways = np.linalg.norm(moved - surface.samples, axis=1) / np.ptp(surface.samples, axis=0).max()
    assert (stretched.moved_mean, stretched.moved_max) == pytest.approx((ways.mean(), ways.max()))
    # the longest side is 0.5, to within where samples lie
    assert stretched.chamfer_to_initial == pytest.approx(chamfer(moved, surface.samples).chamfer / 0.25, rel=0.02)


def test_the_iou_of_a_mesh_is_that_of_as_many_points_as_eval_draws(stretched, views):
    """A thousand points would close the holes of a mesh."""
    again = sample_surface(stretched.points, BOX, 16384, np.random.default_rng(5))
    for view, (_, after) in zip(views, stretched.view_ious, strict=True):
        assert window_iou(again, view) == pytest.approx(after, abs=0.01)


def test_the_picture_shows_the_surface_and_not_the_vertices(stretched, views, tmp_path):
    draw_overlay(tmp_path / "picture.png", stretched, views)
    with Image.open(tmp_path / "picture.png") as picture:
        pixels = np.asarray(picture)
    # In four panels a fifth of the mask's pixels at least.
    agreed = (np.abs(pixels - 255.0 * np.array(AGREED)) < 2.0).all(2).sum()
    assert agreed > sum(2 * view.mask.mean() for view in views) * PANEL**2 / 5
    drawn = (pixels[:, -PANEL:] != 255).any(2).sum()
    assert drawn > 0.1 * PANEL**2


def test_a_surface_that_does_not_move_keeps_every_bit(views):
    result = refine(CORNERS + 0.1, views, config=RefineConfig(steps=0), faces=BOX)
    np.testing.assert_array_equal(result.points, CORNERS + 0.1)
    assert result.chamfer_to_initial == 0.0


def test_samples_lie_evenly_however_the_surface_is_cut_into_faces():
    spacings = []
    # One side is cut into a thousand times as many faces as the others.
    fine, faces = _subdivided(CORNERS, BOX[:1], 5)
    uneven = Surface(fine, np.concatenate([faces, BOX[1:]]))
    for surface in (Surface(CORNERS, BOX), Surface(*_subdivided(CORNERS, BOX, 3)), uneven):
        apart = torch.cdist(*[torch.tensor(surface.samples)] * 2).fill_diagonal_(torch.inf).amin(1)
        spacings.append(apart.mean().item())
        assert apart.min() > 0.7 * apart.mean()
        assert nearest_squared(_dense(CORNERS, BOX), surface.samples).max() < (1.5 * apart.mean()) ** 2
    assert max(spacings) < 1.05 * min(spacings)


def test_the_same_mesh_gives_the_same_samples():
    np.testing.assert_array_equal(Surface(CORNERS, BOX).samples, Surface(CORNERS, BOX).samples)


def test_cut_finely_or_coarsely_a_surface_comes_to_the_same_place(stretched, views):
    coarse, fine = (_subdivided(CORNERS, BOX, times) for times in (2, 4))
    ends = [refine(vertices, views, faces=faces).points for vertices, faces in (coarse, fine)]
    many = [_dense(points, faces, 1 << 16) for points, (_, faces) in zip(ends, (coarse, fine), strict=True)]
    way = chamfer(_dense(CORNERS, BOX, 1 << 16), many[1]).chamfer
    assert chamfer(*many).chamfer < 0.1 * way
    # Eight corners cannot bend as the fine surface does, but go where its own go.
    np.testing.assert_allclose(stretched.points, ends[1][:8], atol=0.02)


def test_vertices_in_one_place_stay_in_one_place(stretched, views):
    # Every face has corners of its own, as along the seams of a texture.
    torn = refine(CORNERS[BOX].reshape(-1, 3), views, faces=np.arange(3 * len(BOX)).reshape(-1, 3))
    np.testing.assert_array_equal(torn.points, stretched.points[BOX].reshape(-1, 3))


def test_vertices_that_no_face_has_change_nothing_and_come_along(stretched, views):
    strays = np.array([CORNERS[5], [9.0, 40.0, 0.0]])
    result = refine(np.concatenate([CORNERS, strays]), views, faces=BOX)
    np.testing.assert_array_equal(result.points[:8], stretched.points)
    np.testing.assert_array_equal(result.points[8], stretched.points[5])
    assert np.linalg.norm(result.points[9] - strays[1]) < 0.1


def test_the_two_sides_of_a_sheet_stay_as_far_apart(views):
    vertices, faces = _subdivided(CORNERS * [1.0, 1.0, 0.01], BOX, 3)
    result = refine(vertices, views, faces=faces)
    assert np.ptp(result.points[:, 0]) > 1.1 * np.ptp(vertices[:, 0])
    front = vertices[:, 2] > 0.0014
    order = [np.lexsort(vertices[side, :2].T) for side in (front, vertices[:, 2] < -0.0014)]
    thickness = result.points[front][order[0]] - result.points[vertices[:, 2] < -0.0014][order[1]]
    np.testing.assert_allclose(thickness, np.broadcast_to([0.0, 0.0, 0.003], thickness.shape), atol=0.003)


def test_what_is_linear_on_every_face_is_so_at_the_samples():
    colours = CORNERS + 0.5
    cloud = Cloud(CORNERS, "points", colours, BOX)
    np.testing.assert_allclose(cloud.colours, cloud.initial + 0.5, atol=1e-6)
    assert len(cloud.initial) == SAMPLES


@pytest.mark.parametrize("faces", [np.empty((0, 3), np.int64), [[0, 0, 1], [2, 2, 2]]])
def test_faces_without_area_leave_a_cloud_with_a_warning(faces, views):
    points = _dense(CORNERS, BOX)[:64]
    with pytest.warns(UserWarning, match="points: the faces have no area, the vertices are taken for a cloud"):
        result = refine(points, views, config=RefineConfig(steps=3), faces=faces)
    np.testing.assert_array_equal(result.points, refine(points, views, config=RefineConfig(steps=3)).points)
    assert result.surface is None


def test_a_cloud_of_which_a_few_points_are_joined_is_a_cloud(views):
    points = _dense(CORNERS, BOX)[:64]
    with pytest.warns(UserWarning, match="points: the faces join 3 of 64 vertices, which are therefore taken for a cloud"):
        result = refine(points, views, config=RefineConfig(steps=3), faces=[[0, 1, 2]])
    assert result.surface is None


@pytest.mark.parametrize(
    ("faces", "said"),
    [
        ([[0, 1, 8]], "points: a face names vertex 8, outside 0 to 7"),
        ([[0, 1, -1]], "points: a face names vertex -1, outside 0 to 7"),
        (QUADS, r"points: faces have shape \[6, 4\], expected triangles \[F, 3\]"),
        ([[0.0, 1.0, 2.0]], "points: the faces are float64, expected whole numbers"),
        ([[0, 1, 2], [3]], "points: the faces are no array of whole numbers"),
    ],
)
def test_faces_that_are_no_triangles_of_the_points_are_refused(faces, said, views):
    with pytest.raises(InputError, match=said):
        refine(CORNERS, views, faces=faces)


def test_tensors_say_the_same_as_arrays(stretched, views):
    result = refine(torch.tensor(CORNERS), views, faces=torch.tensor(BOX))
    np.testing.assert_array_equal(result.points, stretched.points)


def test_example_meshes_come_as_near_to_the_truth_as_clouds_of_their_samples():
    apart = []
    for path in sorted((EXAMPLES / "meshes").glob("*/*.ply"))[::5]:
        category = path.parent.name
        mesh = normalise(read_mesh(path))
        mask = read_mask(EXAMPLES / category / "mask.png")
        camera = read_camera(EXAMPLES / category / "camera.json", mask.shape[1], mask.shape[0])
        target = read_cloud(EXAMPLES / category / "target.ply").points
        result = refine(mesh.vertices, mask, camera, faces=mesh.faces)
        cloud = refine(result.surface[0], mask, camera)
        many = [_dense(vertices, mesh.faces) for vertices in (mesh.vertices, result.points)]
        anew = [samples[farthest_point_sample(samples, SAMPLES)] for samples in many]
        pairs = (cloud.initial, cloud.points), result.surface, anew
        alone, carried, sampled = (chamfer(after, target).chamfer / chamfer(before, target).chamfer for before, after in pairs)
        assert carried < alone + 0.03
        apart.append(sampled - alone)
    assert np.mean(apart) < 0.03


PLY = """ply
format ascii 1.0
comment a box
element vertex 8
property float x
property float y
property float z
property float nx
property float ny
property float nz
property uchar red
property uchar green
property uchar blue
element face {count}
property list uchar int vertex_indices
property uchar flags
end_header
{vertices}
{faces}
"""


def _ply(polygons: list[list[int]]) -> str:
    vertices = [
        f"{x:.9g} {y:.9g} {z:.9g} 0 0 1 {9 * i} 20 30" for i, (x, y, z) in enumerate(CORNERS.astype(np.float32).tolist())
    ]
    faces = [f"{len(corners)} {' '.join(map(str, corners))} {i}" for i, corners in enumerate(polygons)]
    return PLY.format(count=len(polygons), vertices="\n".join(vertices), faces="\n".join(faces))


@pytest.fixture
def folder(tmp_path, monkeypatch, views):
    monkeypatch.chdir(tmp_path)
    Path("box.ply").write_text(_ply(QUADS.tolist()))
    Image.fromarray((255 * views[0].mask).astype(np.uint8)).save("mask.png")
    return tmp_path


def run(*words: str) -> int:
    with pytest.raises(SystemExit) as stopped:
        main(["refine", *words])
    return stopped.value.code


def test_the_file_that_comes_out_differs_in_its_coordinates_alone(folder, capsys, views):
    assert run("box.ply", "mask.png", "-o", "out.ply", "--overlay", "picture.png") == 0
    out, err = capsys.readouterr()
    assert "out.ply: 8 vertices, which follow 1,024 points of the faces" in out
    assert "the normals are those of box.ply" in err
    before, after = (Path(name).read_text().splitlines() for name in ("box.ply", "out.ply"))
    assert len(before) == len(after)
    body = before.index("end_header") + 1
    for number, (old, new) in enumerate(zip(before, after, strict=True)):
        vertex = body <= number < body + 8
        assert (old.split()[3:] == new.split()[3:] and old != new) if vertex else old == new
    start = read_cloud("box.ply")
    expected = refine(start.points, views[:1], faces=start.faces())
    np.testing.assert_allclose(read_cloud("out.ply").points, expected.points, rtol=1e-6)
    with Image.open("picture.png") as picture:
        assert picture.size[0] > 0


def test_json_tells_how_many_points_of_the_surface_were_moved(folder, capsys):
    found = []
    Path("cloud.ply").write_text(_ply([]))
    for words in (("box.ply",), ("cloud.ply",), ("box.ply", "--check"), ("cloud.ply", "--check")):
        assert run(words[0], "mask.png", "--json", "--overwrite", "-o", "out.ply", *words[1:]) == 0
        found.append(json.loads(capsys.readouterr().out)["surface_samples"])
    assert found == [SAMPLES, None, SAMPLES, None]


def test_colours_of_the_vertices_are_compared_with_a_photo(folder, capsys):
    Image.fromarray(np.full((64, 64, 3), 90, np.uint8)).save("photo.png")
    assert run("box.ply", "mask.png", "--image", "photo.png", "-o", "out.ply") == 0


@pytest.mark.parametrize("wrong", [8, -1])
def test_a_face_of_a_vertex_that_is_not_there_is_refused_in_one_line(folder, capsys, wrong):
    Path("bad.ply").write_text(_ply([[0, 1, 2], [0, 1, 3, wrong]]))
    assert run("bad.ply", "mask.png") == 2
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1
    assert f"bad.ply: a face names vertex {wrong}, expected 0 to 7" in lines[0]
    assert not list(folder.glob("*.refined.ply"))
