"""Meshes -> images, masks, cameras and ground truth, by casting rays.

Every mesh is first centred on its bounding box and scaled to longest side 1. y is up; azimuth 0 looks along -z at the side
that faces +z, and grows toward +x; the camera looks at the origin. At azimuth and elevation 0 its R is the canonical one.
"""

from __future__ import annotations

from .folder import RenderSummary, render_folder
from .objects import RenderedObject, ground_truth, normalise, render_mesh
from .rays import RayScene, RenderedView, render_view
from .viewpoints import RenderSettings, fitting_distance, look_at, sample_cameras

__all__ = [
    "RayScene",
    "RenderSettings",
    "RenderSummary",
    "RenderedObject",
    "RenderedView",
    "fitting_distance",
    "ground_truth",
    "look_at",
    "normalise",
    "render_folder",
    "render_mesh",
    "render_view",
    "sample_cameras",
]
