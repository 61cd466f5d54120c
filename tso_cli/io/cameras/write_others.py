"""Writes cameras for other programs: COLMAP's text files, and transforms.json."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import InputError
from ...geometry.camera import Camera
from ...geometry.distortion import Distortion
from ...geometry.rotations import to_quaternion
from .record import OPENGL

Named = tuple[str, Camera, Distortion | None]
"""The name of a picture, its camera, and its lens."""


def _numbers(values: Any) -> str:
    return " ".join(repr(float(value)) for value in np.ravel(values))


def _perspective(named: Sequence[Named]) -> None:
    for name, camera, _ in named:
        if camera.model != "perspective":
            raise InputError(f"{name}: its camera is {camera.model}, expected perspective")
        if camera.K[0, 1] != 0.0:
            raise InputError(
                f"{name}: K has a skew of {camera.K[0, 1]:g}, expected 0: the format has "
                "no place for it; write tso's own format"
            )


def colmap_texts(named: Sequence[Named]) -> dict[str, str]:
    """The files of a COLMAP model without points: name -> text."""
    _perspective(named)
    counts = Counter(name for name, _, _ in named)
    for name, count in counts.items():
        if count > 1:
            raise InputError(
                f"{name}: {count} views have this name, expected one: COLMAP knows pictures by name"
            )
    cameras, images = ["# CAMERA_ID MODEL WIDTH HEIGHT PARAMS"], ["# Two lines for each image"]
    for number, (name, camera, lens) in enumerate(named, 1):
        fx, fy, cx, cy = camera.K[[0, 1, 0, 1], [0, 1, 2, 2]].tolist()
        model, more = "PINHOLE", []
        if lens and not lens.none:
            fisheye = lens.model == "equidistant"
            count = 4 if fisheye or not any(lens.coefficients[4:]) else 8
            model = "OPENCV_FISHEYE" if fisheye else "OPENCV" if count == 4 else "FULL_OPENCV"
            more = [*lens.coefficients, *[0.0] * 8][:count]
        size = f"{camera.width} {camera.height}"
        # Pixel centres of COLMAP lie at halves.
        parameters = _numbers([fx, fy, cx + 0.5, cy + 0.5, *more])
        cameras.append(f"{number} {model} {size} {parameters}")
        pose = f"{_numbers(to_quaternion(camera.R))} {_numbers(camera.t)}"
        images += [f"{number} {pose} {number} {name}", ""]
    texts = {"cameras.txt": cameras, "images.txt": images, "points3D.txt": ["# no points"]}
    return {file: "\n".join(lines) + "\n" for file, lines in texts.items()}


def transforms_text(named: Sequence[Named]) -> str:
    """A transforms.json as nerfstudio writes it, with the intrinsics of each frame."""
    _perspective(named)
    frames = []
    for name, camera, lens in named:
        fx, fy, cx, cy = camera.K[[0, 1, 0, 1], [0, 1, 2, 2]].tolist()
        to_world = np.eye(4)
        to_world[:3, :3] = (OPENGL @ camera.R).T
        to_world[:3, 3] = camera.position
        frame: dict[str, Any] = {
            "file_path": name, "w": camera.width, "h": camera.height, "fl_x": fx, "fl_y": fy,
            "cx": cx + 0.5, "cy": cy + 0.5,
        }  # fmt: skip
        if lens and not lens.none:
            fisheye = lens.model == "equidistant"
            keys = ("k1", "k2", "k3", "k4") if fisheye else ("k1", "k2", "p1", "p2", "k3")
            if any(lens.coefficients[len(keys) :]):
                raise InputError(f"{name}: its lens has more coefficients than the format holds")
            frame["camera_model"] = "OPENCV_FISHEYE" if fisheye else "OPENCV"
            frame |= dict(zip(keys, lens.coefficients, strict=False))
        frames.append(frame | {"transform_matrix": to_world.tolist()})
    return json.dumps({"frames": frames}, indent=1) + "\n"


def folder_of(path: Path, overwrite: bool) -> Path:
    """The folder ``path`` for a model of several files; InputError if it holds one already."""
    binary = [f"{name}.bin" for name in ("cameras", "images", "points3D")]
    if path.is_dir() and any((path / file).exists() for file in binary):
        raise InputError(f"{path}: holds a binary model, which is read first; expected a new name")
    if path.is_dir() and not overwrite and any((path / f).exists() for f in colmap_texts([])):
        raise InputError(f"{path}: holds a model already, expected a new name or `overwrite`")
    if not path.parent.is_dir():
        raise InputError(f"{path}: its folder does not exist, expected one to write to")
    if path.exists() and not path.is_dir():
        raise InputError(f"{path}: is a file, expected a folder to write a COLMAP model to")
    return path
