"""What each of many views counts for: less where it is held to be wrong, and where others show the same side."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ..geometry.camera import Camera
from ..geometry.points import Array
from ..silhouette.projection import pixels_under
from .objective import ResampledView, SilhouetteObjective, ViewBatch

# Of fewer views none can be told to be the wrong one.
FEWEST_TO_JUDGE = 3
# Chosen on validation shapes with none or one of four views wrong: a loss so many times the median is not held against a view;
# nor is any while its gradient agrees this well with the others' (mean cosine); how quickly the weight falls beyond.
TOLERATED = 1.5
AGREEING = 0.1
STEEPNESS = 4.0
# How quickly two pictures come to tell different things as the angle between their cameras grows: the power of its cosine.
SAMENESS = 8


class Weights(NamedTuple):
    """What the views of B clouds count for.

    Attributes
    ----------
    trust : [B, V] in (0, 1], less than 1 where the other views contradict one (`view_weights`).
    shared : [B, V] in (0, 1] of their losses: the trust, divided among those that show the same (`told_once`).
    """

    trust: Tensor
    shared: Tensor

    @classmethod
    def even(cls, clouds: int, views: int) -> Weights:
        """All count in full."""
        ones = torch.ones(clouds, views, dtype=torch.float64)
        return cls(ones, ones)

    @classmethod
    def of(cls, views: Sequence[Sequence[ResampledView]], counts: Tensor, points: Tensor) -> Weights:
        """By the silhouettes at ``points`` [B, N, 3]; ``views`` and ``counts`` are those of `SilhouetteObjective`."""
        if len(views[0]) == 1:
            return cls.even(len(views), 1)
        objective = SilhouetteObjective(views, counts, points)
        trust = _trusted(objective, views, points)
        return cls(trust, told_once(trust, _sameness(objective, views, points)))


def _trusted(objective: SilhouetteObjective, views: Sequence[Sequence[ResampledView]], points: Tensor) -> Tensor:
    if len(views[0]) < FEWEST_TO_JUDGE:
        return torch.ones(len(views), len(views[0]), dtype=torch.float64)
    start = points.detach().clone().requires_grad_()
    losses = objective.losses(start)
    pulls = [torch.autograd.grad(loss.sum(), start, retain_graph=True)[0].flatten(1).double() for loss in losses]
    sizes = torch.tensor([[view.size for view in own] for own in views], dtype=torch.float64, device=start.device)
    return view_weights(torch.stack(losses, 1).detach().double() / sizes, torch.stack(pulls, 1)).cpu()


def told_once(trust: Tensor, sameness: Tensor) -> Tensor:
    """Weights of views of which some show the same: together such views count as the most trusted of them would alone.

    Parameters
    ----------
    trust : [B, V]. sameness : [B, V, V] in [0, 1], how much of what view v tells view u tells as well; 1 for v = u.

    Returns
    -------
    [B, V]: the trust, times the largest of sameness x trust over all views, over their sum.
    """
    told = sameness * trust.unsqueeze(1)
    return trust * told.amax(2) / told.sum(2).clamp_min(torch.finfo(trust.dtype).tiny)


def _sameness(objective: SilhouetteObjective, views: Sequence[Sequence[ResampledView]], points: Tensor) -> Tensor:
    """[B, V, V]: |cos|^8 of the angle between two cameras, times the share of the points seen by one that the other sees.

    A silhouette from behind is that from the front, flipped; surfaces and colours are not.
    """
    toward = torch.from_numpy(np.stack([[_toward(view.camera) for view in own] for own in views]))
    cosine = toward @ toward.mT
    facing = torch.tensor([[view.depth is not None or view.image is not None for view in own] for own in views])
    cosine = torch.where(facing.unsqueeze(1) & facing.unsqueeze(2), cosine.clamp_min(0.0), cosine)
    seen = torch.stack([_seen(objective, view, points) for view in objective.views], 1).double().cpu()  # [B, V, N]
    common = seen @ seen.mT / seen.sum(2, keepdim=True).clamp_min(1.0)
    same: Tensor = cosine.abs() ** SAMENESS * common
    # Of what shows none of the points nobody else tells.
    return same.diagonal_scatter(torch.ones_like(same[:, 0]), dim1=1, dim2=2)


def _seen(objective: SilhouetteObjective, view: ViewBatch, points: Tensor) -> Tensor:
    """[B, N] which points fall on known pixels of a view."""
    pixel, within = pixels_under(*objective.projected(points.detach(), view), *view.mask.shape[1:])
    if view.known is None:
        return within
    return within & (view.known.flatten(1).gather(1, pixel) >= 0.5)


def _toward(camera: Camera) -> Array:
    """Unit vector from the origin toward a camera."""
    vector: Array = -camera.R[2] if camera.model != "perspective" else camera.position
    return vector / max(float(np.linalg.norm(vector)), 1e-9)


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
