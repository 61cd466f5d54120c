"""The scene of the network modes: photo, mask and checkpoint -> the network's crop, its cloud and the camera of the crop."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.camera import CANONICAL_ROTATION, Array, Camera
from ..geometry.view import View
from ..io.images import read_image
from ..network.input import network_input
from ..refinement.placement import mask_doubts
from .load import NO_FILE, Scene, ViewFiles, camera_source, load_views, require_same_size
from .placing import align_silhouette, place_in_front, view_to_world

if TYPE_CHECKING:
    from ..network.model import BaseNetwork, NetworkConfig

Placing = Literal["silhouette", "box", "camera"]


def load_network_scene(
    image_file: Path,
    mask_file: Path,
    checkpoint: Path,
    camera_file: Path | None = None,
    invert: bool = False,
    ignore_file: Path | None = None,
    world: bool = False,
    placing: Placing = "silhouette",
) -> Scene:
    """The scene of the network modes: the photo cropped as for training, and the camera that sees the predicted cloud in it.

    A view-aligned network predicts in the axes of the camera. Of a camera file only K counts (of the crop's canonical camera,
    without one), and the cloud is placed in front of it. A canonical-frame network predicts in the frame of its training
    objects, from which R and t of the camera file lead to the picture.

    Parameters
    ----------
    world : give the output of a view-aligned network in the world coordinates of the camera file.
    placing : of a view-aligned network's cloud: "silhouette" aligns it with the mask (`align_silhouette`), "box" with its
        box (`place_in_front`), "camera" takes t of the camera file, as for an object of longest side 1 at the origin.

    Raises InputError if a file cannot be used, sizes of image and mask differ, or the frame or placing needs a camera file.
    """
    from ..io.checkpoints import load_network

    files = ViewFiles([mask_file], camera_file, invert, [ignore_file] if ignore_file else [])
    (view,), (camera_file,) = load_views(files)
    image = read_image(image_file)
    require_same_size(image_file, image.shape, mask_file, view.mask.shape)
    network, config = load_network(checkpoint)
    option = "--frame world" if world else f"--place {placing}" if placing != "silhouette" else None
    if config.frame != "view" and camera_file is None:
        raise InputError(
            f"{checkpoint}: predicts in the canonical frame of its training objects, which needs the camera's R and t; "
            "found no camera file, expected --camera FILE"
        )
    if config.frame != "view" and option:
        raise InputError(f"{checkpoint}: predicts in the canonical frame, found {option}, which is for view-aligned networks")
    if camera_file is None and placing == "camera":
        raise InputError("--place camera needs the camera's t; found no camera file, expected --camera FILE")
    if camera_file is None and world:
        raise InputError("--frame world needs the camera's R and t; found no camera file, expected --camera FILE")
    if config.frame == "view" and view.camera.model != "perspective":
        raise InputError(f"{camera_file}: model is {view.camera.model}, expected perspective for a view-aligned network")
    return network_scene(image, view, network, config, camera_source(camera_file), camera_file is not None, world, placing)


def network_scene(
    image: NDArray[np.uint8],
    view: View,
    network: BaseNetwork,
    config: NetworkConfig,
    source: str = "given",
    known_camera: bool = True,
    world: bool = False,
    placing: Placing = "silhouette",
) -> Scene:
    """`load_network_scene` for a photo [H, W, 3] or [H, W, 4] with its mask and perspective camera, and a network in memory.

    ``source`` says where the camera is from; without ``known_camera`` the crop gets the canonical one (view-aligned only).
    """
    import torch

    inputs = network_input(image, view, config.image_size, config.crop_share, config.background)
    with torch.no_grad():
        points = network(torch.from_numpy(inputs.image).unsqueeze(0))[0].double().numpy()
    # Ask the photo: the crop is enlarged and hides that the mask is coarse.
    for doubt in mask_doubts(view, len(points)):
        warnings.warn(doubt, stacklevel=2)
    crop, to_output, frame = inputs.view(view.name), Scene.to_output, config.frame
    summary = f"camera {source}" if known_camera else f"canonical camera {NO_FILE}"
    if config.frame == "view":
        if not known_camera:
            crop = replace(crop, camera=Camera.canonical(config.image_size, config.image_size))
            if not config.crop_share:
                warnings.warn(
                    f"{view.name}: the network tells sizes by the whole picture, which without a camera is taken for that of "
                    "the canonical one (--camera FILE)",
                    stacklevel=2,
                )
        placed = _placed(points, crop, view, placing, config.sigma_sq)
        distance = f"at distance {placed.t[2]:.3g}"
        if placing == "camera":
            summary += " (only its K and distance)"
            source += f"; the network's cloud is placed where it has the object, {distance}"
        else:
            # Without a crop of fixed size, t decides which part of the picture the network sees.
            used, verb = ("K", "counts") if config.crop_share else ("K and t", "count")
            if known_camera:
                summary += f" (only its {used})"
            source += f"; of it {used} {verb}, the network's cloud is placed to fill the mask, {distance}"
        crop = replace(crop, camera=placed)
        if world:
            frame = "world"

            def to_output(points: Array) -> Array:
                return view_to_world(points, placed, view.camera)

    about = (None, network, inputs.image, config.sigma_sq)
    return Scene(points, (crop,), (source,), summary, frame, *about, to_output=to_output)


def _placed(points: Array, crop: View, view: View, placing: Placing, sigma_sq: float) -> Camera:
    """The camera of the crop, with R and t that place a view-aligned cloud in front of it."""
    if placing == "camera":
        depth = view.camera.t[2]
        if depth <= 0.0:
            raise InputError(f"{view.name}: the camera has the object at depth {depth:g}, expected it in front (> 0)")
        return replace(crop.camera, R=CANONICAL_ROTATION, t=view.camera.t)
    camera = place_in_front(points, crop)
    return align_silhouette(points, replace(crop, camera=camera), sigma_sq) if placing == "silhouette" else camera
