"""Files -> Scene: the cloud or the network to refine, the mask to agree with, and the camera between them."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .camera import Camera
from .errors import InputError
from .files.cameras import find_camera, read_camera
from .files.clouds import PointCloud, read_cloud
from .files.images import read_image, read_mask
from .network_input import network_input
from .placement import place_in_front, view_to_world
from .scene import View

if TYPE_CHECKING:
    from .network import BaseNetwork, NetworkConfig

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything one refinement needs.

    Attributes
    ----------
    points : [N, 3] float64, the start: the file's cloud, or the network's prediction in the network's frame.
    view : mask and the camera that projects `points` onto it (network modes: of the crop that the network saw).
    camera_source : where the camera is from, in words.
    frame : of the output: "input" (the cloud's own), "view", "canonical" or "world".
    cloud : the file that `points` are from, None in the network modes.
    network, image : the network and its input [3, 64, 64], None in points mode.
    sigma_sq : px^2, what the checkpoint was trained with; None in points mode.
    to_output : takes points from the frame of `points` to that of the output.
    """

    points: Array
    view: View
    camera_source: str
    frame: str
    cloud: PointCloud | None = None
    network: BaseNetwork | None = None
    image: NDArray[np.float32] | None = None
    sigma_sq: float | None = None
    to_output: Callable[[Array], Array] = lambda points: points


def load_view(
    mask_file: Path,
    camera_file: Path | None = None,
    invert: bool = False,
    ignore_file: Path | None = None,
    search: bool = True,
) -> tuple[View, Path | None]:
    """Read a mask and its camera: the one named, else one found beside the mask, else the canonical one.

    Parameters
    ----------
    ignore_file : an image whose foreground marks the pixels of the mask that say nothing.
    search : False looks for no camera beside the mask.

    Returns
    -------
    The view, and the camera's file or None where the canonical camera stands in for one.

    Raises
    ------
    InputError
        A file cannot be used, sizes differ, or the mask is all object or all background.
    """
    mask = read_mask(mask_file, invert)
    height, width = mask.shape
    known = None
    if ignore_file is not None:
        known = read_mask(ignore_file) <= 0.5
        _same_size(ignore_file, known.shape, mask_file, mask.shape)
    if camera_file is None and search:
        camera_file = find_camera(mask_file)
    camera = read_camera(camera_file, width, height, mask_file) if camera_file else Camera.canonical(width, height)
    return View(mask, camera, known, name=str(mask_file)), camera_file


def _same_size(file: Path, shape: tuple[int, ...], mask_file: Path | str, mask_shape: tuple[int, ...]) -> None:
    if shape[:2] != mask_shape:
        raise InputError(
            f"{file}: is {shape[1]}x{shape[0]}, the mask {mask_file} is {mask_shape[1]}x{mask_shape[0]} (width x height), "
            "expected the same"
        )


def _said(camera_file: Path | None) -> str:
    return str(camera_file) if camera_file else "canonical (no camera file was given or found beside the mask)"


def load_points_scene(
    cloud_file: Path,
    mask_file: Path,
    camera_file: Path | None = None,
    invert: bool = False,
    ignore_file: Path | None = None,
    fit: bool = False,
) -> Scene:
    """The scene of points mode; arguments and errors as :func:`load_view` and :func:`tso_cli.files.clouds.read_cloud`.

    ``fit`` finds the camera from mask and cloud (:func:`tso_cli.pose.fit_camera`) instead of reading one.
    """
    cloud = read_cloud(cloud_file)
    view, camera_file = load_view(mask_file, camera_file, invert, ignore_file, search=not fit)
    if fit:
        from .pose import fit_camera

        fitted = fit_camera(cloud.points, view.mask, view.known, name=str(cloud_file))
        return Scene(cloud.points, replace(view, camera=fitted.camera), fitted.describe(), "input", cloud=cloud)
    _warn_of_scale(cloud.points, view, cloud_file)
    return Scene(cloud.points, view, _said(camera_file), "input", cloud=cloud)


