"""Adam by torch's own arithmetic, without the start-up cost of ``torch.optim.Adam``."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor
from torch.optim.adam import adam


class Adam:
    """The optimiser of the paper, with torch's defaults: betas (0.9, 0.999), eps 1e-8.

    The first use of a ``torch.optim.Optimizer`` object imports torch's compiler: 0.9 s, nine times what fifty steps on a small
    cloud take. The function underneath does not. Its fused form goes over each parameter once: two to five times faster,
    equal to the plain one but for rounding.

    Parameters
    ----------
    parameters : leaves with ``requires_grad``.
    learning_rate : of every parameter.
    """

    def __init__(self, parameters: list[Tensor], learning_rate: float) -> None:
        self._parameters = parameters
        self._learning_rate = learning_rate
        self._means = [torch.zeros_like(p) for p in parameters]
        self._squares = [torch.zeros_like(p) for p in parameters]
        # Other devices have no fused form in every release of torch that is supported.
        self._fused = all(p.device.type in ("cpu", "cuda") for p in parameters)
        self._steps = [torch.zeros((), device=p.device if self._fused else "cpu") for p in parameters]

    def step(self, loss: Tensor) -> None:
        """One step down the gradient of ``loss``."""
        self.apply(torch.autograd.grad(loss, self._parameters))

    @torch.no_grad()
    def apply(self, grads: Sequence[Tensor]) -> None:
        """One step, given the gradient by each parameter."""
        adam(
            self._parameters,
            [_laid_out_as(p, grad) for p, grad in zip(self._parameters, grads, strict=True)],
            self._means,
            self._squares,
            [],
            self._steps,
            fused=self._fused,
            amsgrad=False,
            beta1=0.9,
            beta2=0.999,
            lr=self._learning_rate,
            weight_decay=0.0,
            eps=1e-8,
            maximize=False,
        )


def _laid_out_as(parameter: Tensor, grad: Tensor) -> Tensor:
    """The fused form goes through memory as it lies: a gradient that autograd expanded or transposed would be misread."""
    return grad if grad.stride() == parameter.stride() else torch.empty_like(parameter).copy_(grad)
