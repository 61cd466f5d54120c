"""Starts that are predictions of a network: where they are, how many, and whose they are."""

import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from tso_cli.errors import InputError
from tso_cli.evaluation.metrics import chamfer
from tso_cli.geometry.rotations import from_vectors
from tso_cli.io.shipped import CATEGORIES, examples_folder
from tso_cli.train.prior import predictions as module
from tso_cli.train.prior import shown, starts
from tso_cli.train.prior.bank import build_bank
from tso_cli.train.prior.predictions import (
    PREDICTED_SHARE,
    Predictions,
    Predictor,
    draw_predictions,
)
from tso_cli.train.prior.scenes import numbered_scene
from tso_cli.train.prior.shapes import POINTS
from tso_cli.train.prior.starts import draw

from ...lab.studying import thin_checkpoint

MESHES = examples_folder() / "meshes"


def draw_scenes(shapes, count, seed):
    return [numbered_scene(shapes, shapes.chances(), seed, number) for number in range(count)]


@pytest.fixture
def predicted(bank):
    """The bank, with points at (9, 9, 9) as the predictions of its first half."""
    half = len(bank.shape) // 2
    prediction = np.where(np.arange(len(bank.shape)) < half, 0, -1)
    cloud = torch.full((1, POINTS, 3), 9.0)
    return replace(bank, predicted=cloud, prediction=prediction, predicted_chance=0.4)


def test_some_starts_of_the_scenes_with_a_prediction_are_predictions(predicted, monkeypatch):
    for name in ("SHIFTED_SHARE", "STREWN_CHANCE"):
        monkeypatch.setattr(starts, name, 0.0)
    monkeypatch.setattr(shown, "DISTANCE_NOISE", 0.0)
    monkeypatch.setattr(starts, "mirrored", lambda batch, chosen: batch)
    found, known = [], []
    for seed in range(8):
        batch = draw(predicted, np.random.default_rng(seed), 64)
        found.append((batch.start == 9.0).flatten(1).all(1))
        known.append(~batch.counterpart.isnan().flatten(1).any(1))
        assert batch.counterpart[found[-1]].isnan().all()
    of_predictions, of_known = (torch.cat(some).float().mean().item() for some in (found, known))
    assert of_predictions == pytest.approx(0.5 * 0.4, abs=0.05)
    # They take the place of other shapes alone.
    assert of_known == pytest.approx(starts.RIGHT_SHARE + starts.NEAR_SHARE, abs=0.06)


def test_without_predictions_the_draws_are_as_before(bank, predicted):
    never = replace(predicted, predicted_chance=0.0)
    first, second = (draw(each, np.random.default_rng(0), 16) for each in (bank, never))
    assert torch.equal(first.start, second.start)
    assert bank.predicted_chance == 0.0
    assert (bank.prediction == -1).all()


class Known(Predictor):
    """Predicts one cloud for every picture, in the axes of the picture or of the object."""

    def clouds(self, images):
        cloud = np.random.default_rng(0).normal(size=(1, 600, 3)).astype(np.float32)
        return np.tile(cloud, (len(images), 1, 1))


@pytest.fixture
def seen(monkeypatch):
    """Pictures that need no open3d, of scenes that are a quarter turn about y away."""
    turn = from_vectors(np.array([0.0, np.pi / 2.0, 0.0]))

    def see(about, shapes, scene, rng):
        return turn, np.zeros((3, 64, 64), np.float32)

    monkeypatch.setattr(module, "_seen", see)
    monkeypatch.setattr(module, "_is_upright", lambda scene: True)
    return turn


def test_predictions_are_turned_into_the_frame_of_their_scenes(shapes, seen):
    predictor = Known(None, None, None, "known")
    scenes = draw_scenes(shapes, 5, 0)
    found = draw_predictions(predictor, shapes, scenes, 3, seed=0)
    assert found.clouds.shape == (3, POINTS, 3)
    assert [number for number in found.of_scene if number >= 0] == [0, 1, 2]
    assert found.chance == pytest.approx(PREDICTED_SHARE * 5 / 3)
    (cloud,) = predictor.clouds(np.zeros((1, 3, 64, 64)))
    turned = cloud.astype(float) @ seen
    for some in found.clouds:
        distances = np.linalg.norm(some[:, None] - turned[None], axis=2).min(1)
        assert distances.max() < 1e-5
    again = draw_predictions(predictor, shapes, scenes, 3, seed=0)
    np.testing.assert_array_equal(again.clouds, found.clouds)


