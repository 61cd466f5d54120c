import numpy as np
import pytest

from tests.corruption import assert_reads_or_refuses, assert_refused
from tso_cli.io import shapes
from tso_cli.io.clouds import write_cloud
from tso_cli.io.shapes import grid_surface, read_shape, shape_kind

SQUARE_OFF = "OFF\n4 2 0\n0 0 0\n2 0 0\n2 2 0\n0 2 0\n3 0 1 2\n3 0 2 3\n"
SQUARE_PLY = (
    "ply\nformat ascii 1.0\ncomment element face 0\nelement vertex 4\n"
    "property float x\nproperty float y\nproperty float z\n"
    "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
    "0 0 0\n2 0 0\n2 2 0\n0 2 0\n3 0 1 2\n3 0 2 3\n"
)


def binvox_bytes(grid, translate="0 0 0", scale="1"):
    """``grid`` [X, Y, Z] in runs, y fastest, then z, then x."""
    order = grid.astype(np.uint8).transpose(0, 2, 1).ravel()
    runs = b""
    for run in np.split(order, np.flatnonzero(np.diff(order)) + 1):
        whole, rest = divmod(len(run), 255)
        runs += bytes([run[0], 255]) * whole + bytes([run[0], rest]) * (rest > 0)
    depth, width, height = grid.shape
    head = f"#binvox 1\ndim {depth} {height} {width}\ntranslate {translate}\nscale {scale}\ndata\n"
    return head.encode() + runs


def ball(side, radius):
    """A ball in the middle of a cube of ``side`` voxels, whose longest side is 1."""
    axis = (np.arange(side) + 0.5) / side - 0.5
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    return np.sqrt(x**2 + y**2 + z**2) < radius


@pytest.mark.parametrize("name", ["ball.npy", "ball.binvox"])
def test_points_of_a_voxel_ball_lie_near_the_sphere(save, name):
    grid = ball(32, 0.3)
    path = save(name, grid if name.endswith("npy") else binvox_bytes(grid, "-0.5 -0.5 -0.5"))
    points = read_shape(path, 2000)
    assert points.shape == (2000, 3)
    assert points.dtype == np.float64
    assert np.abs(np.linalg.norm(points, axis=1) - 0.3).max() < 1.2 / 32
    assert np.abs(points.mean(0)).max() < 0.02


def test_axes_of_both_grids_are_x_y_z(save):
    grid = np.zeros((8, 8, 8), dtype=bool)
    grid[1, 3, 6] = True
    vertices, _ = grid_surface(save("a.npy", grid))
    np.testing.assert_allclose(
        (vertices.min(0) + vertices.max(0)) / 2, (np.array([1, 3, 6]) + 0.5) / 8 - 0.5, atol=1e-6
    )
    grid[1:4, 3:5, 6] = grid[2, 3, 7] = True  # no two axes and no two directions of an axis alike
    expected, _ = grid_surface(save("a.npy", grid))
    vertices, _ = grid_surface(save("a.binvox", binvox_bytes(grid)))
    np.testing.assert_allclose(
        vertices, expected - (expected.min(0) + expected.max(0)) / 2, atol=1e-6
    )


def test_the_scale_of_a_binvox_file_counts_and_its_occupied_part_is_centred(save):
    grid = np.zeros((4, 4, 4), dtype=bool)
    grid[:3, 1:, :2] = True
    vertices, _ = grid_surface(save("cube.binvox", binvox_bytes(grid, "10 20 30", "2")))
    np.testing.assert_allclose(
        [vertices.min(0), vertices.max(0)], [[-0.75, -0.75, -0.5], [0.75, 0.75, 0.5]], atol=1e-6
    )


def test_the_surface_of_a_grid_is_closed_at_its_border_and_its_longest_side_is_1(save):
    vertices, faces = grid_surface(save("full.npy", np.ones((4, 10, 2))))
    edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()
    np.testing.assert_allclose(
        [vertices.min(0), vertices.max(0)], [[-0.2, -0.5, -0.1], [0.2, 0.5, 0.1]], atol=1e-6
    )


def test_soft_occupancy_places_the_surface_between_voxels(save):
    grid = np.zeros((4, 4, 10))
    grid[:, :, :5] = 1.0
    grid[:, :, 5] = 0.25
    vertices, _ = grid_surface(save("soft.npy", grid))
    # The middle of voxel 4 is at -0.05. The value falls from 1 to 0.25 over one voxel, and passes
    # 0.5 after two thirds.
    assert vertices[:, 2].max() == pytest.approx(-0.05 + 0.1 * 2 / 3, abs=1e-6)


@pytest.mark.parametrize("dtype", [bool, np.int32, ">f4", np.float16])
def test_grids_of_any_number_type_are_read(save, dtype):
    expected = grid_surface(save("a.npy", ball(8, 0.3)))[0]
    np.testing.assert_allclose(
        grid_surface(save("b.npy", np.asfortranarray(ball(8, 0.3).astype(dtype))))[0], expected
    )


