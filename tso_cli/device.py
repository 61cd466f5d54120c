"""Chooses where torch computes."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

from .errors import InputError

if TYPE_CHECKING:
    import torch


def for_training(name: str, precision: str) -> torch.device:
    """The device ``name``; a warning says if it has no arithmetic of the ``precision``."""
    device = resolve(name)
    if precision == "bfloat16" and not has_bfloat16(device):
        warnings.warn(
            f"`device` {device} computes in bfloat16 only by detours, so that a step takes several "
            "times as long; expected `precision` float32 here",
            stacklevel=2,
        )
    return device


def has_bfloat16(device: torch.device) -> bool:
    """Whether a device multiplies matrices of bfloat16 as fast as those of float32."""
    import torch

    if device.type == "cuda":
        return torch.cuda.is_bf16_supported(including_emulation=False)
    supported = getattr(torch.cpu, "_is_avx512_bf16_supported", lambda: False)
    return device.type == "cpu" and bool(supported())


def resolve(name: str) -> torch.device:
    """The torch device ``name``: "cpu", "cuda", "cuda:1", "mps" or "auto".

    "auto" is CUDA if it is available, otherwise the CPU. Raises InputError if the device is not
    available.
    """
    import torch

    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    try:
        device = torch.device(name)
        # Reading a value back fails for "meta", whose tensors have no data.
        torch.ones(1, device=device).item()
    except (RuntimeError, AssertionError, NotImplementedError):
        count = torch.cuda.device_count() if torch.cuda.is_available() else 0
        available = f"{count} CUDA devices" if count else "no CUDA device"
        raise InputError(
            f"`device` {name}: not available here (found the CPU and {available}), "
            "expected a device that is"
        ) from None
    return device
