"""`Backend` of torch, on any device; what is learned has gradients."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from ..kernels.nearest import nearest_in_rows

# Rows whose distances are held at once: they stay in the cache of a processor.
ROWS_AT_ONCE = 2


def nearest_few_in_rows(queries: Tensor, data: Tensor, few: int) -> Tensor:
    """[B, Q, few]: which of ``data`` [B, N, D] are nearest to ``queries`` [B, Q, D], in order.

    For few points in many rows, in single precision. The number of a point takes the place of the
    last bits of its distance, so that one minimum finds both: in a third of the time of trees on a
    CPU. Distances that differ by less than 1 in 10,000 count as equal.
    """
    queries, data = queries.detach().float(), data.detach().float().transpose(1, 2).contiguous()
    batch, count, number = len(queries), queries.shape[1], data.shape[2]
    last = (1 << (number - 1).bit_length()) - 1
    numbers = torch.arange(number, dtype=torch.int32, device=data.device)
    nearest = numbers.new_empty(batch, count, few)
    squares, step = queries.new_empty(2, ROWS_AT_ONCE, count, number)
    for first in range(0, batch, ROWS_AT_ONCE):
        rows = slice(first, min(first + ROWS_AT_ONCE, batch))
        size = rows.stop - first
        squared, off = squares[:size], step[:size]
        torch.sub(queries[rows, :, None, 0], data[rows, None, 0], out=squared).square_()
        for axis in range(1, data.shape[1]):
            torch.sub(queries[rows, :, None, axis], data[rows, None, axis], out=off)
            squared.addcmul_(off, off)
        code = squared.view(torch.int32).bitwise_and_(~last).bitwise_or_(numbers)
        for place in range(few):
            index = code.amin(2).bitwise_and_(last)
            nearest[rows, :, place] = index
            if place + 1 < few:
                code.scatter_(2, index[..., None].long(), torch.iinfo(torch.int32).max)
    return nearest.long()


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
            if queries.dtype == torch.float32:
                return nearest_few_in_rows(queries, data, 1)[..., 0]
            return nearest_in_rows(queries, data)
        # |q - d|^2 - |q|^2 as one product of matrices, which writes its result once.
        extended = torch.cat([-2.0 * data, data.square().sum(-1, keepdim=True)], -1)
        ones = torch.ones_like(queries[..., :1])
        return (torch.cat([queries, ones], -1) @ extended.transpose(1, 2)).argmin(2)

    def dilated(self, maps: Tensor) -> Tensor:
        # Along rows, then along columns: a tenth of the time of `max_pool2d` on a CPU.
        rows = functional.pad(maps, (0, 0, 1, 1), value=-torch.inf)
        rows = torch.maximum(torch.maximum(rows[..., :-2, :], rows[..., 2:, :]), maps)
        columns = functional.pad(rows, (1, 1), value=-torch.inf)
        return torch.maximum(torch.maximum(columns[..., :-2], columns[..., 2:]), rows)

    def convolved(self, maps: Tensor, kernel: Tensor, offset: Tensor, stride: int) -> Tensor:
        channels_last = torch.channels_last
        maps, kernel = (each.contiguous(memory_format=channels_last) for each in (maps, kernel))
        return functional.conv2d(maps, kernel, offset, stride, 1)

    def linear(self, values: Tensor, matrix: Tensor, offset: Tensor) -> Tensor:
        return functional.linear(values, matrix.t(), offset)

    def activated(self, values: Tensor) -> Tensor:
        return functional.silu(values)

    def sampled(self, maps: Tensor, places: Tensor) -> Tensor:
        sampled = functional.grid_sample(
            maps.to(places), places[:, None], padding_mode="border", align_corners=False
        )
        return sampled[:, :, 0].transpose(1, 2)


TORCH = TorchBackend()
