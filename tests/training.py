"""Small training data for tests: boxes with a knob, drawn as dense clouds."""

from typing import Any

import numpy as np
import pytest

from tso_cli.datasets.items import ObjectItem, ViewItem
from tso_cli.geometry.camera import Camera
from tso_cli.network import model as networks
from tso_cli.render.viewpoints import look_at
from tso_cli.train.config import TrainConfig
from tso_lab.studies import fingerprint


def make_thin(monkeypatch: pytest.MonkeyPatch) -> None:
    """The same layers with few channels: steps of milliseconds and files of kilobytes."""
    make_known(monkeypatch)
    monkeypatch.setattr(
        networks,
        "CONVOLUTIONS",
        tuple((4, size, stride) for _, size, stride in networks.CONVOLUTIONS),
    )


def make_known(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fingerprints cost nothing: every part has one number. What they are of is tested in
    test_fingerprint.py.
    """
    monkeypatch.setattr(
        fingerprint, "today", lambda part: {"number": float(list(fingerprint.PARTS).index(part))}
    )


def box_surface(sides: np.ndarray, count: int, rng: np.random.Generator) -> np.ndarray:
    """Points on the surface of a box, longest side 1, with a knob on top so that it looks different
    from every side.
    """
    points = rng.uniform(-0.5, 0.5, (count, 3))
    axis = rng.integers(3, size=count)
    points[np.arange(count), axis] = np.where(points[np.arange(count), axis] > 0, 0.5, -0.5)
    points *= sides
    points[: count // 8] = points[: count // 8] * 0.3 + [sides[0] * 0.35, 0.0, 0.0]
    low, high = points.min(0), points.max(0)
    return (points - (low + high) / 2) / (high - low).max()


def picture(points: np.ndarray, camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """Image (depth as grey) and mask of a dense cloud."""
    pixels, depth = camera.project(points)
    u, v = np.clip(np.rint(pixels), 0, 63).astype(int).T
    image = np.zeros((64, 64, 3), np.uint8)
    order = np.argsort(-depth)
    image[v[order], u[order]] = np.clip(400 - 100 * depth[order], 60, 255)[:, None]
    mask = np.zeros((64, 64), np.float32)
    mask[v, u] = 1.0
    return image, mask


def make_objects(count: int = 3, views: int = 4, category: str = "box") -> list[ObjectItem]:
    rng = np.random.default_rng(0)
    objects = []
    for number in range(count):
        dense = box_surface(rng.uniform(0.3, 1.0, 3), 20_000, rng)
        taken = []
        for view in range(views):
            camera = look_at(rng.uniform(0, 360), rng.uniform(-5, 40), 2.8, (64, 64))
            shown = picture(dense, camera)
            taken.append(
                ViewItem(f"{category}{number} view {view}", camera, lambda shown=shown: shown)
            )  # type: ignore[misc]
        points = dense[::20].astype(np.float32)
        objects.append(
            ObjectItem(f"{category}{number}", category, taken, lambda points=points: points)
        )  # type: ignore[misc]
    return objects


def config(**changes: Any) -> TrainConfig:
    return TrainConfig(
        **{"steps": 6, "batch_size": 2, "points": 64, "views": 2, "saturation_steps": 2, **changes}
    )
