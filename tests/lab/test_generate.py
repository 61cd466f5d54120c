"""Generated shapes: which way they face, that they differ, and that they can be made again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tso_cli.errors import InputError
from tso_cli.geometry.points import sample_surface
from tso_cli.io.meshes import Mesh, read_mesh
from tso_cli.lab.generate import CATEGORIES, airplane, car, chair, generate, parts, write_shapes

MAKERS = dict(zip(CATEGORIES, (chair, car, airplane), strict=True))
KINDS = [(category, kind) for category, maker in MAKERS.items() for kind in maker.WEIGHTS]
MIRROR = {"chair": 0, "car": 0, "airplane": 2}


def of_kind(category: str, kind: str, seed: int) -> Mesh:
    return parts.join(MAKERS[category].build(np.random.default_rng([5, seed]), kind))


def sampled(mesh: Mesh, count: int = 3000) -> np.ndarray:
    return sample_surface(mesh.vertices, mesh.faces, count, np.random.default_rng(0))


def volume(mesh: Mesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float((a * np.cross(b, c)).sum() / 6.0)


def is_closed(mesh: Mesh) -> bool:
    """Whether every edge is run once in each direction."""
    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    return len(np.unique(edges, axis=0)) == len(edges) and {*map(tuple, edges)} == {
        *map(tuple, edges[:, ::-1])
    }


@pytest.mark.parametrize(("category", "kind"), KINDS)
def test_every_kind_is_of_closed_parts_of_moderate_size_and_mirror_symmetric(category, kind):
    for seed in range(2):
        assert all(
            is_closed(part)
            for part in MAKERS[category].build(np.random.default_rng([5, seed]), kind)
        )
        mesh = of_kind(category, kind, seed)
        assert np.isfinite(mesh.vertices).all()
        assert len(mesh.faces) < 6000
        extent = np.ptp(mesh.vertices, axis=0)
        assert extent.min() > 0.1 * extent.max() or category == "airplane"
        x = sampled(mesh)[:, MIRROR[category]] / extent.max()
        assert abs(x.mean()) < 0.015
        assert abs(x.min() + x.max()) < 0.03


@pytest.mark.parametrize("category", CATEGORIES)
def test_no_two_shapes_are_alike_and_their_proportions_vary(category):
    shapes = [generate(category, np.random.default_rng([3, k])) for k in range(20)]
    extents = np.array([np.ptp(mesh.vertices, axis=0) for mesh in shapes])
    assert len({tuple(row) for row in extents.round(6)}) == 20
    assert (extents / extents.max(axis=1, keepdims=True)).std(axis=0).max() > 0.05
    assert len({len(mesh.faces) for mesh in shapes}) > 8


@pytest.mark.parametrize("kind", ["dining", "office", "shell", "armchair", "lounger"])
def test_the_back_of_a_chair_is_behind_its_seat_and_it_stands_on_the_floor(kind):
    behind = 0
    for seed in range(8):
        mesh = of_kind("chair", kind, seed)
        points = sampled(mesh)
        upper = points[points[:, 1] > np.quantile(points[:, 1], 0.95)]
        behind += upper[:, 2].mean() < points[:, 2].mean()
        assert abs(mesh.vertices[:, 1].min()) < 0.06 * np.ptp(mesh.vertices[:, 1])
    assert behind >= 7  # an armchair's arms may be as high as its back


@pytest.mark.parametrize("kind", list(car.WEIGHTS))
def test_cars_are_longer_than_wide_and_high_and_stand_on_four_wheels(kind):
    for seed in range(2):
        mesh = of_kind("car", kind, seed)
        x, y, z = np.ptp(mesh.vertices, axis=0)
        assert z > 1.2 * x
        assert z > 1.05 * y
        ground = mesh.vertices[mesh.vertices[:, 1] < mesh.vertices[:, 1].min() + 0.01 * y]
        assert (ground[:, 2] > 0.15 * z).any()
        assert (ground[:, 2] < -0.15 * z).any()
        assert np.abs(ground[:, 0]).min() > 0.15 * x


@pytest.mark.parametrize("kind", ["sedan", "sports", "van", "pickup", "suv"])
def test_the_bonnet_of_a_car_is_before_its_cabin(kind):
    for seed in range(3):
        points = sampled(of_kind("car", kind, seed))
        z, high = points[:, 2], np.ptp(points[:, 1])
        end = 0.12 * np.ptp(z)
        assert points[z > z.max() - end, 1].max() < points[z < z.min() + end, 1].max() + 0.12 * high
        cabin = points[(points[:, 1] > points[:, 1].max() - 0.07 * high), 2]
        assert z.max() - cabin.max() > 0.15 * np.ptp(z)


@pytest.mark.parametrize("kind", list(airplane.WEIGHTS))
def test_aeroplanes_spread_their_wings_along_z_and_have_their_fin_at_the_rear(kind):
    for seed in range(3):
        points = of_kind("airplane", kind, seed).vertices
        x, y, z = np.ptp(points, axis=0)
        assert z > 1.1 * y
        assert z > 0.3 * x
        if kind in (
            "airliner",
            "rear jet",
            "glider",
        ):  # of the others, a propeller or wing may be higher
            middle = points[np.abs(points[:, 2]) < 0.2 * z]
            assert middle[middle[:, 1].argmax(), 0] > points[:, 0].min() + 0.7 * x


def test_parts_have_the_volume_of_what_they_are():
    assert volume(parts.box((2, 3, 4), (5, 6, 7))) == pytest.approx(24)
    frustum = parts.rod((0, 0, 0), (0, 2, 0), 0.5, 0.25, sides=200)
    assert volume(frustum) == pytest.approx(np.pi * 2 / 3 * (0.25 + 0.125 + 0.0625), rel=1e-3)
    assert volume(parts.ellipsoid((1, 2, 3), (9, 9, 9), 60, 60)) == pytest.approx(
        8 * np.pi, rel=0.01
    )
    u, v = np.meshgrid(np.linspace(0, 2, 5), np.linspace(0, 3, 4))
    assert volume(parts.plate(np.stack([u, v, 0 * u], axis=-1), 0.1)) == pytest.approx(0.6)
    assert [volume(part) for part in parts.both(parts.box((1, 1, 1), (3, 0, 0)))] == pytest.approx(
        [1, 1]
    )


def test_a_shape_depends_on_seed_category_and_number_alone(tmp_path):
    steps: list[tuple[int, int, str]] = []
    short = write_shapes(tmp_path / "short", {"car": 2}, 1)
    long = write_shapes(
        tmp_path / "long", {"airplane": 1, "car": 4}, 1, lambda *step: steps.append(step)
    )
    assert [path.relative_to(tmp_path).as_posix() for path in short] == [
        "short/car/gen_00000.ply",
        "short/car/gen_00001.ply",
    ]
    assert [path.read_bytes() for path in short] == [path.read_bytes() for path in long[1:3]]
    assert steps[-1] == (5, 5, "car/gen_00003")
    other_seed = write_shapes(tmp_path / "other", {"car": 2}, 2)
    assert len({path.read_bytes() for path in (*long, *other_seed)}) == 7


def test_existing_files_are_kept_unless_overwriting_is_asked_for(tmp_path):
    (tmp_path / "car").mkdir()
    existing = tmp_path / "car/gen_00001.ply"
    existing.write_text("mine")
    with pytest.raises(InputError, match="exists already"):
        write_shapes(tmp_path, {"car": 2})
    assert existing.read_text() == "mine"
    assert list((tmp_path / "car").iterdir()) == [existing]
    write_shapes(tmp_path, {"car": 2}, overwrite=True)
    assert read_mesh(existing).faces.shape[0] > 100


def test_the_command_writes_and_counts(tso, tmp_path):
    counts = ("--chair", 2, "--car", 0, "--airplane", 1)
    assert (
        "3 shapes written"
        in tso("lab", "generate", "-o", tmp_path / "out", *counts, "--seed", 3).out
    )
    written = sorted(
        path.relative_to(tmp_path / "out").as_posix() for path in (tmp_path / "out").rglob("*.ply")
    )
    assert written == ["airplane/gen_00000.ply", "chair/gen_00000.ply", "chair/gen_00001.ply"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--chair", -2), "asked for -2 shapes of category chair"),
        (("--car", 100_001), "expected 0 to 100,000"),
        (("--chair", 0, "--car", 0, "--airplane", 0), "no shape at all"),
        (("--seed", -1), "-1"),
        (("-o", "file"), "cannot be made a folder"),
    ],
)
def test_the_command_refuses_bad_input_in_one_line(tso, arguments, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("")
    assert words in tso("lab", "generate", "-o", "out", *arguments).refusal
    assert sorted(path.name for path in tmp_path.iterdir()) == ["file"]
