"""The pose of SAM 3D Objects as JSON: ``rotation`` (w, x, y, z), ``translation`` and ``scale``.

PyTorch3D multiplies rows: x_camera = scale x R(q) + translation, with x to the left, y up and z
forward. A picture does not show the scale, so the camera is x R(q) + translation / scale.

The pose is that of the Gaussian splats, whose z is up. The mesh of the same run is a .glb, whose y
is up (`PartialCamera.for_y_up`). ``intrinsics`` or ``K`` [3, 3], where there are some, have pixel
centres at halves, as those of MoGe. Lists may keep the dimensions of length 1 of a tensor.
"""

from __future__ import annotations

from typing import Any

from ...errors import InputError
from ...geometry.arrays import Array
from .record import PYTORCH3D, Intrinsics, PartialCamera, of_pixels, of_shares
from .source import CameraSource, has_keys

NEEDS = "rotation, translation and scale"

_KEYS = {"rotation", "translation", "scale"}
# The network gives three scales that differ by rounding. A camera cannot stretch an object.
MOST_STRETCHED = 1.05
# No picture is so small: a shorter focal length is in shares of width and height.
SHORTEST_FOCAL = 20.0  # px


def recognises(source: CameraSource) -> bool:
    document = source.json
    first = document[0] if isinstance(document, list) and document else document
    return has_keys(first, _KEYS)


def read(source: CameraSource) -> list[PartialCamera]:
    if len(source.objects) != 1:
        raise InputError(
            f"{source.path}: holds the poses of {len(source.objects)} objects, expected that of "
            "one; write one file for each object"
        )
    values = source.objects[0]
    quaternion = _array(source, "rotation", values["rotation"], (4,))
    translation = _array(source, "translation", values["translation"], (3,))
    R = PYTORCH3D @ source.quaternion("rotation", quaternion).T
    t = PYTORCH3D @ translation / _scale(source, values["scale"])
    return [PartialCamera("", _intrinsics(source, values), R, t, z_up=True)]


def _array(source: CameraSource, key: str, values: Any, *shapes: tuple[int, ...]) -> Array:
    """``values`` as `CameraSource.matrix`, without the dimensions of length 1 of a tensor."""
    while isinstance(values, list) and len(values) == 1 and isinstance(values[0], list):
        values = values[0]
    return source.matrix(key, values, *shapes)


def _scale(source: CameraSource, values: Any) -> float:
    sides = _array(source, "scale", values if isinstance(values, list) else [values], (1,), (3,))
    text = " ".join(f"{side:g}" for side in sides)
    if sides.min() <= 0.0:
        raise source.error("scale", text, "more than 0")
    if sides.max() > MOST_STRETCHED * sides.min():
        raise source.error("scale", text, "three numbers that differ by at most 5 %")
    return float(sides.mean())


def _intrinsics(source: CameraSource, values: dict[str, Any]) -> Intrinsics | None:
    key = next((key for key in ("intrinsics", "K") if values.get(key) is not None), None)
    if key is None:
        return None
    K = _array(source, key, values[key], (3, 3), (9,)).reshape(3, 3)
    if max(K[0, 0], K[1, 1]) < SHORTEST_FOCAL:
        return of_shares(K)
    return of_pixels(K - [[0.0, 0.0, 0.5], [0.0, 0.0, 0.5], [0.0, 0.0, 0.0]], None)
