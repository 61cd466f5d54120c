"""Random views of an object, as people photograph it and as they do not."""

from __future__ import annotations

import numpy as np

from ...geometry.arrays import Array
from ...geometry.camera import CANONICAL_ROTATION
from ...geometry.rotations import from_quaternion, from_vectors

USUAL_CHANCE = 0.75
USUAL_ELEVATION, ANY_ELEVATION = (-5.0, 40.0), (-40.0, 88.0)  # degrees above the horizon
ROLL = 4.0  # degrees, standard deviation of a camera that is held upright
ANY_ROLL_CHANCE = 0.4
LYING_CHANCE = 0.2  # of an object whose up is any direction, such as a cloud that lies on its side
DISTANCE = (1.8, 3.6)  # in longest sides of the object
ORTHOGRAPHIC_CHANCE = 0.05


def draw_pose(rng: np.random.Generator) -> Array:
    """How the object stands, [3, 3]: mostly upright, with y up."""
    if rng.random() >= LYING_CHANCE:
        return np.eye(3)
    return from_quaternion(*rng.normal(size=4).tolist())


def draw_view(rng: np.random.Generator, pose: Array) -> tuple[Array, float]:
    """Rotation [3, 3] from the object to the view's axes, and closeness u = 1 / distance.

    In the view's axes x is right, y is down and z points away from the camera. u is 0 for an
    orthographic view.
    """
    usual = rng.random() < USUAL_CHANCE
    elevation = np.radians(rng.uniform(*(USUAL_ELEVATION if usual else ANY_ELEVATION)))
    azimuth = rng.uniform(-np.pi, np.pi)
    roll = np.radians(rng.normal(0.0, ROLL))
    if rng.random() < ANY_ROLL_CHANCE:
        roll = rng.uniform(-np.pi, np.pi)
    turned = from_vectors(np.array([0.0, azimuth, 0.0]))
    # A camera above the horizon sees the top, which turns toward the camera.
    tilted = from_vectors(np.array([elevation, 0.0, 0.0]))
    rolled = from_vectors(np.array([0.0, 0.0, roll]))
    rotation: Array = rolled @ tilted @ CANONICAL_ROTATION @ turned @ pose
    closeness = 1.0 / rng.uniform(*DISTANCE)
    return rotation, 0.0 if rng.random() < ORTHOGRAPHIC_CHANCE else closeness
