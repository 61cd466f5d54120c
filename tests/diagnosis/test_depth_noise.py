"""Noise of depth maps: it is measured, averaged out, and what is no noise stays."""

from dataclasses import replace

import numpy as np
import pytest

from tests.scenes import depth_of, example
from tso_cli import RefineConfig, refine
from tso_cli.diagnosis.depth_map import noise, without_noise

NAMES = "chair", "car", "airplane"
SCENES = {name: example(name) for name in NAMES}
DEPTHS = {name: depth_of(scene) for name, scene in SCENES.items()}


def noisy(name: str, deviation: float) -> np.ndarray:
    """The true depths of an example, of which the longest side is 1, with normal noise."""
    return DEPTHS[name] + deviation * np.random.default_rng(0).normal(size=DEPTHS[name].shape)


def seen(name: str, depth: np.ndarray, kind: str = "z"):
    return replace(SCENES[name].view, depth=depth, depth_kind=kind)


def off(name: str, depth: np.ndarray) -> float:
    """The root mean square of what known depths are off."""
    error = (depth - DEPTHS[name])[SCENES[name].view.inside]
    return float(np.sqrt(np.nanmean(np.square(error))))


@pytest.mark.parametrize("name", NAMES)
def test_an_exact_map_stays_bit_for_bit(name):
    view = seen(name, DEPTHS[name])
    (found,), findings = without_noise([view])
    assert found is view
    assert findings == []


@pytest.mark.parametrize("deviation", [0.01, 0.03, 0.1])
@pytest.mark.parametrize("name", NAMES)
def test_the_noise_is_measured(name, deviation):
    known = SCENES[name].view.inside & np.isfinite(DEPTHS[name])
    assert noise(noisy(name, deviation), known) == pytest.approx(deviation, rel=0.25)


@pytest.mark.parametrize("name", NAMES)
def test_most_of_the_noise_is_averaged_out(name):
    depth = noisy(name, 0.05)
    (found,), (finding,) = without_noise([seen(name, depth)])
    assert off(name, found.depth) < 0.5 * off(name, depth)
    assert finding.name == "depth-noisy"
    assert not finding.suspicious
    assert "noise of 0.05" in finding.says


def test_edges_of_surfaces_stay():
    """A step of ten deviations is as high as before, up to its last pixels."""
    view = SCENES["chair"].view
    step = np.where(np.arange(view.mask.shape[1]) < view.mask.shape[1] // 2, 1.0, 1.5)
    depth = step + 0.05 * np.random.default_rng(1).normal(size=view.mask.shape)
    mask = np.pad(np.ones(np.subtract(view.mask.shape, 8)), 4)
    view = replace(view, mask=mask, depth=depth, depth_kind="z")
    (found,), _ = without_noise([view])
    mean = found.depth[8:-8].mean(0)
    middle = len(mean) // 2
    assert mean[middle] - mean[middle - 1] > 0.45


def test_unknown_depths_stay_unknown_and_count_for_nothing():
    depth = noisy("chair", 0.05)
    holes = np.random.default_rng(2).random(depth.shape) < 0.3
    (found,), _ = without_noise([seen("chair", np.where(holes, np.nan, depth))])
    np.testing.assert_array_equal(np.isnan(found.depth), holes | np.isnan(depth))
    assert off("chair", found.depth) < 0.6 * off("chair", depth)


def test_a_map_in_its_own_unit_is_smoothed_alike():
    (metric,), _ = without_noise([seen("car", noisy("car", 0.05))])
    (affine,), _ = without_noise([seen("car", 255.0 * noisy("car", 0.05) - 40.0, "affine")])
    np.testing.assert_allclose((affine.depth + 40.0) / 255.0, metric.depth, atol=1e-9)


def test_without_its_noise_a_map_brings_more(monkeypatch):
    chair, config = SCENES["chair"], RefineConfig(accept_doubtful=True)
    view = seen("chair", noisy("chair", 0.1))
    smoothed = refine(chair.points, view, config=config)
    monkeypatch.setattr(
        "tso_cli.refinement.depth_maps.without_noise", lambda views: (list(views), [])
    )
    as_given = refine(chair.points, view, config=config)
    assert chair.error(smoothed.points) < 0.95 * chair.error(as_given.points)
