"""Wrong input under which a hypothesis of the table is right."""

from dataclasses import replace

import numpy as np

from tso_cli import View
from tso_cli.diagnosis.hypotheses import HYPOTHESES

from .common import PLANE

# The hypothesis that undoes another one, where that is not the same change again.
PAIRS = (
    ("cloud-z-up", "cloud-y-up"),
    ("cloud-yzx", "cloud-zxy"),
    ("K-of-half-size", "K-of-double-size"),
    ("cloud-millimetres", "camera-millimetres"),
    ("cloud-centimetres", "camera-centimetres"),
    ("cloud-inches", "camera-inches"),
    ("cloud-ten-times-large", "cloud-ten-times-small"),
    ("cloud-twice-large", "cloud-half-large"),
)
OPPOSITE = {one: other for pair in PAIRS for one, other in (pair, pair[::-1])}
# The aeroplane's camera has its principal point in the middle of the picture, where exchanged
# coordinates change nothing, and a transposed R shows nearly the same silhouette.
INVISIBLE = {"principal-point-swapped", "R-transposed"}


def mistaken(name: str) -> tuple[np.ndarray, View]:
    """The aeroplane's true cloud and its view, wrong so that the hypothesis ``name`` is right."""
    view, camera = PLANE.view, PLANE.camera
    if name == "opengl-camera-to-world":
        flip = np.array([1.0, -1.0, -1.0])
        R, t = flip[:, None] * camera.R, flip * camera.t
        return PLANE.target, replace(view, camera=replace(camera, R=R.T, t=-R.T @ t))
    if name == "t-of-position":
        return PLANE.target, replace(view, camera=replace(camera, t=camera.position))
    mistake = HYPOTHESES[OPPOSITE.get(name, name)]
    mask = view.mask
    if mistake.mask == "inverted":
        mask = 1.0 - mask
    elif mistake.mask:
        mask = mask[:, ::-1] if mistake.mask == "left-right" else mask[::-1]
    wrong = replace(view, mask=mask, camera=mistake.camera(camera))
    return PLANE.target @ mistake.matrix.T, wrong
