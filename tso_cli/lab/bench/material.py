"""What is measured on: another chair's cloud of any size, before the picture of the shipped chair at any size."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ...geometry.camera import Camera
from ...geometry.points import normalise_longest_side, sample_surface
from ...geometry.resampling import area_resize
from ...geometry.view import View
from ...io.cameras import read_camera
from ...io.images import read_mask
from ...io.meshes import Mesh, read_mesh
from ...io.shipped import examples_folder
from ...refinement.config import PAPER_GAMMA, PAPER_LEARNING_RATE
from ...refinement.objective import SilhouetteObjective, resample_view
from ...refinement.optimise import descend
from ...silhouette.chamfer import ChamferToInitial
from ...silhouette.projection import CameraBatch, project

# The example's own start is sampled from this shape.
START = "q17_ChairHandle.ply"
SIGMA_SQ = 0.4
STEPS = 50


def cloud(count: int, seed: int = 0) -> NDArray[np.float64]:
    """``count`` points [N, 3] of the shape that the example of a chair starts from, longest side 1."""
    mesh = _start()
    return normalise_longest_side(sample_surface(mesh.vertices, mesh.faces, count, np.random.default_rng([seed, count])))


@functools.cache
def _start() -> Mesh:
    return read_mesh(examples_folder() / "meshes" / "chair" / START)


def chair_view(side: int) -> View:
    """The mask of the shipped chair, another shape, at ``side`` x ``side`` pixels, and its camera."""
    mask, camera = _picture()
    box = (-0.5, -0.5, camera.width - 0.5, camera.height - 0.5)
    resized, _ = area_resize(mask, box, side, side)
    return View(resized.clip(0.0, 1.0).astype(np.float32), camera.resized(side, side), name="the example of a chair")


@functools.cache
def _picture() -> tuple[NDArray[np.float32], Camera]:
    folder = examples_folder() / "chair"
    mask = read_mask(folder / "mask.png")
    return mask, read_camera(folder / "camera.json", mask.shape[1], mask.shape[0])


@dataclass(frozen=True, eq=False)
class Projection:
    """A cloud in a picture.

    Attributes
    ----------
    points : [1, N, 3]; cameras : the one that sees them.
    points_px : [1, N, 2]; valid : [1, N]; mask : [1, side, side].
    """

    points: Tensor
    cameras: CameraBatch
    points_px: Tensor
    valid: Tensor
    mask: Tensor

    @property
    def side(self) -> int:
        """Of the picture, in pixels."""
        return self.mask.shape[-1]


def projection(count: int, side: int, device: torch.device, seed: int = 0) -> Projection:
    """``count`` points of the start in the picture at ``side`` x ``side``, float32."""
    view = chair_view(side)
    points = torch.as_tensor(cloud(count, seed), dtype=torch.float32, device=device).unsqueeze(0)
    cameras = CameraBatch.of([view.camera], points)
    points_px, valid = project(points, cameras)
    mask = torch.as_tensor(view.mask, device=device).unsqueeze(0)
    return Projection(points, cameras, points_px[:, 0], valid[:, 0], mask)


def trajectory(count: int, device: torch.device, seed: int = 0, steps: int = STEPS) -> list[Tensor]:
    """The iterates [1, N, 3] of a refinement with the paper's settings: the start, then one for each of ``steps`` steps."""
    points = torch.as_tensor(cloud(count, seed), dtype=torch.float32, device=device).unsqueeze(0)
    kept: list[Tensor] = []
    mask_term, chamfer = mask_objective(points), ChamferToInitial(points)
    moving = points.clone().requires_grad_()

    def produce() -> Tensor:
        kept.append(moving.detach().clone())
        return moving

    def objective(moved: Tensor) -> Tensor:
        return mask_term(moved) + PAPER_GAMMA["points"] * chamfer(moved)

    descend(produce, [moving], objective, steps, PAPER_LEARNING_RATE["points"])
    # The first is produced twice: as the best so far, and at the step 0.
    return kept[1:]


def mask_objective(points: Tensor) -> SilhouetteObjective:
    """What `tso refine` asks of the cloud ``points`` [1, N, 3] by the picture of the chair, at its working resolution."""
    working = resample_view(chair_view(256), 0.4, np.zeros(3), 1.0)
    return SilhouetteObjective([[working]], torch.tensor([points.shape[1]]), points)
