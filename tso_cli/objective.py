"""The mask term of the optimisation: views resampled to the resolution their kernel can resolve, projected and compared."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from .camera import NEAR, Camera
from .errors import InputError
from .losses import REFERENCE_PIXELS, PixelWeights, mask_loss
from .projection import CameraBatch, coarsened, default_sigma_sq, project
from .resample import area_resize
from .scene import View

# A silhouette blurred by this variance (px^2) is resolved by its pixels: it is the paper's setting.
RESOLVED_SIGMA_SQ = 0.4
# Of fewer views none can be told to be the wrong one.
FEWEST_TO_JUDGE = 3
# Chosen on validation shapes with none or one of four views wrong: a loss so many times the median is not held against a view;
# nor is any while its gradient agrees this well with the others' (mean cosine); how quickly the weight falls beyond.
TOLERATED = 1.5
AGREEING = 0.1
STEEPNESS = 4.0


@dataclass(frozen=True, eq=False)
class WorkingView:
    """A view as the loop sees it.

    Attributes
    ----------
    mask : [h, w]; known : [h, w] weight of each pixel, None where all count.
    camera : from normalised points to its pixels; sigma_sq : px^2 there.
    """

    mask: NDArray[np.float64]
    known: NDArray[np.float64] | None
    camera: Camera
    sigma_sq: float

    @property
    def kind(self) -> tuple[int, int, str, float]:
        """What views must have in common to be worked on together."""
        return self.camera.width, self.camera.height, self.camera.model, self.sigma_sq

    @property
    def size(self) -> float:
        """Pixels of a 64x64 mask along a unit at the cloud's centre; outlines, and with them losses, grow with it."""
        camera = self.camera
        depth = 1.0 if camera.model == "orthographic" else max(float(camera.t[2]), NEAR)
        return float(np.sqrt(camera.K[0, 0] * camera.K[1, 1] * REFERENCE_PIXELS / (camera.width * camera.height)) / depth)


def working_view(view: View, sigma_sq: float | None, centre: NDArray[np.float64], scale: float) -> WorkingView:
    """Prepare ``view`` for a cloud normalised by ``(X - centre) / scale``.

    A silhouette whose kernel spans many pixels holds nothing finer than that kernel, so its mask is averaged (by area) down
    to pixels of about the kernel's size. The default sigma^2 grows with the image, so every image is worked on at 64 px along
    its longer side; a smaller sigma^2 keeps more. Nothing is ever scaled up.

    Raises
    ------
    InputError
        sigma_sq (px^2; None for the view's default) is under 0.01, or its square root over a quarter of the image.
    """
    if sigma_sq is None:
        sigma_sq = default_sigma_sq(view.camera.width, view.camera.height)
    widest = (max(view.camera.width, view.camera.height) / 4.0) ** 2
    if not 0.01 <= sigma_sq <= widest:
        raise InputError(f"{view.name}: sigma_sq is {sigma_sq:g} px^2, expected 0.01 to {widest:g} for a mask of this size")
    camera, sigma_sq = coarsened(view.camera, sigma_sq, RESOLVED_SIGMA_SQ)
    mask, known = view.mask.astype(np.float64), view.known
    weight: NDArray[np.float64] | None = None if known is None else known.astype(np.float64)
    if camera is not view.camera:
        box = (-0.5, -0.5, view.camera.width - 0.5, view.camera.height - 0.5)
        mask, weight = area_resize(mask, box, camera.width, camera.height, weights=weight)
    return WorkingView(mask, None if known is None else weight, camera.for_normalised(centre, scale), sigma_sq)


def view_weights(losses: Tensor, pulls: Tensor) -> Tensor:
    """Weights of views, some of which may be wrong: another object's mask, or a camera that stood elsewhere.

    Two things together speak against a view: its loss is high beside the others', and its pull on the points is not theirs. A
    loss alone does not: where the cloud is wrong in depth only a view from the side shows it, and its pull leaves the others'
    silhouettes as they are. With r the loss over the median of the cloud's views, and a the mean cosine between the view's
    gradient and the others', the weight is (1.5 / r)^(4 (1 - a / 0.1)), a kept within 0 and 0.1, at most 1.

    Parameters
    ----------
    losses : [B, V], V >= 3, comparable between views.
    pulls : [B, V, D] gradients of the losses with respect to the points.

    Returns
    -------
    [B, V] in (0, 1].
    """
    share = losses / losses.quantile(0.5, dim=1, keepdim=True)
    unit = torch.nn.functional.normalize(pulls, dim=2)
    agreement = ((unit * unit.sum(1, keepdim=True)).sum(2) - 1.0) / (losses.shape[1] - 1)
    doubt = 1.0 - (agreement / AGREEING).clamp(0.0, 1.0)
    return (TOLERATED / share.clamp_min(TOLERATED)) ** (STEEPNESS * doubt)


