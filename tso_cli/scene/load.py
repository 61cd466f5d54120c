"""Files -> Scene: the cloud or the network to refine, the masks, and the cameras that see them."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from ..cloud.cloud import Cloud
from ..diagnosis.hypotheses import (
    INVERT_MASK,
    AssumedView,
    Assumption,
    about,
    axes_of,
    in_axes_of_cloud,
    mirrored,
)
from ..errors import InputError
from ..geometry.camera import Array, Camera
from ..geometry.points import longest_side
from ..geometry.view import View
from ..io.cameras import check_size, find_camera, pair_with_masks, read_camera
from ..io.clouds import PointCloud, read_cloud
from ..io.images import read_depth, read_image, read_mask

if TYPE_CHECKING:
    from ..network.model import BaseNetwork

Placing = Literal["silhouette", "box", "camera"]
NO_FILE = "(no camera file was given or found beside the mask)"
MIRRORED = " (mirrored with its mask: the cloud has left-handed axes)"


@dataclass(frozen=True, eq=False)
class Scene:
    """Everything one refinement needs.

    points : [N, 3] float64, the start: the cloud of the file, or the network's prediction in the network's frame.
    views : masks, and the cameras that project `points` onto them (network modes: one, of the network's crop).
    camera_sources : for each view, where its camera is from; camera_summary : the same for all views, shorter.
    frame : of the output: "input" (that of the cloud), "view", "canonical" or "world"; to_output maps points to it.
    cloud, start : of points mode: the file, and what is refined; with colours if the views have images.
    doubt : why its camera, which was fitted, may be wrong; "" without doubt.
    network, image, sigma_sq : of the network modes: the network, its input [3, 64, 64], and the variance of its training.
    """

    points: Array
    views: tuple[View, ...]
    camera_sources: tuple[str, ...]
    camera_summary: str
    frame: str
    cloud: PointCloud | None = None
    network: BaseNetwork | None = None
    image: NDArray[np.float32] | None = None
    sigma_sq: float | None = None
    start: Cloud | None = None
    doubt: str = ""
    to_output: Callable[[Array], Array] = lambda points: points

    @property
    def view(self) -> View:
        """The first view; the only one in the network modes."""
        return self.views[0]

    @property
    def moving(self) -> Array:
        """What a refinement moves, [N, 3]: the points but outliers, or the samples of a surface."""
        return self.start.initial if self.start else self.points


@dataclass(frozen=True)
class ViewFiles:
    """The files of one or several views; ``ignore``, ``depth`` and ``image`` hold one for each mask or none.

    camera : the file of all cameras; None looks for files beside the masks.
    invert : the masks show the object dark. assumptions : about masks and cameras.
    ignore : images whose foreground marks unknown pixels. depth_scale : as in `read_depth`.
    """

    masks: Sequence[Path]
    camera: Path | None = None
    invert: bool = False
    ignore: Sequence[Path] = ()
    depth: Sequence[Path] = ()
    depth_scale: float = 1.0
    image: Sequence[Path] = ()
    assumptions: Sequence[Assumption] = ()

    def one_each(self, option: str, plural: str, files: Sequence[Path]) -> Sequence[Path | None]:
        """The file of each mask, None where there are no files; InputError for another number of them."""
        if files and len(files) != len(self.masks):
            raise InputError(
                f"{option} {files[0]}: found {len(files)} {plural} for {len(self.masks)} masks, expected one for each or none"
            )
        return files or [None] * len(self.masks)

    @property
    def given(self) -> tuple[Assumption, ...]:
        """The assumptions, and what ``invert`` assumes."""
        return (INVERT_MASK, *self.assumptions) if self.invert else tuple(self.assumptions)


def load_views(files: ViewFiles) -> tuple[list[View], list[Path | None]]:
    """Read masks and their cameras: of the file named, else of one beside the mask, else (for a single mask) the canonical one.

    Returns the views and each camera's file, None for the canonical one. Raises InputError if a file cannot be used, sizes or
    numbers of files differ, or a mask is all object or all background.
    """
    ignore = files.one_each("--ignore", "ignore maps", files.ignore)
    sources = [files.camera or find_camera(mask) for mask in files.masks]
    cameras: list[Camera | None] = [None] * len(files.masks)
    for source in dict.fromkeys(sources) if len(files.masks) > 1 else ():
        numbers = [number for number, other in enumerate(sources) if other == source]
        if source is None:
            raise InputError(
                f"{files.masks[numbers[0]]}: no camera file was given or found beside it, expected one for each of "
                f"{len(files.masks)} masks"
            )
        if len(numbers) > 1:
            for number, camera in zip(
                numbers, pair_with_masks(source, [files.masks[i] for i in numbers]), strict=True
            ):
                cameras[number] = camera
    rows = zip(files.masks, sources, cameras, ignore, strict=True)
    views = [
        _read_view(mask, source, camera, files, unknown) for mask, source, camera, unknown in rows
    ]
    return _with_depth_and_images(views, files), sources


def _with_depth_and_images(views: Sequence[View], files: ViewFiles) -> list[View]:
    depth_files = files.one_each("--depth", "depth maps", files.depth)
    image_files = files.one_each("--image", "images", files.image)
    completed = []
    for view, depth_file, image_file in zip(views, depth_files, image_files, strict=True):
        if depth_file is not None:
            depth = read_depth(depth_file, files.depth_scale)
            require_same_size(depth_file, depth.shape, view.name, view.mask.shape)
            view = replace(view, depth=depth)
        if image_file is not None:
            image = read_image(image_file)
            require_same_size(image_file, image.shape, view.name, view.mask.shape)
            view = replace(view, image=image[..., :3] / np.float32(255.0))
        if isinstance(view, AssumedView):
            view = in_axes_of_cloud(view, axes_of(about(view, view.given)))
        completed.append(view)
    return completed


def _read_view(
    mask_file: Path,
    camera_file: Path | None,
    camera: Camera | None,
    files: ViewFiles,
    ignore_file: Path | None,
) -> View:
    """A mask with ``camera``, else with the one in ``camera_file``, else with the canonical one."""
    mask = read_mask(mask_file, files.invert)
    height, width = mask.shape
    known = None
    if ignore_file is not None:
        known = read_mask(ignore_file) <= 0.5
        require_same_size(ignore_file, known.shape, mask_file, mask.shape)
    if camera_file is None:
        camera = Camera.canonical(width, height)
    elif camera is None:
        camera = read_camera(camera_file, width, height, mask_file)
    else:
        check_size(camera_file, camera, width, height, mask_file)
    view = View(mask, camera, known, name=str(mask_file))
    if view.like_photo:
        warnings.warn(
            f"{mask_file}: looks like a photo, grey in many places; expected a mask, light on the object and dark beside it",
            stacklevel=2,
        )
    if not files.given:
        return view
    view = AssumedView(mask, camera, known, view.name, given=files.given, camera_read=camera)
    for assumption in about(view, files.assumptions):
        view = assumption.of_view(view)
    return view


def _of_mask(assumption: Assumption, masks: Sequence[Path]) -> Assumption:
    """With the path of the one mask that it names, by its path or by the last part of it."""
    named = assumption.view
    paths = [mask for mask in masks if str(mask) == named] or [
        mask for mask in masks if mask.name == named
    ]
    if named and len(paths) != 1:
        found = f"there are {len(paths)} such masks" if paths else "there is no such mask"
        raise InputError(
            f"{assumption.option}: {found}, expected one of {', '.join(map(str, masks))}"
        )
    return replace(assumption, view=str(paths[0])) if named else assumption


def require_same_size(
    file: Path, shape: tuple[int, ...], mask_file: Path | str, mask_shape: tuple[int, ...]
) -> None:
    """InputError where an image of that [H, W, ...] shape and a mask differ in size."""
    if shape[:2] != mask_shape:
        raise InputError(
            f"{file}: is {shape[1]}x{shape[0]}, the mask {mask_file} is {mask_shape[1]}x{mask_shape[0]} (width x height), "
            "expected the same"
        )


def load_points_scene(cloud_file: Path, files: ViewFiles | Path, fit: bool = False) -> Scene:
    """The scene of points mode: a cloud, or a mesh whose surface is refined, and its views, or one mask.

    ``fit`` estimates the camera of the one mask from mask and cloud (`fit_camera`). Errors as `load_views` and `read_cloud`.
    """
    files = files if isinstance(files, ViewFiles) else ViewFiles([files])
    if fit and len(files.masks) != 1:
        raise InputError(
            f"--camera fit finds the camera of one mask, found {len(files.masks)} masks; expected one, or a camera file"
        )
    files = replace(
        files, assumptions=[_of_mask(assumption, files.masks) for assumption in files.assumptions]
    )
    cloud = read_cloud(cloud_file)
    colours = cloud.colours() if files.image else None
    start = Cloud(cloud.points, str(cloud_file), colours, cloud.faces())
    scene = Scene(start.given, (), (), "", "input", cloud=cloud, start=start)
    if fit:
        return _with_fitted_camera(scene, files)
    views, sources = load_views(files)
    for view in views:
        _warn_of_scale(scene.moving, view, cloud_file)
    for view, depth_file in zip(views, files.depth, strict=False):
        _warn_of_depth(scene.moving, view, depth_file)
    names = list(dict.fromkeys(map(camera_source, sources)))
    summary = f"cameras of {', '.join(names) if len(names) < 3 else f'{len(names)} files'}"
    if len(sources) == 1:
        summary = f"camera {names[0]}" if sources[0] else f"canonical camera {NO_FILE}"
    described = tuple(
        camera_source(source) + MIRRORED * mirrored(view)
        for source, view in zip(sources, views, strict=True)
    )
    return replace(scene, views=tuple(views), camera_sources=described, camera_summary=summary)


def _with_fitted_camera(scene: Scene, files: ViewFiles) -> Scene:
    from ..pose import fit_camera

    (ignore,) = files.one_each("--ignore", "ignore maps", files.ignore)
    if any(assumption.camera for assumption in files.assumptions):
        raise InputError(
            "--camera fit finds the camera by itself, expected no --assume about a camera"
        )
    (view,) = _with_depth_and_images([_read_view(files.masks[0], None, None, files, ignore)], files)
    fitted = fit_camera(scene.moving, view.mask, view.known, name=view.name)
    view = replace(view, camera=fitted.camera)
    if isinstance(view, AssumedView):
        # It is in the axes of the cloud, whatever these are.
        view = replace(
            view,
            camera_read=fitted.camera,
            given=tuple(about(view, [one for one in view.given if one.mask])),
        )
    doubt = "" if fitted.sure else f"the fitted camera is unsure: {fitted.doubt}"
    if doubt:
        warnings.warn(f"{view.name}: {doubt}", stacklevel=3)
    summary = f"camera fitted to cloud and mask ({'sure' if fitted.sure else 'unsure'})"
    return replace(
        scene,
        views=(view,),
        camera_sources=(fitted.describe(),),
        camera_summary=summary,
        doubt=doubt,
    )


def camera_source(camera_file: Path | None) -> str:
    """Where a camera is from, in words."""
    return str(camera_file) if camera_file else f"canonical {NO_FILE}"


def _warn_of_scale(points: Array, view: View, cloud_file: Path) -> None:
    """Warn of a cloud that is implausibly near or far for its size: its unit may differ from the camera's."""
    camera = view.camera
    size = longest_side(points)
    distance = float((camera.R @ ((points.min(0) + points.max(0)) / 2.0) + camera.t)[2])
    if camera.model == "perspective" and distance > 0.0 and not 0.2 < distance / size < 1000.0:
        warnings.warn(
            f"{cloud_file}: its longest side is {size:.3g} and its distance from the camera {distance:.3g}; "
            "are both in one unit?",
            stacklevel=2,
        )


def _warn_of_depth(points: Array, view: View, depth_file: Path) -> None:
    """Warn of a depth map that disagrees with the cloud by a factor: its unit may be another."""
    assert view.depth is not None
    observed = float(np.nanmedian(np.where(view.mask > 0.5, view.depth, np.nan)))
    depth = view.camera.project(points)[1]
    if not 0.5 * depth.min() < observed < 2.0 * depth.max():
        warnings.warn(
            f"{depth_file}: its median depth on the object is {observed:.3g}, the cloud's depths are {depth.min():.3g} to "
            f"{depth.max():.3g}; is --depth-scale right?",
            stacklevel=2,
        )
