"""`tso refine --check`: where the cloud falls in each view, without refining it."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from typing import Any

import click

from ..cloud.cloud import Cloud, outlier_warnings
from ..diagnosis.agreement import Agreement
from ..diagnosis.hypotheses import Suspect
from ..diagnosis.mistake_check import checked_hint
from ..diagnosis.placement import (
    SMALLEST_BOX_IOU,
    Placement,
    behind_warnings,
    describe_box,
    mask_doubts,
    place,
    require_overlap,
)
from ..geometry.camera import Array, Camera
from ..geometry.view import View
from ..kernels import blas
from ..optimisation.problem import Problem
from ..refinement import RefineConfig
from ..scene.load import Scene
from ..version import __version__
from . import options


def check_scene(
    scene: Scene, config: RefineConfig, as_json: bool, quiet: bool, warned: list[str]
) -> str:
    """Print cameras, scale and overlap; InputError where cloud and mask do not overlap. Returns what looks wrong, or "".

    ``warned`` collects the warnings so far and those to come.
    """
    placements = [place(scene.moving, view) for view in scene.views]
    doubts = outlier_warnings(_outliers(scene))
    for view, placement in zip(scene.views, placements, strict=True):
        doubts += [*mask_doubts(view, len(scene.moving)), *behind_warnings(placement, view)]
    for doubt in doubts:
        warnings.warn(doubt, stacklevel=1)
    overlaps = [placement.box_iou > SMALLEST_BOX_IOU for placement in placements]
    agreement = Agreement.of(scene.moving, scene.views) if scene.start else None
    if scene.start and agreement and agreement.hint and all(overlaps):
        agreement = _checked(scene.start, scene.views, config)
    suspicion = agreement.suspicion if agreement else None
    if suspicion and all(overlaps):
        warnings.warn(suspicion, stacklevel=1)
    elif suspicion:
        # The error to come says it too.
        warned.append(suspicion)
    reason = suspicion or scene.doubt
    if as_json:
        suspects = agreement.named if agreement else ()
        judged = verdict_document(None, "doubtful" if reason else None, reason, warned, suspects)
        options.echo_json(_document(scene, placements, overlaps, judged))
    elif not quiet:
        _print(scene, placements, overlaps)
    for placement, view in zip(placements, scene.views, strict=True):
        require_overlap(placement, view, suspicion)
    return reason


def _checked(cloud: Cloud, views: tuple[View, ...], config: RefineConfig) -> Agreement | None:
    """With its hint checked as a refinement does it."""
    settings = config.settings(len(views))
    with warnings.catch_warnings(), blas.one_thread():
        # What it warns of is said here.
        warnings.simplefilter("ignore")
        problem, interrupted = checked_hint(Problem.of(cloud, views, settings), settings)
    if interrupted:
        raise KeyboardInterrupt
    return problem.agreement


def camera_document(camera: Camera, source: str) -> dict[str, Any]:
    """A camera for JSON, and where it is from."""
    shape = {"model": camera.model, "width": camera.width, "height": camera.height}
    return {
        "source": source,
        **shape,
        **{name: getattr(camera, name).tolist() for name in ("K", "R", "t")},
    }


def verdict_document(
    confidence: float | None,
    verdict: str | None,
    reason: str,
    warned: list[str],
    suspects: Sequence[Suspect],
) -> dict[str, Any]:
    """What a user of many objects looks at first."""
    return {
        "confidence": confidence,
        "verdict": verdict,
        "reason": reason,
        "warnings": warned,
        "suspects": [suspect._asdict() for suspect in suspects],
    }


def _document(
    scene: Scene, placements: list[Placement], overlaps: list[bool], judged: dict[str, Any]
) -> dict[str, Any]:
    views = []
    for view, source, placement, overlap in zip(
        scene.views, scene.camera_sources, placements, overlaps, strict=True
    ):
        camera = camera_document(view.camera, source)
        views.append(
            {"mask": view.name, "camera": camera, "placement": vars(placement), "meets": overlap}
        )
    return {
        "camera": views[0]["camera"],
        "frame": scene.frame,
        "extent": (scene.moving.max(0) - scene.moving.min(0)).tolist(),
        "outliers": _outliers(scene),
        "moving": len(scene.moving),
        "placement": views[0]["placement"],
        "meets": all(overlaps),
        "views": views,
        **judged,
        "version": __version__,
    }


def _outliers(scene: Scene) -> int:
    return int(scene.start.outliers.sum()) if scene.start else 0


def _print(scene: Scene, placements: list[Placement], overlaps: list[bool]) -> None:
    size = scene.moving.max(0) - scene.moving.min(0)
    if scene.start and scene.start.surface:
        click.echo(
            f"mesh        {len(scene.points):,} vertices; points sampled on its faces stand for it as a cloud"
        )
    for number, (view, placement) in enumerate(zip(scene.views, placements, strict=True)):
        if len(placements) > 1:
            click.echo(f"view        {number + 1} of {len(placements)}, {view.name}")
        _print_view(view.camera, scene.camera_sources[number], size, placement, overlaps[number])


def _print_view(
    camera: Camera, source: str, size: Array, placement: Placement, overlap: bool
) -> None:
    K = camera.K
    share = 100.0 / placement.points
    depth = "all points lie behind the camera"
    if placement.depth is not None:
        depth = f"{placement.depth[0]:.4g} to {placement.depth[1]:.4g}, {placement.behind:,} points behind the camera"
    click.echo(
        f"camera      {camera.model}, {camera.width}x{camera.height}, from {source}\n"
        f"            f {K[0, 0]:.4g} x {K[1, 1]:.4g} px, principal point ({K[0, 2]:.4g}, {K[1, 2]:.4g})\n"
        f"            R {camera.R.round(4).tolist()}, t {camera.t.round(4).tolist()}\n"
        f"cloud       {placement.points:,} points, extent {size[0]:.4g} x {size[1]:.4g} x {size[2]:.4g}\n"
        f"depth       {depth}\n"
        f"points fall {placement.inside_image:,} inside the image ({placement.inside_image * share:.0f} %), "
        f"{placement.inside_mask:,} on the mask ({placement.inside_mask * share:.0f} %)\n"
        f"mask        {describe_box(placement.mask_box)}"
    )
    if placement.points_box is not None:
        click.echo(f"silhouette  {describe_box(placement.points_box)}")
    verdict = "they meet" if overlap else f"they do not meet (expected over {SMALLEST_BOX_IOU})"
    click.echo(f"boxes       IoU {placement.box_iou:.3f}: {verdict}")
