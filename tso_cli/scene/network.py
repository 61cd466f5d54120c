"""The scene of the network modes: photo, mask and checkpoint -> crop, cloud and camera."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..cloud.cloud import Cloud
from ..diagnosis.assumptions import INVERTED, as_meant
from ..diagnosis.findings import Finding
from ..diagnosis.symptoms import coarse, photo, specks
from ..errors import InputError
from ..geometry.arrays import Array, Pixels
from ..geometry.camera import CANONICAL_DISTANCE, CANONICAL_ROTATION, Camera
from ..geometry.view import View
from ..io.checkpoints import load_network
from ..io.clouds import SUFFIXES
from ..io.images import read_image
from ..io.views import NO_FILE, ViewFiles, load_views, require_same_size
from ..losses.projection import project_differentiably
from ..losses.silhouette import silhouette_bce
from ..network.input import network_input
from ..optimisation.loop import minimise
from ..optimisation.parameters import PointParameters
from ..refinement.scene import RefineScene
from .load import Placing, Scene
from .photos import cut_out

if TYPE_CHECKING:
    from ..network.model import BaseNetwork, NetworkConfig

# Twenty steps of a 200th shift a cloud by a tenth of its longest side; more change no result.
ALIGNMENT_STEPS, ALIGNMENT_STEP = 20, 0.005


def load_network_scene(
    image_file: Path,
    files: ViewFiles | Path,
    checkpoint: Path,
    invert: bool = False,
    world: bool = False,
    placing: Placing = "silhouette",
) -> Scene:
    """The scene of a photo: the crop that the network sees, and the camera of the crop.

    A view-aligned network predicts in the axes of the camera. Only K of a camera file counts; the
    crop has the canonical camera without a file. The cloud is placed in front of the camera. A
    canonical-frame network predicts in the frame of its training objects. R and t of the camera
    file lead from there to the picture.

    Parameters
    ----------
    files : of the one view; may be its mask.
    invert : whether the mask shows the object dark.
    world : give the output of a view-aligned network in the world coordinates of the camera file.
    placing : how the cloud of a view-aligned network is placed. "silhouette" aligns it with the
        mask (`align_silhouette`), "box" with the mask's box (`place_in_front`). "camera" takes t
        of the camera file, as for an object of longest side 1 at the origin.

    Raises InputError if a file cannot be used, sizes of image and mask differ, or the frame or
    placing needs a camera file.
    """
    files = files if isinstance(files, ViewFiles) else ViewFiles([files])
    (view,), (origin,) = load_views(files)
    camera_file = origin.file
    view = as_meant(view, [INVERTED] if invert else [])
    if Path(image_file).suffix.lower() in SUFFIXES:
        raise InputError(f"{image_file}: is a cloud or mesh, expected a photo, or mode points")
    image = read_image(image_file)
    require_same_size(image_file, image.shape, files.masks[0], view.mask.shape)
    network, config = load_network(checkpoint)
    option = "`frame` world" if world else f"`place` {placing}" if placing != "silhouette" else None
    if config.frame != "view" and camera_file is None:
        raise InputError(
            f"{checkpoint}: predicts in the canonical frame of its training objects, which needs "
            "the camera's R and t; found no camera file, expected one (`camera` FILE)"
        )
    if config.frame != "view" and option:
        raise InputError(
            f"{checkpoint}: predicts in the canonical frame, found {option}, which is for "
            "view-aligned networks"
        )
    if camera_file is None and placing == "camera":
        raise InputError(
            "`place` camera needs the camera's t; found no camera file, expected one "
            "(`camera` FILE)"
        )
    if camera_file is None and world:
        raise InputError(
            "`frame` world needs the camera's R and t; found no camera file, expected one "
            "(`camera` FILE)"
        )
    if config.frame == "view" and view.camera.model != "perspective":
        raise InputError(
            f"{camera_file}: model is {view.camera.model}, expected perspective for a view-aligned "
            "network"
        )
    return network_scene(
        image,
        view,
        network,
        config,
        str(origin),
        camera_file is not None,
        world,
        placing,
    )


def network_scene(
    image: Pixels,
    view: View,
    network: BaseNetwork,
    config: NetworkConfig,
    source: str = "given",
    known_camera: bool = True,
    world: bool = False,
    placing: Placing = "silhouette",
) -> Scene:
    """`load_network_scene` for a photo [H, W, 3] or [H, W, 4], its view, and a network in memory.

    ``source`` says where the camera of the view is from. Without ``known_camera`` the crop gets the
    canonical camera, which only a view-aligned network can use.
    """
    import torch

    inputs = network_input(image, view, config.image_size, config.crop_share, config.background)
    with torch.no_grad():
        points = network(torch.from_numpy(inputs.image).unsqueeze(0))[0].double().numpy()
    # Of the photo's mask: the crop is enlarged and hides that a mask is coarse.
    known = [photo(view, 0), coarse(view, 0, len(points)), specks(view, 0)]
    crop, to_output, frame = inputs.view(view.name), Scene.to_output, config.frame
    summary = f"camera {source}" if known_camera else f"canonical camera {NO_FILE}"
    if config.frame == "view":
        if not known_camera:
            crop = replace(crop, camera=Camera.canonical(config.image_size, config.image_size))
            if not config.crop_share:
                known.append(Finding("assumed-picture", (0,)))
        placed = _placed(points, crop, view, placing, config.sigma_sq)
        distance = f"at distance {placed.t[2]:.3g}"
        turned = "; R and t turn the result" if world else ""
        if placing == "camera":
            summary += f" (only its K and distance{turned})"
            source += f"; the network's cloud is placed where it has the object, {distance}"
        else:
            # Without a crop of fixed size, t decides which part of the picture a network sees.
            numbers, verb = ("K", "counts") if config.crop_share else ("K and t", "count")
            if known_camera:
                summary += f" (only its {numbers}{turned})"
            source += f"; of it {numbers} {verb}, the network's cloud is placed to fill the mask"
            source += f", {distance}"
        crop = replace(crop, camera=placed)
        if world:
            frame = "world"

            def to_output(points: Array) -> Array:
                return view_to_world(points, placed, view.camera)

    cloud = Cloud(points, "the network's prediction", predicted=True)
    findings = tuple(finding for finding in known if finding)
    return Scene(
        RefineScene(cloud, (crop,), known=findings),
        (source,),
        summary,
        frame,
        network=network,
        image=inputs.image,
        photo=cut_out(image, inputs.box),
        sigma_sq=config.sigma_sq,
        to_output=to_output,
    )


def _placed(points: Array, crop: View, view: View, placing: Placing, sigma_sq: float) -> Camera:
    """The camera of the crop, with R and t that place a view-aligned cloud in front of it."""
    if placing == "camera":
        depth = view.camera.t[2]
        if depth <= 0.0:
            raise InputError(
                f"{view.name}: the camera has the object at depth {depth:g}, expected it in front "
                "(> 0)"
            )
        return replace(crop.camera, R=CANONICAL_ROTATION, t=view.camera.t)
    camera = place_in_front(points, crop)
    return (
        align_silhouette(points, replace(crop, camera=camera), sigma_sq)
        if placing == "silhouette"
        else camera
    )


def place_in_front(points: Array, view: View) -> Camera:
    """The canonical camera with the view's K, shifted so that a cloud [N, 3] fills the mask's box.

    The cloud is view-aligned and centred.

    A crop shows neither distance nor size of the object. At the distance chosen, the longer side of
    the projected box is as long as the longer side of the mask's box. A sideways shift centres one
    on the other.
    """
    left, top, right, bottom = view.box()
    size, middle = max(right - left, bottom - top), np.array([left + right, top + bottom]) / 2.0
    camera = replace(
        view.camera,
        R=CANONICAL_ROTATION,
        t=np.array([0.0, 0.0, CANONICAL_DISTANCE]),
        model="perspective",
    )
    focal = camera.K[[0, 1], [0, 1]]
    nearest = float(points[:, 2].max()) + 0.1
    # The size of the box is almost inversely proportional to the distance, so this converges fast.
    for _ in range(50):
        pixels, _ = camera.project(points)
        low, high = pixels.min(0) - 0.5, pixels.max(0) + 0.5
        distance = max(camera.t[2] * float((high - low).max()) / size, nearest)
        shift = (middle - (low + high) / 2.0) / focal * distance
        t = np.array([camera.t[0] + shift[0], camera.t[1] + shift[1], distance])
        if np.abs(t - camera.t).max() < 1e-9 * distance:
            break
        camera = replace(camera, t=t)
    return camera


def align_silhouette(
    points: Array, view: View, sigma_sq: float = 0.4, steps: int = ALIGNMENT_STEPS
) -> Camera:
    """The view's camera, shifted to where the cloud's silhouette agrees best with the mask (Eq. 4).

    A box depends on the outermost points of a prediction, which are often wrong. The silhouette
    depends on all of them. The camera must be about right already, as from `place_in_front`.
    ``sigma_sq`` is in px^2.
    """
    known = 1.0 if view.known is None else view.known
    mask = view.mask.astype(np.float64)
    weights = mask * known, (1.0 - mask) * known

    def silhouette_loss(shift: Array) -> tuple[float, Array]:
        projected = project_differentiably(points, replace(view.camera, t=view.camera.t + shift[0]))
        if not projected.valid.any():
            return np.inf, shift
        value, gradient_px = silhouette_bce(
            projected.points_px, projected.valid, *weights, sigma_sq
        )
        return value, projected.in_camera(gradient_px).sum(0, keepdims=True)

    rate = ALIGNMENT_STEP * float(np.ptp(points, axis=0).max())
    parameters = PointParameters(np.zeros((1, 3)), rate)
    best = minimise(parameters, silhouette_loss, steps).best[0]
    return replace(view.camera, t=view.camera.t + best)


def view_to_world(points: Array, placed: Camera, camera: Camera) -> Array:
    """A view-aligned cloud, which ``placed`` projects onto the picture, in the world of ``camera``.

    The picture fixes the cloud up to a scale about the camera's centre. The scale is chosen so that
    the cloud's origin has the depth of the world's origin. Raises InputError if that is not in
    front of ``camera``.
    """
    if camera.t[2] <= 0.0:
        raise InputError(
            f"the world's origin has depth {camera.t[2]:g} in this camera, expected it in front "
            "(> 0)"
        )
    points_camera = (points @ placed.R.T + placed.t) * (camera.t[2] / placed.t[2])
    return (points_camera - camera.t) @ camera.R
