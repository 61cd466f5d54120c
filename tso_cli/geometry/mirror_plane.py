"""A mirror plane, and the view of a symmetric object that another view implies."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .arrays import Array
from .view import View


@dataclass(frozen=True, eq=False)
class MirrorPlane:
    """The plane ``normal . x = offset``; ``normal`` [3] has length 1."""

    normal: Array
    offset: float

    def reflect(self, points: Array) -> Array:
        """The mirror images of ``points`` [N, 3]."""
        distance = (points @ self.normal) - self.offset
        reflected: Array = points - 2.0 * distance[:, None] * self.normal
        return reflected

    def flipped(self, view: View) -> View:
        """The view flipped left to right, with the mirrored camera that sees a symmetric object so.

        A depth map is flipped with the mask. A photo is left out: paint, lettering above all, is
        not symmetric where the shape is.
        """
        camera = view.camera
        matrix = np.eye(3) - 2.0 * np.outer(self.normal, self.normal)
        flip = np.array([-1.0, 1.0, 1.0])
        K = camera.K.copy()
        K[0, 1], K[0, 2] = -K[0, 1], camera.width - 1.0 - K[0, 2]
        R = flip[:, None] * (camera.R @ matrix)
        t = flip * (camera.t + 2.0 * self.offset * (camera.R @ self.normal))
        known = None if view.known is None else view.known[:, ::-1]
        depth = None if view.depth is None else view.depth[:, ::-1]
        camera = replace(camera, K=K, R=R, t=t)
        name = f"{view.name}, mirrored"
        mask = view.mask[:, ::-1]
        return View(mask, camera, known, name, depth, mask_error=view.mask_error)
