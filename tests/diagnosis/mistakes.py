"""Wrong input under which a hypothesis of the table is right."""

from dataclasses import replace

import numpy as np

from tso_cli import View
from tso_cli.diagnosis.assumptions import Assumption, as_meant
from tso_cli.diagnosis.hypotheses import FOCAL_UNITS, HYPOTHESES

from .common import PLANE

# The hypothesis that undoes another one, where that is not the same change again.
PAIRS = (
    ("mask-turned-left", "mask-turned-right"),
    ("cloud-z-up", "cloud-y-up"),
    ("cloud-yzx", "cloud-zxy"),
    ("cloud-millimetres", "camera-millimetres"),
    ("cloud-centimetres", "camera-centimetres"),
    ("cloud-inches", "camera-inches"),
    ("cloud-ten-times-large", "cloud-ten-times-small"),
    ("cloud-twice-large", "cloud-half-large"),
)
OPPOSITE = {one: other for pair in PAIRS for one, other in (pair, pair[::-1])}
# The aeroplane's camera has its principal point in the middle of the picture, where exchanged
# coordinates change nothing, and a transposed R shows nearly the same silhouette.
# In a picture of 256 px, a focal length in mm is as large as one in pixels may be.
INVISIBLE = {"principal-point-swapped", "R-transposed", "focal-mm-36", "focal-mm-32"}


def _not_in_pixels(name: str) -> np.ndarray:
    """K of the aeroplane's camera, with a focal length in another unit."""
    K, width, height = PLANE.camera.K.copy(), PLANE.camera.width, PLANE.camera.height
    if name == "K-normalised":
        return np.diag([1 / width, 1 / height, 1]) @ (K + [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])
    if name == "K-ndc":
        half = min(width, height) / 2
        middle = (np.array([width, height]) / 2 - 0.5 - K[:2, 2]) / half
        return np.array([[K[0, 0] / half, 0, middle[0]], [0, K[1, 1] / half, middle[1]], [0, 0, 1]])
    units = {
        "focal-mm-36": 36.0 / width * K[0, 0],
        "focal-mm-32": 32.0 / width * K[0, 0],
        "focal-degrees": np.degrees(2 * np.arctan(width / 2 / K[0, 0])),
    }
    K[0, 0] = K[1, 1] = units[name]
    return K


def mistaken(name: str) -> tuple[np.ndarray, View]:
    """The aeroplane's true cloud and its view, wrong so that the hypothesis ``name`` is right."""
    view, camera = PLANE.view, PLANE.camera
    if name == "opengl-camera-to-world":
        flip = np.array([1.0, -1.0, -1.0])
        R, t = flip[:, None] * camera.R, flip * camera.t
        return PLANE.target, replace(view, camera=replace(camera, R=R.T, t=-R.T @ t))
    if name == "pytorch3d":
        R, t = np.diag([-1.0, -1.0, 1.0]) @ camera.R, camera.t * [-1.0, -1.0, 1.0]
        return PLANE.target, replace(view, camera=replace(camera, R=R.T, t=t))
    if name == "t-of-position":
        return PLANE.target, replace(view, camera=replace(camera, t=camera.position))
    if HYPOTHESES[name] in FOCAL_UNITS:
        return PLANE.target, replace(view, camera=replace(camera, K=_not_in_pixels(name)))
    mistake = HYPOTHESES[OPPOSITE.get(name, name)]
    mask = as_meant(view, [Assumption(mistake)]).mask if mistake.of_mask else view.mask
    wrong = replace(view, mask=mask, camera=mistake.camera(camera))
    return PLANE.target @ mistake.matrix.T, wrong
