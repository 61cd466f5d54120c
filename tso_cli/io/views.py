"""Files -> views: masks, their cameras, and what else is known of each picture."""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import InputError
from ..geometry.arrays import Array
from ..geometry.camera import Camera, intrinsics
from ..geometry.depth_kind import FITTED, DepthKind
from ..geometry.distortion import Distortion, undistorted
from ..geometry.view import View
from .cameras import (
    Intrinsics,
    PartialCamera,
    find_camera,
    form_of,
    named_images,
    of_horizontal_angle,
    paired,
    read_partial_cameras,
    same_shape,
)
from .depth_maps import at_size, confidence_of, read_depth
from .images import focal_length_of_exif, orientation, read_image, resized
from .masks import MaskChoice, read_mask

NO_FILE = "(no camera file was given or found next to the mask)"
OWN_FORMAT = "tso"


@dataclass(frozen=True)
class ViewFiles:
    """The files of one or several views. ``ignore``, ``depth``, ``image`` : one a mask, or none.

    camera : the file or folder of all cameras; None looks for files next to the masks.
    camera_format : its format; None finds out. object_id : the object of a data set with several.
    intrinsics : a camera file whose K is used in place of that of ``camera``.
    focal, fov : the focal length in px of the mask, or the horizontal field of view in degrees;
        without a camera, or for a ``camera`` without K.
    y_up : whether the cloud has y up, as glTF defines it. A pose of the same object with its z up
        is turned for it.
    choice : which object of a mask file is meant.
    any_size : images may be larger or smaller than their masks, and are resized.
    ignore : images whose foreground marks unknown pixels. depth_scale : as in `read_depth`.
    depth_kind, mask_error : as in `View`.
    """

    masks: Sequence[Path]
    camera: Path | None = None
    camera_format: str | None = None
    object_id: int | None = None
    intrinsics: Path | None = None
    focal: float | None = None
    fov: float | None = None
    ignore: Sequence[Path] = ()
    depth: Sequence[Path] = ()
    depth_scale: float = 1.0
    depth_kind: DepthKind = "auto"
    image: Sequence[Path] = ()
    choice: MaskChoice = MaskChoice()
    mask_error: float | None = None
    any_size: bool = False
    y_up: bool = False

    @property
    def known_focal(self) -> tuple[str, Intrinsics] | None:
        """K by ``focal`` or ``fov``, and what gave it; None if neither is known."""
        if self.fov is not None:
            return "the given field of view", of_horizontal_angle(math.radians(self.fov))
        if self.focal is not None:
            return "the given focal length", partial(intrinsics, self.focal)
        return None

    def one_each(self, name: str, plural: str, files: Sequence[Path]) -> Sequence[Path | None]:
        """The file of each mask, None where there are no files; InputError for another number."""
        if files and len(files) != len(self.masks):
            raise InputError(
                f"`{name}` {files[0]}: found {len(files)} {plural} for {len(self.masks)} masks, "
                "expected one for each or none"
            )
        return files or [None] * len(self.masks)


@dataclass(frozen=True)
class CameraOrigin:
    """Where the camera of a view is from.

    file : None for the canonical camera. view : what the file calls the view, if it has several or
        its format is not tso's. by_name : whether the name of the mask chose the view.
    format : of the file. notes : what was done to its numbers.
    """

    file: Path | None
    view: str = ""
    by_name: bool = True
    format: str = OWN_FORMAT
    notes: tuple[str, ...] = ()

    def __str__(self) -> str:
        if self.file is None:
            return "; ".join([f"canonical {NO_FILE}", *self.notes])
        more = [text for text in (self.words, self.view, *self.notes) if text]
        return f"{self.file} ({'; '.join(more)})" if more else str(self.file)

    @property
    def words(self) -> str:
        """What the format is, if it is not tso's own."""
        return "" if self.format == OWN_FORMAT else form_of(self.format)


def summary_of(origins: Sequence[CameraOrigin]) -> str:
    """Where the cameras of all views are from, in few words."""
    if len(origins) == 1:
        (origin,) = origins
        if origin.file is None:
            return "; ".join([f"canonical camera {NO_FILE}", *origin.notes])
        return f"camera {origin}"
    files = list(dict.fromkeys(str(origin.file) for origin in origins))
    named = ", ".join(files) if len(files) < 3 else f"{len(files)} files"
    more = list(dict.fromkeys(text for o in origins for text in (o.words, *o.notes) if text))
    if len(files) == 1 and not all(origin.by_name for origin in origins):
        more.append("views in the order of the masks")
    return f"cameras of {named}" + (f" ({'; '.join(more)})" if more else "")


