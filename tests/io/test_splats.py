"""Gaussian splats: opacity, colour, motion, and the formats that have to be exported first."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.corruption import assert_reads_or_refuses, assert_refused
from tests.io.test_clouds import ORDERS
from tests.io.test_moves import a_ply, bent, motion, moved, unit, write_moved
from tso_cli.cloud.cloud import Cloud
from tso_cli.geometry.rotations import from_quaternion
from tso_cli.io.clouds import read_cloud, write_cloud
from tso_cli.io.splats import turned_colours, turned_rotations

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


# Splats that move as one.


def trained(count=40, coefficients=15, seed=0):
    """The columns of a file as the trainer of 3D Gaussian splatting writes it, name -> values."""
    rng = np.random.default_rng(seed)
    names = [*"xyz", "nx", "ny", "nz", *(f"f_dc_{k}" for k in range(3))]
    names += [f"f_rest_{k}" for k in range(3 * coefficients)]
    names += ["opacity", *(f"scale_{k}" for k in range(3)), *(f"rot_{k}" for k in range(4))]
    values = dict(zip(names, rng.normal(size=(len(names), count)), strict=True))
    values |= dict.fromkeys(("nx", "ny", "nz"), np.zeros(count))
    values["scale_1"] -= 3.0
    return values


def file_of(columns, form="binary_little_endian", kinds=("float",)):
    """A file of these columns, whose types are ``kinds`` in turn."""
    typed = {
        name: (kinds[k % len(kinds)], values) for k, (name, values) in enumerate(columns.items())
    }
    return a_ply(form, typed)


def rows_of(path):
    """The columns of a file as any reader has them, name -> values."""
    head, _, body = path.read_bytes().partition(b"end_header\n")
    form, _, *lines = head.decode().partition("\nelement face")[0].splitlines()[1:]
    kinds = {line.split()[2]: {"float": "f4", "double": "f8"}[line.split()[1]] for line in lines}
    order = ORDERS[form.split()[1]]
    if order is None:
        return dict(zip(kinds, np.loadtxt(body.decode().splitlines(), ndmin=2).T, strict=True))
    rows = np.frombuffer(body, [(name, order + kind) for name, kind in kinds.items()])
    return {name: rows[name].astype(float) for name in kinds}


def numbered(columns, prefix):
    """The columns prefix_0, prefix_1 and so on, [N, K]."""
    count = sum(name.startswith(f"{prefix}_") for name in columns)
    return np.stack([columns[f"{prefix}_{k}"] for k in range(count)], axis=1)


def seen_from(rest, directions):
    """The colour [N, 3, D] that directions [D, 3] add, as the trainer's ``eval_sh`` does it."""
    x, y, z = directions.T
    xx, yy, zz, xy, yz, xz = x * x, y * y, z * z, x * y, y * z, x * z
    sh = rest.reshape(len(rest), 3, -1, 1)
    colour = -0.4886025119029199 * (y * sh[:, :, 0] - z * sh[:, :, 1] + x * sh[:, :, 2])
    if sh.shape[2] > 3:
        colour += 1.0925484305920792 * (xy * sh[:, :, 3] - yz * sh[:, :, 4] - xz * sh[:, :, 6])
        colour += 0.31539156525252005 * (2.0 * zz - xx - yy) * sh[:, :, 5]
        colour += 0.5462742152960396 * (xx - yy) * sh[:, :, 7]
    if sh.shape[2] > 8:
        colour += -0.5900435899266435 * y * (3 * xx - yy) * sh[:, :, 8]
        colour += 2.890611442640554 * xy * z * sh[:, :, 9]
        colour += -0.4570457994644658 * y * (4 * zz - xx - yy) * sh[:, :, 10]
        colour += 0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy) * sh[:, :, 11]
        colour += -0.4570457994644658 * x * (4 * zz - xx - yy) * sh[:, :, 12]
        colour += 1.445305721320277 * z * (xx - yy) * sh[:, :, 13]
        colour += -0.5900435899266435 * x * (xx - 3 * yy) * sh[:, :, 14]
    return colour