class MaskObjective:
    """Weighted sum over views of the silhouette's cross-entropy (Eq. 4), for B clouds that are asked by views of their own.

    Parameters
    ----------
    views : [B][V] views of each cloud; view v is of one kind (:attr:`WorkingView.kind`) for all clouds.
    counts : [B] points of each cloud, those behind them are not there.
    like : [B, N, 3] tensor whose precision and device are used.

    Attributes
    ----------
    weights : [B, V] float64, 1 until :meth:`weigh`.
    """

    def __init__(self, views: Sequence[Sequence[WorkingView]], counts: Tensor, like: Tensor) -> None:
        self.views = [_Together.of(column, like) for column in zip(*views, strict=True)]
        self.weights = np.ones((len(views), len(self.views)))
        self._discounts: list[Tensor] | None = None
        self._sizes = np.array([[view.size for view in own] for own in views])
        size = like.shape[1]
        full = bool((counts == size).all())
        self._there = None if full else (torch.arange(size) < counts.unsqueeze(1)).to(like.device).unsqueeze(1)  # [B, 1, N]

    def __call__(self, points: Tensor) -> Tensor:
        """The loss [B] of the clouds ``points`` [B, N, 3]; infinite where a view shows no point at all."""
        total = points.new_zeros(len(points))
        for number, view in enumerate(self.views):
            loss = self._loss(points, view)
            total = total + (loss if self._discounts is None else self._discounts[number] * loss)
        return total

    def weigh(self, points: Tensor) -> None:
        """Discount, from here on, the views that the others contradict at the clouds ``points`` (:func:`view_weights`)."""
        if len(self.views) < FEWEST_TO_JUDGE:
            return
        start = points.detach().clone().requires_grad_()
        losses, pulls = [], []
        for view in self.views:
            loss = self._loss(start, view)
            pulls.append(torch.autograd.grad(loss.sum(), start)[0].flatten(1).double())
            losses.append(loss.detach().double())
        size = torch.as_tensor(self._sizes).to(losses[0])
        weights = view_weights(torch.stack(losses, 1) / size, torch.stack(pulls, 1))
        self.weights = weights.cpu().numpy()
        if (weights < 1.0).any():
            self._discounts = list(weights.to(points).unbind(1))

    def _loss(self, points: Tensor, view: _Together) -> Tensor:
        projected = project(points, view.cameras)
        if self._there is not None:
            projected = projected._replace(valid=projected.valid & self._there)
        points_px, valid = projected.points_px[:, 0], projected.valid[:, 0]
        # With no point to pull, the pixels that want one would ask for nothing: a cloud behind the camera would be perfect.
        return torch.where(valid.any(1), mask_loss(points_px, valid, view.target, view.sigma_sq), torch.inf)


@dataclass(frozen=True, eq=False)
class _Together:
    """One view of each of B clouds."""

    target: PixelWeights  # [B, h, w]
    cameras: CameraBatch  # [B, 1]
    sigma_sq: float

    @classmethod
    def of(cls, views: Sequence[WorkingView], like: Tensor) -> _Together:
        def stacked(arrays: list[NDArray[np.float64]]) -> Tensor:
            return torch.as_tensor(np.stack(arrays), dtype=like.dtype, device=like.device)

        first = views[0]
        if any(view.kind != first.kind for view in views):
            raise ValueError("views that are worked on together share size, model and sigma^2")
        known = None
        if any(view.known is not None for view in views):
            known = stacked([np.ones_like(view.mask) if view.known is None else view.known for view in views])
        return cls(
            PixelWeights.of(stacked([view.mask for view in views]), known),
            CameraBatch.of([view.camera for view in views], like).one_each(),
            first.sigma_sq,
        )
