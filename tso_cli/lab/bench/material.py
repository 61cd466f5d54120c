"""The clouds and the view that are measured on: one chair's points before the mask of another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ...geometry.points import normalise_longest_side, sample_surface
from ...geometry.resampling import area_resize
from ...geometry.view import View
from ...io.cameras import read_camera
from ...io.images import read_mask
from ...io.meshes import read_mesh
from ...io.shipped import examples_folder
from ...refinement.adam import Adam
from ...refinement.objective import SilhouetteObjective
from ...refinement.presets import PAPER_GAMMA, PAPER_LEARNING_RATE
from ...refinement.resampled_view import resample_view
from ...silhouette.chamfer import ChamferToInitial
from ...silhouette.projection import CameraBatch, project

# The shipped example of a chair starts from points of this shape.
START = "q17_ChairHandle.ply"
SIGMA_SQ = 0.4
STEPS = 50


def cloud(count: int, seed: int = 0) -> NDArray[np.float64]:
    """Initial points [count, 3], longest side 1."""
    mesh = read_mesh(examples_folder() / "meshes" / "chair" / START)
    return normalise_longest_side(sample_surface(mesh.vertices, mesh.faces, count, np.random.default_rng([seed, count])))


def chair_view(side: int) -> View:
    """The mask of the shipped chair at ``side`` x ``side`` pixels, and its camera."""
    folder = examples_folder() / "chair"
    mask = read_mask(folder / "mask.png")
    camera = read_camera(folder / "camera.json", mask.shape[1], mask.shape[0])
    box = (-0.5, -0.5, camera.width - 0.5, camera.height - 0.5)
    resized, _ = area_resize(mask, box, side, side)
    return View(resized.clip(0.0, 1.0).astype(np.float32), camera.resized(side, side), name="the example of a chair")


@dataclass(frozen=True, eq=False)
class Projection:
    """A cloud, its camera and the mask: points [1, N, 3], points_px [1, N, 2], valid [1, N], mask [1, side, side]."""

    points: Tensor
    cameras: CameraBatch
    points_px: Tensor
    valid: Tensor
    mask: Tensor

    @property
    def side(self) -> int:
        return self.mask.shape[-1]


def projection(count: int, side: int, device: torch.device, seed: int = 0) -> Projection:
    """``count`` initial points in the picture at ``side`` x ``side``, float32."""
    view, points = chair_view(side), _initial(count, device, seed)
    cameras = CameraBatch.of([view.camera], points)
    points_px, valid = project(points, cameras)
    mask = torch.as_tensor(view.mask, device=device).unsqueeze(0)
    return Projection(points, cameras, points_px[:, 0], valid[:, 0], mask)


def trajectory(count: int, device: torch.device, seed: int = 0, steps: int = STEPS) -> list[Tensor]:
    """The iterates [1, N, 3] of a refinement with the paper's settings: the initial points, then one for each step."""
    points = _initial(count, device, seed)
    mask_term, chamfer = mask_objective(points), ChamferToInitial(points)
    moving = points.clone().requires_grad_()
    optimiser = Adam([moving], PAPER_LEARNING_RATE["points"])
    iterates = [points]
    for _ in range(steps):
        optimiser.step((mask_term(moving) + PAPER_GAMMA["points"] * chamfer(moving)).sum())
        iterates.append(moving.detach().clone())
    return iterates


def _initial(count: int, device: torch.device, seed: int) -> Tensor:
    return torch.as_tensor(cloud(count, seed), dtype=torch.float32, device=device).unsqueeze(0)


def mask_objective(points: Tensor) -> SilhouetteObjective:
    """The mask loss of `tso refine` for ``points`` [1, N, 3], at its working resolution."""
    view = resample_view(chair_view(256), SIGMA_SQ, np.zeros(3), 1.0)
    return SilhouetteObjective([[view]], torch.tensor([points.shape[1]]), points)
