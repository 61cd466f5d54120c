"""Matrices in .npz, .npy or text: K, R, t, P, or 4x4 matrices, under the names of JSON files.

An array without a name says what it is by its shape: [3, 3] is K, [3, 4] is P, and [4, 4] a pose
from world to camera, or K as ScanNet stores it. A stack of N of them is N views. ``poses`` lead
from camera to world where ``focals`` stand next to them, as DUSt3R stores both.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from ...errors import InputError, prefixed
from ...geometry.arrays import Array
from ..reading import read_array
from .matrices import decomposed
from .own import NAMES, OTHER_NAMES, like_poses, matrices_of, matrix_K, require_no_lens
from .record import PartialCamera, from_world_to_camera, of_pixels
from .source import CameraSource

NEEDS = "3x3, 3x4 or 4x4 numbers"

# Keys whose value is a matrix or a vector -> its dimensions.
_DIMENSIONS = {
    "K": 2, "R": 2, "t": 1, "E": 2, "c2w": 2, "P": 2, "width": 0, "height": 0, "focal": 0, "pp": 1,
}  # fmt: skip


def recognises(source: CameraSource) -> bool:
    if source.looks_like_json:
        return _unnamed_json(source)
    if source.container == "zip":
        keys = source.arrays.keys()
        return any(_key(key) in NAMES for key in keys)
    if source.container == "npy":
        return True
    rows = _rows(source)
    return len(rows) in (3, 4) and {len(words) for words in rows} in ({3}, {4})


def _rows(source: CameraSource) -> list[list[str]]:
    """The words of each line; commas may separate them."""
    return [" ".join(words).replace(",", " ").split() for words in source.words[:5]]


def _unnamed_json(source: CameraSource) -> bool:
    document = source.json
    return (
        isinstance(document, list)
        and len(document) in (3, 4)
        and all(isinstance(row, list) and len(row) in (3, 4) for row in document)
    )


def read(source: CameraSource) -> list[PartialCamera]:
    if source.container == "zip":
        return _named(source, source.arrays)
    if source.looks_like_json:
        values: Any = source.json
    elif source.container == "npy":
        values = read_array(source.data, source.path)
    else:
        values = [[float(word) for word in words] for words in _rows(source)]
    shapes = ((3, 3), (3, 4), (4, 4), (-1, 3, 3), (-1, 3, 4), (-1, 4, 4))
    array = source.matrix("the array", values, *shapes)
    stack = array[None] if array.ndim == 2 else array
    titles = [""] if array.ndim == 2 else [f"[{i}]" for i in range(len(stack))]
    return [_unnamed(source, title, matrix) for title, matrix in zip(titles, stack, strict=True)]


def _unnamed(source: CameraSource, title: str, matrix: Array) -> PartialCamera:
    # Entries of a rotation are at most 1.
    if matrix.shape == (3, 3) or (matrix.shape == (4, 4) and matrix[0, 0] > 2.0):
        return PartialCamera(title, of_pixels(matrix_K(source, title or "K", matrix), None))
    if matrix.shape == (4, 4):
        R, t = from_world_to_camera(source.pose(title or "the matrix", matrix))
        return PartialCamera(title, None, R, t)
    with prefixed(f"{source.path}: {title}: " if title else f"{source.path}: "):
        K, R, t = decomposed(matrix)
    return PartialCamera(title, of_pixels(K, None), R, t)


def _key(key: str) -> str:
    return OTHER_NAMES.get(key, key)


def _with_t(source: CameraSource, arrays: dict[str, Any]) -> dict[str, Any]:
    """``arrays`` with T as t, as OpenCV writes it; without K the file may also be PyTorch3D's."""
    if not any(_key(key) == "K" for key in arrays):
        raise InputError(
            f"{source.path}: has R and T, which differ between OpenCV and PyTorch3D, expected K "
            "with them; name T t if X_camera = R X_world + t, or add focal_length for PyTorch3D "
            "(`camera_format` pytorch3d)"
        )
    return {"t" if key == "T" else key: value for key, value in arrays.items()}


def _named(source: CameraSource, arrays: dict[str, Any]) -> list[PartialCamera]:
    require_no_lens(source, "", arrays)
    if "T" in arrays and "t" not in arrays:
        arrays = _with_t(source, arrays)
    if "poses" in arrays and "focals" in arrays:
        arrays = {"c2w" if key == "poses" else key: value for key, value in arrays.items()}
    by_key = {_key(key): np.asarray(value) for key, value in arrays.items() if _key(key) in NAMES}
    for key, value in by_key.items():
        # Networks store a batch of one scene.
        while value.ndim > _DIMENSIONS[key] + 1 and len(value) == 1:
            value = value[0]
        # A column t has one dimension more than a vector t, as a stack of vectors has.
        column = key in ("t", "focal") and value.ndim > 1 and value.shape[-1] == 1
        by_key[key] = value[..., 0] if column else value
    stacks = {
        key: len(value) for key, value in by_key.items()
        if value.ndim == _DIMENSIONS[key] + 1
    }  # fmt: skip
    counts = set(stacks.values()) - {1}
    if len(counts) > 1:
        raise source.error("the length of its arrays", str(stacks), "one number of views")
    views = []
    count = counts.pop() if counts else 1
    for number in range(count):
        values = {}
        for key, value in by_key.items():
            of_view = value[number if len(value) > 1 else 0] if key in stacks else value
            values[key] = of_view if of_view.ndim else of_view.item()
        where = f"[{number}]." if count > 1 else ""
        K, R, t, size = matrices_of(source, where, values)
        views.append(PartialCamera(where.rstrip("."), K, R, t, size, unread=like_poses(arrays)))
    return views
