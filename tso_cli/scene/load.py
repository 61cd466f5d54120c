"""Files -> Scene: the cloud or the network to refine, the mask to agree with, and the camera between them."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.camera import Camera
from ..geometry.view import View
from ..io.cameras import check_size, find_camera, read_camera
from ..io.clouds import PointCloud, read_cloud
from ..io.images import read_depth, read_image, read_mask
from ..io.pairing import pair_with_masks

if TYPE_CHECKING:
    from ..network.model import BaseNetwork
    from ..refinement.surface import Surface

Array = NDArray[np.float64]

NO_FILE = "(no camera file was given or found beside the mask)"


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything one refinement needs.

    Attributes
    ----------
    points : [N, 3] float64, the start: the file's cloud, or the network's prediction in the network's frame.
    faces : [F, 3] triangles of `points`, None for a cloud.
    views : masks and the cameras that project `points` onto them (network modes: one, of the crop that the network saw).
    camera_sources : where the camera of each is from, in words. camera_in_short : of all, in few.
    frame : of the output: "input" (the cloud's own), "view", "canonical" or "world".
    cloud : the file that `points` are from, None in the network modes.
    colours : [N, 3] of `points`, None where no view has an image.
    network, image : the network and its input [3, 64, 64], None in points mode.
    sigma_sq : squared cells of the window, what the checkpoint was trained with; None in points mode.
    to_output : takes points from the frame of `points` to that of the output.
    """

    points: Array
    views: tuple[View, ...]
    camera_sources: tuple[str, ...]
    camera_in_short: str
    frame: str
    cloud: PointCloud | None = None
    network: BaseNetwork | None = None
    image: NDArray[np.float32] | None = None
    sigma_sq: float | None = None
    colours: Array | None = None
    faces: NDArray[np.int64] | None = None
    to_output: Callable[[Array], Array] = lambda points: points

    @property
    def view(self) -> View:
        """The first view; the only one in the network modes."""
        return self.views[0]

    @cached_property
    def surface(self) -> Surface | None:
        """That of a mesh; None, with a warning, where its faces have no area."""
        if self.cloud is None or self.faces is None:
            return None
        from ..refinement.surface import Surface

        return Surface.of(self.points, self.faces, str(self.cloud.path))

    @property
    def moving(self) -> Array:
        """What a refinement moves, [N, 3]: the points, or the samples of a surface."""
        return self.surface.samples if self.surface else self.points

    @property
    def camera_source(self) -> str:
        """Where the cameras are from, each file once."""
        return ", ".join(dict.fromkeys(self.camera_sources))


def load_view(
    mask_file: Path, camera_file: Path | None = None, invert: bool = False, ignore_file: Path | None = None
) -> tuple[View, Path | None]:
    """Read a mask and its camera: the one named, else one found beside the mask, else the canonical one.

    Parameters
    ----------
    ignore_file : an image whose foreground marks the pixels of the mask that say nothing.

    Returns
    -------
    The view, and the camera's file or None where the canonical camera stands in for one.

    Raises
    ------
    InputError
        A file cannot be used, sizes differ, or the mask is all object or all background.
    """
    source = camera_file or find_camera(mask_file)
    return _read_view(mask_file, source, None, invert, ignore_file), source


def load_views(
    mask_files: Sequence[Path], camera_file: Path | None = None, invert: bool = False, ignore_files: Sequence[Path] = ()
) -> tuple[tuple[View, ...], tuple[Path | None, ...]]:
    """Read masks and their cameras: of the file named, else of those found beside the masks.

    Views of one file are told apart by the masks that they name, else by their order
    (`pair_with_masks`). One mask is read as `load_view` does.

    Parameters
    ----------
    ignore_files : one for each mask, or none.

    Returns
    -------
    The views, and the camera's file of each (None: the canonical camera, of a single mask only).

    Raises
    ------
    InputError
        As `load_view`; or masks, cameras and ignore maps do not pair up.
    """
    ignores = _ignores_of(mask_files, ignore_files)
    sources = [camera_file or find_camera(mask_file) for mask_file in mask_files]
    cameras: list[Camera | None] = [None] * len(mask_files)
    for source in dict.fromkeys(sources):
        own = [i for i, other in enumerate(sources) if other == source]
        if source is None and len(mask_files) > 1:
            raise InputError(
                f"{mask_files[own[0]]}: no camera file was given or found beside it, expected one for each of "
                f"{len(mask_files)} masks"
            )
        if source is not None and len(own) > 1:
            for i, camera in zip(own, pair_with_masks(source, [mask_files[i] for i in own]), strict=True):
                cameras[i] = camera
    rows = zip(mask_files, sources, cameras, ignores, strict=True)
    return tuple(_read_view(file, source, camera, invert, ignore) for file, source, camera, ignore in rows), tuple(sources)


def _require_one_each(option: str, what: str, files: Sequence[Path], masks: int) -> None:
    if files and len(files) != masks:
        raise InputError(f"{option} {files[0]}: found {len(files)} {what} for {masks} masks, expected one for each or none")


def _ignores_of(mask_files: Sequence[Path], ignore_files: Sequence[Path]) -> Sequence[Path | None]:
    """The ignore map of each mask."""
    _require_one_each("--ignore", "ignore maps", ignore_files, len(mask_files))
    return ignore_files or [None] * len(mask_files)


