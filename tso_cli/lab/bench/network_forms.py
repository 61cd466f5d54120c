"""A step of the network in other forms: memory layouts, precisions, and the two forms of Adam."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.optim.adam import adam

from ...network.model import build_network
from ...refinement.adam import Adam
from .timing import Setting, Work

WHAT = "network forms"
PRECISIONS = {"float32": None, "bfloat16": torch.bfloat16}
LAYOUTS = {"": torch.contiguous_format, "channels last, ": torch.channels_last}


def measure(setting: Setting) -> list[dict[str, Any]]:
    """Forward and backward of one image in every layout and precision, and Adam's step for all weights."""
    setting.report("forms of the network")
    forms: dict[str, Work] = {
        f"forward and backward, {layout}{precision}": _pass(setting, memory_format, kind)
        for layout, memory_format in LAYOUTS.items()
        for precision, kind in PRECISIONS.items()
    }
    parameters: list[Tensor] = list(build_network(seed=setting.seed).to(setting.device).parameters())
    grads = [torch.rand_like(parameter) for parameter in parameters]
    fused = Adam(parameters, 0.0)
    timings = setting.race(
        forms | {"Adam, fused": lambda: fused.apply(grads), "Adam, weight by weight": _plain(parameters, grads)}
    )
    return setting.records(WHAT, timings)


def _pass(setting: Setting, memory_format: torch.memory_format, precision: torch.dtype | None) -> Work:
    network: torch.nn.Module = build_network(seed=setting.seed).to(setting.device).to(memory_format=memory_format)  # type: ignore[call-overload]
    image = torch.rand(1, 3, 64, 64, generator=torch.Generator().manual_seed(setting.seed)).to(setting.device)
    image = image.contiguous(memory_format=memory_format)
    parameters: list[Tensor] = list(network.parameters())

    def work() -> None:
        with torch.autocast(setting.device.type, precision, enabled=precision is not None):
            points = network(image)
        torch.autograd.grad(points.float().square().sum(), parameters)

    return work


def _plain(parameters: list[Tensor], grads: list[Tensor]) -> Work:
    means, squares = ([torch.zeros_like(parameter) for parameter in parameters] for _ in range(2))
    steps = [torch.tensor(0.0) for _ in parameters]

    @torch.no_grad()
    def work() -> None:
        adam(parameters, grads, means, squares, [], steps, foreach=False, fused=False, amsgrad=False, beta1=0.9, beta2=0.999,
             lr=0.0, weight_decay=0.0, eps=1e-8, maximize=False)  # fmt: skip

    return work
