"""The camera of a picture, from its mask and a cloud alone. Written in numpy: torch is not needed."""

from __future__ import annotations

from .fit import Alternative, FittedCamera, fit_camera

__all__ = ["Alternative", "FittedCamera", "fit_camera"]
