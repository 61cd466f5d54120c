"""``cameras.npz`` or ``cameras_sphere.npz`` of IDR, VolSDF and NeuS: P of each picture.

``world_mat_0``, ``world_mat_1``, ... are [4, 4]; their upper rows are P = K [R | t].
``scale_mat_0``, ... lead from the unit sphere, in which the networks work, to the world.
"""

from __future__ import annotations

import re
import warnings

from ...errors import prefixed
from .matrices import decomposed
from .record import PartialCamera, of_pixels
from .source import CameraSource

NEEDS = "world_mat_0, world_mat_1, ..."

_KEY = re.compile(r"world_mat_(\d{1,6})")


def recognises(source: CameraSource) -> bool:
    return any(_KEY.fullmatch(key) for key in source.arrays)


def read(source: CameraSource) -> list[PartialCamera]:
    keys = {int(match[1]): key for key in source.arrays if (match := _KEY.fullmatch(key))}
    views = []
    for number, key in sorted(keys.items()):
        P = source.pose(key, source.arrays[key], (4, 4), (3, 4))
        with prefixed(f"{source.path}: {key}: "):
            K, R, t = decomposed(P[:3])
        # DTU and NeuS name pictures with three or six digits.
        names = (f"{number:03d}", f"{number:06d}")
        views.append(PartialCamera(f"picture {number}", of_pixels(K, None), R, t, names=names))
    if any(key.startswith("scale_mat_") for key in source.arrays):
        warnings.warn(
            f"{source.path}: scale_mat is left out: the cloud must be in the frame of the world, "
            "not in the unit sphere",
            stacklevel=2,
        )
    return views
