"""Exact nearest neighbours of batches by all pairs, as a Triton kernel on a GPU. Experimental.

Importing this imports triton: see `tso_cli.kernels.splat_triton`.
"""

from __future__ import annotations

import torch
import triton
import triton.language as tl
from torch import Tensor

# Queries of one program, and points that each query is compared with at once. All pairs are held in
# registers.
QUERIES = 32
DATA = 64


def nearest_in_rows(
    queries: Tensor, data: Tensor, valid: Tensor | None = None, active: Tensor | None = None
) -> Tensor:
    """As `tso_cli.kernels.nearest.nearest_in_rows`, for float32 on a GPU; of equals the first."""
    rows, count, dimensions = queries.shape
    index = torch.empty(rows, count, dtype=torch.int64, device=queries.device)
    if not index.numel():
        return index
    blocks = triton.cdiv(count, QUERIES)
    # Triton launches on the current GPU; the points may be on another one.
    with torch.cuda.device_of(queries):
        _nearest[rows * blocks,](
            queries.contiguous(), data.contiguous(), _flags(valid, index), _flags(active, index),
            index, count, data.shape[1], blocks, DIMENSIONS=dimensions,
            SOME_VALID=valid is not None, SOME_ACTIVE=active is not None,
            QUERIES=QUERIES, DATA=DATA,
        )  # fmt: skip
    return index


def _flags(flags: Tensor | None, unused: Tensor) -> Tensor:
    return unused if flags is None else flags.contiguous().view(torch.uint8)


@triton.jit
def _nearest(  # type: ignore[no-untyped-def]
    queries, data, valid, active, index, query_count, data_count, blocks,
    DIMENSIONS: tl.constexpr, SOME_VALID: tl.constexpr, SOME_ACTIVE: tl.constexpr,
    QUERIES: tl.constexpr, DATA: tl.constexpr,
):  # fmt: skip
    row = tl.program_id(0).to(tl.int64) // blocks
    place = tl.program_id(0) % blocks * QUERIES + tl.arange(0, QUERIES)
    exists = place < query_count
    searches = exists
    if SOME_ACTIVE:
        searches = exists & (tl.load(active + row * query_count + place, mask=exists, other=0) != 0)
    query = queries + (row * query_count + place) * DIMENSIONS
    x = tl.load(query, mask=searches, other=0.0)[:, None]
    y = tl.load(query + 1, mask=searches, other=0.0)[:, None]
    if DIMENSIONS == 3:
        z = tl.load(query + 2, mask=searches, other=0.0)[:, None]
    # Each lane keeps its nearest point so far, and the start of the tile of this point. Lanes are
    # compared once, at the end.
    lane = tl.arange(0, DATA)
    nearest = tl.full([QUERIES, DATA], float("inf"), tl.float32)
    when = tl.full([QUERIES, DATA], 0, tl.int32)
    # The loop is empty if no query of this program is active.
    for start in range(0, data_count * tl.max(searches.to(tl.int32), 0), DATA):
        number = start + lane
        loaded = number < data_count
        if SOME_VALID:
            loaded = loaded & (
                tl.load(valid + row * data_count + number, mask=loaded, other=0) != 0
            )
        point = data + (row * data_count + number) * DIMENSIONS
        # Points that are not loaded are infinitely far; NaN passes no comparison.
        by_x = x - tl.load(point, mask=loaded, other=float("inf"))[None, :]
        by_y = y - tl.load(point + 1, mask=loaded, other=float("inf"))[None, :]
        squared = by_x * by_x + by_y * by_y
        if DIMENSIONS == 3:
            by_z = z - tl.load(point + 2, mask=loaded, other=float("inf"))[None, :]
            squared += by_z * by_z
        closer = squared < nearest
        nearest = tl.where(closer, squared, nearest)
        when = tl.where(closer, start, when)
    closest = tl.min(nearest, 1)
    first = tl.min(tl.where(nearest == closest[:, None], when + lane[None, :], 2147483647), 1)
    finite = searches & (closest < float("inf"))
    tl.store(
        index + row * query_count + place, tl.where(finite, first, -1).to(tl.int64), mask=exists
    )
