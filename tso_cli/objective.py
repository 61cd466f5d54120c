"""The mask term of the optimisation: views resampled to the resolution their kernel can resolve, projected and compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from .errors import InputError
from .losses import silhouette_bce
from .projection import CameraBatch, coarsened, default_sigma_sq, project, silhouette_sums
from .resample import area_resize
from .scene import View

# A silhouette blurred by this variance (px^2) is resolved by its pixels: it is the paper's setting.
RESOLVED_SIGMA_SQ = 0.4


@dataclass(frozen=True, eq=False)
class WorkingView:
    """A view as the loop sees it: tensors with leading batch axes of one cloud and one view."""

    mask: Tensor  # [1, h, w]
    known: Tensor | None  # [1, h, w] weight
    camera: CameraBatch
    sigma_sq: float


def working_view(view: View, sigma_sq: float, centre: NDArray[np.float64], scale: float, like: Tensor) -> WorkingView:
    """Prepare ``view`` for a cloud normalised by ``(X - centre) / scale``.

    A silhouette whose kernel spans many pixels holds nothing finer than that kernel, so its mask is averaged (by area) down
    to pixels of about the kernel's size. The default sigma^2 grows with the image, so every image is worked on at 64 px along
    its longer side; a smaller sigma^2 keeps more. Nothing is ever scaled up.
    """
    camera, sigma_sq = coarsened(view.camera, sigma_sq, RESOLVED_SIGMA_SQ)
    mask, known = view.mask.astype(np.float64), view.known
    weight: NDArray[np.float64] | None = None if known is None else known.astype(np.float64)
    if camera is not view.camera:
        box = (-0.5, -0.5, view.camera.width - 0.5, view.camera.height - 0.5)
        mask, weight = area_resize(mask, box, camera.width, camera.height, weights=weight)
    batch = CameraBatch.of([camera.for_normalised(centre, scale)], like)
    return WorkingView(
        torch.as_tensor(mask, dtype=like.dtype, device=like.device).unsqueeze(0),
        None if known is None else torch.as_tensor(weight, dtype=like.dtype, device=like.device).unsqueeze(0),
        batch,
        sigma_sq,
    )


class MaskObjective:
    """Sum over views of the silhouette's binary cross-entropy (Eq. 4) for one cloud.

    Parameters
    ----------
    views : V views of the object.
    centre, scale : the normalisation of the clouds it will be called with.
    sigma_sq : px^2 of each view's mask; None for each view's default.
    like : tensor whose precision and device are used.

    Raises
    ------
    InputError
        sigma_sq is under 0.01 px^2, or its square root over a quarter of the image.
    """

    def __init__(
        self,
        views: Sequence[View],
        centre: NDArray[np.float64],
        scale: float,
        sigma_sq: float | None,
        like: Tensor,
    ) -> None:
        self.views = []
        for view in views:
            own = default_sigma_sq(view.camera.width, view.camera.height) if sigma_sq is None else sigma_sq
            widest = (max(view.camera.width, view.camera.height) / 4.0) ** 2
            if not 0.01 <= own <= widest:
                raise InputError(f"{view.name}: sigma_sq is {own:g} px^2, expected 0.01 to {widest:g} for a mask of this size")
            self.views.append(working_view(view, own, centre, scale, like))

    def __call__(self, points: Tensor) -> Tensor:
        """The loss of ``points`` [N, 3], a scalar."""
        total = points.new_zeros(())
        for view in self.views:
            projected = project(points.unsqueeze(0), view.camera)
            sums = silhouette_sums(projected, view.camera, view.sigma_sq)[:, 0]
            points_px, valid = projected.points_px[:, 0], projected.valid[:, 0]
            total = total + silhouette_bce(sums, view.mask, points_px, valid, view.sigma_sq, view.known)[0]
        return total
