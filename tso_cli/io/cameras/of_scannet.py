"""A folder of ScanNet: ``pose/0.txt``, ... and ``intrinsic/intrinsic_color.txt``, all [4, 4].

Poses are from camera to world, in the axes of OpenCV. Where the tracking was lost they are
infinite, and such pictures are left out. A file in ``pose`` is a view of its folder.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..guard import reading
from ..reading import is_there
from . import of_matrices
from .record import PartialCamera, from_camera_to_world
from .source import CameraSource

NEEDS = "a pose of 4x4 numbers for each picture"

_INTRINSICS = ("intrinsic/intrinsic_color.txt", "intrinsic_color.txt", "intrinsic_depth.txt")


def recognises(source: CameraSource) -> bool:
    poses, K = _parts(source)
    return poses.name == "pose" and poses.is_dir() and K is not None


def _parts(source: CameraSource) -> tuple[Path, Path | None]:
    """The folder of the poses, and the file of K."""
    poses = source.path / "pose" if source.is_folder else source.path.absolute().parent
    files = (poses.parent / name for name in _INTRINSICS)
    return poses, next(filter(is_there, files), None)


def read(source: CameraSource) -> list[PartialCamera]:
    (poses, file), intrinsics = _parts(source), None
    if file is not None:
        with reading(file, "K as 4x4 or 3x3 numbers"):
            intrinsics = of_matrices.read(CameraSource(file))[0].intrinsics
    files = sorted(poses.glob("*.txt"), key=lambda file: (len(file.name), file))
    views = []
    for pose in map(CameraSource, files) if source.is_folder else [source]:
        with reading(pose, NEEDS):
            numbers = np.array([[float(word) for word in words] for words in pose.words])
            if np.isfinite(numbers).all() or not source.is_folder:
                R, t = from_camera_to_world(pose.pose("the pose", numbers))
                name = pose.path.stem
                views.append(PartialCamera(name, intrinsics, R, t, names=(name,)))
    return views
