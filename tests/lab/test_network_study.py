"""The base network beside the mean and the nearest training shape."""

from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from tso_cli.lab.studies import mean_shape as means
from tso_cli.lab.studies import network
from tso_cli.lab.studies.mean_shape import TURNS, aligned_mean, mean_shape, pair_chamfer
from tso_cli.lab.studies.network import nearest_of

from .studying import MESHES, check_command, thin_checkpoint, write_split


def cloud(seed: int, stretch: tuple[float, float, float] = (1.0, 0.6, 0.3)) -> np.ndarray:
    return (np.random.default_rng(seed).uniform(-0.5, 0.5, (256, 3)) * stretch).astype(np.float32)


@pytest.fixture(autouse=True)
def few_steps(monkeypatch):
    """The mean shape after 60 steps; after 3 for the command."""
    monkeypatch.setattr(means, "mean_shape", partial(mean_shape, steps=60))
    monkeypatch.setattr(network, "mean_shape", partial(mean_shape, steps=3))


def test_the_mean_is_nearer_to_all_than_any_one_of_them() -> None:
    clouds = [cloud(i, (1.0, 0.2 + 0.2 * i, 0.3)) for i in range(4)]
    mean = means.mean_shape(clouds)

    def total(one: np.ndarray) -> float:
        return sum(pair_chamfer(one, other) for other in clouds)

    assert total(mean) < min(total(one) for one in clouds)


def test_a_shape_that_faces_another_way_is_found_by_its_quarter_turn() -> None:
    clouds = [cloud(0), cloud(1, (0.9, 0.9, 0.9))]
    for turn in TURNS:
        assert nearest_of(clouds, clouds[0] @ turn) == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose([np.linalg.det(turn) for turn in TURNS], 1.0)


@pytest.mark.slow
def test_shapes_are_turned_to_each_other_before_their_mean_is_taken() -> None:
    clouds = [cloud(i) @ TURNS[i % 4] for i in range(4)]
    mean, careless = aligned_mean(clouds), means.mean_shape(clouds)
    assert nearest_of([mean], cloud(9)) < 0.5 * nearest_of([careless], cloud(9))


@pytest.mark.slow
def test_the_command_judges_validation_and_test(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(means, "mean_shape", partial(mean_shape, steps=3))
    checkpoint = thin_checkpoint(tmp_path, monkeypatch, 1024)
    parts = {"train": ["car/qbasic_BasicCar", "car/qreal_SUV"], "validation": ["car/qpublic_Taxi"], "test": ["car/qreal_Cop"]}
    split = write_split(tmp_path, **parts)
    arguments = ("network", "--meshes", MESHES, "--split", split, "--checkpoint", checkpoint, "--category", "car")
    record = check_command(tmp_path / "network.json", capsys, *arguments, words=("validation", "Chamfer x1000"))
    assert {row["shape"] for row in record["shapes"]} == {"car/qpublic_Taxi", "car/qreal_Cop"}
    for part in ("validation", "test"):
        row = record["summary"][part]["car"]
        assert row["shapes"] == 1 and row["training_shapes"] == 2
        assert row["network"] > row["nearest"] > 0.0
