"""Gaussian splats: opacity, colour, and the formats that have to be exported first."""

import numpy as np
import pytest

from tests.corruption import assert_refused
from tso_cli.cloud.cloud import Cloud
from tso_cli.io.clouds import read_cloud

RNG = np.random.default_rng(0)


def splats(points, opacity, colours):
    """A file of splats as the trainer of 3D Gaussian splatting writes it."""
    names = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "rot_0"]
    rest = np.zeros((len(points), 2))
    rows = np.c_[points, (colours - 0.5) / 0.28209479, opacity, rest].astype("<f4")
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(points)}"]
    header += [f"property float {name}" for name in names]
    return "\n".join([*header, "end_header", ""]).encode() + rows.tobytes()


@pytest.fixture
def scene(tmp_path):
    points, haze = RNG.uniform(-0.5, 0.5, (300, 3)), RNG.uniform(-5.0, 5.0, (100, 3))
    opacity = np.r_[np.full(300, 3.0), np.full(100, -4.0)]
    colours = np.tile([0.25, 0.5, 0.75], (400, 1))
    path = tmp_path / "splats.ply"
    path.write_bytes(splats(np.r_[points, haze], opacity, colours))
    return path


def test_splats_that_cannot_be_seen_are_known_and_the_constant_colour_is_a_colour(scene):
    cloud = read_cloud(scene)
    assert cloud.faint().tolist() == [False] * 300 + [True] * 100
    np.testing.assert_allclose(cloud.colours(), np.tile([0.25, 0.5, 0.75], (400, 1)), atol=1e-6)


def test_faint_points_move_along_and_nothing_depends_on_them(scene):
    file = read_cloud(scene)
    cloud = Cloud(file.points, "splats", faint=file.faint()).controlled()
    alone = Cloud(file.points[:300], "splats").controlled()
    np.testing.assert_array_equal(cloud.control_points, alone.control_points)
    np.testing.assert_array_equal(cloud.measured, alone.measured)
    assert not cloud.outliers.any()
    shift = np.tile([0.1, 0.0, 0.0], (len(cloud.control_points), 1))
    moved = cloud.moved(shift)
    np.testing.assert_allclose(
        moved.points - file.points, np.tile([0.1 * cloud.scale, 0, 0], (400, 1)), atol=1e-9
    )


def test_a_cloud_with_an_opacity_and_no_scales_is_no_file_of_splats(tmp_path, scene):
    text = scene.read_bytes().replace(b"scale_0", b"other_0")
    (tmp_path / "a.ply").write_bytes(text)
    assert read_cloud(tmp_path / "a.ply").faint() is None


def test_compressed_splats_say_what_to_export(tmp_path):
    packed = (
        "ply\nformat ascii 1.0\nelement vertex 1\nproperty uint packed_position\nend_header\n7\n"
    )
    (tmp_path / "a.compressed.ply").write_text(packed)
    assert_refused("export them as an uncompressed .ply", read_cloud, tmp_path / "a.compressed.ply")
    for name in ("a.splat", "a.spz", "a.ksplat"):
        assert_refused("export the splats as an uncompressed .ply", read_cloud, tmp_path / name)
    assert_refused("convert it to .ply, with CloudCompare", read_cloud, tmp_path / "a.laz")