def test_only_scenes_of_known_categories_have_predictions(shapes, seen):
    scenes = draw_scenes(shapes, 12, 0)
    found = draw_predictions(Known(None, None, ("car",), ""), shapes, scenes, 99, seed=0)
    for scene, number in zip(scenes, found.of_scene, strict=True):
        assert (number >= 0) == (shapes.shapes[scene.shape].category == "car")
    with pytest.raises(InputError, match="none of [0-9]+ scenes shows sofa or table upright"):
        draw_predictions(Known(None, None, ("sofa", "table"), ""), shapes, scenes, 9, seed=0)


def test_pictures_that_are_predicted_from_are_upright_and_not_from_below(shapes, seen, monkeypatch):
    monkeypatch.undo()
    monkeypatch.setattr(module, "_seen", lambda *scene: (seen, np.zeros((3, 64, 64), np.float32)))
    scenes = draw_scenes(shapes, 50, 0)
    found = draw_predictions(Known(None, None, None, ""), shapes, scenes, 99, seed=0)
    up = np.stack([scene.views[0].rotation[:, 1] for scene in scenes])
    predicted = found.of_scene >= 0
    assert 5 < predicted.sum() < 25
    assert (np.abs(up[predicted, 0]) < 0.06).all()  # rolled by 3 degrees
    assert (up[predicted, 1] < -0.7).all()
    assert (up[predicted, 2] < 0.11).all()  # from 6 degrees below the object
    aside, down, away = up[~predicted].T
    assert ((np.abs(aside) > 0.04) | (down > -0.8) | (away > 0.09)).all()


def test_a_bank_has_the_predictions(shapes):
    clouds = np.ones((1, POINTS, 3), np.float32)

    def predict(scenes):
        return Predictions(clouds, np.array([-1, 0, -1]), 0.5)

    bank = build_bank(shapes, 3, seed=0, predict=predict)
    assert torch.equal(bank.predicted, torch.from_numpy(clouds))
    assert (bank.prediction.tolist(), bank.predicted_chance) == ([-1, 0, -1], 0.5)


@pytest.mark.slow
def test_predictions_of_the_shipped_network_lie_on_their_scenes(shapes):
    predictor = Predictor.read(Path("default"))
    assert predictor.categories == CATEGORIES
    scenes = draw_scenes(shapes, 16, 0)
    found = draw_predictions(predictor, shapes, scenes, 12, seed=0)

    def error(turn):
        pairs = [
            (found.clouds[number] @ turn, scene.samplings[0])
            for scene, number in zip(scenes, found.of_scene, strict=True)
            if number >= 0
        ]
        return np.mean([chamfer(a.astype(float), b.astype(float)).chamfer for a, b in pairs])

    turns = np.array([[0.0, np.pi / 2, 0.0], [0.0, np.pi, 0.0], [np.pi / 2, 0.0, 0.0]])
    assert error(np.eye(3)) < 0.5 * min(error(turn) for turn in from_vectors(turns))


def test_a_network_of_few_points_is_refused(tmp_path, monkeypatch):
    with pytest.raises(InputError, match=f"predicts 64 points, expected {POINTS} or more"):
        Predictor.read(thin_checkpoint(tmp_path, monkeypatch, 64))


def train(tso, folder, *words):
    small = ("--steps", 2, "--batch-size", 2, "--scenes", 8, "-o", folder / "my.safetensors")
    return tso("train-prior", MESHES, "--without", "car", *small, *words)


@pytest.mark.slow
def test_a_prior_is_trained_with_predictions_and_resumed_with_the_same_network(
    tso, tmp_path, monkeypatch
):
    thin = thin_checkpoint(tmp_path, monkeypatch, 600)
    options = ("--predicted-by", thin, "--predictions", 2)
    log = tmp_path / "log.jsonl"
    assert train(tso, tmp_path, *options, "--log-file", log).code == 0
    settings = json.loads(log.read_text().splitlines()[0])
    assert settings["predicted_by"].startswith("thin.safetensors, ")
    assert settings["predictions"] == 2
    assert train(tso, tmp_path, *options, "--resume").code == 0
    assert "was trained with --predicted-by" in train(tso, tmp_path, "--resume").refusal
    fewer = (*options[:3], 1, "--resume")
    assert "was trained with --predictions 2" in train(tso, tmp_path, *fewer).refusal


def test_predictions_need_a_network_and_open3d(tso, tmp_path, monkeypatch):
    refused = train(tso, tmp_path, "--predictions", 5).refusal
    assert "--predictions counts what a network predicts, expected --predicted-by" in refused
    monkeypatch.setitem(sys.modules, "open3d", None)
    refused = train(tso, tmp_path, "--predicted-by", "default").refusal
    assert "--predicted-by needs open3d, which is not installed: pip install" in refused
    assert not list(tmp_path.iterdir())
