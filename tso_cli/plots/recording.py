"""A recording for the viewer rerun (rerun.io): how the points moved, step by step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from ..geometry.arrays import Array, Floats, Pixels
from ..geometry.camera import Camera
from ..geometry.points import evenly, longest_side, scattered
from ..geometry.view import View
from ..refinement import RefineResult
from ..scene.load import Scene
from .overlay import near_to_far

# Of larger clouds this many points are recorded in each step.
MOST_POINTS = 20_000
MOST_VIEWS = 12
SIDE = 640  # pixels of the longer side of a picture
START, MOVING = (160, 165, 170), (0, 114, 178)
# Share of the object's size: how far a picture is from its camera, and the radius of a point.
PICTURE_AT, RADIUS = 0.5, 0.004


@dataclass
class Iterates:
    """What `refine` reports to its ``progress``: losses, and control points [N, 3]."""

    steps: list[int] = field(default_factory=list)
    losses: list[float] = field(default_factory=list)
    points: list[Floats] = field(default_factory=list)

    def add(self, step: int, loss: float, points: Array) -> None:
        self.steps.append(step)
        self.losses.append(loss)
        self.points.append(scattered(points, MOST_POINTS).astype(np.float32))


def write_recording(
    path: Path,
    result: RefineResult,
    scene: Scene,
    photos: Sequence[Pixels | None],
    iterates: Iterates,
    lines: Mapping[str, str],
) -> None:
    """Write the recording of a result to ``path``; ``lines`` are what the command says of it.

    The timeline is "step". The result, whose colours are its displacement, appears after the last
    step. Everything is in the frame of the views.
    """
    import rerun as rr

    size = longest_side(result.initial[~result.outliers])
    faces = scene.file.faces() if result.of_mesh and scene.file is not None else None
    recording: Any = rr.RecordingStream("tso")
    # Written to memory first: rerun itself says nothing of a full disk.
    stream = recording.binary_stream()
    rr.set_strict_mode(True)  # else errors are warnings
    said = "\n".join(f"- {name} {line}" for name, line in lines.items())
    words = rr.TextDocument(said, media_type="text/markdown")
    recording.log("words", words, static=True)
    recording.log("scene", _up(rr, scene.views[0].camera), static=True)
    recording.log("scene/start", _cloud(rr, result.initial, START, faces, size), static=True)
    for number in evenly(len(scene.views), MOST_VIEWS):
        camera, photo = result.cameras[number], photos[number]
        _log_view(
            rr, recording, f"scene/view_{number + 1}", scene.views[number], camera, photo, size
        )
    _log_steps(rr, recording, iterates, size)
    recording.set_time("step", sequence=(iterates.steps or [0])[-1] + 1)
    moved = np.linalg.norm(result.points - result.initial, axis=1)
    share = moved / max(float(moved.max()), np.finfo(float).tiny)
    colours = near_to_far(1.0 - share)
    recording.log("scene/result", _cloud(rr, result.points, colours, faces, size))
    path.write_bytes(stream.read() or b"")


def _up(rr: Any, camera: Camera) -> Any:
    """The axis of the scene that points up in the first picture."""
    up = -camera.R[1]
    axis = int(np.abs(up).argmax())
    way = "UP" if up[axis] > 0.0 else "DOWN"
    return getattr(rr.ViewCoordinates, f"RIGHT_HAND_{'XYZ'[axis]}_{way}")


def _cloud(rr: Any, points: Array, colours: Any, faces: Any, size: float) -> Any:
    """A mesh, or the points of a cloud."""
    if faces is None:
        return rr.Points3D(points, colors=colours, radii=RADIUS * size)
    of_vertex = np.broadcast_to(np.asarray(colours, np.uint8), points.shape)
    return rr.Mesh3D(vertex_positions=points, triangle_indices=faces, vertex_colors=of_vertex)


def _log_steps(rr: Any, recording: Any, iterates: Iterates, size: float) -> None:
    if not iterates.steps:
        return
    when = [rr.TimeColumn("step", sequence=iterates.steps)]
    recording.send_columns("loss", when, rr.Scalars.columns(scalars=iterates.losses))
    lengths = [len(points) for points in iterates.points]
    columns = rr.Points3D.columns(positions=np.concatenate(iterates.points)).partition(lengths)
    recording.send_columns("scene/control_points", when, columns)
    looks = rr.Points3D.from_fields(colors=MOVING, radii=1.5 * RADIUS * size)
    recording.log("scene/control_points", looks, static=True)


def _log_view(
    rr: Any, recording: Any, name: str, view: View, camera: Camera, photo: Pixels | None,
    size: float,
) -> None:  # fmt: skip
    """The picture of a view, and its camera. rerun has no orthographic cameras."""
    scale = min(1.0, SIDE / max(camera.width, camera.height))
    width, height = (max(1, round(scale * side)) for side in (camera.width, camera.height))
    whole = (-0.5, -0.5, camera.width - 0.5, camera.height - 0.5)
    camera = camera.cropped(whole, width, height)
    if camera.model == "perspective":
        K = camera.K.copy()
        K[:2, 2] += 0.5  # rerun counts from the corner of the first pixel, not from its centre
        recording.log(name, rr.Transform3D(mat3x3=camera.R.T, translation=-camera.R.T @ camera.t),
                      static=True)  # fmt: skip
        recording.log(name, rr.Pinhole(image_from_camera=K, resolution=[width, height],
                                       image_plane_distance=PICTURE_AT * size),
                      static=True)  # fmt: skip
    mask = np.rint(view.mask * 255.0).astype(np.uint8)
    picture = mask if photo is None else np.ascontiguousarray(photo)
    reduced = Image.fromarray(picture).convert("RGB").resize((width, height), Image.Resampling.BOX)
    recording.log(f"{name}/picture", rr.Image(np.asarray(reduced)).compress(), static=True)
    if photo is not None:
        inside = Image.fromarray(mask).resize((width, height), Image.Resampling.BOX)
        labels = (np.asarray(inside) > 127).astype(np.uint8)
        recording.log(f"{name}/mask", rr.SegmentationImage(labels, opacity=0.4), static=True)
