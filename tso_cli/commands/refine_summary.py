"""What `tso refine` prints of a result: four lines for everybody, and all measures and settings for who asks."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from .refine_camera import camera_words, print_cameras

if TYPE_CHECKING:
    from ..refinement import RefineResult
    from ..scene.load import Scene


def print_result(
    result: RefineResult, scene: Scene, network: str | None, refined_cameras: bool, output: Path, seconds: dict[str, float]
) -> None:
    """What was written, how well it agrees with the masks, how far it moved and what was assumed.

    ``network`` : in words, of the network modes. ``refined_cameras`` : they were to be corrected.
    """
    several = len(scene.views) > 1
    follow = f"vertices, which follow {result.surface_samples:,} points of the faces" if result.surface else "points"
    click.echo(f"{output}: {len(result.points):,} {follow}")
    masks = f"masks, mean of {len(scene.views)}" if several else "mask"
    click.echo(f"  IoU    {result.iou_before:.3f} -> {result.iou_after:.3f} with the {masks}")
    click.echo(f"  moved  {_moved(result)}")
    used = [network, camera_words(scene, result, refined_cameras), _symmetry(result), _doubted(result, scene)]
    click.echo("  used   " + "; ".join([part for part in used if part] + [f"{seconds['total']:.1f} s"]))


def _moved(result: RefineResult) -> str:
    from ..refinement.result import SMALL_DISPLACEMENT, why_unmoved

    if why := why_unmoved(result):
        return f"nothing: {why}"
    least = f"under {100.0 * SMALL_DISPLACEMENT:g} %"
    mean, most = (
        f"{100.0 * share:.1f} %" if share >= SMALL_DISPLACEMENT else least for share in (result.moved_mean, result.moved_max)
    )
    return f"{mean} of the object's size on average, {most} at most"


def _symmetry(result: RefineResult) -> str | None:
    if not result.steps:
        return None
    pictures = "mask contradicts" if len(result.cameras) == 1 else "masks contradict"
    return {
        "used": "assumed mirror-symmetric, as the cloud is",
        "given": "assumed mirror-symmetric, about the given plane",
        "none_found": "no mirror symmetry assumed: the cloud has none",
        "contradicted": f"no mirror symmetry assumed: the {pictures} it",
        # Elsewhere nobody would expect one.
        "not_asked": "no mirror symmetry assumed, as asked" if result.averaged else None,
    }[result.symmetry_outcome]


def _doubted(result: RefineResult, scene: Scene) -> str | None:

    from ..refinement.result import DOUBTFUL_INLIER_WEIGHT

    names = [view.name for view, trust in zip(scene.views, result.view_trust, strict=True) if trust < DOUBTFUL_INLIER_WEIGHT]
    return f"little of {', '.join(names)} (contradicted by the others)" if names else None


def print_details(result: RefineResult, scene: Scene, refined_cameras: bool, seconds: dict[str, float]) -> None:
    """Every measure and setting."""
    from ..evaluation.footprint import IOU_MEANS

    best = f"best at step {result.best_step}"
    if result.averaged and result.best_step:
        best = f"the mean over the stages, the last one's {best}"
    click.echo(f"  steps  {result.steps}, {best}; ended: {result.stop_reason}")
    click.echo(f"  loss   {result.loss_before:.1f} -> {result.loss_after:.1f}   ({result.objective})")
    click.echo(
        f"  Chamfer to the start x1000 {result.chamfer_to_initial * 1e3:.3f}   (squared, mean over points, both directions, "
        "longest side 1)"
    )
    click.echo(f"  IoU is {IOU_MEANS}")
    for view, (before, after), trust, weight in zip(
        scene.views, result.view_ious, result.view_trust, result.view_weights, strict=True
    ):
        click.echo(f"  view   {before:.3f} -> {after:.3f}   trust {trust:.2f}, weight {weight:.2f}, {view.name}")
    if refined_cameras:
        print_cameras(scene.views, result)
    click.echo(f"  mirror {_plane(result)}")
    click.echo(
        f"  sigma_sq {result.sigma_sq:g} (squared 64ths of the window), learning rate {result.learning_rate:g}, gamma "
        f"{result.gamma:g}, preset {result.preset}, {result.device}, seed {result.seed}, {seconds['optimise']:.2f} s in the "
        f"loop, {seconds['total']:.2f} s in all"
    )


def _plane(result: RefineResult) -> str:
    if result.symmetry is None:
        return f"no plane: {result.symmetry_reason}"
    *normal, offset = result.symmetry
    terms = [f"{number:+.3f} {axis}" for number, axis in zip(normal, "xyz", strict=True) if abs(number) >= 5e-4]
    return f"plane {' '.join(terms).lstrip('+')} = {offset:.4g}: {result.symmetry_reason}"
