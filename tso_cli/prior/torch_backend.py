"""`Backend` of torch, on any device; what is learned has gradients."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from ..kernels.nearest import nearest_in_rows


class TorchBackend:
    """`tso_cli.prior.backend.Backend` of torch."""

    xp: Any = torch

    def constant(self, values: np.ndarray[Any, Any], like: Tensor) -> Tensor:
        return torch.as_tensor(values, dtype=like.dtype, device=like.device)

    def whole(self, values: Tensor) -> Tensor:
        return values.long()

    def rows(self, values: Tensor, index: Tensor) -> Tensor:
        return torch.gather(values, 1, index[..., None].expand(-1, -1, values.shape[2]))

    def sums(self, index: Tensor, values: Tensor, count: int) -> Tensor:
        out = values.new_zeros(len(values), count, values.shape[2])
        return out.scatter_add_(1, index[..., None].expand_as(values), values)

    def largest(self, index: Tensor, values: Tensor, count: int, least: float) -> Tensor:
        out = values.new_full((len(values), count), least)
        return out.scatter_reduce_(1, index, values, "amax")

    def nearest(self, queries: Tensor, data: Tensor) -> Tensor:
        if queries.device.type == "cpu":
            return nearest_in_rows(queries, data)
        # |q - d|^2 - |q|^2 as one product of matrices, which writes its result once.
        extended = torch.cat([-2.0 * data, data.square().sum(-1, keepdim=True)], -1)
        ones = torch.ones_like(queries[..., :1])
        return (torch.cat([queries, ones], -1) @ extended.transpose(1, 2)).argmin(2)

    def dilated(self, maps: Tensor) -> Tensor:
        return functional.max_pool2d(maps, 3, 1, 1)

    def convolved(self, maps: Tensor, kernel: Tensor, offset: Tensor, stride: int) -> Tensor:
        return functional.conv2d(maps, kernel, offset, stride, 1)

    def sampled(self, maps: Tensor, places: Tensor) -> Tensor:
        found = functional.grid_sample(
            maps, places[:, None], padding_mode="border", align_corners=False
        )
        return found[:, :, 0].transpose(1, 2)


TORCH = TorchBackend()
