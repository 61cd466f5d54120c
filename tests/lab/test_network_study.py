"""The base network beside the mean and the nearest training shape."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from tso_cli.cli import main
from tso_cli.io.checkpoints import save_network
from tso_cli.lab.studies import mean_shape as means
from tso_cli.lab.studies.mean_shape import TURNS, aligned_mean, mean_shape, pair_chamfer
from tso_cli.lab.studies.network import nearest_of
from tso_cli.network.model import NetworkConfig, build_network

from ..training import make_thin

MESHES = Path(__file__).parents[2] / "examples" / "meshes"


def cloud(seed: int, stretch: tuple[float, float, float] = (1.0, 0.6, 0.3)) -> np.ndarray:
    return (np.random.default_rng(seed).uniform(-0.5, 0.5, (1024, 3)) * stretch).astype(np.float32)


def test_the_mean_of_one_shape_is_that_shape() -> None:
    truth = cloud(0)
    assert pair_chamfer(mean_shape([truth] * 4), truth) < 0.2 * pair_chamfer(cloud(1), truth)


def test_the_mean_is_nearer_to_all_than_any_one_of_them() -> None:
    clouds = [cloud(i, (1.0, 0.2 + 0.2 * i, 0.3)) for i in range(4)]
    mean = mean_shape(clouds)

    def total(one: np.ndarray) -> float:
        return sum(pair_chamfer(one, other) for other in clouds)

    assert total(mean) < min(total(one) for one in clouds)


def test_a_shape_that_faces_another_way_is_found_by_its_quarter_turn() -> None:
    clouds = [cloud(0), cloud(1, (0.9, 0.9, 0.9))]
    for turn in TURNS:
        assert nearest_of(clouds, clouds[0] @ turn) == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose([np.linalg.det(turn) for turn in TURNS], 1.0)


def test_shapes_are_turned_to_each_other_before_their_mean_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(means, "MEAN_STEPS", 60)
    clouds = [cloud(i) @ TURNS[i % 4] for i in range(4)]
    mean, careless = aligned_mean(clouds), mean_shape(clouds)
    assert nearest_of([mean], cloud(9)) < 0.5 * nearest_of([careless], cloud(9))


def test_the_command_judges_validation_and_test_and_draws_a_chart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("open3d")
    make_thin(monkeypatch)
    monkeypatch.setattr(means, "MEAN_STEPS", 3)
    checkpoint = tmp_path / "thin.safetensors"
    save_network(checkpoint, build_network(1024), NetworkConfig())
    split = tmp_path / "split.json"
    names = {"train": ["car/qbasic_BasicCar", "car/qreal_SUV"], "validation": ["car/qpublic_Taxi"], "test": ["car/qreal_Cop"]}
    split.write_text(json.dumps(names))
    output = tmp_path / "network.json"
    arguments = ["--meshes", MESHES, "--split", split, "--checkpoint", checkpoint, "--category", "car", "-o", output]
    with pytest.raises(SystemExit) as stopped:
        main(["lab", "network", *map(str, arguments)])
    assert stopped.value.code == 0
    record = json.loads(output.read_text())
    assert {row["shape"] for row in record["shapes"]} == {"car/qpublic_Taxi", "car/qreal_Cop"}
    for part in ("validation", "test"):
        own = record["summary"][part]["car"]
        assert own["shapes"] == 1 and own["training_shapes"] == 2
        assert own["over_nearest"] == pytest.approx(own["network"] / own["nearest"])
        assert own["network"] > own["nearest"] > 0.0
    printed = capsys.readouterr().out
    assert "validation" in printed and "Chamfer x1000" in printed
    assert output.with_suffix(".png").stat().st_size > 5000
