"""Which of many views are held to be wrong: another object's mask, or a camera that stood elsewhere."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from .objective import MaskObjective, WorkingView

# Of fewer views none can be told to be the wrong one.
FEWEST_TO_JUDGE = 3
# Chosen on validation shapes with none or one of four views wrong: a loss so many times the median is not held against a view;
# nor is any while its gradient agrees this well with the others' (mean cosine); how quickly the weight falls beyond.
TOLERATED = 1.5
AGREEING = 0.1
STEEPNESS = 4.0


def weigh(views: Sequence[Sequence[WorkingView]], counts: Tensor, points: Tensor) -> Tensor:
    """Weights [B, V] in (0, 1] of the V views of each of B clouds, by their silhouettes at ``points`` [B, N, 3].

    See :func:`view_weights`. ``views`` and ``counts`` are those of :class:`tso_cli.objective.MaskObjective`.
    """
    if len(views[0]) < FEWEST_TO_JUDGE:
        return torch.ones(len(views), len(views[0]), dtype=torch.float64)
    start = points.detach().clone().requires_grad_()
    losses = MaskObjective(views, counts, start).losses(start)
    pulls = [torch.autograd.grad(loss.sum(), start, retain_graph=True)[0].flatten(1).double() for loss in losses]
    sizes = torch.tensor([[view.size for view in own] for own in views], dtype=torch.float64, device=start.device)
    return view_weights(torch.stack(losses, 1).detach().double() / sizes, torch.stack(pulls, 1)).cpu()


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