def load_views(files: ViewFiles) -> tuple[list[View], list[CameraOrigin]]:
    """Read masks and their cameras.

    A camera is from the file named, else from a file next to the mask, else (for a single mask) it
    is the canonical one. Pictures of a lens with distortion are undistorted. Returns the views as
    they were read, and where their cameras are from. Raises InputError if a file cannot be used,
    sizes or numbers of files differ, or a mask is all object or all background.
    """
    ignore = files.one_each("ignore", "ignore maps", files.ignore)
    partial_cameras, origins = _cameras(files)
    views, notes = [], []
    for mask, ignored, camera, origin in zip(
        files.masks, ignore, partial_cameras, origins, strict=True
    ):
        view, of_view = _read_view(mask, camera, origin, ignored, files)
        views.append(view)
        notes.append([*origin.notes, *of_view])
    stored = [camera is not None for camera in partial_cameras]
    for number, (view, more) in enumerate(with_depth_and_images(views, files, stored)):
        views[number] = view
        notes[number] += more
    for number, camera in enumerate(partial_cameras):
        lens = camera.distortion if camera else None
        if lens and not lens.none:
            views[number] = _without_distortion(views[number], lens)
            notes[number].append("lens distortion undone")
    return views, [replace(o, notes=tuple(n)) for o, n in zip(origins, notes, strict=True)]


@dataclass(frozen=True)
class KnownFocal:
    """What is known of the focal length of a picture without a camera.

    source : where it is from, in words; "" if nothing is known. deviation : the standard deviation
    of its logarithm: 0 if it is given, None if nothing is known.
    """

    source: str = ""
    deviation: float | None = None

    # A lens at another distance or zoom than EXIF says, and rounding to whole millimetres.
    OF_EXIF = 0.05


def view_without_camera(files: ViewFiles) -> tuple[View, KnownFocal]:
    """The view of a single mask with the canonical pose, and what its K is from.

    K is of `ViewFiles.intrinsics`, `focal` or `fov`, else of the EXIF data of the photo, else the
    canonical camera's.
    """
    (mask,) = files.masks
    (ignore,) = files.one_each("ignore", "ignore maps", files.ignore)
    view, _ = _read_view(mask, None, CameraOrigin(None), ignore, files)
    ((view, _),) = with_depth_and_images([view], files, [False])
    if files.intrinsics is None:
        return _with_focal(view, files)
    canonical = PartialCamera("", R=view.camera.R, t=view.camera.t)
    calibration, _ = read_partial_cameras(files.intrinsics)
    partial = with_intrinsics(canonical, calibration, files.intrinsics, mask)
    height, width = view.mask.shape
    view = replace(view, camera=partial.camera(files.intrinsics, width, height))
    lens = partial.distortion
    if lens is not None and not lens.none:
        view = _without_distortion(view, lens)
    return view, KnownFocal(f"K of {files.intrinsics}", 0.0)


def _with_focal(view: View, files: ViewFiles) -> tuple[View, KnownFocal]:
    height, width = view.mask.shape
    if focal := files.known_focal:
        source, of_size = focal
        return _with_K(view, of_size(width, height)), KnownFocal(source, 0.0)
    for photo in (*files.image, *files.masks):
        if share := focal_length_of_exif(photo):
            K = intrinsics(share * math.hypot(width, height), width, height)
            source_of_focal = KnownFocal(f"the EXIF data of {photo.name}", KnownFocal.OF_EXIF)
            return _with_K(view, K), source_of_focal
    return view, KnownFocal()


def _with_K(view: View, K: Array) -> View:
    return replace(view, camera=replace(view.camera, K=K))


def named_photos(files: ViewFiles) -> list[Path]:
    """The pictures that the camera files name for the masks; none if one of them is a mask."""
    photos = named_images(_cameras(files)[0])
    of_masks = {os.path.realpath(mask) for mask in files.masks}
    return [] if any(os.path.realpath(photo) in of_masks for photo in photos) else photos


