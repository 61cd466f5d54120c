"""What `tso refine` says of a scene before, and of a result after."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..version import __version__
from . import options

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from ..geometry.camera import Camera
    from ..refinement import RefineResult
    from ..refinement.placement import Placement
    from ..scene.load import Scene


def _describe_camera(camera: Camera, source: str) -> dict[str, Any]:
    return {
        "source": source,
        "model": camera.model,
        "width": camera.width,
        "height": camera.height,
        "K": camera.K.tolist(),
        "R": camera.R.tolist(),
        "t": camera.t.tolist(),
    }


def document(
    result: RefineResult,
    scene: Scene,
    checkpoint: Path | None,
    output: Path,
    overlay: Path | None,
    preset: str,
    seconds: dict[str, float],
    warnings: list[str],
) -> dict[str, Any]:
    from ..evaluation.footprint import IOU_MEANS

    return {
        "mode": result.mode,
        "preset": preset,
        "checkpoint": checkpoint,
        "output": output,
        "overlay": overlay,
        "camera": _describe_camera(scene.view.camera, scene.camera_sources[0]),
        "views": [
            {
                "mask": view.name,
                "camera": _describe_camera(view.camera, camera_source),
                "iou_before": before,
                "iou_after": after,
                "trust": trust,
                "weight": weight,
                "window": box,
                "cells": cells,
            }
            for view, camera_source, (before, after), trust, weight, (box, cells) in zip(
                scene.views,
                scene.camera_sources,
                result.view_ious,
                result.view_trust,
                result.view_weights,
                result.view_windows,
                strict=True,
            )
        ],
        "frame": scene.frame,
        "points": len(result.points),
        "surface_samples": result.surface_samples,
        "steps": result.steps,
        "best_step": result.best_step,
        "stop_reason": result.stop_reason,
        "warnings": warnings,
        "loss_before": result.loss_before,
        "loss_after": result.loss_after,
        "losses": result.losses,
        "iou_before": result.iou_before,
        "iou_after": result.iou_after,
        "moved_mean": result.moved_mean,
        "moved_max": result.moved_max,
        "chamfer_to_initial": result.chamfer_to_initial,
        "convention": {
            "moved": "way of a point from its start, as a share of the object's size, the longest side of the start's box",
            "chamfer_to_initial": "squared distances, mean over points, both directions summed, longest side 1",
            "iou": IOU_MEANS,
            "trust": "in a view: 1, or less where the other views contradict it",
            "surface_samples": "points of a mesh's faces, which moved and chamfer_to_initial are of; null for a cloud",
            "weight": "of a view in the loss: its trust, divided among the views that show the same",
            "loss": result.objective + "; the mask's part is a sum over views, each times its weight",
            "symmetry": "a, b, c, d of the mirror plane ax + by + cz = d in the frame of the input, null for none",
            "sigma_sq": "squared 64ths of the window (encoder modes: mask and IoU are those of the 64x64 crop)",
            "window": "edges of the part of the mask that is looked at, px: left, top, right, bottom; cells: along its side",
        },
        "learning_rate": result.learning_rate,
        "gamma": result.gamma,
        "symmetry": result.symmetry,
        "symmetry_outcome": result.symmetry_outcome,
        "symmetry_reason": result.symmetry_reason,
        "sigma_sq": result.sigma_sq,
        "device": result.device,
        "seed": result.seed,
        "seconds": seconds,
        "version": __version__,
    }


def print_check(scene: Scene, placements: list[Placement], as_json: bool) -> None:
    from ..refinement.placement import SMALLEST_BOX_IOU

    size = scene.moving.max(0) - scene.moving.min(0)
    meets = [placement.box_iou > SMALLEST_BOX_IOU for placement in placements]
    if as_json:
        cameras = [_describe_camera(*one) for one in zip((v.camera for v in scene.views), scene.camera_sources, strict=True)]
        options.echo_json(
            {
                "camera": cameras[0],
                "frame": scene.frame,
                "extent": size.tolist(),
                "surface_samples": len(scene.moving) if scene.surface else None,
                "placement": placements[0].as_dict(),
                "meets": all(meets),
                "views": [
                    {"mask": view.name, "camera": camera, "placement": placement.as_dict(), "meets": met}
                    for view, camera, placement, met in zip(scene.views, cameras, placements, meets, strict=True)
                ],
                "version": __version__,
            }
        )
        return
    if scene.surface:
        click.echo(f"mesh        {len(scene.points):,} vertices; points of its faces stand for it as a cloud")
    for number, placement in enumerate(placements):
        view = scene.views[number]
        if len(placements) > 1:
            click.echo(f"view        {number + 1} of {len(placements)}, {view.name}")
        _print_placement(view.camera, scene.camera_sources[number], size, placement, meets[number])


def _print_placement(camera: Camera, source: str, size: NDArray[np.float64], placement: Placement, meets: bool) -> None:
    from ..refinement.placement import SMALLEST_BOX_IOU, describe_box

    K = camera.K
    click.echo(f"camera      {camera.model}, {camera.width}x{camera.height}, from {source}")
    click.echo(f"            f {K[0, 0]:.4g} x {K[1, 1]:.4g} px, principal point ({K[0, 2]:.4g}, {K[1, 2]:.4g})")
    click.echo(f"            R {camera.R.round(4).tolist()}, t {camera.t.round(4).tolist()}")
    click.echo(f"cloud       {placement.points:,} points, extent {size[0]:.4g} x {size[1]:.4g} x {size[2]:.4g}")
    if placement.depth is not None:
        click.echo(
            f"depth       {placement.depth[0]:.4g} to {placement.depth[1]:.4g}, {placement.behind:,} points behind the camera"
        )
    else:
        click.echo("depth       all points lie behind the camera")
    share = 100.0 / placement.points
    click.echo(
        f"points fall {placement.inside_image:,} inside the image ({placement.inside_image * share:.0f} %), "
        f"{placement.inside_mask:,} on the mask ({placement.inside_mask * share:.0f} %)"
    )
    click.echo(f"mask        {describe_box(placement.mask_box)}")
    if placement.points_box is not None:
        click.echo(f"silhouette  {describe_box(placement.points_box)}")
    verdict = "they meet" if meets else f"they do not meet (expected over {SMALLEST_BOX_IOU})"
    click.echo(f"boxes       IoU {placement.box_iou:.3f}: {verdict}")
