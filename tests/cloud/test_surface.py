"""Meshes: control points of the surface move, and the vertices follow."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.spatial import cKDTree
from trimesh.remesh import subdivide

from tests.corruption import assert_refused
from tso_cli import Camera, RefineConfig, View, refine
from tso_cli.cloud.cloud import Cloud
from tso_cli.cloud.control_points import CONTROL_POINTS
from tso_cli.cloud.interpolation import INTERPOLATED_FROM, falling_weights
from tso_cli.cloud.surface import RIDGE, SOLVED, Surface, SurfaceSamples
from tso_cli.diagnosis.findings import Finding
from tso_cli.evaluation.footprint import Solid, common_window, window_iou
from tso_cli.evaluation.metrics import chamfer, nearest_squared
from tso_cli.geometry.points import sample_surface
from tso_cli.io.clouds import read_cloud
from tso_cli.losses.chamfer import spacings
from tso_cli.losses.silhouette import silhouette_of

CORNERS = np.array([[x, y, z] for x in (-0.25, 0.25) for y in (-0.2, 0.2) for z in (-0.15, 0.15)])
QUADS = np.array(
    [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
)
BOX = np.concatenate([QUADS[:, [0, 1, 2]], QUADS[:, [0, 2, 3]]])
FRONT = Camera.canonical(64, 64)
BACK = replace(FRONT, R=FRONT.R @ np.diag([-1.0, 1.0, -1.0]))
# Wider by a fifth, as the front and back views show it.
WIDE = CORNERS * [1.2, 1.0, 1.0]


def _dense(vertices: np.ndarray, faces: np.ndarray, count: int = 16_384) -> np.ndarray:
    return sample_surface(vertices, faces, count, np.random.default_rng(7))


def _subdivided(
    vertices: np.ndarray, faces: np.ndarray, times: int
) -> tuple[np.ndarray, np.ndarray]:
    """Every triangle in four, so many times; the vertices before stay the first."""
    for _ in range(times):
        vertices, faces = subdivide(vertices, faces)
    return vertices, faces


# A stretched box is far from its masks: whether a result is sure is not asked here.
MOVES = RefineConfig(accept_doubtful=True)


@pytest.fixture(scope="module")
def views() -> list[View]:
    solid = _dense(WIDE, BOX)
    return [
        View(np.float32(silhouette_of(solid, camera, 0.1) > 0.5), camera)
        for camera in (FRONT, BACK)
    ]


@pytest.fixture(scope="module")
def stretched(views):
    return refine(CORNERS, views, config=MOVES, faces=BOX)


def test_a_box_is_stretched_to_a_wider_mask_further_than_its_corners_alone_and_stays_a_box(
    stretched, views
):
    size = np.ptp(stretched.points, axis=0) / np.ptp(CORNERS, axis=0)
    # A pixel of the masks is a thirtieth of the width.
    assert 1.08 < size[0] < 1.2 + 1 / 30
    assert abs(size[1] - 1.0) < 0.08
    # No mask shows the depth: the learned prior lets it grow along, less than the width.
    assert 0.94 < size[2] < size[0]
    # Each corner lies where three sides of a box meet.
    sides = np.stack(
        [stretched.points[:, k].reshape(2, 2, 2).swapaxes(0, k).reshape(2, 4) for k in range(3)]
    )
    assert sides.std(2).max() < 0.01
    alone = refine(CORNERS, views, config=MOVES)
    assert alone.control_points == len(alone.points)
    assert np.ptp(alone.points[:, 0]) < np.ptp(stretched.points[:, 0]) - 0.02


def test_a_result_of_a_mesh_is_measured_at_many_points_of_its_faces(stretched, views):
    before, after = stretched.measured
    surface = Surface(CORNERS, BOX)
    np.testing.assert_array_equal(stretched.initial, CORNERS)
    assert stretched.of_mesh
    assert stretched.control_points == CONTROL_POINTS
    np.testing.assert_allclose(before, surface.at(CORNERS), atol=1e-12)
    np.testing.assert_allclose(after, surface.at(stretched.points), atol=1e-12)
    solids = Solid(CORNERS, BOX), Solid(stretched.points, BOX)
    for view, of_view in zip(views, stretched.views, strict=True):
        box = common_window([(solid, view) for solid in solids])
        assert of_view.iou_before == window_iou(solids[0], view, box)
        assert of_view.iou_after == window_iou(solids[1], view, box)
        assert of_view.iou_after > of_view.iou_before + 0.04


def test_the_displacements_of_a_mesh_are_those_of_its_control_points(stretched):
    samples = SurfaceSamples(Surface(CORNERS, BOX), CONTROL_POINTS)
    moved = samples.at_control_points(stretched.points)
    lengths = np.linalg.norm(moved - samples.control_points, axis=1)
    lengths /= np.ptp(samples.control_points, axis=0).max()
    assert stretched.fit.moved_mean == pytest.approx(lengths.mean())
    assert stretched.fit.moved_max == pytest.approx(lengths.max())
    # The longest side is 0.5.
    assert stretched.fit.chamfer_to_initial == pytest.approx(
        chamfer(moved, samples.control_points).chamfer / 0.25, rel=0.02
    )


@pytest.mark.parametrize("times", [0, 2])
def test_the_faces_carry_the_control_points_where_they_should_go(times):
    """At edges and tips the mean of the nearest control points alone would lag behind."""
    samples = SurfaceSamples(Surface(*_subdivided(CORNERS, BOX, times)), CONTROL_POINTS)
    wanted = samples.control_points * [0.2, 0.0, 0.0]
    carried = samples.at_control_points(samples.follow(wanted))
    np.testing.assert_allclose(carried, wanted, atol=4e-4)


def test_zero_steps_return_the_vertices_bit_for_bit(views):
    result = refine(CORNERS + 0.1, views, config=RefineConfig(steps=0), faces=BOX)
    np.testing.assert_array_equal(result.points, CORNERS + 0.1)
    assert result.fit.chamfer_to_initial == 0.0


def test_control_points_are_even_however_the_surface_is_triangulated():
    means = []
    # One side has a thousand times as many faces as the others.
    fine, faces = _subdivided(CORNERS, BOX[:1], 5)
    uneven = Surface(fine, np.concatenate([faces, BOX[1:]]))
    for surface in (Surface(CORNERS, BOX), Surface(*_subdivided(CORNERS, BOX, 3)), uneven):
        points = SurfaceSamples(surface, CONTROL_POINTS).control_points
        distance = spacings(points)
        means.append(distance.mean())
        assert distance.min() > 0.7 * distance.mean()
        gaps = np.sqrt(nearest_squared(_dense(CORNERS, BOX), points))
        assert gaps.max() < 1.5 * distance.mean()
    assert max(means) < 1.05 * min(means)


@pytest.mark.slow
def test_the_triangulation_hardly_changes_the_result(stretched, views):
    coarse, fine = (_subdivided(CORNERS, BOX, times) for times in (2, 4))
    results = [
        refine(vertices, views, config=MOVES, faces=faces).points
        for vertices, faces in (coarse, fine)
    ]
    surfaces = [
        _dense(points, faces, 1 << 16)
        for points, (_, faces) in zip(results, (coarse, fine), strict=True)
    ]
    displacement = chamfer(_dense(CORNERS, BOX, 1 << 16), surfaces[1]).chamfer
    assert chamfer(*surfaces).chamfer < 0.1 * displacement
    # Eight corners cannot bend as the fine surface does.
    np.testing.assert_allclose(stretched.points, results[1][:8], atol=0.03)


@pytest.mark.parametrize("most", [40, 600])
def test_the_correction_is_that_of_a_dense_solution(most, monkeypatch):
    # Their distances differ, so that no two control points are equally near.
    vertices, faces = _subdivided(CORNERS, BOX, 4)
    vertices = vertices + np.random.default_rng(1).normal(size=vertices.shape) * 1e-3
    samples = SurfaceSamples(Surface(vertices, faces), most)
    wanted = np.random.default_rng(0).normal(size=samples.control_points.shape)
    distance, near = cKDTree(samples.control_points).query(vertices, INTERPOLATED_FROM)
    of_vertices = np.zeros((len(vertices), len(wanted)))
    np.put_along_axis(of_vertices, near, falling_weights(distance), 1)
    carried = samples.at_control_points(of_vertices)
    normal = carried.T @ carried + RIDGE * np.eye(len(wanted))
    corrected = wanted + np.linalg.solve(normal, carried.T @ (wanted - carried @ wanted))
    exact = of_vertices @ corrected
    np.testing.assert_allclose(samples.follow(wanted), exact, atol=SOLVED * np.abs(wanted).max())
    monkeypatch.setattr("tso_cli.cloud.surface.SOLVED", 1e-10)
    np.testing.assert_allclose(samples.follow(wanted), exact, atol=1e-9)
    assert not samples.follow(0.0 * wanted).any()


def test_duplicates_of_a_vertex_stay_together(stretched, views):
    # No two faces share a vertex, as along texture seams.
    faces = np.arange(3 * len(BOX)).reshape(-1, 3)
    split = refine(CORNERS[BOX].reshape(-1, 3), views, config=MOVES, faces=faces)
    np.testing.assert_array_equal(split.points, stretched.points[BOX].reshape(-1, 3))


def test_colours_are_interpolated_linearly_at_the_control_points():
    colours = CORNERS + 0.5
    cloud = Cloud(CORNERS, "points", colours, BOX).controlled()
    np.testing.assert_allclose(cloud.colours, cloud.control_points + 0.5, atol=1e-6)
    assert len(cloud.control_points) == CONTROL_POINTS


@pytest.mark.parametrize(
    ("faces", "reason"),
    [
        (np.empty((0, 3), np.int64), "the faces join 0 of 64 vertices"),
        (np.arange(64)[:, None].repeat(3, 1), "the faces have no area"),
        ([[0, 1, 2]], "the faces join 3 of 64 vertices"),
    ],
)
def test_a_mesh_without_area_or_whose_faces_join_few_vertices_is_taken_for_a_cloud(
    faces, reason, views
):
    points, config = _dense(CORNERS, BOX)[:64], RefineConfig(steps=3)
    result = refine(points, views, config=config, faces=faces)
    assert Finding("not-a-mesh", values={"why": reason}) in result.findings
    assert not result.of_mesh
    np.testing.assert_array_equal(result.points, refine(points, views, config=config).points)


@pytest.mark.parametrize(
    ("faces", "message"),
    [
        ([[0, 1, 8]], "points: a face names vertex 8, expected 0 to 7"),
        ([[0, 1, -1]], "points: a face names vertex -1, expected 0 to 7"),
        (QUADS, r"points: faces have shape \[6, 4\], expected triangles \[F, 3\]"),
        ([[0.0, 1.0, 2.0]], "points: the faces are float64, expected whole numbers"),
        ([[0, 1, 2], [3]], "points: the faces are not an array of whole numbers"),
    ],
)
def test_faces_that_are_no_triangles_are_refused(faces, message, views):
    assert_refused(message, refine, CORNERS, views, faces=faces)


def test_vertices_without_faces_change_nothing_and_follow_the_surface(stretched, views):
    loose = np.array([CORNERS[5], [9.0, 40.0, 0.0]])
    result = refine(np.concatenate([CORNERS, loose]), views, config=MOVES, faces=BOX)
    np.testing.assert_array_equal(result.points[:8], stretched.points)
    np.testing.assert_array_equal(result.points[8], stretched.points[5])
    assert np.linalg.norm(result.points[9] - loose[1]) < 0.1


def test_a_thin_sheet_keeps_its_thickness(views):
    vertices, faces = _subdivided(CORNERS * [1.0, 1.0, 0.01], BOX, 3)
    result = refine(vertices, views, config=MOVES, faces=faces)
    assert np.ptp(result.points[:, 0]) > 1.1 * np.ptp(vertices[:, 0])
    sides = vertices[:, 2] > 0.0014, vertices[:, 2] < -0.0014
    front, back = (result.points[side][np.lexsort(vertices[side, :2].T)] for side in sides)
    np.testing.assert_allclose(front, back + [0.0, 0.0, 0.003], atol=0.003)


def test_the_written_file_differs_from_the_input_in_its_coordinates_alone(
    tmp_path, monkeypatch, tso, views
):
    monkeypatch.chdir(tmp_path)
    properties = "".join(f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz"))
    header = f"ply\nformat ascii 1.0\ncomment a box\nelement vertex 8\n{properties}element face 6\n"
    vertices = "".join(
        f"{x:.9g} {y:.9g} {z:.9g} 0 0 1\n" for x, y, z in CORNERS.astype(np.float32).tolist()
    )
    faces = "".join(
        f"4 {' '.join(map(str, corners))} {flag}\n" for flag, corners in enumerate(QUADS.tolist())
    )
    header += "property list uchar int vertex_indices\nproperty uchar flags\nend_header\n"
    Path("box.ply").write_text(header + vertices + faces)
    Image.fromarray((255 * views[0].mask).astype(np.uint8)).save("mask.png")
    run = tso("refine", "box.ply", "mask.png", "-o", "out.ply", "--accept-doubtful")
    assert run.code == 0
    assert "the normals are those of box.ply" in run.err
    assert "out.ply: 8 vertices, which follow 1,024 points of the faces" in run.out
    before, after = (Path(name).read_text().splitlines() for name in ("box.ply", "out.ply"))
    body = before.index("end_header") + 1
    for number, (old, new) in enumerate(zip(before, after, strict=True)):
        vertex = body <= number < body + 8
        assert (old == new) != vertex
        if vertex:
            assert old.split()[3:] == new.split()[3:]
    start = read_cloud("box.ply")
    expected = refine(start.points, views[:1], config=MOVES, faces=start.faces())
    np.testing.assert_allclose(read_cloud("out.ply").points, expected.points, rtol=1e-6)