def load_network_scene(
    image_file: Path,
    mask_file: Path,
    checkpoint: Path,
    camera_file: Path | None = None,
    invert: bool = False,
    ignore_file: Path | None = None,
    world: bool = False,
) -> Scene:
    """The scene of the network modes: the photo cropped as the checkpoint says, and the camera that sees the cloud in it.

    A view-aligned network predicts in the axes of the camera: of a camera file only K counts, and the cloud is set before
    the camera so that it fills the mask's box (:func:`tso_cli.placement.place_in_front`). Without a camera file, K is the
    canonical one of the crop. A canonical-frame network predicts in the frame of its training objects: R and t of the camera
    file lead from there to the picture.

    Parameters
    ----------
    world : give the output of a view-aligned network in the world coordinates of the camera file.

    Raises
    ------
    InputError
        A file cannot be used, image and mask differ in size, or the frame asked for needs a camera file.
    """
    from .files.checkpoints import load_network

    view, camera_file = load_view(mask_file, camera_file, invert, ignore_file)
    image = read_image(image_file)
    _same_size(image_file, image.shape, mask_file, view.mask.shape)
    network, config = load_network(checkpoint)
    if camera_file is None and config.frame != "view":
        raise InputError(
            f"{checkpoint}: predicts in the canonical frame of its training objects, which needs the camera's R and t; "
            "found no camera file, expected --camera FILE"
        )
    if camera_file is None and world:
        raise InputError("--frame world needs the camera's R and t; found no camera file, expected --camera FILE")
    if config.frame == "view" and view.camera.model != "perspective":
        raise InputError(f"{camera_file}: model is {view.camera.model}, expected perspective for a view-aligned network")
    return network_scene(image, view, network, config, _said(camera_file), camera_file is not None, world)


def network_scene(
    image: NDArray[np.uint8],
    view: View,
    network: BaseNetwork,
    config: NetworkConfig,
    camera_source: str = "given",
    known_camera: bool = True,
    world: bool = False,
) -> Scene:
    """The scene of a photo that is in memory already, with a network that may serve many of them.

    Parameters
    ----------
    image : [H, W, 3] or [H, W, 4]; view : its mask and perspective camera.
    known_camera : False lets the canonical camera see the crop; for view-aligned networks only.
    world : as in :func:`load_network_scene`.
    """
    import torch

    given = network_input(image, view, config.image_size, config.crop_share, config.background)
    with torch.no_grad():
        predicted = network(torch.from_numpy(given.image).unsqueeze(0))[0].double().numpy()
    crop, to_output, frame = given.view(view.name), Scene.to_output, config.frame
    if config.frame == "view":
        if not known_camera:
            crop = replace(crop, camera=Camera.canonical(config.image_size, config.image_size))
        placed = place_in_front(predicted, crop)
        crop = replace(crop, camera=placed)
        camera_source += f"; of it K counts, the network's cloud is placed to fill the mask, at distance {placed.t[2]:.3g}"
        if world:
            frame = "world"

            def to_output(points: Array) -> Array:
                return view_to_world(points, placed, view.camera)

    return Scene(
        predicted,
        crop,
        camera_source,
        frame,
        network=network,
        image=given.image,
        sigma_sq=config.sigma_sq,
        to_output=to_output,
    )


def _warn_of_scale(points: Array, view: View, cloud_file: Path) -> None:
    """Warn of a cloud that stands absurdly near or far for its size: the sign of another unit."""
    camera = view.camera
    size = float(np.ptp(points, axis=0).max())
    distance = float((camera.R @ ((points.min(0) + points.max(0)) / 2.0) + camera.t)[2])
    if camera.model == "perspective" and distance > 0.0 and not 0.2 < distance / size < 1000.0:
        warnings.warn(
            f"{cloud_file}: its longest side is {size:.3g} and its distance from the camera {distance:.3g}; "
            "are both in one unit?",
            stacklevel=2,
        )
