"""Weights of several views: lower for views that the others contradict, and shared among views of the same side."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ..geometry.camera import Camera
from ..geometry.points import Array
from ..silhouette.projection import pixels_under
from .objective import SilhouetteObjective, Views

# With fewer views, none can be called the outlier.
FEWEST_TO_JUDGE = 3
# Chosen on validation shapes with none or one of four views wrong. A loss up to so many medians is tolerated, and so is any
# loss of a view whose gradient agrees this well with the others' (mean cosine); the steepness of the fall beyond.
TOLERATED_LOSS = 1.5
AGREEMENT = 0.1
STEEPNESS = 4.0
# Power of the cosine between viewing directions in the redundancy of two views.
REDUNDANCY_POWER = 8


class ViewWeights(NamedTuple):
    """Weights of the views of B clouds.

    ``inlier`` [B, V] is under 1 where the other views contradict one (`inlier_weights`); ``loss`` [B, V] weighs the views'
    losses: the inlier weights, divided among redundant views (`shared_weights`).
    """

    inlier: Tensor
    loss: Tensor

    @classmethod
    def even(cls, clouds: int, views: int) -> ViewWeights:
        ones = torch.ones(clouds, views, dtype=torch.float64)
        return cls(ones, ones)

    @classmethod
    def of(cls, views: Views, counts: Tensor, points: Tensor) -> ViewWeights:
        """From the silhouettes at ``points`` [B, N, 3]; ``views`` and ``counts`` as in `SilhouetteObjective`."""
        if len(views[0]) == 1:
            return cls.even(len(views), 1)
        objective = SilhouetteObjective(views, counts, points)
        inlier = _inlier_weights(objective, views, points)
        return cls(inlier, shared_weights(inlier, _redundancy(objective, views, points)))


def _inlier_weights(objective: SilhouetteObjective, views: Views, points: Tensor) -> Tensor:
    if len(views[0]) < FEWEST_TO_JUDGE:
        return torch.ones(len(views), len(views[0]), dtype=torch.float64)
    start = points.detach().clone().requires_grad_()
    losses = objective.losses(start)
    gradients = [torch.autograd.grad(loss.sum(), start, retain_graph=True)[0].flatten(1).double() for loss in losses]
    scale = torch.tensor([[view.magnification for view in row] for row in views], dtype=torch.float64, device=start.device)
    return inlier_weights(torch.stack(losses, 1).detach().double() / scale, torch.stack(gradients, 1)).cpu()


def inlier_weights(losses: Tensor, gradients: Tensor) -> Tensor:
    """Weights of views of which some may be outliers: the mask of another object, or a wrong camera.

    An outlier has a high loss, and a gradient that disagrees with the other views'. A high loss alone is no sign: where the
    cloud is wrong in depth only a view from the side shows it, and its gradient leaves the other silhouettes as they are. With
    r the loss over the median of the cloud's views, and a the mean cosine between the view's gradient and the others', kept
    within 0 and 0.1, the weight is (1.5 / r)^(4 (1 - a / 0.1)), at most 1.

    ``losses`` [B, V], V >= 3, are comparable between views; ``gradients`` [B, V, D] are theirs by the points. [B, V].
    """
    ratio = losses / losses.quantile(0.5, dim=1, keepdim=True)
    unit = torch.nn.functional.normalize(gradients, dim=2)
    agreement = ((unit * unit.sum(1, keepdim=True)).sum(2) - 1.0) / (losses.shape[1] - 1)
    doubt = 1.0 - (agreement / AGREEMENT).clamp(0.0, 1.0)
    return (TOLERATED_LOSS / ratio.clamp_min(TOLERATED_LOSS)) ** (STEEPNESS * doubt)


def shared_weights(inlier: Tensor, redundancy: Tensor) -> Tensor:
    """Loss weights [B, V] with which redundant views together count as the most trusted of them alone.

    ``redundancy`` [B, V, V] in [0, 1] is how much of the content of view v is in view u too; 1 for v = u.
    """
    others = redundancy * inlier.unsqueeze(1)
    return inlier * others.amax(2) / others.sum(2).clamp_min(torch.finfo(inlier.dtype).tiny)


def _redundancy(objective: SilhouetteObjective, views: Views, points: Tensor) -> Tensor:
    """[B, V, V]: |cos|^8 of the angle between two cameras, times the share of one view's points that the other sees.

    Silhouettes from opposite sides are the same, flipped; surfaces and colours are not.
    """
    directions = torch.from_numpy(np.stack([[_direction_to(view.camera) for view in row] for row in views]))
    cosine = directions @ directions.mT
    one_sided = torch.tensor([[view.depth is not None or view.image is not None for view in row] for row in views])
    cosine = torch.where(one_sided.unsqueeze(1) & one_sided.unsqueeze(2), cosine.clamp_min(0.0), cosine)
    seen = torch.stack([_seen(objective, number, points) for number in range(len(views[0]))], 1).double().cpu()  # [B, V, N]
    common = seen @ seen.mT / seen.sum(2, keepdim=True).clamp_min(1.0)
    redundancy: Tensor = cosine.abs() ** REDUNDANCY_POWER * common
    # A view that sees no point is redundant with itself all the same.
    return redundancy.diagonal_scatter(torch.ones_like(redundancy[:, 0]), dim1=1, dim2=2)


def _seen(objective: SilhouetteObjective, number: int, points: Tensor) -> Tensor:
    """[B, N] which points fall on known pixels of the view of that number."""
    view = objective.views[number]
    pixel, within = pixels_under(*objective.projected(points.detach(), number), *view.mask.shape[1:])
    if view.known is None:
        return within
    return within & (view.known.flatten(1).gather(1, pixel) >= 0.5)


def _direction_to(camera: Camera) -> Array:
    """Unit vector from the origin to a camera."""
    vector: Array = -camera.R[2] if camera.model != "perspective" else camera.position
    return vector / max(float(np.linalg.norm(vector)), 1e-9)