def covariances(columns):
    """The covariance [N, 3, 3] of each splat: R S S^T R^T."""
    turns = np.array([from_quaternion(*q) for q in numbered(columns, "rot")])
    spread = turns * np.exp(numbered(columns, "scale"))[:, None]
    return spread @ spread.transpose(0, 2, 1)


def assert_moved(before, after, size, turn):
    """The splats of columns ``after`` are those of ``before``, turned and ``size`` times as large.

    A camera that moved along sees the same.
    """
    expected = size**2 * turn @ covariances(before) @ turn.T
    largest = np.abs(expected).max(axis=(1, 2), keepdims=True)
    np.testing.assert_allclose(covariances(after) / largest, expected / largest, atol=3e-6)
    lengths = [np.linalg.norm(numbered(columns, "rot"), axis=1) for columns in (before, after)]
    np.testing.assert_allclose(*lengths, rtol=1e-6)
    if "f_rest_0" in before:
        directions = unit(np.random.default_rng(2).normal(size=(50, 3)))
        np.testing.assert_allclose(
            seen_from(numbered(after, "f_rest"), directions @ turn.T),
            seen_from(numbered(before, "f_rest"), directions),
            atol=1e-5,
        )


@pytest.mark.parametrize("coefficients", [0, 3, 8, 15])
@pytest.mark.parametrize("kinds", [("float",), ("double", "float")], ids="-".join)
@pytest.mark.parametrize("form", ORDERS)
def test_a_camera_that_moves_along_sees_splats_as_before(save, tmp_path, form, kinds, coefficients):
    columns = trained(coefficients=coefficients)
    names = np.random.default_rng(1).permutation(list(columns))
    path = save("a.ply", file_of({str(name): columns[name] for name in names}, form, kinds))
    matrix, turn = motion(size=1.7)
    assert write_moved(tmp_path / "b.ply", read_cloud(path), matrix) == []
    before, after = rows_of(path), rows_of(tmp_path / "b.ply")
    assert list(before) == list(after)
    assert_moved(before, after, 1.7, turn)
    for name in ("nx", "ny", "nz", "opacity", "f_dc_0", "f_dc_1", "f_dc_2"):
        assert after[name].tobytes() == before[name].tobytes(), name


def test_what_only_shifts_or_grows_changes_no_rotation_and_no_colour(save, tmp_path):
    path = save("a.ply", file_of(trained(), kinds=("double",)))
    cloud, before = read_cloud(path), rows_of(path)
    for size in (1.0, 2.0):
        matrix, _ = motion(size, degrees=0.0)
        assert write_moved(tmp_path / "b.ply", cloud, matrix) == []
        after = rows_of(tmp_path / "b.ply")
        changed = {name for name in before if after[name].tobytes() != before[name].tobytes()}
        scales = {"scale_0", "scale_1", "scale_2"} if size != 1.0 else set()
        assert changed == {*"xyz", *scales}
    np.testing.assert_allclose(
        numbered(after, "scale"), numbered(before, "scale") + np.log(2.0), atol=1e-6
    )


def test_flat_splats_have_two_scales(save, tmp_path):
    columns = trained()
    del columns["scale_2"]
    path = save("a.ply", file_of(columns))
    assert write_moved(tmp_path / "b.ply", read_cloud(path), motion(size=2.0)[0]) == []
    before, after = rows_of(path), rows_of(tmp_path / "b.ply")
    np.testing.assert_allclose(
        numbered(after, "scale"), numbered(before, "scale") + np.log(2.0), atol=1e-6
    )


def test_splats_that_bend_after_a_motion_move_with_it_and_a_warning_says_so(save, tmp_path):
    path = save("a.ply", file_of(trained()))
    cloud, out = read_cloud(path), tmp_path / "b.ply"
    matrix, turn = motion(size=1.7)
    said = write_moved(out, cloud, matrix, bent(moved(matrix, cloud.points)))
    assert said == [
        f"{out}: the normals, rotations and scales are those of {path}, moved with the whole "
        "cloud, before the points moved further"
    ]
    assert_moved(rows_of(path), rows_of(out), 1.7, turn)