def _cameras(files: ViewFiles) -> tuple[list[PartialCamera | None], list[CameraOrigin]]:
    """What is known of the camera of each mask, None for the canonical camera."""
    sources = [files.camera or find_camera(mask) for mask in files.masks]
    cameras: list[PartialCamera | None] = [None] * len(sources)
    origins = [CameraOrigin(None)] * len(sources)
    for source in dict.fromkeys(sources):
        numbers = [number for number, other in enumerate(sources) if other == source]
        masks = [files.masks[i] for i in numbers]
        if source is None:
            if len(sources) > 1:
                raise InputError(
                    f"{masks[0]}: no camera file was given or found next to it, "
                    f"expected `camera` FILE with a view for each of {len(sources)} masks"
                )
            continue
        partial, name = read_partial_cameras(source, files.camera_format, files.object_id)
        cameras_of_masks, by_name = paired(source, partial, masks)
        for number, camera in zip(numbers, cameras_of_masks, strict=True):
            # In tso's own format the views that masks name need no further words.
            has_words = name != OWN_FORMAT or not by_name
            view = camera.label if has_words and (len(partial) > 1 or name != OWN_FORMAT) else ""
            turned = ("turned for a cloud with y up",) if files.y_up and camera.z_up else ()
            cameras[number] = camera.for_y_up() if files.y_up else camera
            origins[number] = CameraOrigin(source, view, by_name, name, turned)
    if focal := files.known_focal:
        for number, (posed, origin) in enumerate(zip(cameras, origins, strict=True)):
            cameras[number] = _with_given_focal(posed, origin.file, focal[1])
            origins[number] = replace(origin, notes=(*origin.notes, f"with {focal[0]}"))
    if files.intrinsics is not None:
        partial, _ = read_partial_cameras(files.intrinsics)
        for number, (posed, origin) in enumerate(zip(cameras, origins, strict=True)):
            if posed is None:
                raise InputError(
                    f"`intrinsics` {files.intrinsics}: says nothing about the pose, expected "
                    "`camera` FILE or `camera` fit with it"
                )
            cameras[number] = with_intrinsics(posed, partial, files.intrinsics, files.masks[number])
            note = f"K of {files.intrinsics}"
            origins[number] = replace(origin, notes=(*origin.notes, note))
    return cameras, origins


def _with_given_focal(
    posed: PartialCamera | None, file: Path | None, intrinsics: Intrinsics
) -> PartialCamera:
    """``posed``, which is of ``file``, with the K that is given by a focal length or an angle."""
    if posed is None:
        raise InputError(
            "`focal` and `fov` say nothing about the pose, expected `camera` FILE with a pose, or "
            "`camera` fit"
        )
    if posed.intrinsics is not None:
        raise InputError(
            f"{file}: has K, and `focal` or `fov` says it again, expected one; leave them out, or "
            "replace K by `intrinsics` FILE"
        )
    return replace(posed, intrinsics=intrinsics)


def with_intrinsics(
    camera: PartialCamera, views: Sequence[PartialCamera], file: Path, mask: Path
) -> PartialCamera:
    """``camera`` with K and lens of the ``views`` of another ``file``, by the same ``mask``."""
    view = views[0] if len(views) == 1 else paired(file, views, [mask])[0][0]
    if view.intrinsics is None:
        raise InputError(f"{file}: has no focal length, expected K for `intrinsics`")
    return replace(
        camera, intrinsics=view.intrinsics, size=view.size, distortion=view.distortion,
        sized_by=file,
    )  # fmt: skip


def _read_view(
    mask_file: Path,
    camera: PartialCamera | None,
    origin: CameraOrigin,
    ignore_file: Path | None,
    files: ViewFiles,
) -> tuple[View, list[str]]:
    """A mask with its camera, and what was done to the camera's numbers and to the picture."""

    def of_camera(size: tuple[int, int]) -> bool:
        return camera is None or camera.size is None or same_shape(camera.size, size)

    def read(upright: bool) -> NDArray[Any]:
        size = camera.size if camera else None
        return read_mask(mask_file, files.choice, upright, size, known=True)

    stored = camera is not None
    mask, notes = _raster(mask_file, read, of_camera, stored)
    height, width = mask.shape
    unknown = np.isnan(mask)
    counted = ~unknown if unknown.any() else None
    mask = np.where(unknown, np.float32(0.0), mask)
    if ignore_file is not None:
        ignored, more = _raster(
            ignore_file,
            lambda up: read_mask(ignore_file, upright=up),
            lambda size: size == (width, height),
            stored,
        )
        notes += more
        require_same_size(ignore_file, ignored.shape, mask_file, mask.shape)
        counted = (ignored <= 0.5) & ~unknown
    if camera is None or origin.file is None:
        full = Camera.canonical(width, height)
    else:
        full = camera.camera(origin.file, width, height)
        if camera.size and camera.size != (width, height):
            notes.append(f"K scaled from {camera.size[0]}x{camera.size[1]} to {width}x{height}")
    view = View(mask, full, counted, name=str(mask_file), mask_error=files.mask_error)
    return view, notes


