"""Trajectories: lines of TUM's benchmark, and ``odometry.csv`` of Stray Scanner.

A line of TUM is the time, a position and a quaternion x, y, z, w. Poses lead from camera to world,
in the axes of OpenCV. K of Stray Scanner is in the columns fx, fy, cx and cy, or in
``camera_matrix.csv`` next to the table.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..guard import reading
from ..reading import is_there
from . import of_matrices
from .record import Intrinsics, PartialCamera, from_camera_to_world, matrix_of, of_pixels
from .source import CameraSource

NEEDS = "a position and a quaternion x, y, z, w for each picture"

_TUM = ("frame", "x", "y", "z", "qx", "qy", "qz", "qw")
_FOCAL = ("fx", "fy", "cx", "cy")
_TABLE, _MATRIX = "odometry.csv", "camera_matrix.csv"


def recognises(source: CameraSource) -> bool:
    if source.is_folder:
        return is_there(source.path / _TABLE)
    first = " ".join(source.words[0] if source.words else [])
    if {*source.columns} >= {*_TUM}:
        return True
    return len(first.split()) == len(_TUM) and not first.strip("0123456789.eE+- ")


def read(source: CameraSource) -> list[PartialCamera]:
    source = CameraSource(source.path / _TABLE) if source.is_folder else source
    matrix, shared = source.path.with_name(_MATRIX), None
    if is_there(matrix):
        with reading(matrix, "K as 3x3 numbers"):
            shared = of_matrices.read(CameraSource(matrix))[0].intrinsics
    with reading(source, NEEDS):
        if {*source.columns} >= {*_TUM}:
            return [_view(source, row, shared) for row in source.table]
        lines = source.each(source.words, "pose {}: ")
        return [_view(source, dict(zip(_TUM, words, strict=False)), shared) for words in lines]


def _view(source: CameraSource, row: Mapping[str, str], shared: Intrinsics | None) -> PartialCamera:
    number = {key: float(row[key]) for key in (*_TUM[1:], *_FOCAL) if key in row}
    quaternion = [number[key] for key in ("qw", "qx", "qy", "qz")]
    position = source.matrix("the position", [number[key] for key in "xyz"], (3,))
    R, t = from_camera_to_world(np.c_[source.quaternion("the quaternion", quaternion), position])
    if number.keys() >= {*_FOCAL}:
        shared = of_pixels(matrix_of(*(number[key] for key in _FOCAL), corner=True), None)
    return PartialCamera(source.title, shared, R, t, names=(row["frame"],))
