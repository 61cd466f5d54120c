"""`tso refine --check`: where the cloud falls in each view, without refining it."""

from __future__ import annotations

import warnings
from typing import Any

import click

from ...cloud.cloud import ControlledCloud
from ...diagnosis.examine import Diagnosis, NoOverlapError
from ...diagnosis.placement import LEAST_BOX_IOU, Placement, describe_box
from ...diagnosis.trust import UNSURE
from ...geometry.arrays import Array
from ...geometry.camera import Camera
from ...kernels import blas
from ...optimisation.config import Settings
from ...refinement.run import check
from ...scene.load import Scene
from ...version import __version__
from ..options import echo_json
from .sentences import Words
from .sentences_of_moves import move_document, reading_of, words_of_move


def check_scene(
    scene: Scene, settings: Settings, words: Words, messages: list[str], as_json: bool, quiet: bool
) -> str:
    """Print cameras, scale and overlap. Returns what looks wrong, or "".

    ``messages`` collects the warnings of the run. Raises InputError where cloud and mask do not
    overlap.
    """
    no_overlap, move = None, None
    try:
        with blas.one_thread():
            diagnosis, cloud, move = check(scene.given, settings)
    except NoOverlapError as error:
        no_overlap, diagnosis, cloud = words.no_overlap(error), error.diagnosis, error.cloud
    for text in words.notes(diagnosis.notes):
        warnings.warn(text, stacklevel=1)
    if move and (reading := reading_of(move, settings.move, cloud.body.points)):
        warnings.warn(reading, stacklevel=1)
    suspicion = words.suspicion(diagnosis.suspicious)
    if suspicion and no_overlap:
        messages.append(suspicion)  # the error says it too
    elif suspicion:
        warnings.warn(suspicion, stacklevel=1)
    reason = suspicion or "".join(note.says for note in diagnosis.notes if note.name in UNSURE)
    if as_json:
        document = {
            **_document(scene, cloud, diagnosis),
            **(move_document(move, scene.fitted) if move else {}),
            "confidence": None,
            "verdict": "doubtful" if reason else None,
            "reason": reason,
            "warnings": messages,
            "suspects": words.suspects(diagnosis.suspicious),
            "version": __version__,
        }
        echo_json(document)
    elif not quiet:
        _print(scene, cloud, diagnosis)
        if move and (how := words_of_move(move, cloud.body.points)):
            click.echo(f"moves       {how}; the numbers are those after it")
    if no_overlap:
        raise no_overlap
    return reason


def camera_document(camera: Camera, source: str) -> dict[str, Any]:
    """A camera for JSON, and where it is from."""
    shape = {"model": camera.model, "width": camera.width, "height": camera.height}
    arrays = {name: getattr(camera, name).tolist() for name in ("K", "R", "t")}
    return {"source": source, **shape, **arrays}


def _document(scene: Scene, cloud: ControlledCloud, diagnosis: Diagnosis) -> dict[str, Any]:
    rows = zip(scene.views, scene.camera_sources, diagnosis.placements, strict=True)
    views = [
        {
            "mask": view.name,
            "camera": camera_document(view.camera, source),
            "placement": vars(placement),
            "meets": placement.meets,
        }
        for view, source, placement in rows
    ]
    points = cloud.control_points
    return {
        "camera": views[0]["camera"],
        "frame": scene.frame,
        "extent": (points.max(0) - points.min(0)).tolist(),
        "outliers": int(cloud.outliers.sum()),
        "moving": len(points),
        "placement": views[0]["placement"],
        "meets": all(placement.meets for placement in diagnosis.placements),
        "views": views,
    }


def _print(scene: Scene, cloud: ControlledCloud, diagnosis: Diagnosis) -> None:
    size = cloud.control_points.max(0) - cloud.control_points.min(0)
    if cloud.source.surface:
        count = len(scene.points)
        click.echo(f"mesh        {count:,} vertices; points sampled on its faces stand for it")
    placements = diagnosis.placements
    for number, (view, placement) in enumerate(zip(scene.views, placements, strict=True)):
        if len(placements) > 1:
            click.echo(f"view        {number + 1} of {len(placements)}, {view.name}")
        _print_view(view.camera, scene.camera_sources[number], size, placement)


def _print_view(camera: Camera, source: str, size: Array, placement: Placement) -> None:
    K = camera.K
    percent = 100.0 / placement.points
    depth = "all points lie behind the camera"
    if placement.depth is not None:
        nearest, farthest = placement.depth
        behind = f"{placement.behind:,} points behind the camera"
        depth = f"{nearest:.4g} to {farthest:.4g}, {behind}"
    click.echo(
        f"camera      {camera.model}, {camera.width}x{camera.height}, from {source}\n"
        f"            f {K[0, 0]:.4g} x {K[1, 1]:.4g} px, "
        f"principal point ({K[0, 2]:.4g}, {K[1, 2]:.4g})\n"
        f"            R {camera.R.round(4).tolist()}, t {camera.t.round(4).tolist()}\n"
        f"cloud       {placement.points:,} points, "
        f"extent {size[0]:.4g} x {size[1]:.4g} x {size[2]:.4g}\n"
        f"depth       {depth}\n"
        f"points fall {placement.inside_image:,} inside the image "
        f"({placement.inside_image * percent:.0f} %), {placement.inside_mask:,} on the mask "
        f"({placement.inside_mask * percent:.0f} %)\n"
        f"mask        {describe_box(placement.mask_box)}"
    )
    if placement.points_box is not None:
        click.echo(f"silhouette  {describe_box(placement.points_box)}")
    apart = f"they do not meet (expected over {LEAST_BOX_IOU})"
    click.echo(
        f"boxes       IoU {placement.box_iou:.3f}: {'they meet' if placement.meets else apart}"
    )