def _raster(
    file: Path,
    read: Callable[[bool], NDArray[Any]],
    fits: Callable[[tuple[int, int]], bool],
    stored: bool,
) -> tuple[NDArray[Any], list[str]]:
    """A picture, upright or as it is stored, and what was done if it has an EXIF orientation.

    The size decides where only one of the two ``fits``. Otherwise it is taken as ``stored`` if its
    camera is from a file: programs that calibrate cameras read the stored picture.
    """
    if orientation(file) == 1:
        return read(True), []
    upright = not stored
    picture = read(upright)
    if not fits((picture.shape[1], picture.shape[0])):
        other = read(not upright)
        if fits((other.shape[1], other.shape[0])):
            picture, upright = other, not upright
    how = "is turned upright by" if upright else "is taken as it is stored, without"
    return picture, [f"{file.name} {how} its EXIF orientation"]


def with_depth_and_images(
    views: Sequence[View], files: ViewFiles, stored: Sequence[bool]
) -> list[tuple[View, list[str]]]:
    """The views with the depth maps and photos of the ``files``; ``stored`` as in `_raster`."""
    depth_files = files.one_each("depth", "depth maps", files.depth)
    image_files = files.one_each("image", "images", files.image)
    completed = []
    rows = zip(views, depth_files, image_files, stored, strict=True)
    for view, depth_file, image_file, as_stored in rows:
        notes: list[str] = []
        shape = view.mask.shape

        def of_mask(size: tuple[int, int], shape: tuple[int, ...] = shape) -> bool:
            return same_shape(size, (shape[1], shape[0]))

        if depth_file is not None:
            signed = files.depth_kind in FITTED
            read = partial(read_depth, depth_file, files.depth_scale, signed=signed)
            depth, more = _raster(depth_file, read, of_mask, as_stored)
            size = (depth.shape[1], depth.shape[0])
            if not of_mask(size):
                require_same_size(depth_file, depth.shape, view.name, shape)
            if depth.shape != shape:
                depth = at_size(depth, shape[1], shape[0])
                more.append(f"{depth_file.name} scaled from {size[0]}x{size[1]}")
            if confidence := confidence_of(depth_file):
                more.append(f"{depth_file.name} without the low confidence of {confidence}")
            view = replace(view, depth=depth, depth_kind=files.depth_kind)
            notes += more
        if image_file is not None:
            view, more = _with_image(view, image_file, files.any_size, as_stored)
            notes += more
        completed.append((view, notes))
    return completed


def _with_image(view: View, file: Path, any_size: bool, stored: bool) -> tuple[View, list[str]]:
    """The view with its photo, and what was done to it; ``any_size`` as in `ViewFiles`."""
    height, width = view.mask.shape

    def of_mask(size: tuple[int, int]) -> bool:
        return size == (width, height) or (any_size and same_shape(size, (width, height)))

    image, notes = _raster(file, partial(read_image, file), of_mask, stored)
    if of_mask((image.shape[1], image.shape[0])):
        image = resized(image, width, height)
    require_same_size(file, image.shape, view.name, view.mask.shape)
    return replace(view, image=image[..., :3] / np.float32(255.0)), notes


def _without_distortion(view: View, lens: Distortion) -> View:
    """The view that a camera without lens distortion would have; what it lacks is unknown."""
    K = view.camera.K
    mask, inside = undistorted(view.mask, K, lens)
    if view.known is not None:
        inside = inside & undistorted(view.known, K, lens, nearest=True)[0].astype(bool)
    changed = {"mask": np.clip(mask, 0.0, 1.0), "known": None if inside.all() else inside}
    if view.depth is not None:
        changed["depth"] = undistorted(view.depth, K, lens, nearest=True)[0]
    if view.image is not None:
        changed["image"] = np.clip(undistorted(view.image, K, lens)[0], 0.0, 1.0)
    return replace(view, **changed)


def require_same_size(
    file: Path, shape: tuple[int, ...], mask_file: Path | str, mask_shape: tuple[int, ...]
) -> None:
    """InputError where an image of that [H, W, ...] shape and a mask differ in size."""
    if shape[:2] != mask_shape:
        raise InputError(
            f"{file}: is {shape[1]}x{shape[0]}, the mask {mask_file} is "
            f"{mask_shape[1]}x{mask_shape[0]} (width x height), expected the same"
        )
