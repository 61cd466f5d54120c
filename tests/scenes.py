"""The shipped examples; masks, views and cameras made from others."""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.ndimage import binary_dilation, minimum_filter
from scipy.spatial.transform import Rotation

from tso_cli import Camera, RefineConfig, View
from tso_cli.cloud.cloud import Cloud
from tso_cli.evaluation.metrics import chamfer
from tso_cli.geometry.resampling import area_resize
from tso_cli.io.cameras import read_camera
from tso_cli.io.clouds import read_cloud
from tso_cli.io.masks import read_mask
from tso_cli.losses.silhouette import silhouette_of
from tso_cli.optimisation.problem import Problem, prepare

EXAMPLES = Path(__file__).parents[1] / "examples"


class Example(NamedTuple):
    points: np.ndarray
    mask: np.ndarray
    camera: Camera
    target: np.ndarray

    @property
    def view(self) -> View:
        return View(self.mask, self.camera, name="mask.png")

    def error(self, points: np.ndarray) -> float:
        """Chamfer distance to the truth."""
        return chamfer(points, self.target).chamfer


def example(name: str) -> Example:
    """Start, mask, camera and true cloud of a shipped example."""
    folder = EXAMPLES / name
    mask = read_mask(folder / "mask.png")
    camera = read_camera(folder / "camera.json", mask.shape[1], mask.shape[0])
    return Example(
        read_cloud(folder / "initial.ply").points,
        mask,
        camera,
        read_cloud(folder / "target.ply").points,
    )


def depth_of(scene: Example) -> np.ndarray:
    """Depths [H, W] of the true cloud, each drawn 9 px wide; NaN outside the mask."""
    pixels, depth = scene.camera.project(scene.target)
    nearest = np.full(scene.mask.shape, np.inf)
    np.minimum.at(nearest, tuple(pixels.round().astype(int).T[::-1]), depth)
    nearest = minimum_filter(nearest, 9)
    return np.where(np.isfinite(nearest) & (scene.mask > 0.5), nearest, np.nan)


def problem_of(points: np.ndarray, *views: View, symmetry: str = "none") -> Problem:
    """A cloud and its views, prepared for the default optimisation."""
    settings = RefineConfig(symmetry=symmetry).settings()
    return prepare(Cloud(points, "points").controlled(), views, settings)


def block(region: tuple[slice, slice], shape: tuple[int, int] = (64, 64)) -> np.ndarray:
    """A mask that is foreground in ``region``."""
    mask = np.zeros(shape, np.float32)
    mask[region] = 1.0
    return mask


def seen(points: np.ndarray, camera: Camera) -> View:
    """What a camera shows of a cloud, each pixel foreground or not."""
    return View(np.float32(silhouette_of(points, camera) > 0.5), camera)


def about(axis: str, degrees: float) -> np.ndarray:
    """Rotation about x, y or z, right-handed."""
    return Rotation.from_euler(axis, degrees, degrees=True).as_matrix()


def turned(camera: Camera, degrees: float) -> Camera:
    """The camera that sees an object as ``camera`` sees it turned about the vertical axis."""
    return replace(camera, R=camera.R @ about("y", degrees))


def small(scene: Example, pixels: int, grown: int = 0) -> View:
    """A view whose object is ``pixels`` large, and its sharp mask ``grown`` on all sides."""
    left, top, right, bottom = scene.view.pixels_of_object
    height, width = scene.mask.shape
    side = round(width * pixels / max(right - left, bottom - top))
    shares, _ = area_resize(scene.mask, (-0.5, -0.5, width - 0.5, height - 0.5), side, side)
    mask = shares > 0.5
    if grown:
        mask = binary_dilation(mask, iterations=grown)
    return View(np.float32(mask), scene.camera.resized(side, side), name="mask.png")


def in_photo(view: View, times: int, left: int, top: int) -> View:
    """A picture ``times`` as wide and high, which has ``view`` at ``left`` and ``top``."""
    height, width = view.mask.shape
    mask = np.zeros((times * height, times * width), np.float32)
    mask[top : top + height, left : left + width] = view.mask
    K = view.camera.K + [[0.0, 0.0, left], [0.0, 0.0, top], [0.0, 0.0, 0.0]]
    return View(
        mask, replace(view.camera, K=K, width=times * width, height=times * height), name=view.name
    )
