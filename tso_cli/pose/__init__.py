"""The camera of a picture, from its mask and a cloud alone, in numpy."""

from __future__ import annotations

from .fit import Alternative, FittedCamera, fit_camera

__all__ = ["Alternative", "FittedCamera", "fit_camera"]
