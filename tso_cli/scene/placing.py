"""Placing a view-aligned network's cloud in front of a camera."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..errors import InputError
from ..geometry.camera import CANONICAL_DISTANCE, CANONICAL_ROTATION, Array, Camera
from ..geometry.view import View

# Twenty steps of a 200th shift a cloud by a tenth of its longest side; more change no result.
ALIGNMENT_STEPS, ALIGNMENT_STEP = 20, 0.005


def place_in_front(points: Array, view: View) -> Camera:
    """The canonical camera with the view's K, shifted so that a view-aligned, centred cloud [N, 3] fills the mask's box.

    A crop shows neither distance nor size of the object: at the distance chosen the longer side of the projected box equals the
    mask's, and a sideways shift centres it on the mask's.
    """
    left, top, right, bottom = view.box()
    size, middle = max(right - left, bottom - top), np.array([left + right, top + bottom]) / 2.0
    camera = replace(view.camera, R=CANONICAL_ROTATION, t=np.array([0.0, 0.0, CANONICAL_DISTANCE]), model="perspective")
    focal = camera.K[[0, 1], [0, 1]]
    nearest = float(points[:, 2].max()) + 0.1
    # The size of the box is almost inversely proportional to the distance, so this converges in a few rounds.
    for _ in range(50):
        pixels, _ = camera.project(points)
        low, high = pixels.min(0) - 0.5, pixels.max(0) + 0.5
        distance = max(camera.t[2] * float((high - low).max()) / size, nearest)
        shift = (middle - (low + high) / 2.0) / focal * distance
        t = np.array([camera.t[0] + shift[0], camera.t[1] + shift[1], distance])
        if np.abs(t - camera.t).max() < 1e-9 * distance:
            break
        camera = replace(camera, t=t)
    return camera


def align_silhouette(points: Array, view: View, sigma_sq: float | None = None, steps: int = ALIGNMENT_STEPS) -> Camera:
    """The view's camera, shifted to where the silhouette of a cloud agrees best with the mask (BCE, Eq. 4).

    A box depends on the outermost points of a prediction, which are often wrong; the silhouette depends on all of them. The
    camera must be about right already, as from `place_in_front`; ``sigma_sq`` is in px^2, None for the view's default.
    """
    from ..losses.projection import project
    from ..losses.silhouette import default_sigma_sq, silhouette_bce
    from ..refinement.adam import Adam
    from ..refinement.optimise import descend
    from ..refinement.parameters import PointParameters

    sigma_sq = default_sigma_sq(view.camera.width, view.camera.height) if sigma_sq is None else sigma_sq
    known = 1.0 if view.known is None else view.known
    mask = view.mask.astype(np.float64)
    weights = mask * known, (1.0 - mask) * known

    def silhouette_loss(shift: Array) -> tuple[float, Array]:
        projected = project(points, replace(view.camera, t=view.camera.t + shift[0]))
        if not projected.valid.any():
            return np.inf, shift
        value, gradient_px = silhouette_bce(projected.points_px, projected.valid, *weights, sigma_sq)
        return value, projected.in_camera(gradient_px).sum(0, keepdims=True)

    optimiser = Adam(ALIGNMENT_STEP * float(np.ptp(points, axis=0).max()))
    best = descend(PointParameters(np.zeros((1, 3)), optimiser), silhouette_loss, steps).best[0]
    return replace(view.camera, t=view.camera.t + best)


def view_to_world(points: Array, placed: Camera, camera: Camera) -> Array:
    """A view-aligned cloud, which ``placed`` projects onto the picture, in the world of ``camera``.

    The picture fixes the cloud up to a scale about the camera's centre, chosen so that the cloud's origin gets the depth of
    the world's origin. Raises InputError if that is not in front of ``camera``.
    """
    if camera.t[2] <= 0.0:
        raise InputError(f"the world's origin has depth {camera.t[2]:g} in this camera, expected it in front (> 0)")
    points_camera = (points @ placed.R.T + placed.t) * (camera.t[2] / placed.t[2])
    return (points_camera - camera.t) @ camera.R
