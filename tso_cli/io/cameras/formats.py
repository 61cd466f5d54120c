"""The formats of cameras: which one a file has, and its reader, imported when it is met."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path
from typing import Any

from ...errors import InputError
from ..guard import reading
from ..reading import is_there
from .record import PartialCamera
from .source import COLMAP_FILES, EXPECTED, CameraSource, has_keys

# Name for `camera_format` -> what it is, and where it may be found: "json", "text", "yaml", "zip"
# (.npz and .pt), "npy", "glb" or "folder". Tried in this order.
FORMATS = {
    "tso": ("tso's own camera file", "json"),
    "transforms": ("a transforms.json of NeRF, Blender or nerfstudio", "json folder"),
    "3dgs": ("cameras of 3D Gaussian splatting", "json"),
    "bop": ("a scene of BOP", "json folder"),
    "open3d": ("Open3D's pinhole camera or trajectory", "json text"),
    "pix3d": ("annotations of Pix3D", "json"),
    "sam3d": ("the pose of SAM 3D Objects", "json"),
    "gltf": ("cameras of a glTF or GLB scene", "json glb"),
    "kaolin": ("kaolin's camera", "json"),
    "opencv": ("an OpenCV calibration, ROS camera_info or Kalibr", "yaml json zip"),
    "pytorch3d": ("PyTorch3D cameras", "zip"),
    "idr": ("cameras.npz of IDR or NeuS", "zip"),
    "arkit": ("poses of ARKit: Polycam, 3D Scanner App or Record3D", "json folder"),
    "scannet": ("a folder of ScanNet", "folder text"),
    "matrices": ("K, R, t, P or 4x4 matrices", "json npy zip text"),
    "colmap": ("a COLMAP model", "folder text binary"),
    "trajectory": ("a trajectory of TUM or Stray Scanner", "folder text"),
    "realitycapture": ("a table of RealityCapture", "text"),
    "middlebury": ("a _par.txt of Middlebury", "text"),
    "r2n2": ("rendering_metadata.txt of 3D-R2N2", "text"),
}
# What files that are recognised and not read begin with: what they are, and what to do.
NOT_READ = (
    (rb"SQLite format 3", "a COLMAP database, which holds no poses; use the model: a folder with "
     "cameras.bin and images.bin"),
    (rb"NVM_V3", "a VisualSFM model, which tso does not read; reconstruct the pictures with "
     "COLMAP, or store K, R and t with numpy.savez"),
    (rb"# Bundle file", "a Bundler model, which tso does not read; reconstruct the pictures with "
     "COLMAP, or store K, R and t with numpy.savez"),
    (rb"\s*(<\?xml[^>]*>)?\s*<document", "a Metashape file; export cameras as COLMAP or "
     "as a transforms.json"),
    (rb"BLENDER", "a Blender file; export the scene with its cameras as .glb"),
    (rb"Kaydara FBX", "an FBX scene; export it as .glb"),
    (rb"MATLAB 5.0", "a MATLAB file; store K, R and t with numpy.savez"),
    (rb"\x89HDF", "an HDF5 file; store K, R and t with numpy.savez"),
    (rb"\x80[\x02-\x05]", "a pickle, which can run code; store K, R and t with numpy.savez"),
)  # fmt: skip

# And of JSON, by the keys of the document or of the first entry of its list.
NOT_READ_JSON = (
    ({"cameras", "shots"}, "a reconstruction of OpenSfM; export it for COLMAP: opensfm "
     "export_colmap"),
    ({"sfm_data_version"}, "a scene of OpenMVG; export it for COLMAP: openMVG_main_openMVG2Colmap"),
    ({"views", "intrinsics", "poses"}, "a scene of Meshroom; export it for COLMAP: the node "
     "ExportColmap, or aliceVision_exportColmap"),
)  # fmt: skip


def read_partial_cameras(
    path: Path, camera_format: str | None = None, object_id: int | None = None
) -> tuple[list[PartialCamera], str]:
    """The views of a camera file or folder, at least one, and the name of its format.

    The content decides the format, unless ``camera_format`` names it. ``object_id`` chooses the
    object of a data set with several. Raises InputError if no reader knows the file, or if the
    file is wrong.
    """
    source = CameraSource(path)
    if camera_format is not None:
        name = camera_format
        reader = _named(name)
    else:
        name, reader = _recognised(source)
    if object_id is not None and name != "bop":
        raise InputError(
            f"{path}: is {form_of(name)}, `object` {object_id} chooses an object of "
            f"{FORMATS['bop'][0]}"
        )
    if name in FORMATS:
        with reading(source, reader.NEEDS):
            views = reader.read(source, object_id) if name == "bop" else reader.read(source)
    else:
        from ..plugins import guarded

        with guarded(path, name, EXPECTED):
            views = reader.read(source)
    if not views:
        raise InputError(f"{path}: is {form_of(name)} and holds no camera, expected one or more")
    return views, name


def form_of(name: str) -> str:
    """What the format ``name`` is, in words."""
    return FORMATS[name][0] if name in FORMATS else f"the format {name}"


def _module(name: str) -> Any:
    return import_module(f".{'own' if name == 'tso' else 'of_' + name}", __package__)


def _named(name: str) -> Any:
    if name in FORMATS:
        return _module(name)
    from ..plugins import CAMERAS, camera_reader, registered

    plugins = registered(CAMERAS)
    if name not in plugins:
        names = ", ".join([*FORMATS, *plugins])
        raise InputError(f"`camera_format` is {name!r}, expected one of {names}")
    return camera_reader(plugins[name])


def _recognised(source: CameraSource) -> tuple[str, Any]:
    """The format of a file, and its reader."""
    for pattern, advice in NOT_READ:
        if re.match(pattern, source.data):
            raise InputError(f"{source.path}: is {advice}")
    container = source.container
    if container == "json":
        document = source.json
        first = document[0] if isinstance(document, list) and document else document
        for keys, advice in NOT_READ_JSON:
            if has_keys(first, keys):
                raise InputError(f"{source.path}: is {advice}")
    for name, (_, containers) in FORMATS.items():
        if container in containers.split():
            module = _module(name)
            if module.recognises(source):
                return name, module
    from ..plugins import CAMERAS, camera_reader, guarded, registered

    for name, load in registered(CAMERAS).items():
        with guarded(source.path, name, EXPECTED):
            reader = camera_reader(load)
            if reader.recognises(source):
                return name, reader
    if container == "json" or source.path.suffix.lower() == ".json":
        # Its reader says what is wrong with the file, in the terms of tso's own format.
        return "tso", _module("tso")
    if source.is_folder:
        raise _without_cameras(source.path)
    raise InputError(
        f"{source.path}: is no camera file that tso knows, expected one of: "
        f"{', '.join(FORMATS)} (`camera_format`)"
    )


def _without_cameras(folder: Path) -> InputError:
    """The error of a folder without a camera file; it may hold a part of a COLMAP model."""
    parts = [name for name in COLMAP_FILES if is_there(folder / name)]
    for missing in ("cameras", "images"):
        if parts and not any(name.startswith(missing) for name in parts):
            return InputError(
                f"{folder}: holds {parts[0]}, and {missing}.txt or {missing}.bin is missing, "
                "expected a COLMAP model: cameras and images"
            )
    return InputError(
        f"{folder}: is a folder without a camera file, expected a COLMAP model (cameras and "
        "images), transforms.json, scene_camera.json, or the poses of a scan"
    )
