"""The scene of the network modes: photo, mask and checkpoint -> cropped input, predicted cloud, and the camera that sees it."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.camera import CANONICAL_ROTATION, Camera
from ..geometry.view import View
from ..io.images import read_image
from ..network.input import network_input
from ..refinement.placement import mask_doubts, place_in_front, settle, view_to_world
from .load import NO_FILE, Scene, load_view, said, same_size

if TYPE_CHECKING:
    from ..network.model import BaseNetwork, NetworkConfig

Array = NDArray[np.float64]
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
    """The scene of the network modes: the photo cropped as the checkpoint says, and the camera that sees the cloud in it.

    A view-aligned network predicts in the axes of the camera: of a camera file only K counts, and the cloud is set before
    the camera so that it fills the mask's box (`place_in_front`). Without a camera file, K is the
    canonical one of the crop. A canonical-frame network predicts in the frame of its training objects: R and t of the camera
    file lead from there to the picture.

    Parameters
    ----------
    world : give the output of a view-aligned network in the world coordinates of the camera file.
    placing : of a view-aligned network's cloud: "silhouette" sets it where the silhouette agrees best with the mask
        (`settle`), "box" where its box does, "camera" at the camera file's own t, which then is that of
        an object whose middle is the world's origin and whose longest side is 1.

    Raises
    ------
    InputError
        A file cannot be used, image and mask differ in size, or the frame asked for needs a camera file.
    """
    from ..io.checkpoints import load_network

    view, camera_file = load_view(mask_file, camera_file, invert, ignore_file)
    image = read_image(image_file)
    same_size(image_file, image.shape, mask_file, view.mask.shape)
    network, config = load_network(checkpoint)
    if camera_file is None and config.frame != "view":
        raise InputError(
            f"{checkpoint}: predicts in the canonical frame of its training objects, which needs the camera's R and t; "
            "found no camera file, expected --camera FILE"
        )
    if config.frame != "view" and (world or placing != "silhouette"):
        option = "--frame world" if world else f"--place {placing}"
        raise InputError(f"{checkpoint}: predicts in the canonical frame, found {option}, which is for view-aligned networks")
    if camera_file is None and placing == "camera":
        raise InputError("--place camera needs the camera's t; found no camera file, expected --camera FILE")
    if camera_file is None and world:
        raise InputError("--frame world needs the camera's R and t; found no camera file, expected --camera FILE")
    if config.frame == "view" and view.camera.model != "perspective":
        raise InputError(f"{camera_file}: model is {view.camera.model}, expected perspective for a view-aligned network")
    return network_scene(image, view, network, config, said(camera_file), camera_file is not None, world, placing)


def network_scene(
    image: NDArray[np.uint8],
    view: View,
    network: BaseNetwork,
    config: NetworkConfig,
    camera_source: str = "given",
    known_camera: bool = True,
    world: bool = False,
    placing: Placing = "silhouette",
) -> Scene:
    """The scene of a photo that is in memory already, with a network that may serve many of them.

    Parameters
    ----------
    image : [H, W, 3] or [H, W, 4]; view : its mask and perspective camera.
    known_camera : False lets the canonical camera see the crop; for view-aligned networks only.
    world, placing : as in `load_network_scene`.
    """
    import torch

    given = network_input(image, view, config.image_size, config.crop_share, config.background)
    with torch.no_grad():
        predicted = network(torch.from_numpy(given.image).unsqueeze(0))[0].double().numpy()
    # In the crop, which is enlarged, it no longer shows.
    for doubt in mask_doubts(view, len(predicted)):
        warnings.warn(doubt, stacklevel=2)
    crop, to_output, frame = given.view(view.name), Scene.to_output, config.frame
    short = f"camera {camera_source}" if known_camera else f"canonical camera {NO_FILE}"
    if config.frame == "view":
        if not known_camera and not config.crop_share:
            warnings.warn(
                f"{view.name}: the network tells sizes by the whole picture, which without a camera is taken for that of the "
                "canonical one (--camera FILE)",
                stacklevel=2,
            )
        if not known_camera:
            crop = replace(crop, camera=Camera.canonical(config.image_size, config.image_size))
        if placing == "camera":
            if view.camera.t[2] <= 0.0:
                raise InputError(
                    f"{view.name}: the camera has the object at depth {view.camera.t[2]:g}, expected it in front (> 0)"
                )
            placed = replace(crop.camera, R=CANONICAL_ROTATION, t=view.camera.t)
            short += " (only its K and distance)"
            camera_source += f"; the network's cloud is placed where it has the object, at distance {placed.t[2]:.3g}"
        else:
            placed = place_in_front(predicted, crop)
            if placing == "silhouette":
                placed = settle(predicted, replace(crop, camera=placed), config.sigma_sq)
            # A picture that shows sizes is cut out by the place of the object too.
            counts = "K" if config.crop_share else "K and t"
            if known_camera:
                short += f" (only its {counts})"
            fills = f"the network's cloud is placed to fill the mask, at distance {placed.t[2]:.3g}"
            camera_source += f"; of it {counts} {'counts' if config.crop_share else 'count'}, {fills}"
        crop = replace(crop, camera=placed)
        if world:
            frame = "world"

            def to_output(points: Array) -> Array:
                return view_to_world(points, placed, view.camera)

    return Scene(
        predicted,
        (crop,),
        (camera_source,),
        short,
        frame,
        network=network,
        image=given.image,
        sigma_sq=config.sigma_sq,
        to_output=to_output,
    )