@pytest.mark.parametrize(
    ("gone", "says"),
    [
        (["rot_2"], "rotations"),
        (["f_rest_3"], "view-dependent colours"),
        (["f_rest_42", "f_rest_43", "f_rest_44"], "view-dependent colours"),
        (["opacity"], "rotations, view-dependent colours and scales"),
    ],
)
def test_splats_of_which_a_number_is_missing_stay_with_a_warning(save, tmp_path, gone, says):
    columns = {name: values for name, values in trained().items() if name not in gone}
    path = save("a.ply", file_of(columns))
    matrix, _ = motion()
    said = write_moved(tmp_path / "b.ply", read_cloud(path), matrix)
    assert said == [f"{tmp_path}/b.ply: the {says} are those of {path}, before the points moved"]
    before, after = rows_of(path), rows_of(tmp_path / "b.ply")
    left = {"r": "rot_", "v": "f_rest_"}[says[0]]
    for name in before:
        if name.startswith(left):
            assert np.array_equal(after[name], before[name])


def test_many_splats_turn_in_blocks(save, tmp_path, monkeypatch):
    path = save("a.ply", file_of(trained(count=50)))
    matrix, turn = motion()
    write_moved(tmp_path / "b.ply", read_cloud(path), matrix)
    monkeypatch.setattr("tso_cli.io.ply.BLOCK", 7)
    write_moved(tmp_path / "c.ply", read_cloud(path), matrix)
    assert_moved(rows_of(path), rows_of(tmp_path / "c.ply"), 1.7, turn)
    ends = [rows_of(tmp_path / name) for name in ("b.ply", "c.ply")]
    for name in ends[0]:
        np.testing.assert_allclose(ends[0][name], ends[1][name], rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("form", ["ascii", "binary_big_endian"])
def test_damaged_splats_are_moved_or_refused(save, tmp_path, form):
    columns, (matrix, _) = trained(count=4, coefficients=3), motion()
    columns |= {f"rot_{k}": np.full(4, 3e38) for k in range(4)}  # too large once they are turned
    path = save("a.ply", file_of(columns, form))

    def read_and_move(file):
        cloud, out = read_cloud(file), tmp_path / "moved.ply"
        points = moved(matrix, cloud.points)
        if np.abs(points).max() < 1e6:
            write_cloud(out, points, like=cloud, overwrite=True, matrix=matrix)
            read_cloud(out)

    was_read, refused = assert_reads_or_refuses(read_and_move, path, count=120)
    assert was_read > 3
    assert refused > 20


turns = st.tuples(*[st.floats(-1.0, 1.0)] * 4).filter(lambda q: np.linalg.norm(q) > 0.1)


@settings(max_examples=100, deadline=None)
@given(turns, st.sampled_from([3, 8, 15]), st.integers(0, 2**31))
def test_colours_turn_with_any_rotation(quaternion, coefficients, seed):
    """The colour from a direction before is the colour from the turned direction after."""
    rng, turn = np.random.default_rng(seed), from_quaternion(*quaternion)
    rest = rng.normal(size=(5, 3 * coefficients))
    directions = unit(rng.normal(size=(20, 3)))
    after = seen_from(turned_colours(rest, turn), directions @ turn.T)
    np.testing.assert_allclose(after, seen_from(rest, directions), atol=1e-12)


@settings(max_examples=100, deadline=None)
@given(turns, turns, st.floats(1e-3, 1e3))
def test_rotations_follow_one_another_and_keep_their_length(first, then, length):
    """The quaternions of splats need not have length 1."""
    quaternion = length * np.array(first)
    turned = turned_rotations(quaternion[None], from_quaternion(*then))[0]
    expected = from_quaternion(*then) @ from_quaternion(*first)
    np.testing.assert_allclose(from_quaternion(*turned), expected, atol=1e-12)
    assert np.linalg.norm(turned) == pytest.approx(np.linalg.norm(quaternion), rel=1e-12)
