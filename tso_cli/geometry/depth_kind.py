"""What a depth map holds. Without numpy, which completing an option must not import."""

from __future__ import annotations

from typing import Literal

DepthKind = Literal["auto", "z", "inverse", "affine", "ray"]
"""What a depth map holds:

- z: depth along the camera's z axis, in the units of t;
- auto: the same, but the map is tested first, and left out if it is something else;
- inverse: a / z + b with unknown a > 0 and b, as disparity and most relative depth;
- affine: a z + b with unknown a > 0 and b;
- ray: the distance from the camera along the ray, in the units of t.
"""
FITTED: tuple[DepthKind, ...] = ("inverse", "affine")
"""Kinds that are known up to two numbers, which are fitted to the cloud."""
