"""What `tso refine` says and writes of cameras that were fitted or refined."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from ..errors import InputError
from ..io.output import check_output

if TYPE_CHECKING:
    from ..geometry.camera import Camera
    from ..geometry.view import View
    from ..refinement import RefineResult
    from ..scene.load import Scene


def refuse_camera_options(mode: str, fit: bool, refine_camera: bool, write_camera: Path | None) -> None:
    """InputError for an option that only points mode has."""
    given = {"--camera fit": fit, "--refine-camera": refine_camera, "--write-camera": write_camera is not None}
    for name, there in given.items():
        if there and mode != "points":
            raise InputError(
                f"{name} is for --mode points, found --mode {mode}, which places its cloud before the camera itself"
            )


def refuse_camera_output(path: Path | None, overwrite: bool, others: Sequence[Path | None]) -> None:
    """InputError for a camera file that cannot be written, or would replace another file of the command."""
    if path is None:
        return
    if path.suffix.lower() != ".json":
        raise InputError(f"{path}: the suffix is {path.suffix!r}, expected .json")
    check_output(path, overwrite)
    if any(other is not None and other.resolve() == path.resolve() for other in others):
        raise InputError(f"{path}: is another file of this command, expected another name for --write-camera")


def write_used_cameras(path: Path, result: RefineResult, masks: Sequence[Path]) -> None:
    """The cameras of the result as a camera file that names their masks."""
    from ..io.cameras import CameraRecord, write_cameras

    pairs = zip(result.cameras, masks, strict=True)
    write_cameras(path, [CameraRecord(camera, mask) for camera, mask in pairs], overwrite=True)


def camera_words(scene: Scene, result: RefineResult, refined: bool) -> str:
    """The cameras that were used, as short as can be; ``refined``: they were to be corrected."""
    words = scene.camera_in_short
    # No step: nothing was asked of the cameras.
    if not refined or not result.steps:
        return words
    corrected = [pair for pair in zip(scene.views, result.cameras, strict=True) if pair[0].camera is not pair[1]]
    if not corrected:
        return f"{words}, kept: no small correction explains the misfit"
    if len(scene.views) > 1:
        return f"{words}, {len(corrected)} of {len(scene.views)} corrected"
    turned, shifted = _change(*corrected[0], result)
    return f"{words}, corrected: turned by {turned:.1f} degrees, shifted by {100.0 * shifted:.1f} % of its distance"


def print_cameras(views: Sequence[View], result: RefineResult) -> None:
    """How far each camera moved, of cameras that were to move."""
    for view, camera in zip(views, result.cameras, strict=True) if result.steps else ():
        if camera is view.camera:
            from ..refinement.camera_correction import MISFIT_LEFT

            click.echo(
                f"  camera kept   (no small correction takes the misfit of the start under {MISFIT_LEFT:g} of it; {view.name})"
            )
        else:
            turned, shifted = _change(view, camera, result)
            click.echo(f"  camera turned {turned:.2f} degrees, shifted {100.0 * shifted:.2f} % of its distance   ({view.name})")


def camera_records(views: Sequence[View], result: RefineResult) -> dict[str, Any]:
    """For JSON: every camera as used, its turn in degrees and its shift as a share of its distance, 0 where it was kept."""
    records = []
    for view, camera in zip(views, result.cameras, strict=True):
        turned, shifted = _change(view, camera, result)
        place = {"K": camera.K.tolist(), "R": camera.R.tolist(), "t": camera.t.tolist()}
        records.append(place | {"turned_degrees": turned, "shifted_share": shifted})
    return {"refined_cameras": records}


def _change(view: View, camera: Camera, result: RefineResult) -> tuple[float, float]:
    """Turn in degrees, and the shift of the cloud's middle as a share of its distance, from the view's camera to ``camera``."""
    import numpy as np

    from ..geometry.rotations import angle_between

    start = result.judged[0]
    middle = (start.min(0) + start.max(0)) / 2.0
    before, after = (c.R @ middle + c.t for c in (view.camera, camera))
    shifted = np.linalg.norm(after - before) / np.linalg.norm(before)
    return float(angle_between(view.camera.R, camera.R)), float(shifted)
