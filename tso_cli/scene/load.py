"""Files -> Scene: the cloud or the network to refine, the masks, and the cameras that see them."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from ..cloud.cloud import Cloud
from ..diagnosis.assumptions import Assumption, as_meant, assumptions_of, left_handed
from ..diagnosis.findings import ASSUMED_CAMERA, Finding
from ..errors import InputError
from ..geometry.arrays import Array, Floats, Pixels
from ..geometry.view import View
from ..io.clouds import PointCloud, read_cloud
from ..io.views import KnownFocal, ViewFiles, load_views, summary_of, view_without_camera
from ..refinement.scene import RefineScene

if TYPE_CHECKING:
    from ..network.model import BaseNetwork
    from ..pose.fit import FittedCamera

Placing = Literal["silhouette", "box", "camera"]
ONLY_SHOWN = "the cloud has no colours: the photo is shown, and does not guide the result"
WITHOUT_FIT = "the photo is only shown: it guides the fit of a camera alone"
Y_UP = (".glb", ".gltf")  # by the definition of glTF
MIRRORED = " (mirrored with its mask: the cloud has left-handed axes)"


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything one refinement needs, and where it is from.

    given : the start, its views and how they are meant. The start is the cloud of the file, or
        the network's prediction in the network's frame.
    camera_sources : for each view, where its camera is from. camera_summary : the same for all
        views, shorter.
    frame : of the output: "input" (the frame of the cloud), "view", "canonical" or "world";
        ``to_output`` maps points to it.
    file : in points mode, what the file holds.
    shown : in points mode the views with their images, if these do not guide the result.
    fitted : the camera that was fitted to cloud and mask, and its alternatives; None if it was
        given.
    network, image, sigma_sq, photo : in the network modes the network, its input [3, 64, 64], the
        variance of its training, and the photo's part that the network sees [H, W, 3].
    """

    given: RefineScene
    camera_sources: tuple[str, ...]
    camera_summary: str
    frame: str
    file: PointCloud | None = None
    shown: tuple[View, ...] = ()
    fitted: FittedCamera | None = None
    network: BaseNetwork | None = None
    image: Floats | None = None
    sigma_sq: float | None = None
    photo: Pixels | None = None
    to_output: Callable[[Array], Array] = lambda points: points

    @property
    def points(self) -> Array:
        """[N, 3] float64, the start."""
        return self.given.cloud.points

    @property
    def views(self) -> tuple[View, ...]:
        """The views as they are meant. In the network modes there is one, of the network's crop."""
        return self.given.views

    @property
    def view(self) -> View:
        """The first view."""
        return self.views[0]


def load_points_scene(
    cloud_file: Path,
    files: ViewFiles | Path,
    assume: Sequence[str] = (),
    fit: int | None = None,
    index: int | None = None,
) -> Scene:
    """The scene of points mode: a cloud, or a mesh whose surface is refined, and its views.

    ``files`` may be a single mask. ``assume`` names hypotheses that are taken as true. ``fit``
    estimates the camera of the one mask from mask and cloud (`fit_camera`): 0 takes the best pose,
    a larger number that of its alternatives. The images of a cloud without colours are only shown,
    with a warning. ``index`` is as in `read_cloud`. Errors as `load_views` and `read_cloud`.
    """
    files = files if isinstance(files, ViewFiles) else ViewFiles([files])
    files = replace(files, y_up=cloud_file.suffix.lower() in Y_UP)
    assumptions = assumptions_of(assume, list(map(str, files.masks)))
    file = read_cloud(cloud_file, index=index)
    if file.source is not None:
        file.source.require_movable()
    # A camera that is to be fitted needs colours too: they break the symmetries of a shape.
    compares_colours = bool(files.image) or fit is not None
    colours = file.colours() if compares_colours else None
    paint = file.paint() if compares_colours else None
    cloud = Cloud(file.points, str(cloud_file), colours, file.faces(), False, file.faint(), paint)
    if not files.image or colours is not None or cloud.paint is not None:
        if files.image and fit is None:
            warnings.warn(WITHOUT_FIT, stacklevel=2)
        return _scene_of(cloud, file, files, assumptions, fit)
    warnings.warn(ONLY_SHOWN, stacklevel=2)
    scene = _scene_of(cloud, file, replace(files, any_size=True), assumptions, fit)
    without = tuple(replace(view, image=None) for view in scene.given.read)
    return replace(scene, given=replace(scene.given, read=without), shown=scene.views)


def _scene_of(
    cloud: Cloud,
    file: PointCloud,
    files: ViewFiles,
    assumptions: tuple[Assumption, ...],
    fit: int | None,
) -> Scene:
    if fit is not None:
        return _with_fitted_camera(cloud, file, files, assumptions, fit)
    read, origins = load_views(files)
    mirrored = MIRRORED if left_handed(assumptions) else ""
    described = tuple(f"{origin}{mirrored}" for origin in origins)
    known = [
        Finding(ASSUMED_CAMERA, (i,)) for i, origin in enumerate(origins) if origin.file is None
    ]
    scene = RefineScene(cloud, tuple(read), assumptions, tuple(known))
    return Scene(scene, described, summary_of(origins), "input", file)


def _with_fitted_camera(
    cloud: Cloud,
    file: PointCloud,
    files: ViewFiles,
    assumptions: tuple[Assumption, ...],
    pose: int,
) -> Scene:
    from ..pose.fit import fit_camera

    read, focal = view_without_camera(files)
    if files.depth:
        return _before_camera(cloud, file, read, focal, assumptions)
    view, body = as_meant(read, assumptions), cloud.controlled()
    K = view.camera.K
    fitted = fit_camera(
        body.control_points,
        view.mask,
        view.known,
        float(K[0, 0]) if focal.deviation else None,
        view.name,
        K if focal.deviation == 0.0 else None,
        focal.deviation,
        view.image,
        body.colours,
    ).chosen(pose)
    # The fitted camera is in the axes of the cloud, whatever these are.
    of_mask = tuple(assumption for assumption in assumptions if assumption.hypothesis.of_mask)
    of_cloud = [assumption for assumption in assumptions if not assumption.hypothesis.of_mask]
    read = replace(as_meant(read, of_cloud), camera=fitted.camera)
    known = (
        () if fitted.sure else (Finding("unsure-camera", (0,), values={"why": fitted.why_unsure}),)
    )
    by = f", with {focal.source}" if focal.source else ""
    how_sure = "pose sure" if fitted.sure else "pose unsure"
    focal_length = "" if focal.deviation == 0.0 else f"; {fitted.focal_length}"
    summary = f"camera fitted to cloud and mask{by}: {how_sure}{focal_length}"
    scene = RefineScene(cloud, (read,), of_mask, known)
    return Scene(scene, (fitted.describe(),), summary, "input", file, fitted=fitted)


def _before_camera(
    cloud: Cloud,
    file: PointCloud,
    view: View,
    focal: KnownFocal,
    assumptions: tuple[Assumption, ...],
) -> Scene:
    """The scene of a camera at the origin, which looks along z.

    A depth map shows where the object is in the axes and the unit of the camera. So the cloud moves
    there, and is written there.
    """
    if focal.deviation != 0.0:
        raise InputError(
            f"{view.name}: with a depth map the focal length is not estimated, expected "
            "`intrinsics`, `focal` or `fov`"
        )
    camera = replace(view.camera, R=np.eye(3), t=np.zeros(3))
    scene = RefineScene(cloud, (replace(view, camera=camera),), assumptions)
    summary = f"camera at the origin, with {focal.source}: the cloud moves into its axes"
    return Scene(scene, (summary,), summary, "camera", file)
