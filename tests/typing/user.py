"""What a user may write with tso's public names; mypy --strict checks it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import tso_cli
from tso_cli import (
    Camera,
    InputError,
    MaskLoss,
    Mode,
    Preset,
    RefineConfig,
    RefineResult,
    TsoError,
    View,
    chamfer,
    draw_overlay,
    emd,
    f_score,
    fit_camera,
    iou,
    read_camera,
    read_cameras,
    read_cloud,
    read_depth,
    read_image,
    read_mask,
    refine,
    refine_batch,
    refine_each,
    write_cameras,
    write_cloud,
    write_depth,
    write_mask,
)


def refined(folder: Path, preset: Preset = "best", mode: Mode = "points") -> RefineResult:
    cloud = read_cloud(folder / "initial.ply")
    mask = read_mask(str(folder / "mask.png"))
    camera: Camera = read_camera(folder / "camera.json", mask.shape[1], mask.shape[0])
    view = View(mask, camera, name="front", depth=read_depth("depth.png", scale=1e-3))
    result = refine(cloud.points, [view], config=RefineConfig(mode=mode, preset=preset, steps=6))
    points: NDArray[np.float64] = result.points
    write_cloud("refined.ply", points, like=cloud, overwrite=True)
    draw_overlay("refined.png", result, view, photos=[read_image(folder / "image.png")])
    if result.trust.verdict == "doubtful":
        print(result.trust.reason, result.trust.confidence, result.fit.iou_after)
    for finding in result.findings:
        print(finding.name, finding.score, str(finding))
    return result


def judged(points: NDArray[np.float64], target: NDArray[np.float64]) -> list[float]:
    return [
        chamfer(points, target).chamfer,
        f_score(points, target, threshold=0.01).precision,
        emd(points, target),
        iou(np.ones((4, 4)), np.ones((4, 4))),
    ]


def many(points: NDArray[np.float64], view: View) -> int:
    failed = 0
    for found in refine_batch([(points, view), (points, [view, view])]):
        if isinstance(found, TsoError):
            failed += isinstance(found, InputError)
    for number, one in refine_each([(points, view)]):
        print(number, one if isinstance(one, TsoError) else one.fit.outcome)
    return failed


def fitted(points: NDArray[np.float64], mask: NDArray[np.float32]) -> Camera:
    found = fit_camera(points, mask)
    write_mask("mask.png", mask)
    write_depth("depth.npy", np.ones((4, 4)))
    write_cameras("cameras.json", [found.camera, *read_cameras("others.json")])
    loss = MaskLoss([View(mask, found.camera)])
    value, gradient = loss.value_and_gradient(points)
    print(value, gradient, tso_cli.__version__)
    return found.camera if found.sure else Camera.canonical(64, 64)
