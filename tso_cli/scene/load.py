"""Files -> Scene: the cloud or the network to refine, the masks, and the cameras that see them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from ..cloud.cloud import Cloud
from ..diagnosis.findings import Finding
from ..diagnosis.hypotheses import INVERTED, Assumption, as_meant, assumptions_of, left_handed
from ..errors import InputError
from ..geometry.arrays import Array, Floats
from ..geometry.camera import Camera
from ..geometry.view import View
from ..io.cameras import check_size, find_camera, pair_with_masks, read_camera
from ..io.clouds import PointCloud, read_cloud
from ..io.images import read_depth, read_image, read_mask
from ..refinement.scene import RefineScene

if TYPE_CHECKING:
    from ..network.model import BaseNetwork

Placing = Literal["silhouette", "box", "camera"]
NO_FILE = "(no camera file was given or found next to the mask)"
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
    network, image, sigma_sq : in the network modes the network, its input [3, 64, 64], and the
        variance of its training.
    """

    given: RefineScene
    camera_sources: tuple[str, ...]
    camera_summary: str
    frame: str
    file: PointCloud | None = None
    network: BaseNetwork | None = None
    image: Floats | None = None
    sigma_sq: float | None = None
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


@dataclass(frozen=True)
class ViewFiles:
    """The files of one or several views. ``ignore``, ``depth``, ``image`` : one a mask, or none.

    camera : the file of all cameras; None looks for files next to the masks.
    assume : names of hypotheses that are taken as true. invert : "mask-inverted" is one of them.
    ignore : images whose foreground marks unknown pixels. depth_scale : as in `read_depth`.
    """

    masks: Sequence[Path]
    camera: Path | None = None
    assume: Sequence[str] = ()
    invert: bool = False
    ignore: Sequence[Path] = ()
    depth: Sequence[Path] = ()
    depth_scale: float = 1.0
    image: Sequence[Path] = ()

    def one_each(self, name: str, plural: str, files: Sequence[Path]) -> Sequence[Path | None]:
        """The file of each mask, None where there are no files; InputError for another number."""
        if files and len(files) != len(self.masks):
            raise InputError(
                f"`{name}` {files[0]}: found {len(files)} {plural} for {len(self.masks)} masks, "
                "expected one for each or none"
            )
        return files or [None] * len(self.masks)

    @property
    def assumptions(self) -> tuple[Assumption, ...]:
        """How the files are meant; raises InputError for an unknown hypothesis or mask."""
        named = assumptions_of(self.assume, list(map(str, self.masks)))
        return (INVERTED, *named) if self.invert else named


def load_views(files: ViewFiles) -> tuple[list[View], list[Path | None]]:
    """Read masks and their cameras.

    A camera is from the file named, else from a file next to the mask, else (for a single mask) it
    is the canonical one. Returns the views as they were read, and each camera's file, None for the
    canonical camera. Raises InputError if a file cannot be used, sizes or numbers of files differ,
    or a mask is all object or all background.
    """
    ignore = files.one_each("ignore", "ignore maps", files.ignore)
    sources = [files.camera or find_camera(mask) for mask in files.masks]
    cameras: list[Camera | None] = [None] * len(files.masks)
    for source in dict.fromkeys(sources) if len(files.masks) > 1 else ():
        numbers = [number for number, other in enumerate(sources) if other == source]
        if source is None:
            raise InputError(
                f"{files.masks[numbers[0]]}: no camera file was given or found next to it, "
                f"expected `camera` FILE with a view for each of {len(files.masks)} masks"
            )
        if len(numbers) > 1:
            paired = pair_with_masks(source, [files.masks[i] for i in numbers])
            for number, camera in zip(numbers, paired, strict=True):
                cameras[number] = camera
    rows = zip(files.masks, sources, cameras, ignore, strict=True)
    views = [_read_view(*row) for row in rows]
    return _with_depth_and_images(views, files), sources


def _with_depth_and_images(views: Sequence[View], files: ViewFiles) -> list[View]:
    depth_files = files.one_each("depth", "depth maps", files.depth)
    image_files = files.one_each("image", "images", files.image)
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
        completed.append(view)
    return completed


def _read_view(
    mask_file: Path, camera_file: Path | None, camera: Camera | None, ignore_file: Path | None
) -> View:
    """A mask with ``camera``, else with the camera of the file, else with the canonical one."""
    mask = read_mask(mask_file)
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
    return View(mask, camera, known, name=str(mask_file))


def require_same_size(
    file: Path, shape: tuple[int, ...], mask_file: Path | str, mask_shape: tuple[int, ...]
) -> None:
    """InputError where an image of that [H, W, ...] shape and a mask differ in size."""
    if shape[:2] != mask_shape:
        raise InputError(
            f"{file}: is {shape[1]}x{shape[0]}, the mask {mask_file} is "
            f"{mask_shape[1]}x{mask_shape[0]} (width x height), expected the same"
        )


def load_points_scene(cloud_file: Path, files: ViewFiles | Path, fit: bool = False) -> Scene:
    """The scene of points mode: a cloud, or a mesh whose surface is refined, and its views.

    ``files`` may be a single mask. ``fit`` estimates the camera of the one mask from mask and cloud
    (`fit_camera`). Errors as `load_views` and `read_cloud`.
    """
    files = files if isinstance(files, ViewFiles) else ViewFiles([files])
    assumptions = files.assumptions
    file = read_cloud(cloud_file)
    colours = file.colours() if files.image else None
    cloud = Cloud(file.points, str(cloud_file), colours, file.faces())
    if fit:
        return _with_fitted_camera(cloud, file, files, assumptions)
    read, sources = load_views(files)
    names = list(dict.fromkeys(map(camera_source, sources)))
    summary = f"cameras of {', '.join(names) if len(names) < 3 else f'{len(names)} files'}"
    if len(sources) == 1:
        summary = f"camera {names[0]}" if sources[0] else f"canonical camera {NO_FILE}"
    mirrored = MIRRORED if left_handed(assumptions) else ""
    described = tuple(camera_source(source) + mirrored for source in sources)
    given = RefineScene(cloud, tuple(read), assumptions)
    return Scene(given, described, summary, "input", file)


def _with_fitted_camera(
    cloud: Cloud, file: PointCloud, files: ViewFiles, assumptions: tuple[Assumption, ...]
) -> Scene:
    from ..pose import fit_camera

    (mask_file,) = files.masks
    (ignore,) = files.one_each("ignore", "ignore maps", files.ignore)
    (read,) = _with_depth_and_images([_read_view(mask_file, None, None, ignore)], files)
    view, points = as_meant(read, assumptions), cloud.controlled().control_points
    fitted = fit_camera(points, view.mask, view.known, name=view.name)
    # The fitted camera is in the axes of the cloud, whatever these are.
    of_mask = tuple(one for one in assumptions if one.hypothesis.mask)
    of_cloud = [one for one in assumptions if not one.hypothesis.mask]
    read = replace(as_meant(read, of_cloud), camera=fitted.camera)
    known = (
        () if fitted.sure else (Finding("unsure-camera", (0,), values={"why": fitted.why_unsure}),)
    )
    summary = f"camera fitted to cloud and mask ({'sure' if fitted.sure else 'unsure'})"
    given = RefineScene(cloud, (read,), of_mask, known)
    return Scene(given, (fitted.describe(),), summary, "input", file)


def camera_source(camera_file: Path | None) -> str:
    """Where a camera is from, in words."""
    return str(camera_file) if camera_file else f"canonical {NO_FILE}"
