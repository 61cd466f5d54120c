"""Generated shapes: which way they face, that they differ, and that they can be had again."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tso_cli.cli import main
from tso_cli.errors import InputError
from tso_cli.geometry.points import sample_surface
from tso_cli.io.meshes import Mesh, read_mesh, write_mesh
from tso_cli.lab.generate import CATEGORIES, airplane, car, chair, generate, parts, write_shapes
from tso_cli.lab.generate.airframe import Body
from tso_cli.lab.generate.hidden import without_hidden

KINDS = [(category, kind) for category, of in zip(CATEGORIES, (chair, car, airplane), strict=True) for kind in of.KINDS]
MAKERS = dict(zip(CATEGORIES, (chair, car, airplane), strict=True))
MIRROR = {"chair": 0, "car": 0, "airplane": 2}


def shapes(category: str, count: int = 40) -> list[Mesh]:
    return [generate(category, np.random.default_rng([3, k])) for k in range(count)]


def of_kind(category: str, kind: str, seed: int) -> Mesh:
    return parts.join(MAKERS[category].KINDS[kind](np.random.default_rng([5, seed])))


def volume(mesh: Mesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float((a * np.cross(b, c)).sum() / 6.0)


def tso(*arguments: object) -> int:
    with pytest.raises(SystemExit) as stopped:
        main([str(argument) for argument in arguments])
    return int(stopped.value.code or 0)


# Every shape


@pytest.mark.parametrize(("category", "kind"), KINDS)
def test_every_kind_is_finite_of_moderate_size_and_mirror_symmetric(category: str, kind: str) -> None:
    for seed in range(6):
        mesh = of_kind(category, kind, seed)
        assert np.isfinite(mesh.vertices).all()
        assert 0 <= mesh.faces.min() <= mesh.faces.max() < len(mesh.vertices)
        assert len(mesh.faces) < 6000
        extent = np.ptp(mesh.vertices, axis=0)
        assert extent.min() > 0.1 * extent.max() or category == "airplane"
        low, high = mesh.vertices[:, MIRROR[category]].min(), mesh.vertices[:, MIRROR[category]].max()
        assert abs(low + high) < 0.02 * (high - low)


@pytest.mark.parametrize("category", CATEGORIES)
def test_the_surface_is_symmetric_not_only_its_box(category: str) -> None:
    axis = MIRROR[category]
    for k, mesh in enumerate(shapes(category, 12)):
        points = sample_surface(mesh.vertices, mesh.faces, 6000, np.random.default_rng(k))
        points = points / np.ptp(points, axis=0).max()
        assert abs(points[:, axis].mean()) < 0.01
        right = points[points[:, axis] > 0]
        left = points[points[:, axis] <= 0]
        np.testing.assert_allclose(np.abs(right[:, axis]).mean(), np.abs(left[:, axis]).mean(), atol=0.02)


@pytest.mark.parametrize("category", CATEGORIES)
def test_shapes_survive_being_written_and_read(category: str, tmp_path: Path) -> None:
    for k, mesh in enumerate(shapes(category, 8)):
        path = tmp_path / f"{k}.ply"
        write_mesh(path, mesh)
        back = read_mesh(path)
        np.testing.assert_allclose(back.vertices, mesh.vertices, atol=1e-5)
        np.testing.assert_array_equal(back.faces, mesh.faces)
        assert back.colours is None


@pytest.mark.parametrize("category", CATEGORIES)
def test_no_two_shapes_are_alike_and_their_proportions_vary(category: str) -> None:
    extents = np.array([np.ptp(mesh.vertices, axis=0) for mesh in shapes(category, 60)])
    shares = extents / extents.max(axis=1, keepdims=True)
    assert len({tuple(row) for row in extents.round(6)}) == 60
    assert shares.std(axis=0).max() > 0.05
    assert len({len(mesh.faces) for mesh in shapes(category, 60)}) > 30


def test_a_category_that_is_not_known_is_refused() -> None:
    with pytest.raises(InputError, match="'boat' is not a category, expected chair, car, airplane"):
        generate("boat", np.random.default_rng(0))


# Which way they face


def test_the_back_of_a_chair_is_behind_its_seat() -> None:
    behind = 0
    for k, mesh in enumerate(shapes("chair", 60)):
        points = sample_surface(mesh.vertices, mesh.faces, 3000, np.random.default_rng(k))
        points -= (mesh.vertices.min(axis=0) + mesh.vertices.max(axis=0)) / 2.0
        upper = points[points[:, 1] > np.quantile(points[:, 1], 0.85)]
        depth = np.ptp(mesh.vertices[:, 2])
        assert upper[:, 2].mean() < 0.06 * depth  # a stool has no back
        behind += upper[:, 2].mean() < -0.1 * depth
    assert behind > 50


@pytest.mark.parametrize("kind", ["dining", "office", "shell", "armchair", "lounger"])
def test_chairs_with_a_back_have_it_behind(kind: str) -> None:
    for seed in range(12):
        mesh = of_kind("chair", kind, seed)
        points = sample_surface(mesh.vertices, mesh.faces, 3000, np.random.default_rng(seed))
        upper = points[points[:, 1] > np.quantile(points[:, 1], 0.95)]
        assert upper[:, 2].mean() < points[:, 2].mean()


def test_chairs_stand_on_the_floor() -> None:
    for mesh in shapes("chair", 40):
        height = np.ptp(mesh.vertices[:, 1])
        assert abs(mesh.vertices[:, 1].min()) < 0.06 * height


def test_cars_are_longer_than_wide_and_high_and_stand_on_four_wheels() -> None:
    for mesh in shapes("car", 40):
        x, y, z = np.ptp(mesh.vertices, axis=0)
        assert z > 1.2 * x
        assert z > 1.05 * y
        ground = mesh.vertices[mesh.vertices[:, 1] < mesh.vertices[:, 1].min() + 0.01 * y]
        assert (ground[:, 2] > 0.15 * z).any()
        assert (ground[:, 2] < -0.15 * z).any()
        assert np.abs(ground[:, 0]).min() > 0.15 * x


@pytest.mark.parametrize("kind", ["sedan", "sports", "van", "pickup", "estate", "suv"])
def test_the_bonnet_of_a_car_is_before_its_cabin(kind: str) -> None:
    for seed in range(8):
        mesh = of_kind("car", kind, seed)
        points = sample_surface(mesh.vertices, mesh.faces, 4000, np.random.default_rng(seed))
        z = points[:, 2]
        end = 0.12 * np.ptp(z)
        front, rear = points[z > z.max() - end, 1], points[z < z.min() + end, 1]
        assert front.max() < rear.max() + 0.12 * np.ptp(points[:, 1])
        top = points[points[:, 1] > 0.93 * points[:, 1].max()]
        assert z.max() - top[:, 2].max() > 0.15 * np.ptp(z)


def test_aeroplanes_spread_their_wings_along_z() -> None:
    for mesh in shapes("airplane", 60):
        x, y, z = np.ptp(mesh.vertices, axis=0)
        assert z > 1.1 * y
        assert z > 0.3 * x


@pytest.mark.parametrize("kind", ["airliner", "business", "fighter", "glider", "transport"])
def test_the_fin_of_an_aeroplane_is_at_the_rear(kind: str) -> None:
    for seed in range(8):
        points = of_kind("airplane", kind, seed).vertices
        points = points[np.abs(points[:, 2]) < 0.2 * np.ptp(points[:, 2])]
        highest = points[points[:, 1].argmax()]
        assert highest[0] > points[:, 0].min() + 0.75 * np.ptp(points[:, 0])


def test_a_fuselage_is_widest_before_its_middle_and_its_tail_rises() -> None:
    points = Body(0.1, 0.1, tail=0.5, nose=0.1, rise=0.8, droop=0.3).mesh().vertices
    assert points[points[:, 0] > 0.49, 1].mean() > 0.02
    assert points[points[:, 0] < -0.49, 1].mean() < 0.0
    wide = points[np.abs(points[:, 2]) > 0.0499, 0]
    assert -0.41 < wide.min() < wide.max() < 0.01


# Parts


def test_parts_are_closed_with_the_volume_of_what_they_are() -> None:
    assert volume(parts.box((2, 3, 4), (5, 6, 7))) == pytest.approx(24)
    assert volume(parts.rod((0, 0, 0), (0, 2, 0), 0.5, 0.25, sides=200)) == pytest.approx(
        np.pi * 2 / 3 * (0.25 + 0.125 + 0.0625), rel=1e-3
    )
    assert volume(parts.ellipsoid((1, 2, 3), (9, 9, 9), 60, 60)) == pytest.approx(8 * np.pi, rel=0.01)
    assert volume(parts.slab(parts.rectangle(2, 3), 1, 5, axis=2)) == pytest.approx(24)
    u, v = np.meshgrid(np.linspace(0, 2, 5), np.linspace(0, 3, 4))
    assert volume(parts.plate(np.stack([u, v, 0 * u], axis=-1), 0.1)) == pytest.approx(0.6)
    assert volume(parts.mirrored(parts.box((1, 1, 1), (3, 0, 0)), 0)) == pytest.approx(1)
    for part in (
        parts.cushion((1, 0.2, 1), (0, 0, 0)),
        parts.wheel((0, 0, 0), 0.3, 0.2, 0),
        parts.tube([(0, 0, 0), (1, 0, 0), (1, 1, 0)], 0.1),
    ):
        edges = np.sort(np.concatenate([part.faces[:, [0, 1]], part.faces[:, [1, 2]], part.faces[:, [2, 0]]]), axis=1)
        assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()


def test_a_smooth_curve_passes_through_its_points() -> None:
    knots = np.array([[0.0, 0.0], [1.0, 0.0], [2.0, 0.0], [3.0, 0.0]])
    np.testing.assert_allclose(parts.curve(knots, 7), np.stack([np.linspace(0, 3, 7), np.zeros(7)], axis=1), atol=1e-12)
    bent = parts.curve([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]], 21)
    np.testing.assert_allclose(bent[[0, 10, 20]], [[0, 0], [1, 0], [1, 1]], atol=1e-12)


def test_what_lies_inside_another_part_is_removed_and_nothing_else() -> None:
    outer, inner, apart = (parts.box((s, s, s), (x, 0, 0)) for s, x in ((1.0, 0.0), (0.4, 0.0), (0.4, 3.0)))
    kept = without_hidden([outer, inner, apart])
    assert len(kept) == 2
    assert volume(kept[0]) == pytest.approx(1.0)
    assert volume(kept[1]) == pytest.approx(0.064)
    half = without_hidden([outer, parts.box((0.6, 0.6, 0.6), (0.5, 0, 0))])[1]
    assert half.vertices[half.faces].mean(axis=1)[:, 0].min() > 0.5


# Folders


def test_the_same_seed_gives_the_same_bytes_and_another_seed_does_not(tmp_path: Path) -> None:
    counts = {"chair": 3, "car": 2, "airplane": 2}
    first = [path.read_bytes() for path in write_shapes(tmp_path / "a", counts, 4)]
    assert first == [path.read_bytes() for path in write_shapes(tmp_path / "b", counts, 4)]
    other = [path.read_bytes() for path in write_shapes(tmp_path / "c", counts, 5)]
    assert not set(first) & set(other)
    assert len(set(first)) == 7


def test_a_shape_depends_on_its_own_number_only(tmp_path: Path) -> None:
    done: list[tuple[int, int, str]] = []
    few = write_shapes(tmp_path / "few", {"car": 2}, 1)
    many = write_shapes(tmp_path / "many", {"airplane": 1, "car": 4}, 1, lambda *step: done.append(step))
    assert [path.relative_to(tmp_path).as_posix() for path in few] == ["few/car/gen_00000.ply", "few/car/gen_00001.ply"]
    assert [path.read_bytes() for path in few] == [path.read_bytes() for path in many[1:3]]
    assert done[-1] == (5, 5, "car/gen_00003")


def test_files_that_are_there_are_kept_unless_asked(tmp_path: Path) -> None:
    (tmp_path / "car").mkdir()
    there = tmp_path / "car/gen_00001.ply"
    there.write_text("mine")
    with pytest.raises(InputError, match="exists already"):
        write_shapes(tmp_path, {"car": 2})
    assert there.read_text() == "mine"
    assert list((tmp_path / "car").iterdir()) == [there]
    write_shapes(tmp_path, {"car": 2}, overwrite=True)
    assert read_mesh(there).faces.shape[0] > 100


@pytest.mark.parametrize(
    ("counts", "seed", "words"),
    [
        ({"car": -1}, 0, "asked for -1 shapes of category car"),
        ({"car": 100_001}, 0, "expected 0 to 100,000"),
        ({"car": 0}, 0, "no shape at all"),
        ({"boat": 1}, 0, "not a category"),
        ({"car": 1}, -1, "seed is -1"),
    ],
)
def test_what_makes_no_sense_is_refused_before_anything_is_written(
    counts: dict[str, int], seed: int, words: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=words):
        write_shapes(tmp_path / "out", counts, seed)
    assert not (tmp_path / "out").exists()


def test_the_command_writes_and_counts(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert tso("lab", "generate", "-o", tmp_path / "out", "--chair", 2, "--car", 0, "--airplane", 1, "--seed", 3) == 0
    assert "3 shapes written" in capsys.readouterr().out
    written = sorted(path.relative_to(tmp_path / "out").as_posix() for path in (tmp_path / "out").rglob("*.ply"))
    assert written == ["airplane/gen_00000.ply", "chair/gen_00000.ply", "chair/gen_00001.ply"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--chair", -2), "asked for -2 shapes of category chair"),
        (("--chair", "many"), "not a valid integer"),
        (("--chair", 0, "--car", 0, "--airplane", 0), "no shape at all"),
        (("--seed", -1), "-1"),
        (("-o", "missing/out"), "cannot be made a folder"),
        (("-o", "file"), "cannot be made a folder"),
    ],
)
def test_the_command_refuses_bad_input_in_one_line(
    arguments: tuple[object, ...],
    words: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    assert tso("lab", "generate", "-o", "out", *arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert len(captured.err.strip().splitlines()) == 1
    assert words in captured.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file"]


def test_generating_needs_numpy_alone() -> None:
    code = "import sys, tso_cli.lab.generate; print([m for m in ('torch', 'scipy', 'trimesh', 'open3d') if m in sys.modules])"
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"
