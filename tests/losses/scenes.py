"""A camera with skew in general position, and points that it sees at chosen pixels."""

import numpy as np
from hypothesis import strategies as st

from tso_cli.geometry.camera import Camera
from tso_cli.geometry.rotations import from_vectors

WIDTH, HEIGHT = 32, 24


def camera_of(model: str = "perspective") -> Camera:
    focal = 40.0 if model == "perspective" else 20.0
    K = np.array([[focal, 1.5, 15.0], [0.0, 1.1 * focal, 12.5], [0.0, 0.0, 1.0]])
    return Camera(
        K,
        from_vectors(np.array([0.4, -0.8, 0.3])),
        np.array([0.1, -0.05, 2.0]),
        WIDTH,
        HEIGHT,
        model,
    )


def points_at(pixels: np.ndarray, camera: Camera, depth: np.ndarray) -> np.ndarray:
    """The points [N, 3] that project to ``pixels`` [N, 2] at ``depth`` [N]."""
    plane = np.linalg.solve(camera.K, np.concatenate([pixels, np.ones((len(pixels), 1))], 1).T).T
    plane[:, :2] *= 1.0 if camera.model == "orthographic" else depth[:, None]
    return (np.concatenate([plane[:, :2], depth[:, None]], 1) - camera.t) @ camera.R


# Columns and rows in and around the image, and depths before and behind the camera.
PLACES = st.lists(
    st.tuples(st.floats(-9, 40), st.floats(-9, 40), st.floats(-1, 3)), min_size=1, max_size=12
)


def points_of(places: list[tuple[float, float, float]], camera: Camera) -> np.ndarray:
    """Points away from the borders of pixels, no two equally near: both forms round alike there."""
    column, row, depth = (
        np.round(places, 3) + np.random.default_rng(4).uniform(1e-4, 9e-4, (len(places), 3))
    ).T
    return points_at(np.stack([column, row], 1), camera, depth)


def scattered(count: int = 60, seed: int = 1) -> np.ndarray:
    """Pixels inside and outside the image; the last lie near borders of pixels and the image."""
    pixels = np.random.default_rng(seed).uniform([-3, -3], [WIDTH + 3, HEIGHT + 3], (count, 2))
    borders = [
        [4.5, 3.2],
        [20.7, 11.5],
        [WIDTH - 0.5, 8.3],
        [12.2, HEIGHT - 0.5],
        [-0.5, 6.1],
        [7.3, -0.5],
        [9.5, 9.5],
    ]
    sides = np.where(np.arange(len(borders)) % 2, 1e-4, -1e-4)[:, None]
    return np.concatenate([pixels, borders + sides])