def _read_view(
    mask_file: Path, camera_file: Path | None, camera: Camera | None, invert: bool, ignore_file: Path | None
) -> View:
    """The view of a mask and of its ``camera``, None for the one that ``camera_file`` has for it, else the canonical one."""
    mask = read_mask(mask_file, invert)
    height, width = mask.shape
    known = None
    if ignore_file is not None:
        known = read_mask(ignore_file) <= 0.5
        same_size(ignore_file, known.shape, mask_file, mask.shape)
    if camera_file is None:
        camera = Camera.canonical(width, height)
    elif camera is None:
        camera = read_camera(camera_file, width, height, mask_file)
    else:
        check_size(camera_file, camera, width, height, mask_file)
    return View(mask, camera, known, name=str(mask_file))


def same_size(file: Path, shape: tuple[int, ...], mask_file: Path | str, mask_shape: tuple[int, ...]) -> None:
    """InputError where an image of that [H, W, ...] shape and a mask differ in size."""
    if shape[:2] != mask_shape:
        raise InputError(
            f"{file}: is {shape[1]}x{shape[0]}, the mask {mask_file} is {mask_shape[1]}x{mask_shape[0]} (width x height), "
            "expected the same"
        )


def _with_depths(views: tuple[View, ...], files: Sequence[Path], scale: float) -> tuple[View, ...]:
    depths = _read_each("--depth", "depth maps", views, files, lambda file: read_depth(file, scale))
    return tuple(replace(view, depth=depth) for view, depth in zip(views, depths, strict=True))


def _with_images(views: tuple[View, ...], files: Sequence[Path]) -> tuple[View, ...]:
    images = _read_each("--image", "images", views, files, read_image)
    return tuple(replace(view, image=image[..., :3] / np.float32(255.0)) for view, image in zip(views, images, strict=True))


def _read_each(
    option: str, what: str, views: tuple[View, ...], files: Sequence[Path], read: Callable[[Path], NDArray[Any]]
) -> list[NDArray[Any]]:
    """What ``read`` makes of the file of each view; InputError where there is not one for each, of its mask's size."""
    _require_one_each(option, what, files, len(views))
    found = []
    for view, file in zip(views, files, strict=True):
        found.append(read(file))
        same_size(file, found[-1].shape, view.name, view.mask.shape)
    return found


def said(camera_file: Path | None) -> str:
    """Where a camera comes from, in words."""
    return str(camera_file) if camera_file else f"canonical {NO_FILE}"


def in_short(camera_files: Sequence[Path | None]) -> str:
    """Which cameras were used, in few words."""
    if len(camera_files) == 1:
        return f"camera {camera_files[0]}" if camera_files[0] else f"canonical camera {NO_FILE}"
    each = list(dict.fromkeys(map(str, camera_files)))
    return f"cameras of {', '.join(each) if len(each) < 3 else f'{len(each)} files'}"


def load_points_scene(
    cloud_file: Path,
    mask_files: Path | Sequence[Path],
    camera_file: Path | None = None,
    invert: bool = False,
    ignore_files: Sequence[Path] = (),
    fit: bool = False,
    depth_files: Sequence[Path] = (),
    depth_scale: float = 1.0,
    image_files: Sequence[Path] = (),
) -> Scene:
    """The scene of points mode; arguments and errors as `load_views` and `read_cloud`.

    ``fit`` finds the camera of the one mask from mask and cloud (`fit_camera`) instead of reading it;
    it goes without depth maps. These are one for each mask, or none; ``depth_scale`` is that of
    `read_depth`. So are images, of a cloud that has colours.
    """
    masks = [mask_files] if isinstance(mask_files, Path) else mask_files
    if fit and len(masks) != 1:
        raise InputError(f"--camera fit finds the camera of one mask, found {len(masks)} masks; expected one, or a camera file")
    cloud = read_cloud(cloud_file)
    colours = cloud.colours() if image_files else None
    scene = Scene(cloud.points, (), (), "", "input", cloud=cloud, colours=colours, faces=cloud.faces())
    if fit:
        from ..pose import fit_camera

        view = _read_view(masks[0], None, None, invert, _ignores_of(masks, ignore_files)[0])
        fitted = fit_camera(scene.moving, view.mask, view.known, name=view.name)
        views: tuple[View, ...] = (replace(view, camera=fitted.camera),)
        if image_files:
            views = _with_images(views, image_files)
        if not fitted.sure:
            warnings.warn(f"{masks[0]}: the fitted camera is unsure: {fitted.doubt}", stacklevel=2)
        short = f"camera fitted to cloud and mask ({'sure' if fitted.sure else 'unsure'})"
        return replace(scene, views=views, camera_sources=(fitted.describe(),), camera_in_short=short)
    views, camera_files = load_views(masks, camera_file, invert, ignore_files)
    if depth_files:
        views = _with_depths(views, depth_files, depth_scale)
    if image_files:
        views = _with_images(views, image_files)
    for view in views:
        _warn_of_scale(cloud.points, view, cloud_file)
    for view, depth_file in zip(views, depth_files, strict=False):
        _warn_of_depth(cloud.points, view, depth_file)
    sources = tuple(map(said, camera_files))
    return replace(scene, views=views, camera_sources=sources, camera_in_short=in_short(camera_files))


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


def _warn_of_depth(points: Array, view: View, depth_file: Path) -> None:
    """Warn of a depth map that shows the object nowhere near the cloud: the sign of another unit."""
    assert view.depth is not None
    found = float(np.nanmedian(np.where(view.mask > 0.5, view.depth, np.nan)))
    depth = view.camera.project(points)[1]
    if not 0.5 * depth.min() < found < 2.0 * depth.max():
        warnings.warn(
            f"{depth_file}: its median depth on the object is {found:.3g}, the cloud's depths are {depth.min():.3g} to "
            f"{depth.max():.3g}; is --depth-scale right?",
            stacklevel=2,
        )
