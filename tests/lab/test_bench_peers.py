"""Contestants do the same work, and one that cannot is recorded with its reason."""

from __future__ import annotations

import dataclasses
import sys
import types

import pytest
import torch

from tests.lab.benching import QUICK, RATES
from tso_cli.kernels.splat import splat
from tso_cli.lab.bench import chamfer, peers, silhouette
from tso_cli.lab.bench.material import SIGMA_SQ, projection, trajectory
from tso_cli.silhouette.chamfer import ChamferToInitial


def test_the_scatter_is_the_same_loss_where_every_mask_pixel_is_reached():
    scene = projection(2048, 24, torch.device("cpu"))
    sums = splat(scene.points_px, scene.valid, 24, 24, SIGMA_SQ)
    covered = (sums > 0.5) & (sums < 2.0)
    scene = dataclasses.replace(scene, mask=covered.float())
    # the clamp hides silhouettes nearer to 0 or 1 than 1e-6
    expected = torch.nn.functional.binary_cross_entropy(torch.tanh(sums).clamp(1e-6, 1 - 1e-6), scene.mask, reduction="sum")
    assert float(silhouette.scattered_loss(scene.points_px, scene.mask, 4)) == pytest.approx(float(expected), rel=1e-4)
    narrow = silhouette.scattered_loss(scene.points_px, scene.mask, 3)
    assert float(narrow) == pytest.approx(float(expected), rel=1e-2)


def test_every_contestant_computes_the_same_chamfer_distance_and_gradient():
    start = trajectory(200, torch.device("cpu"), steps=1)[0]
    # so far that many a neighbour is another than the point's own start
    moved = start + 0.05 * torch.randn(start.shape, generator=torch.Generator().manual_seed(0))
    expected = ChamferToInitial(start.double())(moved.double())
    gradients = []
    for name, make in chamfer.makers(start, QUICK).items():
        term = make()
        if isinstance(term, str):
            assert name in ("chamferdist", "pykeops", "point_cloud_utils", "pytorch3d")
            continue
        leaf = moved.clone().requires_grad_()
        value = term(leaf)
        assert float(value.detach()) == pytest.approx(float(expected), rel=1e-3), name
        gradients.append(torch.autograd.grad(value.sum(), leaf)[0])
    assert len(gradients) >= 5
    for gradient in gradients[1:]:
        torch.testing.assert_close(gradient, gradients[0], rtol=1e-3, atol=1e-6)


def test_a_trajectory_starts_where_nothing_moved_and_keeps_every_step():
    iterates = trajectory(100, torch.device("cpu"), steps=4)
    assert len(iterates) == 5
    moved = [float((iterate - iterates[0]).norm()) for iterate in iterates]
    assert moved[0] == 0.0
    assert moved == sorted(moved)


def test_a_peer_that_is_missing_is_recorded_and_stops_nothing(monkeypatch):
    for package in ("chamferdist", "pykeops", "point_cloud_utils", "pytorch3d", "gsplat"):
        monkeypatch.setitem(sys.modules, package, None)
    records = chamfer.measure(QUICK, [32], steps=1) + silhouette.measure(QUICK, RATES, [(32, 16)])
    missing = {(r["what"], r["name"]) for r in records if r.get("left_out") == peers.NOT_INSTALLED}
    assert missing == {
        *(("chamfer", name) for name in ("chamferdist", "pykeops", "point_cloud_utils", "pytorch3d")),
        ("silhouette", "pytorch3d"),
        ("silhouette", "gsplat"),
    }


def test_a_peer_that_fails_is_recorded_with_its_reason(monkeypatch):
    class ChamferDistance:
        def __call__(self, *_, **__):
            raise RuntimeError("needs\na GPU")

    monkeypatch.setitem(sys.modules, "chamferdist", types.SimpleNamespace(ChamferDistance=ChamferDistance))
    records = chamfer.measure(QUICK, [32], steps=1)
    (found,) = [record for record in records if record["name"] == "chamferdist"]
    assert found["left_out"] == "does not run here (needs a GPU)"


def test_a_peer_that_is_there_is_measured(monkeypatch):
    class ChamferDistance:
        def __call__(self, moved, initial, **_):
            return (moved - initial).square().sum()

    monkeypatch.setitem(sys.modules, "chamferdist", types.SimpleNamespace(ChamferDistance=ChamferDistance))
    records = chamfer.measure(QUICK, [32], steps=1)
    assert next(record for record in records if record["name"] == "chamferdist")["seconds"]["median"] > 0.0


def test_what_would_take_too_long_is_left_out_with_the_reason():
    assert silhouette.too_much("exact", 16384, 256) is None
    assert "multiply-adds" in silhouette.too_much("exact", 1_000_000, 1024)
    assert "taps" in silhouette.too_much("scatter 9x9", 1_000_000, 1024)
    assert silhouette.too_much("compiled", 1_000_000, 1024) is None