def test_what_is_in_a_file_decides_how_it_is_read(save, tmp_path):
    write_cloud(tmp_path / "cloud.ply", np.eye(3))
    assert shape_kind(tmp_path / "cloud.ply") == "cloud"
    assert shape_kind(save("mesh.ply", SQUARE_PLY)) == "mesh"
    assert shape_kind(save("none.ply", SQUARE_PLY.replace("face 2", "face 0"))) == "cloud"
    assert shape_kind(save("crlf.ply", SQUARE_PLY.replace("\n", "\r\n"))) == "mesh"
    assert shape_kind(save("grid.npy", np.ones((2, 3, 4)))) == "voxels"
    assert shape_kind(save("cloud.npy", np.ones((4, 3)))) == "cloud"
    assert shape_kind(tmp_path / "not_there.off") == "mesh"


@pytest.mark.parametrize("name", ["square.off", "square.ply"])
def test_a_mesh_gives_points_of_its_surface_or_on_request_its_vertices(save, name):
    path = save(name, SQUARE_OFF if name.endswith("off") else SQUARE_PLY)
    points = read_shape(path, 300, seed=1)
    assert points.shape == (300, 3)
    assert len(np.unique(points, axis=0)) == 300
    assert (points[:, 2] == 0).all()
    assert 0 <= points.min() <= points.max() <= 2
    np.testing.assert_array_equal(points, read_shape(path, 300, seed=1))
    assert not np.array_equal(points, read_shape(path, 300, seed=2))
    assert sorted(read_shape(path, 300, as_vertices=True).tolist()) == [
        [0, 0, 0],
        [0, 2, 0],
        [2, 0, 0],
        [2, 2, 0],
    ]


GOOD = binvox_bytes(ball(6, 0.4))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty"),
        (b"#binvox 2\n", "expected a .binvox header"),
        (GOOD[:40], "expected a .binvox header"),
        (GOOD.replace(b"dim 6 6 6", b"dim 6 6"), "not enough values .*, expected dim of three"),
        (GOOD.replace(b"dim 6 6 6\n", b""), "dim is missing"),
        (GOOD.replace(b"dim 6 6 6", b"dim 6 6 6.5"), "6.5"),
        (GOOD.replace(b"dim 6 6 6", b"dim 0 6 6"), "dim 0 6 6"),
        (GOOD.replace(b"dim 6 6 6", b"dim 10000 10000 10000"), "1 to 134,217,728 voxels"),
        (GOOD.replace(b"dim 6 6 6", b"dim 6 6 7"), "216 voxels.*, expected runs .* 252 voxels"),
        (GOOD.replace(b"scale 1", b"scale 0"), "scale 0"),
        (GOOD.replace(b"scale 1", b"scale nan"), "scale nan"),
        (GOOD[:-1], "expected runs of 0 or 1"),
        (GOOD[:-2], "expected runs .* that hold 216 voxels"),
        (GOOD[:-2] + b"\x02" + GOOD[-1:], "expected runs of 0 or 1"),
        (binvox_bytes(np.zeros((4, 4, 4))), "no voxel of the 4 x 4 x 4 grid"),
        (np.full((3, 3, 3), np.nan), "NaN"),
        (np.ones((3, 0, 3)), "expected 1 to"),
        (np.ones((3, 3, 3), complex), "expected a grid of numbers"),
        (np.full((3, 3, 3), None), "expected numbers"),
    ],
)
def test_a_wrong_grid_is_refused_in_one_line(save, content, message):
    path = save("bad.binvox" if isinstance(content, bytes) else "bad.npy", content)
    assert_refused(f"{path.name}: .*{message}", read_shape, path, 10)


def test_a_grid_too_large_to_turn_into_a_surface_is_refused(save, monkeypatch):
    monkeypatch.setattr(shapes, "MAX_VOXELS", 26)
    for path in (
        save("a.npy", np.ones((3, 3, 3))),
        save("a.binvox", binvox_bytes(np.ones((3, 3, 3)))),
    ):
        assert_refused("1 to 26 voxels", read_shape, path, 10)


def test_paths_without_a_shape_are_refused(tmp_path, save):
    for path in (
        save("a.png", b"x"),
        tmp_path / "missing.ply",
        tmp_path / "missing.binvox",
        tmp_path / "missing.off",
    ):
        assert_refused(path.name, read_shape, path)
    (tmp_path / "folder.npy").mkdir()
    assert_refused("is a folder", read_shape, tmp_path / "folder.npy")


@pytest.mark.parametrize("name", ["good.binvox", "good.npy"])
def test_any_damage_to_a_grid_is_read_or_refused(save, name):
    path = save(name, GOOD if name.endswith("binvox") else ball(6, 0.4).astype(np.float32))
    read, refused = assert_reads_or_refuses(lambda path: read_shape(path, 4), path, 150)
    assert read > 0
    assert refused > 30
