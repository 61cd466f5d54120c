"""Whether Triton kernels (experimental) run: on float32 tensors on a GPU, if Triton is there."""

from __future__ import annotations

import functools
import warnings

import torch
from torch import Tensor


def triton_runs(points: Tensor) -> bool:
    """Whether Triton kernels run on ``points``."""
    return points.device.type == "cuda" and points.dtype == torch.float32 and _importable()


@functools.cache
def _importable() -> bool:
    """Whether Triton can be imported; if it cannot, warns and says why."""
    try:
        import triton  # noqa: F401
    except ImportError as error:
        reason = (str(error).splitlines() or ["no reason given"])[0]
        warnings.warn(
            f"Triton kernels are not used, which is slower: triton cannot be imported ({reason})",
            stacklevel=2,
        )
        return False
    return True
