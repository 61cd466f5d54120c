"""``rendering_metadata.txt`` of 3D-R2N2: a line for each picture.

A line has azimuth, elevation and in-plane rotation in degrees, a distance ratio, and the field of
view 25, which is not used. Facts about the cameras, from the code that rendered the pictures:

- The camera stands at 1.75 times the distance ratio and looks at the origin. In the axes of the
  models (y up) its direction is (cos el cos az, sin el, cos el sin az).
- The lens is Blender's default, 35 mm on a sensor of 32 mm.
- The in-plane rotation turns the picture. It is 0 in the published files.
"""

from __future__ import annotations

import numpy as np

from ...geometry.arrays import Array
from .own import relative_to
from .record import PartialCamera, of_longer_sides
from .source import CameraSource

NEEDS = "azimuth, elevation, rotation and distance ratio in each line"

FOCAL = 35.0 / 32.0
"""Focal length, in longer sides of the picture."""
_COLUMNS, _FIELD_OF_VIEW = 5, 25.0


def recognises(source: CameraSource) -> bool:
    rows = source.words
    try:
        last = {float(words[-1]) for words in rows}
    except ValueError:
        return False
    return {len(words) for words in rows} == {_COLUMNS} and last == {_FIELD_OF_VIEW}


def read(source: CameraSource) -> list[PartialCamera]:
    views = []
    for number, words in enumerate(source.words):
        source.place = f"line {number + 1}: "
        values = source.matrix("the view", [float(word) for word in words[:4]], (4,))
        azimuth, elevation, rotation, ratio = values.tolist()
        if ratio <= 0.0:
            raise source.error("the distance ratio", f"{ratio:g}", "more than 0")
        R, t = pose(azimuth, elevation, ratio, rotation)
        image = relative_to(source.path, f"{number:02d}.png")
        views.append(PartialCamera(source.title, of_longer_sides(FOCAL), R, t, image=image))
    return views


def pose(
    azimuth: float, elevation: float, ratio: float, rotation: float = 0.0
) -> tuple[Array, Array]:
    """R and t of a view, from the axes of ShapeNet's models (y up). Angles are in degrees."""
    az, el, roll = np.radians([azimuth, elevation, rotation])
    right = np.array([np.sin(az), 0.0, -np.cos(az)])
    down = np.array([np.sin(el) * np.cos(az), -np.cos(el), np.sin(el) * np.sin(az)])
    forward = -np.array([np.cos(el) * np.cos(az), np.sin(el), np.cos(el) * np.sin(az)])
    rolled_right = np.cos(roll) * right + np.sin(roll) * down
    rolled_down = np.cos(roll) * down - np.sin(roll) * right
    return np.array([rolled_right, rolled_down, forward]), np.array([0.0, 0.0, 1.75 * ratio])
