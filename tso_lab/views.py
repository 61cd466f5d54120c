"""Further views of an example; imports no torch, whose memory is no part of a refinement's."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tso_cli.geometry.points import Array
from tso_cli.geometry.rotations import from_vectors
from tso_cli.geometry.view import View
from tso_cli.losses.silhouette import silhouette_of


def views_around(view: View, truth: Array, radians: Array) -> list[View]:
    """The view, and silhouettes of its ``truth`` [N, 3] turned about the vertical axis."""
    turns = from_vectors(np.outer(radians, [0.0, 1.0, 0.0]))
    cameras = [replace(view.camera, R=view.camera.R @ turn) for turn in turns]
    return [view, *(View(silhouette_of(truth, camera), camera) for camera in cameras)]
